# SPDX-License-Identifier: MIT
# ruff: noqa: D100

# # A rubber cylinder pressed between rigid plates
#
# This demo computes nearly incompressible rubber at finite strain. It shows how to
#
# - avoid volumetric locking of rubber, `volumetric="reduced"`,
# - model a quarter of a symmetric problem, and draw the whole,
# - compare the work of the supports with the stored energy.
#
# **Problem.** The problem is that of Sussman and Bathe (1987), in plane strain: a long cylinder of
# rubber, of radius 200 mm, is compressed between two rigid plates without friction until the plates
# have approached by 200 mm, half of its diameter. This is a model of a seal or a bearing pad. The
# law is Mooney-Rivlin's with $C_{10}$ = 0.293 MPa, $C_{01}$ = 0.177 MPa and a bulk modulus of 1410
# MPa, 1500 times the shear modulus. A quarter is meshed; it takes half of the approach. Units: mm,
# MPa, N per mm, N mm per mm.
#
# **Result.** The picture shows the force over the approach of the plates, with the reference
# values, and the von Mises stress in the deformed cylinder.
#
# **Compare with.** Sussman and Bathe's curve gives 250 and 1400 N/mm, read off their graph, at
# approaches of 100 and 200 mm. Twelve variants of another program (Ansys, VM201 and VM211) lie
# between 0.966 and 1.066 times these values.
#
# **Options to try.** `--volumetric full` shows locking. `--degree 2`, `--cell triangle` and `--h`
# change the elements, `--slave plate` exchanges slave and master side (table below).
#
# *Source.* T. Sussman, K.-J. Bathe, "A finite element formulation for nonlinear incompressible
# elastic and inelastic analysis", Computers and Structures 26 (1987) 357-409.

import argparse
import logging
from pathlib import Path

from mpi4py import MPI

import figures
import numpy as np

import dolfinx_mortar as dm
from dolfinx import fem

RADIUS, PLATE = 200.0, (800.0, 200.0)  # mm; width and thickness of the plate
HALF_WAY, WHOLE = 250.0, 1400.0  # N/mm, of Sussman and Bathe's graph at 100 and 200 mm
SIDES = {"cylinder": ("arc", "top"), "plate": ("top", "arc")}  # slave, master

parser = argparse.ArgumentParser(description="A rubber cylinder pressed between plates.")
parser.add_argument("--h", type=float, default=10.0, help="size of the cells, in mm")
parser.add_argument("--cell", choices=["quadrilateral", "triangle"], default="quadrilateral")
parser.add_argument("--degree", type=int, choices=[1, 2], default=1, help="of the displacement")
parser.add_argument(
    "--volumetric",
    choices=["reduced", "full"],
    help="default: reduced, for quadrilaterals of degree 1",
)
parser.add_argument("--slave", choices=list(SIDES), default="cylinder")
parser.add_argument("--approach", type=float, default=200.0, help="of the plates, in mm")
parser.add_argument("--steps", type=int, default=20, help="number of equal load steps")
parser.add_argument("--no-animation", action="store_true", help="draw no animation")
parser.add_argument("--output", type=Path, default=Path("results/rubber"))


def main(options: argparse.Namespace) -> None:
    """Press the cylinder, write results and pictures."""
    # ## Mesh
    #
    # The lower right quarter of the cylinder, and half of the lower plate.

    comm = MPI.COMM_WORLD
    shape = {"radius": RADIUS, "block": PLATE, "core": RADIUS, "limit": 2.0, "half": True}
    mesh, cell_tags, facet_tags = dm.meshing.hertz(
        comm, kind="graded", h=options.h, cell=options.cell, **shape
    )

    # ## Bodies
    #
    # The plate is rigid in effect: its modulus is a hundred thousand times that of the rubber.
    # Cells of first order lock, since they cannot keep their volume at every point. With
    # `volumetric="reduced"`, mean dilatation, they keep it in the mean over the cell.

    V = fem.functionspace(mesh, ("Lagrange", options.degree, (2,)))
    u = fem.Function(V, name="displacement")
    laws = {"disc": dm.MooneyRivlin(C10=0.293, C01=0.177, K=1410.0), "block": dm.NeoHooke(1e5, 0.3)}
    first_order = options.cell == "quadrilateral" and options.degree == 1
    volumetric = options.volumetric or ("reduced" if first_order else "full")
    how = {"strain": "finite", "volumetric": volumetric, "energies": True}
    solid = dm.Solid(u, laws, cell_tags, **how)

    # ## Supports
    #
    # Symmetry on the axis, and on the flat face of the quarter, which is moved down.

    push, zero = fem.Constant(mesh, 0.0), fem.Constant(mesh, 0.0)
    pressed, axis, ground_x, ground_y = (
        fem.dirichletbc(
            value, fem.locate_dofs_topological(V.sub(i), 1, facet_tags.find(side)), V.sub(i)
        )
        for side, i, value in (
            *(("flat", 1, push), ("axis", 0, zero)),
            *(("bottom", 0, zero), ("bottom", 1, zero)),
        )
    )

    # ## Contact and steps

    slave, master = SIDES[options.slave]
    contact = dm.Contact(facet_tags, slave=slave, master=master)
    problem = dm.ContactProblem(solid, [contact], bcs=[pressed, axis, ground_x, ground_y])
    levels = np.linspace(0.0, options.approach, options.steps + 1)[1:]
    options.output.mkdir(parents=True, exist_ok=True)
    results, rows, work, before = options.output / "rubber.xdmf", [], 0.0, (0.0, 0.0)
    with dm.Writer(results, problem, notes={"units": "mm, MPa"}) as writer:
        for step in dm.load_steps(problem, levels, on_time=lambda d: push.value.fill(-d / 2)):
            writer.write(step.time)
            row = measure(step, problem, pressed)
            work += (row["force"] + before[1]) / 2 * (step.time - before[0])
            before = step.time, row["force"]
            rows.append(dm.summarise(step) | row | {"work": work})

    # ## Results
    #
    # The force in N/mm at approaches of 100 and 200 mm, and the Newton iterations of all 20 steps:
    #
    # | | F(100) | F(200) | iterations |
    # |---|---|---|---|
    # | default | 252.9 | 1415.9 | 91 |
    # | `--h 20` | 252.9 | 1417.6 | 89 |
    # | `--slave plate` | 252.8 | 1415.6 | 81 |
    # | `--degree 2 --h 20` | 253.7 | 1418.0 | 181 |
    # | `--cell triangle --degree 2 --h 20` | 253.2 | 1417.0 | 233 |
    # | `--volumetric full` | 296.7 | 1528.0 | 78 |
    #
    # The last row locks, as all cells of first order do without `volumetric="reduced"`. Cells of
    # second order have `--volumetric full` by default.
    #
    # The work of the plates is integrated by the trapezoidal rule. Up to the error of this rule it
    # equals the stored energy.

    dm.write_summary(options.output / "summary.json", problem, rows, options=vars(options))
    if comm.rank == 0:
        figures.draw(options.output, results, rows, animated=not options.no_animation)
        report(rows)
        print(f"results in {options.output}")


def measure(step: dm.LoadStep, problem: dm.ContactProblem, pressed: fem.DirichletBC) -> dict:
    """Return force, energy, stress and volume change of the whole cylinder; collective."""
    solid, (contact,) = problem.solid, problem.contacts
    nodes, J = contact.gather(problem.u), solid.cell_values("J").x.array
    return {
        "approach": step.time,
        "force": 2.0 * abs(float(dm.reaction(problem, pressed).force[1])),
        "stored": 4.0 * solid.energies()["disc"].stored,
        "stored_in_plate": 4.0 * solid.energies()["block"].stored,
        "peak_pressure": float(nodes["pressure"].max()),
        "largest_stress": solid.max("von_mises"),
        "volume_change": problem.comm.allreduce(np.abs(J - 1.0).max(initial=0.0), MPI.MAX),
    }


def report(rows: list[dict]) -> None:
    """Print forces and energies."""
    print("approach   force [N/mm]   stored   work of the plates   peak [MPa]   iterations")
    for row in rows:
        print(
            f"{row['approach']:8.1f} {row['force']:14.2f} {row['stored']:8.0f} {row['work']:20.0f}"
            f" {row['peak_pressure']:12.3f} {row['newton_iterations']:12d}"
        )
    print(f"Sussman and Bathe: {HALF_WAY:g} N/mm at 100 mm, {WHOLE:g} N/mm at 200 mm")


if __name__ == "__main__":
    logging.basicConfig(level=logging.WARNING, format="%(message)s")
    chosen = parser.parse_args()
    if chosen.steps < 1:
        parser.error(f"--steps {chosen.steps}: at least 1")
    if not 0.0 < chosen.approach < 2 * RADIUS:
        parser.error(f"--approach {chosen.approach}: between 0 and the diameter, {2 * RADIUS:g}")
    if not 0.0 < chosen.h <= 50.0:
        parser.error(f"--h {chosen.h}: a positive number, at most 50")
    main(chosen)

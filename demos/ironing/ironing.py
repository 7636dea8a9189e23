# SPDX-License-Identifier: MIT
# ruff: noqa: D100

# # Shallow ironing
#
# This demo computes large sliding with friction at finite strain. It shows how to
#
# - compute at finite strain with a hyperelastic law, `Solid(.., strain="finite")`,
# - let bodies slide over many facets, with friction,
# - read the reaction of a support, and write XDMF files and an animation.
#
# **Problem.** The problem is that of Fischer and Wriggers (2006), in plane strain. A tool with a
# round underside is pressed down by 1 mm, 0.8 mm of it into a soft block, and then dragged along
# the block by 10 mm, over many facets in each step. The law is compressible neo-Hookean with $E$ =
# 689.6 MPa in the block, ten times as much in the tool, and Poisson's ratio 0.32. The coefficient
# of friction is 0.3. Cells under the tool lose a third of their volume. Units: mm, MPa, N per mm.
#
# **Result.** The picture shows the vertical force V and the horizontal force H of the tool, beside
# those of six programs, and the von Mises stress half way along.
#
# **Compare with.** The published forces of the six programs (`literature.py`) differ by a quarter
# in V and by 85 % in H. Two other tests are stricter: the forces should hardly depend on the mesh
# and on the choice of the slave side, and without friction H must vanish half way along, by
# symmetry.
#
# **Options to try.** `--slave block`, `--h 0.075` and `--friction 0` give the other rows of the
# table below. `--steps` is the total number of steps.

import argparse
import logging
from pathlib import Path

from mpi4py import MPI

import figures
import numpy as np
from block_and_tool import block_and_tool

import dolfinx_mortar as dm
from dolfinx import fem

DOWN, ALONG = 1.0, 10.0  # mm
SIDES = {"tool": ("underside", "top"), "block": ("top", "underside")}  # slave, master

parser = argparse.ArgumentParser(
    description="Shallow ironing: a tool is dragged over a soft block."
)
parser.add_argument("--h", type=float, default=0.15, help="length of facets, in mm")
parser.add_argument("--steps", type=int, default=30, help="total number; a third of them down")
parser.add_argument("--friction", type=float, default=0.3, help="coefficient")
parser.add_argument("--slave", choices=list(SIDES), default="tool")
parser.add_argument("--no-animation", action="store_true", help="draw no animation")
parser.add_argument("--output", type=Path, default=Path("results/ironing"))


def main(options: argparse.Namespace) -> None:
    """Press and drag, write results and pictures."""
    # ## Bodies
    #
    # Hyperelastic laws are functions of the deformation gradient. The stress in pictures and files
    # is Cauchy's, force per deformed area.

    mesh, cell_tags, facet_tags = block_and_tool(MPI.COMM_WORLD, options.h)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    u = fem.Function(V, name="displacement")
    laws = {"block": dm.NeoHooke(E=689.6, nu=0.32), "tool": dm.NeoHooke(E=6896.0, nu=0.32)}
    solid = dm.Solid(u, laws, cell_tags, strain="finite")

    # ## Supports
    #
    # The base of the block is held. The displacement of the top of the tool is prescribed, first
    # down, then along the block. The reaction at the top of the tool has the components V and H.

    still, motion = fem.Constant(mesh, (0.0, 0.0)), fem.Constant(mesh, (0.0, 0.0))
    base, held = (
        fem.dirichletbc(value, fem.locate_dofs_topological(V, 1, facet_tags.find(side)), V)
        for side, value in (("base", still), ("held", motion))
    )

    def move(t: float) -> None:
        motion.value[:] = ALONG * max(t - 1.0, 0.0), -DOWN * min(t, 1.0)

    # ## Contact
    #
    # The contact side of the tool includes its flanks, because the block rises beside the underside
    # and touches them.

    slave, master = SIDES[options.slave]
    friction = {"friction": options.friction} if options.friction else {}
    contact = dm.Contact(facet_tags, slave=slave, master=master, **friction)
    problem = dm.ContactProblem(solid, [contact], bcs=[base, held])

    # ## Steps
    #
    # In the first third of the steps the tool moves down, until $t$ = 1; in the others it is
    # dragged, until $t$ = 2.

    down = options.steps // 3
    along = options.steps - down
    times = [*np.linspace(0, 1, down + 1)[1:], *np.linspace(1, 2, along + 1)[1:]]
    options.output.mkdir(parents=True, exist_ok=True)
    results, rows = options.output / "ironing.xdmf", []
    with dm.Writer(results, problem, notes={"units": "mm, MPa"}) as writer:
        for step in dm.load_steps(problem, times, on_time=move):
            writer.write(step.time)
            rows.append(dm.summarise(step) | measure(step, problem, held))

    # ## Results
    #
    # If the sides are exchanged or all facets are halved, V at $t$ = 1 and 1.5 changes by at most
    # 0.6 % and 0.8 %, and H by 7 %.
    #
    # | | V(1) | H(1) | V(1.5) | H(1.5) | Newton iterations a step |
    # |---|---|---|---|---|---|
    # | default | 315.9 | 66.9 | 403.8 | 131.9 | 3.7 |
    # | `--slave block` | 317.8 | 67.6 | 407.1 | 134.8 | 3.8 |
    # | `--h 0.075` | 315.8 | 66.6 | 401.7 | 140.7 | 4.3 |
    # | `--friction 0` | 309.9 | 32.7 | 400.8 | 0.2 | 3.7 |
    #
    # While the tool moves down, the block is softer towards its near free end than towards the
    # far one. This causes a horizontal force, also without friction.

    dm.write_summary(options.output / "summary.json", problem, rows, options=vars(options))
    if mesh.comm.rank == 0:
        figures.draw(options.output, results, rows, animated=not options.no_animation)
        report(rows)
        print(f"results in {options.output}")


def measure(step: dm.LoadStep, problem: dm.ContactProblem, held: fem.DirichletBC) -> dict:
    """Return the forces at the top of the tool, smallest J and largest stress; collective."""
    H, V = dm.reaction(problem, held).force
    return {
        "vertical": -float(V),
        "horizontal": float(H),
        "smallest_J": step.report.certificate.smallest_J,
        "largest_stress": problem.solid.max("von_mises"),
    }


def report(rows: list[dict]) -> None:
    """Print forces and the number of Newton iterations."""
    print("    t     V [N/mm]   H [N/mm]    H/V   smallest J   Newton iterations")
    for row in rows:
        V, H = row["vertical"], row["horizontal"]
        print(
            f"{row['time']:6.3f} {V:11.2f} {H:10.2f} {H / V if V > 1e-6 else 0.0:7.3f}"
            f" {row['smallest_J']:10.3f} {row['newton_iterations']:12d}"
        )
    print(f"Newton iterations: {np.mean([row['newton_iterations'] for row in rows]):.1f} a step")


if __name__ == "__main__":
    logging.basicConfig(level=logging.WARNING, format="%(message)s")
    chosen = parser.parse_args()
    if chosen.steps < 3:
        parser.error(f"--steps {chosen.steps}: at least 3")
    if not 0.0 < chosen.h <= 0.3:
        parser.error(f"--h {chosen.h}: a positive number, at most 0.3")
    if chosen.friction < 0.0:
        parser.error(f"--friction {chosen.friction}: not negative")
    main(chosen)

# SPDX-License-Identifier: MIT
# ruff: noqa: D100

# # Shallow ironing: a tool is pressed into a soft block and dragged along it
#
# A tool with a round underside is pressed 1 mm down, 0.8 mm of it into a soft block, and then
# dragged by 10 mm, many facets in each step, with friction. Strains are large: cells under the tool
# lose a third of their volume. This demo shows how to
#
# - compute at finite strain, `Solid(.., strain="finite")`, with a hyperelastic law,
# - let bodies slide over many facets, with friction,
# - read reactions from supports, and write what XDMF and an animation show.
#
# The problem is that of Fischer and Wriggers (2006), in plane strain, with a compressible
# neo-Hookean law, E = 689.6 MPa in the block and ten times as much in the tool, Poisson's ratio
# 0.32 and a friction coefficient of 0.3. Six programs have published its forces, vertical V and
# horizontal H, which differ by a quarter in V and by 85 % in H (`literature.py`). So it is the
# better test that one's own numbers hardly depend on the mesh or on which side is the slave, and
# that without friction H vanishes in the middle of the way, by symmetry. Units: mm, MPa, N per mm.

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

parser = argparse.ArgumentParser(description="A tool dragged over a soft block.")
parser.add_argument("--h", type=float, default=0.15, help="length of facets, in mm")
parser.add_argument("--steps", type=int, default=30, help="in all; a third of them down")
parser.add_argument("--friction", type=float, default=0.3, help="coefficient")
parser.add_argument("--slave", choices=list(SIDES), default="tool")
parser.add_argument("--no-animation", action="store_true", help="draw no animation")
parser.add_argument("--output", type=Path, default=Path("results/ironing"))


def main(options: argparse.Namespace) -> None:
    """Press and drag, write results and pictures."""
    # ## Bodies
    #
    # Laws see the deformation gradient. The stress that is shown is Cauchy's, force per area as it
    # is then.

    mesh, cell_tags, facet_tags = block_and_tool(MPI.COMM_WORLD, options.h)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    u = fem.Function(V, name="displacement")
    laws = {"block": dm.NeoHooke(E=689.6, nu=0.32), "tool": dm.NeoHooke(E=6896.0, nu=0.32)}
    solid = dm.Solid(u, laws, cell_tags, strain="finite")

    # ## Supports
    #
    # The base is held, the top of the tool moves: down, then along. Its reaction is what the tool
    # is pushed with.

    still, motion = fem.Constant(mesh, (0.0, 0.0)), fem.Constant(mesh, (0.0, 0.0))
    base, held = (
        fem.dirichletbc(value, fem.locate_dofs_topological(V, 1, facet_tags.find(side)), V)
        for side, value in (("base", still), ("held", motion))
    )

    def move(t: float) -> None:
        motion.value[:] = ALONG * max(t - 1.0, 0.0), -DOWN * min(t, 1.0)

    # ## Contact
    #
    # The flanks of the tool belong to its side: the block rises beside the underside, and touches
    # them.

    slave, master = SIDES[options.slave]
    friction = {"friction": options.friction} if options.friction else {}
    contact = dm.Contact(facet_tags, slave=slave, master=master, **friction)
    problem = dm.ContactProblem(solid, [contact], bcs=[base, held])

    # ## Steps
    #
    # At the end of a third of the steps the tool is down, t = 1; at t = 2 it has been dragged.

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
    # V at t = 1 and 1.5 changes by 0.6 % and 0.8 % at most if the sides are swapped or all facets
    # halved, H by 7 %.
    #
    # | | V(1) | H(1) | V(1.5) | H(1.5) | Newton iterations a step |
    # |---|---|---|---|---|---|
    # | default | 315.9 | 66.9 | 403.8 | 131.9 | 3.7 |
    # | `--slave block` | 317.8 | 67.6 | 407.1 | 134.8 | 3.8 |
    # | `--h 0.075` | 315.8 | 66.6 | 401.7 | 140.7 | 4.3 |
    # | `--friction 0` | 309.9 | 32.7 | 400.8 | 0.2 | 3.7 |
    #
    # While it goes down the block yields more to the near free end than to the far one, and the
    # tool feels a thrust, also without friction.

    dm.write_summary(options.output / "summary.json", problem, rows, options=vars(options))
    if mesh.comm.rank == 0:
        figures.draw(options.output, results, rows, animated=not options.no_animation)
        report(rows)
        print(f"results in {options.output}")


def measure(step: dm.LoadStep, problem: dm.ContactProblem, held: fem.DirichletBC) -> dict:
    """Return the forces on the tool's top, and how far cells are compressed; collective."""
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

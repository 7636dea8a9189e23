# SPDX-License-Identifier: MIT
"""Cost of friction: steps of Hertz' contacts with friction over the step of pressing without it.

Run with ``containers/run python3 benchmarks/friction.py [--rounds 3] [--output FILE]``. A disc (2D)
and a quarter of a ball (3D) are pressed on a block and then pushed sideways by a part of the depth,
which without friction would only move them. Memory is measured in separate processes. Problems are
created anew for every round, in turns; the least processor time of each counts, after a first round
that compiles.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path
from time import process_time
from typing import Any

from mpi4py import MPI

import numpy as np

import dolfinx_mortar as dm
from dolfinx import fem

E, NU = 206_900.0, 0.29
LAWS = {
    "elastic": dm.Elastic(E, NU),
    "plastic": dm.VonMises(E, NU, Y=450.0 * np.sqrt(2.0 / 3.0), a=10_000.0),
}
DEPTH = {"elastic": 0.05, "plastic": 0.2}
MU = 0.2
# name: dimension, kind of cell, sizes
CASES = {
    "disc, triangles": (2, "triangle", (0.1, 0.044)),
    "ball, tetrahedra": (3, "tetrahedron", (0.17, 0.12)),
    "ball, hexahedra": (3, "hexahedron", (0.25, 0.2)),
}


def create(dimension: int, mesh: Any, law: str, geometry: str, friction: float | None) -> Any:
    """Return a problem, and the Constant by which its top moves; planes of symmetry are free."""
    V = fem.functionspace(mesh.mesh, ("Lagrange", 1, (dimension,)))
    top = fem.Constant(mesh.mesh, np.zeros(dimension))
    if dimension == 2:
        held, moved = "bottom", "flat"
        slave, master = "top", "arc"
    else:
        held, moved, slave, master = "bottom", "flat", "top", "sphere"
    bcs = [
        fem.dirichletbc(
            value, fem.locate_dofs_topological(V, dimension - 1, mesh.facet_tags.find(tag)), V
        )
        for tag, value in ((held, fem.Constant(mesh.mesh, np.zeros(dimension))), (moved, top))
    ]
    contact = dm.Contact(mesh.facet_tags, slave=slave, master=master, friction=friction)
    solid = dm.Solid(fem.Function(V), LAWS[law])
    return dm.ContactProblem(solid, [contact], bcs=bcs, geometry=geometry), top


def measure(
    dimension: int, cell: str, h: float, law: str, geometry: str, rounds: int
) -> list[dict[str, Any]]:
    """Return a row for pressing and one for pushing with friction, over pressing without."""
    options = {"h": h, "cell": cell} if dimension == 3 else {"kind": "graded", "h": h}
    make = dm.meshing.sphere if dimension == 3 else dm.meshing.hertz
    mesh = make(MPI.COMM_WORLD, **options)
    found: dict[tuple[str, float | None], dict[str, Any]] = {}
    for _ in range(rounds + 1):
        for friction in (None, MU):
            problem, top = create(dimension, mesh, law, geometry, friction)
            for step, side in (("press", 0.0), ("push", 0.1)):
                top.value[0], top.value[-1] = side * DEPTH[law], -DEPTH[law]
                start = process_time()
                report = dm.newton(problem)
                seconds = process_time() - start
                problem.commit()
                row = {
                    "newton": report.newton_iterations,
                    "qp": report.qp_iterations,
                    "krylov": sum(i.linear_iterations for i in report.iterations),
                    "seconds": min(seconds, found.get((step, friction), {}).get("seconds", 1e9)),
                }
                found[step, friction] = row
    unknowns = problem.V.dofmap.index_map.size_global * dimension
    without = found["press", None]
    return [
        {
            "step": f"{law}, {geometry}, {step}",
            "unknowns": unknowns,
            "without": without,
            "with": found[step, MU],
            "ratio": found[step, MU]["seconds"] / without["seconds"],
        }
        for step in ("press", "push")
    ]


def peak(dimension: int, cell: str, h: float, friction: float | None) -> float:
    """Return the peak memory in MB of one elastic step in a process of its own."""
    arguments = [str(dimension), cell, str(h), "" if friction is None else str(friction)]
    command = [sys.executable, __file__, "--peak", *arguments]
    return float(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def say_peak(dimension: str, cell: str, h: str, friction: str) -> None:
    """Print the peak memory of this process after a step."""
    make = dm.meshing.sphere if dimension == "3" else dm.meshing.hertz
    options = {"cell": cell} if dimension == "3" else {"kind": "graded"}
    mesh = make(MPI.COMM_WORLD, h=float(h), **options)
    problem, top = create(
        int(dimension), mesh, "elastic", "reference", float(friction) if friction else None
    )
    top.value[-1] = -DEPTH["elastic"]
    dm.newton(problem)
    # not ru_maxrss, in which a process inherits the peak of the one that started it
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    print(float(status["VmHWM"].split()[0]) / 1e3)


def main() -> None:
    """Measure all cases; print a table and write JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--output", type=Path, help="file for the numbers, or a folder")
    parser.add_argument("--peak", nargs=4, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.peak:
        say_peak(*options.peak)
        return
    found: dict[str, Any] = {}
    for name, (dimension, cell, sizes) in CASES.items():
        rows = []
        for h in sizes:
            for law in LAWS:
                for geometry in ("reference", "updated"):
                    rows += measure(dimension, cell, h, law, geometry, options.rounds)
                    for row in rows[-2:]:
                        one, other = row["without"], row["with"]
                        print(
                            f"{name:18} {row['unknowns']:8d} {row['step']:28} "
                            f"Newton {one['newton']:2d} {other['newton']:2d}  "
                            f"linear {one['krylov']:4d} {other['krylov']:4d}  "
                            f"seconds {one['seconds']:6.2f} {other['seconds']:6.2f}  "
                            f"ratio {row['ratio']:.2f}",
                            flush=True,
                        )
        memory = [peak(dimension, cell, sizes[-1], friction) for friction in (None, MU)]
        print(f"{name:18} peak memory {memory[0]:.0f} and {memory[1]:.0f} MB")
        found[name] = {"steps": rows, "memory": memory}
    if options.output:
        folder = options.output.suffix == ""
        file = options.output / "friction.json" if folder else options.output
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()

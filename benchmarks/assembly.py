# SPDX-License-Identifier: MIT
"""Cost of residuals and tangents of bodies, relative to the plain law in plain kinematics.

Run with ``containers/run python3 benchmarks/assembly.py [--cells 40000] [--rounds 7] [--output
FILE]``. The body is one block, partly plastic. All solids use the same mesh, space and integration
points. They are measured in turns, and the least processor time of each solid counts, so that the
ratios of one run can be compared.
"""

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from time import process_time
from typing import Any

from mpi4py import MPI

import numpy as np

import dolfinx
import dolfinx_mortar as dm
from dolfinx import fem
from tests.cases.pointwise_laws import Compiled

E, NU, Y, A = 206_900.0, 0.29, 367.0, 10_000.0
PLAIN = dm.VonMises(E, NU, Y, A)
ELASTIC, VOCE = dm.Elastic(E, NU), dm.VonMisesVoce(E, NU, Y, A, 500.0, 200.0, 20.0)
DRUCKER_PRAGER, MIXED = dm.DruckerPrager(E, NU, Y, 0.3), dm.VonMises(E, NU, Y, A, H=5_000.0)
EIGEN, FINITE = {"eigenstrain": 1e-4}, {"strain": "finite"}
RUBBER = dm.MooneyRivlin(E / 12, E / 12, E)
# name: law, options of Solid; the first entry of a law is the reference of the others
PLANE = {
    "von Mises": (PLAIN, {}),
    "reduced": (PLAIN, {"volumetric": "reduced"}),
    "axisymmetric": (PLAIN, {"kinematics": "axisymmetric"}),
    "axisymmetric, reduced": (PLAIN, {"kinematics": "axisymmetric", "volumetric": "reduced"}),
    "eigenstrain": (PLAIN, EIGEN),
    "plane stress": (PLAIN, {"kinematics": "plane_stress"}),
    "mixed hardening": (MIXED, {}),
    "mixed, plane stress": (MIXED, {"kinematics": "plane_stress"}),
    "Voce": (VOCE, {}),
    "Drucker-Prager": (DRUCKER_PRAGER, {}),
    "pointwise, numba": (Compiled(E, NU, Y, A), {}),
    "finite, neo-Hooke": (dm.NeoHooke(E, NU), FINITE),
    "finite, Mooney-Rivlin": (RUBBER, FINITE),
    "finite, Mooney-Rivlin, reduced": (RUBBER, FINITE | {"volumetric": "reduced"}),
    "finite, von Mises": (dm.VonMises(E, NU, Y, 0.0, A), FINITE),
    "finite, mixed hardening": (MIXED, FINITE),
    "elastic": (ELASTIC, {}),
    "elastic, axisymmetric": (ELASTIC, {"kinematics": "axisymmetric"}),
    "elastic, eigenstrain": (ELASTIC, EIGEN),
    "elastic, plane stress": (ELASTIC, {"kinematics": "plane_stress"}),
}
IN_SPACE = ("von Mises", "reduced", "eigenstrain", "Voce", "pointwise, numba", "elastic")
FINITE_ONES = [name for name in PLANE if name.startswith("finite")]
SPACE = {name: PLANE[name] for name in (*IN_SPACE, *FINITE_ONES, "elastic, eigenstrain")}


def create_space(cell: str, degree: int, cells: int) -> fem.FunctionSpace:
    """Return a vector space on a block of about so many cells, off the axis."""
    kind = dolfinx.mesh.to_type(cell)
    if cell in ("triangle", "quadrilateral"):
        n = round(np.sqrt(cells / (2 if cell == "triangle" else 1)))
        ends = [np.array([1.0, 0.0]), np.array([2.0, 1.0])]
        mesh = dolfinx.mesh.create_rectangle(MPI.COMM_WORLD, ends, [n, n], kind)
    else:
        n = round(np.cbrt(cells / (6 if cell == "tetrahedron" else 1)))
        mesh = dolfinx.mesh.create_unit_cube(MPI.COMM_WORLD, n, n, n, kind)
    return fem.functionspace(mesh, ("Lagrange", degree, (mesh.geometry.dim,)))


def create_tasks(V: fem.FunctionSpace, law: Any, options: Any) -> list[Callable[[], None]]:
    """Return functions that assemble residual and tangent of a partly plastic solid."""
    u = fem.Function(V)
    u.interpolate(lambda x: 4e-3 * np.array([x[1] * x[0], -0.3 * x[0] ** 2, 0 * x[0]][: len(u)]))
    solid = dm.Solid(u, law, **options)
    K, r = solid.create_matrix(), u.x.petsc_vec.copy()

    def residual() -> None:
        u.x.array[:] *= (
            1.0 + 1e-9
        )  # pointwise laws are evaluated only if the displacement has changed
        solid.assemble_residual(r)

    return [residual, lambda: solid.assemble_tangent(K)]


def measure(
    cell: str, degree: int, cells: int, rounds: int, kinds: dict[str, Any]
) -> list[dict[str, Any]]:
    """Return a row for each kind of solid on a mesh of such cells."""
    V = create_space(cell, degree, cells)
    reducible = degree == 1 and cell in ("quadrilateral", "hexahedron")
    chosen = {
        name: (law, given)
        for name, (law, given) in kinds.items()
        if reducible or "volumetric" not in given or (degree == 2 and "strain" in given)
    }
    tasks = {name: create_tasks(V, law, given) for name, (law, given) in chosen.items()}
    least = {name: [np.inf, np.inf] for name in tasks}
    for turn in range(rounds + 1):  # the first round fills the caches
        for name, both in tasks.items():
            for i, task in enumerate(both):
                begin = process_time()
                task()
                if turn:
                    least[name][i] = min(least[name][i], process_time() - begin)
    rows = []
    for name, seconds in least.items():
        plain = least["elastic" if name.startswith("elastic") else "von Mises"]
        ratios = [mine / its for mine, its in zip(seconds, plain, strict=True)]
        rows.append(
            {"cell": cell, "degree": degree, "kind": name, "ms": [1e3 * s for s in seconds]}
            | {"ratios": ratios}
        )
    return rows


def main() -> None:
    """Measure all kinds on all cells."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--cells", type=int, default=40_000, help="number of cells; a quarter of it in 3D"
    )
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    rows = []
    for cell, degree in (("quadrilateral", 1), ("triangle", 1), ("triangle", 2)):
        rows += measure(cell, degree, options.cells, options.rounds, PLANE)
    for cell in ("hexahedron", "tetrahedron"):
        rows += measure(cell, 1, options.cells // 4, options.rounds, SPACE)
    if MPI.COMM_WORLD.rank == 0:
        print(f"{'cell':14s}degree  {'kind':30s}residual ms  ratio  tangent ms  ratio")
        for row in rows:
            (residual, tangent), ratios = row["ms"], row["ratios"]
            print(
                f"{row['cell']:14s}{row['degree']:5d}   {row['kind']:30s} {residual:11.1f}"
                f" {ratios[0]:6.2f} {tangent:11.1f} {ratios[1]:6.2f}"
            )
        if options.output:
            options.output.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()

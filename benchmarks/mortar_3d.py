# SPDX-License-Identifier: MIT
"""Mortar operators in 3D: time per slave node, and their share of the model's linear solve.

Run with ``containers/run python3 benchmarks/mortar_3d.py [--facets 1000 ...] [--cell CELL]
[--degrees 1 2] [--output FILE]``. Two blocks with n x n and 2n/3 x 2n/3 facets of first order
(twice as many of tetrahedra) at their interface are tied and compressed; those of second order are
twice as long, so that there are as many nodes. The blocks are three cells high, fewer than in real
models, where the share is smaller. The smallest model is solved twice, so that no compilation is
measured.
"""

import argparse
import json
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np

import dolfinx_mortar as dm
from dolfinx import fem
from tests.cases.meshes_3d import BOTTOM, BOTTOM_OF_UPPER, TOP, TOP_OF_LOWER, two_boxes

COMM = MPI.COMM_WORLD
LAYERS = 3


def row(n: int, cell: str, degree: int) -> dict[str, Any]:
    """Solve the model with (n + 1)^2 slave nodes and return its numbers."""
    fine, coarse = n // degree, 2 * n // (3 * degree)
    mesh, _, facets = two_boxes(
        COMM,
        (fine, fine, LAYERS),
        (coarse, coarse, LAYERS),
        heights=(LAYERS / fine, LAYERS / coarse),
        cell=cell,
    )
    V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
    bcs = []
    for tag, value in ((BOTTOM, 0.0), (TOP, -1e-3 / n)):
        dofs = fem.locate_dofs_topological(V, 2, facets.find(tag))
        bcs.append(fem.dirichletbc(np.array([0.0, 0.0, value]), dofs, V))
    solid = dm.Solid(fem.Function(V, name="u"), dm.Elastic(E=206_900.0, nu=0.29))
    tie = dm.Tie(facets, slave=TOP_OF_LOWER, master=BOTTOM_OF_UPPER)
    problem = dm.ContactProblem(solid, [tie], bcs=bcs)
    report = dm.newton(problem)
    seconds, linear = problem.timings.seconds, problem.linear.counts
    solve = linear.seconds_factor + linear.seconds_solve
    nodes = (degree * fine + 1) ** 2
    return {
        "cell": cell,
        "degree": degree,
        "slave_nodes": nodes,
        "unknowns": 3 * V.dofmap.index_map.size_global,
        "ranks": COMM.size,
        "mortar": seconds["mortar"],
        "microseconds_per_node": 1e6 * seconds["mortar"] / nodes,
        "set_up_and_solve": solve,
        "mortar_over_linear": seconds["mortar"] / solve,
        "krylov": sum(i.linear_iterations for i in report.iterations),
        "linear_field_error": report.certificate.linear_field_error,
    }


def main() -> None:
    """Measure all models."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--facets", type=int, nargs="+", default=[1_000, 10_000, 100_000])
    parser.add_argument("--cell", choices=["hexahedron", "tetrahedron"], default="hexahedron")
    parser.add_argument("--degrees", type=int, nargs="+", choices=[1, 2], default=[1])
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    sizes = [round(np.sqrt(m)) for m in options.facets]
    for degree in options.degrees:
        row(sizes[0], options.cell, degree)  # compiles
    rows = [row(n, options.cell, degree) for n in sizes for degree in options.degrees]
    if COMM.rank == 0:
        print("degree     nodes  unknowns  mortar s  us/node  multigrid s  share   CG")
        for r in rows:
            print(
                f"{r['degree']:6d} {r['slave_nodes']:9d} {r['unknowns']:9d} {r['mortar']:9.2f}"
                f" {r['microseconds_per_node']:8.1f} {r['set_up_and_solve']:12.2f}"
                f" {100 * r['mortar_over_linear']:5.1f}% {r['krylov']:4d}"
            )
        if options.output:
            options.output.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()

# SPDX-License-Identifier: MIT
"""Factorisations in a bound-constrained QP: a block under a rigid parabolic obstacle.

Run with ``containers/run python3 benchmarks/qp_reuse.py [--cells 50 158 316] [--output FILE]``. One
table row per mesh: the plain factorisation and solve, which are the units of all ratios; the QP
without a previous solution; the QP again, for a tangent that has changed by a few per cent.
"""

import argparse
import json
from pathlib import Path
from time import perf_counter
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

import ufl
from dolfinx import fem, mesh
from dolfinx.fem.petsc import assemble_matrix
from dolfinx_mortar.qp import BoundQP, LinearSolver, solve

COMM = MPI.COMM_WORLD
DEPTH, RADIUS = 0.01, 5.0
COLUMNS = (
    "unknowns",
    "symbolic+numeric [s]",
    "numeric [s]",
    "one solve [s]",
    "QP [s]",
    "ratio",
    "active/bounded",
    "solves",
    "factorisations",
    "next QP [s]",
    "next solves",
    "next factorisations",
)


def block(cells: int) -> tuple[fem.FunctionSpace, BoundQP]:
    """Return an elastic unit square held below, and its contact with a parabola above.

    The space is returned because PETSc objects live on its mesh's communicator.
    """
    domain = mesh.create_unit_square(COMM, cells, cells)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    strain = ufl.sym(ufl.grad(u))
    stress = 2.0 * strain + 1.5 * ufl.tr(strain) * ufl.Identity(2)
    below = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[1], 0.0))
    clamp = fem.dirichletbc(np.zeros(2), below, V)
    A = assemble_matrix(fem.form(ufl.inner(stress, ufl.grad(v)) * ufl.dx), [clamp])
    A.assemble()
    above = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[1], 1.0))
    above = above[above < V.dofmap.index_map.size_local]
    bounded = (2 * above + 1).astype(np.int32)
    b, lower, upper = (A.createVecRight() for _ in range(3))
    lower.set(PETSc.NINFINITY)
    upper.set(PETSc.INFINITY)
    x = V.tabulate_dof_coordinates()[above, 0]
    upper.array[bounded] = (x - 0.47) ** 2 / (2.0 * RADIUS) - DEPTH
    return V, BoundQP(A, b, lower, upper, bounded)


def plain(A: PETSc.Mat) -> tuple[float, float, float]:
    """Return seconds of symbolic + numeric factorisation, of numeric alone, of one solve."""
    linear = LinearSolver(COMM, prefix="plain_")
    linear.set_matrix(A)
    none = np.zeros(0, dtype=np.int32)
    r, x = A.createVecRight(), A.createVecRight()
    r.set(1.0)
    times = []
    for _ in range(2):
        A.stateIncrease()
        before = linear.counts.seconds_factor
        linear.factorise(none)
        times.append(linear.counts.seconds_factor - before)
    linear.apply(r, x)
    before = linear.counts.seconds_solve
    linear.apply(r, x)
    return times[0], times[1], linear.counts.seconds_solve - before


def measure(cells: int) -> dict[str, Any]:
    """Return one row of the table."""
    _space, qp = block(cells)
    whole, numeric, one = plain(qp.A)
    start = (qp.upper.array_r[qp.bounded] < 0.0).astype(np.int8)
    linear = LinearSolver(COMM, prefix="bench_")
    begin = perf_counter()
    first = solve(qp, linear=linear, start_active=start)
    middle = perf_counter()
    diagonal = qp.A.getDiagonal()
    diagonal.array[::3] *= 1.02
    qp.A.setDiagonal(diagonal)
    before = perf_counter()
    second = solve(qp, linear=linear, start_active=first.active)
    end = perf_counter()
    active = COMM.allreduce(np.array([np.abs(first.active).sum(), qp.bounded.size]))
    values = (
        *(qp.A.size[0], whole, numeric, one, middle - begin, (middle - begin) / whole),
        *(f"{active[0]}/{active[1]}", first.linear_iterations, first.factorisations),
        *(end - before, second.linear_iterations, second.factorisations),
    )
    return dict(zip(COLUMNS, values, strict=True))


def main() -> None:
    """Print the table; write it as JSON if asked to."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cells", type=int, nargs="+", default=[50, 158, 316])
    parser.add_argument("--output", type=Path)
    arguments = parser.parse_args()
    rows = [measure(cells) for cells in arguments.cells]
    if COMM.rank == 0:
        for name in COLUMNS:
            cells = [f"{v:.4g}" if isinstance(v := row[name], float) else str(v) for row in rows]
            print(f"{name:22}", *(f"{cell:>12}" for cell in cells))
        if arguments.output:
            arguments.output.write_text(json.dumps({"ranks": COMM.size, "rows": rows}, indent=1))


if __name__ == "__main__":
    main()

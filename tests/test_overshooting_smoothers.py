# SPDX-License-Identifier: MIT
"""Multigrid whose smoothers were given too small an eigenvalue: they estimate it by themselves."""

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest

from dolfinx_mortar.qp.linear import LinearSolveFailed, LinearSolver
from dolfinx_mortar.qp.multigrid import OwnUnknowns, Preconditioning

SIDE = 40
NONE = np.zeros(0, dtype=np.int32)
# As what a stiff slave adds to the nodes of a soft master: a matrix of rank one on a few nodes.
NODES = np.array([SIDE * i + j for i in range(6, 36, 8) for j in (9, 10, 29, 30)], dtype=np.int32)


def matrix(values, rows):
    """Return a matrix (n, n) of these rows and columns, zero elsewhere."""
    n = SIDE**2
    A = PETSc.Mat().createAIJ((n, n), nnz=len(NODES), comm=MPI.COMM_SELF)
    A.setOption(PETSc.Mat.Option.IGNORE_ZERO_ENTRIES, True)
    A.setValues(rows, rows, values)
    A.assemble()
    return A


def membrane():
    """Return the matrix of differences on a square grid with fixed boundary."""
    line = 2.0 * np.eye(SIDE) - np.eye(SIDE, k=1) - np.eye(SIDE, k=-1)
    whole = np.kron(line, np.eye(SIDE)) + np.kron(np.eye(SIDE), line)
    return matrix(whole, np.arange(SIDE**2, dtype=np.int32))


class Apart(OwnUnknowns):
    """Levels are made without some of the entries, which are added to them."""

    def __init__(self, A, between):
        super().__init__(A)
        self.between = between

    def preconditioning(self, held):
        """Return them for a set of held unknowns."""
        change = self.change(held)
        B = change.matrix.copy()
        B.axpy(-1.0, self.between)
        return Preconditioning(B, change, [], self.between.copy())


def problem(sign, second=-1.0):
    """Return a solver and its matrix, sign 100 v v^T included; v is 1 and second at neighbours."""
    v = np.resize([1.0, second], len(NODES))
    outer = np.outer(v, v)
    A, between = membrane(), matrix(sign * 100.0 * (outer - np.eye(len(NODES))), NODES)
    A.axpy(1.0, matrix(100.0 * np.eye(len(NODES)), NODES))  # the diagonal is in both
    A.axpy(1.0, between)
    unknowns = Apart(A, between)
    solver = LinearSolver(MPI.COMM_SELF, prefix="over_", multigrid=True, unknowns=unknowns)
    solver.set_matrix(A)
    return solver, A


def left(solver, A):
    """Return the residual of a solution, over the right-hand side."""
    b, x = A.createVecLeft(), A.createVecRight()
    b.array[:] = np.sin(np.arange(SIDE**2))
    solver.solve(b, x, NONE, atol=1e-8 * b.norm())
    return (b - A * x).norm() / b.norm()


def test_smoothers_estimate_by_themselves():
    """The largest eigenvalue over the diagonal is 16, 2 without the entries between bodies."""
    assert left(*problem(1.0)) < 1e-8
    solver, A = problem(1.0)
    solver.options.given["pc_gamg_use_sa_esteig"] = True
    with pytest.raises(LinearSolveFailed, match="PETSc reason -8"):
        left(solver, A)


def test_negative_pivots_of_the_coarsest_level():
    """There the matrix is indefinite."""
    solver, A = problem(-1.0, second=1.0)
    with pytest.raises(LinearSolveFailed):
        left(solver, A)
    assert solver.negative_pivots() > 0
    assert solver.counts.factorisations == 1

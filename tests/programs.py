# SPDX-License-Identifier: MIT
"""Bound-constrained QPs without a mesh, for any number of ranks."""

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.qp import BoundQP

# three unknowns: from six of the eight active sets the updates never end
CYCLING = np.array([[9.0, -13, 7], [-13, 22, -7], [7, -7, 9]])
CYCLING_FORCE = np.array([-1.0, 2, 0])


def sets(*values):
    """Return an active set."""
    return np.array(values, dtype=np.int8)


def from_arrays(A, b, lower, upper, comm):
    """Distribute a dense problem given on all ranks; IEEE infinities mean no bound."""
    matrix = PETSc.Mat().createAIJ(A.shape, nnz=A.shape[0], comm=comm)
    first, last = matrix.getOwnershipRange()
    for row in range(first, last):
        matrix.setValues(row, np.arange(A.shape[0], dtype=PETSc.IntType), A[row])
    matrix.assemble()
    vectors = [matrix.createVecRight() for _ in range(3)]
    for vector, values in zip(vectors, (b, lower, upper), strict=True):
        vector.array[:] = np.clip(values[first:last], PETSc.NINFINITY, PETSc.INFINITY)
    own = np.isfinite(lower) | np.isfinite(upper)
    return BoundQP(matrix, *vectors, np.flatnonzero(own[first:last]).astype(np.int32))


def gathered(v):
    """Return all entries of a vector on every rank."""
    return np.concatenate(v.comm.tompi4py().allgather(v.array_r.copy()))


def membrane(
    n=24,
    *,
    comm=MPI.COMM_WORLD,
    depth=0.05,
    curvature=1.0,
    held=True,
    force=0.0,
    stiffness=1.0,
    length=1.0,
):
    """Return a square membrane of n x n nodes under a parabolic obstacle along its last row."""
    size = n * n
    A = PETSc.Mat().createAIJ((size, size), nnz=5, comm=comm)
    first, last = A.getOwnershipRange()
    b, lower, upper = (A.createVecRight() for _ in range(3))
    lower.set(PETSc.NINFINITY)
    upper.set(PETSc.INFINITY)
    bounded = []
    for row in range(first, last):
        i, j = divmod(row, n)
        neighbours = [
            p * n + q
            for p, q in ((i - 1, j), (i + 1, j), (i, j - 1), (i, j + 1))
            if 0 <= p < n and 0 <= q < n
        ]
        A.setValue(row, row, stiffness * (len(neighbours) + (1 if held and i == 0 else 0)))
        for column in neighbours:
            A.setValue(row, column, -stiffness)
        if i == 0:
            b[row] = force * stiffness * length
        if i == n - 1:
            t = j / (n - 1) - 0.45
            upper[row] = length * (0.5 * curvature * t * t - depth)
            bounded.append(row - first)
    for part in (A, b, upper):
        part.assemble()
    return BoundQP(A, b, lower, upper, np.array(bounded, dtype=np.int32))


def active_everywhere(solution):
    """Return the active set of all ranks on every rank."""
    parts = MPI.COMM_WORLD.allgather(solution.active)
    return [int(a) for part in parts for a in part]

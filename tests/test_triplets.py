# SPDX-License-Identifier: MIT
"""Matrices from triplets: repeated entries, entries of other ranks, refilling."""

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest

from dolfinx_mortar.algebra import triplets

COMM = MPI.COMM_WORLD
pytestmark = pytest.mark.mpi


def test_sum_of_entries_of_all_ranks():
    """Every rank adds to every row; all that is in a row is the sum over ranks and repetitions."""
    n = 3 * COMM.size
    A = PETSc.Mat().create(COMM)
    A.setSizes([(3, n), (3, n)])
    A.setType(PETSc.Mat.Type.AIJ)
    rows = np.repeat(np.arange(n), 2)
    columns = (rows + 1) % n
    kept = rows.copy(), columns.copy()
    triplets.set_pattern(A, rows, columns)
    assert (rows == kept[0]).all()  # PETSc sorts copies
    for factor in (1.0, -3.0):
        triplets.set_values(A, factor * (1.0 + rows))
        first, last = A.getOwnershipRange()
        start, j, values = A.getValuesCSR()
        own = np.arange(first, last)
        assert (np.diff(start) == 1).all()
        assert (j == (own + 1) % n).all()
        assert (values == 2 * COMM.size * factor * (1.0 + own)).all()


def test_values_that_are_zero_stay_in_the_pattern():
    A = PETSc.Mat().create(COMM)
    A.setSizes([(1, COMM.size)] * 2)
    A.setType(PETSc.Mat.Type.AIJ)
    i = np.array([COMM.rank, COMM.rank])
    triplets.set_pattern(A, i, np.array([0, COMM.size - 1]))
    triplets.set_values(A, np.zeros(2))
    assert len(A.getValuesCSR()[1]) == min(2, COMM.size)


def test_entries_off_the_matrix():
    """PETSc does not look, it would write past the end."""
    A = PETSc.Mat().create(COMM)
    A.setSizes([(1, COMM.size)] * 2)
    A.setType(PETSc.Mat.Type.AIJ)
    with pytest.raises(AssertionError):
        triplets.set_pattern(A, [COMM.size], [0])

# SPDX-License-Identifier: MIT
"""Sums of triplets: repeated entries, entries of other ranks, one pattern for many sums."""

from types import SimpleNamespace

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx_mortar.algebra.csr import Triplets

COMM = MPI.COMM_WORLD
pytestmark = pytest.mark.mpi


def layout(n):
    return SimpleNamespace(size_local=n, size_global=n * COMM.size)


def test_sum_of_entries_of_all_ranks():
    """Every rank adds to every row; all that is in a row is the sum over ranks and repetitions."""
    n = 3 * COMM.size
    rows = np.repeat(np.arange(n), 2)
    columns = (rows + 1) % n
    given = rows.copy(), columns.copy()
    triplets = Triplets(COMM, layout(3), rows, columns)
    assert (rows == given[0]).all() and (columns == given[1]).all()  # PETSc sorts copies
    own = np.arange(3) + 3 * COMM.rank
    assert triplets.rows.tolist() == [0, 1, 2]
    assert (triplets.columns == (own + 1) % n).all()
    sums = [triplets.sum(factor * (1.0 + rows)) for factor in (1.0, -3.0)]
    for factor, values in zip((1.0, -3.0), sums, strict=True):  # the first one is still known
        assert (values == 2 * COMM.size * factor * (1.0 + own)).all()
    matrix = triplets.matrix(sums[0])
    ones = matrix.createVecRight()
    ones.set(1.0)
    triplets.sum(np.zeros(rows.size))
    assert ((matrix * ones).array == sums[0]).all()


def test_values_that_are_zero_stay_in_the_pattern():
    i = np.array([COMM.rank, COMM.rank])
    triplets = Triplets(COMM, layout(1), i, np.array([0, COMM.size - 1]))
    assert len(triplets.sum(np.zeros(2))) == len(triplets.columns) == min(2, COMM.size)


@pytest.mark.parametrize("row", [-1, COMM.size])
def test_entries_off_the_matrix(row):
    """PETSc does not look, it would write past the end."""
    with pytest.raises(AssertionError):
        Triplets(COMM, layout(1), [row], [0])

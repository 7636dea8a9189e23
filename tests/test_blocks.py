# SPDX-License-Identifier: MIT
"""Matrices of blocks between nodes: entries where they belong, repeated places, refilling."""

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx import fem
from dolfinx_mortar.algebra.csr import BlockMatrix
from tests.cases.meshes import two_blocks
from tests.cases.meshes_3d import two_boxes

COMM = MPI.COMM_WORLD
pytestmark = pytest.mark.mpi


def space(d, partition):
    mesh = (two_blocks if d == 2 else two_boxes)(COMM, partition=partition)[0]
    return fem.functionspace(mesh, ("Lagrange", 1, (d,)))


@pytest.mark.parametrize(
    ("d", "repeats", "partition"), [(2, False, "empty"), (2, True, "graph"), (3, True, "empty")]
)
def test_blocks_stand_at_their_nodes(d, repeats, partition, rng):
    """Against a sum over the blocks, entry by entry; a second filling leaves nothing of the first.

    Places come in any order and may be those of other ranks' columns.
    """
    V = space(d, partition)
    layout = V.dofmap.index_map
    n, N, first = layout.size_local, layout.size_global, layout.local_range[0]
    rows, columns = np.divmod(rng.permutation(n * N)[: 3 * n], N)
    if repeats:
        rows, columns = np.tile(rows, 2), np.tile(columns, 2)
    A = BlockMatrix(COMM, V.dofmap.index_map, d, rows, columns)
    assert A.matrix.getSize() == (d * N, d * N)
    for _ in range(2):
        blocks = rng.normal(size=(len(rows), d, d))
        A.fill(blocks)
        expected = np.zeros((n, d, N, d))
        np.add.at(expected, (rows, slice(None), columns), blocks)
        start, j, values = A.matrix.getValuesCSR()
        found = np.zeros((d * n, d * N))
        found[np.repeat(np.arange(d * n), np.diff(start)), j] = values
        assert (found == expected.reshape(d * n, d * N)).all()
    assert A.matrix.getOwnershipRange() == (d * first, d * (first + n))


def test_columns_ascend_and_zeros_stay():
    """Products refill patterns in place, which must not depend on the values."""
    V = space(2, "stripes")
    n = V.dofmap.index_map.size_local
    A = BlockMatrix(COMM, V.dofmap.index_map, 2, np.repeat(np.arange(n), 2), np.tile([1, 0], n))
    A.fill(np.zeros((2 * n, 2, 2)))
    start, j, values = A.matrix.getValuesCSR()
    assert (np.diff(start) == 4).all()
    assert (j.reshape(-1, 4) == np.arange(4)).all()
    assert (values == 0).all()

# SPDX-License-Identifier: MIT
"""Sums of dense blocks, or of sparse matrices, on a pattern that is fixed once; over all ranks."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

from mpi4py import MPI
from petsc4py import PETSc

import numba
import numpy as np
from scipy import sparse

from dolfinx_mortar.algebra.blocks import Layout
from dolfinx_mortar.algebra.triplets import Triplets
from dolfinx_mortar.arrays import Floats, Ints, Longs

Matrix: TypeAlias = sparse.csr_array


@dataclass(frozen=True, eq=False)
class Blocks:
    """Dense matrices (p,) between a rows and b columns of nodes, of i x h entries for each two."""

    rows: Ints  # (p, a) nodes
    columns: Ints  # (p, b) nodes
    values: Floats  # (p, a, i, b, h)


@numba.njit(cache=True)
def _add(start, columns, rows, others, values, total):  # type: ignore[no-untyped-def]
    """Add values (p, a, i, b, h) to a total (e, i, h) at the entries of a pattern."""
    for p in range(rows.shape[0]):
        for a in range(rows.shape[1]):
            first, last = start[rows[p, a]], start[rows[p, a] + 1]
            for b in range(others.shape[1]):
                low, high = first, last
                while high - low > 1:
                    middle = (low + high) // 2
                    if columns[middle] <= others[p, b]:
                        low = middle
                    else:
                        high = middle
                for i in range(values.shape[2]):
                    for h in range(values.shape[4]):
                        total[low, i, h] += values[p, a, i, b, h]


class BlockSums:
    """A matrix of blocks on a fixed pattern of this rank's nodes, and its sum over ranks.

    Args:
        comm: communicator.
        layout: how the sum is divided among ranks.
        pattern: (m, n) which blocks there may be.
        block: rows and columns of each.
        rows: (block rows * m,) global rows of the sum.
        columns: (block columns * n,) its global columns.

    Attributes:
        sums: the sum over ranks.
    """

    def __init__(
        self,
        comm: MPI.Intracomm,
        layout: Layout,
        pattern: Matrix,
        block: tuple[int, int],
        rows: Longs,
        columns: Longs,
    ) -> None:
        """Fix the pattern; collective."""
        pattern = Matrix(pattern).sorted_indices()
        self._start, self._columns = pattern.indptr, pattern.indices
        self._width, self._block = pattern.shape[1], block
        node = np.repeat(np.arange(pattern.shape[0]), np.diff(self._start))
        self._keys = node.astype(np.int64) * self._width + self._columns
        i = block[0] * node[:, None, None] + np.arange(block[0])[:, None]
        j = block[1] * self._columns[:, None, None] + np.arange(block[1])
        shape = len(node), *block
        numbers = (np.broadcast_to(v, shape) for v in (rows[i], columns[j]))
        self.sums = Triplets(comm, layout, *numbers)

    def fill(self, parts: Sequence[Matrix | Blocks]) -> PETSc.Mat:
        """Return the sum of parts within the pattern, over ranks; collective.

        Sparse matrices have scalar entries, of which each is stored once.
        """
        total = np.zeros((len(self._keys), *self._block))
        for part in parts:
            if isinstance(part, Blocks):
                at = part.rows, part.columns, part.values
                _add(self._start, self._columns, *(np.ascontiguousarray(v) for v in at), total)
                continue
            entries, (a, b) = part.tocoo(), self._block
            (row, i), (column, j) = np.divmod(entries.row, a), np.divmod(entries.col, b)
            place = np.searchsorted(self._keys, row.astype(np.int64) * self._width + column)
            total[place, i, j] += entries.data
        return self.sums.fill(total)

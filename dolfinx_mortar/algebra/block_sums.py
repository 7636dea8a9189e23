# SPDX-License-Identifier: MIT
"""Sums of dense blocks on a pattern that is fixed once; over all ranks."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

from mpi4py import MPI
from petsc4py import PETSc

import numba
import numpy as np
from scipy import sparse

from dolfinx_mortar.algebra.blocks import Layout
from dolfinx_mortar.algebra.csr import csr_of
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


class BlockEntries:
    """Sums of blocks at the entries of a pattern of this rank's nodes.

    Args:
        pattern: (m, n) which blocks there may be.
        block: rows and columns of each.
        rows: (block rows * m,) global rows.
        columns: (block columns * n,) global columns.

    Attributes:
        rows: Global rows (e,) of all entries, some of them of other ranks.
        columns: Their global columns (e,).
    """

    rows: Longs
    columns: Longs

    def __init__(
        self, pattern: Matrix, block: tuple[int, int], rows: Longs, columns: Longs
    ) -> None:
        pattern = Matrix(pattern).sorted_indices()
        self._start, self._nodes = pattern.indptr, pattern.indices
        self._shape = len(self._nodes), *block
        node = np.repeat(np.arange(pattern.shape[0]), np.diff(self._start))
        i = block[0] * node[:, None, None] + np.arange(block[0])[:, None]
        j = block[1] * self._nodes[:, None, None] + np.arange(block[1])
        found = (np.broadcast_to(v, self._shape).ravel() for v in (rows[i], columns[j]))
        self.rows, self.columns = found

    def sum(self, parts: Sequence[Blocks]) -> Floats:
        """Return the sums (e,) of parts within the pattern."""
        total = np.zeros(self._shape)
        for part in parts:
            at = part.rows, part.columns, part.values
            _add(self._start, self._nodes, *(np.ascontiguousarray(v) for v in at), total)
        return total.ravel()


class BlockSums:
    """The matrix of the sums over all ranks of blocks at the entries of a pattern."""

    def __init__(self, comm: MPI.Intracomm, layout: Layout, entries: BlockEntries) -> None:
        """Analyse the pattern; collective."""
        self._entries = entries
        self._sums = Triplets(comm, layout, entries.rows, entries.columns)

    def zero(self) -> PETSc.Mat:
        """Return the matrix with zeros; collective."""
        return self._sums.zero()

    def fill(self, parts: Sequence[Blocks]) -> PETSc.Mat:
        """Return the sum of parts within the pattern; collective."""
        return self._sums.fill(self._entries.sum(parts))


class SumWithProducts:
    """A + sum_i B_i N_i over all ranks, on a fixed pattern."""

    def __init__(
        self,
        comm: MPI.Intracomm,
        layout: Layout,
        A: BlockEntries,
        *products: tuple[BlockEntries, PETSc.Mat],
    ) -> None:
        """Analyse the patterns of A and of each B and N; collective."""
        self._A, rows, columns = A, [A.rows], [A.columns]
        self._products: list[tuple[BlockSums, PETSc.Mat]] = []
        for B, N in products:
            sums = BlockSums(comm, layout, B)
            product = sums.zero().matMult(N)
            start, found, _ = csr_of(product)
            first, last = product.getOwnershipRange()
            rows.append(np.repeat(np.arange(first, last), np.diff(start)))
            columns.append(found.astype(np.int64))
            self._products.append((sums, product))
        self._total = Triplets(comm, layout, np.concatenate(rows), np.concatenate(columns))

    def zero(self) -> PETSc.Mat:
        """Return the matrix of `fill`, whatever its values, for the analysis of its pattern."""
        return self._total.zero()

    def fill(
        self,
        A: Sequence[Blocks],
        *products: tuple[Sequence[Blocks], PETSc.Mat],
    ) -> PETSc.Mat:
        """Return the sum, the same matrix in every call; collective."""
        values = [self._A.sum(A)]
        for (sums, product), (B, N) in zip(self._products, products, strict=True):
            sums.fill(B).matMult(N, result=product)
            values.append(csr_of(product)[2])
        return self._total.fill(np.concatenate(values))

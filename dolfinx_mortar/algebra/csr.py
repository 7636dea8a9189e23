# SPDX-License-Identifier: MIT
"""Entries in the format CSR, and sums of triplets and dense blocks over all ranks.

petsc4py's `getValuesCSR` and `setValuesCSR` take a hundred times as long; it does not wrap
MatSetPreallocationCOO. Sums do not depend on the order of messages.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Protocol

from mpi4py import MPI
from petsc4py import PETSc

import numba
import numpy as np
import numpy.typing as npt
import scipy

from dolfinx_mortar.common.arrays import Floats, Ints, Longs

# the libraries that petsc4py is linked with
_lib = ctypes.CDLL(PETSc.__file__)


def has(name: str) -> bool:
    """Whether a function of PETSc's library can be called: petsc4py may hide it."""
    return hasattr(_lib, name)


def call(name: str, *arguments: object) -> None:
    """Call a function; raise its error."""
    error = getattr(_lib, name)(*arguments)
    if error:
        raise PETSc.Error(error)


def csr_of(A: PETSc.Mat) -> tuple[Ints, Ints, Floats]:
    """First entry of each owned row, global columns and values, copied."""
    if A.getType() != "seqaij":
        return A.getValuesCSR()
    start, columns = A.getRowIJ()
    with _stored(A, "Read", len(columns)) as values:
        return start, columns, values.copy()


def owned_rows(A: PETSc.Mat) -> scipy.sparse.csr_array:
    """Owned rows with global columns, copied."""
    start, columns, values = csr_of(A)
    return scipy.sparse.csr_array((values, columns, start), shape=(len(start) - 1, A.getSize()[1]))


def matrix_of(comm: MPI.Comm, rows: scipy.sparse.sparray, columns: int) -> PETSc.Mat:
    """Matrix of owned rows with global columns, of which this rank owns some; collective."""
    found, sizes = rows.tocsr(), ((rows.shape[0], None), (columns, None))
    places = (v.astype(PETSc.IntType) for v in (found.indptr, found.indices))
    return PETSc.Mat().createAIJ(sizes, csr=(*places, found.data), comm=comm)


def set_csr(A: PETSc.Mat, start: Ints, columns: Ints, values: Floats) -> None:
    """Set all values (e,) of owned rows of an assembled matrix, on its pattern; collective.

    Global columns (e,) ascend in each row; start is (rows + 1,).
    """
    if A.getType() != "seqaij":
        A.setValuesCSR(start, columns, values)
        A.assemble()
        return
    with _stored(A, "Write", len(columns)) as stored:
        stored[:] = values


def add_blocks(A: PETSc.Mat, start: Ints, columns: Ints, blocks: Floats) -> None:
    """Add blocks (e, d, c) to an assembled matrix on one rank.

    Columns (e,) of blocks ascend in each row; start is (block rows + 1,).

    Raises:
        ValueError: if the pattern of A lacks an entry; A is then partly filled.
    """
    rows, places = A.getRowIJ()
    with _stored(A, "", len(places)) as values:
        if not _add_blocks(rows, places, values, start, columns, blocks):
            raise ValueError("a matrix has no place for a block")


@numba.njit(cache=True)
def _add_blocks(rows, places, values, start, columns, blocks):  # type: ignore[no-untyped-def]
    d, c = blocks.shape[1:]
    for r in range(len(start) - 1):
        for i in range(d):
            p, end = rows[d * r + i], rows[d * r + i + 1]
            for e in range(start[r], start[r + 1]):
                while p < end and places[p] < c * columns[e]:
                    p += 1
                if p + c > end or places[p] != c * columns[e]:
                    return False
                for j in range(c):
                    values[p + j] += blocks[e, i, j]
                p += c
    return True


@contextmanager
def _stored(A: PETSc.Mat, access: str, count: int) -> Iterator[Floats]:
    """Values of a matrix on one rank; access is "Read", "Write", or "" for both."""
    if not count:
        yield np.zeros(0)
        return
    matrix, first = ctypes.c_void_p(A.handle), ctypes.POINTER(ctypes.c_double)()
    call(f"MatSeqAIJGetArray{access}", matrix, ctypes.byref(first))
    try:
        yield np.ctypeslib.as_array(first, shape=(count,))
    finally:
        call(f"MatSeqAIJRestoreArray{access}", matrix, ctypes.byref(first))


class Layout(Protocol):
    """Distribution of nodes over ranks, as dolfinx's IndexMap."""

    @property
    def size_local(self) -> int:
        """Number of owned nodes."""

    @property
    def size_global(self) -> int:
        """Number of all nodes."""


class Triplets:
    """Sums of triplets at the entries of a square matrix; collective.

    Args:
        layout: of rows and columns.
        d: rows and columns per node.
        rows: (t,) global, of any rank.
        columns: (t,) global.

    Attributes:
        rows: (e,) owned local rows of the entries, ascending.
        columns: (e,) global, ascending within a row.
    """

    rows: Ints
    columns: Longs

    def __init__(
        self,
        comm: MPI.Intracomm,
        layout: Layout,
        rows: npt.ArrayLike,
        columns: npt.ArrayLike,
        *,
        d: int = 1,
    ) -> None:
        i, j = (np.array(v, dtype=PETSc.IntType).ravel() for v in (rows, columns))  # PETSc sorts
        assert i.size == j.size
        for indices in (i, j):  # PETSc would write past the end
            inside = (indices >= 0) & (indices < d * layout.size_global)
            assert inside.all()
        self._sums = PETSc.Mat().create(comm)
        self._sums.setSizes([(d * layout.size_local, d * layout.size_global)] * 2)
        self._sums.setType(PETSc.Mat.Type.AIJ)
        pointers = (ctypes.c_void_p(v.ctypes.data) for v in (i, j))
        count = ctypes.c_ssize_t(i.size)
        call("MatSetPreallocationCOO", ctypes.c_void_p(self._sums.handle), count, *pointers)
        self.sum(np.zeros(i.size))
        self._start, found, _ = csr_of(self._sums)
        own = np.arange(d * layout.size_local, dtype=np.int32)
        self.rows, self.columns = np.repeat(own, np.diff(self._start)), found.astype(np.int64)

    def fill(self, values: npt.ArrayLike) -> PETSc.Mat:
        """Matrix of the sums of values (t,), the same object in every call; collective."""
        v = np.ascontiguousarray(values, dtype=PETSc.ScalarType).ravel()
        pointer, mode = ctypes.c_void_p(v.ctypes.data), ctypes.c_int(PETSc.InsertMode.INSERT_VALUES)
        call("MatSetValuesCOO", ctypes.c_void_p(self._sums.handle), pointer, mode)
        return self._sums

    def zero(self) -> PETSc.Mat:
        """Matrix with arbitrary values."""
        return self._sums

    def sum(self, values: npt.ArrayLike) -> Floats:
        """Sums (e,) of the values (t,); collective."""
        return csr_of(self.fill(values))[2]

    def matrix(self, values: Floats) -> PETSc.Mat:
        """New matrix with the values (e,); collective."""
        csr = self._start, self.columns.astype(PETSc.IntType), values
        return PETSc.Mat().createAIJ(self._sums.getSizes(), csr=csr, comm=self._sums.comm)


class BlockMatrix:
    """Matrix of d x d blocks (p,) at owned local rows and global columns (p,); collective.

    Repeated blocks are added.
    """

    def __init__(
        self,
        comm: MPI.Intracomm,
        layout: Layout,
        d: int,
        rows: npt.ArrayLike,
        columns: npt.ArrayLike,
    ) -> None:
        self._filled: Floats | None = None
        first = comm.exscan(layout.size_local) or 0
        i = d * (np.asarray(rows, dtype=np.int64) + first)[:, None, None] + np.arange(d)[:, None]
        j = d * np.asarray(columns, dtype=np.int64)[:, None, None] + np.arange(d)
        self._sums = Triplets(comm, layout, *np.broadcast_arrays(i, j), d=d)
        self.matrix = self._sums.zero()

    def of(self, blocks: Floats) -> PETSc.Mat:
        """Matrix of the blocks (p, d, d), refilled if they are another array; collective.

        Do not change the array in place.
        """
        if self._filled is not blocks:
            self.fill(blocks)
        return self.matrix

    def fill(self, blocks: Floats) -> None:
        """Set the matrix to the blocks (p, d, d); collective."""
        self._filled = blocks
        self._sums.fill(blocks)


@dataclass(frozen=True, eq=False)
class Blocks:
    """Dense matrices (p,) between a row nodes and b column nodes, with i x h entries per pair."""

    rows: Ints  # (p, a) nodes
    columns: Ints  # (p, b) nodes
    values: Floats  # (p, a, i, b, h)


@numba.njit(cache=True)
def _add(start, columns, rows, others, values, total):  # type: ignore[no-untyped-def]
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
    """Sums of blocks at the entries of a pattern (m, n) of this rank's nodes.

    Global rows (block rows * m,), columns (block columns * n,), and those of the entries (e,), may
    be of other ranks.
    """

    rows: Longs
    columns: Longs

    def __init__(
        self, pattern: scipy.sparse.csr_array, block: tuple[int, int], rows: Longs, columns: Longs
    ) -> None:
        pattern = scipy.sparse.csr_array(pattern).sorted_indices()
        self._start, self._nodes = pattern.indptr, pattern.indices
        self._shape = len(self._nodes), *block
        node = np.repeat(np.arange(pattern.shape[0]), np.diff(self._start))
        i = block[0] * node[:, None, None] + np.arange(block[0])[:, None]
        j = block[1] * self._nodes[:, None, None] + np.arange(block[1])
        found = (np.broadcast_to(v, self._shape).ravel() for v in (rows[i], columns[j]))
        self.rows, self.columns = found

    def sum(self, parts: Sequence[Blocks]) -> Floats:
        """Sums (e,) of parts within the pattern."""
        total = np.zeros(self._shape)
        for part in parts:
            at = part.rows, part.columns, part.values
            _add(self._start, self._nodes, *(np.ascontiguousarray(v) for v in at), total)
        return total.ravel()


class Sum:
    """Sum of matrices on the union of their first patterns; collective."""

    def __init__(self) -> None:
        self._total: PETSc.Mat | None = None

    def fill(self, parts: Sequence[PETSc.Mat]) -> PETSc.Mat:
        """The sum, always the same matrix."""
        if self._total is None:
            self._total = parts[0].duplicate(copy=True)
            for part in parts[1:]:
                self._total.axpy(1.0, part, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
            self._total.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
            return self._total
        self._total.zeroEntries()
        for part in parts:
            self._total.axpy(1.0, part, PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
        return self._total


class SumWithProducts:
    """A + sum_i B_i N_i over all ranks, on a fixed pattern; collective."""

    def __init__(
        self,
        comm: MPI.Intracomm,
        layout: Layout,
        A: BlockEntries,
        *products: tuple[BlockEntries, PETSc.Mat],
    ) -> None:
        self._entries, self._A = A, Triplets(comm, layout, A.rows, A.columns)
        self._products = list[tuple[SumWithProducts, PETSc.Mat]]()
        for B, N in products:
            factor = SumWithProducts(comm, layout, B)
            self._products.append((factor, factor.zero().matMult(N)))
        self._sum = Sum()
        self._total = self._sum.fill([self._A.zero(), *(BN for _, BN in self._products)])

    def zero(self) -> PETSc.Mat:
        """Matrix with arbitrary values."""
        return self._total

    def fill(self, A: Sequence[Blocks], *products: tuple[Sequence[Blocks], PETSc.Mat]) -> PETSc.Mat:
        """The sum, the same object in every call; collective."""
        parts = [self._A.fill(self._entries.sum(A))]
        for (factor, product), (B, N) in zip(self._products, products, strict=True):
            parts.append(factor.fill(B).matMult(N, result=product))
        return self._sum.fill(parts)

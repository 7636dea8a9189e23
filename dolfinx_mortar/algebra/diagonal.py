# SPDX-License-Identifier: MIT
"""What C adds to the diagonal of (I + C)^T K (I + C), for C with few rows."""

from __future__ import annotations

from petsc4py import PETSc

import numba
import numpy as np
from scipy.sparse import csr_array

from dolfinx_mortar.algebra.csr import csr_of, owned_rows, set_csr
from dolfinx_mortar.algebra.half import UpperHalf
from dolfinx_mortar.algebra.parallel import any_rank
from dolfinx_mortar.arrays import Ints


class RowsOf:
    """Rows of K where C has some, refilled where they serve another C; and K for products.

    Changes of basis have the same rows while the same nodes face each other.
    """

    def __init__(self, K: PETSc.Mat) -> None:
        self.K = K
        self._state = -1
        self._rows: Ints = np.empty(0, dtype=np.int32)
        self._kept: PETSc.Mat | None = None
        self._half: UpperHalf | None = None  # of K
        self._half_state = -1  # of K when it was copied
        self._set_up, self._resting = False, True  # whether levels were made; whether K serves

    @property
    def factor(self) -> PETSc.Mat | UpperHalf:
        """K for products: of blocks a copy of the upper half, which is read faster.

        In space, where an iteration of multigrid forms eight; its sums have other last digits. The
        copy is made again when K has other values.
        """
        K, state = self.K, int(self.K.stateGet())
        if "baij" not in K.getType() or K.getBlockSize() < 3 or self._resting:
            return K
        if self._half is None:
            self._half = UpperHalf(K)
        elif self._half_state != state:
            self._half.update()
        self._half_state = state
        return self._half

    def release_half(self) -> None:
        """Free the copy of K until the next QP: a set-up, which begins, needs the memory."""
        self._set_up = self._resting = True
        if self._half is not None:
            self._half.destroy()
            self._half = None

    def forget(self) -> None:
        """Be as new: products before the next set-up read K again, whose sums differ in digits."""
        self.release_half()
        self._set_up, self._state, self._kept = False, -1, None

    def use_half(self) -> None:
        """Let products use the copy, but not before the first set-up: it would leave a gap."""
        self._resting = not self._set_up

    def including(self, rows: Ints) -> tuple[Ints, PETSc.Mat]:
        """Return owned rows, among them these, and K on them in AIJ; collective."""
        state, comm = int(self.K.stateGet()), self.K.comm.tompi4py()
        lacks, old = any_rank(comm, not np.isin(rows, self._rows).all(), state != self._state)
        if self._kept is None or lacks:
            self._rows, self._kept = rows, rows_of(self.K, rows)
        elif old:
            self._kept = rows_of(self.K, self._rows, self._kept)
        self._state = state
        return self._rows, self._kept

    def diagonal_change(self, C: PETSc.Mat) -> PETSc.Vec:
        """Return the diagonal of K C + (K C)^T + C^T K C; collective.

        Its entry j is sum_r C_rj (2 K_rj + sum_m K_rm C_mj), over the rows r and m of C that are
        not zero. K C itself would take seven times as long (multigrid, 48 thousand unknowns).
        """
        entries = owned_rows(C)
        entries.eliminate_zeros()  # half of those of T
        rows = np.flatnonzero(np.diff(entries.indptr)).astype(np.int32)
        rows, K_r = self.including(rows)
        start, columns, values = csr_of(K_r)
        places, others = _others(C, entries, columns)
        own = np.append(entries.indptr[rows], entries.nnz), entries.indices, entries.data
        more = others.indptr, others.indices, others.data
        terms = _terms((start, columns, values, places), own, more)
        change = self.K.createVecRight()
        add = PETSc.InsertMode.ADD_VALUES
        change.setValues(entries.indices.astype(PETSc.IntType), terms, add)
        change.assemble()
        return change


def _others(C: PETSc.Mat, own: csr_array, numbers: Ints) -> tuple[Ints, csr_array]:
    """Return rows of C, of any rank, and which of them have these global numbers; collective."""
    if C.comm.size == 1:
        return numbers, own
    asked, places = np.unique(numbers, return_inverse=True)
    rows = PETSc.IS().createGeneral(asked.astype(PETSc.IntType), comm=PETSc.COMM_SELF)
    every = PETSc.IS().createStride(C.getSize()[1], step=1, comm=PETSc.COMM_SELF)
    (found,) = C.createSubMatrices(rows, every)
    return places.astype(numbers.dtype), owned_rows(found)


@numba.njit(cache=True)
def _terms(K, C, others):  # type: ignore[no-untyped-def]
    """Return C_rj (2 K_rj + sum_m K_rm C_mj) (e,) at the entries of C.

    Columns ascend in each row of all matrices.

    Args:
        K: starts, columns and values of rows r, and the row of `others` of each column.
        C: starts, columns and values of these rows r.
        others: starts, columns and values of rows m.
    """
    start, columns, values, places = K
    first, j, c = C
    first_m, j_m, c_m = others
    terms = np.zeros(len(c))
    for r in range(len(first) - 1):
        low, high = first[r], first[r + 1]
        a = low
        for p in range(start[r], start[r + 1]):
            while a < high and j[a] < columns[p]:
                a += 1
            if a < high and j[a] == columns[p]:
                terms[a] += 2.0 * values[p]
            m, q = places[p], low
            for b in range(first_m[m], first_m[m + 1]):
                while q < high and j[q] < j_m[b]:
                    q += 1
                if q < high and j[q] == j_m[b]:
                    terms[q] += values[p] * c_m[b]
        for q in range(low, high):
            terms[q] *= c[q]
    return terms


def rows_of(K: PETSc.Mat, rows: Ints, result: PETSc.Mat | None = None) -> PETSc.Mat:
    """Return owned rows of K in AIJ, in a matrix of the same rows if one is given; collective."""
    first = K.getOwnershipRange()[0]
    if K.getType() == "seqaij":  # blocks give blocks only
        index = PETSc.IS().createGeneral(rows.astype(PETSc.IntType), comm=K.comm)
        every = PETSc.IS().createStride(K.getSize()[1], step=1, comm=K.comm)
        return K.createSubMatrix(index, every, result)
    found = [K.getRow(int(first + row)) for row in rows]
    indptr = np.cumsum([0, *(len(columns) for columns, _ in found)], dtype=PETSc.IntType)
    columns = np.concatenate([np.zeros(0, PETSc.IntType), *(columns for columns, _ in found)])
    values = np.concatenate([np.zeros(0), *(values for _, values in found)])
    if result is not None:
        set_csr(result, indptr, columns, values)
        return result
    sizes = (len(rows), PETSc.DECIDE), K.getSizes()[1]
    return PETSc.Mat().createAIJ(sizes, csr=(indptr, columns, values), comm=K.comm)

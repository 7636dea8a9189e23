# SPDX-License-Identifier: MIT
"""(I + C)^T K (I + C) for C with few rows: as a matrix, and as an operator without a matrix."""

from __future__ import annotations

import ctypes
import logging
import weakref
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from typing import Any

from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.csr import call, csr_of
from dolfinx_mortar.algebra.parallel import free_unused, values_at
from dolfinx_mortar.arrays import Floats, Ints

log = logging.getLogger(__name__)
_INT = np.ctypeslib.as_ctypes_type(PETSc.IntType)


def as_aij(K: PETSc.Mat) -> PETSc.Mat:
    """Return K if its format is AIJ, else a copy, for methods that take no blocks; collective."""
    if "baij" not in K.getType():
        return K
    if K.comm.rank == 0:
        log.debug("a matrix of order %d is copied from blocks to AIJ", K.getSize()[0])
    return K.convert("aij", out=PETSc.Mat())


class Congruence:
    """(I + C)^T K (I + C) = K + K C + (K C)^T + C^T K C of a symmetric K, on a fixed pattern.

    C has few rows, so that all terms but K are small. PETSc's product of three matrices takes three
    to five times as long and more memory (measured at 39k unknowns in 3D, 1 and 2 ranks).
    """

    def __init__(self, K: PETSc.Mat, C: PETSc.Mat) -> None:
        """Analyse the patterns; collective."""
        K, other = as_aij(K), PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN
        self.Ct = C.transpose(PETSc.Mat())
        self.KC = K.matMult(C)
        self.CtKC = self.Ct.matMult(self.KC)
        self.product = self.KC.duplicate(copy=True)
        for part in (self.KC.transpose(PETSc.Mat()), self.CtKC, K):  # K last: one copy
            self.product.axpy(1.0, part, other)

    def update(self, K: PETSc.Mat, C: PETSc.Mat) -> None:
        """Refill the product from new values on the same patterns; collective."""
        K = as_aij(K)
        C.transpose(self.Ct)
        K.matMult(C, result=self.KC)
        KCt = self.KC.transpose(PETSc.Mat())
        self.Ct.matMult(self.KC, result=self.CtKC)
        refill(self.product, (self.KC, KCt, self.CtKC, K))  # as in __init__: the same round-off
        KCt.destroy()


class ProductOfBases:
    """(I + C)^T A (I + D) of any A, for C and D with few rows, on a fixed pattern.

    Args:
        A: in the format AIJ.
        C: change of the basis of test functions.
        D: that of trial functions.

    Attributes:
        product: the matrix.
    """

    def __init__(self, A: PETSc.Mat, C: PETSc.Mat, D: PETSc.Mat) -> None:
        """Analyse the patterns; the values come with `update`; collective."""
        self._Ct, self._AD = C.transpose(PETSc.Mat()), A.matMult(D)
        self._right = union(self._AD, [A])
        self._CtR = self._Ct.matMult(self._right)
        self.product = union(self._CtR, [self._right])
        self.product.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)

    def update(self, A: PETSc.Mat, C: PETSc.Mat, D: PETSc.Mat) -> None:
        """Refill the product from new values on the same patterns; collective."""
        C.transpose(self._Ct)
        A.matMult(D, result=self._AD)
        refill(self._right, [self._AD, A])
        self._Ct.matMult(self._right, result=self._CtR)
        refill(self.product, [self._CtR, self._right])


class ContextOf:
    """Context of a PETSc Mat of type python whose owner does what PETSc calls.

    PETSc keeps contexts where Python cannot see that: Mat and owner would keep each other for ever.
    """

    def __init__(self, owner: object) -> None:
        self._owner = weakref.ref(owner)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._owner(), name)


class _Decoupled(ABC):
    """An operator without a matrix, decoupled at some unknowns.

    Attributes:
        matrix: a PETSc Mat of type python.
        decoupled: owned unknowns that are decoupled.
        diagonal: (n,) before decoupling; may be near to the operator's own.
        scale: the entry at decoupled unknowns, the mean of the diagonal.
    """

    def __init__(self, like: PETSc.Mat) -> None:
        self.decoupled: Ints = np.empty(0, dtype=np.int32)
        self.diagonal, self.scale = like.createVecRight(), 1.0
        self._x = like.createVecRight()
        self.matrix = PETSc.Mat().createPython(like.getSizes(), ContextOf(self), comm=like.comm)
        self.matrix.setUp()

    @abstractmethod
    def product(self, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Set y to the product with x, nothing decoupled; collective."""

    def changed(self) -> None:
        """Tell PETSc so; read the mean of the diagonal; collective."""
        self.scale = self.diagonal.sum() / self.diagonal.getSize()
        self.matrix.stateIncrease()

    # -- called by PETSc -------------------------------------------------------------------------

    def mult(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Set y to the product with x."""
        x.copy(self._x)
        self._x.array[self.decoupled] = 0.0
        self.product(self._x, y)
        y.array[self.decoupled] = self.scale * x.array_r[self.decoupled]

    def getDiagonal(self, mat: PETSc.Mat, d: PETSc.Vec) -> None:
        """Set d to the diagonal."""
        self.diagonal.copy(d)
        d.array[self.decoupled] = self.scale


class OperatorOfBases(_Decoupled):
    """(I + C)^T A (I + D) for a sum A and products of such factors, decoupled at some unknowns.

    The same as `ProductOfBases`, without a matrix.
    """

    def __init__(self, like: PETSc.Mat) -> None:
        super().__init__(like)
        self._parts: Sequence[PETSc.Mat] = []
        self._bases: Sequence[tuple[PETSc.Mat, PETSc.Mat]] = []
        self._u, self._change = like.createVecRight(), like.createVecRight()

    def follow(
        self,
        parts: Sequence[PETSc.Mat],
        bases: Sequence[tuple[PETSc.Mat, PETSc.Mat]],
        decoupled: Ints,
        diagonal: PETSc.Vec,
    ) -> None:
        """Set the terms of A, the pairs of factors C and D, the decoupled owned unknowns.

        Args:
            parts: terms of A.
            bases: C and D, from left to right.
            decoupled: their rows and columns are those of the identity times the mean diagonal.
            diagonal: (n,) approximate diagonal.
        """
        self._parts, self._bases, self.decoupled = parts, bases, decoupled
        diagonal.copy(self.diagonal)
        self.changed()

    def product(self, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Set y to the product with x, nothing decoupled; collective."""
        x.copy(self._u)
        for _, D in reversed(self._bases):
            D.mult(self._u, self._change)
            self._u.axpy(1.0, self._change)
        y.set(0.0)
        for part in self._parts:
            part.multAdd(self._u, y, y)
        for C, _ in self._bases:
            C.multTranspose(y, self._change)
            y.axpy(1.0, self._change)


def union(A: PETSc.Mat, others: Iterable[PETSc.Mat]) -> PETSc.Mat:
    """Return a new matrix on the union of the patterns; collective."""
    total = A.duplicate(copy=True)
    for other in others:
        total.axpy(1.0, other, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    return total


def refill(total: PETSc.Mat, parts: Iterable[PETSc.Mat]) -> None:
    """Set a matrix to the sum of others, the patterns of which it contains; collective."""
    total.zeroEntries()
    for part in parts:
        total.axpy(1.0, part, PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)


def decouple(matrix: PETSc.Mat, rows: Ints, scale: float) -> None:
    """Replace owned rows and their columns by those of the identity times a scale; collective."""
    numbers = (rows + matrix.getOwnershipRange()[0]).astype(PETSc.IntType)
    matrix.zeroRowsColumns(numbers, diag=scale)


class Halved:
    """K for products: of blocks a copy of the upper half, which is read faster.

    In space, where an iteration of multigrid forms eight; its sums have other last digits.
    """

    def __init__(self, K: PETSc.Mat) -> None:
        self.K = K
        self._half: UpperHalf | None = None
        self._state = -1  # of K when it was copied
        self._set_up, self._resting = False, True  # whether levels were made; whether K serves

    @property
    def factor(self) -> PETSc.Mat | UpperHalf:
        """K, or the copy, which is made again when K has other values."""
        K, state = self.K, int(self.K.stateGet())
        if "baij" not in K.getType() or K.getBlockSize() < 3 or self._resting:
            return K
        if self._half is None:
            self._half = UpperHalf(K)
        elif self._state != state:
            self._half.update()
        self._state = state
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
        self._set_up = False

    def use_half(self) -> None:
        """Let products use the copy, but not before the first set-up: it would leave a gap."""
        self._resting = not self._set_up


class UpperHalf:
    """A copy of the upper half of the columns that a rank owns; other columns are read in K.

    A product of 53 thousand unknowns of hexahedra takes 3.3 instead of 6.3 ms (copy 3.7), on two
    ranks 1.9 instead of 3.0 on each (copy 2.3). PETSc's format of halves on several ranks takes 2.1
    (copy 20) and sends in both directions.

    Args:
        K: symmetric matrix in BAIJ, whose pattern stays as it is.
    """

    def __init__(self, K: PETSc.Mat) -> None:
        """Copy the values; collective."""
        self._K, self._half = K, PETSc.Mat()
        self._far = _FarColumns(K) if K.comm.size > 1 else None
        self.update()

    def update(self) -> None:
        """Copy the present values."""
        own = self._K.getDiagonalBlock()
        own.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self._half = own.convert("sbaij", out=self._half)

    def mult(self, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Set y to the product with x; collective."""
        if self._far is None:
            self._half.mult(x, y)
        else:
            self._far.mult(self._half, x, y)

    def destroy(self) -> None:
        """Free the copy; collective."""
        self._half.destroy()


class _FarColumns:
    """The columns of K that other ranks own, and what they send for a product."""

    def __init__(self, K: PETSc.Mat) -> None:
        self._K = K  # the matrix of far columns is its own
        self._matrix, count, ghosts = ctypes.c_void_p(), _INT(), ctypes.POINTER(_INT)()
        handle = ctypes.c_void_p(K.handle)
        call("MatMPIBAIJGetSeqBAIJ", handle, None, ctypes.byref(self._matrix), None)
        call("MatGetGhosts", handle, ctypes.byref(count), ctypes.byref(ghosts))
        blocks, size = np.array(ghosts[: count.value], PETSc.IntType), K.getBlockSize()
        x, own = K.createVecRight(), PETSc.COMM_SELF
        self._x, self._y = x.createLocalVector(), x.createLocalVector()
        self._values = PETSc.Vec().createSeq(size * len(blocks), bsize=size, comm=own)
        index = PETSc.IS().createBlock(size, blocks, comm=own)
        self._scatter = PETSc.Scatter().create(x, index, self._values, None)

    def mult(self, half: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Set y to the product of own and far columns with x."""
        self._scatter.begin(x, self._values)
        x.getLocalVector(self._x, readonly=True)
        y.getLocalVector(self._y)
        half.mult(self._x, self._y)
        self._scatter.end(x, self._values)
        total = ctypes.c_void_p(self._y.handle)
        call("MatMultAdd", self._matrix, ctypes.c_void_p(self._values.handle), total, total)
        x.restoreLocalVector(self._x, readonly=True)
        y.restoreLocalVector(self._y)


class CongruentOperator(_Decoupled):
    """(I + C)^T K (I + C), decoupled at some unknowns, for changing K, C and unknowns.

    With contact in 3D the matrix would have 2.3 times the entries of K, and no equal patterns of
    the rows of a node, which make products fast: one takes 5 times as long as with K (22 thousand
    unknowns), that with C a tenth of it. A copy of `matrix` is an explicit matrix.

    Attributes:
        K: the matrix in the middle, and
        half: the same for products.
        C: the present C; None for 0.
    """

    def __init__(self, K: PETSc.Mat, half: Halved | None = None) -> None:
        super().__init__(K)
        self.K, self.half = K, half or Halved(K)
        self.C: PETSc.Mat | None = None
        self._of_K, self._state = K.createVecRight(), -1  # diagonal of K, and K's state then
        self._moved = K.createVecRight()

    def follow(self, C: PETSc.Mat | None, decoupled: Ints) -> None:
        """Set C (None for 0) and the decoupled owned unknowns; read the values of K; collective.

        The diagonal is that of a K without entries off its own.
        """
        self.C, self.decoupled = C, decoupled
        self.half.use_half()
        if self._state != int(self.K.stateGet()):
            self.K.getDiagonal(self._of_K)
            self._state = int(self.K.stateGet())
        self._of_K.copy(self.diagonal)
        if C is not None:
            self._add_change(C)
        self.changed()

    def _add_change(self, C: PETSc.Mat) -> None:
        """Add the change of the diagonal by C, sum_r C_rj (C_rj + 2 delta_rj) K_rr; collective."""
        start, columns, values = csr_of(C)
        rows, first = np.repeat(np.arange(len(start) - 1), np.diff(start)), C.getOwnershipRange()[0]
        terms = values * (values + 2.0 * (columns == rows + first)) * self._of_K.array_r[rows]
        self.diagonal.setValues(columns, terms, PETSc.InsertMode.ADD_VALUES)
        self.diagonal.assemble()

    def product(self, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Set y to the product with x, nothing decoupled; collective."""
        if self.C is None:
            self.half.factor.mult(x, y)
            return
        self.C.multAdd(x, x, self._moved)
        self.half.factor.mult(self._moved, y)
        self.C.multTranspose(y, self._moved)
        y.axpy(1.0, self._moved)

    def split(self, parts: Ints) -> tuple[PETSc.Mat, PETSc.Mat | None]:
        """Return the explicit matrix in two, B within the parts and X between them; collective.

        Args:
            parts: (n,) number of the part of each owned unknown; K has no entries between parts.

        Returns:
            B, and X with rows near C only; None for C = 0.
        """
        self.half.release_half()
        within, between = self.K.convert("aij", out=PETSc.Mat()), None
        if self.C is not None:
            change, coupled = _change(within, self.C), np.ones(len(parts))
            free_unused(self.K.comm.tompi4py())
            coupled[self.decoupled] = -1.0
            inside, between = _split(change, coupled * (parts + 1.0))
            within.axpy(1.0, inside, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        decouple(within, self.decoupled, self.scale)
        return within, between

    # -- called by PETSc -------------------------------------------------------------------------

    def multTranspose(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Set y to the product with x: K is symmetric."""
        self.mult(mat, x, y)

    def duplicate(self, mat: PETSc.Mat, op: int) -> PETSc.Mat:
        """Return the explicit matrix."""
        self.half.release_half()
        if self.C is not None:
            explicit = Congruence(self.K, self.C).product
        else:
            explicit = self.K.convert("aij", out=PETSc.Mat())
        decouple(explicit, self.decoupled, self.scale)
        return explicit


def _change(K: PETSc.Mat, C: PETSc.Mat) -> PETSc.Mat:
    """Return K C + (K C)^T + C^T K C; collective."""
    other = PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN
    KC = K.matMult(C)
    change = C.transpose(PETSc.Mat()).matMult(KC)
    for part in (KC, KC.transpose(PETSc.Mat())):
        change.axpy(1.0, part, other)
    return change


def _split(matrix: PETSc.Mat, marks: Floats) -> tuple[PETSc.Mat, PETSc.Mat]:
    """Return the entries within parts, and those between them and not decoupled; collective.

    Args:
        matrix: (n, n) with few entries.
        marks: (n,) number of the part of each owned unknown, from 1; negative where decoupled.
    """
    indptr, columns, values = csr_of(matrix)
    rows = np.repeat(np.arange(len(indptr) - 1), np.diff(indptr))
    there, place = np.unique(columns, return_inverse=True)
    of_columns = values_at(matrix.comm, marks[:, None], there)[place, 0]
    within = np.abs(of_columns) == np.abs(marks[rows])
    between = ~within & (of_columns > 0.0) & (marks[rows] > 0.0)
    inside, outside = (
        _select(matrix, rows[on], columns[on], values[on]) for on in (within, between)
    )
    return inside, outside


def _select(like: PETSc.Mat, rows: Ints, columns: Ints, values: Floats) -> PETSc.Mat:
    """Return a matrix of entries in owned rows, which ascend, and global columns; collective."""
    counts = np.bincount(rows, minlength=like.getLocalSize()[0])
    indptr = np.concatenate([[0], np.cumsum(counts)]).astype(PETSc.IntType)
    csr = indptr, columns.astype(PETSc.IntType), values
    return PETSc.Mat().createAIJ(like.getSizes(), csr=csr, comm=like.comm)

# SPDX-License-Identifier: MIT
"""(I + C)^T K (I + C) for C with few rows: as a matrix, and as an operator without a matrix."""

from __future__ import annotations

import logging
import weakref
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from typing import Any

from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.csr import csr_of
from dolfinx_mortar.arrays import Ints

log = logging.getLogger(__name__)


def as_aij(K: PETSc.Mat) -> PETSc.Mat:
    """K in the format AIJ, copied if it has blocks; collective."""
    if "baij" not in K.getType():
        return K
    if K.comm.rank == 0:
        log.debug("a matrix of order %d is copied from blocks to AIJ", K.getSize()[0])
    return K.convert("aij", out=PETSc.Mat())


class Congruence:
    """(I + C)^T K (I + C) = K + K C + (K C)^T + C^T K C of a symmetric K, on a fixed pattern."""

    def __init__(self, K: PETSc.Mat, C: PETSc.Mat) -> None:
        K, other = as_aij(K), PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN
        self.Ct = C.transpose(PETSc.Mat())
        self.KC = K.matMult(C)
        self.CtKC = self.Ct.matMult(self.KC)
        self.product = self.KC.duplicate(copy=True)
        for part in (self.KC.transpose(PETSc.Mat()), self.CtKC, K):  # K last: one copy
            self.product.axpy(1.0, part, other)

    def update(self, K: PETSc.Mat, C: PETSc.Mat) -> None:
        """Recompute on the same patterns; collective."""
        K = as_aij(K)
        C.transpose(self.Ct)
        K.matMult(C, result=self.KC)
        KCt = self.KC.transpose(PETSc.Mat())
        self.Ct.matMult(self.KC, result=self.CtKC)
        refill(self.product, (self.KC, KCt, self.CtKC, K))  # order of __init__: same round-off
        KCt.destroy()


class ProductOfBases:
    """(I + C)^T A (I + D) in AIJ, for C and D with few rows, on a fixed pattern; collective.

    `update` computes the values.
    """

    def __init__(self, A: PETSc.Mat, C: PETSc.Mat, D: PETSc.Mat) -> None:
        self._Ct, self._AD = C.transpose(PETSc.Mat()), A.matMult(D)
        self._right = union(self._AD, [A])
        self._CtR = self._Ct.matMult(self._right)
        self.product = union(self._CtR, [self._right])
        self.product.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)

    def update(self, A: PETSc.Mat, C: PETSc.Mat, D: PETSc.Mat) -> None:
        """Compute on the fixed patterns; collective."""
        C.transpose(self._Ct)
        A.matMult(D, result=self._AD)
        refill(self._right, [self._AD, A])
        self._Ct.matMult(self._right, result=self._CtR)
        refill(self.product, [self._CtR, self._right])


class ContextOf:
    """Context of a PETSc Mat of type python with a weak reference to its owner.

    PETSc's own reference would never be freed.
    """

    def __init__(self, owner: object) -> None:
        self._owner = weakref.ref(owner)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._owner(), name)


class _Decoupled(ABC):
    """An operator without a matrix, decoupled at some unknowns.

    `scale` is the diagonal entry at decoupled unknowns, the mean of the `diagonal` (n,), which may
    be approximate.
    """

    def __init__(self, like: PETSc.Mat) -> None:
        self.decoupled: Ints = np.empty(0, dtype=np.int32)
        self.diagonal, self.scale = like.createVecRight(), 1.0
        self._x = like.createVecRight()
        self.matrix = PETSc.Mat().createPython(like.getSizes(), ContextOf(self), comm=like.comm)
        self.matrix.setUp()

    @abstractmethod
    def product(self, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Set y, without decoupling; collective."""

    def changed(self) -> None:
        """Update PETSc's state and the scale; collective."""
        self.scale = self.diagonal.sum() / self.diagonal.getSize()
        self.matrix.stateIncrease()

    # called by PETSc

    def mult(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        x.copy(self._x)
        self._x.array[self.decoupled] = 0.0
        self.product(self._x, y)
        y.array[self.decoupled] = self.scale * x.array_r[self.decoupled]

    def getDiagonal(self, mat: PETSc.Mat, d: PETSc.Vec) -> None:
        self.diagonal.copy(d)
        d.array[self.decoupled] = self.scale


class OperatorOfBases(_Decoupled):
    """`ProductOfBases` without a matrix, for a sum A and nested factors."""

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
        """Set the terms of A, factors C and D from left to right, and the diagonal; collective."""
        self._parts, self._bases, self.decoupled = parts, bases, decoupled
        diagonal.copy(self.diagonal)
        self.changed()

    def product(self, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Set y, without decoupling; collective."""
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
    """Sum of matrices on the union of their patterns; collective."""
    total = A.duplicate(copy=True)
    for other in others:
        total.axpy(1.0, other, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    return total


def refill(total: PETSc.Mat, parts: Iterable[PETSc.Mat]) -> None:
    """Sum of matrices, on parts of the pattern of `total`; collective."""
    total.zeroEntries()
    for part in parts:
        total.axpy(1.0, part, PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)


def decouple(matrix: PETSc.Mat, rows: Ints, scale: float) -> None:
    """Replace owned rows and their columns by those of the identity times a scale; collective."""
    numbers = (rows + matrix.getOwnershipRange()[0]).astype(PETSc.IntType)
    matrix.zeroRowsColumns(numbers, diag=scale)


class Halved:
    """K for products: in space the upper half of its blocks, which is read faster."""

    def __init__(self, K: PETSc.Mat) -> None:
        self.K, self._half = K, PETSc.Mat()
        self._state = -1  # of the copied K

    @property
    def factor(self) -> PETSc.Mat:
        """K, or its half with the present values; collective."""
        K = self.K
        if "baij" not in K.getType() or K.getBlockSize() < 3:
            return K
        if self._state != int(K.stateGet()):
            K.setOption(PETSc.Mat.Option.SYMMETRIC, True)
            self._half = K.convert("sbaij", out=self._half)
            self._state = int(K.stateGet())
        return self._half


class CongruentOperator(_Decoupled):
    """(I + C)^T K (I + C), decoupled at some unknowns, for changing K, C and unknowns.

    In 3D five times as fast as the matrix; `half` is K for products.
    """

    def __init__(self, K: PETSc.Mat, half: Halved | None = None) -> None:
        super().__init__(K)
        self.K, self.half = K, half or Halved(K)
        self.C: PETSc.Mat | None = None
        self._of_K, self._state = K.createVecRight(), -1  # diagonal of K, and the state of that K
        self._moved = K.createVecRight()

    def follow(self, C: PETSc.Mat | None, decoupled: Ints) -> None:
        """Set C (None for 0) and the decoupled owned unknowns, read the values of K; collective.

        The diagonal is that of the product with diag(K).
        """
        self.C, self.decoupled = C, decoupled
        if self._state != int(self.K.stateGet()):
            self.K.getDiagonal(self._of_K)
            self._state = int(self.K.stateGet())
        self._of_K.copy(self.diagonal)
        if C is not None:
            self._add_change(C)
        self.changed()

    def _add_change(self, C: PETSc.Mat) -> None:
        start, columns, values = csr_of(C)
        rows, first = np.repeat(np.arange(len(start) - 1), np.diff(start)), C.getOwnershipRange()[0]
        terms = values * (values + 2.0 * (columns == rows + first)) * self._of_K.array_r[rows]
        self.diagonal.setValues(columns, terms, PETSc.InsertMode.ADD_VALUES)
        self.diagonal.assemble()

    def product(self, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Set y, without decoupling; collective."""
        if self.C is None:
            self.half.factor.mult(x, y)
            return
        self.C.multAdd(x, x, self._moved)
        self.half.factor.mult(self._moved, y)
        self.C.multTranspose(y, self._moved)
        y.axpy(1.0, self._moved)

    # called by PETSc

    def multTranspose(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Set y: K is symmetric."""
        self.mult(mat, x, y)

    def duplicate(self, mat: PETSc.Mat, op: int) -> PETSc.Mat:
        """Explicit matrix; collective."""
        if self.C is not None:
            explicit = Congruence(self.K, self.C).product
        else:
            explicit = self.K.convert("aij", out=PETSc.Mat())
        decouple(explicit, self.decoupled, self.scale)
        return explicit

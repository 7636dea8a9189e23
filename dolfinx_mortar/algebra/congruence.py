# SPDX-License-Identifier: MIT
"""(I + C)^T K (I + C) for C with few rows: as a matrix, and as an operator without a matrix."""

from __future__ import annotations

import weakref
from collections.abc import Sequence
from typing import Any

from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.csr import Sum, csr_of
from dolfinx_mortar.common.arrays import Ints


def as_aij(K: PETSc.Mat) -> PETSc.Mat:
    """K in the format AIJ, copied if it has blocks; collective."""
    return K.convert("aij", out=PETSc.Mat()) if "baij" in K.getType() else K


class ProductOfBases:
    """(I + C)^T A (I + D) in AIJ, for C and D with few rows, on fixed patterns; collective.

    For a sum A and nested factors.
    """

    def __init__(self) -> None:
        self._sum, self._factors = Sum(), list[_Factor]()

    def fill(
        self, parts: Sequence[PETSc.Mat], bases: Sequence[tuple[PETSc.Mat, PETSc.Mat]]
    ) -> PETSc.Mat:
        """Product, always the same matrix, for terms of A, and C and D from left to right."""
        A = as_aij(parts[0])
        if len(parts) > 1:
            A = self._sum.fill([A, *parts[1:]])
        for k, factors in enumerate(bases):
            if k == len(self._factors):
                self._factors.append(_Factor())
            A = self._factors[k].fill(A, *factors)
        return A


class _Factor:
    def __init__(self) -> None:
        self._Ct, self._right, self._product = PETSc.Mat(), Sum(), Sum()
        self._AD: PETSc.Mat | None = None
        self._CtR: PETSc.Mat | None = None

    def fill(self, A: PETSc.Mat, C: PETSc.Mat, D: PETSc.Mat) -> PETSc.Mat:
        C.transpose(self._Ct)
        self._AD = A.matMult(D, result=self._AD)
        right = self._right.fill([self._AD, A])
        self._CtR = self._Ct.matMult(right, result=self._CtR)
        return self._product.fill([self._CtR, right])


class ContextOf:
    """Context of a PETSc Mat of type python with a weak reference to its owner.

    PETSc's own reference would never be freed.
    """

    def __init__(self, owner: object) -> None:
        self._owner = weakref.ref(owner)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._owner(), name)


class OperatorOfBases:
    """`ProductOfBases` without a matrix, decoupled at some unknowns.

    `scale` is the diagonal entry at decoupled unknowns, the mean of the `diagonal` (n,), which may
    be approximate.
    """

    def __init__(self, like: PETSc.Mat) -> None:
        self.decoupled: Ints = np.empty(0, dtype=np.int32)
        self.diagonal, self.scale = like.createVecRight(), 1.0
        self._parts: Sequence[PETSc.Mat] = []
        self._bases: Sequence[tuple[PETSc.Mat, PETSc.Mat]] = []
        self._x, self._u, self._change = (like.createVecRight() for _ in range(3))
        self.matrix = PETSc.Mat().createPython(like.getSizes(), ContextOf(self), comm=like.comm)
        self.matrix.setUp()

    def follow_bases(
        self,
        parts: Sequence[PETSc.Mat],
        bases: Sequence[tuple[PETSc.Mat, PETSc.Mat]],
        decoupled: Ints,
        diagonal: PETSc.Vec,
    ) -> None:
        """Set the terms of A, factors C and D from left to right, and the diagonal; collective."""
        self._parts, self._bases, self.decoupled = parts, bases, decoupled
        diagonal.copy(self.diagonal)
        self.scale = diagonal.sum() / diagonal.getSize()
        self.matrix.stateIncrease()

    def product(self, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Set y, without decoupling; collective."""
        x.copy(self._u)
        for _, D in reversed(self._bases):
            D.mult(self._u, self._change)
            self._u.axpy(1.0, self._change)
        self._parts[0].mult(self._u, y)
        for part in self._parts[1:]:
            part.multAdd(self._u, y, y)
        for C, _ in self._bases:
            C.multTranspose(y, self._change)
            y.axpy(1.0, self._change)

    # called by PETSc

    def mult(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Set y."""
        x.copy(self._x)
        self._x.array[self.decoupled] = 0.0
        self.product(self._x, y)
        y.array[self.decoupled] = self.scale * x.array_r[self.decoupled]

    def getDiagonal(self, mat: PETSc.Mat, d: PETSc.Vec) -> None:
        """Set d."""
        self.diagonal.copy(d)
        d.array[self.decoupled] = self.scale


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


class CongruentOperator(OperatorOfBases):
    """(I + C)^T K (I + C), decoupled at some unknowns, for changing K, C and unknowns.

    In 3D five times as fast as the matrix; `half` is K for products.
    """

    def __init__(self, K: PETSc.Mat, half: Halved | None = None) -> None:
        super().__init__(K)
        self.K, self.half = K, half or Halved(K)
        self.C: PETSc.Mat | None = None
        self._of_K, self._state = K.createVecRight(), -1  # diagonal of K, and the state of that K

    def follow(self, C: PETSc.Mat | None, decoupled: Ints) -> None:
        """Set C (None for 0) and the decoupled owned unknowns, read the values of K; collective.

        The diagonal is that of the product with diag(K).
        """
        self.C = C
        if self._state != int(self.K.stateGet()):
            self.K.getDiagonal(self._of_K)
            self._state = int(self.K.stateGet())
        diagonal = self._of_K.copy()
        if C is not None:
            start, columns, values = csr_of(C)
            rows = np.repeat(np.arange(len(start) - 1), np.diff(start))
            own = columns == rows + C.getOwnershipRange()[0]
            terms = values * (values + 2.0 * own) * self._of_K.array_r[rows]
            diagonal.setValues(columns, terms, PETSc.InsertMode.ADD_VALUES)
            diagonal.assemble()
        bases = [] if C is None else [(C, C)]
        self.follow_bases([self.half.factor], bases, decoupled, diagonal)

    def duplicate(self, mat: PETSc.Mat, op: int) -> PETSc.Mat:
        """Explicit matrix; collective."""
        if self.C is not None:
            explicit = ProductOfBases().fill([self.K], [(self.C, self.C)])
        else:
            explicit = self.K.convert("aij", out=PETSc.Mat())
        decouple(explicit, self.decoupled, self.scale)
        return explicit

# SPDX-License-Identifier: MIT
"""Products with a symmetric matrix of blocks that read the upper half of its entries."""

from __future__ import annotations

import ctypes

from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.csr import call

_INT = np.ctypeslib.as_ctypes_type(PETSc.IntType)


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

# SPDX-License-Identifier: MIT
"""Multigrid preconditioner in unknowns v that may differ from the unknowns x of the QP.

An unknown at its bound is fixed and drops out of multigrid. At an open contact the unknown of the
QP, the relative motion of the sides, is unsuitable: coarse functions couple the two bodies
(measured in 2D: 75 and 113 iterations on two meshes instead of 17 and 23, in 3D 43 instead of 18).
So multigrid may use a matrix B in other unknowns v,

    x = (I - E) v,      M^-1 = (I - E) B^-1 (I - E)^T on unknowns that are not held now,

where B belongs to an earlier set of held unknowns, geometry and tangent. With GAMG the residuals
and the smoother of the finest level use the present matrix, and only the coarse levels are those of
B: then changes of the set cost few iterations. With other PCs each unknown that has changed
its state since costs about one.
"""

import ctypes
from dataclasses import dataclass
from typing import Protocol

from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.congruence import CongruentOperator
from dolfinx_mortar.algebra.csr import call
from dolfinx_mortar.algebra.parallel import free_unused
from dolfinx_mortar.arrays import HALF_OF_DIGITS, Ints
from dolfinx_mortar.qp.operator import count_negative


@dataclass(frozen=True)
class Change:
    """The unknowns v of multigrid for one set of held unknowns."""

    E: PETSc.Mat | None  # (n, n) x = (I - E) v; None for E = 0
    matrix: PETSc.Mat  # (n, n) of the QP in v, held unknowns decoupled; maybe of type python


class Unknowns(Protocol):
    """Unknowns v for each set of held unknowns of the QP."""

    def change(self, held: Ints) -> Change:
        """Return v for the present geometry; collective."""

    def motions(self, change: Change) -> list[PETSc.Vec]:
        """Return the near null space in these v, zero where they are decoupled; collective."""


class OwnUnknowns:
    """The unknowns v = x, for the matrix A of the QP."""

    def __init__(self, A: PETSc.Mat) -> None:
        self.operator = CongruentOperator(A)

    def change(self, held: Ints) -> Change:
        """Return v = x; collective."""
        self.operator.follow(None, held)
        return Change(None, self.operator.matrix)

    def motions(self, change: Change) -> list[PETSc.Vec]:
        """Return none: that of constants."""
        return []


def orthonormal(vectors: list[PETSc.Vec]) -> list[PETSc.Vec]:
    """Return an orthonormal basis of the vectors, which are overwritten; collective."""
    basis: list[PETSc.Vec] = []
    for vector in vectors:
        whole = vector.norm()
        for _ in range(2):  # twice is enough
            for other in basis:
                vector.axpy(-other.dot(vector), other)
        if vector.norm() > HALF_OF_DIGITS * whole:  # what is left has half of its digits
            vector.normalize()
            basis.append(vector)
    return basis


class Multigrid:
    """Context of a PETSc PC of type python: M^-1 above, with any PC for B^-1.

    The finest level of PETSc's GAMG uses the present matrix. With other PCs, unknowns that were
    held at the set-up and are free now are preconditioned by the mean of the diagonal.

    Args:
        A: (n, n) matrix of the QP.
        prefix: prefix of the options of the PC for B^-1.
    """

    def __init__(self, A: PETSc.Mat, prefix: str) -> None:
        """Create the inner PC; its options are read at every set-up."""
        self.inner = PETSc.PC().create(A.comm)
        self.inner.setOptionsPrefix(prefix)
        self.inner.setFromOptions()
        self.B: PETSc.Mat | None = None
        self.E: PETSc.Mat | None = None
        self.held: Ints = np.empty(0, dtype=np.int32)  # now
        self.negative = 0  # eigenvalues of the coarsest level's matrix
        self._r, self._v = A.createVecRight(), A.createVecRight()

    @property
    def follows(self) -> bool:
        """Tell whether the finest level uses the present matrix."""
        return bool(self.inner.getType() == PETSc.PC.Type.GAMG)

    def clear(self) -> None:
        """Free the matrices of the inner PC."""
        self.inner.reset()
        self.B = self.E = None

    def renew(
        self, change: Change, motions: list[PETSc.Vec], held: Ints, *, definite: bool
    ) -> None:
        """Set up with another matrix; collective.

        Args:
            change: v, with the matrix B of the QP in them.
            motions: near null space, which is overwritten.
            held: unknowns that it holds.
            definite: whether it is.
        """
        self.B, self.E, self.held = change.matrix.copy(), change.E, held
        free_unused(self.B.comm.tompi4py())
        self.B.setOption(PETSc.Mat.Option.SPD, definite)
        basis = orthonormal(motions)
        if basis:
            self.B.setBlockSize(basis[0].getBlockSize())
            self.B.setNearNullSpace(PETSc.NullSpace().create(vectors=basis, comm=self.B.comm))
        self.inner.setFromOptions()
        if self.follows:
            self.inner.setUseAmat(True)
            self.inner.setOperators(change.matrix, self.B)
        else:
            self.inner.setOperators(self.B)
        self.inner.setReusePreconditioner(False)
        self.inner.setFailedReason(PETSc.PC.FailedReason.NOERROR)  # PETSc keeps that of a set-up
        self.inner.setUp()
        self.negative = 0
        if self.follows:
            self._forget_factors()
            self.negative = count_negative(self._coarsest) if definite else 0
            self._release(change.matrix)
        self.inner.setReusePreconditioner(True)  # the finest matrix changes, coarse levels stay

    def _forget_factors(self) -> None:
        """Free what products P^T B P would need to be formed again, B among it; collective."""
        for level in range(self.inner.getMGLevels() - 1):
            product = self.inner.getMGSmoother(level).getOperators()[0]
            call("MatProductClear", ctypes.c_void_p(product.handle))

    @property
    def _coarsest(self) -> PETSc.Mat:
        """The matrix that a factorisation inverts, P^T B P, or B where there is one level."""
        return self.inner.getMGSmoother(0).getOperators()[1]

    @property
    def _needs_diagonal(self) -> bool:
        """Tell whether cycles read no more of B than its diagonal.

        They apply the matrix of the change; only other smoothers than Jacobi, and a single level,
        read more of B.
        """
        levels = self.inner.getMGLevels()
        smoother = self.inner.getMGSmoother(levels - 1)
        return bool(levels > 1 and smoother.getPC().getType() == PETSc.PC.Type.JACOBI)

    def _release(self, finest: PETSc.Mat) -> None:
        """Keep of B what cycles read; collective."""
        if self._needs_diagonal:
            assert self.B is not None, "not set up"
            self.B = PETSc.Mat().createDiagonal(self.B.getDiagonal())
            for user in (self.inner.getMGSmoother(self.inner.getMGLevels() - 1), self.inner):
                user.setOperators(finest, self.B)

    def follow(self, change: Change, held: Ints) -> None:
        """Set the unknowns that are held now, and v; collective.

        The matrix of the change is the object of the set-up with other values.
        """
        assert self.B is not None, "not set up"
        self.E, self.held = change.E, held
        self.B.setDiagonal(change.matrix.getDiagonal())  # all that the smoother reads of B

    def apply(self, pc: PETSc.PC, r: PETSc.Vec, z: PETSc.Vec) -> None:
        """Set z = M^-1 r (called by PETSc)."""
        r.copy(self._r)
        if self.E is not None:
            self.E.multTranspose(r, self._v)
            self._r.axpy(-1.0, self._v)
        self.inner.apply(self._r, self._v)
        self._v.copy(z)
        if self.E is not None:
            self.E.mult(self._v, self._r)
            z.axpy(-1.0, self._r)
        z.array[self.held] = 0.0

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

Aggregates of nodes of two bodies in contact could not slide, as their coarse functions are rigid
motions (graded tetrahedra, 181 thousand unknowns: 17 iterations, 12 without contact, 13 with
aggregates of one body). The entries between bodies come from contact alone. They are left out when
levels are made, and P^T X P of them is added to the matrix of each level.
"""

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Protocol

from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.congruence import CongruentOperator
from dolfinx_mortar.algebra.csr import call, csr_of, rows_of
from dolfinx_mortar.algebra.parallel import free_unused
from dolfinx_mortar.arrays import HALF_OF_DIGITS, Ints
from dolfinx_mortar.qp.operator import count_negative


@dataclass(frozen=True)
class Change:
    """The unknowns v of multigrid for one set of held unknowns."""

    E: PETSc.Mat | None  # (n, n) x = (I - E) v; None for E = 0
    matrix: PETSc.Mat  # (n, n) of the QP in v, held unknowns decoupled; maybe of type python


@dataclass(frozen=True)
class Preconditioning:
    """The matrix to precondition with for one set of held unknowns."""

    B: PETSc.Mat  # (n, n) explicit: the matrix of the change, less ``between``
    change: Change
    motions: list[PETSc.Vec]  # near null space, zero at held unknowns
    between: PETSc.Mat | None = None  # (n, n) entries between parts that aggregates do not join


class Unknowns(Protocol):
    """Unknowns v for each set of held unknowns of the QP."""

    def preconditioning(self, held: Ints) -> Preconditioning:
        """Return the matrices of a set-up; collective."""

    def change(self, held: Ints) -> Change:
        """Return v for the present geometry; collective."""


class OwnUnknowns:
    """The unknowns v = x, for the matrix A of the QP."""

    def __init__(self, A: PETSc.Mat) -> None:
        self.operator = CongruentOperator(A)

    def preconditioning(self, held: Ints) -> Preconditioning:
        """Return A with held unknowns decoupled; collective."""
        change = self.change(held)
        return Preconditioning(change.matrix.copy(), change, [])

    def change(self, held: Ints) -> Change:
        """Return v = x; collective."""
        self.operator.follow(None, held)
        return Change(None, self.operator.matrix)


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


@contextmanager
def _product_of_three(ranks: int) -> Iterator[None]:
    """On one rank form the products P^T (A P) of levels in two steps, unless a user decides.

    PETSc's own choice takes twice as long (48 thousand unknowns in space: set-up .85 -> .60 s);
    on several ranks it forms two products, too. Its option has no prefix.
    """
    options, name = PETSc.Options(), "matptap_via"
    ours = ranks == 1 and not options.hasName(name)
    if ours:
        options.setValue(name, "rap")
    try:
        yield
    finally:
        if ours:
            options.delValue(name)


def _add(matrix: PETSc.Mat, other: PETSc.Mat) -> None:
    """Add a matrix of another pattern in place; collective."""
    matrix.axpy(1.0, other, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)


def _product_of_few(X: PETSc.Mat, P: PETSc.Mat) -> PETSc.Mat:
    """Return P^T X P of a symmetric X with few rows, without a transposed copy of P; collective."""
    rows = np.flatnonzero(np.diff(csr_of(X)[0])).astype(np.int32)
    return rows_of(P, rows).transposeMatMult(rows_of(X, rows).matMult(P))


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

    def renew(self, data: Preconditioning, held: Ints, *, definite: bool) -> None:
        """Set up with another matrix; collective.

        Args:
            data: the matrix.
            held: unknowns that it holds.
            definite: whether it is.
        """
        data.B.setOption(PETSc.Mat.Option.SPD, definite)
        self.B, self.E = data.B, data.change.E
        self.held = held
        basis = orthonormal(data.motions)
        if basis:
            data.B.setBlockSize(basis[0].getBlockSize())
            data.B.setNearNullSpace(PETSc.NullSpace().create(vectors=basis, comm=data.B.comm))
        self.inner.setFromOptions()
        if self.follows:
            self.inner.setUseAmat(True)
            self.inner.setOperators(data.change.matrix, data.B)
        else:
            self.inner.setOperators(data.B)
        self.inner.setReusePreconditioner(False)
        self.inner.setFailedReason(PETSc.PC.FailedReason.NOERROR)  # PETSc keeps that of a set-up
        if data.between is not None and not self.follows:
            _add(data.B, data.between)
        with _product_of_three(data.B.comm.size):
            self.inner.setUp()
            if self.follows:
                self._forget_factors()
            if data.between is not None and self.follows:
                self._join(data.B, data.between)
        self.negative = count_negative(self._coarsest) if self.follows and definite else 0
        self.inner.setReusePreconditioner(True)  # the finest matrix changes, coarse levels stay
        if self.follows:
            self._release(data.change.matrix)

    def _forget_factors(self) -> None:
        """Free what products P^T B P would need to be formed again, B among it; collective."""
        for level in range(self.inner.getMGLevels() - 1):
            product = self.inner.getMGSmoother(level).getOperators()[0]
            call("MatProductClear", ctypes.c_void_p(product.handle))

    def _join(self, B: PETSc.Mat, between: PETSc.Mat) -> None:
        """Add what couples the parts to the matrices of all levels; collective.

        In place: the smoothers refer to them, which estimate their eigenvalues then. Of the finest,
        Jacobi reads the diagonal only.
        """
        if not self._needs_diagonal:
            _add(B, between)
        for level in range(self.inner.getMGLevels() - 1, 0, -1):
            between = _product_of_few(between, self.inner.getMGInterpolation(level))
            smoother = self.inner.getMGSmoother(level - 1)
            own = smoother.getOperators()[0]
            _add(own, between)
            if level > 1:
                smoother.setOperators(own)
            free_unused(B.comm.tompi4py())

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
        """Keep of B what cycles read, and the other levels' matrices in blocks; collective."""
        levels = self.inner.getMGLevels()
        if self._needs_diagonal:
            assert self.B is not None, "not set up"
            self.B = PETSc.Mat().createDiagonal(self.B.getDiagonal())
            for user in (self.inner.getMGSmoother(levels - 1), self.inner):
                user.setOperators(finest, self.B)
        # In place: the smoothers refer to them. A cycle takes 10 to 15 % less time.
        for level in range(1, levels - 1):
            own = self.inner.getMGSmoother(level)
            matrix = own.getOperators()[0]
            if own.getPC().getType() == PETSc.PC.Type.JACOBI and matrix.getBlockSize() > 1:
                matrix.convert("baij")

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

# SPDX-License-Identifier: MIT
"""An iterative solver's preconditioner: multigrid in unknowns that suit it, not in those of the QP.

Where a bound holds an unknown, the unknown is right for multigrid: it drops out. Where the bound is
open, the two sides move apart, and the unknown, their relative motion, mixes them: coarse functions
of one body drag the other along (measured in 2D: 75 and 113 iterations on two meshes instead of 17
and 23, in 3D 43 instead of 18). So the caller may give a matrix B in unknowns v of its own,

    x = (I - E) v,      M^-1 = (I - E) B^-1 (I - E)^T on unknowns that are not held now.

B is that of an earlier set of held unknowns, earlier geometry and tangent. Each unknown that has
changed sides since costs an iteration or so, unless the finest level knows: there, residuals and
smoother have the matrix of the moment; only the coarse levels are B's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.congruence import CongruentOperator
from dolfinx_mortar.arrays import Floats, Ints
from dolfinx_mortar.qp.bound_qp import EPS


@dataclass(frozen=True)
class Change:
    """The unknowns v of multigrid for one set of held unknowns."""

    E: PETSc.Mat | None  # (n, n) x = (I - E) v; None for E = 0
    matrix: PETSc.Mat  # (n, n) of the QP in v, held unknowns decoupled; perhaps of type python


@dataclass(frozen=True)
class Preconditioning:
    """The matrix to precondition with for one set of held unknowns."""

    B: PETSc.Mat  # (n, n) explicit: the matrix of the change
    change: Change
    motions: list[PETSc.Vec]  # v that strain next to nothing, zero at held unknowns


class Unknowns(Protocol):
    """Unknowns v that suit multigrid, for each set of held unknowns of the QP."""

    def preconditioning(self, held: Ints) -> Preconditioning:
        """Return what is needed for a set-up; collective."""

    def change(self, held: Ints) -> Change:
        """Return v for the present geometry; collective."""


class OwnUnknowns:
    """The unknowns of the QP themselves.

    Args:
        A: matrix of the QP.
    """

    def __init__(self, A: PETSc.Mat) -> None:
        """Hold nothing."""
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
        if vector.norm() > np.sqrt(EPS) * whole:  # what is left has half of its digits
            vector.normalize()
            basis.append(vector)
    return basis


class FreePart:
    """Context of a PETSc Mat of type python: A on unknowns that are not held, without a copy of A.

    For vectors that vanish at held unknowns.
    """

    def __init__(self, A: PETSc.Mat) -> None:
        """Hold nothing."""
        self.A = A
        self.held: Ints = np.empty(0, dtype=np.int32)

    def mult(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Set y = A x with zeros at held unknowns (called by PETSc)."""
        self.A.mult(x, y)
        y.array[self.held] = 0.0

    def multTranspose(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Set y = A^T x with zeros at held unknowns (called by PETSc)."""
        self.A.multTranspose(x, y)
        y.array[self.held] = 0.0


class Multigrid:
    """Context of a PETSc PC of type python: M^-1 above, with any PC for B^-1.

    PETSc's GAMG follows the set, the geometry and the tangent on its finest level; of other PCs,
    unknowns that are free but were held at the set-up get their diagonal.

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
        self.held_by_B: Ints = self.held
        self.freed: Ints = self.held
        self.freed_diagonal: Floats = np.empty(0)
        self._r, self._v = A.createVecRight(), A.createVecRight()

    @property
    def follows(self) -> bool:
        """Tell whether the finest level has the matrix of the moment."""
        return bool(self.inner.getType() == PETSc.PC.Type.GAMG)

    def clear(self) -> None:
        """Free the matrices of the inner PC."""
        self.inner.reset()
        self.B = self.E = None

    def renew(self, data: Preconditioning, held: Ints, *, definite: bool) -> None:
        """Take another matrix; collective."""
        data.B.setOption(PETSc.Mat.Option.SPD, definite)
        self.B, self.E, self.held_by_B = data.B, data.change.E, held
        basis = orthonormal(data.motions)
        if basis:
            data.B.setBlockSize(basis[0].getBlockSize())
            data.B.setNearNullSpace(PETSc.NullSpace().create(vectors=basis))
        self.inner.setFromOptions()
        if self.follows:
            self.inner.setUseAmat(True)
            self.inner.setOperators(data.change.matrix, data.B)
        else:
            self.inner.setOperators(data.B)
        self.inner.setReusePreconditioner(False)
        self.inner.setUp()
        self.inner.setReusePreconditioner(True)  # values of B change, the coarse levels stay

    def follow(self, change: Change, held: Ints) -> None:
        """Say which unknowns are held now, and what v is; collective.

        The matrix of the change is the object that the set-up was given, with other values.
        """
        assert self.B is not None, "not set up"
        self.E, self.held = change.E, held
        self.B.setDiagonal(change.matrix.getDiagonal())  # the smoother reads nothing else of it

    def hold(self, held: Ints, diagonal: Floats) -> None:
        """Say which unknowns are held now, and the diagonal of the QP's matrix."""
        self.held = held
        self.freed = np.asarray(np.setdiff1d(self.held_by_B, held), dtype=np.int32)
        self.freed_diagonal = diagonal[self.freed]

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
        z.array[self.freed] = r.array_r[self.freed] / self.freed_diagonal
        z.array[self.held] = 0.0

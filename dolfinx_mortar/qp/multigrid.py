# SPDX-License-Identifier: MIT
"""An iterative solver's preconditioner: multigrid in unknowns that suit it, not in those of the QP.

Where a bound holds an unknown, the unknown is right for multigrid: it drops out. Where the bound is
open, the two sides move apart, and the unknown, their relative motion, mixes them: coarse functions
of one body drag the other along (measured in 2D: 75 and 113 iterations on two meshes instead of 17
and 23, in 3D 43 instead of 18). So the caller may give a matrix B in unknowns v of its own,

    x = (I - E) v,      M^-1 = (I - E) B^-1 (I - E)^T on unknowns that are not held now.

B may be that of an earlier set of held unknowns.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.arrays import Floats, Ints
from dolfinx_mortar.qp.tolerances import EPS


@dataclass(frozen=True)
class Preconditioning:
    """The matrix to precondition with for one set of held unknowns."""

    B: PETSc.Mat  # (n, n) symmetric positive definite, held unknowns decoupled
    E: PETSc.Mat | None  # (n, n) x = (I - E) v; None for E = 0
    motions: list[PETSc.Vec]  # v that strain next to nothing, zero at held unknowns


CreatePreconditioning = Callable[[Ints], Preconditioning]


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

    multTranspose = mult  # A is symmetric


class Multigrid:
    """Context of a PETSc PC of type python: M^-1 above, with any PC for B^-1.

    Args:
        like: (n,) a vector of the size of the matrices.
        prefix: prefix of the options of the PC for B^-1.
    """

    def __init__(self, like: PETSc.Vec, prefix: str) -> None:
        """Create the inner PC; its options are read at every set-up."""
        self.inner = PETSc.PC().create(like.comm)
        self.inner.setOptionsPrefix(prefix)
        self.inner.setFromOptions()
        self.E: PETSc.Mat | None = None
        self.held_by_B: Ints = np.empty(0, dtype=np.int32)
        self.held: Ints = self.held_by_B
        self.freed: Ints = self.held_by_B
        self.freed_diagonal: Floats = np.empty(0)
        self._r, self._v = like.duplicate(), like.duplicate()

    def clear(self) -> None:
        """Free the matrices of the inner PC."""
        self.inner.reset()
        self.E = None

    def renew(self, data: Preconditioning, held: Ints) -> None:
        """Take another matrix; collective."""
        self.E, self.held_by_B = data.E, held
        basis = orthonormal(data.motions)
        if basis:
            data.B.setBlockSize(basis[0].getBlockSize())
            data.B.setNearNullSpace(PETSc.NullSpace().create(vectors=basis))
        self.inner.setOperators(data.B)
        self.inner.setFromOptions()
        self.inner.setUp()

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

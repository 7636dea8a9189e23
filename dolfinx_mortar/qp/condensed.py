# SPDX-License-Identifier: MIT
"""A QP condensed to its unknowns G with bounds or friction, with a dense matrix.

With the inner unknowns I eliminated,

    S = A_GG - A_GI A_II^-1 A_IG,    g = b_G - A_GI A_II^-1 b_I,

the QP of S and g is of the same kind. MUMPS gives S on one rank, see
`preconditioner.SchurComplement`.
"""

from __future__ import annotations

from dataclasses import replace

from petsc4py import PETSc

import numpy as np
import scipy
from numpy.linalg import norm

from dolfinx_mortar.algebra.congruence import ContextOf
from dolfinx_mortar.algebra.csr import owned_rows
from dolfinx_mortar.common.arrays import (
    EPS,
    QUARTER_OF_DIGITS,
    ROUND_OFF,
    Floats,
    Ints,
    Longs,
)
from dolfinx_mortar.qp.bound_qp import BoundQP, Sliding, reaction
from dolfinx_mortar.qp.linear import LinearSolveFailed, LinearSolver


class Dense:
    """S (k, k) as a PETSc matrix and a `held.Solver`; `diagonal` (k,) is that of A."""

    exact = True

    def __init__(self, S: Floats, diagonal: Floats) -> None:
        self.S, self.diagonal = S, diagonal
        self.scale = 1.0 / np.sqrt(np.maximum(np.abs(np.diag(S)), EPS * np.abs(diagonal)))
        self.matrix = PETSc.Mat().createPython(S.shape, ContextOf(self), PETSc.COMM_SELF)

    def mult(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Set y = S x."""
        y.array[:] = self.S @ x.array_r

    def getDiagonal(self, mat: PETSc.Mat, y: PETSc.Vec) -> None:
        """Set y to the diagonal of A."""
        y.array[:] = self.diagonal

    def round_off(self, x: PETSc.Vec) -> float:
        """See `held.Solver`."""
        return ROUND_OFF * float(norm(self.diagonal * x.array_r))

    def solve(
        self,
        b: PETSc.Vec,
        x: PETSc.Vec,
        held: Ints,
        *,
        atol: float,
        sliding: Sliding | None = None,
        **others: object,
    ) -> PETSc.Vec:
        """See `held.Solver`."""
        values, right, result = x.array, b.array_r, b.duplicate()
        found = right - self.S @ values
        rest = found.copy()
        if sliding is not None:
            law = sliding.law
            law.put(rest, law.pick(found) - sliding.reaction(values, found))
        rest[held] = 0.0
        first = float(norm(rest))
        if first > self.round_off(x):
            M = self.S.copy()
            if sliding is not None:
                sliding.add(np.eye(len(M)), M.T)
            M, free = self._free(M, held)
            lu, pivots, failed = scipy.linalg.lapack.dgetrf(M, overwrite_a=True)
            if failed or not np.abs(np.diag(lu)).min(initial=1.0) > 64 * len(M) * EPS:
                raise LinearSolveFailed("nothing holds a body: a state leaves the matrix singular")
            step, _ = scipy.linalg.lapack.dgetrs(lu, pivots, rest[free] * self.scale[free])
            values[free] += step * self.scale[free]
            found = right - self.S @ values
            force = max(first, *(float(norm(v)) for v in (right, found)))
            if self.round_off(x) > QUARTER_OF_DIGITS * force > 0.0:
                raise LinearSolveFailed("hardly anything holds a body: round-off is near forces")
        result.array[:] = found
        return result

    def _free(self, M: Floats, held: Ints) -> tuple[Floats, Longs]:
        """Scaled free part of M, and its unknowns."""
        free = np.setdiff1d(np.arange(len(M)), held)
        s = self.scale[free]
        return M[np.ix_(free, free)] * np.outer(s, s), free

    def negative(self, held: Ints) -> int:
        """Number of negative eigenvalues of the free part."""
        M, _ = self._free(self.S, held)
        if not len(M) or scipy.linalg.lapack.dpotrf(M, lower=True)[1] == 0:
            return 0
        return int((np.linalg.eigvalsh(M) < -ROUND_OFF * len(M)).sum())


class Condensed:
    """A QP on one rank, condensed by MUMPS to its unknowns with bounds or friction.

    A LinAlgError if A is indefinite with these fixed. `atol` is the norm of b - A x on inner
    unknowns that counts as zero; `linear` has S.
    """

    def __init__(self, whole: BoundQP, linear: LinearSolver, atol: float) -> None:
        schur = linear.schur
        assert schur is not None
        product = schur.product
        self._whole, self._linear, self._G = whole, linear, schur.unknowns
        self._atol = atol
        linear.factorise(self._G)
        S, out = schur.S, product.decoupled
        if product.C is not None:
            C = owned_rows(product.C)[self._G][:, self._G]
            half = S + C.T @ S
            S = half + half @ C
        self._x: Floats = np.zeros(whole.b.getLocalSize())
        self._x[out] = whole.b.array_r[out] / product.scale
        on = np.isin(self._G, whole.held)
        rest = ~on & ~np.isin(self._G, out)
        self._on, self._rest = np.flatnonzero(on), np.flatnonzero(rest)
        self._L = scipy.linalg.cholesky(S[np.ix_(rest, rest)], lower=True)
        self._Q = scipy.linalg.solve_triangular(self._L, S[np.ix_(rest, on)], lower=True)
        inner = S[np.ix_(on, on)] - self._Q.T @ self._Q
        self.dense = Dense(inner, whole.stiffness[whole.held])

    def about(self, x: Floats | None = None) -> BoundQP:
        """Condensed QP of the residual at x (n,)."""
        whole, held = self._whole, self._whole.held
        self._x = self._with_inner(self._x if x is None else x)
        at = whole.b.duplicate()
        at.array[:] = self._x
        left = reaction(whole, at).array_r[self._G]
        self._w = scipy.linalg.solve_triangular(self._L, left[self._rest], lower=True)
        b, lower, upper = (self.dense.matrix.createVecRight() for _ in range(3))
        b.array[:] = left[self._on] - self._Q.T @ self._w + self.dense.S @ self._x[held]
        lower.array[:], upper.array[:] = whole.lower.array_r[held], whole.upper.array_r[held]
        law = whole.friction
        if law is not None:
            places = np.searchsorted(held, law.tangential)
            law = replace(law, tangential=np.where(law.some, places, -1).astype(np.int32))
        bounded = np.searchsorted(held, whole.bounded).astype(np.int32)
        parts = {"b": b, "lower": lower, "upper": upper, "bounded": bounded, "friction": law}
        return replace(whole, A=self.dense.matrix, product=None, near=None, **parts)

    def expand(self, own: Floats) -> Floats:
        """Return x (n,) for a solution (k,)."""
        held, x = self._whole.held, self._x.copy()
        right = self._w - self._Q @ (own - x[held])
        x[self._G[self._rest]] += scipy.linalg.solve_triangular(
            self._L, right, lower=True, trans="T"
        )
        x[held] = own
        return self._with_inner(x)

    def _with_inner(self, x: Floats) -> Floats:
        found = self._whole.b.duplicate()
        found.array[:] = x
        left = reaction(self._whole, found)
        left.array[self._G] = 0.0
        if left.norm() <= self._atol:
            return x
        self._linear.apply(left, found)
        if not np.isfinite(found.norm()):
            raise LinearSolveFailed("the linear solver gave NaN or infinity: check its options")
        return x + found.array_r

# SPDX-License-Identifier: MIT
"""A QP condensed to its unknowns G with bounds or friction, with a dense matrix.

With those of its inner unknowns I eliminated,

    S = A_GG - A_GI A_II^-1 A_IG,    g = b_G - A_GI A_II^-1 b_I,

the QP of S and g is of the same kind, so that the same loop solves it; a state takes a dense
factorisation of its free rows. MUMPS gives S, see `schur`, on one rank.
"""

from __future__ import annotations

from dataclasses import replace

from petsc4py import PETSc

import numpy as np
from numpy.linalg import norm
from scipy.linalg import LinAlgError, lapack

from dolfinx_mortar.algebra.congruence import ContextOf
from dolfinx_mortar.arrays import (
    EPS,
    HALF_OF_DIGITS,
    QUARTER_OF_DIGITS,
    ROUND_OFF,
    SAME,
    Floats,
    Ints,
    Longs,
)
from dolfinx_mortar.qp.bound_qp import BoundQP, reaction
from dolfinx_mortar.qp.friction import Sliding
from dolfinx_mortar.qp.linear import LinearSolveFailed, LinearSolver, NotDefinite


class Dense:
    """S as a matrix of PETSc and a solver of its free rows, see `held.Solver`.

    Args:
        S: (k, k).
        diagonal: (k,) that of A, which scales distances to forces.
    """

    exact = True

    def __init__(self, S: Floats, diagonal: Floats) -> None:
        self.S, self.diagonal = S, diagonal
        self.scale = 1.0 / np.sqrt(np.maximum(np.abs(np.diag(S)), EPS * np.abs(diagonal)))
        self.matrix = PETSc.Mat().createPython(S.shape, ContextOf(self), PETSc.COMM_SELF)

    def mult(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Set y to the product with x."""
        y.array[:] = self.S @ x.array_r

    def getDiagonal(self, mat: PETSc.Mat, y: PETSc.Vec) -> None:
        """Set y to the diagonal of A."""
        y.array[:] = self.diagonal

    def round_off(self, x: PETSc.Vec) -> float:
        """Return that of A x."""
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
        """Solve for what is not held, in place; see `LinearSolver.solve`."""
        values, right, result = x.array, b.array_r, b.duplicate()
        found = right - self.S @ values
        rest = found.copy()
        if sliding is not None:
            law = sliding.law
            law.put(rest, law.pick(found) - sliding.reaction(values, found))
        rest[held] = 0.0
        first = float(norm(rest))
        if first > self.round_off(x):
            M, free = self._free(self.S if sliding is None else _slipping(self.S, sliding), held)
            lu, pivots, failed = lapack.dgetrf(M, overwrite_a=True)
            if failed or not np.abs(np.diag(lu)).min(initial=1.0) > 64 * len(M) * EPS:
                raise NotDefinite("nothing holds a body: a state leaves the matrix singular")
            step, _ = lapack.dgetrs(lu, pivots, rest[free] * self.scale[free])
            values[free] += step * self.scale[free]
            found = right - self.S @ values
            force = max(first, *(float(norm(v)) for v in (right, found)))
            if self.round_off(x) > QUARTER_OF_DIGITS * force > 0.0:
                raise NotDefinite("hardly anything holds a body: round-off is near the forces")
        result.array[:] = found
        return result

    def _free(self, M: Floats, held: Ints) -> tuple[Floats, Longs]:
        """Return the free part of a matrix (k, k), scaled, and which unknowns it has."""
        free = np.setdiff1d(np.arange(len(M)), held)
        s = self.scale[free]
        return M[np.ix_(free, free)] * np.outer(s, s), free

    def negative(self, held: Ints) -> int:
        """Return how many eigenvalues of the free part of S are negative."""
        M, _ = self._free(self.S, held)
        if not len(M) or lapack.dpotrf(M, lower=True)[1] == 0:
            return 0
        return int((np.linalg.eigvalsh((M + M.T) / 2) < -ROUND_OFF * len(M)).sum())


def _slipping(S: Floats, sliding: Sliding) -> Floats:
    """Return S with the rows of slipping nodes replaced by those of their law."""
    M, law, d = S.copy(), sliding.law, sliding.direction
    normal = S[sliding.normal]
    for a in range(d.shape[1]):
        some = law.some[:, a]
        rows = law.tangential[some, a]
        M[rows] -= (law.coefficient * d[:, a])[some, None] * normal[some]
        for c in range(d.shape[1]):
            both = some & law.some[:, c]
            part = sliding.stiffness * ((a == c) - d[:, a] * d[:, c])
            M[law.tangential[both, a], law.tangential[both, c]] += part[both]
    return M


class Condensed:
    """A QP on one rank, condensed to its unknowns with bounds or friction by MUMPS's S.

    Args:
        whole: the QP.
        linear: solver of A.
        held: unknowns that an initial state holds,
        values: and where.

    Attributes:
        dense: the solver of the condensed linear systems.
        qp: the condensed QP.
    """

    def __init__(self, whole: BoundQP, linear: LinearSolver, held: Ints, values: Floats) -> None:
        self._whole, self._linear, self._G = whole, linear, whole.held
        G, law = self._G, whole.friction
        linear.factorise(G)
        self._y = self._begin(held, values)
        assert linear.schur is not None
        self.dense = Dense(linear.schur.model(), whole.stiffness[G])
        b, lower, upper = (self.dense.matrix.createVecRight() for _ in range(3))
        b.array[:] = self._product(self._y)[G] + self.dense.S @ self._y[G]
        if not np.isfinite(b.array_r).all():
            raise LinearSolveFailed("The linear solver gave NaN or infinity: check its options.")
        lower.array[:], upper.array[:] = whole.lower.array_r[G], whole.upper.array_r[G]
        if law is not None:
            places = np.searchsorted(G, law.tangential)
            law = replace(law, tangential=np.where(law.some, places, -1).astype(np.int32))
        bounded = np.searchsorted(G, whole.bounded).astype(np.int32)
        self.qp = replace(
            whole,
            A=self.dense.matrix,
            b=b,
            lower=lower,
            upper=upper,
            bounded=bounded,
            friction=law,
            product=None,
            near=None,
        )

    def _begin(self, held: Ints, values: Floats) -> Floats:
        """Return x (n,) in a state; with G held at 0 where that is not of use.

        MUMPS's S serves all states, of which the first one is the last one most often.
        """
        at: Floats = np.zeros(self._whole.b.getLocalSize())
        if self._whole.friction is None and held.size:
            at[held] = values
            try:
                at += self._inner(self._product(at), held)
            except LinAlgError:  # nothing holds a body in that state
                return self._inner(self._whole.b.array_r, self._G)
            x = self._whole.b.duplicate()
            x.array[:] = at
            if self._linear.round_off(x) <= HALF_OF_DIGITS * self._whole.b.norm():
                return at
        return self._inner(self._whole.b.array_r, self._G)  # bounds are far, or nothing holds it

    def _product(self, x: Floats) -> Floats:
        """Return b - A x (n,)."""
        at = self._whole.b.duplicate()
        at.array[:] = x
        return np.asarray(reaction(self._whole, at).array_r)

    def _inner(self, values: Floats, held: Ints) -> Floats:
        """Return A^-1 times values (n,), with these held at 0."""
        right, found = self._whole.b.duplicate(), self._whole.b.duplicate()
        right.array[:] = values
        right.array[held] = 0.0
        self._linear.hold(held)
        self._linear.apply(right, found)
        found.array[held] = 0.0
        return np.asarray(found.array_r)

    def expand(self, own: Floats) -> Floats:
        """Return x (n,) for that of the condensed QP (k,)."""
        stiffness = self._whole.stiffness[self._G]
        found = self._y.copy()
        if norm(stiffness * (own - found[self._G])) > SAME * norm(stiffness * own):
            at = np.zeros_like(found)
            at[self._G] = own
            found[:] = self._inner(self._product(at), self._G)
        found[self._G] = own
        return found

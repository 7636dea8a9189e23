# SPDX-License-Identifier: MIT
"""A QP condensed to its unknowns with bounds or friction, with a dense matrix.

With these unknowns G held, A is factorised once, and its columns A_IG are solved together:

    S = A_GG - A_GI A_II^-1 A_IG,    g = b_G - A_GI A_II^-1 b_I.

The QP of S and g is of the same kind, so that the same loop solves it; a state takes a dense
factorisation of its free rows. Scalars are condensed likewise.
"""

from __future__ import annotations

from dataclasses import replace

from petsc4py import PETSc

import numpy as np
from scipy.linalg import lapack
from scipy.sparse import csr_array

from dolfinx_mortar.algebra.csr import csr_of
from dolfinx_mortar.arrays import EPS, ROUND_OFF, Bools, Floats, Ints, Longs
from dolfinx_mortar.qp.bound_qp import BoundQP, reaction
from dolfinx_mortar.qp.friction import Friction, Sliding, state_of
from dolfinx_mortar.qp.linear import LinearSolver, NotDefinite

MOST = 1500
"""Unknowns of a dense problem, see `condenses`."""


def condenses(qp: BoundQP, linear: LinearSolver) -> bool:
    """Tell whether the problem is on one rank, with a factorisation, and has few such unknowns."""
    if qp.comm.size > 1 or not linear.direct:
        return False
    return 0 < qp.held.size <= MOST


def select(qp: BoundQP, mask: Bools) -> tuple[BoundQP, Bools]:
    """Return the QP with some of its bounds (k,), and which nodes (m,) of friction it has."""
    law = qp.friction
    if law is None:
        return replace(qp, bounded=qp.bounded[mask]), np.zeros(0, dtype=bool)
    some = mask[law.normal]
    law = law.select(some)
    law = replace(law, normal=(np.cumsum(mask).astype(np.int32) - 1)[law.normal])
    return replace(qp, bounded=qp.bounded[mask], friction=law), some


class Dense:
    """S as a matrix of PETSc and a solver of its free rows, see `held.Solver`.

    Args:
        S: (k, k).
        diagonal: (k,) that of A, which scales distances to forces.
    """

    direct = True

    def __init__(self, S: Floats, diagonal: Floats) -> None:
        self.S, self.diagonal = S, diagonal
        self.scale = 1.0 / np.sqrt(np.maximum(np.abs(np.diag(S)), EPS * np.abs(diagonal)))
        self.matrix = PETSc.Mat().createPython(S.shape, self, PETSc.COMM_SELF)
        self.states = 0
        self._key = b""
        self._free: Longs = np.zeros(0, dtype=np.int64)
        self._lu = self._pivots = np.zeros(0)

    def mult(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Set y to the product with x (called by PETSc)."""
        y.array[:] = self.S @ x.array_r

    def getDiagonal(self, mat: PETSc.Mat, y: PETSc.Vec) -> None:
        """Set y to the diagonal of A (called by PETSc)."""
        y.array[:] = self.diagonal

    def round_off(self, x: PETSc.Vec) -> float:
        """Return that of A x."""
        return ROUND_OFF * float(np.linalg.norm(self.diagonal * x.array_r))

    def solve(
        self,
        b: PETSc.Vec,
        x: PETSc.Vec,
        held: Ints,
        *,
        atol: float,
        z: PETSc.Vec | None = None,
        sliding: Sliding | None = None,
        go_on: object = None,
    ) -> PETSc.Vec:
        """Solve for what is not held, in place; see `LinearSolver.solve`."""
        values, right, result = x.array, b.array_r, b.duplicate()
        found = right - self.S @ values
        rest = found.copy()
        if sliding is not None:
            law = sliding.law
            law.put(rest, law.pick(found) - sliding.reaction(values, found))
        rest[held] = 0.0
        if np.linalg.norm(rest) > self.round_off(x):
            self._factorise(held, sliding)
            free = self._free
            step, _ = lapack.dgetrs(self._lu, self._pivots, rest[free] * self.scale[free])
            values[free] += step * self.scale[free]
            found = right - self.S @ values
        result.array[:] = found
        return result

    def _factorise(self, held: Ints, sliding: Sliding | None) -> None:
        """Factorise the free rows, unless these are the last ones.

        Raises:
            NotDefinite: if they are singular.
        """
        key = state_of(held, sliding)
        if key == self._key:
            return
        self.states += 1
        free = np.ones(len(self.S), dtype=bool)
        free[held] = False
        self._free = np.flatnonzero(free)
        M = self.S if sliding is None else _slipping(self.S, sliding)
        s = self.scale[self._free]
        M = M[np.ix_(self._free, self._free)] * np.outer(s, s)
        self._lu, self._pivots, failed = lapack.dgetrf(M, overwrite_a=True)
        least = np.abs(np.diag(self._lu)).min(initial=1.0)
        self._key = key
        if failed or not least > 64 * len(s) * EPS:
            self._key = b""
            raise NotDefinite("nothing holds a body: a state leaves the condensed matrix singular")

    def negative(self, held: Ints) -> int:
        """Return how many eigenvalues of the free part of S are negative."""
        free = np.ones(len(self.S), dtype=bool)
        free[held] = False
        s = self.scale[free]
        M = self.S[np.ix_(free, free)] * np.outer(s, s)
        if not len(s) or lapack.dpotrf(M, lower=True)[1] == 0:
            return 0
        return int((np.linalg.eigvalsh((M + M.T) / 2) < -ROUND_OFF * len(s)).sum())


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
    """A QP condensed to its unknowns with bounds or friction, on one rank.

    Attributes:
        whole: the QP.
        qp: the condensed one.
        dense: the solver of its linear systems.

    Raises:
        LinearSolveFailed: if A is singular with all of them held.
    """

    def __init__(self, whole: BoundQP, linear: LinearSolver) -> None:
        self.whole, self.linear, scalars = whole, linear, whole.scalars
        self.G = G = whole.held
        linear.factorise(G)
        self._y = self.inner(whole.b.array_r)
        self._state = whole.A.stateGet()
        place = np.full(len(self._y) + 1, -1, dtype=np.int32)  # the last one is that of none
        place[G] = np.arange(G.size)
        self._place = place
        y = whole.b.duplicate()
        y.array[:] = self._y
        self._g = reaction(whole, y).array_r[G].copy()
        diagonal, schur = whole.diagonal.array_r[G], linear.setup.preconditioner.schur
        if schur is not None:
            self._Y, self.dense, self._scalars = None, Dense(schur.model(), diagonal), None
            return
        start, columns, values = csr_of(whole.A)
        rows = csr_array((values, columns, start), shape=(len(self._y),) * 2)
        self._Y = linear.solve_many(self._inside(rows[:, G].toarray().T))
        self._Y[:, G] = 0.0
        rows = rows[G]
        self.dense = Dense(rows[:, G].toarray() - rows @ self._Y.T, diagonal)
        if scalars is not None:
            R, C = self._inside(scalars.rows), scalars.columns
            self._Yq = linear.solve_many(self._inside(C))
            self._Yq[:, G] = 0.0
            scalars = replace(
                scalars,
                motions=scalars.motions[:, G],
                loads=scalars.loads - R @ self._y,
                columns=C[:, G] - self._Yq @ rows.T,
                rows=scalars.rows[:, G] - R @ self._Y.T,
                block=scalars.block - R @ self._Yq.T,
            )
        self._scalars = scalars

    def _inside(self, values: Floats) -> Floats:
        """Return rows (r, n) that are zero in G."""
        found = values.copy()
        found[..., self.G] = 0.0
        return found

    def inner(self, values: Floats) -> Floats:
        """Return A_II^-1 times values (n,), zero in G."""
        right, found = self.whole.b.duplicate(), self.whole.b.duplicate()
        right.array[:] = self._inside(values)
        self.linear.apply(right, found)
        return self._inside(found.array_r)

    def is_of(self, whole: BoundQP) -> bool:
        """Tell whether a QP has the same matrix, right-hand side and scalars."""
        mine = self.whole
        same = mine.A is whole.A and mine.b is whole.b and mine.scalars is whole.scalars
        return same and self._state == whole.A.stateGet()

    def holds(self, whole: BoundQP) -> Bools:
        """Tell which bounds (k,) of a QP are on unknowns in G."""
        return np.isin(whole.bounded, self.G)

    def serves(self, part: BoundQP) -> bool:
        """Tell whether all unknowns with bounds or friction are in G."""
        law = part.friction
        tangential = np.zeros(0, np.int32) if law is None else law.tangential[law.some]
        return bool((self._place[np.append(part.bounded, tangential)] >= 0).all())

    def select(self, whole: BoundQP) -> BoundQP:
        """Return the condensed QP of one with other bounds or friction, of unknowns in G."""
        G, place, A = self.G, self._place, self.dense.matrix
        b, lower, upper = (A.createVecRight() for _ in range(3))
        b.array[:] = self._g
        lower.array[:], upper.array[:] = whole.lower.array_r[G], whole.upper.array_r[G]
        law: Friction | None = whole.friction
        if law is not None:
            law = replace(law, tangential=place[law.tangential])
        return BoundQP(
            *(A, b, lower, upper, place[whole.bounded], law, whole.definite),
            extent=whole.extent,
            scalars=self._scalars,
        )

    def expand(self, x: Floats, q: Floats) -> Floats:
        """Return x (n,) of the whole QP for that of the condensed one (k,) and scalars (m,)."""
        if self._Y is None:
            at, z = self.whole.b.duplicate(), self.whole.b.duplicate()
            at.array[self.G] = x
            self.whole.A.mult(at, z)
            found = self._y - self.inner(z.array_r)
        else:
            found = self._y - x @ self._Y
            if self._scalars is not None:
                found -= q @ self._Yq
        found[self.G] = x
        return np.asarray(found)

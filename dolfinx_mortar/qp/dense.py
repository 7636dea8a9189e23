# SPDX-License-Identifier: MIT
"""A QP condensed to its unknowns with bounds or friction, with a dense matrix.

With these unknowns G held, A is factorised once, and its columns A_IG are solved together:

    S = A_GG - A_GI A_II^-1 A_IG,    g = b_G - A_GI A_II^-1 b_I.

The QP of S and g is of the same kind, so that the same loop solves it, on rank 0; a state takes a
dense factorisation of its free rows. Scalars are condensed likewise. Where MUMPS gives S (`schur`),
the columns are not needed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar, cast

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from scipy.linalg import LinAlgError, lapack

from dolfinx_mortar.algebra.errors import from_callbacks
from dolfinx_mortar.algebra.parallel import norm
from dolfinx_mortar.arrays import (
    EPS,
    HALF_OF_DIGITS,
    QUARTER_OF_DIGITS,
    ROUND_OFF,
    SAME,
    Actives,
    Bools,
    Floats,
    Ints,
    Longs,
)
from dolfinx_mortar.qp.bound_qp import BoundQP, Scalars
from dolfinx_mortar.qp.friction import Friction, Sliding, state_of
from dolfinx_mortar.qp.linear import LinearSolveFailed, LinearSolver, NotDefinite
from dolfinx_mortar.qp.operator import ContextOf
from dolfinx_mortar.qp.schur import SchurComplement

MOST = 1500
"""Unknowns of a dense problem, see `condenses`."""

T = TypeVar("T")
Array = TypeVar("Array", Floats, Ints, Actives)


def condenses(qp: BoundQP, linear: LinearSolver) -> bool:
    """Tell whether a factorisation serves, and there are few such unknowns; collective.

    Bounds alone are few if S has no more entries than A: strips of 6 to 120 thousand unknowns with
    61 to 1001 bounds took .55 to .83 of the time where it has fewer, .92 with 1.15 times as many,
    1.08 with 1.7 times.
    """
    if not linear.direct:
        return False
    size = int(qp.comm.allreduce(qp.held.size))
    if qp.friction is not None or qp.scalars is not None or not size:
        return 0 < size <= MOST
    if linear.setup.preconditioner.schur is not None:
        return True
    entries = qp.A.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"]
    return bool(qp.definite and size**2 <= entries)


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
        self.matrix = PETSc.Mat().createPython(S.shape, ContextOf(self), PETSc.COMM_SELF)
        self._key = b""
        self._free: Longs = np.zeros(0, dtype=np.int64)
        self._lu = self._pivots = np.zeros(0)

    def mult(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Set y to the product with x."""
        y.array[:] = self.S @ x.array_r

    def getDiagonal(self, mat: PETSc.Mat, y: PETSc.Vec) -> None:
        """Set y to the diagonal of A."""
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
        first = float(np.linalg.norm(rest))
        if first > self.round_off(x):
            self._factorise(held, sliding)
            free = self._free
            step, _ = lapack.dgetrs(self._lu, self._pivots, rest[free] * self.scale[free])
            values[free] += step * self.scale[free]
            found = right - self.S @ values
            force = max(first, *(float(np.linalg.norm(v)) for v in (right, found)))
            if self.round_off(x) > QUARTER_OF_DIGITS * force > 0.0:
                raise NotDefinite("hardly anything holds a body: round-off is near the forces")
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
    """A QP condensed to its unknowns with bounds or friction; collective.

    MUMPS's S of an indefinite matrix may have no inverse, which numpy says.

    Args:
        whole: the QP.
        linear: solver of A.
        held: unknowns that an initial state holds,
        values: and where.

    Attributes:
        whole: as above.
        G: (k,) those unknowns of this rank.
        dense: the solver of the condensed linear systems, on all ranks.

    Raises:
        LinearSolveFailed: if A is singular with all of them held.
    """

    def __init__(self, whole: BoundQP, linear: LinearSolver, held: Ints, values: Floats) -> None:
        self.whole, self.linear, self.G = whole, linear, whole.held
        counts = whole.comm.allgather(self.G.size)
        self._first = sum(counts[: whole.comm.rank])
        linear.factorise(self.G)
        self._y, self._state = self._begin(held, values), whole.A.stateGet()
        own = self._product(self._y, whole.b)[self.G], self._y[self.G], whole.stiffness[self.G]
        force, w, diagonal = self.gather(np.stack(own, axis=1)).T
        schur = self._schur
        self._Y: Floats = np.zeros((0, len(self._y)))
        self._Yq: Floats = np.zeros((0, len(self._y)))
        S = schur.model() if schur is not None else self._columns(sum(counts))
        self.dense, self._g = Dense(S, diagonal), force + S @ w
        if not np.isfinite(self._g).all():
            raise LinearSolveFailed("The linear solver gave NaN or infinity: check its options.")
        self._scalars = None if whole.scalars is None else self._condense(whole.scalars)

    def _begin(self, held: Ints, values: Floats) -> Floats:
        """Return x (n,) in a state; with G held at 0 where that is not of use; collective.

        MUMPS's S serves all states, of which the first one is the last one most often.
        """
        at: Floats = np.zeros(self.whole.b.getLocalSize())
        if self._schur is None or self.whole.friction is not None or not self._sum(held.size):
            return self.inner(self.whole.b.array_r)
        at[held] = values
        try:
            at += self.inner(self._product(at, self.whole.b), held)
        except LinAlgError:  # nothing holds a body in that state
            return self.inner(self.whole.b.array_r)
        x = self.whole.b.duplicate()
        x.array[:] = at
        if self.linear.round_off(x) <= HALF_OF_DIGITS * self.whole.b.norm():
            return at
        return self.inner(self.whole.b.array_r)  # hardly anything holds it, or bounds are far

    @property
    def _schur(self) -> SchurComplement | None:
        return self.linear.setup.preconditioner.schur

    def gather(self, values: Array) -> Array:
        """Return the values (.., ...) of all ranks, in their order; collective."""
        return cast(Array, np.concatenate(self.whole.comm.allgather(values)))

    def _sum(self, values: Floats | int) -> Floats:
        return np.asarray(self.whole.comm.allreduce(values, op=MPI.SUM))

    def _product(self, x: Floats, b: PETSc.Vec) -> Floats:
        """Return b - A x (n,) of this rank; collective."""
        at = self.whole.b.duplicate()
        at.array[:] = x
        z = at.duplicate()
        self.whole.A.mult(at, z)
        return np.asarray(b.array_r - z.array_r)

    def inner(self, values: Floats, held: Ints | None = None) -> Floats:
        """Return A_II^-1 times values (n,), zero in G or what else is held; collective."""
        held = self.G if held is None else held
        right, found = self.whole.b.duplicate(), self.whole.b.duplicate()
        right.array[:] = values
        right.array[held] = 0.0
        self.linear.factorise(held)
        self.linear.apply(right, found)
        found.array[held] = 0.0
        return np.asarray(found.array_r)

    def _columns(self, k: int) -> Floats:
        """Solve the columns A_IG; return S (k, k); collective."""
        A, n = self.whole.A, len(self._y)
        unit = PETSc.Mat().createDense(((n, None), (None, k)), comm=A.comm)
        unit.setUp()
        values = unit.getDenseArray()
        values[self.G, self._first + np.arange(self.G.size)] = 1.0
        unit.assemble()
        columns = A.matMult(unit)
        right = columns.getDenseArray()
        rows = right[self.G].copy()
        right[self.G] = 0.0
        columns.assemble()
        self.linear.solve_many(columns, unit)
        found = unit.getDenseArray()
        found[self.G] = 0.0
        unit.assemble()
        self._Y = found.T.copy()
        A.matMult(unit, result=columns)
        S = self.gather(rows - columns.getDenseArray(readonly=True)[self.G])
        unit.destroy()
        columns.destroy()
        return S

    def _condense(self, scalars: Scalars) -> Scalars:
        """Return the scalars of the condensed QP; collective."""
        none, R = self.whole.b.duplicate(), scalars.rows.copy()
        R[:, self.G] = 0.0
        self._Yq = np.array([self.inner(column) for column in scalars.columns])
        C = scalars.columns + np.array([self._product(y, none) for y in self._Yq])
        inside = self._sum(np.hstack([R @ self._y[:, None], R @ self._Yq.T, R @ self._Y.T]))
        m = len(C)
        return replace(
            scalars,
            motions=self.gather(scalars.motions[:, self.G].T).T,
            loads=scalars.loads - inside[:, 0],
            columns=self.gather(C[:, self.G].T).T,
            rows=self.gather(scalars.rows[:, self.G].T).T - inside[:, m + 1 :],
            block=scalars.block - inside[:, 1 : m + 1],
        )

    def is_of(self, whole: BoundQP) -> bool:
        """Tell whether a QP has the same matrix, right-hand side and scalars."""
        mine = self.whole
        same = mine.A is whole.A and mine.b is whole.b and mine.scalars is whole.scalars
        return same and self._state == whole.A.stateGet()

    def holds(self, whole: BoundQP) -> Bools:
        """Tell which bounds (k,) of this rank are on unknowns in G."""
        return np.isin(whole.bounded, self.G)

    def serves(self, part: BoundQP) -> bool:
        """Tell whether all unknowns with bounds or friction are in G; collective."""
        inside = bool(np.isin(part.held, self.G).all())
        return bool(self.whole.comm.allreduce(inside, op=MPI.LAND))

    def select(self, part: BoundQP) -> BoundQP:
        """Return the condensed QP of one with other bounds or friction, on all ranks; collective.

        Its unknowns, bounds and nodes with friction are those of all ranks, in their order.
        """
        A, G, law = self.dense.matrix, self.G, part.friction
        b, lower, upper = (A.createVecRight() for _ in range(3))
        b.array[:] = self._g
        bounds = self.gather(np.stack([part.lower.array_r[G], part.upper.array_r[G]], axis=1))
        lower.array[:], upper.array[:] = bounds.T
        place = np.full(len(self._y) + 1, -1, dtype=np.int32)  # the last one is that of none
        place[G] = self._first + np.arange(G.size)
        if law is not None:
            before = sum(part.comm.allgather(part.bounded.size)[: part.comm.rank])
            normal = (law.normal + before).astype(np.int32)
            law = Friction(
                self.gather(normal),
                self.gather(place[law.tangential]),
                *(self.gather(v) for v in (law.rest, law.coefficient, law.cohesion)),
            )
        bounded = self.gather(place[part.bounded])
        return BoundQP(
            *(A, b, lower, upper, bounded, law, part.definite),
            extent=part.extent,
            scalars=self._scalars,
        )

    def expand(self, x: Floats, q: Floats) -> Floats:
        """Return x (n,) of this rank for that of the condensed QP (k,) and scalars (m,)."""
        own = x[self._first : self._first + self.G.size]
        if self._schur is None:
            found = self._y - x @ self._Y - q[: len(self._Yq)] @ self._Yq
        elif self._moves(own):
            at: Floats = np.zeros(len(self._y))
            at[self.G] = own
            found = self.inner(self._product(at, self.whole.b)).copy()
        else:
            return self._y
        found[self.G] = own
        return np.asarray(found)

    def _moves(self, own: Floats) -> bool:
        """Tell whether unknowns in G differ from what they began with; collective."""
        stiffness = self.whole.stiffness[self.G]
        change = norm(self.whole.comm, stiffness * (own - self._y[self.G]))
        return change > SAME * norm(self.whole.comm, stiffness * own)


def on_root(comm: MPI.Comm, function: Callable[[], T]) -> T:
    """Call a function on rank 0 and return its value on all; raise its error on all; collective."""
    answer, own = None, None
    if comm.rank == 0:
        try:
            with from_callbacks():
                answer = function()
        except BaseException as caught:
            own = caught
    answer, error = comm.bcast((answer, own))
    if error is not None:
        raise own or error  # with its cause, where that is
    return cast(T, answer)

# SPDX-License-Identifier: MIT
"""Primal-dual active set: semi-smooth Newton on z = max(0, z + c (x - upper)), and on lower bounds.

With friction also on z_t = q min(1, s / |q|), see `qp.friction`.

Where a factorisation serves and few unknowns have bounds, the QP is condensed to these, see
`dense`: the updates are the same. Without friction and with a definite matrix, the interior point
takes over after a cycle, and after a set that leaves a body unconstrained.
"""

from dataclasses import dataclass, replace
from functools import partial

from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.errors import from_callbacks
from dolfinx_mortar.algebra.parallel import any_rank, maximum, ratio
from dolfinx_mortar.arrays import EPS, LIMIT, Bools, Floats
from dolfinx_mortar.qp import interior_point
from dolfinx_mortar.qp.bound_qp import (
    BoundQP,
    QPNotSolved,
    QPSolution,
    check,
    is_noise,
    reaction,
)
from dolfinx_mortar.qp.dense import Condensed, condenses, on_root, select
from dolfinx_mortar.qp.descent import descend
from dolfinx_mortar.qp.held import HeldProblem, Solver, State
from dolfinx_mortar.qp.linear import LinearSolveFailed, LinearSolver, NotDefinite
from dolfinx_mortar.qp.scalars import Bordered, NoResistance, moved, no_friction
from dolfinx_mortar.qp.updates import LOOSE, TIGHT, Outcome, update

# How friction was linearised: limits of the pressure of the solution, or of a solution before it
EXACT, GIVEN = "exact linearisation", "given limits"


@from_callbacks()
def solve(
    qp: BoundQP,
    linear: LinearSolver,
    *,
    start: State,
    rtol: float,
    guess: PETSc.Vec | None = None,
) -> QPSolution:
    """Solve a bound-constrained QP by active-set updates (collective).

    Args:
        start: initial active set and directions of slip.
        guess: (n,) first x, 0 by default.

    Returns:
        The solution; its active set is that of the last linear system, in which weakly active
        unknowns may be in either state.

    Raises:
        QPNotSolved: if the interior point, called after a cycle or a failed solve, fails too.
    """
    if qp.friction is not None or qp.scalars is not None:
        return solve_states(qp, linear, start, rtol, guess)
    definite = True
    try:
        if condenses(qp, linear):
            return solve_states(qp, linear, start, rtol)
        x = qp.b.duplicate()
        x.set(0.0)
        if guess is not None:
            guess.copy(x)
        problem = HeldProblem(qp, linear, x, rtol)
        outcome = update(problem.hold, start, qp.comm, level=LOOSE)
        if not outcome.reason:
            return problem.solution(outcome, "active-set")
        reason = outcome.reason
    except LinearSolveFailed as error:
        reason = f"an active set could not be solved ({error})"
        definite = not isinstance(error, NotDefinite)
    except QPNotSolved as error:
        reason = str(error)
    if not qp.definite:
        raise QPNotSolved(
            f"Active set: {reason}. Where few nodes touch, as at a corner or on a coarse mesh, "
            "they may open and close in turn: refine the mesh there, take smaller steps, or "
            "prescribe displacements instead of loads"
        )
    try:
        solution = interior_point.solve(qp, linear, rtol=rtol)
    except (LinearSolveFailed, PETSc.Error, np.linalg.LinAlgError) as error:
        raise QPNotSolved(
            f"Active set: {reason}. The interior point failed as well ({error}). "
            "Most often a body is unconstrained: add a support or a load that closes the contact."
        ) from error
    note = f"handed to the interior point: {reason}. {solution.note}".strip()
    return replace(solution, note=note, definite=definite)


@dataclass(frozen=True)
class _Found:
    """A solution with friction or scalars."""

    x: Floats  # (n,)
    q: Floats  # (m,)
    state: State
    updates: int
    how: str  # friction was linearised
    visited: Bools  # (k,) which bounds were active on the way
    resistance: Floats | None  # (m, m) against q


def solve_states(
    qp: BoundQP, linear: LinearSolver, start: State, rtol: float, guess: PETSc.Vec | None = None
) -> QPSolution:
    """Solve a QP with friction or scalars; condensed where that serves; see `solve`.

    What round-off leaves of a condensed solution is solved with the whole matrix.
    """
    found, law = None, qp.friction
    if condenses(qp, linear):
        found = _find_condensed(qp, linear, start, rtol)
        at, x, z = _of_whole(qp, found)
        start, kkt = found.state, check(at, x, z)
    if found is None or not kkt.satisfied(rtol):
        found = _find(qp, linear, start, rtol, guess)
        at, x, z = _of_whole(qp, found)
        kkt = check(at, x, z)
    state, directions = found.state, None
    active = state.active
    if is_noise(at, x, z):  # of which either sign is as good as none
        active = np.where(active * z.array_r[qp.bounded] < 0.0, 0, active).astype(np.int8)
    if law is not None:
        directions = np.where(state.slips(law)[:, None], state.directions, 0.0)
    return QPSolution(
        *(x, z, active, kkt, found.updates, 0, 0, "active-set"),
        sliding=directions,
        linearisation="" if law is None else found.how,
        travel=None if qp.scalars is None else found.q,
        resistance=found.resistance,
    )


def _of_whole(qp: BoundQP, found: _Found) -> tuple[BoundQP, PETSc.Vec, PETSc.Vec]:
    """Return the QP with the scalars that are found, x, and b - A x there; collective."""
    at = qp if qp.scalars is None else moved(qp, found.q)
    x = qp.b.duplicate()
    x.array[:] = found.x
    return at, x, reaction(at, x)


def _find_condensed(qp: BoundQP, linear: LinearSolver, start: State, rtol: float) -> _Found:
    """Solve by a dense matrix, with those bounds that are candidates; see `_find`.

    These are active in the initial state, or were in a state of the QP before, or are missed by a
    solution without them.
    """
    law, comm = qp.friction, qp.comm
    candidates: Bools = (start.active != 0) | np.isin(qp.bounded, linear.visited)
    if law is not None:
        candidates[law.normal[law.cohesion > 0.0]] = True
    whole = linear.setup.preconditioner.schur is not None
    if whole or not any_rank(comm, candidates.any())[0]:
        candidates[:] = True
    while True:
        last = linear.condensed
        if not (isinstance(last, Condensed) and last.is_of(qp)):
            last = None
        part, some = select(qp, candidates | (False if last is None else last.holds(qp)))
        try:
            on = np.isin(qp.bounded, part.bounded)
            begin = State(start.active[on], start.directions[some], start.stiffness[some])
            if last is None or not last.serves(part):
                held, (lower, upper) = begin.active != 0, part.bounds()
                at = part.bounded[held], np.where(begin.active > 0, upper, lower)[held]
                last = linear.condensed = Condensed(part, linear, *at)
            found = _solve_dense(last, part, begin, rtol)
        except (LinearSolveFailed, QPNotSolved, NoResistance):
            if not any_rank(comm, not candidates.all())[0]:
                raise
            candidates[:] = True
            continue
        x = last.expand(found.x, found.q)
        w = x[qp.bounded]
        lower, upper = (qp if qp.scalars is None else moved(qp, found.q)).bounds()
        beyond = np.where(on, 0.0, np.maximum(w - upper, lower - w))
        deepest = float(maximum(comm, beyond.max(initial=0.0))[0])
        if not deepest > 0.0:
            break
        candidates |= on | (w > upper - deepest) | (w < lower + deepest)
    linear.visited = part.bounded[found.visited]
    state = State(0 * start.active, 0.0 * start.directions, 0.0 * start.stiffness)
    state.active[on] = found.state.active
    state.directions[some], state.stiffness[some] = found.state.directions, found.state.stiffness
    return replace(found, x=x, state=state)


def _solve_dense(condensed: Condensed, part: BoundQP, start: State, rtol: float) -> _Found:
    """Solve the condensed QP on rank 0; return x of all ranks, and this rank's state; collective.

    Args:
        condensed: the dense matrix.
        part: the QP of its unknowns.
        start: initial state.
        rtol: tolerance.
    """
    small, gather, dense = condensed.select(part), condensed.gather, condensed.dense
    begin = State(gather(start.active), gather(start.directions), gather(start.stiffness))

    def solve() -> tuple[_Found, int]:
        found = _find(small, dense, begin, rtol)
        return found, dense.negative(found.state.held(small))

    found, condensed.linear.beyond = on_root(part.comm, solve)
    state, counts = found.state, (len(start.active), len(start.directions))
    before = np.array(part.comm.allgather(counts))[: part.comm.rank].sum(axis=0, dtype=int)
    bounds, nodes = (slice(n, n + count) for n, count in zip(before, counts, strict=True))
    own = State(state.active[bounds], state.directions[nodes], state.stiffness[nodes])
    return replace(found, state=own, visited=found.visited[bounds])


def _find(
    qp: BoundQP, linear: Solver, start: State, rtol: float, guess: PETSc.Vec | None = None
) -> _Found:
    """Solve with friction or scalars.

    Raises:
        QPNotSolved: if no way converges.
        NoResistance: if nothing resists a scalar.
    """
    border = None if qp.scalars is None else Bordered(qp, linear)
    qp = replace(qp, friction=qp.friction or no_friction())
    at: tuple[BoundQP, Solver] = qp, linear
    if border is not None:
        at = border.qp, border
        rtol *= min(1.0, ratio(qp.b.norm(), border.qp.b.norm()))  # of the forces on x alone
    x, state, before = at[0].b.duplicate(), start, np.inf
    visited: Bools = start.active != 0
    x.set(0.0)
    if guess is not None:
        x.array[: guess.local_size] = guess.array_r
    while True:
        problem = HeldProblem(*at, x, rtol)
        outcome, how = _solve_law(problem, state)
        state, visited = outcome.state, visited | problem.visited
        ended = state, outcome.updates, how, visited
        if border is None:
            return _Found(x.array_r, np.zeros(0), *ended, None)
        values, q = border.at(x.array_r)
        if not border.rho.any() or border.is_met(q):
            return _Found(values, q, *ended, border.resistance() + np.diag(border.proximal()))
        left = border.force_of_term(q)
        if not left.max() <= 0.5 * before:  # the load moves its tool on and on, or until it touches
            border.share /= 16.0
        if border.share < EPS:
            raise NoResistance(left)
        before = left.max()
        border.hold(None)


def _solve_law(problem: HeldProblem, start: State) -> tuple[Outcome[State], str]:
    """Solve with friction: by consistent linearisation, or else by iteration over given limits.

    Raises:
        QPNotSolved: if neither converges.
    """
    outcome = _update_frictional(problem, start, LOOSE)
    if not outcome.reason:
        return outcome, EXACT
    try:
        found = _solve_given(problem, problem.best.state if problem.best else start)
    except LinearSolveFailed:
        found = None
    if found is None:
        raise QPNotSolved(f"active set with friction: {outcome.reason}")
    return found, GIVEN


def _solve_given(problem: HeldProblem, state: State) -> Outcome[State] | None:
    """Solve for the friction limits of the last solution until they agree; None if they do not."""
    qp, law = problem.qp, problem.qp.friction
    assert law is not None
    problem.solve(state, TIGHT)
    for _ in range(LIMIT):
        pressing = np.where(state.active > 0, problem.z.array_r[qp.bounded], 0.0)
        limits = law.limit(pressing[law.normal])
        given = replace(law, coefficient=0.0 * limits, cohesion=limits)
        at = problem.linear, problem.x, problem.rtol
        problem = HeldProblem(replace(qp, friction=given), *at)
        convex = law.plane and qp.definite
        found = (descend if convex else _update_frictional)(problem, state, TIGHT)
        if found.reason:
            return None
        state = found.state
        if check(qp, problem.x, problem.z).satisfied(problem.rtol):
            return found
    return None


def _update_frictional(problem: HeldProblem, start: State, level: int) -> Outcome[State]:
    """Update the state of all nodes at once, then only of those with the largest error.

    All at once, states may cycle, or leave a body unconstrained that few nodes hold. In the plane
    the descent, which always ends, is used against cycles instead.
    """
    outcome, first = Outcome(start, 0, "not tried"), start
    law = problem.qp.friction
    assert law is not None
    for worst in (False, True):
        try:
            hold = partial(problem.hold, worst=worst)
            outcome = update(hold, first, problem.qp.comm, level=level)
            if not outcome.reason:
                return outcome
            first = problem.best.state if problem.best else start
        except LinearSolveFailed as error:
            reason = f"an active set could not be solved ({error})"
            outcome, first = Outcome(first, 0, reason), State.holding(problem.qp)
            problem.forget()
        level = TIGHT
    return outcome

# SPDX-License-Identifier: MIT
"""Primal-dual active set: semi-smooth Newton on z = max(0, z + c (x - upper)), and on lower bounds.

With friction also on z_t = q min(1, s / |q|), see `qp.bound_qp`.
"""

from dataclasses import dataclass, replace
from functools import partial

from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.parallel import from_callbacks
from dolfinx_mortar.common.arrays import EPS, LIMIT, Floats
from dolfinx_mortar.qp.bound_qp import (
    BoundQP,
    Friction,
    QPNotSolved,
    QPSolution,
    check,
    is_noise,
    reaction,
)
from dolfinx_mortar.qp.condensed import Condensed
from dolfinx_mortar.qp.held import (
    LOOSE,
    SHARE,
    TIGHT,
    HeldProblem,
    Outcome,
    Solver,
    State,
    nearest,
    update,
)
from dolfinx_mortar.qp.linear import LinearSolveFailed, LinearSolver
from dolfinx_mortar.qp.scalars import Bordered, NoResistance, moved

FEW = (
    "Where few nodes touch, as at a corner or on a coarse mesh, they may open and close in turn: "
    "refine the mesh there, take smaller steps, or prescribe displacements instead of loads"
)


@dataclass(frozen=True)
class _Found:
    outcome: Outcome
    x: Floats  # (n,)
    q: Floats | None = None  # (m,)
    resistance: Floats | None = None  # (m, m) of q


@from_callbacks()
def solve(
    qp: BoundQP,
    linear: LinearSolver,
    *,
    start: State,
    rtol: float,
    guess: PETSc.Vec | None = None,
) -> QPSolution:
    """Solve a bound-constrained QP by active-set updates, condensed where possible (collective).

    The active set of the solution is that of the last linear system; weakly active unknowns may be
    in either state. `guess` (n,) is the first x.

    Raises:
        QPNotSolved: if no updates end.
        LinAlgError: if the check of a condensed one fails.
    """
    if linear.schur is None:
        return _solution(qp, _find(qp, linear, start, rtol, guess))
    condensed, x = Condensed(qp, linear, SHARE * rtol * qp.b.norm()), None
    for _ in range(2):
        at = condensed.about(x)
        found = _find(at, condensed.dense, start, rtol)
        start, x = found.outcome.state, condensed.expand(found.x)
        linear.beyond = condensed.dense.negative(start.held(at))
        solution = _solution(qp, replace(found, x=x))
        if solution.kkt.satisfied(rtol):
            return solution
    raise np.linalg.LinAlgError


def _solution(qp: BoundQP, found: _Found) -> QPSolution:
    """Solution with its check, of the QP moved by its scalars; collective."""
    at = qp if found.q is None else moved(qp, found.q)
    x, outcome = qp.b.duplicate(), found.outcome
    x.array[:] = found.x
    z, active, directions = reaction(at, x), outcome.state.active, None
    if is_noise(at, x, z):
        active = np.where(active * z.array_r[qp.bounded] < 0.0, 0, active).astype(np.int8)
    if (law := qp.friction) is not None:
        slips = outcome.state.slips(law)[:, None]
        directions = np.where(slips, outcome.state.directions, 0.0)
    return QPSolution(
        *(x, z, active, check(at, x, z), outcome.updates, 0, 0, "active-set"),
        sliding=directions,
        linearisation="" if law is None else outcome.linearisation,
        travel=found.q,
        resistance=found.resistance,
    )


def _find(
    qp: BoundQP, linear: Solver, start: State, rtol: float, guess: PETSc.Vec | None = None
) -> _Found:
    """Solve by states; QPNotSolved if no method converges, NoResistance if a scalar is free."""
    border = None if qp.scalars is None else Bordered(qp, linear)
    at: tuple[BoundQP, Solver] = qp, linear
    most = np.inf
    if border is not None:
        at, most = (border.qp, border), min(rtol * qp.b.norm(), border.scalars.noise.min())
    x, state, before = at[0].b.duplicate(), start, np.inf
    x.set(0.0)
    if guess is not None:
        x.array[: guess.local_size] = guess.array_r
    while True:
        problem = HeldProblem(*at, x, rtol, most)
        outcome = _solve_law(problem, state)
        state = outcome.state
        if border is None:
            return _Found(outcome, x.array_r)
        values, q = border.at(x.array_r)
        left = np.abs(border.rho * (q - border.centre))
        # round-off of e.z, and what is missing
        if not border.rho.any() or (left <= 2.0 * border.least).all():
            return _Found(outcome, values, q, border.resistance() + np.diag(border.proximal()))
        left /= np.sqrt(border.weights)
        if not left.max() <= 0.5 * before:  # the load moves its tool until contact, or for ever
            border.share /= 16.0
        if border.share < EPS:
            raise NoResistance(left)
        before = left.max()
        border.hold(None)


def _solve_law(problem: HeldProblem, start: State) -> Outcome:
    """Solve by consistent linearisation, else by given friction limits; else QPNotSolved."""
    outcome = _update(problem, start, TIGHT if problem.linear.exact else LOOSE)
    if not outcome.reason:
        return outcome
    found, cause = None, None
    if (law := problem.qp.friction) is not None:
        try:
            found = _solve_given(problem, law, problem.best or start)
        except LinearSolveFailed as error:
            cause = error
    if found is None:
        raise QPNotSolved(f"active set: {outcome.reason}. {FEW}") from cause
    return replace(found, linearisation="given limits")


def _solve_given(problem: HeldProblem, law: Friction, state: State) -> Outcome | None:
    """Iterate over the friction limits; None if they do not converge."""
    qp = problem.qp
    problem.solve(state, TIGHT)
    for _ in range(LIMIT):
        pressing = np.where(state.active > 0, problem.z.array_r[qp.bounded], 0.0)
        limits = law.limit(pressing[law.normal])
        given = replace(law, coefficient=0.0 * limits, cohesion=limits)
        at = problem.linear, problem.x, problem.rtol, problem.most
        problem = HeldProblem(replace(qp, friction=given), *at)
        found = _update(problem, state, TIGHT)
        if found.reason:
            return None
        state = found.state
        if check(qp, problem.x, problem.z).satisfied(problem.rtol):
            return found
    return None


def _update(problem: HeldProblem, start: State, level: int) -> Outcome:
    """Update all nodes; if that cycles or leaves a body free, only those with the largest error."""
    outcome, first = Outcome(start, 0, "not tried"), start
    for worst in (False, True):
        try:
            hold = partial(problem.hold, worst=worst)
            outcome = update(hold, first, problem.qp.comm, level=level)
            if not outcome.reason:
                return outcome
            first = problem.best or start
        except LinearSolveFailed as error:
            reason = f"an active set could not be solved ({error})"
            outcome = Outcome(first, 0, reason)
            first = State.create(problem.qp, nearest(problem.qp))
            problem.x.set(0.0)
            problem.z = problem.qp.b.copy()
        level = TIGHT
    return outcome

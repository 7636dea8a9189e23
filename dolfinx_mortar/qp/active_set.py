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
from dolfinx_mortar.qp.scalars import Bordered, NoResistance, moved, no_friction

# Friction limits by the pressure of this solution, or of the previous one
EXACT, GIVEN = "exact linearisation", "given limits"
FEW = (
    "Where few nodes touch, as at a corner or on a coarse mesh, they may open and close in turn: "
    "refine the mesh there, take smaller steps, or prescribe displacements instead of loads"
)


@dataclass(frozen=True)
class _Found:
    x: Floats  # (n,)
    q: Floats  # (m,)
    state: State
    updates: int
    how: str  # linearisation of friction
    resistance: Floats | None  # (m, m) of q


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
        linear.beyond = condensed.dense.negative(found.state.held(at))
        start, x = found.state, condensed.expand(found.x)
        solution = _solution(qp, replace(found, x=x))
        if solution.kkt.satisfied(rtol):
            return solution
    raise np.linalg.LinAlgError


def _solution(qp: BoundQP, found: _Found) -> QPSolution:
    """Solution with its check, of the QP moved by its scalars; collective."""
    at = qp if qp.scalars is None else moved(qp, found.q)
    x = qp.b.duplicate()
    x.array[:] = found.x
    z, active, directions = reaction(at, x), found.state.active, None
    if is_noise(at, x, z):
        active = np.where(active * z.array_r[qp.bounded] < 0.0, 0, active).astype(np.int8)
    if (law := qp.friction) is not None:
        slips = found.state.slips(law)[:, None]
        directions = np.where(slips, found.state.directions, 0.0)
    return QPSolution(
        *(x, z, active, check(at, x, z), found.updates, 0, 0, "active-set"),
        sliding=directions,
        linearisation="" if law is None else found.how,
        travel=None if qp.scalars is None else found.q,
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
        outcome, how = _solve_law(problem, state)
        state, ended = outcome.state, (outcome.state, outcome.updates, how)
        if border is None:
            return _Found(x.array_r, np.zeros(0), *ended, None)
        values, q = border.at(x.array_r)
        left = np.abs(border.rho * (q - border.centre))
        # round-off of e.z, and what is missing
        if not border.rho.any() or (left <= 2.0 * border.least).all():
            return _Found(values, q, *ended, border.resistance() + np.diag(border.proximal()))
        left /= np.sqrt(border.weights)
        if not left.max() <= 0.5 * before:  # the load moves its tool until contact, or for ever
            border.share /= 16.0
        if border.share < EPS:
            raise NoResistance(left)
        before = left.max()
        border.hold(None)


def _solve_law(problem: HeldProblem, start: State) -> tuple[Outcome, str]:
    """Solve by consistent linearisation, else by given friction limits; else QPNotSolved."""
    outcome = _update(problem, start, TIGHT if problem.linear.exact else LOOSE)
    if not outcome.reason:
        return outcome, EXACT
    law, found, cause = problem.qp.friction, None, None
    try:
        found = None if law is None else _solve_given(problem, problem.best or start)
    except LinearSolveFailed as error:
        cause = error
    if found is not None:
        return found, GIVEN
    kind = "" if law is None or not law.normal.size else " with friction"
    raise QPNotSolved(f"active set{kind}: {outcome.reason}. {FEW}") from cause


def _solve_given(problem: HeldProblem, state: State) -> Outcome | None:
    """Iterate over the friction limits; None if they do not converge."""
    qp, law = problem.qp, problem.qp.friction or no_friction()
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
            outcome, first = (
                Outcome(first, 0, reason),
                State.create(problem.qp, nearest(problem.qp)),
            )
            problem.forget()
        level = TIGHT
    return outcome

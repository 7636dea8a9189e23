# SPDX-License-Identifier: MIT
"""Primal-dual active set: semi-smooth Newton on z = max(0, z + c (x - upper)), and on lower bounds.

With friction also on z_t = q min(1, s / |q|), see `qp.friction`.

If there are few bounded unknowns, the `condensed` QP predicts the active set, and the updates check
it. Without friction and with a definite matrix, the interior point takes over after a cycle, and
after a set that leaves a body unconstrained.
"""

from dataclasses import replace
from functools import partial

from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.errors import from_callbacks
from dolfinx_mortar.arrays import LIMIT
from dolfinx_mortar.qp import condensed, interior_point
from dolfinx_mortar.qp.bound_qp import BoundQP, QPNotSolved, QPSolution, check
from dolfinx_mortar.qp.descent import descend
from dolfinx_mortar.qp.held import HeldProblem, State
from dolfinx_mortar.qp.linear import LinearSolveFailed, LinearSolver, NotDefinite
from dolfinx_mortar.qp.updates import LOOSE, TIGHT, Outcome, update

# How friction was linearised: limits of the pressure of the solution, or of a solution before it
EXACT, GIVEN = "exact linearisation", "given limits"


@from_callbacks()
def solve(
    qp: BoundQP,
    linear: LinearSolver,
    *,
    start: State,
    changes: int | None,
    rtol: float,
    guess: PETSc.Vec | None = None,
) -> QPSolution:
    """Solve a bound-constrained QP by active-set updates (collective).

    Args:
        start: initial active set and directions of slip.
        changes: bounded unknowns in which the solution is expected to differ from the initial set;
            None for any number. Each may cost an iteration. If they cost more than a factorisation,
            the condensed QP predicts the set (always to predict it would take plastic steps of
            benchmarks/hertz_2d.py with 50 thousand unknowns 4 more factorisations).
        guess: (n,) first x, 0 by default.

    Returns:
        The solution; its active set is that of the last linear system, in which weakly active
        unknowns may be in either state.

    Raises:
        QPNotSolved: if the interior point, called after a cycle or a failed solve, fails too.
    """
    x = qp.b.duplicate()
    x.set(0.0)
    if guess is not None:
        guess.copy(x)
    if qp.friction is not None:
        return _solve_frictional(qp, linear, x, start, rtol)
    definite = True
    try:
        level, first = LOOSE, start
        if condensed.is_worthwhile(qp, linear):
            level = TIGHT
            if changes is None or changes > linear.setup.renewal.after:
                guess = condensed.predict(qp, linear, x, start.active, rtol=rtol)
                first = replace(start, active=guess)
        problem = HeldProblem(qp, linear, x, rtol)
        outcome = update(problem.hold, first, qp.comm, level=level)
        if not outcome.reason:
            found = problem.solution(outcome, "active-set")
            return replace(found, changes=problem.count_changes(start, outcome.state))
        reason = outcome.reason
    except LinearSolveFailed as error:
        reason = f"an active set could not be solved ({error})"
        definite = not isinstance(error, NotDefinite)
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


def _solve_frictional(
    qp: BoundQP, linear: LinearSolver, x: PETSc.Vec, start: State, rtol: float
) -> QPSolution:
    """Solve with friction: by consistent linearisation, or else by iteration over given limits.

    Raises:
        QPNotSolved: if neither converges.
    """
    problem = HeldProblem(qp, linear, x, rtol)
    outcome = _update_frictional(problem, start, LOOSE)
    if not outcome.reason:
        return replace(problem.solution(outcome, "active-set"), linearisation=EXACT)
    try:
        found = _solve_given(problem, problem.best.state if problem.best else State.holding(qp))
    except LinearSolveFailed:
        found = None
    if found is None:
        raise QPNotSolved(f"Active set with friction: {outcome.reason}")
    return replace(found, linearisation=GIVEN)


def _solve_given(problem: HeldProblem, state: State) -> QPSolution | None:
    """Solve for the friction limits of the last solution until they agree; None if they do not."""
    qp, law = problem.qp, problem.qp.friction
    assert law is not None
    problem.solve(state, TIGHT)
    for _ in range(LIMIT):
        pressing = np.where(state.active > 0, problem.z.array_r[qp.bounded], 0.0)
        limits = law.limit(pressing[law.normal])
        given = replace(law, coefficient=0.0 * limits, cohesion=limits)
        problem = HeldProblem(replace(qp, friction=given), problem.linear, problem.x, problem.rtol)
        convex = law.plane and qp.definite
        found = (descend if convex else _update_frictional)(problem, state, TIGHT)
        if found.reason:
            return None
        state = found.state
        kkt = check(qp, problem.x, problem.z)
        if kkt.satisfied(problem.rtol):
            return replace(problem.solution(found, "active-set"), kkt=kkt)
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
            if not outcome.reason or law.plane:
                return outcome
            first = problem.best.state if problem.best else start
        except LinearSolveFailed as error:
            reason = f"an active set could not be solved ({error})"
            outcome, first = Outcome(first, 0, reason), State.holding(problem.qp)
            problem.forget()
        level = TIGHT
    return outcome

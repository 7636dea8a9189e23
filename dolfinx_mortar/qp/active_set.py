# SPDX-License-Identifier: MIT
"""Primal-dual active set: semi-smooth Newton on z = max(0, z + c (x - upper)) and its mirror image.

With friction on z_t = q min(1, s / |q|) as well, linearised exactly (`qp.friction`).

Where the bounded unknowns are few, `condensed` guesses the set first, and the updates only check
it. Without friction and with a definite matrix, a cycle, and a set that leaves a body free, are
handed to the interior point.
"""

from dataclasses import replace
from functools import partial

from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.qp import condensed, interior_point
from dolfinx_mortar.qp.bound_qp import BoundQP, QPNotSolved, QPSolution, check
from dolfinx_mortar.qp.descent import descend
from dolfinx_mortar.qp.held import HeldProblem, State
from dolfinx_mortar.qp.linear import LinearSolveFailed, LinearSolver
from dolfinx_mortar.qp.updates import LIMIT, LOOSE, TIGHT, Outcome, update

# Of the largest error, from which on nodes with friction change sides: all of them, those half as
# bad as the worst, the worst alone. Tried one after the other.
SHARES = (0.0, 0.5, 1.0)
# How friction was linearised: limits follow the pressure of the solution, or of the one before it
EXACT, GIVEN = "exact linearisation", "given limits"


def solve(
    qp: BoundQP, linear: LinearSolver, *, start: State, changes: int | None, rtol: float
) -> QPSolution:
    """Solve a bound-constrained QP by active-set updates (collective).

    Args:
        qp: the problem.
        linear: linear solver, attached to qp.A.
        start: first active set, and how closed nodes slip.
        changes: bounded unknowns in which the solution is expected to differ from the first set,
            None if that may be any number. Each may cost an iteration; more of them than a
            factorisation is worth are better guessed by `condensed`. Were all guessed, plastic
            steps of benchmarks/hertz_2d.py with 50 thousand unknowns would take 45 solves and 10
            factorisations instead of 40 and 6.
        rtol: tolerance of the check.

    Returns:
        The solution; its active set is one that solved the linear system, so that weakly active
        unknowns may be on either side.

    Raises:
        QPNotSolved: if the interior point, called after a cycle or a failed solve, fails too.
    """
    x = qp.b.duplicate()
    x.set(0.0)
    if qp.friction is not None:
        return _solve_frictional(qp, linear, x, start, rtol)
    try:
        level, first = LOOSE, start
        if condensed.is_worthwhile(qp, linear):
            level = TIGHT
            if changes is None or changes > linear.attached.renewal.after:
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
    return _hand_over(qp, linear, rtol, reason)


def _solve_frictional(
    qp: BoundQP, linear: LinearSolver, x: PETSc.Vec, start: State, rtol: float
) -> QPSolution:
    """Solve with friction: exactly linearised, or else for given limits again and again.

    Raises:
        QPNotSolved: if that fails, too.
    """
    problem = HeldProblem(qp, linear, x, rtol)
    outcome = _update_frictional(problem, start, LOOSE)
    if not outcome.reason:
        return replace(problem.solution(outcome, "active-set"), linearisation=EXACT)
    try:
        found = _solve_given(problem, problem.best or State.holding(qp))
    except LinearSolveFailed:
        found = None
    if found is None:
        raise QPNotSolved(f"Active set with friction: {outcome.reason}")
    return replace(found, linearisation=GIVEN)


def _solve_given(problem: HeldProblem, state: State) -> QPSolution | None:
    """Solve for the limits of the last solution until they are its own; None if it does not end."""
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
    """Update until a state stays: at first all nodes change sides at once, then only the worst.

    All at once, they may go in circles, or let go of a body that only some of them hold. Against
    circles there is a descent in the plane, which is sure to end.
    """
    outcome, first = Outcome(start, 0, "not tried"), start
    law = problem.qp.friction
    assert law is not None
    for share in SHARES:
        try:
            hold = partial(problem.hold, share=share)
            outcome = update(hold, first, problem.qp.comm, level=level)
            if not outcome.reason or law.plane:
                return outcome
            first = problem.best or start
        except LinearSolveFailed as error:
            reason = f"an active set could not be solved ({error})"
            outcome, first = Outcome(first, 0, reason), State.holding(problem.qp)
            problem.forget()
        level = TIGHT
    return outcome


def _hand_over(qp: BoundQP, linear: LinearSolver, rtol: float, reason: str) -> QPSolution:
    """Let the interior point finish, and say so."""
    if not qp.definite:
        raise QPNotSolved(f"Active set: {reason}. The matrix is not said to be definite.")
    try:
        solution = interior_point.solve(qp, linear, rtol=rtol)
    except (LinearSolveFailed, PETSc.Error, np.linalg.LinAlgError) as error:
        raise QPNotSolved(
            f"Active set: {reason}. The interior point failed as well ({error}). "
            "Most often a body can float away: add a support or a load that closes the contact."
        ) from error
    note = f"handed to the interior point: {reason}. {solution.note}".strip()
    return replace(solution, note=note)

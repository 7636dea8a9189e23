# SPDX-License-Identifier: MIT
"""Primal-dual active set: semi-smooth Newton on z = max(0, z + c (x - upper)) and its mirror image.

Where the bounded unknowns are few, `condensed` finds the set first, and the updates only check it.
A cycle, and a set that leaves a body free, are handed to the interior point.
"""

from dataclasses import replace

from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.arrays import Actives
from dolfinx_mortar.qp import condensed
from dolfinx_mortar.qp.backends import interior_point
from dolfinx_mortar.qp.bound_qp import BoundQP, QPNotSolved, QPSolution, on_bounded
from dolfinx_mortar.qp.held import HeldProblem
from dolfinx_mortar.qp.linear import LinearSolveFailed, LinearSolver
from dolfinx_mortar.qp.updates import LOOSE, TIGHT, Outcome, update


def solve(qp: BoundQP, linear: LinearSolver, *, start: Actives, rtol: float) -> QPSolution:
    """Solve a bound-constrained QP by active-set updates (collective).

    Args:
        qp: the problem.
        linear: linear solver, attached to qp.A.
        start: (k,) first active set.
        rtol: tolerance of the check.

    Returns:
        The solution; its active set is one that solved the linear system, so that weakly active
        unknowns may be on either side.

    Raises:
        QPNotSolved: if the interior point, called after a cycle or a failed solve, fails too.
    """
    x = qp.b.duplicate()
    x.set(0.0)
    try:
        level, first = LOOSE, start
        if condensed.is_worthwhile(qp, linear):
            level = TIGHT
            if not _expects_few_changes(linear):
                first = _predict(qp, linear, x, start, rtol)
        problem = HeldProblem(qp, linear, x, rtol)
        outcome = update(problem.hold, first, qp.comm, level=level)
        if not outcome.reason:
            _remember_changes(problem, start, outcome)
            return problem.solution(outcome, "active-set")
        reason = outcome.reason
    except LinearSolveFailed as error:
        reason = f"an active set could not be solved ({error})"
    return _hand_over(qp, linear, start, rtol, reason)


def _predict(
    qp: BoundQP, linear: LinearSolver, x: PETSc.Vec, start: Actives, rtol: float
) -> Actives:
    """Return what the model says, or the start: a model that breaks down is only a lost guess."""
    try:
        return condensed.predict(qp, linear, x, start, rtol=rtol)
    except np.linalg.LinAlgError:
        return start


def _expects_few_changes(linear: LinearSolver) -> bool:
    """Tell whether the last QP of this solver changed its first set by a few unknowns only.

    Each may cost an iteration; more of them than a factorisation is worth are better predicted.
    Were all predicted, plastic steps of benchmarks/hertz_2d.py with 50 thousand unknowns would take
    31 to 37 solves and 10 to 11 factorisations instead of 30 to 36 and 7 to 8.
    """
    changes = linear.learnt.changes
    return changes is not None and changes <= linear.refactor_after


def _remember_changes(problem: HeldProblem, start: Actives, outcome: Outcome) -> None:
    found = on_bounded(problem.qp, problem.x, problem.z)
    noise = problem.rtol * problem.z.norm()
    strong = found.strong(start, outcome.active, noise)
    changes = int(problem.qp.comm.allreduce(int(strong.sum())))
    problem.linear.learnt = replace(problem.linear.learnt, changes=changes)


def _hand_over(
    qp: BoundQP, linear: LinearSolver, start: Actives, rtol: float, reason: str
) -> QPSolution:
    """Let the interior point finish, and say so."""
    try:
        solution = interior_point.solve(qp, linear, start=start, rtol=rtol)
    except (LinearSolveFailed, PETSc.Error, np.linalg.LinAlgError) as error:
        raise QPNotSolved(
            f"Active set: {reason}. The interior point failed as well ({error}). "
            "Most often a body can float away: add a support or a load that closes the contact."
        ) from error
    note = f"handed to the interior point: {reason}. {solution.note}".strip()
    return replace(solution, note=note)

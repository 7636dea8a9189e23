# SPDX-License-Identifier: MIT
"""A try at a load step: undone if it fails, and made again if multigrid may be why."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from dolfinx_mortar.qp import QPNotSolved
from dolfinx_mortar.steps import failures
from dolfinx_mortar.steps.problem import ContactProblem
from dolfinx_mortar.steps.report import NewtonNotConverged, StepReport


@contextmanager
def undone_on_failure(problem: ContactProblem, report: StepReport) -> Iterator[None]:
    """Put the displacement and the results back if the step fails; complete the report anyway."""
    before, shown = problem.u.x.array.copy(), problem.solid.keep()
    earlier = dict(problem.timings.seconds)
    try:
        with problem.timings("total"), failures.named(problem, report):
            yield
    except BaseException:  # perhaps of this rank only, which must not wait for the others
        problem.u.x.array[:] = before
        problem.solid.put_back(shown)
        raise
    finally:
        report.seconds = problem.timings.since(earlier)
        report.linear_solver = problem.linear.description
        if report.converged and (unread := problem.linear.unused_options()):
            report.notes.append(
                f"petsc_options without effect: {', '.join(unread)}; misspelt, or of no use here"
            )
        report.notes += [note for note in problem.system.notes if note not in report.notes]


def again_factorised(
    problem: ContactProblem, failure: NewtonNotConverged, attempt: Callable[[], StepReport]
) -> StepReport:
    """Make a step again with a factorisation in place of multigrid; collective.

    The next steps keep it if that succeeds; otherwise multigrid was not the cause, and stays.

    Raises:
        NewtonNotConverged: the failure, if no QP was its cause, if the user has chosen the linear
            solver, or if the matrix is too large; that of the second try.
    """
    multigrid = problem.linear
    by_solver = isinstance(failure.__cause__, QPNotSolved)
    instead = multigrid.factorising() if by_solver else None
    if instead is None:
        raise failure
    problem.linear = instead
    try:
        report = attempt()
    except BaseException:
        instead.clear()
        problem.linear = multigrid
        raise
    report.notes.append(
        f"{multigrid.description} gave no solution: this step and the next ones are factorised"
    )
    return report

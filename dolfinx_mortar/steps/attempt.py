# SPDX-License-Identifier: MIT
"""A try at a load step: undone if it fails, and made again with another solver."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from dolfinx_mortar.qp import LinearSolver
from dolfinx_mortar.steps import failures
from dolfinx_mortar.steps.problem import ContactProblem
from dolfinx_mortar.steps.report import NewtonNotConverged, StepReport


@contextmanager
def undone_on_failure(problem: ContactProblem, report: StepReport) -> Iterator[None]:
    """Put the displacement and the results back if the step fails; complete the report anyway.

    Those of the interfaces too, which are set before the certificate judges them: resultants,
    pressures, slips, dissipation.
    """
    before, shown = problem.u.x.array.copy(), problem.solid.keep()
    results = [(interface, interface.keep()) for interface in problem.interfaces]
    earlier = dict(problem.timings.seconds)
    try:
        with problem.timings("total"), failures.named(problem, report):
            yield
    except BaseException:  # perhaps of this rank only, which must not wait for the others
        problem.u.x.array[:] = before
        problem.solid.put_back(shown)
        for interface, kept in results:
            interface.put_back(kept)
        raise
    finally:
        report.seconds = problem.timings.since(earlier)
        report.linear_solver = problem.linear.description
        if report.converged and (unread := problem.linear.unused_options()):
            report.notes.append(
                f"petsc_options without effect: {', '.join(unread)}; misspelt, or of no use here"
            )
        report.notes += [note for note in problem.system.notes if note not in report.notes]


@contextmanager
def solving_with(problem: ContactProblem, linear: LinearSolver) -> Iterator[None]:
    """Solve with another linear solver, and keep it unless the step fails all the same; collective.

    Then the first one was not the cause: the step was too large, or a body floats.
    """
    before, problem.linear = problem.linear, linear
    try:
        yield
    except NewtonNotConverged:
        linear.clear()
        problem.linear = before
        raise

# SPDX-License-Identifier: MIT
"""Results of a converged step: reactions, notes, certificate, data of the commit."""

from dolfinx_mortar.common.step_report import Note, StepReport
from dolfinx_mortar.persistence.committed import StepOutcome
from dolfinx_mortar.problem.contacts import Residuals, contact_forces
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.problem.step_data import check_tightening
from dolfinx_mortar.qp.linear import LinearSolveFailed
from dolfinx_mortar.report.certificate import StepEnd, create_certificate, set_results
from dolfinx_mortar.report.notes import find_notes
from dolfinx_mortar.report.reaction import support_forces
from dolfinx_mortar.steps.failures import StepFailed, describe_cells
from dolfinx_mortar.steps.subproblem import Iterate, Subproblem


def finish(
    qps: Subproblem, report: StepReport, iterate: Iterate, residual: Residuals, overlap: float
) -> None:
    """Set the results of a converged step, with a remaining initial overlap; collective.

    Raises:
        StepFailed: if a tightening is larger than the model.
    """
    problem = qps.problem
    contacts = iterate.contacts
    with problem.timings("results"):
        problem.solid.evaluate()
    if too_far := check_tightening(problem.system):
        raise StepFailed(too_far)
    slips, balances = set_results(problem, iterate.balance, contacts)
    end = StepEnd(problem, report, iterate.balance, contacts, residual, iterate.stiffness, overlap)
    negative = iterate.negative or _ends_indefinite(qps, report)
    report.notes += find_notes(end) + _notes_on_shifts(problem, report, negative)
    report.certificate = create_certificate(end, balances)
    supports = support_forces(problem, iterate.balance)  # last: no error may follow
    at, paired = problem.owned_u.copy(), problem.system.present.paired_at
    normal, tangential = -contact_forces(problem, contacts)
    ended = [interface.state(True) for interface in problem.interfaces]
    closed = contacts.active, contacts.sliding
    outcome = StepOutcome(at, *closed, paired, slips, normal, tangential, ended)
    problem.outcome, problem.committed.supports = outcome, supports
    report.converged = True


def _ends_indefinite(qps: Subproblem, report: StepReport) -> bool:
    """Whether the last tangent is indefinite, also before symmetric buckling; collective."""
    if not qps.finite or report.iterations[-1].shift:
        return False
    try:
        return qps.solver.is_indefinite()
    except LinearSolveFailed:  # singular
        return True


def _notes_on_shifts(problem: ContactProblem, report: StepReport, negative: bool) -> list[str]:
    notes, shifted = list[str](), [it.number for it in report.iterations if it.shift]
    cells = describe_cells(problem)
    if shifted:
        seen = (
            f"the tangent was indefinite in {len(shifted)} iterations, the last of them "
            f"{shifted[-1]}: up to {max(it.shift for it in report.iterations):g} times "
            "the elastic stiffness was added there"
        )
        notes.append(Note(seen, cells))
    if negative or shifted[-1:] == [len(report.iterations)]:
        seen = "the tangent is indefinite at the end: the equilibrium found is unstable"
        why = "A small disturbance leads to another one, which an imperfect mesh finds"
        notes.append(Note(seen, f"{why}. {cells}"))
    return notes

# SPDX-License-Identifier: MIT
"""Semi-smooth Newton: a bound-constrained QP at every iterate (paper, section 3).

See ARCHITECTURE.md, A Newton step. An iteration with the exact tangent that raises the residual is
undone, and repeated without.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import replace
from functools import partial
from typing import Any, Protocol

from mpi4py import MPI

import numpy as np

from dolfinx_mortar import qp as backends
from dolfinx_mortar.algebra.parallel import Relaxed, free_unused, from_callbacks, largest, ratio
from dolfinx_mortar.common.agreement import check_same_on_all_ranks
from dolfinx_mortar.common.arguments import NUMBER, check_optional
from dolfinx_mortar.common.arrays import Floats
from dolfinx_mortar.common.spaces import mean_cell_sizes
from dolfinx_mortar.common.step_report import Iteration, NewtonNotConverged, Note, StepReport
from dolfinx_mortar.interfaces.interface import Interface
from dolfinx_mortar.interfaces.link import predict_active
from dolfinx_mortar.persistence.committed import Before, Gained, StepOutcome
from dolfinx_mortar.problem.checks import check_controls, check_problem, check_tightening
from dolfinx_mortar.problem.contacts import (
    DIGIT,
    Contacts,
    Residuals,
    Scales,
    contact_forces,
    found_by,
    gap_round_off,
    go_on,
    largest_force,
    measure,
    wear_off,
)
from dolfinx_mortar.problem.linearisation import (
    Balance,
    count_changes,
    find_balance,
    find_extent,
)
from dolfinx_mortar.problem.predictors import predict
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.qp.linear import LinearSolveFailed
from dolfinx_mortar.report.certificate import StepEnd, create_certificate, set_results
from dolfinx_mortar.report.notes import find_notes
from dolfinx_mortar.report.reaction import support_forces
from dolfinx_mortar.steps import driven_tools, failures
from dolfinx_mortar.steps.line_search import take_step
from dolfinx_mortar.steps.subproblem import Iterate, Solution, Subproblem

log = logging.getLogger(__name__)

FAILED = failures.StepFailed, backends.QPNotSolved, backends.UnusableQP

# The fixed point is slow if it needs more than FEW iterations, and an update changes the contact
# forces by SHARE of the residual.
FEW = 5
SHARE = 0.5
MOST_TURNS = 50  # solutions of a step and its fields in turn; a conductance that opens takes 20


class Field(Protocol):
    """Unknowns that are solved in turn with a step, such as temperatures."""

    given: Any
    """Constants and other data that they read."""

    def solve(self, dt: float | None) -> float:
        """Solve with the step's results; return the change over the range; collective."""

    def commit(self) -> None:
        """Make this the start of the next step."""

    def undone(self) -> AbstractContextManager[None]:
        """Return to the start of the step if the block fails."""


def newton(
    problem: ContactProblem,
    *,
    qp: str = "active-set",
    rtol: float = 1e-6,
    max_it: int = 50,
    level: float | None = None,
) -> StepReport:
    """Solve one load step, from the present u and the committed state; collective.

    At the iterate u^k the QP of the quadratic model of the energy (paper, eqs. 9 and 10) starts
    from the last active set and directions of slip. A line search on J(v) + s sum_j D_jj (w_n -
    gap)_+, with s twice the largest multiplier, shortens the step, except for laws without energy.
    With geometry="updated" normals, segments, D and M are computed in every iteration, and their
    derivatives are part of the tangent where that converges faster. For multigrid that fails see
    `load_steps`.

    Args:
        problem: the bodies and their constraints; ``problem.commit()`` accepts the step.
        qp: name of the QP backend, see ``dolfinx_mortar.qp.available()``.
        rtol: tolerance of the residuals of forces and contact, relative to the largest forces of
            the step and their work; round-off is the limit.
        max_it: largest number of Newton iterations.
        level: load level at the end of the step, for terms that depend on it, see `Term.begin`.
            With `Inertia` the time; a step that has not been committed is repeated.

    Returns:
        The report of the converged step.

    Raises:
        NewtonNotConverged: with the report attached; u and the committed state are as before.
        ValueError: for an unknown backend, a bad tolerance, or other input, on all ranks.
    """
    check_problem(problem, ContactProblem)
    check_optional("level", level, NUMBER)
    solve = partial(solve_step, problem, qp=qp, rtol=rtol, max_it=max_it, level=level)
    return in_turn(problem, [], solve, level, rtol)


def in_turn(
    problem: ContactProblem,
    fields: Sequence[Field],
    solve: Callable[[], StepReport],
    level: float | None,
    rtol: float,
) -> StepReport:
    """Solve a step in turn with fields and laws of friction until all agree; collective."""
    rubbing = [(one, one.law) for one in problem.interfaces if one.law and one.law.own]
    if not (fields or rubbing):
        return solve()
    begin, before = problem.committed.level, Before(problem.state, problem.outcome)
    dt = None if level is None else abs(level - begin) or None
    for one, _ in rubbing:
        one.turns = Relaxed(problem.comm)
    report = solve()
    with problem.undone(before), ExitStack() as undone:
        for field in fields:
            undone.enter_context(field.undone())
        for _ in range(MOST_TURNS):
            changes = [field.solve(dt) for field in fields]
            changes += [law.turn(one) for one, law in rubbing]
            if max(changes) <= rtol:
                return report
            report = solve()
        raise NewtonNotConverged(
            f"forces, temperatures and friction do not agree after {MOST_TURNS} solutions in turn: "
            "take smaller steps, frozen coefficients, and conductances that change steadily: one "
            "that jumps where a contact opens may have no steady state",
            report,
        )


def solve_step(
    problem: ContactProblem,
    *,
    qp: str,
    rtol: float,
    max_it: int,
    overlap: float = 0.0,
    level: float | None = None,
) -> StepReport:
    """Solve one load step with an overlap that may remain at the end; see `newton`; collective."""
    given = {"qp": qp, "rtol": rtol, "max_it": max_it, "level": level}
    check_same_on_all_ranks(problem.comm, **given, **problem.inputs)
    check_controls(qp, rtol, max_it)
    report = StepReport(backend=qp, geometry=problem.geometry, rtol=rtol)
    if overlap > 0.0:
        report.notes.append(f"an initial overlap of {overlap:.3g} remains in this part")
    linear = problem.linear
    multigrid = linear.options.multigrid
    problem.go_back()
    last = problem.ended_here()
    before, earlier = Before(problem.state, problem.outcome), dict(problem.timings.seconds)
    try:
        with problem.timings("total"), from_callbacks():
            try:
                gained = _solve(problem, report, before, max_it, level, overlap)
                assert problem.outcome is not None
                start = before if last is None or last.before is None else last.before
                problem.outcome = replace(problem.outcome, level=level, before=start, gained=gained)
            except FAILED as error:
                reached = problem.u.x.array.copy()
                problem.undo(before)
                linear.options.multigrid = multigrid
                if not linear.direct:
                    linear.clear()  # its levels are those of undone tangents
                raise failures.explain(problem, report, error, reached) from error
            except BaseException:  # maybe on one rank only: no communication
                problem.undo(before)
                linear.options.multigrid = multigrid
                linear.abandon()
                raise
    finally:
        report.seconds = problem.timings.since(earlier)
        report.linear_solver += linear.description
        if report.converged and (unread := linear.options.unread()):
            report.notes.append(
                f"petsc_options without effect: {', '.join(unread)}; they are misspelt, or this "
                "solver does not use them"
            )
        report.notes += [
            note for note in problem.system.present.claims.notes if note not in report.notes
        ]
    problem.told[:] = [report.notes]
    return report


def _solve(
    problem: ContactProblem,
    report: StepReport,
    before: Before,
    max_it: int,
    level: float | None,
    overlap: float,
) -> Gained | None:
    """Solve a step from the prediction of the last one, or else without."""
    for predictor in (None if problem.in_time else predict, None):
        data = problem.begin_step(level, predictor)
        step = _Step(report, overlap, Subproblem(problem, data, report.backend, report.rtol))
        try:
            end = step.run(max_it)
        except (*FAILED, NewtonNotConverged):
            if data.travel is None:
                raise
            problem.undo(before)
            report.begin_anew()
        else:
            break
    now = problem.committed.level
    if level is None or level == now:
        return None
    return Gained(problem.owned_u - data.begun, end.travel, level - now)


class _Step:
    """One load step in progress."""

    def __init__(self, report: StepReport, overlap: float, qps: Subproblem) -> None:
        self.report, self.overlap, self.qps = report, overlap, qps
        self.problem, self.data = qps.problem, qps.data
        if qps.solver.direct:  # the factorisation may be that of another attempt
            qps.solver.forget(keep_definite=qps.linear)

    def run(self, max_it: int) -> Iterate:
        old = self.first()
        while len(self.report.iterations) < max_it:
            try:
                new = self.iterate(old, exact=self.is_exact(old))
            except backends.QPNotSolved:
                if not self.factorise():
                    raise
                continue
            if self.problem.comm.rank == 0:
                log.info("%s", self.report.iterations[-1])
            exact, residual = self.report.iterations[-1].exact_tangent, new.residuals[-1]
            if residual.excess <= 1.0:
                at = new.balance, new.contacts, new.stiffness
                if too_deep := wear_off(self.problem, *at):
                    raise failures.StepFailed(too_deep)
                with self.problem.timings("mortar"):
                    passed = failures.describe_passing(self.problem)
                if passed:
                    raise failures.failed(self.problem, self.report, passed)
                finish(self.qps, self.report, new, self.overlap)
                return new
            worse = exact and not self.missed(residual) <= self.missed(old.residuals[-1])
            old = self.go_back(old) if worse else new
        raise failures.StepFailed(f"Newton did not converge in max_it={max_it} iterations")

    def go_back(self, old: Iterate) -> Iterate:
        """Undo an exact step that raised the residual, and bar the exact tangent."""
        residual = old.residuals[-1]
        self.problem.move(old.u)
        for interface, kept in old.tools:
            interface.restore(kept)
        self.problem.follow_geometry()
        balance = self.balance(old.contacts)
        start = old.contacts.active[balance.nodes].astype(np.int8)
        at = replace(old, balance=balance, start=start, barred=DIGIT * self.missed(residual))
        return replace(at, residuals=[*old.residuals, residual])

    def iterate(self, old: Iterate, *, exact: bool) -> Iterate:
        problem, number, rtol = self.problem, len(self.report.iterations) + 1, self.report.rtol
        free_unused(problem.comm)
        found = self.qps.solve(old, exact=exact)
        lin, solved = found.lin, found.solved
        contacts = found_by(lin, solved, problem.n).after(old.contacts, old.balance.limits)
        penalty = max(old.penalty, largest(problem.comm, contacts.multipliers))

        moved = take_step(problem, found, penalty, old)
        norm = problem.solid.elastic_norm(problem.u)
        turned, updated = 0.0, self.qps.moving or self.qps.driven
        if updated:
            given = contact_forces(problem, contacts)
            problem.follow_geometry()
            change = (contact_forces(problem, contacts) - given).sum(axis=0)
            turned = problem.vector(change.ravel()).norm()
        balance = self.balance(contacts)
        geometry = self.gap_error(found, moved.length, balance, contacts) if updated else 0.0

        scales = old.scales
        if not old.residuals:
            lifted = problem.vector(self.data.asked)
            lifted.pointwiseMult(lifted, lin.diagonal)
            scales = replace(scales, first=float(max(lin.qp.b.norm(), lifted.norm())))
        residual = measure(problem.u, balance, contacts, lin.diagonal, scales, norm, rtol)
        residual = driven_tools.miss(problem, balance, contacts, residual, rtol)
        self.report.quote(number, solved.note or found.rejected)
        self.report.note_friction(number, solved.linearisation)
        self.report.iterations.append(
            Iteration(
                number=number,
                increment=ratio(moved.increment, old.norm + norm),
                force_residual=residual.forces,
                contact_residual=residual.contact,
                kkt=solved.kkt.worst,
                active=problem.comm.allreduce(int(contacts.active.sum())),
                changed=count_changes(lin, solved, old.start, residual.limit),
                updates=solved.updates,
                linear_iterations=solved.linear_iterations,
                factorisations=solved.factorisations,
                step_length=moved.length,
                line_search_steps=moved.halvings,
                geometry_change=geometry,
                shift=found.shift,
                exact_tangent=found.exact,
            )
        )
        contacts = contacts.completed(balance.limits)
        barred = old.barred
        if found.rejected:
            barred = DIGIT * self.missed(old.residuals[-1])
        elif old.residuals and not found.exact:
            if self.missed(residual) > self.missed(old.residuals[-1]):
                barred = np.inf
        # by the force changes of the last two updates
        many = ratio(turned, old.turned) ** FEW * residual.excess > 1.0
        return Iterate(
            problem.owned_u.copy(),
            self.tools(),
            moved.travel,
            balance,
            contacts,
            contacts.active[balance.nodes].astype(np.int8),
            scales,
            moved.energy,
            norm,
            lin.diagonal,
            penalty,
            moved.pressure,
            found.shift,
            found.negative,
            turned,
            slow=many and turned > SHARE * residual.forces * residual.limit / rtol,
            barred=barred,
            residuals=[*old.residuals, residual],
        )

    def factorise(self) -> bool:
        """Factorise from now on, if multigrid was the default; collective."""
        given_up, number = self.qps.solver.description, len(self.report.iterations) + 1
        if not self.qps.solver.give_up_multigrid():
            return False
        self.report.linear_solver = f"{given_up}, from iteration {number} on "
        self.report.notes.append(
            f"{given_up} gave no solution in iteration {number}: from there on this step and later "
            "ones are factorised (petsc_options={'pc_type': 'cholesky'} does so from the start)"
        )
        if self.problem.comm.rank == 0:
            log.warning("%s", self.report.notes[-1])
        return True

    def is_exact(self, old: Iterate) -> bool:
        if not old.residuals or old.shift or not self.qps.may_be_exact:
            return False
        if not self.missed(old.residuals[-1]) < old.barred:
            return False
        return self.qps.finite or old.slow or self.report.iterations[-1].exact_tangent

    def missed(self, residual: Residuals) -> float:
        """Residual that the exact tangent must lower."""
        return max(residual.forces, residual.contact) if self.qps.finite else residual.excess

    def tools(self) -> list[tuple[Interface, dict[str, Floats]]]:
        return [(i, i.state(False)) for i in self.problem.interfaces if i.driven() is not None]

    def first(self) -> Iterate:
        problem, flows = self.problem, self.data.flows
        balance = find_balance(problem, self.data, self.overlap, from_committed=flows)
        contacts = go_on(self.data.contacts, balance.limits, gap_round_off(problem.u))
        energy = None if flows else problem.terms.energy()
        norm = problem.solid.elastic_norm(problem.u)
        start = contacts.active[balance.nodes].astype(np.int8)
        if problem.contacts and not problem.comm.allreduce(bool(start.any()), op=MPI.LOR):
            links, length = problem.system.links, problem.system.facet_length
            start = predict_active(links, problem.positions(), problem.n, balance.nodes, length)
        extent = find_extent(problem.V.mesh, np.append(self.data.target, self.data.increment))
        begun = largest_force(problem.comm, balance, np.zeros(0))
        length = problem.system.facet_length
        cells = mean_cell_sizes(problem.V) if problem.solid.strain == "finite" else 0.0
        scales = Scales(length, begun=begun, work=norm**2, extent=extent, cells=cells)
        travel = np.zeros(0) if self.data.travel is None else self.data.travel
        place = problem.owned_u.copy(), self.tools(), travel
        return Iterate(*place, balance, contacts, start, scales, energy, norm, problem.vector())

    def balance(self, contacts: Contacts | None) -> Balance:
        multipliers = None if contacts is None else contacts.multipliers
        return find_balance(self.problem, self.data, self.overlap, multipliers)

    def gap_error(
        self, found: Solution, length: float, balance: Balance, contacts: Contacts
    ) -> float:
        """Error of predicted gaps, in facet lengths; collective."""
        bounds, gaps = found.lin.balance.bounds, np.full(self.problem.n, np.nan)
        gaps[found.lin.balance.nodes] = bounds.upper - length * found.solved.x.array_r[bounds.dofs]
        off = np.abs(balance.bounds.upper - gaps[balance.nodes])
        off = off[contacts.active[balance.nodes] & np.isfinite(off)]
        return largest(self.problem.comm, off) / self.problem.system.facet_length


def finish(qps: Subproblem, report: StepReport, iterate: Iterate, overlap: float) -> None:
    """Set the results of a converged step, with a remaining initial overlap; collective.

    Raises:
        StepFailed: if a tightening is larger than the model.
    """
    problem = qps.problem
    contacts, residual = iterate.contacts, iterate.residuals[-1]
    with problem.timings("results"):
        problem.solid.evaluate()
    if too_far := check_tightening(problem.system):
        raise failures.StepFailed(too_far)
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
    cells = failures.describe_cells(problem)
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

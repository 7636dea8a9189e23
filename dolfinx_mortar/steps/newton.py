# SPDX-License-Identifier: MIT
"""Semi-smooth Newton: a bound-constrained QP at every iterate (paper, section 3).

One iteration, at u with contacts (active set, multipliers) and a geometry:

    1  solve min 1/2 dy.K^ dy - r^.dy, lower <= dy <= upper, as accurately as the residual requires
    2  u <- u + t T dy, t by line search; the reactions of the QP are the new multipliers
    3  rebuild normals, segments, D, M and T at u, unless the geometry is frozen and Newton's method
       has not yet converged in it
    4  residuals of forces and contact at u, in that geometry, with these multipliers
    5  converged if all are within their tolerances

Updates of the geometry are a fixed-point iteration: one after every iteration while their change
or the residual decreases; otherwise the geometry is frozen until Newton's method has converged. The
motion of the surfaces is linearised, too, where that saves iterations (`Watch.is_slow`), near a
balance at finite strain, and where the fixed point fails; then Newton's method is quadratic.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx import fem
from dolfinx_mortar import qp as backends
from dolfinx_mortar.algebra.errors import from_callbacks
from dolfinx_mortar.algebra.parallel import any_rank, free_unused, maximum, ratio
from dolfinx_mortar.arguments import NUMBER, check_optional
from dolfinx_mortar.arrays import QUARTER_OF_DIGITS, Actives, Bools, Floats
from dolfinx_mortar.interfaces.near import predict_active
from dolfinx_mortar.newton_method import driven_tools, failures
from dolfinx_mortar.newton_method.contacts import Contacts, find_sliders, found_by, go_on
from dolfinx_mortar.newton_method.line_search import NoDescent, search, shorten
from dolfinx_mortar.newton_method.linearisation import (
    Balance,
    Corrections,
    Linearisation,
    count_changes,
    find_balance,
    find_extent,
    linearise,
    linearise_all,
    to_displacement,
)
from dolfinx_mortar.newton_method.residuals import (
    DIGIT,
    Residuals,
    Scales,
    gap_round_off,
    largest_force,
    measure,
    next_tolerance,
    tightest,
)
from dolfinx_mortar.newton_method.tunnelling import describe_passing
from dolfinx_mortar.newton_method.watch import (
    MOST_RISES,
    NEAR,
    Watch,
    contact_forces,
    find_change,
    normal_forces,
    tangential_forces,
)
from dolfinx_mortar.persistence.committed import Before, Gained, StepOutcome
from dolfinx_mortar.problem.checks import check_controls, check_problem
from dolfinx_mortar.problem.jumps import check_tightening
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.problem.step_data import StepData
from dolfinx_mortar.qp import LinearSolver, QPSolution
from dolfinx_mortar.qp.linear import LinearSolveFailed
from dolfinx_mortar.qp.solver import ACTIVE_SET
from dolfinx_mortar.report.certificate import create_certificate
from dolfinx_mortar.report.interface_results import set_results
from dolfinx_mortar.report.notes import StepEnd, find_notes
from dolfinx_mortar.report.pulls import find_pull
from dolfinx_mortar.report.reaction import support_forces
from dolfinx_mortar.report.small_strain import find_left_out
from dolfinx_mortar.report.uncoupled import find_crossing
from dolfinx_mortar.step_report import Iteration, NewtonNotConverged, StepReport
from dolfinx_mortar.terms.inertia import Inertia
from dolfinx_mortar.terms.sum import Energy, VolumeStep

log = logging.getLogger(__name__)

FAILED = failures.StepFailed, backends.QPNotSolved, backends.UnusableQP

# Relative residual of forces below which an indefinite tangent is used as it is, see `linearise`.
# With shifted ones it stays above 3e-3 and 6e-3 where a cube of metal of 4^3 cells is pressed to
# .55 and .5 of its height in one step, and Newton's method leaves the saddle in 30 iterations.
STABLE = 1e-2
# Multiples of the elastic stiffness that are tried one after the other where a tangent is
# indefinite. A compression by a share e of the moduli needs about e, in a slender column, whose
# elastic stiffness against bending is low, e times its length over its thickness, squared.
SHIFTS = (0.0, 0.01, 0.1, 1.0, 10.0, 100.0, 1000.0)
# How often a QP with the exact tangent is solved once more, with the parts of gap rows that T_g
# neglects. They are some per cent of the rows, so that each correction gains one to two digits:
# with 0, 1, 2, 4, 6 of them five cases in the plane take 219, 194, 192, 192, 192 iterations.
CORRECTIONS = 3


def newton(
    problem: ContactProblem,
    *,
    qp: str = "active-set",
    rtol: float = 1e-6,
    max_it: int = 50,
    level: float | None = None,
) -> StepReport:
    """Solve one load step, from the present u and the committed state; collective.

    At the iterate u^k the energy is replaced by its quadratic model (paper, eq. 9) and the
    bound-constrained QP is solved (eq. 10), warm-started from the last active set and the last
    directions of slip. A line search on J(v) + s sum_j D_jj (w_n - gap)_+, with s twice the largest
    multiplier, shortens the step; laws with a stress but no energy have no J, and no line search.
    With geometry="updated" normals, segments, D and M are computed anew in every iteration, and
    their derivatives are part of the tangent where that converges faster.

    Args:
        problem: the bodies and their constraints; ``problem.commit()`` accepts the step.
        qp: name of the QP backend, see ``dolfinx_mortar.qp.available()``.
        rtol: tolerance of the residuals of forces and contact, relative to the largest forces of
            the step and their work; round-off is the limit.
        max_it: largest number of Newton iterations.
        level: load level at the end of the step, for terms that depend on it, see `Term.begin`.
            With `Inertia` the time: a step that has not been committed is made anew.

    Returns:
        The report of the converged step.

    Raises:
        NewtonNotConverged: with the report attached; u and the committed state are as before.
        ValueError: for an unknown backend, a bad tolerance, or other input, on all ranks.
    """
    check_problem(problem, ContactProblem)
    check_optional("level", level, NUMBER)
    return solve_step(problem, qp=qp, rtol=rtol, max_it=max_it, level=level)


def solve_step(
    problem: ContactProblem,
    *,
    qp: str,
    rtol: float,
    max_it: int,
    overlap: float = 0.0,
    level: float | None = None,
    linear: LinearSolver | None = None,
) -> StepReport:
    """Solve one load step; see `newton`.

    Args:
        problem: as in `newton`.
        qp: as in `newton`.
        rtol: as in `newton`.
        max_it: as in `newton`.
        overlap: depth by which the sides may still overlap at the end, if they do at the start.
        level: as in `newton`.
        linear: linear solver of the step; that of the problem by default.
    """
    problem.check_ranks(qp=qp, rtol=rtol, max_it=max_it, level=level)
    check_controls(qp, rtol, max_it)
    report = StepReport(backend=qp, geometry=problem.geometry, rtol=rtol)
    if overlap > 0.0:
        report.notes.append(f"an initial overlap of {overlap:.3g} remains in this part")
    linear = linear or problem.linear
    problem.go_back()
    last = problem.ended_here()
    before, earlier = Before(problem.state, problem.outcome), dict(problem.timings.seconds)
    tries = _Tries(linear)
    try:
        with problem.timings("total"), from_callbacks():
            try:
                step = _solve(problem, report, tries, before, max_it, (level, overlap))
                assert problem.outcome is not None
                start = before if last is None or last.before is None else last.before
                gained = step.gained(level)
                problem.outcome = replace(problem.outcome, level=level, before=start, gained=gained)
            except FAILED as error:
                reached = problem.u.x.array.copy()
                problem.undo(before)
                problem.raise_failed()  # the cause
                if not linear.direct:
                    linear.clear()  # levels of tangents of the step that is undone
                    problem.operator.rows.forget()
                raise failures.explain(problem, report, error, reached) from error
            except BaseException:  # perhaps of this rank only: no communication
                problem.undo(before)
                linear.abandon()
                raise
    finally:
        report.seconds = problem.timings.since(earlier)
        solver = tries.solver if tries.last is None else tries.last.solver
        report.linear_solver += solver.description  # to those that another one took over from
        unread = [option for option in linear.options.unread() if option in solver.options.unread()]
        if report.converged and unread:
            report.notes.append(
                f"petsc_options without effect: {', '.join(unread)}; they are misspelt, or this "
                "solver does not use them"
            )
        report.notes += [note for note in problem.system.notes if note not in report.notes]
    return report


@dataclass
class _Tries:
    """The linear solver of a step, and what has been made of the step last."""

    solver: LinearSolver
    last: _Step | None = None


def _solve(
    problem: ContactProblem,
    report: StepReport,
    tries: _Tries,
    before: Before,
    max_it: int,
    how: tuple[float | None, float],
) -> _Step:
    """Solve a step from where the last one promises; if that fails, without; collective."""
    level, overlap = how
    predict = not any(isinstance(term, Inertia) for _, term in problem.terms.named)
    for predicted in (predict, False):
        data = problem.begin_step(level, predict=predicted)
        step = tries.last = _Step(problem, report, data, overlap, tries.solver)
        try:
            step.run(max_it)
        except (*FAILED, NewtonNotConverged):
            if data.travel is None:
                raise
            problem.undo(before)
            report.begin_anew()
        else:
            break
    return step


@dataclass(frozen=True)
class Iterate:
    """Data of an iterate for the next iteration."""

    balance: Balance
    contacts: Contacts
    scales: Scales
    energy: Energy | None  # J(u), where a line search may need it
    norm: float  # |u|_e
    largest: float  # largest multiplier so far
    stiffness: PETSc.Vec  # diagonal of the last K^
    pressure: Floats | None = None  # (owned cells,) mean stresses by the last linearisation

    @property
    def start(self) -> Actives:
        """The active set with which the next QP starts, of the nodes that have bounds now."""
        return self.contacts.active[self.balance.nodes].astype(np.int8)


@dataclass(frozen=True)
class _Solution:
    """The QP of an iteration and its solution."""

    lin: Linearisation
    solved: QPSolution
    driven: driven_tools.Settled | None  # motions of the tools that forces drive
    exact: bool  # whether it has the exact tangent of the moving geometry
    rejected: str  # why it has not, where that was tried


@dataclass(frozen=True)
class _Moved:
    """What a step along the solution of a QP has changed."""

    du: PETSc.Vec  # the whole step
    length: float  # the share of it that u has moved
    halvings: int  # of the line search
    energy: Energy | None  # J at its end
    pressure: Floats | None  # (owned cells,) mean stresses at its end, by the linearisation


class _Step:
    """One load step in progress."""

    def __init__(
        self,
        problem: ContactProblem,
        report: StepReport,
        data: StepData,
        overlap: float,
        solver: LinearSolver,
    ) -> None:
        self.problem, self.report, self.data, self.overlap = problem, report, data, overlap
        self.solver = solver
        if solver.direct:  # a step that was tried has left another factorisation
            solver.forget(keep_definite=self.linear)
        self.direction = fem.Function(problem.V)  # du, for its norm
        self.negative = False  # whether the last tangent that was used is indefinite
        self.shifted = 0  # the entry of SHIFTS that the last tangent needed
        self.start = problem.owned_u.copy()
        self.travel = np.zeros(0) if data.travel is None else data.travel  # of driven tools

    @property
    def linear(self) -> bool:
        """Whether all laws and terms are."""
        return bool(self.problem.terms.linear)

    @property
    def may_be_exact(self) -> bool:
        """Whether the motion of the surfaces can be linearised.

        With driven tools only where strains are finite and there are other contacts: a stack that
        a tool presses by a force diverges without. It has no derivative by the motions of tools,
        and with tools alone takes an iteration a step more (a cylinder on rubber: 8 and 7).
        """
        if self.report.backend != ACTIVE_SET:
            return False
        if not self.driven:
            return True
        others = [link.interface.driven() is None for link in self.problem.system.unilateral]
        return self.problem.solid.strain == "finite" and any(others)

    @property
    def driven(self) -> bool:
        """Whether tools or rigid sides are driven by forces, and move in every iteration."""
        return bool(self.problem.system.driven)

    def gained(self, level: float | None) -> Gained | None:
        """Return what the iterations have added, at the end of a step to a level."""
        now = self.problem.committed.level
        if level is None or level == now:
            return None
        by = self.problem.owned_u - self.data.begun
        return Gained(by, self.travel, level - now)

    def run(self, max_it: int) -> None:
        """Iterate until convergence; set the results and the certificate."""
        problem = self.problem
        watch = Watch(problem.geometry == "updated" and bool(problem.contacts))  # ties stay at X
        iterate, start = self.first()
        residuals = list[Residuals]()
        for number in range(1, max_it + 1):
            place, old = self.place(), iterate
            try:
                iterate, watch, residual = self.iterate(number, iterate, start, watch, residuals)
            except failures.StepFailed as error:
                raise self.told(error) from error
            if problem.comm.rank == 0:
                log.info("%s", self.report.iterations[-1])
            if self.leads_away(residual, residuals):
                self.go_back(place)
                iterate = replace(old, balance=self.balance(old.contacts))
                watch = replace(watch, barred=DIGIT * self.missed(residuals[-1]), exact=False)
                start = iterate.start
                residuals.append(residuals[-1])
                continue
            residuals.append(residual)
            if residual.excess <= 1.0:
                if self.geometry_is_complete():
                    self.check_passing()
                    self.finish(iterate, residual)
                    return
                iterate = replace(iterate, balance=self.balance(iterate.contacts))  # another T
            start = iterate.start
        end = failures.StepFailed(f"Newton did not converge in max_it={max_it} iterations")
        raise self.told(end)

    def leads_away(self, residual: Residuals, residuals: list[Residuals]) -> bool:
        """Tell whether the last iteration, with the exact tangent, has raised the residual."""
        if not self.report.iterations[-1].exact_tangent or residual.excess <= 1.0:
            return False
        return not self.missed(residual) <= self.missed(residuals[-1])

    def place(self) -> tuple[Floats, list[Any], tuple[Any, ...]]:
        """Return where the iterate and the tools that forces drive are, for `go_back`."""
        kept = [(i, i.state()) for i in self.problem.interfaces if i.driven() is not None]
        how = self.shifted, self.negative, self.travel
        return self.problem.owned_u.copy(), kept, how

    def go_back(self, place: tuple[Floats, list[Any], tuple[Any, ...]]) -> None:
        """Undo the last iteration; collective."""
        u, kept, (self.shifted, self.negative, self.travel) = place
        self.problem.owned_u[:] = u
        self.problem.u.x.scatter_forward()
        for interface, before in kept:
            interface.restore(before)
        self.problem.follow_geometry()

    def told(self, error: failures.StepFailed) -> failures.StepFailed:
        """Return the error with corners without a normal, which may be its cause; collective."""
        x, links = self.problem.positions(), self.problem.system.unilateral
        found = [failures.describe_corners(link, x) for link in links]
        corners = "; ".join(told for told in found if told)
        return failures.StepFailed(f"{corners}. {error}") if corners else error

    def first(self) -> tuple[Iterate, Actives]:
        """Return the initial iterate, and the initial active set of its QP."""
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
        cells = problem.solid.cell_sizes if problem.solid.strain == "finite" else 0.0
        scales = Scales(length, begun=begun, work=norm**2, extent=extent, cells=cells)
        return Iterate(balance, contacts, scales, energy, norm, 0.0, problem.vector()), start

    def balance(self, contacts: Contacts | None) -> Balance:
        """Return forces and constraints at u in the present geometry."""
        multipliers = None if contacts is None else contacts.multipliers
        return find_balance(self.problem, self.data, self.overlap, multipliers)

    def iterate(
        self,
        number: int,
        old: Iterate,
        start: Actives,
        watch: Watch,
        residuals: list[Residuals],
    ) -> tuple[Iterate, Watch, Residuals]:
        """Make one Newton iteration and record it in the report."""
        problem, first = self.problem, number == 1
        problem.raise_failed()
        free_unused(problem.comm)
        if watch.held and problem.solid.strain == "finite" and self.is_exact(watch, residuals):
            old, watch, residuals[-1] = self.thaw(old, watch)
            start = old.start
        found, watch = self.find_solution(number, start, old, watch, residuals)
        lin, solved = found.lin, found.solved
        self.report.quote(number, solved.note or found.rejected)
        self.report.note_friction(number, solved.linearisation)
        contacts = found_by(lin, solved, problem.n).after(old.contacts, old.balance.limits)
        multiplier = maximum(problem.comm, contacts.multipliers.max(initial=0.0))[0]
        largest = max(old.largest, float(multiplier))
        scales = replace(old.scales, first=self.first_forces(lin)) if first else old.scales

        moved = self.take_step(found, largest, old)
        norm = problem.solid.elastic_norm(problem.u)
        increment = self.elastic_norm(moved.du)
        increment = increment / (old.norm + norm) if old.norm + norm > 0.0 else 0.0

        judge = partial(self.judge, contacts, lin.diagonal, scales, norm)
        predicted = self.predicted_gaps(lin, solved, moved.length)
        before = residuals[-1] if found.exact else None
        balance, residual, watch, change = self.follow(watch, judge, contacts, predicted, before)
        self.report.iterations.append(
            Iteration(
                number=number,
                increment=increment,
                force_residual=residual.forces,
                contact_residual=residual.contact,
                kkt=solved.kkt.worst,
                active=problem.comm.allreduce(int(contacts.active.sum()), op=MPI.SUM),
                changed=count_changes(lin, solved, start, residual.limit),
                updates=solved.updates,
                linear_iterations=solved.linear_iterations,
                factorisations=solved.factorisations,
                step_length=moved.length,
                line_search_steps=moved.halvings,
                geometry_change=change,
                geometry_held=watch.held,
                shift=SHIFTS[self.shifted],
                exact_tangent=found.exact,
            )
        )
        iterate = Iterate(
            balance,
            contacts.completed(balance.limits),
            scales,
            moved.energy,
            norm,
            largest,
            lin.diagonal,
            moved.pressure,
        )
        return iterate, watch, residual

    # -- the parts of an iteration ---------------------------------------------------------------

    def find_solution(
        self,
        number: int,
        start: Actives,
        old: Iterate,
        watch: Watch,
        residuals: list[Residuals],
    ) -> tuple[_Solution, Watch]:
        """Return the QP of an iteration with its solution, and the state of the fixed point.

        With the exact tangent where that is of use; where its QP has no solution, without.
        """
        tangent = not self.linear or (number == 1 and self.problem.terms.vary(self.problem.K))
        lin, solved, rejected = None, None, ""
        if self.is_exact(watch, residuals):
            lin, solved, rejected = self.solve_exact(start, old, watch, residuals, tangent)
            if rejected:
                watch = watch.after_exact(np.inf, self.missed(residuals[-1]))
        exact = solved is not None
        if lin is None or solved is None:
            accuracy = partial(self.accuracy, watch=watch, residuals=residuals)
            near = bool(residuals) and residuals[-1].forces < STABLE
            lin, solved = self.linearise(old, start, tangent, accuracy, near=near)
        return _Solution(*self.drive(lin, solved, old), exact, rejected), watch

    def take_step(self, found: _Solution, largest: float, old: Iterate) -> _Moved:
        """Move u, and tools that forces drive, along the solution of the QP; collective.

        Args:
            found: the QP and its solution.
            largest: largest multiplier so far.
            old: the iterate before.
        """
        problem, lin = self.problem, found.lin
        T = problem.system.transformation if lin.geometry is None else lin.geometry.trial
        du = to_displacement(T, found.solved.x)
        self.check_distance(du, old.scales.extent)
        volumes = problem.solid.volume_step(self.as_function(du))
        length, halvings, energy = self.move(found, du, largest, old, volumes)
        if found.driven is not None:
            moved = length * found.driven.travel
            self.travel = self.travel + moved if len(self.travel) else moved
            found.driven.drives.move(moved)
        pressure = None if volumes is None else volumes.pressure_at(length)
        return _Moved(du, length, halvings, energy, pressure)

    def predicted_gaps(self, lin: Linearisation, solved: QPSolution, length: float) -> Floats:
        """Return the gaps (owned nodes,) that the QP predicts at a share of its solution."""
        bounds, gaps = lin.balance.bounds, np.full(self.problem.n, np.nan)
        gaps[lin.balance.nodes] = bounds.upper - length * solved.x.array_r[bounds.dofs]
        return gaps

    def first_forces(self, lin: Linearisation) -> float:
        """Return the size of the forces of the first QP, prescribed increments included."""
        lifted = self.problem.vector(self.data.asked)
        lifted.pointwiseMult(lifted, lin.diagonal)
        return float(max(lin.qp.b.norm(), lifted.norm()))

    def judge(
        self,
        contacts: Contacts,
        diagonal: PETSc.Vec,
        scales: Scales,
        norm: float,
        balance: Balance,
    ) -> Residuals:
        """Return the residuals of a balance, those of tools that forces drive included."""
        rtol = self.report.rtol
        found = measure(self.problem.u, balance, contacts, diagonal, scales, norm, rtol)
        return driven_tools.miss(self.problem, balance, contacts, found, rtol)

    def drive(
        self, lin: Linearisation, solved: QPSolution, old: Iterate
    ) -> tuple[Linearisation, QPSolution, driven_tools.Settled | None]:
        """Return the QP in which tools carry their loads, its solution, and their motions."""
        if solved.travel is None:
            return lin, solved, None
        found = driven_tools.settle(lin.drives, lin, solved, old.scales.extent)
        return found.lin, found.solved, found

    def with_scalars(self, lin: Linearisation, old: Iterate) -> Linearisation:
        """Return the QP with the motions of tools that forces drive as unknowns; collective."""
        given = None if old.balance.friction is None else old.contacts.multipliers
        known = None if given is None else old.balance.known(given)
        drives = driven_tools.find_drives(self.problem, known)
        if drives is None:
            return lin
        if any(isinstance(term, Inertia) for _, term in self.problem.terms.named):
            drives.check_gaps(old.balance, old.contacts.active, old.scales.facet_length)
        at = lin, DIGIT * self.report.rtol, old.scales.begun
        scalars = driven_tools.as_scalars(drives, *at)
        return replace(lin, qp=replace(lin.qp, scalars=scalars), drives=drives)

    def linearise(
        self,
        old: Iterate,
        start: Actives,
        tangent: bool,
        accuracy: Callable[[Linearisation], float],
        *,
        near: bool,
    ) -> tuple[Linearisation, QPSolution]:
        """Return the QP of an iterate and its solution.

        At finite strain K may be indefinite, far from the solution or beyond a bifurcation. Then
        multiples of the elastic stiffness are added until it is positive on the free unknowns; an
        iteration begins with a tenth of what the last one needed. Near a balance Newton's step goes
        to it, be it stable or not: where multigrid cannot solve that, as conjugate gradients may
        not where the balance is a saddle of the energy, the rest of the step is factorised.
        Shifted steps would leave the saddle again.
        """
        finite, given = self.problem.solid.strain == "finite", (old, start, tangent, accuracy)
        first: Exception | None = None
        begin = 0 if near else max(self.shifted - 1, 0)
        for k in range(begin, len(SHIFTS) if finite else begin + 1):
            try:
                lin, solved = self.solve_shifted(k, *given)
            except (backends.QPNotSolved, backends.UnusableQP) as error:
                if near and k == 0 and finite and self.factorises_from_here():
                    return self.linearise(old, start, tangent, accuracy, near=near)
                first = first or error
            else:
                self.negative = finite and (self.has_negative_pivots() or not solved.definite)
                if not self.negative or (near and k == 0):
                    return lin, solved
                if k == begin and not solved.definite and self.is_loose(*given):
                    return self.solve_shifted(begin, *given)
                first = first or backends.QPNotSolved(
                    "the tangent stays indefinite, whatever multiple of the elastic one is added"
                )
            self.solver.forget()  # what has been factorised is of no use
        assert first is not None
        raise first

    def factorises_from_here(self) -> bool:
        """Replace multigrid by a factorisation for the rest of the step, if it may; collective."""
        given_up, factorising = self.solver.description, self.solver.factorising()
        if factorising is None:
            return False
        self.solver = factorising
        if done := len(self.report.iterations):
            self.report.linear_solver = f"{given_up}, from iteration {done + 1} on "
        told = f"{given_up} cannot solve the tangent near the balance, which may be a saddle of "
        told += "the energy: the rest of this step is factorised"
        self.report.notes.append(told)
        if self.problem.comm.rank == 0:
            log.info("%s", told)
        return True

    def solve_shifted(
        self,
        k: int,
        old: Iterate,
        start: Actives,
        tangent: bool,
        accuracy: Callable[[Linearisation], float],
    ) -> tuple[Linearisation, QPSolution]:
        """Return the QP of an iterate with the k-th of `SHIFTS`, and its solution."""
        lin = linearise(
            self.problem,
            old.balance,
            tangent=tangent,
            shift=SHIFTS[k],
            pressure=old.pressure,
            linear=self.solver,
        )
        self.shifted, lin = k, self.with_scalars(lin, old)
        return lin, self.solve(lin, start, old, accuracy(lin))

    def is_loose(
        self,
        old: Iterate,
        start: Actives,
        tangent: bool,
        accuracy: Callable[[Linearisation], float],
    ) -> bool:
        """Tell whether the largest of `SHIFTS` leaves the tangent singular: no strain holds it."""
        self.solver.forget()
        try:
            loose = not self.solve_shifted(len(SHIFTS) - 1, old, start, tangent, accuracy)[
                1
            ].definite
        except (backends.QPNotSolved, backends.UnusableQP):
            loose = True
        self.solver.forget()
        return loose

    def has_negative_pivots(self) -> bool:
        """Tell whether the last factorisation has negative pivots; collective."""
        return bool(maximum(self.problem.comm, float(self.solver.negative_pivots()))[0] > 0)

    def ends_indefinite(self) -> bool:
        """Tell whether the last tangent is indefinite, whatever the linear solver is; collective.

        Solutions do not show it where neither loads nor iterates have a part of the mode that is
        unstable: by symmetry, before a body buckles.
        """
        if self.problem.solid.strain == "small" or self.report.iterations[-1].shift:
            return False
        try:
            return self.solver.is_indefinite()
        except LinearSolveFailed:  # it is singular
            return True

    def is_exact(self, watch: Watch, residuals: list[Residuals]) -> bool:
        """Tell whether the next QP has the exact tangent of the moving geometry."""
        if not residuals or not watch.moving or not self.may_be_exact:
            return False
        if watch.rises >= MOST_RISES:
            return True
        last, finite = residuals[-1], self.problem.solid.strain == "finite"
        itself = any(link.sides.meet_themselves for link in self.problem.system.unilateral)
        far = max(last.forces, last.contact) >= NEAR
        if (far and (self.shifted or itself or not finite)) or self.missed(last) >= watch.barred:
            return False
        if finite:  # where tangents are new in any case
            return True
        return watch.is_slow(self.linear, last.forces / self.report.rtol, last.excess)

    def missed(self, residual: Residuals) -> float:
        """Return what an iteration with the exact tangent has to lower.

        At finite strain not the gaps alone: at rims a small force opens and closes large ones.
        """
        if self.problem.solid.strain == "finite":
            return max(residual.forces, residual.contact)
        return residual.excess

    def solve_exact(
        self,
        start: Actives,
        old: Iterate,
        watch: Watch,
        residuals: list[Residuals],
        tangent: bool,
    ) -> tuple[Linearisation | None, QPSolution | None, str]:
        """Solve the QP with the exact tangent of the moving geometry; say why it has no solution.

        Its bounds are corrected by what the rows of T_g neglect, see `Corrections`.
        """
        contacts = old.contacts
        given = contacts.multipliers, contacts.tangential
        at = self.problem, old.balance, self.data.partners
        pressure, solver = old.pressure, self.solver
        lin = linearise_all(*at, *given, tangent=tangent, pressure=pressure, linear=solver)
        lin = self.with_scalars(lin, old)
        rtol = self.accuracy(lin, watch, residuals)
        try:
            solved = self.solve(lin, start, old, rtol)
            corrections = Corrections()
            for _ in range(CORRECTIONS):
                lin, left = corrections.apply(lin, solved)
                if left <= DIGIT * residuals[-1].limit:
                    break
                last, guess = solved, None if self.solver.direct else solved.x
                solved = self.solve(lin, solved.active, old, rtol, guess)
                solved = replace(
                    solved,
                    updates=last.updates + solved.updates,
                    linear_iterations=last.linear_iterations + solved.linear_iterations,
                    factorisations=last.factorisations + solved.factorisations,
                )
        except backends.QPNotSolved as error:
            return None, None, f"without the exact tangent ({error})"
        curvature = solved.x.dot(lin.qp.b - solved.z)  # x.A x: b - A x = z
        if self.shifted and not curvature > 0.0:  # it leads to what is not stable
            return None, None, "without the exact tangent, which is indefinite"
        self.shifted = 0
        return lin, solved, ""

    def accuracy(self, lin: Linearisation, watch: Watch, residuals: list[Residuals]) -> float:
        """Return the relative tolerance of the next QP."""
        if self.linear and not watch.moving:
            return tightest(self.report.rtol)  # one QP is the whole step
        # where only the geometry changes, the factorisation is that of the first QP: 2 to 4 of 12
        # to 18 solves are saved by not asking it for more digits
        new = self.solver.direct and not (self.linear and residuals)
        kind = "direct" if new else "iterative"
        found = next_tolerance(kind, self.report.rtol, lin.qp.b.norm(), residuals)
        solid = self.problem.solid
        stiff = solid.strain == "finite" and solid.volumetric != "full"
        if self.solver.direct or not (stiff or lin.balance.limits is not None):
            return found
        # Forces of the bulk modulus hide those of shear, so that 1e-2 leaves shears wrong. A block
        # bent with K/mu = 5000 took 7 to 48 iterations, and metal failed; with 1e-3 it takes 5 to
        # 32, with 1e-4 4 to 6, as with a factorisation, in a tenth of the time. With friction too
        # loose a solution slips elsewhere: three steps of the bolted tee take 53 iterations with
        # 1e-2, 26, 27, 24 with 1e-3, 1e-4, 1e-6, and .39, .48, .63 of the time.
        most = QUARTER_OF_DIGITS if stiff else DIGIT**3
        return max(tightest(self.report.rtol), min(found, most))

    def solve(
        self,
        lin: Linearisation,
        start: Actives,
        old: Iterate,
        rtol: float,
        guess: PETSc.Vec | None = None,
    ) -> QPSolution:
        """Solve the QP with the backend of the step."""
        limits, kappa = old.balance.limits, None
        if self.problem.solid.strain == "finite":
            # Where it slides, diag(A) is a hundred times too large: a ball dragged over a block (50
            # thousand unknowns) had eigenvalues with a negative real part, and GMRES stood still.
            kappa = old.contacts.kappa(limits)
        if self.driven:  # deep drawing takes 606 iterations in 46 parts without, for 153 in 36
            rtol = min(rtol, tightest(self.report.rtol))
        with self.problem.timings("linear_solves"):
            try:
                solved = backends.solve(
                    lin.qp,
                    self.report.backend,
                    self.solver,
                    start_active=start,
                    start_sliding=old.contacts.directions(limits),
                    start_kappa=kappa,
                    guess=guess,
                    rtol=rtol,
                )
            except backends.NoResistance as error:
                raise driven_tools.unresisted(lin.drives, lin, error.which) from error
        if solved.travel is not None:  # see `driven_tools.settle`
            return solved
        # supports and ties are satisfied exactly, also by an iterative solver
        equal = lin.balance.equal
        solved.x.array[equal.dofs] = equal.upper
        return solved

    def check_distance(self, du: PETSc.Vec, extent: float) -> None:
        """Raise if a step is far longer than the model: the tangent is singular."""
        farthest = du.norm(PETSc.NormType.INFINITY)
        if not QUARTER_OF_DIGITS * farthest <= extent:
            raise failures.StepFailed(
                f"a Newton step is {farthest:.1e} long in a model of size {extent:.1e}: the "
                "tangent is singular, because nothing holds a body or nothing resists its plastic "
                "flow, or a load or pretension is too large for the stiffness (check units of both)"
            )

    def move(
        self,
        found: _Solution,
        du: PETSc.Vec,
        largest: float,
        old: Iterate,
        volumes: VolumeStep | None,
    ) -> tuple[float, int, Energy | None]:
        """Move u along the step; return its length, the halvings, and J.

        The step is whole if there is no energy, if the committed state is linearised, or if
        supports or ties still prescribe increments, for which the energy may increase; they do not
        once the supports have moved their bodies rigidly at the start of the step. Nor does the
        energy decrease towards a balance that is a saddle. The step is shorter where it would turn
        a cell inside out.
        """
        problem, energy = self.problem, old.energy
        lin, solved, driven = found.lin, found.solved, found.driven
        lost = gap_round_off(problem.u)
        asked = float(maximum(problem.comm, old.balance.equal.scale)[0])
        with problem.timings("assembly"):
            try:
                saddle = self.negative and self.shifted == 0  # whose energy may increase
                if energy is None or asked > lost or lin.geometry is not None or saddle:
                    curve = None if driven is None else driven.curve
                    return *shorten(problem, du.array_r, curve), problem.terms.energy()
                way = search(problem, lin, solved, du, largest, energy, volumes, driven)
                return way if volumes is None else (*way[:2], problem.terms.energy())
            except NoDescent as error:
                raise failures.StepFailed(str(error)) from error

    def follow(
        self,
        watch: Watch,
        judge: Callable[[Balance], Residuals],
        contacts: Contacts,
        predicted: Floats,
        last: Residuals | None,
    ) -> tuple[Balance, Residuals, Watch, float]:
        """Update the geometry unless it is constant or frozen; return balance and residuals.

        Args:
            watch: the fixed point so far.
            judge: returns the residuals of a balance.
            contacts: found by the QP.
            predicted: gaps (owned nodes,) by it.
            last: residuals before, of the exact tangent; None for another QP.
        """
        problem = self.problem
        if last is None and (not watch.moving or watch.held) and not self.driven:
            balance = self.balance(contacts)
            residual = judge(balance)
            if not watch.moving or residual.excess > 1.0:
                return balance, residual, watch, 0.0
        before, carrying = contact_forces(problem, contacts), self.carrying()
        problem.follow_geometry()
        balance = self.balance(contacts)
        residual = judge(balance)
        change, work = find_change(problem.comm, balance, contacts, predicted)
        turned = problem.vector(contact_forces(problem, contacts) - before).norm()
        if self.driven:  # what is measured is the motion of tools, too
            return balance, residual, watch, change / problem.system.facet_length
        if last is not None:
            at = self.missed(residual), self.missed(last)
            watch = watch.after_exact(*at, other_nodes=self.differ(carrying))
        else:
            watch = watch.after(work, residual.forces).turning(ratio(turned, residual.limit))
        if watch.failed > MOST_RISES or (watch.rises >= MOST_RISES and not self.may_be_exact):
            raise failures.StepFailed(failures.unsettled(problem))
        return balance, residual, watch, change / problem.system.facet_length

    def carrying(self) -> list[Bools]:
        """Return which nodes (n, c) of each contact carry multipliers."""
        return [link.coupling.kept for link in self.problem.system.unilateral]

    def differ(self, carrying: list[Bools]) -> bool:
        """Tell whether other nodes than these do at present, at finite strain; collective.

        At small strain the fixed point goes on there: it contracts, and is cheaper.
        """
        if self.problem.solid.strain == "small":
            return False
        pairs = zip(carrying, self.carrying(), strict=True)
        differ = not all(np.array_equal(one, other) for one, other in pairs)
        return bool(any_rank(self.problem.comm, differ)[0])

    def thaw(self, old: Iterate, watch: Watch) -> tuple[Iterate, Watch, Residuals]:
        """Return the iterate in the geometry at u, which was frozen; collective.

        The residual in the frozen one is no measure of what the exact tangent has to reduce.
        """
        problem = self.problem
        problem.follow_geometry()
        balance = self.balance(old.contacts)
        given = problem.u, balance, old.contacts, old.stiffness, old.scales, old.norm
        residual = measure(*given, self.report.rtol)
        return replace(old, balance=balance), watch.thawed(), residual

    def geometry_is_complete(self) -> bool:
        """Tell whether all touching facets are paired and all their nodes in T; else add them."""
        problem = self.problem
        with problem.timings("mortar"):
            complete = problem.system.is_complete(problem.configuration, problem.positions())
        if not complete:
            problem.follow_geometry(everywhere=True)
        return complete

    def check_passing(self) -> None:
        """Raise if bodies have passed through each other."""
        with self.problem.timings("mortar"):
            passed = describe_passing(self.problem)
        if passed:  # other causes need not be looked for
            raise NewtonNotConverged(f"{passed}{failures.AS_BEFORE}", self.report)

    def finish(self, iterate: Iterate, residual: Residuals) -> None:
        """Set the results of the step."""
        problem, report = self.problem, self.report
        contacts = iterate.contacts
        with problem.timings("results"):
            problem.solid.evaluate()
        if too_far := check_tightening(problem.system):
            raise failures.StepFailed(too_far)
        slips, balances = set_results(problem, iterate.balance, contacts)
        sliders = None
        if (limits := iterate.balance.limits) is not None:
            noise = gap_round_off(problem.u)
            sliders = find_sliders(limits, contacts, iterate.stiffness, noise)
        left_out, crossing = find_left_out(problem), find_crossing(problem)
        stiffness = iterate.stiffness.array_r
        pull = find_pull(problem, contacts)
        how = self.overlap, left_out, crossing, pull, report.rtol, residual.limit
        end = StepEnd(problem, iterate.balance, contacts, stiffness, *how)
        self.negative = self.negative or self.ends_indefinite()
        report.notes += find_notes(end) + self.notes_on_shifts()
        report.certificate = create_certificate(
            problem, report, contacts, residual, balances, sliders, left_out, crossing, pull
        )
        problem.raise_failed()
        supports = support_forces(problem, iterate.balance)  # last, as no error may follow
        at, paired = problem.owned_u.copy(), problem.system.present.paired
        forces = -normal_forces(problem, contacts), -tangential_forces(problem, contacts)
        ended = problem.ends_of_interfaces()
        closed = contacts.active, contacts.sliding
        outcome = StepOutcome(at, *closed, paired, slips, *forces, ended)
        problem.outcome, problem.committed.supports = outcome, supports
        report.converged = True

    def notes_on_shifts(self) -> list[str]:
        """Return a note if tangents were indefinite."""
        notes, shifted = [], [it.number for it in self.report.iterations if it.shift]
        if shifted:
            notes.append(
                f"the tangent was indefinite in {len(shifted)} iterations, the last of them "
                f"{shifted[-1]}: up to {max(it.shift for it in self.report.iterations):g} times "
                "the elastic stiffness was added there"
            )
        if self.negative or shifted[-1:] == [len(self.report.iterations)]:
            notes.append(
                "the tangent is indefinite at the end: the equilibrium found is unstable, and a "
                "small disturbance leads to another one; give the mesh an imperfection to find "
                "that one"
            )
        if notes:
            notes[-1] += failures.describe_cells(self.problem)
        return notes

    def as_function(self, du: PETSc.Vec) -> fem.Function:
        """Return du as the Function `direction`; collective."""
        self.direction.x.array[: du.local_size] = du.array_r
        self.direction.x.scatter_forward()
        return self.direction

    def elastic_norm(self, du: PETSc.Vec) -> float:
        """Return |du|_e; collective."""
        return self.problem.solid.elastic_norm(self.as_function(du))

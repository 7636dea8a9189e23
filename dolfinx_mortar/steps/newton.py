# SPDX-License-Identifier: MIT
"""Semi-smooth Newton: a bound-constrained QP at every iterate, and a line search on the energy."""

from __future__ import annotations

import logging

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_mortar import qp as backends
from dolfinx_mortar.algebra.parallel import free_unused, maximum
from dolfinx_mortar.arrays import Actives, Floats
from dolfinx_mortar.qp import QPSolution
from dolfinx_mortar.steps import near
from dolfinx_mortar.steps.certificate import create_certificate
from dolfinx_mortar.steps.checks import check_controls
from dolfinx_mortar.steps.problem import ContactProblem
from dolfinx_mortar.steps.report import Iteration, NewtonNotConverged, StepReport

log = logging.getLogger(__name__)

ARMIJO = 1e-4
# QPs on the way need not be more accurate than Newton's next increment, about the square of the
# last. Digits that save one Newton iteration are cheap with a factorisation only.
FORCING = {"direct": 1e-4, "iterative": 1e-2}
# A contact set of which a smaller share changed in the last QP is expected to stay.
SETTLED = 0.1
MAX_HALVINGS = 12
# Forces balanced to this share of their scale are balanced to round-off.
FORCE_FLOOR = 1e-12
# Below this share of diag(K) |u| a force residual is the round-off of K u.
STIFFNESS_FLOOR = 1e-15
# Below this share of the coordinates a displacement is lost in the round-off of the gaps.
COORDINATE_FLOOR = 16.0 * np.finfo(float).eps
# An iteration stalls if two of them leave this share of the increment; the geometry is then held
# until the increment has fallen to the other share.
STALLED, RELEASED = 0.7, 0.1


def newton(
    problem: ContactProblem, *, qp: str = "active-set", rtol: float = 1e-6, max_it: int = 50
) -> StepReport:
    """Solve one load step from the committed state; collective.

    At the iterate u^k the energy is replaced by its quadratic model (paper, eq. 9) and the
    bound-constrained QP is solved to the end (eq. 10), warm-started from the last contact set. The
    step is shortened on J(v) + s sum_j D_jj (w_n - gap)_+ if that merit does not fall. Where a
    material has a stress but no energy, there is no J, and all steps are whole.

    Args:
        problem: the bodies and their constraints; ``problem.commit()`` accepts the step.
        qp: name of the QP backend, see ``dolfinx_mortar.qp.available()``.
        rtol: tolerance for |du|_e / (|u|_e + |u + du|_e) in the elastic energy norm and for the
            relative projected force residual.
        max_it: largest number of Newton iterations.

    Returns:
        The report of the converged step.

    Raises:
        NewtonNotConverged: with the report attached; u and the committed state are as before.
        ValueError: for an unknown backend or bad tolerance, or input that ``begin_step`` rejects.
    """
    backends.check_name(qp)
    check_controls(rtol, max_it)
    before, active = problem.u.x.array.copy(), problem.active.copy()
    earlier = dict(problem.timings.seconds)
    report = StepReport(backend=qp, geometry=problem.geometry, rtol=rtol)
    try:
        with problem.timings("total"):
            problem.begin_step()
            _Step(problem, report).run(max_it)
    except backends.QPNotSolved as error:
        number, cause = len(report.iterations) + 1, str(error).rstrip(". ")
        raise _failed(f"the QP of Newton iteration {number}: {cause}", problem, report) from error
    finally:
        report.seconds = problem.timings.since(earlier)
        report.linear_solver = problem.linear.description
        report.notes += [note for note in problem.notes if note not in report.notes]
        if not report.converged:
            problem.u.x.array[:] = before
            problem.active = active
    return report


def _failed(message: str, problem: ContactProblem, report: StepReport) -> NewtonNotConverged:
    """Return the error, with what the audit knows about bodies that may move off; collective."""
    if problem.audit().held_by_contact:
        message += (
            ". A body held by contact alone may float away (do the loads press it on?), or slides "
            "or rolls freely (then prescribe that motion)"
        )
    return NewtonNotConverged(
        f"{message}. The displacement and the committed state are as before the step: "
        "retry with a smaller one (dm.load_steps does)",
        report,
    )


class _Step:
    """One load step in progress: what an iteration hands to the next."""

    def __init__(self, problem: ContactProblem, report: StepReport) -> None:
        self.problem, self.report = problem, report
        self.moving = problem.geometry == "updated" and bool(problem.interfaces)
        self.settled = False  # the contact set is expected to stay
        self.potential: float | None = None  # J(u), once a line search has needed it
        self.largest_multiplier = 0.0
        extent = np.abs(problem.V.mesh.geometry.x).max(initial=0.0)
        self.rest = COORDINATE_FLOOR * float(maximum(problem.comm, extent)[0])
        self.predicted_gap: Floats | None = None  # after the last step, as it was linearised
        self.held_at: float | None = None  # increment at which the geometry was stopped
        self.noted: dict[str, list[int]] = {}  # what the QP backend said, and in which iterations

    def run(self, max_it: int) -> None:
        """Iterate until converged; sets the results and the certificate."""
        problem, report = self.problem, self.report
        start = near.predict_active(problem)
        for number in range(1, max_it + 1):
            if number > 1:
                if self.moving and not self.hold():
                    problem.update_geometry()
                start = problem.active[problem.bounded_nodes].astype(np.int8)
            done = self.iterate(number, start)
            _log(problem, report)
            # While the geometry moves, its update looks after the far nodes.
            complete = (self.moving and not done) or problem.far_nodes_stay_open()
            if done and complete and self.held_at is None:
                problem.set_results(self.reaction)
                report.certificate = create_certificate(problem, report, self.reaction)
                report.converged = True
                return
        raise _failed(f"Newton did not converge in max_it={max_it} iterations", problem, report)

    def hold(self) -> bool:
        """Tell whether to keep the geometry in the next iteration, because Newton stalls.

        The merit of the line search belongs to one geometry. Where the tangent changes a lot, a
        new gap after every step can lend the energy that a cycle of steps spends; with the
        geometry held the merit falls for good.
        """
        increments = [i.increment for i in self.report.iterations]
        if self.held_at is None:
            floor = 10.0 * self.report.rtol
            if len(increments) > 3 and increments[-1] > max(floor, STALLED * increments[-3]):
                self.held_at = increments[-1]
        elif increments[-1] <= max(RELEASED * self.held_at, self.report.rtol):
            self.held_at = None
        return self.held_at is not None

    def iterate(self, number: int, start: Actives) -> bool:
        """Linearise, solve the QP, step, record; return whether this was the last iteration."""
        problem, report = self.problem, self.report
        free_unused(problem.comm)
        fixed_supports = not problem.changes_dirichlet()
        qp = problem.quadratic_program()
        geometry_change, rtol = self.geometry_change(), self.accuracy()
        with problem.timings("linear_solves"):
            solved = backends.solve(
                qp,
                report.backend,
                problem.linear,
                start_active=start,
                rtol=rtol,
                settled=self.settled,
            )
        if solved.note:
            self.note(number, solved.note)
        changed = self.take_over(solved, start)

        step = problem.to_displacement(solved.x)
        increment, at_rest = self.energy_increment(step)
        slope = -problem.vectors["r"].dot(step)
        search = fixed_supports and problem.solid.has_energy
        length, halvings = self.line_search(step, solved.x, slope, search=search)
        self.predicted_gap = problem.gap - length * _normal_part(problem, solved.x)
        residual, floor = force_residual(problem, solved.z)
        report.iterations.append(
            Iteration(
                number=number,
                increment=increment,
                force_residual=residual,
                kkt=solved.kkt.worst,
                active=problem.comm.allreduce(int(problem.active.sum()), op=MPI.SUM),
                changed=changed,
                updates=solved.updates,
                linear_iterations=solved.linear_iterations,
                factorisations=solved.factorisations,
                step_length=length,
                line_search_steps=halvings,
                geometry_change=geometry_change,
            )
        )
        self.settled = changed <= SETTLED * report.iterations[-1].active
        in_balance = residual <= max(report.rtol, floor)
        small = increment <= report.rtol and in_balance and changed == 0
        # Balanced forces need no confirming solve, unless the geometry has moved since.
        balanced = residual <= max(FORCE_FLOOR, 10.0 * self.tolerance, floor)
        balanced = balanced or (problem.solid.linear and in_balance)
        tight = solved.kkt.satisfied(max(self.tolerance, 1e-2 * report.rtol))
        return length == 1.0 and tight and (small or (balanced and (at_rest or not self.moving)))

    @property
    def tolerance(self) -> float:
        """Tolerance of the last QP: far enough below Newton's never to be what limits it.

        A digit more is one or two iterations with a factorisation, and many with multigrid.
        """
        least = 1e-10 if self.problem.linear.direct else 1.0
        return max(1e-13, min(least, 1e-3 * self.report.rtol))

    def note(self, number: int, text: str) -> None:
        """Report what the QP backend says: one note, once for all iterations that say the same."""
        self.noted.setdefault(text, []).append(number)
        said = [f"iteration {', '.join(map(str, n))}: {t}" for t, n in self.noted.items()]
        self.report.notes = ["; ".join(said)]

    def accuracy(self) -> float:
        """Return the tolerance of the next QP: tight where it may be the last one."""
        problem, done = self.problem, self.report.iterations
        if problem.solid.linear and not self.moving:
            return self.tolerance  # one QP is the whole step
        last = done[-1].increment if done else 1.0
        share = FORCING["direct" if problem.linear.direct else "iterative"]
        return float(max(self.tolerance, share * min(1.0, last) ** 2))

    def take_over(self, solved: QPSolution, start: Actives) -> int:
        """Keep the contact set and reactions; return how many nodes changed, weak ones left out.

        A node is weakly active if both its reaction and its opening are below the tolerance.
        """
        problem = self.problem
        active = solved.active > 0
        problem.active[:] = False
        problem.active[problem.bounded_nodes] = active
        # What b - A x leaves off the active set is residual, not contact force.
        keep = problem.bounded[active]
        forces = solved.z.array_r[keep].copy()
        solved.z.set(0.0)
        solved.z.array[keep] = forces
        self.reaction = solved.z
        z = np.abs(solved.z.array_r[problem.bounded])
        opening = np.abs(problem.gap[problem.bounded_nodes] - solved.x.array_r[problem.bounded])
        near = active | (start > 0)
        multipliers = z / problem.multiplier_weights()
        largest = maximum(
            problem.comm,
            z.max(initial=0.0),
            opening.max(initial=0.0, where=near),
            multipliers.max(initial=0.0),
        )
        strong = (z > 1e-3 * largest[0]) | (opening > 1e-3 * largest[1])
        self.largest_multiplier = max(self.largest_multiplier, float(largest[2]))
        return int(problem.comm.allreduce(int(((start > 0) != active)[strong].sum()), op=MPI.SUM))

    def energy_increment(self, step: PETSc.Vec) -> tuple[float, bool]:
        """Return |du|_e / (|u|_e + |u + du|_e), and whether du is round-off of u or X.

        Bodies that only move rigidly have no energy; then the second answer decides.
        """
        problem = self.problem
        v, own = problem.increment, step.array_r.size
        norms = []
        for u, du in ((0.0, 1.0), (1.0, 0.0), (1.0, 1.0)):
            v.x.array[:own] = u * problem.u.x.array[:own] + du * step.array_r
            v.x.scatter_forward()
            norms.append(problem.solid.elastic_norm(v))
        largest = maximum(
            problem.comm,
            np.abs(step.array_r).max(initial=0.0),
            np.abs(problem.u.x.array).max(initial=0.0),
        )
        total = norms[1] + norms[2]
        at_rest = bool(largest[0] <= max(1e-11 * largest[1], self.rest))
        return norms[0] / total if total > 0 else 0.0, at_rest

    def merit(self, violation: float) -> float:
        """Return J(u) + s sum_j D_jj (w_n - gap)_+ for a given sum."""
        problem = self.problem
        external = problem.vectors["f"].array_r @ problem.u.x.array[: problem.d * problem.n]
        self.potential = problem.solid.energy() - float(problem.comm.allreduce(external))
        return self.potential + 2.0 * self.largest_multiplier * violation

    def line_search(
        self, step: PETSc.Vec, dy: PETSc.Vec, slope: float, *, search: bool
    ) -> tuple[float, int]:
        """Move u along the step until the merit falls; return the length and the halvings.

        Without a search (an iteration that changes Dirichlet values must be free to raise the
        energy; a law may have none) the whole step is taken.
        """
        problem = self.problem
        own = step.array_r.size
        start, direction = problem.u.x.array[:own].copy(), step.array_r.copy()
        violated = [problem.violation(part, dy) if search else 0.0 for part in (0.0, 1.0)]
        before = self.merit(violated[0]) if search else 0.0
        slope += 2.0 * self.largest_multiplier * (violated[1] - violated[0])
        length = 1.0
        for halvings in range(MAX_HALVINGS + 1):
            problem.u.x.array[:own] = start + length * direction
            problem.u.x.scatter_forward()
            if not search:
                return length, 0
            after = self.merit(problem.violation(length, dy))
            noise = 1e-13 * (abs(before) + abs(after))
            if after <= before + ARMIJO * length * min(slope, 0.0) + noise:
                return length, halvings
            length *= 0.5
        raise _failed("the line search found no step that lowers the energy", problem, self.report)

    def geometry_change(self) -> float:
        """Return how far the active gaps are from their last prediction, in facet lengths."""
        problem = self.problem
        if self.predicted_gap is None or not self.moving:
            return 0.0
        both = problem.active & np.isfinite(self.predicted_gap) & np.isfinite(problem.gap)
        change = np.abs(problem.gap[both] - self.predicted_gap[both]).max(initial=0.0)
        return float(maximum(problem.comm, change)[0] / problem.facet_length)


def _normal_part(problem: ContactProblem, dy: PETSc.Vec) -> Floats:
    """Return the closing w_n of every owned node in an increment, 0 where it is not bounded."""
    closing = np.zeros(problem.n)
    closing[problem.bounded_nodes] = dy.array_r[problem.bounded]
    return closing


def force_residual(problem: ContactProblem, reaction: PETSc.Vec) -> tuple[float, float]:
    """Return the norm of T^T (f - F(u)) - z on free unknowns over its scale, and its floor.

    The scale is the largest of the norms of external forces, contact forces, reactions of supports
    and ties, and unassembled element forces. The floor is the round-off of K u on that scale: after
    unloading all forces may vanish, but not their round-off.
    """
    v = problem.vectors
    with problem.timings("assembly"):
        problem.solid.assemble_residual(v["F"])
        elements = problem.solid.element_force_norm()
    v["F"].copy(v["r"])
    v["r"].aypx(-1.0, v["f"])
    free = problem.to_reduced(v["r"])
    supports = free.array_r[problem.eliminated]
    free.axpy(-1.0, reaction)
    free.array[problem.eliminated] = 0.0
    x = problem.vectors["x"]
    x.array[:] = problem.u.x.array[: x.array_r.size]
    x.pointwiseMult(x, problem.diagonal)
    squares = problem.comm.allreduce(np.array([supports @ supports]), op=MPI.SUM)
    scale = max(v["f"].norm(), reaction.norm(), float(np.sqrt(squares[0])), elements)
    if scale == 0.0:
        return 0.0, 0.0
    return free.norm() / scale, STIFFNESS_FLOOR * x.norm() / scale


def _log(problem: ContactProblem, report: StepReport) -> None:
    """Log one line about the last iteration on rank 0."""
    if problem.comm.rank == 0:
        i = report.iterations[-1]
        log.info(
            "Newton %2d: increment %.2e, forces %.2e, KKT %.1e, active %d (%+d), QP %d, CG %d, "
            "factorisations %d, step %.3g",
            *(i.number, i.increment, i.force_residual, i.kkt, i.active, i.changed, i.updates),
            *(i.linear_iterations, i.factorisations, i.step_length),
        )

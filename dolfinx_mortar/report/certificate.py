# SPDX-License-Identifier: MIT
"""Certificate of a converged step, error of the small strain, and results of interfaces.

The small strain neglects H^T H / 2 of the Green-Lagrange strain, H = grad u: relatively e / 2 of a
strain e (the spread of finite measures), a^2 / 2 of a rotation a.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.parallel import maximum, ratio
from dolfinx_mortar.common.arrays import CHUNK, HALF_OF_DIGITS, Floats, Ints
from dolfinx_mortar.common.step_report import Certificate, StepReport
from dolfinx_mortar.interfaces.constraints import SlipLimits
from dolfinx_mortar.interfaces.coupling import along_and_across, relative_motions
from dolfinx_mortar.interfaces.link import Link, nodal_gaps, set_results_of, set_sliding
from dolfinx_mortar.materials.tensor import double_contraction, frobenius_norm
from dolfinx_mortar.persistence.committed import Slips
from dolfinx_mortar.problem.contacts import Contacts, Residuals, find_sliders, gap_round_off
from dolfinx_mortar.problem.linearisation import Balance, growth
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.report.penetration import Overlap, find_overlaps
from dolfinx_mortar.solid.solid import Solid

# Largest error without a note: of forces, by the work of rotations or half of the whole term; in
# logarithmic strain space of the stress norm (.02 for 2.7 % of the shear stress).
LARGEST_SHARE = 0.02
# of the mean |H^T H|: a strip bent by 11 %, a bar stretched by 14 %, a body turned by 7 degrees
# have 1 %


@dataclass(frozen=True)
class LeftOut:
    """Term that the small strain neglects; zero for other measures."""

    strain: float  # largest |H^T H| / 2
    work: float  # error of forces: share of the stress work, of the worst body
    lengths: float  # mean |H^T H| / 2 of that body
    felt: Floats  # (bodies,) errors over the limits
    own: Floats  # (2, bodies) largest strain and rotation


def _measure(solid: Solid, cells: Ints) -> tuple[Floats, Floats]:
    """Sums (6, cells) and maxima (4, cells) for `find_left_out`."""
    volume, dofmap = solid.fields.weights[cells], solid.stress.function_space.dofmap
    found = solid.gradients.evaluate(cells)
    shown = solid.stress.x.array.reshape(-1, dofmap.bs)[dofmap.list[cells].ravel()]
    stress: Floats = np.asfortranarray(shown)
    size, strains = frobenius_norm(found.left_out), frobenius_norm(found.strain)
    seen = strains if found.seen is found.strain else frobenius_norm(found.seen)
    angles = np.linalg.norm(found.rotation, axis=1)
    made = [double_contraction(stress, E) for E in (found.seen, found.turned, found.left_out)]
    at_points = np.stack([np.ones_like(size), size, *made]).reshape(5, *volume.shape)
    space, left, work, *missed = (at_points * volume).sum(axis=2)
    work = np.abs(work)  # per cell: under volume constraints point values vary
    peaks = np.stack([size, strains, angles, seen]).reshape(4, *volume.shape).max(axis=2)
    return np.stack([space, left, work, work * left / space, *missed]), peaks


def find_left_out(problem: ContactProblem) -> LeftOut:
    """Measure strain and rotation at u, after `Solid.evaluate`; collective."""
    solid, comm, count = problem.solid, problem.comm, problem.bodies.count
    sums, peaks = np.zeros((6, count)), np.zeros((4, count))
    cells: Ints = np.arange(len(problem.bodies.of_cells), dtype=np.int32)
    many = CHUNK // solid.fields.weights.shape[1]
    for some in (cells[first : first + many] for first in range(0, len(cells), many)):
        body, found = problem.bodies.of_cells[some], _measure(solid, some)
        for total, values in zip(sums, found[0], strict=True):
            total += np.bincount(body, values, count)
        for peak, values in zip(peaks, found[1], strict=True):
            np.maximum.at(peak, body, values)
    comm.Allreduce(MPI.IN_PLACE, sums, op=MPI.SUM)
    space, left, work, felt, *missed = sums
    strains, *own, seen = maximum(comm, *peaks.ravel()).reshape(peaks.shape)
    # without strain the stress is round-off
    strained = (seen > HALF_OF_DIGITS * own[1]) & (work > 0.0)
    turned, whole = np.divide(np.abs(missed), work, out=np.zeros((2, count)), where=strained)
    means = np.divide(felt, work, out=np.zeros(count), where=work > 0.0)
    means = np.maximum(means, left / space)
    felt = np.maximum(turned, 2.0 * means) / LARGEST_SHARE
    worst, forces = felt.argmax(), np.maximum(turned, whole / 2.0)
    return LeftOut(
        strain=float(strains.max()),
        work=float(forces[worst]),
        lengths=float(means[worst]),
        felt=felt,
        own=np.stack(own),
    )


def _largest(comm: MPI.Comm, *arrays: Floats) -> Floats:
    return maximum(comm, *(a.max(initial=0.0) for a in arrays))


def operator_errors(link: Link, X: Floats, facet_length: float) -> tuple[float, float]:
    """Linear-field error and row-sum error of D and M, relative to D_jj; collective.

    On flat interfaces (D - M) X, X (owned nodes, d), has no tangential part; on curved ones it is
    the gap times the angle between facet and nodal normals, so the first error is also relative to
    the gap plus a facet length, for each direction of a tie. Rows of D - M sum to zero.
    """
    sides, coupling = link.sides, link.coupling
    judged = coupling.kept.T & coupling.normals.any(axis=1)
    normals = coupling.normals if coupling.operators is None else coupling.operators.normals
    v = link.Q.createVecRight()
    v.set(1.0)
    sums = np.abs(relative_motions(link, v)).max(initial=0.0)
    v.array[:] = X.ravel()
    along, across = along_and_across(relative_motions(link, v), normals)
    linear = (across / (np.abs(along) + facet_length))[judged].max(initial=0.0)
    linear, sums = maximum(sides.V.mesh.comm, linear, sums)
    return float(linear), float(sums)


def find_pull(problem: ContactProblem, contacts: Contacts, least: float = 0.0) -> float:
    """Largest tension of the contacts over their largest compression; collective.

    Of D_jj lambda_j and lambda_j int Phi_j. Forces up to ``least`` are residual.
    """
    found = [0.0]
    for link in problem.system.unilateral:
        p, coupling = link.pattern, link.coupling
        z = coupling.weight[:, 0] * contacts.multipliers[link.nodes] * link.constrained[:, 0]
        z[np.abs(z) <= least] = 0.0
        shared_out = np.bincount(p.row[: p.split], coupling.P[: p.split, 0], minlength=len(z))
        forces = np.stack([z, z * (1.0 - shared_out)])
        pull, push = _largest(problem.comm, -forces, np.abs(forces))
        found.append(ratio(pull, push))
    return max(found)


@dataclass(frozen=True)
class StepEnd:
    """End of a step, and what is found in it; collective."""

    problem: ContactProblem
    report: StepReport
    balance: Balance
    contacts: Contacts
    residual: Residuals  # in the final geometry
    stiffness: PETSc.Vec  # diagonal of the last condensed stiffness
    overlap: float = 0.0  # that remains from the start

    @cached_property
    def left_out(self) -> LeftOut:
        """Errors of the small strain."""
        return find_left_out(self.problem)

    @cached_property
    def overlaps(self) -> Mapping[int, Overlap]:
        """Deepest overlaps of sides, and of uncoupled boundaries (-1)."""
        return find_overlaps(self.problem)

    @cached_property
    def pull(self) -> float:
        """Tension of contacts."""
        return find_pull(self.problem, self.contacts, self.residual.limit)


def create_certificate(end: StepEnd, balances: tuple[float, float]) -> Certificate:
    """Certificate of a step with its results and balances, see `set_results`; collective."""
    problem, report, contacts = end.problem, end.report, end.contacts
    left_out, residual, crossing = end.left_out, end.residual, end.overlaps.get(-1)
    strain, rotation = left_out.own.max(axis=1).tolist()
    links, length = problem.system.links, problem.system.facet_length
    nodal, nothing = nodal_gaps(links, problem.positions(), problem.n), np.zeros((2, 0))
    on = [(link, link.coupling.directions[:, 0]) for link in problem.system.unilateral]
    pairs = [(nodal[link.nodes[some]], link.interface.multiplier[some]) for link, some in on]
    g, p = np.concatenate([nothing, *pairs], axis=1)
    deepest, tensile, pressure, product = _largest(problem.comm, -g, -p, np.abs(p), np.abs(g * p))
    errors = [operator_errors(link, problem.X, length) for link in links if link.pairing] or [
        (0.0, 0.0)
    ]
    counts, least = np.array([0, 0, contacts.active.sum()]), 1.0
    for link in links:
        kept, share = link.coupling.kept.any(axis=1), link.coupling.coverage.share
        counts[:2] += kept.sum(), ((share > 0.0) & ~kept).sum()
        least = min(least, float(share[kept].min(initial=1.0)))
    counts = problem.comm.allreduce(counts, op=MPI.SUM)
    return Certificate(
        equilibrium=residual.forces,
        gap=ratio(deepest, length),
        sign=max(ratio(tensile, pressure), end.pull),
        complementarity=ratio(product, pressure * length),
        force_balance=balances[0],
        moment_balance=balances[1],
        linear_field_error=max(e[0] for e in errors),
        row_sum_error=max(e[1] for e in errors),
        smallest_coverage=float(-maximum(problem.comm, -least)[0]),
        kept_nodes=int(counts[0]),
        removed_nodes=int(counts[1]),
        active_nodes=int(counts[2]),
        active_set_changes=sum(i.changed for i in report.iterations),
        newton_iterations=report.newton_iterations,
        qp_iterations=report.qp_iterations,
        line_search_steps=sum(i.line_search_steps for i in report.iterations),
        geometry_change=report.iterations[-1].geometry_change,
        left_out_strain=ratio(left_out.strain, strain),
        left_out_work=left_out.work,
        left_out_lengths=left_out.lengths,
        rotation=rotation,
        loads=residual.loads,
        crossing=0.0 if crossing is None else max(crossing.share, 0.0),
        **_finite_strain(problem),
        **_friction(end, length),
    )


def _finite_strain(problem: ContactProblem) -> dict[str, float]:
    """Smallest J, and moment of the bodies' internal forces at X + u, 0 for objective laws."""
    volumes, d = problem.solid.volumes, problem.d
    if volumes is None:
        return {}
    found = {"smallest_J": volumes.smallest()}
    if not problem.bodies.shifts.all():
        return found
    internal, (arms, forces) = problem.vector(), np.zeros((2, problem.n, 3))
    problem.solid.add_forces(internal)
    forces[:, :d] = internal.array_r.reshape(-1, d)
    x = problem.X + problem.owned_u.reshape(-1, d)
    arms[:, :d] = x - problem.bodies.centre[problem.bodies.label]
    size = np.linalg.norm(arms, axis=1) * np.linalg.norm(forces, axis=1)
    sums = np.append(np.cross(arms, forces).sum(axis=0), size.sum())
    sums = problem.comm.allreduce(sums, op=MPI.SUM)
    return found | {"internal_moment": ratio(float(np.linalg.norm(sums[:3])), sums[3])}


def _friction(end: StepEnd, facet_length: float) -> dict[str, float]:
    comm, limits = end.problem.comm, end.balance.limits
    if limits is None:
        return {}
    sliders = find_sliders(limits, end.contacts, end.stiffness, gap_round_off(end.problem.u))
    size, way = (np.linalg.norm(v, axis=1) for v in (sliders.reaction, sliders.slip))
    most, work = sliders.limit, (sliders.reaction * sliders.slip).sum(axis=1)
    sticks = (most > 0.0) & ~sliders.directions()[0].any(axis=1)
    beyond, limit, stuck, gain = _largest(comm, size - most, most, way[sticks], -work)
    whole, taken = comm.allreduce(np.array([most @ way, work.sum()]), op=MPI.SUM)
    return {
        "friction_cone": ratio(beyond, limit),
        "friction_stick": ratio(stuck, facet_length),
        "friction_work": ratio(max(whole - taken, 0.0), whole),
        "friction_gain": ratio(gain, whole),
    }


def set_results(
    problem: ContactProblem,
    balance: Balance,
    contacts: Contacts,
) -> tuple[Slips | None, tuple[float, float]]:
    """Set the interfaces' resultants and Functions; collective.

    Returns the slips, and the largest imbalances of forces and moments. Reactions of equalities are
    residual forces, of contacts D_jj times the multipliers; tractions are per present area.
    """
    d, n = problem.d, problem.n
    moved = problem.X + problem.u.x.array[: d * n].reshape(-1, d)
    reaction = np.zeros(d * n)
    reaction[balance.equal.dofs] = balance.reduced.array_r[balance.equal.dofs]
    reaction[balance.bounds.dofs] = contacts.reactions(balance)
    known = balance.known(contacts.multipliers)
    if (limits := balance.limits) is not None:
        some = limits.some
        reaction[limits.tangential[some]] = contacts.tangential_reactions(limits)[some]
    forces = reaction.reshape(-1, d)
    gap = nodal_gaps(problem.system.links, problem.vector(moved), n)
    grown = [growth(problem, link) for link in problem.system.links]
    balances = [(0.0, 0.0)]
    for k, link in enumerate(problem.system.links):
        frozen = problem.configuration is None or link.interface.stays
        on = link.constrained
        found = set_results_of(
            link,
            np.where(on, forces[link.nodes], 0.0),
            np.where(on[:, :1], known[link.nodes], 0.0),
            link.shown_gap(gap),
            link.acting(contacts.active),
            problem.X if frozen else moved,
            grown[k],
        )
        balances.append(found)
    slips = None if limits is None else _set_sliding(problem, limits, contacts, grown)
    force, moment = np.max(balances, axis=0)
    return slips, (float(force), float(moment))


def _set_sliding(
    problem: ContactProblem, limits: SlipLimits, contacts: Contacts, grown: Sequence[Floats]
) -> Slips:
    n, d, committed = problem.n, problem.d, problem.committed
    traction, slip = np.zeros((2, n, d))
    assert contacts.sliding is not None
    slides = np.asarray(limits.along(contacts.sliding[limits.nodes]).any(axis=1))
    resisting, known = contacts.tangential_reactions(limits), limits.known(contacts.multipliers)
    slips = np.where(slides[:, None], limits.slip, 0.0)
    aside = limits.slides & known.any(axis=1)
    beside = np.where(aside[:, None], limits.beside, 0.0)
    traction[limits.nodes] = -(limits.vectors(resisting) + known) / limits.weight[:, None]
    slip[limits.nodes] = limits.vectors(slips) + beside
    energy, status = np.zeros((2, n))
    energy[limits.nodes] = (resisting * slips).sum(axis=1) + (known * beside).sum(axis=1)
    slides |= aside
    acts = contacts.active[limits.nodes] | (limits.cohesion > 0.0)
    status[limits.nodes] = np.where(slides, 2.0, acts)
    total = Slips(committed.slid.copy(), committed.dissipated.copy())
    for k, link in enumerate(problem.system.links):
        if link.interface.law is not None:
            nodes, carries = link.nodes, link.constrained[:, 0]
            total.slid[k, nodes] += carries * np.linalg.norm(slip[nodes], axis=1)
            total.dissipated[k, nodes] += carries * energy[nodes]
            way, spent = total.slid[k, nodes], total.dissipated[k, nodes]
            drag, last = (carries[:, None] * v[nodes] for v in (traction, slip))
            drag /= grown[k][:, None]
            set_sliding(link, drag, last, way, carries * status[nodes], spent)
    return total

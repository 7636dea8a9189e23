# SPDX-License-Identifier: MIT
"""Notes on a converged step: separation from the partner, neglected strains, resolution."""

import logging
import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from dolfinx import fem
from dolfinx_mortar.algebra.parallel import any_rank, maximum, norm, ratio
from dolfinx_mortar.audit.audit import SPOILT, are_flat
from dolfinx_mortar.common.arrays import HALF_OF_DIGITS, QUARTER_OF_DIGITS, Floats
from dolfinx_mortar.common.spaces import components
from dolfinx_mortar.common.step_report import Note
from dolfinx_mortar.geometry.segments import Segments
from dolfinx_mortar.interfaces.coupling import slipped
from dolfinx_mortar.interfaces.link import Link
from dolfinx_mortar.interfaces.tool import SidePattern, find_facing, point_gaps
from dolfinx_mortar.mortar.curvature_correction import missed_heights, point_heights
from dolfinx_mortar.mortar.duals import weighted_duals
from dolfinx_mortar.mortar.operators import WholeSide, mean_values, whole_facets
from dolfinx_mortar.mortar.pairing import Pairing
from dolfinx_mortar.mortar.surface import (
    coordinates,
    mean_facet_length,
    nodal_normals,
)
from dolfinx_mortar.problem.contacts import Contacts, gap_round_off
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.report.certificate import LARGEST_SHARE, StepEnd
from dolfinx_mortar.report.penetration import notes_on_crossings, notes_on_overlaps
from dolfinx_mortar.solid.pointwise import largest_stress_lost
from dolfinx_mortar.solid.supports import name_of

log = logging.getLogger(__name__)

# Nodes that resolve the largest pressure, in 2D and 3D: errors against Hertz are at most 9 % with 5
# nodes and 3 % with 7 in 2D, 14 % with 9 and 4 % with 17 in 3D.
NODES = {2: 7, 3: 17}
# strain or rotation (radians, 2.9 degrees) for a note
LARGE = 0.05


def note_partners(end: StepEnd) -> list[str]:
    """Notes on slides, rotations, tension and overlaps of contacts."""
    notes = _missed_tools(end)
    notes += _frozen(end) if end.problem.geometry == "reference" else _turned_tools(end)
    if end.pull > max(end.report.rtol, QUARTER_OF_DIGITS):
        seen = f"contacts pull, by {end.pull:.1%} of the largest push: forces are wrong there"
        why = "Refine the slave side where the master ends, or let the other side be the slave"
        notes.append(Note(seen, why))
    if end.overlap == 0.0:  # otherwise an initial overlap remains
        notes += notes_on_overlaps(end.problem, end.overlaps, end.contacts.active, end.report.rtol)
    return notes + notes_on_crossings(end.problem, end.overlaps)


def _missed_tools(end: StepEnd) -> list[str]:
    notes, links = list[str](), end.problem.system.links
    why = (
        "Either no facet of the side faces the tool (its normal has to point out of the tool, "
        "towards the body), or Dirichlet data hold all nodes: see problem.audit()"
    )
    for link in links:
        shared = [np.isin(link.nodes, other.nodes).any() for other in links if other is not link]
        met = link.pairing is not None or link.constrained.any() or any(shared)
        if not any_rank(end.problem.comm, met)[0]:
            seen = "no slave node carries a multiplier, so that the tool had no effect in this step"
            notes.append(Note(f"{link.interface}: {seen}", why))
    return notes


def _frozen(end: StepEnd) -> list[str]:
    notes, problem, length = list[str](), end.problem, end.problem.system.facet_length
    for link in end.problem.system.unilateral:
        slip = slipped(link, problem.vector(problem.owned_u))
        slip[~end.contacts.active[link.nodes]] = 0.0
        farthest = float(maximum(problem.comm, slip.max(initial=0.0))[0])
        finite = problem.solid.strain == "finite" and link.pairing is not None
        angle, seen = _turn(problem, link, end.contacts) if finite else 0.0, []
        if farthest > length:
            seen.append(f"has slid {farthest:.3g}, {farthest / length:.1f} facet lengths")
        if angle > LARGE:
            seen.append(f"has turned by {np.degrees(angle):.2g} degrees where it is closed")
        if seen:
            why = "Frozen geometry keeps partners and normals at X: choose geometry='updated'"
            notes.append(Note(f"{link.interface} {' and '.join(seen)}, in frozen geometry", why))
    return notes


def _turn(problem: ContactProblem, link: Link, contacts: Contacts) -> float:
    """Rotation of normals, atan2(|sum_j z_j N_j x n_j|, sum_j z_j N_j . n_j); collective."""
    slave, d = link.sides.slave, problem.d
    at_X, now = np.zeros((2, slave.owned, 3))
    for normals, u in ((at_X, None), (now, problem.u)):
        normals[:, :d] = nodal_normals(slave, coordinates(slave, u))[: slave.owned]
    z = link.coupling.weight[:, 0] * contacts.multipliers[link.nodes]
    mine = np.append(z @ np.cross(at_X, now), z @ (at_X * now).sum(axis=1))
    total = np.sum(problem.comm.allgather(mine), axis=0)
    return float(np.arctan2(np.linalg.norm(total[:3]), total[3]))


def _turned_tools(end: StepEnd) -> list[str]:
    notes, sliding = list[str](), end.contacts.sliding
    for link in end.problem.system.links:
        tool = link.interface.tool
        if tool is None or link.interface.law is None or sliding is None:
            continue
        turn, slides = tool.turn(), sliding[link.nodes].any(axis=1)
        about = np.abs(link.coupling.normals[slides] @ turn) if len(turn) > 1 else np.zeros(0)
        spin, moves = maximum(end.problem.comm, about.max(initial=0.0), slides.any())
        angle, missed = float(np.linalg.norm(turn)), 1.0 - np.sinc(spin / np.pi)
        if moves and (angle >= np.pi or missed > LARGE):
            seen = (
                f"{link.interface}: the tool turns by {np.degrees(angle):.0f} degrees in this step "
                f"and by {np.degrees(spin):.0f} about normals of the side, which slides on it"
            )
            why = (
                "Slips are taken along the shorter way around, back beyond 180 degrees, and about "
                f"normals along straight ways, which are {missed:.0%} too short: take steps of 30 "
                "degrees at most"
            )
            notes.append(Note(seen, why))
    return notes


def note_pressures(end: StepEnd) -> list[str]:
    """Notes on the resolution of pressures."""
    forces, stiffness = np.zeros((2, end.problem.n))
    forces[end.balance.nodes] = end.contacts.reactions(end.balance)
    against = end.stiffness.array_r[end.balance.bounds.dofs]
    if (give := end.balance.give) is not None:  # wear levels errors of gaps
        against = against / (1.0 + give * against)
    stiffness[end.balance.nodes] = against
    forces[forces <= np.maximum(end.residual.limit, stiffness * gap_round_off(end.problem.u))] = 0.0
    notes, few = list[str](), list[str]()
    for link in end.problem.system.unilateral:
        notes += note_on_facets(link, end.problem, forces, stiffness)
        if any_rank(end.problem.comm, forces[link.nodes].any())[0]:
            few += notes_on_resolution(link, end.contacts)
    return notes + few


def note_strains(end: StepEnd) -> list[str]:
    """Note if the neglected term or any strain or rotation is large; collective."""
    problem, found, felt = end.problem, end.left_out, end.left_out.felt
    large = problem.solid.gradients.small and found.own.max() > LARGE
    if felt.max() < 1.0 and not large:
        return []
    body = int(np.argmax(felt if felt.max() >= 1.0 else found.own.max(axis=0)))
    (strain, rotation), others = found.own[:, body], int((felt >= 1.0).sum()) - 1
    more = f" (and {others} more)" if others > 0 else ""
    seen = (
        f"{name_of(problem.bodies, [body])}{more}: strains "
        f"of up to {strain:.1%} and rotations of up to {np.degrees(rotation):.1f} degrees"
        f"{' are no longer small' if others < 0 else ''}; the small strain leaves out "
        f"up to {found.strain:.2g}, {found.work:.1%} of the work of the stresses and "
        f"{found.lengths:.2%} of lengths"
    )
    why = (
        f"Strains beyond {LARGE:.0%} or rotations beyond {np.degrees(LARGE):.1f} degrees are wrong "
        "by half of themselves and more, forces by the share of the work. Choose a finite strain, "
        "Solid(.., strain='finite'), reduce strains and rotations, or mesh the body nearer to its "
        "final position"
    )
    return [Note(seen, why)]


def note_lost_stress(end: StepEnd) -> list[str]:
    """Note on laws of the additive form out of range; collective."""
    share, name = largest_stress_lost(end.problem.comm, end.problem.solid.points.found)
    if share < LARGEST_SHARE:
        return []
    seen = (
        f"{name} is computed in the logarithmic strain space, where shear softens: the norm of the "
        f"stress is up to {100 * share:.0f} % below that of the law"
    )
    why = (
        "It is 2 % at a shear of 1, whose shear stress is 3 % too low; 9 % and 17 % at a shear of "
        "2. Isotropic laws without kinematic hardening have no such limit"
    )
    return [Note(seen, why)]


def note_on_facets(
    link: Link, problem: ContactProblem, forces: Floats, stiffness: Floats
) -> list[str]:
    """Note on a contact if facets make its pressures inaccurate; collective.

    Errors h_j of gaps are, with facets, the height of smooth surfaces, minus its mean over loaded
    nodes; with smooth surfaces of degree 1 `missed_heights`. K^_jj h_j is compared with the contact
    forces z_j, at loaded nodes and those with gaps below h_j.
    Uniform facets on a tool: forces F of an overlap w store Psi = F w / 2, and -z.h is 2 Psi (1 -
    F'/F), F' the force of the smooth surface. Forces and stiffness K^_jj are (owned nodes,).
    """
    comm, k, z = problem.comm, stiffness[link.nodes], forces[link.nodes]
    on, meshed = z > 0.0, link.pairing is not None
    touches = any_rank(comm, on.any())[0]
    even = _missed(link, problem.configuration) if touches or meshed else None
    if even is None:
        return []
    missed, smooth = even, meshed and link.interface.smooth
    if smooth or not touches:
        least = HALF_OF_DIGITS * mean_facet_length(link.sides.slave)
        near = np.abs(missed) if smooth else missed - least
        on = on | (link.coupling.kept[:, 0] & (link.gaps(problem.positions()) <= near))
    else:
        total, count = comm.allreduce(np.array([missed[on].sum(), on.sum()]))
        missed = missed - total / max(count, 1)
    share, right = ratio(norm(comm, k[on] * missed[on]), norm(comm, z)), SPOILT
    if share <= SPOILT and not meshed and (stored := problem.solid.potential()) is not None:
        work = comm.allreduce(float(z @ even))
        share, missed, right = ratio(abs(work), 2.0 * abs(stored)), even, 0.25 * SPOILT
    if share <= right:
        return []
    largest = float(maximum(comm, np.abs(missed[on]).max(initial=0.0))[0])
    worth = "and no node carries: forces may be missing"
    if np.isfinite(share):
        worth = f"worth up to {100 * share:.0f} % of the contact forces, which may be wrong"
    what = "smooth surfaces through the nodes" if smooth else "facets of curved sides"
    seen = f"{link.interface}: gaps of {what} are known to {largest:.2g} here, {worth}"
    return [Note(seen, "Refine" if smooth else "Choose surface='smooth', or refine")]


def _missed(link: Link, u: fem.Function | None) -> Floats | None:
    """Errors (n,) of gaps, None where they are exact; collective."""
    pattern, slave, tool = link.pattern, link.sides.slave, link.interface.tool
    if link.pairing is not None:
        smooth = pattern.smooth or pattern.nearby
        assert smooth is not None, "of contacts only"
        curved = slave.element.degree == 1 and not are_flat(link, smooth)
        if link.interface.smooth and not curved:
            return None
        (pairing, operators), weight = link.mortar, link.mortar[1].weight
        find = missed_heights if link.interface.smooth else point_heights
        found = find(pairing, operators.segments, u, smooth)
        return _nodal_means(link, pairing, operators.segments, weight, found)
    if not isinstance(pattern, SidePattern):  # of a user's interface
        return None
    side, faceted = pattern.side, pattern.faceted
    if tool is None or side is None or faceted is None or slave.element.degree > 1 or pattern.nodal:
        return None
    x = coordinates(slave, u)
    segments, points = whole_facets(side, x, find_facing(side, tool, x))
    flat, smooth_gaps = (
        point_gaps(which, tool, u, segments, points)[0]
        for which in (pattern, replace(pattern, nodal=True))
    )
    weight = link.coupling.weight
    return faceted * _nodal_means(link, side, segments, weight, flat - smooth_gaps)


def _nodal_means(
    link: Link, of: Pairing | WholeSide, segments: Segments, weight: Floats, at_points: Floats
) -> Floats:
    Phi = weighted_duals(of, segments, link.with_ghosts(link.coupling.kept[:, 0]) > 0.0)
    return mean_values(of, segments, Phi, weight[:, :1], at_points[:, None])[:, 0]


def notes_on_resolution(link: Link, contacts: Contacts) -> list[str]:
    """Note on a largest pressure that is not resolved; collective.

    Not of patches up to the ends of sides, with singular pressures.
    """
    count, ends = _peak_patch(link, contacts)
    wanted = NODES[link.sides.fixed.shape[1]]
    if not (ends and 0 < count < wanted):
        return []
    slave, master, told = link.sides.slave, link.sides.surfaces[-1], ""
    common = link.coupling.common if master is not slave else None
    below = common is not None and (contacts.active[link.nodes] & common.below_edges).any()
    if any_rank(link.sides.V.mesh.comm, below)[0]:
        told = (
            f"; an edge or a corner of {master.label} presses between nodes of "
            f"slave={slave.label}, and its force acts at one of these, up to a facet beside it"
        )
    seen = (
        f"{link.interface}: the largest pressure is not resolved: its patch has {count} nodes in "
        f"contact, and {wanted} are needed{told}"
    )
    return [Note(seen, "Refine there" + ", or exchange slave and master" * bool(told))]


def _peak_patch(link: Link, contacts: Contacts) -> tuple[int, bool]:
    """Number of nodes of the patch with the peak, and whether it ends at open nodes; collective."""
    slave, nodes, layout = link.sides.slave, link.nodes, link.sides.V.dofmap.index_map
    kept, planes = link.coupling.kept[:, 0], link.sides.mirrors[nodes].sum(axis=1)
    number = layout.local_to_global(slave.nodes).astype(np.int64)
    rows = number[: slave.owned], contacts.active[nodes], contacts.multipliers[nodes], planes
    on = link.with_ghosts(kept) > 0.0
    sides = [slave.facets[:, [a, b]] for a, b in combinations(range(slave.facets.shape[1]), 2)]
    pairs = np.concatenate([number[ab[on[ab].all(axis=1)]] for ab in sides])
    sent = link.sides.V.mesh.comm.allgather((np.column_stack(rows)[kept], pairs))
    table, pairs = (np.concatenate(each) for each in zip(*sent, strict=True))
    known, active, multiplier, planes = table[np.argsort(table[:, 0])].T
    closed, (a, b) = active > 0.0, np.searchsorted(known, pairs).T
    if not closed.any():
        return 0, False
    both = closed[a] & closed[b]
    patch = components(a[both], b[both], len(closed))
    inside = closed & (patch == patch[np.where(closed, multiplier, -np.inf).argmax()])
    ends = (inside[a] & ~closed[b]) | (inside[b] & ~closed[a])
    return int((2.0 ** (planes[inside].max() - planes[inside])).sum()), bool(ends.any())


# the same order on all ranks
DIAGNOSES = note_partners, note_strains, note_lost_stress, note_pressures


def find_notes(end: StepEnd) -> list[str]:
    """All notes; rank 0 logs each kind once; collective."""
    notes = [note for diagnose in DIAGNOSES for note in diagnose(end)]
    if end.problem.comm.rank == 0:
        for note in notes:
            kind = _kind(note, [repr(i) for i in end.problem.interfaces])
            if kind not in end.problem.logged:
                end.problem.logged.add(kind)
                more = "; problem.diagnose() says more" * hasattr(note, "why")
                log.warning("%s%s", note, more)
    return notes


def _kind(note: str, names: Sequence[str]) -> str:
    """Note without numbers, except in the name of its interface.

    >>> _kind("Contact(slave=1): 1.5e-3 deep in 2 facets", ["Contact(slave=1)"])
    'Contact(slave=1): # deep in # facets'
    """
    name = max((name for name in names if note.startswith(name)), key=len, default="")
    return name + re.sub(r"\d[\d.]*(e[-+]?\d+)?", "#", note[len(name) :])

# SPDX-License-Identifier: MIT
"""Resolution of pressures: heights of curved sides, nodes of the largest patch, oscillations."""

from dataclasses import replace
from itertools import combinations

from mpi4py import MPI

import numpy as np
import scipy

from dolfinx import fem
from dolfinx_mortar.algebra.parallel import any_rank, maximum, norm, ratio
from dolfinx_mortar.audit.audit import SPOILT, are_flat
from dolfinx_mortar.common.arrays import HALF_OF_DIGITS, Bools, Floats
from dolfinx_mortar.common.step_report import Note
from dolfinx_mortar.geometry.segments import Segments
from dolfinx_mortar.interfaces.link import Link
from dolfinx_mortar.interfaces.tool import SidePattern, find_facing, point_gaps
from dolfinx_mortar.mortar.curvature_correction import missed_heights, point_heights
from dolfinx_mortar.mortar.duals import weighted_duals
from dolfinx_mortar.mortar.operators import WholeSide, mean_values, whole_facets
from dolfinx_mortar.mortar.pairing import Pairing
from dolfinx_mortar.mortar.surface import coordinates, mean_facet_length, sum_at_nodes
from dolfinx_mortar.problem.contacts import Contacts
from dolfinx_mortar.problem.problem import ContactProblem

# Nodes that resolve the largest pressure, in 2D and 3D: errors against Hertz are at most 9 % with 5
# nodes and 3 % with 7 in 2D, 14 % with 9 and 4 % with 17 in 3D.
NODES = {2: 7, 3: 17}
# Oscillation of plane pressures over their mean: on disc and block .007 to .083 where pressures are
# within a tenth of Hertz', .15 to 1 where a fifth off.
OSCILLATION = 0.1


def note_on_facets(
    link: Link, problem: ContactProblem, forces: Floats, stiffness: Floats
) -> list[str]:
    """Note on a contact if facets make its pressures inaccurate; collective.

    Errors h_j of gaps are, with facets, the height of smooth surfaces, minus its mean over loaded
    nodes; with smooth surfaces of degree 1 `missed_heights`. K^_jj h_j is compared with the contact
    forces z_j, at loaded nodes and those with gaps below h_j. A uniform h_j counts two to four
    times, a soft master is taken for a stiff one.
    Uniform facets on a tool: forces F of an overlap w store Psi = F w / 2, and -z.h is 2 Psi (1 -
    F'/F), F' the force of the smooth surface (accurate to 1 % on rings of 64 facets).

    Args:
        forces: (owned nodes,) of contact.
        stiffness: (owned nodes,) K^_jj.
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
    pose, x = tool.pose(), coordinates(slave, u)
    segments, points = whole_facets(side, x, find_facing(side, pose, tool.asked, x))
    flat, smooth_gaps = (
        point_gaps(which, pose, tool.asked, u, segments, points)[0]
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
    """Notes on pressures that are not resolved, or that oscillate; collective.

    Not of patches up to the ends of sides, with singular pressures. Pressures oscillate where the
    multiplier space of a fine, stiff slave side exceeds the trace space of the master.
    """
    count, ends = _peak_patch(link, contacts)
    if not ends:
        return []
    d, comm = link.sides.fixed.shape[1], link.sides.V.mesh.comm
    closed = comm.allreduce(int(contacts.active[link.nodes].sum()))
    if d == 2 and len(link.sides.surfaces) > 1 and closed >= NODES[d]:
        share = oscillation(link, contacts)
        if share > OSCILLATION:
            seen = f"{link.interface}: pressures oscillate from node to node, by {share:.0%} of "
            why = "Forces are accurate: exchange slave and master, or refine the master there"
            return [Note(f"{seen}their mean", why)]
    if not 0 < count < NODES[d]:
        return []
    slave, master, told = link.sides.slave, link.sides.surfaces[-1], ""
    common = link.coupling.common if master is not slave else None
    below = common is not None and (contacts.active[link.nodes] & common.below_edges).any()
    if any_rank(comm, below)[0]:
        told = (
            f"; an edge or a corner of {master.label} presses between nodes of "
            f"slave={slave.label}, and its force acts at one of these, up to a facet beside it"
        )
    seen = (
        f"{link.interface}: the largest pressure is not resolved: its patch has {count} nodes in "
        f"contact, and {NODES[d]} are needed{told}"
    )
    return [Note(seen, "Refine there" + ", or exchange slave and master" * bool(told))]


def oscillation(link: Link, contacts: Contacts) -> float:
    """Amplitude of node-to-node oscillations of pressures, over their mean; collective.

    sum_j D_jj |d_j - (M d)_j| / 4 over sum_j D_jj p_j, d = p - M p, p_j the multipliers, M the mean
    over the other nodes of the facets of j; d_j = 0 next to nodes without multiplier. In the plane
    p (1 +- a) gives a.
    """
    slave, nodes, comm = link.sides.slave, link.nodes, link.sides.V.mesh.comm
    own = np.column_stack([contacts.multipliers[nodes], link.coupling.kept[:, 0]])
    p, kept = link.with_ghosts(own).T

    def of_neighbours(values: Floats) -> Floats:
        there = values[slave.facets]
        return sum_at_nodes(slave, (there.sum(axis=1, keepdims=True) - there)[:, :, None])[:, 0]

    count = np.maximum(of_neighbours(np.ones_like(p)), 1.0)
    inner = (kept > 0) & (of_neighbours(kept) == count)
    d = np.where(inner, p - of_neighbours(p) / count, 0.0)
    size = np.abs(d - of_neighbours(d) / count) / 4.0
    w = link.coupling.weight[:, 0]
    amplitude, pressure = comm.allreduce(w @ np.column_stack([size, p])[: slave.owned], op=MPI.SUM)
    return ratio(amplitude, pressure)


def _peak_patch(link: Link, contacts: Contacts) -> tuple[int, bool]:
    """Number of nodes of the patch with the peak, and whether it ends at open nodes; collective."""
    slave, nodes = link.sides.slave, link.nodes
    active, planes = contacts.active[nodes], link.sides.mirrors[nodes].sum(axis=1)
    off = link.with_ghosts(link.coupling.kept[:, 0] & ~active)[slave.facets]
    beside = np.repeat(off.max(axis=1)[:, None, None], off.shape[1], axis=1)
    ends = sum_at_nodes(slave, beside)[: slave.owned, 0] > 0.0
    patches = find_patches(link, active, contacts.multipliers[nodes], planes, ends)
    if not patches:
        return 0, False
    fixed, open_ = max(patches, key=lambda patch: float(patch[:, 0].max()))[:, 1:].T
    return int((2.0 ** (fixed.max() - fixed)).sum()), bool(open_.any())


def find_patches(link: Link, marked: Bools, *columns: Floats | Bools) -> list[Floats]:
    """Tables of ``columns`` (n,) or (n, c) by patch of marked nodes; collective."""
    slave, comm, layout = link.sides.slave, link.sides.V.mesh.comm, link.sides.V.dofmap.index_map
    on = link.with_ghosts(marked) > 0.0
    number = layout.local_to_global(slave.nodes).astype(np.int64)
    own = np.column_stack([number[: slave.owned], *columns])[marked]
    sides = [slave.facets[:, [a, b]] for a, b in combinations(range(slave.facets.shape[1]), 2)]
    pairs = np.concatenate([number[ab[on[ab].all(axis=1)]] for ab in sides])
    table, pairs = (np.concatenate(comm.allgather(rows)) for rows in (own, pairs))
    table = table[np.argsort(table[:, 0])]
    ends = np.searchsorted(table[:, 0], pairs)
    graph = scipy.sparse.coo_array((np.ones(len(ends)), ends.T), shape=(len(table), len(table)))
    count, label = scipy.sparse.csgraph.connected_components(graph, directed=False)
    return [table[label == k, 1:] for k in range(count)]

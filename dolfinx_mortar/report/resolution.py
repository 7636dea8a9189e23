# SPDX-License-Identifier: MIT
"""Whether the contact patch with the largest pressure has enough nodes to resolve it."""

from collections.abc import Sequence
from itertools import combinations

from mpi4py import MPI

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from dolfinx_mortar.algebra.parallel import any_rank, ratio
from dolfinx_mortar.arrays import Bools, Floats, Longs
from dolfinx_mortar.interfaces.link import Link
from dolfinx_mortar.mortar.surface import accumulate, sum_at_nodes
from dolfinx_mortar.newton_method.contacts import Contacts

# Nodes that resolve the largest pressure, in 2D and 3D. Measured against Hertz' at the same
# force, on triangles, quadrilaterals, tetrahedra and hexahedra, either slave: 3 nodes of a line
# contact miss it by -5 to 33 %, 5 by -3 to 9 %, 7 by -3 to 1 % (a pin with 1 % clearance: 5 by -3
# to 3 %, 7 by -1 to 3 %); 9 nodes of a point contact by -14 to 5 %, 13 by -1 %, 17 to 25 by -2 to
# 4 %.
NODES = {2: 7, 3: 17}
# Pressures in the plane oscillate by more than this share of their mean. Disc and block, moduli
# 1:100 to 100:1, slave facets .3 to 3.4 times as long as the master's, with seven closed nodes or
# more: .007 to .083 where pressures differ from Hertz' by a tenth at most, in the mean; .15 to 1
# where they do by more than a fifth.
OSCILLATION = 0.1


def note_on_resolution(link: Link, contacts: Contacts, sure: bool = True) -> str:
    """Return the note on pressures that are not resolved, or that oscillate, or ""; collective.

    A patch that reaches the ends of its sides is left out: its size is given by the model, and its
    pressures may be singular there. Multipliers of a slave side that is finer and stiffer than the
    master are not controlled by it, and oscillate: their dual space has more dofs than the trace of
    the displacements that yield. That is measured in the plane only.

    The force of a multiplier acts at its slave node. Below an edge of the master that of only one
    of the nodes around has a mean gap of zero, and lever arms are wrong by up to a facet: of two
    cantilevers that slide along each other forces by up to 9 %, as the arm to the third power.

    Args:
        link: the interface.
        contacts: which contacts are closed, and their multipliers.
        sure: whether facets and edges do not spoil its forces, as far as is known.
    """
    count, ends = _peak_patch(link, contacts)
    if not ends:
        return ""
    d, comm = link.sides.fixed.shape[1], link.sides.V.mesh.comm
    closed = comm.allreduce(int(contacts.active[link.nodes].sum()))
    if d == 2 and len(link.sides.surfaces) > 1 and closed >= NODES[d]:
        share = oscillation(link, contacts)
        if share > OSCILLATION:
            told = "; forces are accurate, single pressures are not" if sure else ""
            return (
                f"{link.interface}: pressures oscillate from node to node, by {share:.0%} of their "
                f"mean{told}: exchange slave and master, or refine the master there"
            )
    if not 0 < count < NODES[d]:
        return ""
    slave, master = link.sides.slave, link.sides.surfaces[-1]
    common, told = link.coupling.common if master is not slave else None, ""
    below = common is not None and (contacts.active[link.nodes] & common.below_edges).any()
    if any_rank(comm, below)[0]:
        told = (
            f", or exchange slave and master: an edge or a corner of {master.label} presses "
            f"between nodes of slave={slave.label}, and its force acts at one of these, up to a "
            "facet beside it"
        )
    return (
        f"{link.interface}: the largest pressure is not resolved: its patch has {count} nodes in "
        f"contact, and {NODES[d]} are needed; refine there{told}"
    )


def oscillation(link: Link, contacts: Contacts) -> float:
    """Return the amplitude of pressures that oscillate from node to node, over their mean.

    sum_j D_jj |d_j - (M d)_j| / 4 over sum_j D_jj p_j, with d = p - M p, p_j the multiplier of
    slave node j, 0 if it is open, and M the mean over the other nodes of its facets; d_j is 0 where
    j or one of these cannot carry a multiplier. In the plane pressures p (1 +- a) have the value a,
    and smooth ones a difference of the fourth order. Collective.
    """
    slave, nodes, comm = link.sides.slave, link.nodes, link.sides.V.mesh.comm
    own = np.zeros((len(slave.nodes), 2))
    own[: slave.owned] = np.column_stack([contacts.multipliers[nodes], link.coupling.kept[:, 0]])
    p, kept = accumulate(slave, own).T

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


def notes_on_rims(links: Sequence[Link]) -> list[str]:
    """Return a note for each interface with nodes that lost and regained a multiplier; collective.

    They keep it although they are covered less than other nodes have to be
    (`mortar.duals.STAYS`). Nodes that are well covered again are not noted.
    """
    notes = []
    for link in links:
        faces = link.coupling.coverage.faces
        own = int((link.coupling.returned.any(axis=1) & ~faces).sum())
        if count := link.sides.V.mesh.comm.allreduce(own, op=MPI.SUM):
            notes.append(
                f"{link.interface}: {count} slave nodes at the rim of the other side gained and "
                "lost their multiplier by turns, because each of the two states leads to the "
                "other; they keep it. The finer the mesh at the rim, the smaller the difference"
            )
    return notes


def _peak_patch(link: Link, contacts: Contacts) -> tuple[int, bool]:
    """Return how many nodes the patch with the peak has, and whether it ends; collective.

    It ends where its nodes have open neighbours that could close. Connected are active nodes of one
    facet, over all ranks. Of a model cut by planes of symmetry the whole patch counts: a node off
    all planes stands for two to the number of planes.
    """
    slave, nodes = link.sides.slave, link.nodes
    active, planes = contacts.active[nodes], link.sides.mirrors[nodes].sum(axis=1)
    marks = np.zeros((len(slave.nodes), 1))
    marks[: slave.owned, 0] = link.coupling.kept[:, 0] & ~active
    (off,) = (accumulate(slave, marks) > 0).T
    beside = np.repeat(off[slave.facets].any(axis=1)[:, None], slave.facets.shape[1], axis=1)
    ends = sum_at_nodes(slave, beside[:, :, None])[: slave.owned, 0] > 0
    return _measure(find_patches(link, active, contacts.multipliers[nodes], planes, ends))


def find_patches(link: Link, marked: Bools, *columns: Floats | Bools) -> list[Floats]:
    """Return the patches of connected slave nodes, those of one facet over all ranks; collective.

    Args:
        marked: (n,) nodes that count.
        columns: (n,) or (n, c) what the tables of patches shall say of their nodes.
    """
    slave, comm, layout = link.sides.slave, link.sides.V.mesh.comm, link.sides.V.dofmap.index_map
    marks = np.zeros((len(slave.nodes), 1))
    marks[: slave.owned, 0] = marked
    on = accumulate(slave, marks)[:, 0] > 0
    number = layout.local_to_global(slave.nodes).astype(np.int64)
    table = np.column_stack([number[: slave.owned], *columns])
    pairs = np.concatenate(comm.allgather(_pairs(number[slave.facets], on[slave.facets])))
    return _patches(np.concatenate(comm.allgather(table[marked])), pairs)


def _pairs(facets: Longs, on: Bools) -> Longs:
    """Return the pairs (p, 2) of marked nodes that facets (m, k) have in common."""
    found = [
        facets[on[:, a] & on[:, b]][:, [a, b]] for a, b in combinations(range(facets.shape[1]), 2)
    ]
    return np.concatenate(found)


def _patches(table: Floats, pairs: Longs) -> list[Floats]:
    """Return the rows of a table (n, 1 + c) of each patch, without their numbers.

    Args:
        table: numbers of nodes, and more of them.
        pairs: connected ones (p, 2), by number.
    """
    table = table[np.argsort(table[:, 0])]
    ends = np.searchsorted(table[:, 0], pairs)
    graph = coo_array((np.ones(len(ends)), ends.T), shape=(len(table), len(table)))
    count, label = connected_components(graph, directed=False)
    return [table[label == k, 1:] for k in range(count)]


def _measure(patches: Sequence[Floats]) -> tuple[int, bool]:
    """Return the size of the patch with the largest multiplier, and whether it ends.

    Args:
        patches: multiplier, prescribed components and open neighbours of nodes, (n, 3) each.
    """
    if not patches:
        return 0, False
    fixed, open_ = max(patches, key=lambda patch: float(patch[:, 0].max()))[:, 1:].T
    return int((2.0 ** (fixed.max() - fixed)).sum()), bool(open_.any())

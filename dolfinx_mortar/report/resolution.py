# SPDX-License-Identifier: MIT
"""Whether the contact patch with the largest pressure has enough nodes to resolve it."""

from collections.abc import Sequence
from itertools import combinations

from mpi4py import MPI

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

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


def note_on_few_nodes(link: Link, contacts: Contacts, sure: bool = True) -> str:
    """Return the note on a contact whose largest pressure is not resolved, or ""; collective.

    A patch that reaches the ends of its sides is left out: its size is given by the model.

    Args:
        contacts: which contacts are closed, and their multipliers.
        sure: whether facets do not spoil its forces, as far as is known.
    """
    count, ends = _peak_patch(link, contacts)
    needed = NODES[link.sides.fixed.shape[1]]
    if not 0 < count < needed or not ends:
        return ""
    forces = "forces and moments are accurate; " if sure else ""
    return (
        f"{link.interface}: the largest pressure is not resolved: its patch has {count} nodes in "
        f"contact, and {needed} are needed; {forces}refine there"
    )


def notes_on_rims(links: Sequence[Link]) -> list[str]:
    """Return a note for each interface with nodes that lost and regained a multiplier; collective.

    They keep it although they are covered less than other nodes have to be
    (`mortar.integrals.STAYS`). Nodes that are well covered again are not noted.
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
    slave, nodes, comm = link.sides.slave, link.nodes, link.sides.V.mesh.comm
    active, fixed = contacts.active[nodes], link.sides.fixed[nodes].sum(axis=1)
    open_ = link.coupling.kept[:, 0] & ~active
    marks = np.zeros((len(slave.nodes), 2))
    marks[: slave.owned] = np.column_stack([active, open_])
    on, off = (accumulate(slave, marks) > 0).T
    layout = link.sides.V.dofmap.index_map
    number = layout.local_to_global(slave.nodes).astype(np.int64)
    pairs = _pairs(number[slave.facets], on[slave.facets])
    beside = np.repeat(off[slave.facets].any(axis=1)[:, None], slave.facets.shape[1], axis=1)
    ends = sum_at_nodes(slave, beside[:, :, None])[: slave.owned, 0] > 0
    table = np.column_stack([number[: slave.owned], contacts.multipliers[nodes], fixed, ends])
    table = np.concatenate(comm.allgather(table[active]))
    pairs = np.concatenate(comm.allgather(pairs))
    return _measure(table, pairs) if len(table) else (0, False)


def _pairs(facets: Longs, on: Bools) -> Longs:
    """Return the pairs (p, 2) of marked nodes that facets (m, k) have in common."""
    found = [
        facets[on[:, a] & on[:, b]][:, [a, b]] for a, b in combinations(range(facets.shape[1]), 2)
    ]
    return np.concatenate(found)


def _measure(table: Floats, pairs: Longs) -> tuple[int, bool]:
    """Return the size of the patch with the largest multiplier, and whether it ends.

    Args:
        table: number, multiplier, prescribed components and open neighbours of nodes (n, 4).
        pairs: connected ones (p, 2), by number.
    """
    table = table[np.argsort(table[:, 0])]
    ends = np.searchsorted(table[:, 0], pairs)
    graph = coo_array((np.ones(len(ends)), ends.T), shape=(len(table), len(table)))
    _, label = connected_components(graph, directed=False)
    patch = table[label == label[np.argmax(table[:, 1])]]
    planes = patch[:, 2].max() - patch[:, 2]
    return int((2.0**planes).sum()), bool(patch[:, 3].any())

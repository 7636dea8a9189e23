# SPDX-License-Identifier: MIT
"""What is drawn, on rank 0: cells, facets and their nodes, gathered from all ranks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import cycle, pairwise
from typing import Any

from mpi4py import MPI

import numpy as np

import basix
from dolfinx import fem, plot
from dolfinx import mesh as dmesh
from dolfinx_mortar.arrays import Floats, Ints, Longs
from dolfinx_mortar.geometry.elements import FACETS_OF
from dolfinx_mortar.tags import names_of

# By number of nodes of a triangle or quadrilateral: corners, middles of edges, the one inside.
WAY_AROUND = {
    3: (0, 1, 2),
    4: (0, 1, 2, 3),
    6: (0, 3, 1, 4, 2, 5),
    9: (0, 4, 1, 5, 2, 6, 3, 7),
}
TRIANGLES = {
    3: ((0, 1, 2),),
    4: ((0, 1, 2), (0, 2, 3)),
    6: ((0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)),
    9: tuple((a, b, 8) for a, b in pairwise((*WAY_AROUND[9], 0))),
}
NO_TAG = np.iinfo(np.int32).min


@dataclass(frozen=True)
class Parts:
    """Cells in the plane, or facets, with values at their nodes and of themselves."""

    x: Floats  # (n, 3)
    nodes: Longs  # (m, k): vertices on the way around, middles of edges, the one inside
    at_nodes: dict[str, np.ndarray] = field(default_factory=dict)  # (n,) or (n, c)
    of_parts: dict[str, np.ndarray] = field(default_factory=dict)  # (m,)

    def where(self, chosen: np.ndarray) -> Parts:
        """Return some of the parts."""
        of_parts = {name: values[chosen] for name, values in self.of_parts.items()}
        return replace(self, nodes=self.nodes[chosen], of_parts=of_parts)


def gather(
    comm: MPI.Comm,
    own: Parts,
    number: Longs,
) -> Parts | None:
    """Return the parts of all ranks on rank 0, each and each node once; None elsewhere; collective.

    Args:
        comm: communicator.
        own: parts of this rank.
        number: (n,) global numbers of its nodes.
    """
    used = np.unique(own.nodes)
    row = (
        number[used],
        own.x[used],
        number[own.nodes],
        {name: values[used] for name, values in own.at_nodes.items()},
        own.of_parts,
    )
    rows = comm.gather(row if own.nodes.size else None)
    if rows is None:
        return None
    rows = [row for row in rows if row is not None]
    if not rows:
        return replace(own, x=own.x[:0], nodes=np.empty((0, 1), dtype=np.int64))
    numbers, x, nodes = (np.concatenate([row[i] for row in rows]) for i in range(3))
    known, first = np.unique(numbers, return_index=True)
    nodes = np.searchsorted(known, nodes)
    _, once = np.unique(np.sort(nodes, axis=1), axis=0, return_index=True)
    at_nodes = {n: np.concatenate([row[3][n] for row in rows])[first] for n in own.at_nodes}
    of_parts = {n: np.concatenate([row[4][n] for row in rows])[once] for n in own.of_parts}
    return Parts(x[first], nodes[once], at_nodes, of_parts)


def parts_of_mesh(domain: dmesh.Mesh, dim: int, entities: Ints, values: Ints) -> Parts | None:
    """Return local cells or facets of a mesh, with their tags, on rank 0; collective."""
    tdim = domain.topology.dim
    for pair in ((dim, tdim), (tdim, dim), (dim, 0)):
        domain.topology.create_connectivity(*pair)
    x = np.asarray(domain.geometry.x, dtype=float)
    nodes = np.empty((0, 1), dtype=np.int64)
    if len(entities):  # dolfinx would divide by their number
        listed, _, _ = plot.vtk_mesh(domain, dim, np.asarray(entities, dtype=np.int32))
        nodes = listed.reshape(len(entities), -1)[:, 1:].astype(np.int64)
    index_map = domain.geometry.index_map()
    every = np.arange(len(x), dtype=np.int32)
    own = Parts(x, nodes, of_parts={"tag": np.asarray(values)})
    return gather(domain.comm, own, index_map.local_to_global(every))


def parts_of_space(
    V: fem.FunctionSpace,
    at_nodes: Mapping[str, np.ndarray],
    of_cells: Mapping[str, np.ndarray],
) -> Parts | None:
    """Return cells of bodies in the plane, or outer facets of others, on rank 0; collective.

    Args:
        V: Lagrange space of degree 1 or 2; its nodes are those of the parts.
        at_nodes: values at the local nodes.
        of_cells: values of the owned cells.
    """
    x = V.tabulate_dof_coordinates()
    if V.mesh.topology.dim == 2:
        listed, _, _ = plot.vtk_mesh(V)
        nodes = listed.reshape(-1, V.dofmap.dof_layout.num_dofs + 1)[:, 1:]
        of_parts = dict(of_cells)
    else:
        _, cells, index = outer_facets(V.mesh)
        count = len(basix.topology(V.mesh.basix_cell())[2])
        closure = [V.dofmap.dof_layout.entity_closure_dofs(2, i) for i in range(count)]
        order = FACETS_OF[V.mesh.topology.cell_name(), V.element.basix_element.degree].order
        nodes = V.dofmap.list[cells[:, None], np.array(closure)[:, order][index]]
        of_parts = {name: values[cells] for name, values in of_cells.items()}
    own = Parts(x, nodes.astype(np.int64), dict(at_nodes), of_parts)
    every = np.arange(len(x), dtype=np.int32)
    return gather(V.mesh.comm, own, V.dofmap.index_map.local_to_global(every))


def outer_facets(domain: dmesh.Mesh) -> tuple[Ints, Ints, Ints]:
    """Return the outer facets that this rank owns, their cells and their numbers in these."""
    topology, d = domain.topology, domain.topology.dim
    for pair in ((d - 1, d), (d, d - 1)):
        topology.create_connectivity(*pair)
    facets = dmesh.exterior_facet_indices(topology)
    to_cell = topology.connectivity(d - 1, d)
    cells = to_cell.array[to_cell.offsets[facets]]
    count = len(basix.topology(domain.basix_cell())[d - 1])
    own = topology.connectivity(d, d - 1).array.reshape(-1, count)[cells]
    return facets, cells, np.argmax(own == facets[:, None], axis=1).astype(np.int32)


def parts_of_side(V: fem.FunctionSpace, surface: Any, x: Floats, values: Floats) -> Parts | None:
    """Return the facets of one side of an interface, at points x (n, d), on rank 0; collective.

    Args:
        V: space of the displacement.
        surface: its nodes (local numbers) and facets (indices into these).
        x: (local nodes, d) coordinates.
        values: (local nodes,) what is drawn.
    """
    nodes = surface.nodes
    points = np.zeros((len(nodes), 3))
    points[:, : x.shape[1]] = x[nodes]
    facets = surface.facets.astype(np.int64)
    own = Parts(points, facets, {"value": values[nodes]})
    return gather(V.mesh.comm, own, V.dofmap.index_map.local_to_global(nodes))


def groups(
    parts: Parts, tags: dmesh.MeshTags | None, colours: Sequence[str]
) -> Iterator[tuple[str, str, Parts]]:
    """Yield name, colour and parts of each tag that there is; colours recur if they are few."""
    values = parts.of_parts["tag"]
    names = {tag: name for name, tag in names_of(tags).items()} | {NO_TAG: "no tag"}
    for tag, colour in zip(np.unique(values), cycle(colours), strict=False):
        yield names.get(int(tag), f"tag {tag}"), colour, parts.where(values == tag)


def curves(ends: Longs) -> Iterator[list[tuple[int, bool]]]:
    """Yield the lines of each curve in order: (line, whether it is passed backwards).

    Args:
        ends: (m, 2) nodes at the ends of each line.

    >>> list(curves(np.array([[1, 2], [1, 0], [5, 4]])))
    [[(0, True), (1, False)], [(2, False)]]
    """
    pairs = [(int(a), int(b)) for a, b in ends]
    at: dict[int, list[int]] = {}
    for line, pair in enumerate(pairs):
        for node in pair:
            at.setdefault(node, []).append(line)
    left = set(range(len(pairs)))
    for start in sorted(at, key=lambda node: len(at[node]) != 1):  # closed curves start anywhere
        node, found = start, []
        while lines := [line for line in at[node] if line in left]:
            first, second = pairs[lines[0]]
            left.remove(lines[0])
            found.append((lines[0], second == node))
            node = first if second == node else second
        if found:
            yield found

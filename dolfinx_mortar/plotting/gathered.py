# SPDX-License-Identifier: MIT
"""Cells or facets with values, gathered from all ranks on rank 0."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import cycle

import numpy as np

import basix
from dolfinx import fem, plot
from dolfinx import mesh as dmesh
from dolfinx_mortar.arrays import Floats, Ints, Longs
from dolfinx_mortar.geometry.elements import FACETS_OF
from dolfinx_mortar.tags import names_of

SIDES = ("#d62728", "#1f77b4", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf", "#8c564b", "#e377c2")
NO_TAG = np.iinfo(np.int32).min
Values = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class Parts:
    """Cells in the plane, or facets, with values at their nodes and of themselves."""

    x: Floats  # (n, 3)
    nodes: Longs  # (m, k): vertices in order around the part, middles of edges, the one inside
    at_nodes: Values  # (n,) or (n, c)
    of_parts: Values  # (m,)

    def where(self, chosen: np.ndarray) -> Parts:
        """Return some of the parts."""
        of_parts = {name: values[chosen] for name, values in self.of_parts.items()}
        return replace(self, nodes=self.nodes[chosen], of_parts=of_parts)


def gather_bodies(V: fem.FunctionSpace, at_nodes: Values, of_cells: Values) -> Parts | None:
    """Return the cells of bodies in the plane, or the outer facets of others, on rank 0.

    Collective; None on all other ranks.

    Args:
        V: Lagrange space of degree 1 or 2; its nodes are those of the parts.
        at_nodes: values at the local nodes, (n,) or (n, c).
        of_cells: (cells,) values of the owned cells.
    """
    topology = V.mesh.topology
    if topology.dim == 2:
        listed, _, _ = plot.vtk_mesh(V)
        nodes = listed.reshape(-1, V.dofmap.dof_layout.num_dofs + 1)[:, 1:]
        return _gather(V, nodes, at_nodes, of_cells)
    topology.create_connectivity(2, 3)
    facets = dmesh.exterior_facet_indices(topology)
    nodes, cells = _nodes_of(V, facets)
    return _gather(V, nodes, at_nodes, {name: of_cells[name][cells] for name in of_cells})


def gather_facets(
    V: fem.FunctionSpace, tags: dmesh.MeshTags, at_nodes: Values, tag: int | None = None
) -> Parts | None:
    """Return the facets that have tags, or one of them, with their "tag"; as `gather_bodies`."""
    owned = V.mesh.topology.index_map(tags.dim).size_local
    chosen = tags.indices < owned
    if tag is not None:
        chosen &= tags.values == tag
    nodes, _ = _nodes_of(V, tags.indices[chosen])
    return _gather(V, nodes, at_nodes, {"tag": tags.values[chosen]})


def _nodes_of(V: fem.FunctionSpace, facets: Ints) -> tuple[Longs, Ints]:
    """Return the nodes (m, k) of facets, and the cells (m,) that they belong to."""
    topology, d = V.mesh.topology, V.mesh.topology.dim
    for pair in ((d - 1, d), (d, d - 1)):
        topology.create_connectivity(*pair)
    to_cell = topology.connectivity(d - 1, d)
    cells = to_cell.array[to_cell.offsets[facets]]
    count = len(basix.topology(V.mesh.basix_cell())[d - 1])
    own = topology.connectivity(d, d - 1).array.reshape(-1, count)[cells]
    number = np.argmax(own == facets[:, None], axis=1)
    order = FACETS_OF[topology.cell_name(), V.element.basix_element.degree].order
    layout = V.dofmap.dof_layout
    closure = np.array([layout.entity_closure_dofs(d - 1, i) for i in range(count)])[:, order]
    return V.dofmap.list[cells[:, None], closure[number]].astype(np.int64), cells


def _gather(V: fem.FunctionSpace, nodes: Longs, at_nodes: Values, of_parts: Values) -> Parts | None:
    """Return the parts of all ranks on rank 0, None elsewhere; collective."""
    used, own = np.unique(nodes, return_inverse=True)
    columns = {name: values[used] for name, values in at_nodes.items()}
    x = V.tabulate_dof_coordinates()[used]
    rows = V.mesh.comm.gather((x, own.reshape(nodes.shape), columns, dict(of_parts)))
    if rows is None:
        return None
    before = np.cumsum([0, *(len(row[0]) for row in rows)])
    return Parts(
        np.concatenate([row[0] for row in rows]),
        np.concatenate([row[1] + n for row, n in zip(rows, before, strict=False)]),
        {name: np.concatenate([row[2][name] for row in rows]) for name in at_nodes},
        {name: np.concatenate([row[3][name] for row in rows]) for name in of_parts},
    )


def polygons_of(parts: Parts) -> Longs:
    """Return the nodes (m, p) around cells or facets: vertices, with middles of edges between."""
    k = parts.nodes.shape[1]
    n = 3 if k in (3, 6) else 4
    return parts.nodes if k == n else parts.nodes[:, np.arange(2 * n).reshape(2, n).T.ravel()]


def triangles_of(parts: Parts) -> Longs:
    """Return the nodes (t, 3) of triangles that fill cells or facets, part after part.

    They meet at the node inside, or else at the first but one of the polygon: a middle if there are
    some, from which no other two nodes lie on one line.
    """
    around = polygons_of(parts)
    if parts.nodes.shape[1] > around.shape[1]:
        tip, rim = parts.nodes[:, -1:], np.hstack([around, around[:, :1]])
    else:
        tip, rim = around[:, 1:2], np.hstack([around[:, 2:], around[:, :1]])
    corners = np.broadcast_arrays(tip, rim[:, :-1], rim[:, 1:])
    return np.stack(corners, axis=2).reshape(-1, 3)


def groups(
    parts: Parts, tags: dmesh.MeshTags | None, colours: Sequence[str]
) -> Iterator[tuple[str, str, Parts]]:
    """Yield name, colour and parts of each tag; colours are repeated if there are too few."""
    values = parts.of_parts["tag"]
    names = {tag: name for name, tag in names_of(tags).items()} | {NO_TAG: "no tag"}
    for tag, colour in zip(np.unique(values), cycle(colours), strict=False):
        yield names.get(int(tag), f"tag {tag}"), colour, parts.where(values == tag)

# SPDX-License-Identifier: MIT
"""One side of an interface as flat arrays: nodes, facets, coordinates and normals."""

import math
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numba
import numpy as np
import numpy.typing as npt

import basix
import dolfinx
from dolfinx.fem import Function, FunctionSpace
from dolfinx_mortar.algebra.parallel import any_rank, raised_together
from dolfinx_mortar.common import compat
from dolfinx_mortar.common.arrays import TINY, Bools, Floats, Ints, Longs, place
from dolfinx_mortar.common.spaces import check_space, connected_parts
from dolfinx_mortar.common.tags import all_labels, check_entities, label, tag_of
from dolfinx_mortar.geometry.facets import (
    FACETS_OF,
    FacetElement,
    Facets,
    bounding_balls,
    distortions,
    facet_normals,
    facet_sizes,
    normals_at_nodes,
    scaled_normals,
)
from dolfinx_mortar.geometry.flat import thickness
from dolfinx_mortar.geometry.segments import Cones, create_cones, find_meeting, groups_in_space
from dolfinx_mortar.geometry.tolerances import ROUND_OFF

_MOST_WARPED = 0.3
"""Least quality of facets, see `distortions`: the cosine between the normal at a corner and the
mean normal, along which the facet is projected. At 0.3 areas are divided by more than three."""


@dataclass(frozen=True, eq=False)
class Surface:
    """The marked facets that this rank integrates, and their nodes.

    A facet belongs to the rank of its cell; this rank's nodes of other ranks' facets are included.
    """

    V: FunctionSpace
    tag: int
    label: str  # tag, for messages
    nodes: Ints  # (n,) local, ascending: owned before ghosts
    owned: int
    element: FacetElement
    facets: Ints  # (m, k) of nodes; area vectors point outwards
    entities: Ints  # (m,) local facets of the mesh
    X: Floats
    thickness: Floats  # (m,) of the body behind each facet at X, or inf

    @property
    def curved(self) -> bool:
        """Whether cells are curved."""
        return compat.cell_degree(self.V.mesh) > 1

    @cached_property
    def behind(self) -> tuple[Ints, Floats, Floats, Floats]:
        """Cells behind facets: nodes (m, k), X (m, k, d), dN/dxi (d, m, k), volume over area (m,).

        Derivatives are at the facet's centre.
        """
        V, cell = self.V, self.V.mesh.basix_cell()
        cells, local = _cells_behind(V, self.entities)
        corners = np.asarray(basix.geometry(cell))
        sides = basix.topology(cell)[len(corners[0]) - 1]
        middles = np.array([corners[side].mean(axis=0) for side in sides])
        slopes = V.element.basix_element.tabulate(1, middles)[1:, :, :, 0][:, local]
        nodes = V.dofmap.list[cells]
        X = V.tabulate_dof_coordinates()[:, : self.X.shape[1]][nodes]
        return nodes, X, slopes, _heights_behind(self, X, self.X, slopes)


def check_tags(facet_tags: Any) -> None:
    """Raise a ValueError unless the argument is a MeshTags."""
    if not isinstance(facet_tags, dolfinx.mesh.MeshTags):
        raise ValueError(f"facet_tags is {facet_tags!r}: give a dolfinx.mesh.MeshTags of facets.")


def marks(index_map: dolfinx.common.IndexMap, local: Ints) -> Bools:
    """Local entries that any rank marks; collective."""
    found = dolfinx.la.vector(index_map)
    found.array[:] = 0.0
    found.array[local] = 1.0
    found.scatter_reverse(dolfinx.la.InsertMode.add)
    found.scatter_forward()
    return found.array > 0.0


def _marked_facets(V: FunctionSpace, facet_tags, tag: int, name: str) -> Ints:  # type: ignore[no-untyped-def]
    """Owned marked facets; a ValueError on all ranks."""
    topology, comm = V.mesh.topology, V.mesh.comm
    fdim = topology.dim - 1
    check_tags(facet_tags)
    if not compat.on_same_mesh(facet_tags, V.mesh):
        raise ValueError(
            f"facet_tags ({name}={label(facet_tags, tag)}) belong to another mesh than V."
        )
    if facet_tags.dim != fdim:
        raise ValueError(
            f"facet_tags ({name}={label(facet_tags, tag)}) mark entities of dimension "
            f"{facet_tags.dim}; facets have dimension {fdim}."
        )
    connect(topology)
    with raised_together(comm):
        check_entities("facet_tags", facet_tags)
    facet_map = facet_tags.topology.index_map(fdim)
    marked = marks(facet_map, facet_tags.find(tag))[: facet_map.size_local]
    facets = np.flatnonzero(marked).astype(np.int32)
    exterior = dolfinx.mesh.exterior_facet_indices(topology)
    inside = np.setdiff1d(facets, exterior)
    total, interior = comm.allreduce(np.array([len(facets), len(inside)]))
    if total == 0:
        raise ValueError(
            f"{name}={label(facet_tags, tag)} marks no facet; facet_tags has the values "
            f"[{all_labels(comm, facet_tags)}]."
        )
    if interior > 0:
        raise ValueError(
            f"{name}={label(facet_tags, tag)} marks {interior} facets inside the mesh; mark "
            "exterior facets only. Where bodies touch, each needs nodes of its own (in Gmsh, do "
            "not fragment them)."
        )
    return facets


def _element(V: FunctionSpace) -> FacetElement:
    return FACETS_OF[V.mesh.topology.cell_name(), V.element.basix_element.degree]


def _cells_behind(V: FunctionSpace, entities: Ints) -> tuple[Ints, Ints]:
    topology = V.mesh.topology
    tdim = topology.dim
    facet_cells = topology.connectivity(tdim - 1, tdim)
    cells = facet_cells.array[facet_cells.offsets[entities]]
    count = len(basix.topology(V.mesh.basix_cell())[tdim - 1])  # ranks may have no cell
    cell_facets = topology.connectivity(tdim, tdim - 1).array.reshape(-1, count)
    return cells, np.argmax(cell_facets[cells] == entities[:, None], axis=1)


def facet_nodes(V: FunctionSpace, entities: Ints) -> tuple[Ints, Ints]:
    """Nodes (m, k) around facets (m,), and a cell (m,) of each."""
    tdim, (cells, local) = V.mesh.topology.dim, _cells_behind(V, entities)
    count = len(basix.topology(V.mesh.basix_cell())[tdim - 1])
    order, layout = _element(V).order, V.dofmap.dof_layout
    closure = np.array([layout.entity_closure_dofs(tdim - 1, i) for i in range(count)])[:, order]
    return V.dofmap.list[cells[:, None], closure[local]], cells


def _order_outwards(X: Floats, nodes: Ints, cells: Ints, V: FunctionSpace) -> Ints:
    assert (cells < V.mesh.topology.index_map(V.mesh.topology.dim).size_local).all()
    element, x = _element(V), X[nodes]
    outwards = x.mean(axis=1) - X[V.dofmap.list[cells]].mean(axis=1)
    wrong = (facet_normals(Facets(element, x)) * outwards).sum(axis=1) < 0
    return np.where(wrong[:, None], nodes[:, element.mirrored], nodes)


def _check_shapes(facets: Facets, comm: MPI.Comm, name: str) -> None:
    finite = np.isfinite(facets.x).all()
    quality = distortions(facets) if finite else np.ones(len(facets.x))
    unusable = np.flatnonzero(quality < _MOST_WARPED)
    bad = comm.allreduce(np.array([not finite, len(unusable)], dtype=int))
    if bad[0]:
        raise ValueError(f"{name}: coordinates of the mesh are not finite.")
    if bad[1]:
        places = comm.allgather(facets.x[unusable[:1]].mean(axis=1))
        middles = ", or its middle node lies near an end or off its edge"
        raise ValueError(
            f"{name}: {bad[1]} facets are degenerate (no length or area), inverted or badly warped "
            "(the normal at a corner is far from the mean normal"
            f"{middles if facets.element.degree > 1 else ''}), such as the one around "
            f"{place(np.concatenate(places)[0])}; mend the mesh there."
        )


def create_surface(
    V: FunctionSpace, facet_tags: dolfinx.mesh.MeshTags, tag: int | str, name: str
) -> Surface:
    """Collect the exterior facets marked with `tag`, a number or name, on any rank (collective).

    Raises:
        ValueError: on all ranks, for an unsupported space, wrong tags, and facets that are
            interior, not finite, degenerate, inverted or badly warped.
    """
    check_space(V)
    element = _element(V)
    value = tag_of(facet_tags, tag, name)
    entities = _marked_facets(V, facet_tags, value, name)
    nodes_of, cells = facet_nodes(V, entities)
    X = V.tabulate_dof_coordinates()[:, : V.mesh.geometry.dim]
    nodes_of = _order_outwards(X, nodes_of, cells, V)
    nodes, size = np.unique(nodes_of), V.dofmap.index_map.size_local
    owned = np.flatnonzero(marks(V.dofmap.index_map, nodes)[:size])  # also of others' facets
    nodes = np.concatenate([owned, nodes[nodes >= size]]).astype(np.int32)
    called = label(facet_tags, value)
    facets = Facets(element, X[nodes_of])
    _check_shapes(facets, V.mesh.comm, f"{name}={called}")
    return Surface(
        V=V,
        tag=value,
        label=called,
        nodes=nodes,
        owned=len(owned),
        element=element,
        facets=np.searchsorted(nodes, nodes_of).astype(np.int32),
        entities=entities,
        X=np.ascontiguousarray(X[nodes]),
        thickness=_thickness(V, facets, nodes_of),
    )


def _thickness(V: FunctionSpace, facets: Facets, nodes: Ints) -> Floats:
    comm = V.mesh.comm
    result = thickness(facets, seen_facets(comm, facets, facets)[0])
    unknown = np.isinf(result)
    around, partly, edges = any_rank(
        comm, (~unknown).any(), unknown.any(), _meet_at_edges(V, facets, nodes)
    )
    if not partly or not (around or edges):
        return result
    _, part = connected_parts(V)
    boundary = find_boundary(V)
    own, of = part[nodes[unknown, 0]], part[boundary.nodes[:, 0]]
    result[unknown] = thickness_of_bodies(comm, facets[unknown], own, boundary.facets, of)
    return result


def thickness_of_bodies(
    comm: MPI.Intracomm, facets: Facets, body: Ints | Longs, others: Facets, of: Ints | Longs
) -> Floats:
    """Thickness (m,) behind facets among others of their own body; collective."""
    found = np.full(len(body), np.inf)
    for one in np.unique(np.concatenate(comm.allgather(np.unique(body)))):
        mine = np.flatnonzero(body == one)
        theirs = seen_facets(comm, facets[mine], others[np.flatnonzero(of == one)])[0]
        found[mine] = thickness(facets[mine], theirs)
    return found


def _meet_at_edges(V: FunctionSpace, facets: Facets, nodes: Ints) -> bool:
    """Whether facets meet at more than 60 degrees; collective."""
    n = facet_normals(facets)
    mean = means_at_nodes(V, nodes, n)[nodes]
    along = (mean * n[:, None]).sum(axis=2)
    return bool((along < np.sqrt(0.75) * np.linalg.norm(mean, axis=2)).any())


def means_at_nodes(V: FunctionSpace, nodes: Ints, values: Floats) -> Floats:
    """Means (local nodes, c) of values (m, c) of facets with nodes (m, k); collective."""
    c = values.shape[1] + 1
    sums = dolfinx.la.vector(V.dofmap.index_map, c)
    sums.array[:] = 0.0
    at, each = sums.array.reshape(-1, c), np.column_stack([values, np.ones(len(values))])
    add_at_nodes(at, np.ascontiguousarray(nodes), each[:, None].repeat(nodes.shape[1], axis=1))
    sums.scatter_reverse(dolfinx.la.InsertMode.add)
    sums.scatter_forward()
    return at[:, :-1] / np.maximum(at[:, -1:], 1.0)


@dataclass(frozen=True, eq=False)
class Boundary:
    """All exterior facets of a mesh that this rank integrates, at X."""

    facets: Facets  # (m,)
    cells: Ints  # (m,) owned
    entities: Ints  # (m,) local facets of the mesh
    nodes: Ints  # (m, k) local

    def __getitem__(self, which: Longs) -> "Boundary":
        return Boundary(*(getattr(self, field.name)[which] for field in fields(self)))

    def at(self, u: Function | None) -> Facets:
        """The facets at X + u."""
        if u is None:
            return self.facets
        X = self.facets.x
        return Facets(self.facets.element, X + u.x.array.reshape(-1, X.shape[2])[self.nodes])


def connect(topology: dolfinx.mesh.Topology) -> None:
    """Connect cells and facets; collective."""
    d = topology.dim
    topology.create_connectivity(d - 1, d)
    topology.create_connectivity(d, d - 1)


def find_boundary(V: FunctionSpace) -> Boundary:
    """All exterior facets; collective."""
    connect(V.mesh.topology)
    entities = dolfinx.mesh.exterior_facet_indices(V.mesh.topology)
    nodes, cells = facet_nodes(V, entities)
    X = V.tabulate_dof_coordinates()[:, : V.mesh.geometry.dim]
    nodes = _order_outwards(X, nodes, cells, V)
    return Boundary(Facets(_element(V), X[nodes]), cells, entities, nodes)


def cells_of(surface: Surface) -> Ints:
    """Owned cell (m,) behind each facet."""
    return facet_nodes(surface.V, surface.entities)[1]


def accumulate(surface: Surface, values: npt.NDArray[Any], *, largest: bool = False) -> Floats:
    """Sums over ranks of nodal values (n,) or (n, c), or maxima, also at ghosts (collective)."""
    result, comm = np.array(values, dtype=float), surface.V.mesh.comm
    if comm.size == 1:
        return result
    index_map, c = surface.V.dofmap.index_map, math.prod(result.shape[1:])
    columns, ghosts = result.reshape(len(result), c), index_map.ghosts.astype(PETSc.IntType)
    sums = PETSc.Vec().createGhost(ghosts, (c * index_map.size_local, None), bsize=c, comm=comm)
    with sums.localForm() as local:
        local.set(-np.inf if largest else 0.0)
        local.array_w.reshape(-1, c)[surface.nodes] = columns
    mode = PETSc.InsertMode.MAX_VALUES if largest else PETSc.InsertMode.ADD_VALUES
    sums.ghostUpdate(mode, PETSc.ScatterMode.REVERSE)
    sums.ghostUpdate(PETSc.InsertMode.INSERT_VALUES, PETSc.ScatterMode.FORWARD)
    with sums.localForm() as local:
        columns[:] = local.array_r.reshape(-1, c)[surface.nodes]
    sums.destroy()
    return result


def sum_at_nodes(surface: Surface, values: npt.NDArray[Any]) -> Floats:
    """Sums (n, c) of values (m, k, c) of all ranks' facets at nodes (collective)."""
    sums = np.zeros((len(surface.nodes), values.shape[2]))
    add_at_nodes(sums, surface.facets, np.ascontiguousarray(values, dtype=np.float64))
    return accumulate(surface, sums)


def nodal_means(surface: Surface, values: Floats) -> Floats:
    """Means (n, c) of values (m, c) of all ranks' facets at nodes; collective."""
    return means_at_nodes(surface.V, surface.nodes[surface.facets], values)[surface.nodes]


@numba.njit(cache=True)
def add_at_nodes(sums, nodes, values):  # type: ignore[no-untyped-def]
    """Add values (m, k, c) at nodes (m, k) to sums (n, c)."""
    for f in range(len(nodes)):
        for i in range(nodes.shape[1]):
            for c in range(sums.shape[1]):
                sums[nodes[f, i], c] += values[f, i, c]


def dependent_nodes(surface: Surface) -> Bools:
    """Nodes (n,) whose rows of D depend on other nodes with multiplier (collective)."""
    count = np.zeros(len(surface.nodes))
    for middle, *_ in surface.element.shares:
        count[surface.facets[:, middle]] = 1.0
    return accumulate(surface, count) > 0


def coordinates(surface: Surface, u: Function | None) -> Floats:
    """Coordinates X + u (n, d) of the nodes; ghosts of u must be up to date."""
    if u is None:
        return surface.X
    return surface.X + u.x.array.reshape(-1, surface.X.shape[1])[surface.nodes]


def facets_at(surface: Surface, x: Floats) -> Facets:
    """Facets with nodes at x (n, d)."""
    return Facets(surface.element, x[surface.facets])


def nodal_normals(surface: Surface, x: Floats) -> Floats:
    """Averaged unit normals (n, d) of the nodes, zero where those of facets cancel (collective)."""
    total = sum_at_nodes(surface, normals_at_nodes(facets_at(surface, x)))
    length = np.linalg.norm(total, axis=1)[:, None]
    return np.where(length > 8 * ROUND_OFF, total / np.maximum(length, TINY), 0.0)


def nodal_sagittas(surface: Surface, x: Floats, feature_angle: float) -> Floats:
    """Mean deviation (n,) of a surface from its flat parts at each node; collective.

    L a / 8 for an arc of chord L and angle a, twice that between facet and nodal normals, without
    edges; parts of second order are half as long.
    """
    facets = facets_at(surface, x)
    normals = nodal_normals(surface, x)[surface.facets]
    cosines = np.einsum("mkd,md->mk", normals, facet_normals(facets))
    turns = np.arccos(np.clip(cosines, -1.0, 1.0))
    turn = np.where(turns > np.radians(feature_angle / 2), 0.0, turns).max(axis=1, initial=0.0)
    sagitta = facet_sizes(facets.x) * turn / (4 * surface.element.degree**2)
    return nodal_means(surface, sagitta[:, None])[:, 0]


def thickness_stretches(surface: Surface, u: Function) -> Floats:
    """Stretch 1 / |F^-T n| (n,) of the bodies along the normals at X (collective).

    Means of the change of volume over area.
    """
    nodes, X, slopes, height = surface.behind
    x = X + u.x.array.reshape(-1, X.shape[2])[nodes]
    stretch = np.abs(_heights_behind(surface, x, coordinates(surface, u), slopes) / height)
    return nodal_means(surface, stretch[:, None])[:, 0]


def _heights_behind(surface: Surface, x: Floats, of_nodes: Floats, slopes: Floats) -> Floats:
    volume = np.linalg.det(np.einsum("amk,mki->mai", slopes, x))
    normals = scaled_normals(facets_at(surface, of_nodes), surface.element.centre)[:, 0]
    return volume / np.maximum(np.linalg.norm(normals, axis=1), TINY)


def mean_facet_length(surface: Surface) -> float:
    """Mean length of first edges at X (collective)."""
    first, second = surface.element.vertices[:2]
    edges = surface.X[surface.facets[:, second]] - surface.X[surface.facets[:, first]]
    local = np.array([np.linalg.norm(edges, axis=1).sum(), len(edges)])
    total, count = surface.V.mesh.comm.allreduce(local)
    return float(total / count)


def find_receivers(
    comm: MPI.Intracomm, x: Floats, directions: Floats, margin: Floats, facets: Facets
) -> Bools:
    """Own facets (m, ranks) that other ranks may need (collective).

    For projections of facets x (m, k, d) along directions (m, k', d), bounded in compact groups.
    """
    order, size = groups_in_space(x.mean(axis=1))
    cones = [create_cones(x[:0], directions[:0], margin[:0])]  # there may be no group
    for group in (order[first : first + size] for first in range(0, len(x), size)):
        nodes, normals = (v[group].reshape(1, -1, x.shape[2]) for v in (x, directions))
        cones.append(create_cones(nodes, normals, margin[group].max(keepdims=True)))
    every = Cones(*map(np.concatenate, zip(*cones, strict=True)))
    needed = np.zeros((len(facets.x), comm.size), dtype=bool)
    balls = bounding_balls(facets.x)
    for rank, others in enumerate(comm.allgather(every)):
        needed[find_meeting(others, *balls)[:, 1], rank] = True
    return needed


def send(comm: MPI.Intracomm, receivers: Bools, *values: npt.NDArray[Any]) -> list[Any]:
    """Rows of values (m, ..), by receivers (m, ranks), that this rank gets; collective."""
    parts = comm.alltoall([tuple(v[to] for v in values) for to in receivers.T])
    return [np.concatenate(each) for each in zip(*parts, strict=True)]


def seen_facets(
    comm: MPI.Intracomm, asking: Facets, others: Facets, *values: npt.NDArray[Any]
) -> list[Any]:
    """All ranks' facets, and values (m, ..), that this rank's may face; collective."""
    if comm.size == 1:
        return [others, *values]
    n = facet_normals(asking)[:, None]
    receivers = find_receivers(comm, asking.x, n, np.zeros(len(n)), others)
    x, *found = send(comm, receivers, others.x, *values)
    return [Facets(others.element, x), *found]

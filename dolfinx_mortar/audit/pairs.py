# SPDX-License-Identifier: MIT
"""Proposed contacts between bodies."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np
import scipy

from dolfinx import fem
from dolfinx.mesh import Mesh, MeshTags, meshtags
from dolfinx_mortar import compat
from dolfinx_mortar.agreement import check_same_on_all_ranks
from dolfinx_mortar.algebra.parallel import raised_together, sums_at_nodes
from dolfinx_mortar.arguments import POSITIVE, check, check_optional, instance
from dolfinx_mortar.arrays import Ints, Longs
from dolfinx_mortar.audit.mesh_audit import check_mesh
from dolfinx_mortar.audit.sides import Candidates, choose_roles
from dolfinx_mortar.interfaces.constraints import Limit, create_law
from dolfinx_mortar.interfaces.contact import SURFACES, Contact
from dolfinx_mortar.interfaces.interface import FEATURE_ANGLE
from dolfinx_mortar.mortar.facing_bodies import (
    Facing,
    Skin,
    are_near,
    check_angle,
    find_faces,
    find_facing,
)
from dolfinx_mortar.mortar.surface import find_boundary
from dolfinx_mortar.spaces import check_space
from dolfinx_mortar.supports.bodies import find_bodies
from dolfinx_mortar.tags import Tags, check_entities, names_of, tags_of

REFINE = "so they are not constrained there; refine around them, so that it matters less"


@dataclass(frozen=True)
class Pair:
    """A proposed contact; areas are lengths in the plane."""

    slave: str  # name in the tags of `Pairs`
    master: str
    facets: tuple[int, int]  # of both sides
    sizes: tuple[float, float]  # mean facet diameters
    area: float  # of the facing part of the slave side
    distance: float  # least between facing facets; negative: overlap


@dataclass(frozen=True)
class Pairs:
    """Proposed contacts and the tags of their sides; unpacks as ``facet_tags, contacts``."""

    tags: Tags
    contacts: list[Contact]
    found: list[Pair]
    joined: dict[tuple[str, str], int]  # nodes shared by two bodies of one part: no contact
    lost: list[str]  # constraints, in words

    def __iter__(self) -> Iterator[Any]:
        return iter((self.tags, self.contacts))

    def __str__(self) -> str:
        lines = ["slave (facets, size), master (facets, size): area, distance"]
        for p in self.found:
            one, other = (f"({n}, {size:.3g})" for n, size in zip(p.facets, p.sizes, strict=True))
            lines.append(f"{p.slave} {one}, {p.master} {other}: {p.area:.3g}, {p.distance:.3g}")
        lines += [describe_joined(self.joined)] if self.joined else []
        return "\n".join([*lines, *self.lost])

    __repr__ = __str__


def describe_joined(joined: dict[tuple[str, str], int]) -> str:
    """Sentence about bodies that share nodes."""
    who = ", ".join(
        f"{one!r} and {other!r} share {_nodes(count)}" for (one, other), count in joined.items()
    )
    return (
        f"{who}: what shares nodes is tied by the mesh, and no contact is found within it. If that "
        "is meant, there is nothing to do; bodies that may part or slide need nodes of their own "
        "(in Gmsh, do not fragment them, or split the mesh along the interface)"
    )


def find_pairs(
    mesh: Mesh,
    cell_tags: MeshTags | None = None,
    *,
    within: float | None = None,
    surface: str = "smooth",
    feature_angle: float = FEATURE_ANGLE,
    friction: Limit | None = None,
    tresca: Limit | None = None,
    show: bool = True,
) -> Pairs:
    """Propose contacts between bodies that are near and face each other; collective.

        found = dm.find_pairs(mesh, cell_tags)
        facet_tags, contacts = found
        problem = dm.ContactProblem(solid, contacts, bcs=bcs)

    Bodies are the connected parts of the mesh, divided by cell tags; common nodes join bodies. Two
    bodies are a pair if some facet of one, projected along its normal, meets an opposite facet of
    the other, with nothing between them, at most `within` apart; overlaps count up to half of the
    thinner body. A side is the whole face of such facets, up to edges. The finer side is the slave,
    unless nodes would lose a constraint, as slaves of two contacts or in a cycle; then the other
    side, if not more than twice as coarse. The table lists remaining losses.

    Args:
        mesh: of all bodies.
        cell_tags: tags of all cells; names of `Tags` become those of the bodies.
        within: largest distance of a pair; default the diameter of the larger facet.
        surface: see `Contact`, as the next ones.
        feature_angle: degrees between facets from which on an edge is sharp.
        friction: Coulomb's coefficient.
        tresca: limit of the tangential traction.
        show: whether rank 0 prints the table.

    Returns:
        A record that unpacks as facet tags, such as "disc to block", and contacts.

    Raises:
        ValueError: on all ranks, for an invalid mesh; tags of another mesh or not of all cells;
            invalid options; a single connected body; and if there is no pair, with the nearest
            distance.
    """
    check("mesh", mesh, instance(Mesh, "give a dolfinx.mesh.Mesh of all bodies"))
    given = {"within": within, "surface": surface, "feature_angle": feature_angle}
    options = {"friction": friction, "tresca": tresca, "show": show}
    check_same_on_all_ranks(mesh.comm, cell_tags=cell_tags, **given, **options)
    _check(mesh, cell_tags, within, surface)
    check_angle(feature_angle)
    create_law(friction, tresca)
    with raised_together(mesh.comm):
        tag_of_cell = _tags_of_cells(mesh, cell_tags)
    check_mesh(mesh)
    V = fem.functionspace(mesh, ("Lagrange", compat.cell_degree(mesh), (mesh.geometry.dim,)))
    found = _find(V, tag_of_cell, cell_tags, within, feature_angle)
    kept = {"surface": surface, "feature_angle": feature_angle}
    pairs = _create(V, found, kept | {"friction": friction, "tresca": tresca})
    if show and mesh.comm.rank == 0:
        print(pairs, flush=True)
    return pairs


def _check(mesh: Mesh, cell_tags: Any, within: Any, surface: Any) -> None:
    kinds = compat.cell_kinds(mesh)
    if len(kinds) > 1:
        raise ValueError(
            f"mesh has cells of several kinds, {', '.join(kinds)}: give all bodies the same kind"
        )
    degree, d = compat.cell_degree(mesh), mesh.geometry.dim
    check_space(fem.functionspace(mesh, ("Lagrange", degree, (d,))), "mesh")
    remedy = (
        "give a positive distance in the units of the mesh, or None for the diameter of a facet"
    )
    check_optional("within", within, POSITIVE, remedy)
    check("surface", surface, SURFACES)
    check_optional("cell_tags", cell_tags, tags_of(mesh, mesh.topology.dim))


def _tags_of_cells(mesh: Mesh, cell_tags: MeshTags | None) -> Longs:
    owned = mesh.topology.index_map(mesh.topology.dim).size_local
    tags = np.zeros(owned, dtype=np.int64)
    if cell_tags is None:
        return tags
    check_entities("cell_tags", cell_tags)
    known, own = np.zeros(owned, dtype=bool), cell_tags.indices < owned
    known[cell_tags.indices[own]] = True
    tags[cell_tags.indices[own]] = cell_tags.values[own]
    if not known.all():
        raise ValueError(
            f"cell_tags leave out {owned - known.sum()} of {owned} cells: give each cell the tag "
            "of its body, or no tags, so that bodies are the connected parts of the mesh"
        )
    return tags


@dataclass(frozen=True)
class _Side:
    """Part of a body that faces another one, all ranks."""

    body: int
    other: int
    faces: frozenset[int]
    area: float
    distance: float
    sizes: tuple[float, float]


@dataclass(frozen=True)
class _Found:
    names: Sequence[str]
    entities: Longs
    faces: Longs  # (m,) of each exterior facet
    sides: dict[tuple[int, int], _Side]
    joined: dict[tuple[str, str], int]
    common: Longs  # (sides, sides) shared nodes that face partners


def _find(
    V: fem.FunctionSpace,
    tag_of_cell: Longs,
    cell_tags: MeshTags | None,
    within: float | None,
    feature_angle: float,
) -> _Found:
    topology, comm = V.mesh.topology, V.mesh.comm
    for pair in ((topology.dim - 1, topology.dim), (topology.dim, topology.dim - 1)):
        topology.create_connectivity(*pair)
    part_of_cell, count = _ordered_parts(V)
    bodies = np.column_stack([tag_of_cell, part_of_cell])
    own = np.unique(bodies, axis=0).reshape(-1, 2)
    known = np.unique(np.concatenate(comm.allgather(own)), axis=0)
    names = _names(known, cell_tags)
    keys = known[:, 0] * count + known[:, 1]
    body_of_cell = np.searchsorted(keys, bodies[:, 0] * count + bodies[:, 1])
    shared = _shared_nodes(V, body_of_cell, known[:, 1])
    joined = {(names[a], names[b]): nodes for (a, b), nodes in shared.items()}
    told = f". {describe_joined(joined)}" if joined else ""
    if count == 1:
        raise ValueError(
            "mesh is one connected body: each body needs its own nodes where bodies touch. A body "
            f"that touches itself needs a Contact whose slave and master are the same tag{told}"
        )

    boundary = find_boundary(V)
    facets, cells, entities = boundary.facets, boundary.cells, boundary.entities
    body = body_of_cell[cells].astype(np.int64)
    faces = find_faces(V, facets, boundary.nodes, body, feature_angle)
    label = np.column_stack([body, faces])
    facing = find_facing(comm, Skin(facets, part_of_cell[cells], label))
    sides = _sides(comm, facing[are_near(facing, within)])
    if not sides:
        _raise_none(_sides(comm, facing), names, within, told)
    numbers, common = entities.astype(np.int64), _facing_nodes(V, boundary.nodes, facing, sides)
    return _Found(names, numbers, faces, sides, joined, common)


def _facing_nodes(
    V: fem.FunctionSpace, nodes: Ints, facing: Facing, sides: dict[tuple[int, int], _Side]
) -> Longs:
    """Numbers (s, s) of common nodes where sides face their partners; collective."""
    bodies, faces = facing.label[:, :, 0], facing.label[:, 0, 1]
    seen = []
    for side in sides.values():
        of = (bodies == [side.body, side.other]).all(axis=1) & np.isin(faces, list(side.faces))
        seen.append(nodes[facing.facet[of]])
    return _common_nodes(V, seen)


def _shared_nodes(
    V: fem.FunctionSpace, body_of_cell: Longs, part: Longs
) -> dict[tuple[int, int], int]:
    several = np.flatnonzero(np.bincount(part)[part] > 1)
    cells = V.dofmap.list[: len(body_of_cell)]
    common = np.triu(_common_nodes(V, [cells[body_of_cell == k] for k in several]), 1)
    return {(int(several[a]), int(several[b])): int(common[a, b]) for a, b in np.argwhere(common)}


def _common_nodes(V: fem.FunctionSpace, sets: Sequence[Ints]) -> Longs:
    if not sets:
        return np.zeros((0, 0), dtype=np.int64)
    layout, comm, on = V.dofmap.index_map, V.mesh.comm, []
    for local in sets:
        nodes = layout.local_to_global(np.unique(local).astype(np.int32)).astype(np.int64)
        found = sums_at_nodes(comm, layout, nodes, np.ones((len(nodes), 1)))[:, 0] > 0.0
        on.append(scipy.sparse.csr_array(found.astype(np.int64)[None]))
    rows = scipy.sparse.vstack(on)
    return np.asarray(comm.allreduce((rows @ rows.T).toarray(), op=MPI.SUM))


def _ordered_parts(V: fem.FunctionSpace) -> tuple[Longs, int]:
    bodies = find_bodies(V)
    d = V.mesh.geometry.dim
    x = V.tabulate_dof_coordinates()[: len(bodies.label), :d]
    boxes = np.full((bodies.count, 2, d), np.inf)
    np.minimum.at(boxes[:, 0], bodies.label, x)
    np.minimum.at(boxes[:, 1], bodies.label, -x)
    V.mesh.comm.Allreduce(MPI.IN_PLACE, boxes, op=MPI.MIN)
    size = np.bincount(bodies.label, minlength=bodies.count)
    size = V.mesh.comm.allreduce(size, op=MPI.SUM)
    columns = np.column_stack([boxes[:, 0], -boxes[:, 1], size])
    place = np.empty(bodies.count, dtype=np.int64)
    place[np.lexsort(columns.T[::-1])] = np.arange(bodies.count)
    return place[bodies.of_cells], bodies.count


def _names(known: Longs, cell_tags: MeshTags | None) -> list[str]:
    if cell_tags is None:
        return [f"body {k + 1}" for k in range(len(known))]
    called = {tag: name for name, tag in names_of(cell_tags).items()}
    names = []
    for k, tag in enumerate(known[:, 0]):
        alike = np.flatnonzero(known[:, 0] == tag)
        number = f" #{k - alike[0] + 1}" if len(alike) > 1 else ""
        names.append(f"{called.get(int(tag), f'body {tag}')}{number}")
    return names


def _sides(comm: MPI.Intracomm, facing: Facing) -> dict[tuple[int, int], _Side]:
    key = np.column_stack([facing.label[:, :, 0], facing.label[:, :, 1]])
    own, which = np.unique(key, axis=0, return_inverse=True)
    columns = facing.area, *facing.size.T, np.ones(len(key))
    sums = [np.bincount(which.ravel(), column, len(own)) for column in columns]
    least = np.full(len(own), np.inf)
    np.minimum.at(least, which.ravel(), facing.distance)
    one = np.concatenate(comm.allgather(np.column_stack([own, *sums, least])))
    other = one[:, [1, 0, 3, 2, 4, 6, 5, 7, 8]]  # with both bodies exchanged
    other[:, 4] = 0.0
    sides, rows = {}, np.concatenate([one, other])
    for a, b in np.unique(rows[:, :2].astype(int), axis=0).tolist():
        part = rows[(rows[:, :2] == [a, b]).all(axis=1)]
        area, size, size_b, count = part[:, 4:8].sum(axis=0).tolist()
        sizes, faces = (size / count, size_b / count), frozenset(part[:, 2].astype(int).tolist())
        sides[a, b] = _Side(a, b, faces, area, float(part[:, 8].min()), sizes)
    return sides


def _raise_none(
    sides: dict[tuple[int, int], _Side], names: Sequence[str], within: float | None, told: str
) -> None:
    how = "a facet is long" if within is None else f"within={within:g}"
    none = f"find_pairs: no two bodies face each other at a distance of at most {how}"
    if not sides:
        raise ValueError(
            f"{none}, or at all, or they overlap by more than half of the thinner one: check the "
            f"mesh, or tag the sides by hand{told}"
        )
    near = min(sides.values(), key=lambda side: (abs(side.distance), side.body, side.other))
    who = f"{names[near.body]!r} and {names[near.other]!r}"
    raise ValueError(
        f"{none}. The nearest, {who}, are {near.distance:.4g} apart: give a larger within={told}"
    )


def _create(V: fem.FunctionSpace, found: _Found, options: dict[str, Any]) -> Pairs:
    groups = _groups(found)
    tag_of_face = {face: tag for tag, (_, faces) in enumerate(groups, start=1) for face in faces}
    tags: Longs = np.array([tag_of_face.get(int(f), 0) for f in found.faces], np.int64)
    on, mesh = np.flatnonzero(tags), V.mesh
    entities = found.entities[on].astype(np.int32)
    order = np.argsort(entities)
    marks = meshtags(mesh, mesh.topology.dim - 1, entities[order], tags[on][order].astype(np.int32))
    named = Tags(marks, {name: tag for tag, (name, _) in enumerate(groups, start=1)})
    named.name = "pairs"
    counts = mesh.comm.allreduce(np.bincount(tags, minlength=len(groups) + 1), op=MPI.SUM)

    contacts, rows = [], []
    chosen, lost = _choose_slaves(found, tag_of_face)
    for slave, master in chosen:
        at = [tag_of_face[next(iter(side.faces))] for side in (slave, master)]
        names = [groups[tag - 1][0] for tag in at]
        contacts.append(Contact(named, slave=names[0], master=names[1], **options))
        facets = int(counts[at[0]]), int(counts[at[1]])
        rows.append(Pair(names[0], names[1], facets, slave.sizes, slave.area, slave.distance))
    return Pairs(named, contacts, rows, found.joined, lost)


def _groups(found: _Found) -> list[tuple[str, frozenset[int]]]:
    """Name and faces of each tag; sides of a body with common faces are merged."""
    groups: list[tuple[int, list[int], frozenset[int]]] = []
    for side in found.sides.values():
        others, faces, rest = [side.other], side.faces, []
        for group in groups:
            if group[2] & faces:
                others, faces = group[1] + others, group[2] | faces
            else:
                rest.append(group)
        groups = [*rest, (side.body, others, faces)]
    return [
        (f"{found.names[body]} to {', '.join(found.names[k] for k in sorted(others))}", faces)
        for body, others, faces in sorted(groups, key=lambda g: (g[0], min(g[1])))
    ]


def _nodes(count: int) -> str:
    return f"{count} node{'s' * (count > 1)}"


def _choose_slaves(
    found: _Found, tag_of_face: Mapping[int, int]
) -> tuple[list[tuple[_Side, _Side]], list[str]]:
    place = {key: k for k, key in enumerate(found.sides)}
    keys = [(a, b) for a, b in found.sides if a < b]
    pairs = [(found.sides[a, b], found.sides[b, a]) for a, b in keys]
    numbers = np.array([[place[a, b], place[b, a]] for a, b in keys], dtype=np.int64)
    sizes = np.array([one.sizes for one, _ in pairs])
    tags = np.array([tag_of_face[next(iter(side.faces))] for side in found.sides.values()])
    roles = choose_roles(Candidates(numbers, sizes, tags, found.common))
    chosen = [(pair[k], pair[1 - k]) for pair, k in zip(pairs, roles.slave, strict=True)]
    who = [f"{found.names[s.body]!r} as slave of {found.names[m.body]!r}" for s, m in chosen]
    lost = [
        f"{who[other]} loses {_nodes(count)} to its contact with "
        f"{found.names[chosen[one][1].body]!r}, {REFINE}"
        for (one, other), count in roles.twice.items()
    ]
    lost += [
        f"{who[other]} loses {_nodes(count)} that would close a cycle with {who[one]}, {REFINE}"
        for (one, other), count in roles.cyclic.items()
    ]
    return chosen, lost

# SPDX-License-Identifier: MIT
"""Proposed contacts between bodies."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np
import scipy

from dolfinx import fem, la
from dolfinx.mesh import Mesh, MeshTags, meshtags
from dolfinx_mortar.audit.audit import COARSE
from dolfinx_mortar.audit.mesh_audit import check_mesh
from dolfinx_mortar.common import compat
from dolfinx_mortar.common.agreement import check_same_on_all_ranks
from dolfinx_mortar.common.arguments import POSITIVE, check, check_optional, instance
from dolfinx_mortar.common.arrays import HALF_OF_DIGITS, Bools, Ints, Longs
from dolfinx_mortar.common.spaces import check_space
from dolfinx_mortar.common.tags import Tags, names_of
from dolfinx_mortar.interfaces.constraints import Limit, create_law
from dolfinx_mortar.interfaces.contact import SURFACES, Contact
from dolfinx_mortar.interfaces.interface import FEATURE_ANGLE
from dolfinx_mortar.mortar.facing_bodies import (
    Facing,
    Skin,
    are_near,
    boxes_of,
    check_angle,
    find_faces,
    find_facing,
)
from dolfinx_mortar.mortar.surface import find_boundary
from dolfinx_mortar.solid.laws import UNTAGGED, tags_of_cells
from dolfinx_mortar.solid.supports import find_bodies

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
        surface: see `Contact`, as for `friction` and `tresca`.
        feature_angle: degrees between facets from which on an edge is sharp.
        show: whether rank 0 prints the table.

    Returns:
        A record that unpacks as facet tags, such as "disc to block", and contacts.

    Raises:
        ValueError: on all ranks, for an invalid mesh, tags or options; a single connected body;
            and if there is no pair, with the nearest distance.
    """
    check("mesh", mesh, instance(Mesh, "give a dolfinx.mesh.Mesh of all bodies"))
    law = {"friction": friction, "tresca": tresca}
    options = {"surface": surface, "feature_angle": feature_angle, **law}
    check_same_on_all_ranks(mesh.comm, cell_tags=cell_tags, within=within, show=show, **options)
    V = _check(mesh, within, surface)
    check_angle(feature_angle)
    create_law(**law)
    owned = mesh.topology.index_map(mesh.topology.dim).size_local
    tag_of_cell = np.zeros(owned, dtype=np.int64)
    if cell_tags is not None:
        tag_of_cell = tags_of_cells(mesh, cell_tags)[:owned]
        lost = int(mesh.comm.allreduce(int((tag_of_cell == UNTAGGED).sum()), op=MPI.SUM))
        if lost:
            raise ValueError(
                f"cell_tags leave out {lost} cells: give each cell the tag of its body, or no "
                "tags, so that bodies are the connected parts of the mesh"
            )
    check_mesh(mesh)
    pairs = _create(V, _find(V, tag_of_cell, cell_tags, within, feature_angle), options)
    if show and mesh.comm.rank == 0:
        print(pairs, flush=True)
    return pairs


def _check(mesh: Mesh, within: Any, surface: Any) -> fem.FunctionSpace:
    """Check arguments; return a space of displacements."""
    kinds = compat.cell_kinds(mesh)
    if len(kinds) > 1:
        raise ValueError(
            f"mesh has cells of several kinds, {', '.join(kinds)}: give all bodies the same kind"
        )
    V = fem.functionspace(mesh, ("Lagrange", compat.cell_degree(mesh), (mesh.geometry.dim,)))
    check_space(V, "mesh")
    remedy = (
        "give a positive distance in the units of the mesh, or None for the diameter of a facet"
    )
    check_optional("within", within, POSITIVE, remedy)
    check("surface", surface, SURFACES)
    return V


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
    sides: list[_Side]
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
    key = tag_of_cell * count + part_of_cell
    known = np.unique(np.concatenate(comm.allgather(np.unique(key))))
    body_of_cell, (tags, parts) = np.searchsorted(known, key), np.divmod(known, count)
    names, several = _names(tags, cell_tags), np.flatnonzero(np.bincount(parts)[parts] > 1)
    cells = V.dofmap.list[: len(body_of_cell)]
    shared = np.triu(_common_nodes(V, [cells[body_of_cell == k] for k in several]), 1)
    joined = {
        (names[several[a]], names[several[b]]): int(shared[a, b]) for a, b in np.argwhere(shared)
    }
    told = f". {describe_joined(joined)}" if joined else ""
    if count == 1:
        raise ValueError(
            "mesh is one connected body: each body needs its own nodes where bodies touch. A body "
            f"that touches itself needs a Contact whose slave and master are the same tag{told}"
        )

    boundary = find_boundary(V)
    facets, cells = boundary.facets, boundary.cells
    body = body_of_cell[cells].astype(np.int64)
    faces = find_faces(V, facets, boundary.nodes, body, feature_angle)
    label = np.column_stack([body, faces])
    facing = find_facing(comm, Skin(facets, part_of_cell[cells], label))
    sides = _sides(comm, facing[are_near(facing, within)])
    if not sides:
        _raise_none(_sides(comm, facing), names, within, told)
    seen = []
    for side in sides:
        of = (facing.label[:, :, 0] == [side.body, side.other]).all(axis=1)
        of &= np.isin(facing.label[:, 0, 1], list(side.faces))
        seen.append(boundary.nodes[facing.facet[of]])
    entities = boundary.entities.astype(np.int64)
    return _Found(names, entities, faces, sides, joined, _common_nodes(V, seen))


def _common_nodes(V: fem.FunctionSpace, sets: Sequence[Ints]) -> Longs:
    """Numbers (sets, sets) of common nodes; collective."""
    many = max(len(sets), 1)
    vector = la.vector(V.dofmap.index_map, many)
    on = vector.array.reshape(-1, many)
    on[:] = 0.0
    for k, local in enumerate(sets):
        on[local.ravel(), k] = 1.0
    vector.scatter_reverse(la.InsertMode.add)
    owned = (on[: V.dofmap.index_map.size_local] > 0.0).astype(np.int64)
    return np.asarray(V.mesh.comm.allreduce(owned.T @ owned, op=MPI.SUM))


def _ordered_parts(V: fem.FunctionSpace) -> tuple[Longs, int]:
    """Part (cells,) of owned cells, numbered in the order of coordinates, and their number."""
    bodies = find_bodies(V)
    x = V.tabulate_dof_coordinates()[: len(bodies.label), : V.mesh.geometry.dim]
    boxes = boxes_of(V.mesh.comm, x[:, None], bodies.label.astype(np.int64), bodies.count)
    place = np.empty(bodies.count, dtype=np.int64)
    place[np.lexsort(boxes.reshape(bodies.count, -1).T[::-1])] = np.arange(bodies.count)
    return place[bodies.of_cells], bodies.count


def _names(tags: Longs, cell_tags: MeshTags | None) -> list[str]:
    if cell_tags is None:
        return [f"body {k + 1}" for k in range(len(tags))]
    called = {tag: name for name, tag in names_of(cell_tags).items()}
    names = []
    for k, tag in enumerate(tags):
        alike = np.flatnonzero(tags == tag)
        number = f" #{k - alike[0] + 1}" if len(alike) > 1 else ""
        names.append(f"{called.get(int(tag), f'body {tag}')}{number}")
    return names


def _sides(comm: MPI.Intracomm, facing: Facing) -> list[_Side]:
    """Sides that face each other, by their bodies; collective."""
    turned, none = (facing.label[:, ::-1], facing.size[:, ::-1]), np.zeros(len(facing.area))
    rows = [
        np.column_stack([label[:, :, 0], label[:, 0, 1], size, area, facing.distance])
        for label, size, area in ((facing.label, facing.size, facing.area), (*turned, none))
    ]
    table = np.concatenate(comm.allgather(np.concatenate(rows)))
    sides = []
    for a, b in np.unique(table[:, :2].astype(int), axis=0).tolist():
        part = table[(table[:, :2] == [a, b]).all(axis=1)]
        faces, sizes = frozenset(part[:, 2].astype(int).tolist()), part[:, 3:5].mean(axis=0)
        sides.append(_Side(a, b, faces, part[:, 5].sum(), part[:, 6].min(), tuple(sizes)))
    return sides


def _raise_none(
    sides: Sequence[_Side], names: Sequence[str], within: float | None, told: str
) -> None:
    how = "a facet is long" if within is None else f"within={within:g}"
    none = f"find_pairs: no two bodies face each other at a distance of at most {how}"
    if not sides:
        raise ValueError(
            f"{none}, or at all, or they overlap by more than half of the thinner one: check the "
            f"mesh, or tag the sides by hand{told}"
        )
    near = min(sides, key=lambda side: (abs(side.distance), side.body, side.other))
    who = f"{names[near.body]!r} and {names[near.other]!r}"
    raise ValueError(
        f"{none}. The nearest, {who}, are {near.distance:.4g} apart: give a larger within={told}"
    )


def _create(V: fem.FunctionSpace, found: _Found, options: dict[str, Any]) -> Pairs:
    names, tag_of_side = _tags_of_sides(found)
    tags = np.zeros(len(found.faces), dtype=np.int32)
    for side, tag in zip(found.sides, tag_of_side, strict=True):
        tags[np.isin(found.faces, list(side.faces))] = tag
    on, mesh = np.flatnonzero(tags), V.mesh
    on = on[np.argsort(found.entities[on])]
    marks = meshtags(mesh, mesh.topology.dim - 1, found.entities[on].astype(np.int32), tags[on])
    named = Tags(marks, {name: tag for tag, name in enumerate(names, start=1)})
    named.name = "pairs"
    counts = mesh.comm.allreduce(np.bincount(tags, minlength=len(names) + 1), op=MPI.SUM)
    number = {(side.body, side.other): k for k, side in enumerate(found.sides)}
    ends = np.array([[k, number[b, a]] for (a, b), k in number.items() if a < b])
    roles = _choose_roles(found, ends)
    contacts, rows, who, masters = list[Contact](), list[Pair](), list[str](), list[str]()
    for k in np.take_along_axis(ends, np.stack([roles.slave, 1 - roles.slave], axis=1), axis=1):
        (slave, master), at = (found.sides[i] for i in k), tag_of_side[k]
        one, other = (names[tag - 1] for tag in at)
        contacts.append(Contact(named, slave=one, master=other, **options))
        sizes = tuple(counts[at].tolist()), slave.sizes
        rows.append(Pair(one, other, *sizes, slave.area, slave.distance))
        masters.append(repr(found.names[master.body]))
        who.append(f"{found.names[slave.body]!r} as slave of {masters[-1]}")
    twice = [(k, n, f"to its contact with {masters[i]}") for (i, k), n in roles.twice.items()]
    cycles = [
        (k, n, f"that would close a cycle with {who[i]}") for (i, k), n in roles.cyclic.items()
    ]
    lost = [f"{who[k]} loses {_nodes(n)} {how}, {REFINE}" for k, n, how in twice + cycles]
    return Pairs(named, contacts, rows, found.joined, lost)


def _tags_of_sides(found: _Found) -> tuple[list[str], Longs]:
    """Name of each tag, and tag of each side; sides of a body with common faces are merged."""
    sides = found.sides
    common = [[bool(one.faces & other.faces) for other in sides] for one in sides]
    _, label = scipy.sparse.csgraph.connected_components(scipy.sparse.coo_array(common))
    groups = [[side for side, k in zip(sides, label, strict=True) if k == n] for n in set(label)]
    order = sorted(groups, key=lambda group: (group[0].body, min(min(s.faces) for s in group)))
    tags = [1 + k for side in sides for k, group in enumerate(order) if side in group]
    names = [
        f"{found.names[group[0].body]} to {', '.join(found.names[side.other] for side in group)}"
        for group in order
    ]
    return names, np.array(tags)


def _nodes(count: int) -> str:
    return f"{count} node{'s' * (count > 1)}"


@dataclass(frozen=True, eq=False)
class _Roles:
    """Slave sides, and slave nodes that lose a constraint."""

    slave: Longs  # (p,) 0 or 1: index of the slave
    twice: dict[tuple[int, int], int]  # slave nodes of two pairs, lost by the second
    # nodes of the second pair that would close a cycle with the first
    cyclic: dict[tuple[int, int], int]

    @property
    def lost(self) -> tuple[int, int]:
        """Numbers of these nodes, of cycles first."""
        return sum(self.cyclic.values()), sum(self.twice.values())


def _choose_roles(found: _Found, ends: Longs) -> _Roles:
    """Finer sides as slaves, then the best turn of one pair each; with sides ``ends`` (p, 2).

    A node is the slave in one contact only; contacts must not need each other's slave nodes in a
    cycle (`interfaces.basis`). Slaves are at most `COARSE` times coarser than masters.
    """
    sizes = np.array([found.sides[one].sizes for one, _ in ends])
    finer = (sizes[:, 1] < sizes[:, 0] * (1.0 - HALF_OF_DIGITS)).astype(np.int64)
    coarser = sizes.max(axis=1) / sizes.min(axis=1)
    near = [k for k in np.argsort(coarser, kind="stable") if coarser[k] <= COARSE]
    best, before = _assess(found, ends, finer), None
    while best is not before:
        before = best
        turns = (before.slave ^ (np.arange(len(ends)) == k) for k in near)
        turned = (_assess(found, ends, slave) for slave in turns)
        best = min([before, *turned], key=lambda roles: roles.lost)
    return best


def _assess(found: _Found, ends: Longs, slave: Longs) -> _Roles:
    p = np.arange(len(slave))
    slaves, masters = ends[p, slave], ends[p, 1 - slave]
    shared = np.triu(found.common[np.ix_(slaves, slaves)], 1)
    twice = {(int(i), int(k)): int(shared[i, k]) for i, k in np.argwhere(shared)}
    return _Roles(slave, twice, _close_cycles(found.common[np.ix_(masters, slaves)]))


def _close_cycles(needed: Longs) -> dict[tuple[int, int], int]:
    """Entries (i, k), i < k, without which no pair needs itself."""
    _, label = scipy.sparse.csgraph.connected_components(
        scipy.sparse.coo_array(needed), directed=True, connection="strong"
    )
    some = [(int(i), int(k)) for i, k in np.argwhere(needed * (label[:, None] == label))]
    needs: Bools = np.eye(len(needed), dtype=bool)
    removed = {}
    for i, k in sorted(some, key=lambda ends: (max(ends), ends[0] < ends[1])):
        if needs[k, i]:
            removed[i, k] = int(needed[i, k])
        else:
            needs |= np.outer(needs[:, i], needs[k])
    return removed

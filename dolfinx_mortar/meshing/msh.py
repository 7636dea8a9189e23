# SPDX-License-Identifier: MIT
"""Meshes from files of Gmsh."""

import logging
import os
import re
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx_mortar.algebra.parallel import raised_together
from dolfinx_mortar.common import compat
from dolfinx_mortar.common.arguments import check, instance
from dolfinx_mortar.common.arrays import HALF_OF_DIGITS, Longs
from dolfinx_mortar.common.disk import check_path
from dolfinx_mortar.common.tags import Tags
from dolfinx_mortar.meshing.full_cells import fill_cells
from dolfinx_mortar.meshing.two_bodies import TaggedMesh, gmsh_model

log = logging.getLogger(__name__)

# Gmsh's numbers of known cells, and the corners of their facets.
CELLS = {2: 2, 3: 2, 9: 2, 10: 2, 4: 3, 5: 4, 11: 3, 12: 4}
KNOWN = "triangles, quadrilaterals, tetrahedra or hexahedra of degree 1 or 2"
# A line of $PhysicalNames: dimension, tag, name; text also in binary files.
NAMED = re.compile(rb'\s*(\d+)\s+(\d+)\s+"(.*)"\s*')


@dataclass(frozen=True)
class Group:
    """Physical groups of one name, on one rank."""

    dim: int
    tag: int
    name: str
    entities: list[int]  # that have elements
    nodes: dict[int, Longs]  # (elements, nodes of an element) by Gmsh's number of their kind

    @property
    def size(self) -> int:
        """Number of elements."""
        return sum(map(len, self.nodes.values()))

    def __str__(self) -> str:
        return f"{self.name!r}" if self.name else f"number {self.tag}"


def read_msh(path: str | os.PathLike[str], comm: MPI.Intracomm = MPI.COMM_WORLD) -> TaggedMesh:
    """Read mesh, cell tags and facet tags from a file of Gmsh, with their names (collective).

        mesh, cell_tags, facet_tags = dm.meshing.read_msh("bearing.msh")
        contact = dm.Contact(facet_tags, slave="pin", master="bore")

    Bodies are physical groups of the highest dimension, sides and supports those one dimension
    lower; others, and partitions, are ignored. Touching bodies must not share nodes. The tags are
    Gmsh's numbers of the groups; groups of one name and dimension are merged, with the lowest
    number. Rank 0 reads and distributes.

    Args:
        path: file of version 2 or 4, text or binary; in the plane z = 0 or in space, of first or
            second order. 8-node quadrilaterals and 20-node hexahedra get the nodes they lack by
            their own shape functions.
        comm: communicator of the mesh.

    Raises:
        OSError: on all ranks, as the others, if the file cannot be read.
        ValueError: if it is damaged or no .msh file; if cells are in no physical group or several,
            of several kinds or an unknown one; if a group is empty, or of no facets of bodies.
        RuntimeError: without gmsh.
    """
    check("comm", comm, instance(MPI.Intracomm, "give a communicator, such as MPI.COMM_WORLD"))
    file = check_path(comm, path)
    with ExitStack() as stack:
        groups: list[Group] = []
        model: Any = None
        with raised_together(comm):
            if comm.rank == 0:
                gmsh = _open(file, stack)
                fill_cells(gmsh.model)
                groups = _check(gmsh.model, _read_groups(gmsh.model, file), f"path = {str(file)!r}")
                model = gmsh.model
                model.removePhysicalGroups()
                for g in groups:
                    model.addPhysicalGroup(g.dim, g.entities, g.tag)
                model.mesh.renumberNodes()
        told = comm.bcast([(g.dim, g.tag, g.name) for g in groups])
        dim = max(d for d, _, _ in told)
        domain, cell_tags, facet_tags = compat.mesh_from_gmsh(model, comm, dim)
    domain.name = file.stem
    cell_tags.name, facet_tags.name = "bodies", "boundary"
    names = [{name: tag for d, tag, name in told if d == of and name} for of in (dim, dim - 1)]
    return TaggedMesh(domain, Tags(cell_tags, names[0]), Tags(facet_tags, names[1]))


def _open(file: Path, stack: ExitStack) -> Any:
    """Gmsh with the model of a file, until the stack closes; OSError, ValueError, RuntimeError.

    gmsh puts elements without a tag of geometry (meshio) in entity 0: then tags of groups replace
    those of entities.
    """
    if not file.is_file():
        raise FileNotFoundError(f"path = {str(file)!r}: there is no such file in {Path.cwd()}.")
    with file.open("rb") as stream:
        if b"$MeshFormat" not in stream.read(4096):
            raise ValueError(
                f"path = {str(file)!r} is no mesh of Gmsh (version 2 or 4): it does not begin with "
                "$MeshFormat. Make one of a geometry with: gmsh -3 FILE -format msh41"
            )
    gmsh = stack.enter_context(gmsh_model())
    try:
        gmsh.merge(str(file))
        gmsh.model.mesh.unpartition()
        if all(tag for dim, tag in gmsh.model.getEntities() if dim):
            return gmsh
        gmsh.model.remove()
        gmsh.model.add(file.stem)
        gmsh.option.setNumber("Mesh.SwitchElementTags", 1)
        gmsh.merge(str(file))
    except Exception as error:  # gmsh raises bare Exception
        raise ValueError(f"path = {str(file)!r} is damaged: gmsh says: {error}") from error
    gmsh.model.removePhysicalGroups()
    for dim, tag in gmsh.model.getEntities():
        if tag > 0:
            gmsh.model.addPhysicalGroup(dim, [tag], tag)
    return gmsh


def _read_groups(model: Any, file: Path) -> list[Group]:
    """Groups with elements or a name, merged by name; names from the file, as gmsh loses some."""
    names = {(dim, tag): name for dim, tag, name in _named(file)}
    filled = {(int(d), int(t)) for d, t in model.getPhysicalGroups()}
    alike: dict[tuple[int, int | str], list[int]] = {}
    for dim, tag in sorted({*names, *filled}):
        alike.setdefault((dim, names.get((dim, tag)) or tag), []).append(tag)
    found = []
    for (dim, name), tags in alike.items():
        entities: list[int] = []
        parts: dict[int, list[Longs]] = {}
        groups = [(dim, tag) for tag in tags if (dim, tag) in filled]
        for entity in sorted(
            {int(e) for g in groups for e in model.getEntitiesForPhysicalGroup(*g)}
        ):
            kinds, numbers, nodes = model.mesh.getElements(dim, entity)
            entities += [entity] if len(kinds) else []
            for kind, every, flat in zip(kinds, numbers, nodes, strict=True):
                own = np.asarray(flat, dtype=np.int64).reshape(len(every), -1)
                parts.setdefault(int(kind), []).append(own)
        by_kind = {kind: np.concatenate(some) for kind, some in parts.items()}
        text = name if isinstance(name, str) else ""
        found.append(Group(dim, tags[0], text, entities, by_kind))
    return found


def _named(file: Path) -> Iterator[tuple[int, int, str]]:
    with file.open("rb") as stream:
        for line in stream:
            if line.startswith((b"$EndPhysicalNames", b"$Entities", b"$Nodes")):
                return
            if (found := NAMED.fullmatch(line)) is not None:
                yield int(found[1]), int(found[2]), found[3].decode(errors="replace")


def _check(model: Any, groups: list[Group], path: str) -> list[Group]:
    if not groups:
        raise ValueError(
            f"{path} has no physical groups, so that nothing tells bodies and sides apart: in "
            'Gmsh, Physical Volume("ball") = {1}; and Physical Surface("top") = {2}; or '
            "gmsh.model.addPhysicalGroup(dim, tags, name=...)."
        )
    empty = [g for g in groups if g.dim > 0 and not g.size]
    if empty:
        raise ValueError(
            f"{path}: the physical group {', '.join(map(str, empty))} is empty (dimension "
            f"{empty[0].dim}): give it entities, or take it out; mesh all dimensions (gmsh -3)."
        )
    dim = max(g.dim for g in groups)
    bodies, sides = ([g for g in groups if g.dim == of] for of in (dim, dim - 1))
    _check_cells(model, bodies, path)
    _check_plane(model, bodies, path)
    _check_apart(bodies, path)
    _check_apart(sides, path)
    _check_facets(model, bodies, sides, path)
    for sort in (bodies, sides):
        nameless = [str(g.tag) for g in sort if not g.name]
        if 0 < len(nameless) < len(sort):
            log.warning(
                "%s: physical groups without a name, of dimension %d: %s; where another group has "
                "the name already, gmsh.model.addPhysicalGroup leaves it out: put all entities of "
                "a name into one group, or use the numbers",
                *(path, sort[0].dim, ", ".join(nameless)),
            )
    return bodies + sides


def _check_cells(model: Any, bodies: list[Group], path: str) -> None:
    dim = bodies[0].dim
    if dim < 2:
        raise ValueError(
            f"{path}: the physical groups are of dimension {dim}; bodies are surfaces in 2D or "
            "volumes in 3D: add a physical surface or volume for each."
        )

    def count(entities: list[tuple[int, int]]) -> int:
        """Number of elements, those of several groups once."""
        tags = [some for at in entities for some in model.mesh.getElements(*at)[1]]
        return len(np.unique(np.concatenate([[], *tags])))

    inside = [(dim, entity) for g in bodies for entity in g.entities]
    for d in range(3, dim - 1, -1):
        n = count([(d, -1)]) - (count(inside) if d == dim else 0)
        if n:
            raise ValueError(
                f"{path}: {n} cells of dimension {d} are in no physical group: give each body a "
                f"physical {('surface', 'volume')[d - 2]}."
            )
    kinds = sorted({kind for g in bodies for kind in g.nodes})
    names = sorted(model.mesh.getElementProperties(kind)[0] for kind in kinds)
    if len(kinds) > 1:
        raise ValueError(
            f"{path} mixes cells, {' and '.join(names)}: use one kind for all bodies (in Gmsh, "
            "recombine all surfaces or none)."
        )
    if kinds[0] not in CELLS:
        raise ValueError(
            f"{path}: cells of the kind {names[0]!r} are not supported; use {KNOWN} (in Gmsh, "
            "Mesh.ElementOrder 1 or 2)."
        )


def _check_facets(model: Any, bodies: list[Group], sides: list[Group], path: str) -> None:
    """Raise a ValueError for elements of sides that are no facets: dolfinx would abort."""
    (kind,) = {kind for g in bodies for kind in g.nodes}
    k = CELLS[kind]
    parts = [nodes[:, :k] for g in sides for nodes in g.nodes.values()]
    if not parts:
        return
    if bodies[0].dim == 2:
        found = model.mesh.getElementEdgeNodes(kind, primary=True)
    else:
        found = model.mesh.getElementFaceNodes(kind, k, primary=True)
    every = np.asarray(found, dtype=np.int64).reshape(-1, k)
    facets = every[np.isin(every, np.concatenate([part.ravel() for part in parts])).all(axis=1)]
    known = {tuple(row) for row in np.sort(facets, axis=1)}
    for g in sides:
        rows = (np.sort(nodes[:, :k], axis=1) for nodes in g.nodes.values())
        off = sum(tuple(row) not in known for some in rows for row in some)
        if off:
            raise ValueError(
                f"{path}: {off} of the {g.size} elements of the physical group {g} "
                f"(dimension {g.dim}) are no facets of a body: if they bound one that is in no "
                f"group, give it a physical {('surface', 'volume')[g.dim - 1]}; take what bounds "
                "no body, such as a section, an axis or the surface of a tool, out of the groups."
            )


def _check_plane(model: Any, bodies: list[Group], path: str) -> None:
    if bodies[0].dim == 3:
        return
    tags, x, _ = model.mesh.getNodes()
    parts = [nodes.ravel() for g in bodies for nodes in g.nodes.values()]
    x = x.reshape(-1, 3)[np.isin(tags, np.concatenate(parts))]
    low, high = float(x[:, 2].min()), float(x[:, 2].max())
    if max(-low, high) > HALF_OF_DIGITS * np.ptp(x, axis=0).max():
        raise ValueError(
            f"{path}: a mesh of surfaces must be in the plane z = 0, but has z from {low:g} to "
            f"{high:g}: rotate or move it; bodies in space need physical volumes."
        )


def _check_apart(groups: list[Group], path: str) -> None:
    for kind in sorted({kind for g in groups for kind in g.nodes}):
        parts = [(g, g.nodes[kind]) for g in groups if kind in g.nodes]
        owner = np.repeat(np.arange(len(parts)), [len(n) for _, n in parts])
        nodes = np.sort(np.concatenate([n for _, n in parts]), axis=1)
        _, first, same = np.unique(nodes, axis=0, return_index=True, return_inverse=True)
        before = first[same.ravel()]
        pairs = np.stack([owner[before], owner])[:, before != np.arange(len(owner))]
        apart = pairs[:, pairs[0] != pairs[1]]
        if apart.size:
            one, other = (parts[i][0] for i in apart[:, 0])
            raise ValueError(
                f"{path}: {apart.shape[1]} elements of dimension {one.dim} are in two physical "
                f"groups, such as {one} and {other}, but an element has one "
                "tag: leave it out of one of them. If the groups are the two sides of an "
                "interface, the bodies share their nodes there and are one: make each with a "
                "boundary of its own (in Gmsh, do not fragment them)."
            )
        if pairs.size:
            raise ValueError(
                f"{path}: {pairs.shape[1]} elements of the physical group {parts[pairs[0, 0]][0]} "
                "are in the file twice: write it anew (Mesh.MshFileVersion 4.1)."
            )

# SPDX-License-Identifier: MIT
"""Meshes of a user's own: files of Gmsh, with the names of their physical groups."""

import os
import re
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx_mortar import compat
from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.arrays import HALF_OF_DIGITS, Longs
from dolfinx_mortar.meshing.two_bodies import TaggedMesh, gmsh_model
from dolfinx_mortar.tags import Tags

# Gmsh's numbers of the cells that the package knows.
CELLS = (2, 3, 9, 10, 4, 5, 11, 12)
KNOWN = "triangles, quadrilaterals, tetrahedra or hexahedra of degree 1 or 2"
# A line of $PhysicalNames: dimension, tag, name. Text also in binary files.
NAMED = re.compile(rb'\s*(\d+)\s+(\d+)\s+"(.*)"\s*')


@dataclass(frozen=True)
class Group:
    """A physical group of a file, on one rank."""

    dim: int
    tag: int
    name: str  # empty if it has none
    kinds: tuple[str, ...]  # of its elements, in Gmsh's words
    types: tuple[int, ...]  # Gmsh's numbers of these kinds
    elements: Longs  # (m,) numbers of its elements
    nodes: tuple[Longs, ...]  # of each kind, (elements, nodes of an element)

    def __str__(self) -> str:
        return f"{self.name!r}" if self.name else f"number {self.tag}"


def read_msh(path: str | os.PathLike[str], comm: MPI.Intracomm = MPI.COMM_WORLD) -> TaggedMesh:
    """Read mesh, cell tags and facet tags from a file of Gmsh, with their names (collective).

        mesh, cell_tags, facet_tags = dm.meshing.read_msh("bearing.msh")
        contact = dm.Contact(facet_tags, slave="pin", master="bore")

    Bodies are physical groups of the highest dimension, sides and supports those of the next lower
    one (others are left out); each body is meshed apart, without common nodes where bodies touch.
    The tags are Gmsh's numbers of the groups, and their names the groups' names. Rank 0 reads, and
    distributes.

    Args:
        path: file of version 2 or 4, text or binary; in the plane z = 0 or in space, of first or
            second order.
        comm: communicator of the mesh.

    Raises:
        OSError: if there is no such file, or it cannot be read.
        ValueError: if the file is no .msh file or damaged; has no physical groups, empty ones, or
            two of one kind with one name; if cells are in no group or in several, of several kinds,
            of an unknown kind, lines, or a surface in space.
        RuntimeError: if gmsh is not installed. All errors are raised on all ranks.
    """
    with ExitStack() as stack:
        groups: list[Group] = []
        model: Any = None
        with raised_together(comm):
            if comm.rank == 0:
                file = _check_file(path)
                model = _open_model(file, stack)
                groups = _read_groups(model, file)
                _check(model, groups, f"path = {os.fspath(path)!r}")
                model.mesh.renumberNodes()  # dolfinx wants no gaps
        told = comm.bcast([(g.dim, g.tag, g.name) for g in groups])
        dim = max(d for d, _, _ in told)
        domain, cell_tags, facet_tags = compat.mesh_from_gmsh(model, comm, dim)
    domain.name = Path(path).stem
    cell_tags.name, facet_tags.name = "bodies", "boundary"
    names = [{name: tag for d, tag, name in told if d == of and name} for of in (dim, dim - 1)]
    return TaggedMesh(domain, Tags(cell_tags, names[0]), Tags(facet_tags, names[1]))


def _check_file(path: Any) -> Path:
    """Return the path of a file of Gmsh.

    Raises:
        OSError: if there is none.
        ValueError: if it is something else.
    """
    file = Path(path)
    if not file.is_file():
        raise FileNotFoundError(f"path = {str(file)!r}: there is no such file in {Path.cwd()}.")
    with file.open("rb") as stream:
        if b"$MeshFormat" not in stream.read(4096):
            raise ValueError(
                f"path = {str(file)!r} is no mesh of Gmsh (version 2 or 4): it does not begin with "
                "$MeshFormat. Make one of a geometry with: gmsh -3 FILE -format msh41"
            )
    return file


def _open_model(file: Path, stack: ExitStack) -> Any:
    """Return gmsh's model of a file; the stack closes it.

    Raises:
        ValueError: if gmsh cannot read it.
        RuntimeError: if there is no gmsh.
    """
    try:
        gmsh = stack.enter_context(gmsh_model())
    except ImportError as error:
        raise RuntimeError(
            "gmsh is not installed; pip install 'dolfinx_mortar[demo]' (or python3-gmsh)."
        ) from error
    try:
        gmsh.merge(str(file))
    except Exception as error:  # gmsh raises bare Exception
        raise ValueError(f"path = {str(file)!r} is damaged: gmsh says: {error}") from error
    return gmsh.model


def _read_groups(model: Any, file: Path) -> list[Group]:
    """Return the groups that have elements or a name.

    Gmsh forgets the names of empty groups, and one of two that are the same: those are read from
    the file.
    """
    names = {(dim, tag): name for dim, tag, name in _named(file)}
    keys = sorted({*names, *((int(d), int(t)) for d, t in model.getPhysicalGroups())})
    return [_read_group(model, dim, tag, names.get((dim, tag), "")) for dim, tag in keys]


def _named(file: Path) -> Iterator[tuple[int, int, str]]:
    """Yield dimension, tag and name of the groups that a file names."""
    with file.open("rb") as stream:
        for line in stream:
            if line.startswith((b"$EndPhysicalNames", b"$Entities", b"$Nodes")):
                return
            if (found := NAMED.fullmatch(line)) is not None:
                yield int(found[1]), int(found[2]), found[3].decode(errors="replace")


def _read_group(model: Any, dim: int, tag: int, name: str) -> Group:
    """Return a group with its elements."""
    found: dict[int, list[tuple[Longs, Longs]]] = {}
    known = (dim, tag) in {(int(d), int(t)) for d, t in model.getPhysicalGroups()}
    for entity in model.getEntitiesForPhysicalGroup(dim, tag) if known else ():
        for kind, *arrays in zip(*model.mesh.getElements(dim, entity), strict=True):
            tags, nodes = (np.asarray(a, dtype=np.int64) for a in arrays)
            found.setdefault(int(kind), []).append((tags, nodes.reshape(len(tags), -1)))
    none = [np.empty(0, dtype=np.int64)]
    return Group(
        dim,
        tag,
        name,
        tuple(model.mesh.getElementProperties(kind)[0] for kind in found),
        tuple(found),
        np.concatenate([tags for parts in found.values() for tags, _ in parts] or none),
        tuple(np.concatenate([nodes for _, nodes in parts]) for parts in found.values()),
    )


def _check(model: Any, groups: list[Group], path: str) -> None:
    """Raise a ValueError unless a mesh of ours can be made of the groups."""
    if not groups:
        raise ValueError(
            f"{path} has no physical groups, so that nothing tells bodies and sides apart: in "
            'Gmsh, Physical Volume("ball") = {1}; and Physical Surface("top") = {2}; or '
            "gmsh.model.addPhysicalGroup(dim, tags, name=...)."
        )
    empty = [g for g in groups if g.dim > 0 and not len(g.elements)]
    if empty:
        raise ValueError(
            f"{path}: the physical group {', '.join(map(str, empty))} is empty (dimension "
            f"{empty[0].dim}): give it entities, or take it out; mesh all dimensions (gmsh -3)."
        )
    twice = [key for key, n in Counter((g.dim, g.name) for g in groups if g.name).items() if n > 1]
    for dim, name in twice:
        tags = [g.tag for g in groups if (g.dim, g.name) == (dim, name)]
        raise ValueError(
            f"{path}: the physical groups {' and '.join(map(str, tags))} of dimension {dim} are "
            f"both called {name!r}: rename one, or make them one group."
        )
    dim = max((g.dim for g in groups), default=0)
    bodies = [g for g in groups if g.dim == dim]
    _check_cells(model, bodies, path)
    _check_plane(model, bodies, path)
    for sort in (bodies, [g for g in groups if g.dim == dim - 1]):
        _check_apart(sort, path)


def _check_cells(model: Any, bodies: list[Group], path: str) -> None:
    """Raise a ValueError unless all cells are of one known kind, and in a group."""
    dim = bodies[0].dim
    if dim < 2:
        raise ValueError(
            f"{path}: the physical groups are of dimension {dim}; bodies are surfaces in 2D or "
            "volumes in 3D: add a physical surface or volume for each."
        )
    every = {d: model.mesh.getElements(d)[1] for d in range(dim, 4)}
    left = {d: sum(map(len, tags)) for d, tags in every.items()}
    left[dim] -= len(np.unique(np.concatenate([g.elements for g in bodies])))
    for d, n in reversed(left.items()):
        if n:
            raise ValueError(
                f"{path}: {n} cells of dimension {d} are in no physical group: give each body a "
                f"physical {('surface', 'volume')[d - 2]}."
            )
    kinds = dict(kind for g in bodies for kind in zip(g.types, g.kinds, strict=True))
    if len(kinds) > 1:
        raise ValueError(
            f"{path} mixes cells, {' and '.join(sorted(kinds.values()))}: use one kind for all "
            "bodies (in Gmsh, recombine all surfaces or none)."
        )
    ((kind, name),) = kinds.items()
    if kind not in CELLS:
        raise ValueError(
            f"{path}: cells of the kind {name!r} are not supported; use {KNOWN} (in Gmsh, "
            "Mesh.ElementOrder 1 or 2, Mesh.SecondOrderIncomplete 0)."
        )


def _check_plane(model: Any, bodies: list[Group], path: str) -> None:
    """Raise a ValueError if surfaces are not in the plane z = 0."""
    if bodies[0].dim == 3:
        return
    tags, x, _ = model.mesh.getNodes()
    x = x.reshape(-1, 3)[np.isin(tags, np.unique(np.concatenate([g.nodes[0] for g in bodies])))]
    low, high = float(x[:, 2].min()), float(x[:, 2].max())
    if max(-low, high) > HALF_OF_DIGITS * np.ptp(x, axis=0).max():
        raise ValueError(
            f"{path}: a mesh of surfaces must be in the plane z = 0, but has z from {low:g} to "
            f"{high:g}: rotate or move it; bodies in space need physical volumes."
        )


def _check_apart(groups: list[Group], path: str) -> None:
    """Raise a ValueError if an element is in two groups, of one dimension; its tag is one."""
    kinds = sorted({kind for g in groups for kind in g.types})
    for kind in kinds:
        parts = [(g, g.nodes[g.types.index(kind)]) for g in groups if kind in g.types]
        owner = np.concatenate([np.full(len(n), i) for i, (_, n) in enumerate(parts)])
        nodes = np.sort(np.concatenate([n for _, n in parts]), axis=1)
        order = np.lexsort([owner, *nodes.T])
        same = (nodes[order[1:]] == nodes[order[:-1]]).all(axis=1)
        pairs = np.stack([owner[order[:-1]], owner[order[1:]]])[:, same]
        apart = pairs[:, pairs[0] != pairs[1]]
        if apart.size:
            first, second = (parts[i][0] for i in apart[:, 0])
            raise ValueError(
                f"{path}: {apart.shape[1]} elements of dimension {first.dim} are in two physical "
                f"groups, such as {first} and {second}, but an element has one "
                "tag: leave it out of one of them. If the groups are the two sides of an "
                "interface, the bodies share their nodes there and are one: make each with a "
                "boundary of its own (in Gmsh, do not fragment them)."
            )
        if pairs.size:
            raise ValueError(
                f"{path}: {pairs.shape[1]} elements of the physical group {parts[pairs[0, 0]][0]} "
                "are in the file twice: write it anew (Mesh.MshFileVersion 4.1)."
            )

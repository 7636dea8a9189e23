# SPDX-License-Identifier: MIT
"""The mesh of a tube on another one, a hub on a shaft: their half section, or a quarter in 3D."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from mpi4py import MPI

import numpy as np

from dolfinx import mesh as dmesh
from dolfinx_mortar.arrays import Bools, Floats
from dolfinx_mortar.meshing.arguments import check_on_all_ranks, positive
from dolfinx_mortar.meshing.bodies import ON_PLANE, Arrays, distribute, exterior_facets
from dolfinx_mortar.tags import Tags

INNER_TUBE, OUTER_TUBE = 1, 2
BODIES = {"inner": INNER_TUBE, "outer": OUTER_TUBE}
SIDES = {
    "bore": 1,
    "outside": 2,
    "around_inner": 3,
    "within_outer": 4,
    "on_y": 5,
    "on_x": 6,
    "inner_start": 7,
    "inner_end": 8,
    "outer_start": 9,
    "outer_end": 10,
}


class TubesMesh(NamedTuple):
    """Mesh of the tubes, with its tags."""

    mesh: dmesh.Mesh
    cell_tags: Tags  # 1 inner tube, 2 outer tube
    # 1 bore, 2 outside, 3 outside of the inner tube, 4 bore of the outer one, 5 x = 0, 6 y = 0 (in
    # 3D), 7 and 8 the ends of the inner tube at z = 0 and at its length, 9 and 10 of the outer one
    facet_tags: Tags


def tubes(
    comm: MPI.Intracomm,
    *,
    radii: tuple[float, float, float] = (10.0, 20.0, 30.0),
    length: float = 20.0,
    cells: Sequence[Sequence[int]] = ((6, 12), (7, 15)),
) -> TubesMesh:
    """Mesh two tubes of one length, one on the other, non-matching where they meet (collective).

    The section has coordinates (r, z) and quadrilaterals, the quarter x, y >= 0 in 3D coordinates
    (x, y, z) and hexahedra; z runs from 0 to the length. Nodes lie on circles; the tubes have no
    node in common. Cell tags: 1 inner tube, 2 outer one. Facet tags: 1 bore, 2 outside, 3 and 4 the
    sides of the inner and of the outer tube where they meet, 5 on x = 0 and 6 on y = 0 in 3D, 7 and
    8 the ends of the inner tube at z = 0 and at its length, 9 and 10 those of the outer one. Their
    names are "inner" and "outer", "bore", "outside", "around_inner", "within_outer", "on_y",
    "on_x", "inner_start", "inner_end", "outer_start" and "outer_end".

    Args:
        comm: Communicator of the mesh.
        radii: Radii of the bore, of the side where the tubes meet, and of the outside.
        length: Length of both tubes.
        cells: For each tube how many cells lie across the wall and along the axis; with a third
            number, around the quarter, the mesh is in 3D.

    Raises:
        ValueError: If an argument is out of range (on all ranks).
    """
    given = {"radii": radii, "length": length, "cells": cells}
    r, L, n = check_on_all_ranks(comm, _check, **given)
    space = len(n[0]) == 3

    def create() -> tuple[Arrays, Arrays]:
        return _tube(r[0], r[1], L, n[0]), _tube(r[1], r[2], L, n[1])

    mesh, first = distribute(comm, create, "hexahedron" if space else "quadrilateral")
    mesh.name = "tubes"
    in_first = mesh.topology.original_cell_index < first
    values = np.where(in_first, INNER_TUBE, OUTER_TUBE).astype(np.int32)
    cells_tagged = np.arange(len(values), dtype=np.int32)
    cell_tags = dmesh.meshtags(mesh, mesh.topology.dim, cells_tagged, values)
    cell_tags.name = "bodies"
    facet_tags = _tag_boundary(mesh, in_first, r, L)
    facet_tags.name = "boundary"
    return TubesMesh(mesh, Tags(cell_tags, BODIES), Tags(facet_tags, SIDES))


def _check(
    *, radii: Any, length: Any, cells: Any
) -> tuple[tuple[float, ...], float, list[list[int]]]:
    """Return radii, length and numbers of cells, or raise a ValueError."""
    r = positive("radii", radii, "bore, where the tubes meet, outside")
    if not r[0] < r[1] < r[2]:
        raise ValueError(f"radii = {radii!r} must grow from the bore to the outside.")
    (L,) = positive("length", length, "of both tubes")
    n = np.array(cells, dtype=object)
    shaped = n.shape in ((2, 2), (2, 3))
    if not shaped or not all(isinstance(v, int | np.integer) and v > 0 for v in n.flat):
        raise ValueError(
            f"cells = {cells!r} must be two positive integers for each of the two tubes, across "
            "and along, or three for a mesh in 3D: across, along and around."
        )
    return r, L, [[int(v) for v in row] for row in n]


def _tube(inner: float, outer: float, length: float, cells: list[int]) -> Arrays:
    """Mesh one tube: nodes (n, d), cells (m, 2^d); the last direction runs fastest."""
    ends = ((inner, outer), (0.0, length), (0.0, 1.0))
    lines = [np.linspace(*ends[k], count + 1) for k, count in enumerate(cells)]
    grid: list[Floats] = [a.ravel() for a in np.meshgrid(*lines, indexing="ij")]
    strides = [int(np.prod([count + 1 for count in cells[k + 1 :]])) for k in range(len(cells))]
    corner = np.array([0])
    for stride in strides:
        corner = (corner[:, None] + np.array([0, stride])).ravel()
    lattice = np.meshgrid(*[np.arange(count) for count in cells], indexing="ij")
    first = sum(stride * a.ravel() for stride, a in zip(strides, lattice, strict=True))
    quads = np.asarray(first)[:, None] + corner
    if len(cells) == 2:
        return np.stack(grid, axis=1), quads.astype(np.int64)
    r, z, turn = grid
    # nodes on the symmetry planes are there without round-off
    x = np.where(turn == 1.0, 0.0, r * np.cos(np.pi / 2 * turn))
    return np.stack([x, r * np.sin(np.pi / 2 * turn), z], axis=1), quads.astype(np.int64)


def _tag_boundary(
    mesh: dmesh.Mesh, in_first: Bools, radii: tuple[float, ...], length: float
) -> dmesh.MeshTags:
    """Tag the outer facets of the tubes from the tube they belong to and where they are."""
    facets, inner, x = exterior_facets(mesh, in_first)
    space = mesh.topology.dim == 3
    radius: Floats = np.linalg.norm(x[:, :, :2], axis=2) if space else x[:, :, 0]
    z = x[:, :, mesh.topology.dim - 1]

    def on(values: Floats, at: float, size: float) -> Bools:
        return np.asarray(np.abs(values - at).max(axis=1, initial=0.0) < ON_PLANE * size)

    a, c, b = radii
    common = on(radius, c, b)
    sides = [
        ("bore", on(radius, a, b)),
        ("outside", on(radius, b, b)),
        ("around_inner", common & inner),
        ("within_outer", common & ~inner),
        ("inner_start", on(z, 0.0, length) & inner),
        ("inner_end", on(z, length, length) & inner),
        ("outer_start", on(z, 0.0, length) & ~inner),
        ("outer_end", on(z, length, length) & ~inner),
    ]
    if space:
        sides += [("on_y", on(x[:, :, 0], 0.0, b)), ("on_x", on(x[:, :, 1], 0.0, b))]
    values = np.zeros(len(facets), dtype=np.int32)
    for name, where in sides:
        values[where] = SIDES[name]
    return dmesh.meshtags(mesh, mesh.topology.dim - 1, facets, values)

# SPDX-License-Identifier: MIT
"""The mesh of a tube's section: a quarter of one ring, or of two that meet without matching."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from mpi4py import MPI

import numpy as np

from dolfinx import mesh as dmesh
from dolfinx_mortar.arrays import Bools, Floats
from dolfinx_mortar.meshing.arguments import check_on_all_ranks, choose
from dolfinx_mortar.meshing.bodies import ON_PLANE, Arrays, distribute, exterior_facets
from dolfinx_mortar.tags import Tags

INNER_RING, OUTER_RING = 1, 2
BORE, OUTSIDE, AROUND_INNER, WITHIN_OUTER, ON_Y, ON_X = 1, 2, 3, 4, 5, 6
BODIES = {"inner": INNER_RING, "outer": OUTER_RING}
SIDES = {
    "bore": BORE,
    "outside": OUTSIDE,
    "around_inner": AROUND_INNER,
    "within_outer": WITHIN_OUTER,
    "on_y": ON_Y,
    "on_x": ON_X,
}


class RingsMesh(NamedTuple):
    """Mesh of the rings, with its tags."""

    mesh: dmesh.Mesh
    cell_tags: Tags  # 1 inner ring, 2 outer ring
    # 1 bore, 2 outside, 3 outside of the inner ring, 4 bore of the outer one, 5 x = 0, 6 y = 0
    facet_tags: Tags


def rings(
    comm: MPI.Intracomm,
    *,
    radii: Sequence[float] = (1.0, 1.15, 1.3),
    cells: Sequence[tuple[int, int]] = ((6, 36), (8, 48)),
    cell: str = "quadrilateral",
) -> RingsMesh:
    """Mesh the quarter x, y >= 0 of one ring or of two around each other (collective).

    Nodes lie on circles; two rings have no node in common. Cell tags: 1 inner (or only) ring,
    2 outer one. Facet tags: 1 bore, 2 outside, 3 and 4 the sides of the inner and of the outer ring
    where they meet, 5 on x = 0, 6 on y = 0. Their names are "inner" and "outer", "bore", "outside",
    "around_inner", "within_outer", "on_y" and "on_x".

    Args:
        comm: Communicator of the mesh.
        radii: Radii from the bore to the outside, two for one ring, three for two.
        cells: For each ring how many cells lie across and along it.
        cell: "triangle" or "quadrilateral".

    Raises:
        ValueError: If an argument is out of range (on all ranks).
    """
    r, n = check_on_all_ranks(comm, _check, radii=radii, cells=cells, cell=cell)

    def create() -> tuple[Arrays, Arrays]:
        made = [_ring(r[k], r[k + 1], n[k], cell) for k in range(len(n))]
        nothing = np.empty((0, 2)), np.empty((0, made[0][1].shape[1]), dtype=np.int64)
        return made[0], (made[1] if len(made) > 1 else nothing)

    mesh, first = distribute(comm, create, cell)
    mesh.name = "rings"
    in_first = mesh.topology.original_cell_index < first
    values = np.where(in_first, INNER_RING, OUTER_RING).astype(np.int32)
    cell_tags = dmesh.meshtags(mesh, 2, np.arange(len(values), dtype=np.int32), values)
    cell_tags.name = "bodies"
    facet_tags = _tag_boundary(mesh, in_first, r)
    facet_tags.name = "boundary"
    return RingsMesh(mesh, Tags(cell_tags, BODIES), Tags(facet_tags, SIDES))


def _check(*, radii: Any, cells: Any, cell: Any) -> tuple[list[float], list[list[int]]]:
    """Return radii and numbers of cells, or raise a ValueError."""
    choose("cell", cell, ("triangle", "quadrilateral"))
    try:
        r = [float(v) for v in radii]
    except (TypeError, ValueError):
        r = []
    if len(r) not in (2, 3) or not np.isfinite(r).all() or not (np.diff([0.0, *r]) > 0.0).all():
        raise ValueError(
            f"radii = {radii!r} must be two or three growing positive numbers, from the bore to "
            "the outside."
        )
    n = np.array(cells, dtype=object)
    shape = (len(r) - 1, 2)
    if n.shape != shape or not all(isinstance(v, int | np.integer) and v > 0 for v in n.flat):
        raise ValueError(
            f"cells = {cells!r} must be a pair of positive integers for each of {shape[0]} rings: "
            "how many cells lie across and along it."
        )
    return r, [[int(v) for v in row] for row in n]


def _ring(inner: float, outer: float, cells: list[int], cell: str) -> Arrays:
    """Mesh the quarter of one ring."""
    across, along = cells
    r = np.linspace(inner, outer, across + 1)
    angle = np.pi / 2 * np.linspace(0.0, 1.0, along + 1)
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    direction[-1, 0] = 0.0
    x = (direction[:, None] * r[:, None]).reshape(-1, 2)
    first = (np.arange(along)[:, None] * (across + 1) + np.arange(across)).ravel()
    quads = first[:, None] + np.array([0, 1, across + 1, across + 2])
    if cell == "quadrilateral":
        return x, quads
    return x, np.concatenate([quads[:, [0, 1, 3]], quads[:, [0, 3, 2]]])


def _tag_boundary(mesh: dmesh.Mesh, in_first: Bools, radii: list[float]) -> dmesh.MeshTags:
    """Tag the outer facets of the rings from the ring they belong to and their radius."""
    facets, inner_ring, x = exterior_facets(mesh, in_first)
    radius: Floats = np.linalg.norm(x, axis=2)

    def on(values: Floats, at: float) -> Bools:
        return np.asarray(np.abs(values - at).max(axis=1, initial=0.0) < ON_PLANE * radii[-1])

    values = np.zeros(len(facets), dtype=np.int32)
    values[on(x[:, :, 0], 0.0)], values[on(x[:, :, 1], 0.0)] = ON_Y, ON_X
    values[on(radius, radii[0])], values[on(radius, radii[-1])] = BORE, OUTSIDE
    if len(radii) == 3:
        between = on(radius, radii[1])
        values[between & inner_ring], values[between & ~inner_ring] = AROUND_INNER, WITHIN_OUTER
    return dmesh.meshtags(mesh, 1, facets, values)

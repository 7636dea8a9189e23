# SPDX-License-Identifier: MIT
"""Meshes for the demos and tests, made by gmsh on one rank and distributed.

Both bodies of a contact problem live in one mesh with two disconnected parts. Each symmetric body
is meshed as its right half and mirrored, so that the mesh has the symmetry of the problem, and is
meshed in a gmsh model of its own, so that no node can be shared where the bodies touch.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from mpi4py import MPI

import numpy as np

from dolfinx import mesh as dmesh
from dolfinx_mortar.arrays import Bools, Floats, Longs
from dolfinx_mortar.meshing.arguments import check_gap, check_on_all_ranks, choose, finite, positive
from dolfinx_mortar.meshing.bodies import (
    ON_PLANE,
    Arrays,
    distribute,
    exterior_facets,
    gmsh_model,
    read_cells,
    set_graded_size,
)
from dolfinx_mortar.tags import Tags

BLOCK, DISC = 1, 2  # cell tags
BOTTOM, FLAT, TOP, ARC, AXIS = 1, 2, 3, 4, 5  # facet tags
BODIES = {"block": BLOCK, "disc": DISC}
SIDES = {"bottom": BOTTOM, "flat": FLAT, "top": TOP, "arc": ARC, "axis": AXIS}
PAPER_DIVISIONS = (34, 20)  # half block: 34 x 20 rectangles, 2720 triangles in the whole block
PAPER_DISC_SIZE = 0.45 / 8.0  # element size over radius that gives about 1200 triangles
Graded = tuple[float, float] | None  # size at the contact point, largest one over it
GRADED_CORE = 2.5  # mm, distance from the contact point within which the size is h


class HertzMesh(NamedTuple):
    """Mesh of the half disc on the block, with its tags."""

    mesh: dmesh.Mesh
    cell_tags: Tags  # 1 block, 2 disc
    # 1 bottom of block, 2 flat face of disc, 3 top of block, 4 arc, 5 axis, the line of symmetry of
    # the half
    facet_tags: Tags


def hertz(
    comm: MPI.Intracomm,
    *,
    kind: str = "paper",
    h: float | tuple[float, float] = 0.05,
    radius: float = 8.0,
    block: tuple[float, float] = (30.0, 10.0),
    gap: float = 0.0,
    cell: str = "triangle",
    half: bool = False,
    limit: float = 10.0,
) -> HertzMesh:
    """Mesh a half disc above a block, non-matching where they touch (collective).

    The block is [-w/2, w/2] x [-t, 0] with (w, t) = ``block``. The disc has its lowest point at
    (0, ``gap``) and its flat face on top at y = ``radius + gap``. The mesh is symmetric in x and
    (0, 0), (0, ``gap``) are nodes. Cell tags: 1 block, 2 disc. Facet tags: 1 bottom of the block,
    2 flat face of the disc, 3 top of the block, 4 arc of the disc; the half that is x >= 0 alone,
    which is also the section of a ball on a round plate, has 5 on x = 0. Their names are "block"
    and "disc", "bottom", "flat", "top", "arc" and "axis".

    Args:
        comm: Communicator of the mesh; gmsh runs on its rank 0 only.
        kind: "paper": about 1200 cells in the disc and 2720 in the block (as triangles, for any
            ``radius`` and ``block``); "graded": element size ``h`` within 2.5 mm of the first
            contact point and h (1 + r - 2.5), at most ``limit`` h, at distance r mm.
        h: Element size of the graded mesh [mm]; a pair gives (block, disc) separately.
        radius: Radius of the disc [mm].
        block: Width and thickness of the block [mm].
        gap: Initial vertical gap between the bodies [mm]; negative for an overlap.
        cell: "triangle" or "quadrilateral".
        half: Whether to leave out x < 0.
        limit: Largest size of the graded mesh over h, greater than 1.

    Returns:
        The mesh, its cell tags and its facet tags.

    Raises:
        ValueError: If an argument is out of range (on all ranks).
        RuntimeError: If gmsh is missing or fails (on all ranks).
    """
    given = {"kind": kind, "cell": cell, "h": h, "radius": radius, "block": block, "gap": gap}
    given["limit"] = limit
    sizes, radius, block, gap, limit = check_on_all_ranks(comm, _check, **given)
    graded = [(size, limit) if kind == "graded" else None for size in sizes]

    def create() -> tuple[Arrays, Arrays]:
        whole = _on_axis if half else _mirror
        return (
            whole(*_half_block(block, graded[0], cell)),
            whole(*_half_disc(radius, gap, graded[1], cell)),
        )

    mesh, first = distribute(comm, create, cell)
    mesh.name = "hertz"
    in_block = mesh.topology.original_cell_index < first
    values = np.where(in_block, BLOCK, DISC).astype(np.int32)
    cell_tags = dmesh.meshtags(mesh, 2, np.arange(len(values), dtype=np.int32), values)
    cell_tags.name = "bodies"
    facet_tags = _tag_boundary(mesh, in_block, thickness=block[1], radius=radius, gap=gap)
    facet_tags.name = "boundary"
    return HertzMesh(mesh, Tags(cell_tags, BODIES), Tags(facet_tags, SIDES))


def _check(
    *, kind: Any, cell: Any, h: Any, radius: Any, block: Any, gap: Any, limit: Any
) -> tuple[tuple[float, ...], float, tuple[float, float], float, float]:
    """Return sizes (block, disc), radius, block, gap, limit as numbers, or raise a ValueError."""
    choose("kind", kind, ("paper", "graded"))
    choose("cell", cell, ("triangle", "quadrilateral"))
    sizes = positive("h", h, "block, disc", one=True)
    (R,) = positive("radius", radius, "of the disc")
    width, thickness = positive("block", block, "width, thickness")
    if kind == "graded" and max(sizes) > R / 2:
        raise ValueError(f"h = {h!r} must be at most half the radius, {R / 2:g}.")
    largest = finite("limit", limit, "use 10 for the largest size over h")
    if not largest > 1.0:
        raise ValueError(f"limit = {limit!r} must be greater than 1, the largest size over h.")
    return sizes, R, (width, thickness), check_gap(gap, R, thickness), largest


def _half_block(block: tuple[float, float], graded: Graded, cell: str) -> Arrays:
    """Mesh [0, w/2] x [-t, 0]."""

    def draw(geo: Any) -> int:
        w, t = 0.5 * block[0], block[1]
        p = [geo.addPoint(x, y, 0.0) for x, y in ((0, 0), (0, -t), (w, -t), (w, 0))]
        lines = [geo.addLine(p[i], p[(i + 1) % 4]) for i in range(4)]
        surface = geo.addPlaneSurface([geo.addCurveLoop(lines)])
        if graded is None:
            nx, ny = PAPER_DIVISIONS
            for line, n in zip(lines, (ny, nx, ny, nx), strict=True):
                geo.mesh.setTransfiniteCurve(line, n + 1)
            geo.mesh.setTransfiniteSurface(surface)
        return p[0]

    return _mesh_half(draw, graded, block[1], cell)


def _half_disc(radius: float, gap: float, graded: Graded, cell: str) -> Arrays:
    """Mesh the quarter disc x >= 0."""

    def draw(geo: Any) -> int:
        p = [geo.addPoint(x, y + gap, 0.0) for x, y in ((0, 0), (radius, radius), (0, radius))]
        arc = geo.addCircleArc(p[0], p[2], p[1])
        lines = [arc, geo.addLine(p[1], p[2]), geo.addLine(p[2], p[0])]
        geo.addPlaneSurface([geo.addCurveLoop(lines)])
        return p[0]

    return _mesh_half(draw, graded, PAPER_DISC_SIZE * radius, cell)


def _mesh_half(draw: Callable[[Any], int], graded: Graded, uniform: float, cell: str) -> Arrays:
    """Mesh one plane surface; sizes are graded from the point that ``draw`` returns, or uniform."""
    with gmsh_model() as gmsh:
        origin = draw(gmsh.model.geo)
        gmsh.model.geo.synchronize()
        if graded is None:
            gmsh.option.setNumber("Mesh.MeshSizeMin", uniform)
            gmsh.option.setNumber("Mesh.MeshSizeMax", uniform)
        else:
            h, limit = graded
            set_graded_size(gmsh, origin, h, core=GRADED_CORE, limit=limit, beyond=limit - 1.0)
        # 6 = frontal Delaunay; 8 and 3 = its variant and blossom-full-quad recombination
        gmsh.option.setNumber("Mesh.Algorithm", 6 if cell == "triangle" else 8)
        gmsh.option.setNumber("Mesh.RecombineAll", int(cell == "quadrilateral"))
        gmsh.option.setNumber("Mesh.RecombinationAlgorithm", 3)
        gmsh.model.mesh.generate(2)
        x, cells = read_cells(gmsh, cell)
    return x[:, :2], cells


def _on_axis(x: Floats, cells: Longs) -> Arrays:
    """Put nodes that are on x = 0 up to round-off there."""
    near = np.abs(x[:, 0]) < 1e-10 * np.ptp(x[:, 0])
    return np.where(near[:, None], [[0.0, 1.0]], [[1.0, 1.0]]) * x, cells


def _mirror(x: Floats, cells: Longs) -> Arrays:
    """Add the mirror image in x = 0, whose nodes are shared.

    >>> x = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    >>> nodes, cells = _mirror(x, np.array([[0, 1, 2]]))
    >>> nodes[:, 0].tolist(), cells.tolist()
    ([0.0, 1.0, 0.0, -1.0], [[0, 1, 2], [3, 0, 2]])
    """
    x, cells = _on_axis(x, cells)
    on_axis = x[:, 0] == 0.0
    image = np.arange(len(x))
    image[~on_axis] = len(x) + np.arange(np.count_nonzero(~on_axis))
    # the image of a cell has the two nodes of each edge along x the other way round
    flip = [1, 0, 2] if cells.shape[1] == 3 else [1, 0, 3, 2]
    return (
        np.concatenate([x, x[~on_axis] * [-1.0, 1.0]]),
        np.concatenate([cells, image[cells][:, flip]]),
    )


def _tag_boundary(
    mesh: dmesh.Mesh, in_block: Bools, *, thickness: float, radius: float, gap: float
) -> dmesh.MeshTags:
    """Tag the outer facets of both bodies from the body they belong to and their height."""
    facets, block_side, x = exterior_facets(mesh, in_block)
    # on the scale of the body itself: the other one and the gap may be of any size
    tolerance = ON_PLANE * np.where(block_side, thickness, radius)

    def at(height: float) -> Bools:
        return np.abs(x[:, :, 1] - height).max(axis=1, initial=0.0) < tolerance

    values = np.zeros(len(facets), dtype=np.int32)
    values[block_side & at(-thickness)] = BOTTOM
    values[block_side & at(0.0)] = TOP
    values[~block_side] = ARC
    values[~block_side & at(radius + gap)] = FLAT
    values[(x[:, :, 0] == 0.0).all(axis=1)] = AXIS  # exterior in the half only
    tagged = values > 0
    return dmesh.meshtags(mesh, 1, facets[tagged], values[tagged])

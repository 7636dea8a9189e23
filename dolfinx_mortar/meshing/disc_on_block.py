# SPDX-License-Identifier: MIT
"""A half disc on a block, by gmsh on one rank, then distributed.

The bodies are two disconnected parts of one mesh. Each is symmetric and meshed as its right half,
which is then mirrored, so that the mesh has the symmetry of the problem; and in a gmsh model of its
own, so that no node is shared where the bodies touch.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx_mortar.agreement import check_same_on_all_ranks
from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.arguments import is_name, is_number
from dolfinx_mortar.arrays import Bools, Floats, Longs
from dolfinx_mortar.meshing.two_bodies import (
    ON_PLANE,
    Arrays,
    TaggedMesh,
    check_gap,
    distribute,
    exterior_facets,
    gmsh_model,
    name_parts,
    positive,
    read_cells,
    set_graded_size,
)

PAPER_DIVISIONS = (34, 20)  # half block: 34 x 20 rectangles, 2720 triangles in the whole block
PAPER_DISC_SIZE = 0.45 / 8.0  # element size over radius that gives about 1200 triangles
Graded = tuple[float, float] | None  # size at the contact point, largest one over it
GRADED_CORE = 2.5  # mm, distance from the contact point within which the size is h


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
) -> TaggedMesh:
    """Mesh a half disc above a block, non-matching where they touch (collective).

    The block is [-w/2, w/2] x [-t, 0] with (w, t) = ``block``. The disc has its lowest point at
    (0, ``gap``) and its flat face on top at y = ``radius + gap``. The mesh is symmetric in x and
    (0, 0), (0, ``gap``) are nodes. Bodies: "block", "disc". Sides: "bottom" and "top" of the block,
    "flat" and "arc" of the disc, and "axis", which is x = 0 in the half.

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
        half: Whether to leave out x < 0; the rest is also the section of a ball on a round plate.
        limit: Largest size of the graded mesh over h, greater than 1.

    Raises:
        ValueError: if an argument is out of range, or not the same on all ranks.
        RuntimeError: if gmsh is missing or fails. All errors are raised on all ranks.
    """
    given: dict[str, Any] = {
        "kind": kind,
        "cell": cell,
        "h": h,
        "radius": radius,
        "block": block,
        "gap": gap,
    }
    with raised_together(comm):
        sizes = _check(**given, limit=limit)
    check_same_on_all_ranks(comm, **given, limit=limit, half=half)
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
    facets, block_side, x = exterior_facets(mesh, in_block)
    # on the scale of the body itself: the other one and the gap may be of any size
    tolerance = ON_PLANE * np.where(block_side, block[1], radius)

    def at(height: float) -> Bools:
        return np.abs(x[:, :, 1] - height).max(axis=1, initial=0.0) < tolerance

    flat = ~block_side & at(radius + gap)
    sides = {
        "bottom": block_side & at(-block[1]),
        "flat": flat,
        "top": block_side & at(0.0),
        "arc": ~block_side & ~flat,
        "axis": (x[:, :, 0] == 0.0).all(axis=1),  # exterior in the half only
    }
    return name_parts(mesh, in_block, ("block", "disc"), facets, sides)


def _check(
    *,
    kind: str,
    cell: str,
    h: Any,
    radius: float,
    block: tuple[float, float],
    gap: float,
    limit: float,
) -> tuple[float, ...]:
    """Return the sizes of block and disc, or raise a ValueError."""
    for name, value, known in (
        ("kind", kind, ("paper", "graded")),
        ("cell", cell, ("triangle", "quadrilateral")),
    ):
        if not is_name(value, known):
            raise ValueError(f"{name} = {value!r} is not known; use one of {known}.")
    sizes = positive("h", h, "block, disc", one=True)
    positive("radius", radius, "of the disc")
    positive("block", block, "width, thickness")
    if kind == "graded" and max(sizes) > radius / 2:
        raise ValueError(f"h = {h!r} must be at most half the radius, {radius / 2:g}.")
    if not (is_number(limit) and limit > 1.0):
        raise ValueError(f"limit = {limit!r} must be greater than 1, the largest size over h.")
    check_gap(gap, min(radius, block[1]))
    return sizes


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

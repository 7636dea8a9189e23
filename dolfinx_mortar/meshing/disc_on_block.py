# SPDX-License-Identifier: MIT
"""A half disc on a block, by gmsh on one rank, then distributed.

The bodies are two disconnected parts of one mesh. Each is symmetric and meshed as its right half,
which is then mirrored, so that the mesh has the symmetry of the problem; and in a gmsh model of its
own, so that no node is shared where the bodies touch.
"""

from collections.abc import Callable
from typing import Any

from mpi4py import MPI

from dolfinx_mortar.agreement import check_same_on_all_ranks
from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.arguments import POSITIVE, check, number, one_of
from dolfinx_mortar.meshing.two_bodies import (
    Arrays,
    TaggedMesh,
    check_sizes,
    distribute,
    gmsh_model,
    mirrored,
    name_sides,
    on_axis,
    read_cells,
    set_graded_size,
)

PAPER_DIVISIONS = (34, 20)  # half block: 34 x 20 rectangles, 2720 triangles in the whole block
PAPER_DISC_SIZE = 0.45 / 8.0  # element size over radius that gives about 1200 triangles
# size at the contact point, largest one over it, distance within which it is the first
Graded = tuple[float, float, float] | None


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
    core: float = 2.5,
) -> TaggedMesh:
    """Mesh a half disc above a block, non-matching where they touch (collective).

    The block is [-w/2, w/2] x [-t, 0] with (w, t) = ``block``. The disc has its lowest point at
    (0, ``gap``) and its flat face on top at y = ``radius + gap``. The mesh is symmetric in x and
    (0, 0), (0, ``gap``) are nodes. Bodies: "block", "disc". Sides: "bottom" and "top" of the block,
    "flat" and "arc" of the disc, and "axis", which is x = 0 in the half.

    Args:
        comm: Communicator of the mesh; gmsh runs on its rank 0 only.
        kind: "paper": about 1200 cells in the disc and 2720 in the block (as triangles, for any
            ``radius`` and ``block``); "graded": element size ``h`` within ``core`` of the first
            contact point and h (1 + r - core), at most ``limit`` h, at distance r mm.
        h: Element size of the graded mesh [mm]; a pair gives (block, disc) separately.
        radius: Radius of the disc [mm].
        block: Width and thickness of the block [mm].
        gap: Initial vertical gap between the bodies [mm]; negative for an overlap.
        cell: "triangle" or "quadrilateral".
        half: Whether to leave out x < 0; the rest is also the section of a ball on a round plate.
        limit: Largest size of the graded mesh over h, greater than 1.
        core: Where the graded mesh begins to coarsen [mm].

    Raises:
        ValueError: if an argument is out of range, or not the same on all ranks.
        RuntimeError: if gmsh is missing or fails. All errors are raised on all ranks.
    """
    with raised_together(comm):
        check("kind", kind, one_of("paper", "graded"))
        check("cell", cell, one_of("triangle", "quadrilateral"))
        sizes = check_sizes(h, radius, block, gap, "width, thickness")
        if kind == "graded" and max(sizes) > radius / 2:
            raise ValueError(f"h is {h!r}: give at most half of the radius, {radius / 2:g}")
        check("limit", limit, number("the largest size over h,", above=1.0))
        check("core", core, POSITIVE)
    same = {"kind": kind, "cell": cell, "h": h, "radius": radius, "block": block, "gap": gap}
    check_same_on_all_ranks(comm, **same, limit=limit, core=core, half=half)
    graded = [(size, limit, core) if kind == "graded" else None for size in sizes]

    def create() -> tuple[Arrays, Arrays]:
        x1, cells1 = _half_block(block, graded[0], cell)
        x2, cells2 = _half_disc(radius, gap, graded[1], cell)
        if half:
            return (on_axis(x1), cells1), (on_axis(x2), cells2)
        return mirrored(x1, cells1), mirrored(x2, cells2)

    mesh, first = distribute(comm, create, cell)
    mesh.name = "hertz"
    of = {"thickness": block[1], "radius": radius, "gap": gap}
    return name_sides(mesh, first, **of, names=("disc", "arc"), planes=("axis",))


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
            h, limit, core = graded
            set_graded_size(gmsh, origin, h, core=core, limit=limit, beyond=limit - 1.0)
        # 6 = frontal Delaunay; 8 and 3 = its variant and blossom-full-quad recombination
        gmsh.option.setNumber("Mesh.Algorithm", 6 if cell == "triangle" else 8)
        gmsh.option.setNumber("Mesh.RecombineAll", int(cell == "quadrilateral"))
        gmsh.option.setNumber("Mesh.RecombinationAlgorithm", 3)
        gmsh.model.mesh.generate(2)
        x, cells = read_cells(gmsh, cell)
    return x[:, :2], cells

# SPDX-License-Identifier: MIT
"""A quarter of a half ball on a block, graded towards the first contact point.

Hexahedra are mapped: around the contact point, the block is a cube in shells that end at its sides.
The half ball is the image of such a half ball of twice the radius under the inversion in the sphere
of radius 2R around its highest point's mirror image (0, 0, 2R): it takes the plane z = 0 to the
ball's surface and the sphere of radius 2R to the flat face, and as it is conformal, well-shaped
cells stay so. Tetrahedra come from gmsh.
"""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx_mortar.agreement import check_same_on_all_ranks
from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.arguments import is_name
from dolfinx_mortar.arrays import Bools, Floats, Longs
from dolfinx_mortar.meshing.graded_octant import graded_octant
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

CORE = 0.125  # radius of the finest part over the radius of the ball
HXT = 10  # gmsh's number of its fast Delaunay algorithm


def sphere(
    comm: MPI.Intracomm,
    *,
    cell: str = "hexahedron",
    h: float | tuple[float, float] = 0.125,
    radius: float = 8.0,
    block: tuple[float, float, float] = (30.0, 30.0, 10.0),
    gap: float = 0.0,
    core: float | None = None,
    half: bool = False,
) -> TaggedMesh:
    """Mesh a quarter of a half ball above a block, non-matching where they touch (collective).

    The whole block is [-w/2, w/2] x [-l/2, l/2] x [-t, 0] with (w, l, t) = ``block``. The half ball
    has its lowest point at (0, 0, ``gap``) and its flat face on top at z = ``radius + gap``. The
    quarter x, y >= 0 of both is meshed; (0, 0, 0) and (0, 0, ``gap``) are nodes. Bodies: "block",
    "ball". Sides: "bottom" and "top" of the block, "flat" and "sphere" of the ball, "symmetry_x"
    and "symmetry_y", on x = 0 and y = 0.

    Args:
        comm: Communicator of the mesh; it is created on rank 0 and distributed.
        cell: "hexahedron" or "tetrahedron" (which needs gmsh).
        h: Element size at the first contact point [mm]; a pair gives (block, ball) separately. The
            ball's hexahedra are one more along the edge of the core, so that they do not match.
        radius: Radius of the ball [mm].
        block: Width, length and thickness of the whole block [mm].
        gap: Initial vertical gap between the bodies [mm]; negative for an overlap.
        core: Distance from the contact point within which the size is ``h`` [mm], by default an
            eighth of the radius; beyond, sizes grow in proportion to the distance.
        half: Whether to mesh the half y >= 0 of both instead, for loads along x; the part x < 0 is
            the mirror image of the quarter, and nothing is "symmetry_x" then.

    Raises:
        ValueError: if an argument is out of range, or not the same on all ranks.
        RuntimeError: if gmsh is missing or fails. All errors are raised on all ranks.
    """
    given: dict[str, Any] = {
        "cell": cell,
        "h": h,
        "radius": radius,
        "block": block,
        "gap": gap,
        "core": core,
    }
    with raised_together(comm):
        sizes, core = _check(**given)
    check_same_on_all_ranks(comm, **given, half=half)
    corner = np.array([block[0] / 2, block[1] / 2, block[2]])

    def create() -> tuple[Arrays, Arrays]:
        if cell == "hexahedron":
            bodies = (
                _block_of_hexahedra(corner, core, sizes[0]),
                _ball_of_hexahedra(radius, gap, core, sizes[1]),
            )
        else:
            bodies = (
                _block_of_tetrahedra(corner, core, sizes[0]),
                _ball_of_tetrahedra(radius, gap, core, sizes[1]),
            )
        return (_mirrored(*bodies[0]), _mirrored(*bodies[1])) if half else bodies

    mesh, first = distribute(comm, create, cell)
    mesh.name = "sphere"
    in_block = mesh.topology.original_cell_index < first
    facets, block_side, x = exterior_facets(mesh, in_block)
    # on the scale of the body itself: the other one and the gap may be of any size
    tolerance = ON_PLANE * np.where(block_side, block[2], radius)

    def at(axis: int, position: float) -> Bools:
        return np.abs(x[:, :, axis] - position).max(axis=1, initial=0.0) < tolerance

    flat = ~block_side & at(2, radius + gap)
    sides = {
        "bottom": block_side & at(2, -block[2]),
        "flat": flat,
        "top": block_side & at(2, 0.0),
        "sphere": ~block_side & ~flat,
        "symmetry_x": at(0, 0.0),  # exterior in the quarter only
        "symmetry_y": at(1, 0.0),
    }
    return name_parts(mesh, in_block, ("block", "ball"), facets, sides)


def _check(
    *, cell: str, h: Any, radius: float, block: tuple[float, ...], gap: float, core: float | None
) -> tuple[tuple[float, ...], float]:
    """Return the sizes of block and ball, and the core, or raise a ValueError."""
    if not is_name(cell, ("hexahedron", "tetrahedron")):
        raise ValueError(f"cell = {cell!r} is not known; use 'hexahedron' or 'tetrahedron'.")
    sizes = positive("h", h, "block, ball", one=True)
    positive("radius", radius, "of the ball")
    width, length, thickness = positive("block", block, "width, length, thickness")
    check_gap(gap, min(radius, thickness))
    (inner,) = positive("core", CORE * radius if core is None else core, "of the finest part")
    largest = 0.5 * min(radius, width / 2, length / 2, thickness)
    if max(sizes) > inner:
        raise ValueError(
            f"h = {h!r} must be at most {inner:g}, the core: by default an eighth of the radius."
        )
    if inner > largest:
        raise ValueError(
            f"core = {inner!r} must be at most {largest:g}, half of what the radius and the block "
            "leave."
        )
    return sizes, inner


def _block_of_hexahedra(corner: Floats, core: float, h: float) -> Arrays:
    n = int(np.ceil(core / h - 1e-9))
    x, cells = graded_octant(core, n, float(np.cbrt(corner.prod())), lambda p: p * corner)
    return x * [1.0, 1.0, -1.0] + 0.0, cells


def _ball_of_hexahedra(radius: float, gap: float, core: float, h: float) -> Arrays:
    n = int(np.ceil(core / h - 1e-9)) + 1

    def outer(p: Floats) -> Floats:
        # equal angles; on a far face the largest coordinate is 1
        angles = np.tan(0.25 * np.pi * p)
        return 2.0 * radius * angles / np.linalg.norm(angles, axis=1, keepdims=True)

    x, cells = graded_octant(core, n, 2.0 * radius, outer)
    # inversion of the lower half space around (0, 0, 2R)
    arm = x * [1.0, 1.0, -1.0] - [0.0, 0.0, 2.0 * radius]
    x = (2.0 * radius) ** 2 * arm / (arm**2).sum(axis=1, keepdims=True) + [0, 0, 2.0 * radius + gap]
    return x, cells


def _block_of_tetrahedra(corner: Floats, core: float, h: float) -> Arrays:
    with gmsh_model() as gmsh:
        w, b, t = corner
        gmsh.model.occ.addBox(0, 0, -t, w, b, t)
        return _tetrahedra(gmsh, (0.0, 0.0, 0.0), core, h, float(np.linalg.norm(corner)))


def _ball_of_tetrahedra(radius: float, gap: float, core: float, h: float) -> Arrays:
    with gmsh_model() as gmsh:
        occ = gmsh.model.occ
        part = [(3, occ.addSphere(0, 0, 0, radius, -1, 0.0, np.pi / 2, np.pi / 2))]
        # the pole of the parametrisation goes to the rim, away from the contact
        occ.rotate(part, 0, 0, 0, 0, 1, 0, np.pi / 2)
        occ.translate(part, 0, 0, radius + gap)
        return _tetrahedra(gmsh, (0.0, 0.0, gap), core, h, 2.0 * radius)


def _tetrahedra(
    gmsh: Any, contact: tuple[float, float, float], core: float, h: float, far: float
) -> Arrays:
    """Mesh the model; sizes grow from h at the contact point to h far / core at distance far."""
    gmsh.model.occ.synchronize()
    points = np.array([gmsh.model.getValue(0, tag, []) for _, tag in gmsh.model.getEntities(0)])
    nearest = int(np.linalg.norm(points - contact, axis=1).argmin())
    origin = gmsh.model.getEntities(0)[nearest][1]
    set_graded_size(gmsh, origin, h, core=core, limit=far / core, beyond=far - core)
    gmsh.option.setNumber("Mesh.Algorithm3D", HXT)
    gmsh.model.mesh.generate(3)
    return read_cells(gmsh, "tetrahedron")


def _mirrored(x: Floats, cells: Longs) -> Arrays:
    """Add the mirror image in x = 0, whose nodes are shared.

    >>> nodes, cells = _mirrored(np.eye(4, 3), np.array([[0, 1, 2, 3]]))
    >>> nodes[:, 0].tolist(), cells.tolist()
    ([1.0, 0.0, 0.0, 0.0, -1.0], [[0, 1, 2, 3], [1, 4, 2, 3]])
    """
    near = np.abs(x[:, 0]) < ON_PLANE * np.ptp(x[:, 0])
    x = np.where(near[:, None], [[0.0, 1.0, 1.0]], [[1.0, 1.0, 1.0]]) * x
    image = np.arange(len(x))
    image[~near] = len(x) + np.arange(np.count_nonzero(~near))
    # an image is turned inside out; other orders of its nodes turn it back
    turn = [1, 0, 2, 3] if cells.shape[1] == 4 else [4, 5, 6, 7, 0, 1, 2, 3]
    return (
        np.concatenate([x, x[~near] * [-1.0, 1.0, 1.0]]),
        np.concatenate([cells, image[cells][:, turn]]),
    )

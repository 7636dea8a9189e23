# SPDX-License-Identifier: MIT
"""A quarter of the half ball on a block, graded towards the first contact point.

Hexahedra are mapped: around the contact point, the block is a cube in shells that end at its sides.
The half ball is the image of such a half ball of twice the radius under the inversion in the sphere
of radius 2R around its highest point's mirror image (0, 0, 2R): it takes the plane z = 0 to the
ball's surface and the sphere of radius 2R to the flat face, and as it is conformal, well-shaped
cells stay so. Tetrahedra come from gmsh.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from mpi4py import MPI

import numpy as np

from dolfinx import mesh as dmesh
from dolfinx_mortar.arrays import Bools, Floats, Longs
from dolfinx_mortar.meshing.arguments import check_gap, check_on_all_ranks, choose, positive
from dolfinx_mortar.meshing.bodies import (
    ON_PLANE,
    Arrays,
    distribute,
    exterior_facets,
    gmsh_model,
    read_cells,
    set_graded_size,
)
from dolfinx_mortar.meshing.hexahedra import graded_octant
from dolfinx_mortar.tags import Tags

BLOCK, BALL = 1, 2  # cell tags
BOTTOM, FLAT, TOP, SPHERE, SYMMETRY_X, SYMMETRY_Y = 1, 2, 3, 4, 5, 6  # facet tags
BODIES = {"block": BLOCK, "ball": BALL}
SIDES = {
    "bottom": BOTTOM,
    "flat": FLAT,
    "top": TOP,
    "sphere": SPHERE,
    "symmetry_x": SYMMETRY_X,
    "symmetry_y": SYMMETRY_Y,
}
CORE = 0.125  # radius of the finest part over the radius of the ball
HXT = 10  # gmsh's number of its fast Delaunay algorithm


class SphereMesh(NamedTuple):
    """Quarter of the half ball on the block, with its tags."""

    mesh: dmesh.Mesh
    cell_tags: Tags  # 1 block, 2 ball
    facet_tags: Tags  # 1 bottom, 2 flat face, 3 block top, 4 ball, 5 x = 0, 6 y = 0


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
) -> SphereMesh:
    """Mesh a quarter of a half ball above a block, non-matching where they touch (collective).

    The whole block is [-w/2, w/2] x [-l/2, l/2] x [-t, 0] with (w, l, t) = ``block``. The half ball
    has its lowest point at (0, 0, ``gap``) and its flat face on top at z = ``radius + gap``. The
    quarter x, y >= 0 of both is meshed; (0, 0, 0) and (0, 0, ``gap``) are nodes. Cell tags: 1
    block, 2 ball. Facet tags: 1 bottom of the block, 2 flat face of the ball, 3 top of the block, 4
    round surface of the ball, 5 symmetry plane x = 0, 6 symmetry plane y = 0. Their names are
    "block" and "ball", "bottom", "flat", "top", "sphere", "symmetry_x" and "symmetry_y".

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
            the mirror image of the quarter, and no facet has the tag 5 then.

    Raises:
        ValueError: If an argument is out of range (on all ranks).
        RuntimeError: If gmsh is missing or fails (on all ranks).
    """
    given = {"cell": cell, "h": h, "radius": radius, "block": block, "gap": gap, "core": core}
    sizes, radius, block, gap, core = check_on_all_ranks(comm, _check, **given)
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
    values = np.where(in_block, BLOCK, BALL).astype(np.int32)
    cell_tags = dmesh.meshtags(mesh, 3, np.arange(len(values), dtype=np.int32), values)
    cell_tags.name = "bodies"
    facet_tags = _tag_boundary(mesh, in_block, thickness=block[2], radius=radius, gap=gap)
    facet_tags.name = "boundary"
    return SphereMesh(mesh, Tags(cell_tags, BODIES), Tags(facet_tags, SIDES))


def _check(
    *, cell: Any, h: Any, radius: Any, block: Any, gap: Any, core: Any
) -> tuple[tuple[float, ...], float, tuple[float, float, float], float, float]:
    """Return sizes (block, ball), radius, block, gap and core as numbers, or raise a ValueError."""
    choose("cell", cell, ("hexahedron", "tetrahedron"))
    sizes = positive("h", h, "block, ball", one=True)
    (R,) = positive("radius", radius, "of the ball")
    width, length, thickness = positive("block", block, "width, length, thickness")
    number = check_gap(gap, R, thickness)
    if core is None and max(sizes) > CORE * R:
        raise ValueError(
            f"h = {h!r} must be at most {CORE * R:g}, an eighth of the radius, or give a larger "
            "core."
        )
    (inner,) = positive("core", CORE * R if core is None else core, "of the finest part")
    largest = 0.5 * min(R, width / 2, length / 2, thickness)
    if not max(sizes) <= inner <= largest:
        raise ValueError(
            f"core = {inner!r} must lie between h = {h!r} and {largest:g}, half of what the radius "
            "and the block leave."
        )
    return sizes, R, (width, length, thickness), number, inner


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


def _tag_boundary(
    mesh: dmesh.Mesh, in_block: Bools, *, thickness: float, radius: float, gap: float
) -> dmesh.MeshTags:
    """Tag the outer facets of both bodies from the body they belong to and their planes."""
    facets, block_side, x = exterior_facets(mesh, in_block)
    # on the scale of the body itself: the other one and the gap may be of any size
    tolerance = ON_PLANE * np.where(block_side, thickness, radius)

    def at(axis: int, position: float) -> Bools:
        return np.abs(x[:, :, axis] - position).max(axis=1, initial=0.0) < tolerance

    values = np.zeros(len(facets), dtype=np.int32)
    values[~block_side] = SPHERE
    values[block_side & at(2, -thickness)] = BOTTOM
    values[block_side & at(2, 0.0)] = TOP
    values[~block_side & at(2, radius + gap)] = FLAT
    values[at(0, 0.0)] = SYMMETRY_X  # exterior in the quarter only
    values[at(1, 0.0)] = SYMMETRY_Y
    tagged = values > 0
    return dmesh.meshtags(mesh, 2, facets[tagged], values[tagged])

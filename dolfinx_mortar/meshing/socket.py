# SPDX-License-Identifier: MIT
"""A quarter of a ball in a socket that is a little larger: sides that fit closely.

Hexahedra are mapped from cubes in shells: a cube in the middle of the ball, and shells that become
spheres towards the surface; around it shells that end at the sides of the block. Tetrahedra come
from gmsh.
"""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx import mesh as dmesh
from dolfinx_mortar.arrays import Bools, Floats
from dolfinx_mortar.meshing.arguments import check_on_all_ranks, choose, positive
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
from dolfinx_mortar.meshing.sphere import (
    BALL,
    BLOCK,
    BODIES,
    BOTTOM,
    FLAT,
    SIDES,
    SPHERE,
    SYMMETRY_X,
    SYMMETRY_Y,
    TOP,
    SphereMesh,
)
from dolfinx_mortar.tags import Tags

BLOCK_SIZE = 2.5  # half the edge of the block over the socket's radius
CORE = 0.5  # edge of the cube in the ball, and extent of the finest tetrahedra, over the radius
COARSEST = 4.0  # largest size of the tetrahedra over h


def socket(
    comm: MPI.Intracomm,
    *,
    cell: str = "tetrahedron",
    h: float | tuple[float, float] = 1.0,
    radius: float = 10.0,
    clearance: float = 0.1,
) -> SphereMesh:
    """Mesh a quarter of a half ball in a block with a socket for it (collective).

    The socket is the lower half of a sphere of this ``radius`` around the origin, in the block
    [-2.5 R, 2.5 R]^2 x [-2.5 R, 0]. The lower half of a ball of the radius ``radius - clearance``
    touches it at (0, 0, -R). The quarter x, y >= 0 of both is meshed. Cell tags: 1 block, 2 ball.
    Facet tags: 1 bottom of the block, 2 flat face of the ball, 3 socket, 4 round surface of the
    ball, 5 symmetry plane x = 0, 6 symmetry plane y = 0. Their names are those of `sphere`, but
    "socket" for "top".

    Args:
        comm: Communicator of the mesh; it is created on rank 0 and distributed.
        cell: "hexahedron" or "tetrahedron" (which needs gmsh).
        h: Element size where they touch [mm]; a pair gives (block, ball) separately.
        radius: Radius of the socket [mm].
        clearance: How much smaller that of the ball is [mm].

    Raises:
        ValueError: If an argument is out of range (on all ranks).
        RuntimeError: If gmsh is missing or fails (on all ranks).
    """
    given = {"cell": cell, "h": h, "radius": radius, "clearance": clearance}
    sizes, R, r = check_on_all_ranks(comm, _check, **given)

    def create() -> tuple[Arrays, Arrays]:
        make = (
            (_block_of_hexahedra, _ball_of_hexahedra)
            if cell == "hexahedron"
            else (_block_of_tetrahedra, _ball_of_tetrahedra)
        )
        block, (x, cells) = make[0](R, sizes[0]), make[1](r, sizes[1])
        return block, (x - [0.0, 0.0, R - r], cells)

    mesh, first = distribute(comm, create, cell)
    mesh.name = "socket"
    in_block = mesh.topology.original_cell_index < first
    values = np.where(in_block, BLOCK, BALL).astype(np.int32)
    cell_tags = dmesh.meshtags(mesh, 3, np.arange(len(values), dtype=np.int32), values)
    sides = {"socket" if tag == TOP else name: tag for name, tag in SIDES.items()}
    facet_tags = _tag_boundary(mesh, in_block, R, r)
    return SphereMesh(mesh, Tags(cell_tags, BODIES), Tags(facet_tags, sides))


def _check(
    *, cell: Any, h: Any, radius: Any, clearance: Any
) -> tuple[tuple[float, ...], float, float]:
    """Return sizes (block, ball) and the radii of socket and ball, or raise a ValueError."""
    choose("cell", cell, ("hexahedron", "tetrahedron"))
    sizes = positive("h", h, "block, ball", one=True)
    (R,) = positive("radius", radius, "of the socket")
    (c,) = positive("clearance", clearance, "of the ball")
    if max(sizes) > CORE * R:
        raise ValueError(f"h = {h!r} must be at most {CORE * R:g}, {CORE:g} of the radius.")
    if c > CORE * R:
        raise ValueError(f"clearance = {clearance!r} must be at most {CORE * R:g}, half a radius.")
    return sizes, R, R - c


def _on_sphere(p: Floats) -> Floats:
    """Return points of the unit sphere at equal angles, for points of the unit cube's far faces."""
    angles = np.tan(0.25 * np.pi * p)
    return np.asarray(angles / np.linalg.norm(angles, axis=1, keepdims=True))


def _ball_of_hexahedra(r: float, h: float) -> Arrays:
    n = int(np.ceil(0.5 * np.pi * r / h / 2))
    x, cells = graded_octant(CORE * r, n, r, lambda p: r * _on_sphere(p))
    return x * [1.0, 1.0, -1.0] + 0.0, cells


def _block_of_hexahedra(R: float, h: float) -> Arrays:
    n = int(np.ceil(0.5 * np.pi * R / h / 2))
    x, cells = graded_octant(1.0, n, BLOCK_SIZE, lambda p: BLOCK_SIZE * p)
    used, cells = np.unique(cells[n**3 :], return_inverse=True)  # without the cube
    level = x[used].max(axis=1, keepdims=True)
    p, s = x[used] / level, (level - 1.0) / (BLOCK_SIZE - 1.0)
    x = R * ((1.0 - s) * _on_sphere(p) + s * BLOCK_SIZE * p)
    return x * [1.0, 1.0, -1.0] + 0.0, cells.reshape(-1, 8)


def _octant(gmsh: Any, r: float) -> tuple[int, int]:
    """Add an octant x, y >= 0, z <= 0 of a ball; the pole of its surface is away from contact."""
    part = (3, gmsh.model.occ.addSphere(0, 0, 0, r, -1, 0.0, np.pi / 2, np.pi / 2))
    gmsh.model.occ.rotate([part], 0, 0, 0, 0, 1, 0, np.pi / 2)
    return part


def _ball_of_tetrahedra(r: float, h: float) -> Arrays:
    with gmsh_model() as gmsh:
        _octant(gmsh, r)
        return _tetrahedra(gmsh, r, h)


def _block_of_tetrahedra(R: float, h: float) -> Arrays:
    with gmsh_model() as gmsh:
        edge = BLOCK_SIZE * R
        block = (3, gmsh.model.occ.addBox(0, 0, -edge, edge, edge, edge))
        gmsh.model.occ.cut([block], [_octant(gmsh, R)])
        return _tetrahedra(gmsh, R, h)


def _tetrahedra(gmsh: Any, r: float, h: float) -> Arrays:
    """Mesh the model; sizes grow from h around the point of contact (0, 0, -r)."""
    gmsh.model.occ.synchronize()
    points = np.array([gmsh.model.getValue(0, tag, []) for _, tag in gmsh.model.getEntities(0)])
    nearest = int(np.linalg.norm(points - [0.0, 0.0, -r], axis=1).argmin())
    origin = gmsh.model.getEntities(0)[nearest][1]
    set_graded_size(gmsh, origin, h, core=CORE * r, limit=COARSEST, beyond=BLOCK_SIZE * r)
    gmsh.model.mesh.generate(3)
    return read_cells(gmsh, "tetrahedron")


def _tag_boundary(mesh: dmesh.Mesh, in_block: Bools, R: float, r: float) -> dmesh.MeshTags:
    """Tag the outer facets of both bodies from the body they belong to and their planes."""
    facets, block_side, x = exterior_facets(mesh, in_block)
    tolerance = ON_PLANE * R

    def at(axis: int, position: float) -> Bools:
        return np.abs(x[:, :, axis] - position).max(axis=1, initial=0.0) < tolerance

    from_centre = np.abs(np.linalg.norm(x, axis=2) - R).max(axis=1, initial=0.0)
    values = np.zeros(len(facets), dtype=np.int32)
    values[~block_side] = SPHERE
    values[block_side & (from_centre < tolerance)] = TOP
    values[block_side & at(2, -BLOCK_SIZE * R)] = BOTTOM
    values[~block_side & at(2, r - R)] = FLAT
    values[at(0, 0.0)] = SYMMETRY_X
    values[at(1, 0.0)] = SYMMETRY_Y
    tagged = values > 0
    return dmesh.meshtags(mesh, 2, facets[tagged], values[tagged])

# SPDX-License-Identifier: MIT
"""The mesh of the demo: a quarter of a ball in a slightly larger socket.

Hexahedra: the ball is a cube in the middle and layers around it that become spherical towards the
surface; the block consists of layers from the socket to its plane sides. Tetrahedra are made by
Gmsh.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx_mortar.common.arrays import HALF_OF_DIGITS, Bools, Floats
from dolfinx_mortar.meshing.two_bodies import (
    Arrays,
    TaggedMesh,
    all_at,
    graded_octant,
    mesh_by_gmsh,
    two_bodies,
)

BLOCK_SIZE = 2.5  # half the edge of the block over the socket's radius
CORE = 0.5  # edge of the cube in the ball, and extent of the finest tetrahedra, over the radius
COARSEST = 4.0  # largest size of the tetrahedra over h


def ball_in_socket(
    comm: MPI.Intracomm,
    *,
    cell: str = "tetrahedron",
    h: tuple[float, float] = (1.0, 1.0),
    radius: float = 10.0,
    clearance: float = 0.1,
) -> TaggedMesh:
    """Mesh a quarter of a half ball in a block with a socket for it (collective).

    The socket is the lower half of a sphere of this ``radius`` around the origin, in the block
    [-2.5 R, 2.5 R]^2 x [-2.5 R, 0]. The lower half of a ball of the radius ``radius - clearance``
    touches it at (0, 0, -R). The quarter x, y >= 0 of both is meshed. Bodies: "block", "ball".
    Sides: "bottom" and "socket" of the block, "flat" and "sphere" of the ball, "symmetry_x" and
    "symmetry_y", on x = 0 and y = 0.

    Args:
        comm: Communicator of the mesh; it is created on rank 0 and distributed.
        cell: "hexahedron" or "tetrahedron" (which needs gmsh).
        h: Element sizes of block and ball where they touch [mm], at most half of the radius.
        radius: Radius of the socket [mm].
        clearance: Radius of the socket less that of the ball [mm], at most half of the radius.
    """
    R, r = radius, radius - clearance

    def create() -> tuple[Arrays, Arrays]:
        make = (
            (_block_of_hexahedra, _ball_of_hexahedra)
            if cell == "hexahedron"
            else (_block_of_tetrahedra, _ball_of_tetrahedra)
        )
        block, (x, cells) = make[0](R, h[0]), make[1](r, h[1])
        return block, (x - [0.0, 0.0, R - r], cells)

    def sides(of_block: Bools, x: Floats) -> dict[str, Bools]:
        def at(axis: int, position: float) -> Bools:
            return all_at(x[:, :, axis], position, HALF_OF_DIGITS * R)

        flat = ~of_block & at(2, r - R)
        return {
            "bottom": of_block & at(2, -BLOCK_SIZE * R),
            "flat": flat,
            "socket": of_block & all_at(np.linalg.norm(x, axis=2), R, HALF_OF_DIGITS * R),
            "sphere": ~of_block & ~flat,
            "symmetry_x": at(0, 0.0),
            "symmetry_y": at(1, 0.0),
        }

    return two_bodies(comm, create, cell, "socket", ("block", "ball"), sides)


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
    gmsh.option.setNumber("Mesh.Algorithm3D", 1)  # Delaunay
    part = (3, gmsh.model.occ.addSphere(0, 0, 0, r, -1, 0.0, np.pi / 2, np.pi / 2))
    gmsh.model.occ.rotate([part], 0, 0, 0, 0, 1, 0, np.pi / 2)
    return part


def _ball_of_tetrahedra(r: float, h: float) -> Arrays:
    return _tetrahedra(lambda gmsh: _octant(gmsh, r), r, h)


def _block_of_tetrahedra(R: float, h: float) -> Arrays:
    def draw(gmsh: Any) -> None:
        edge = BLOCK_SIZE * R
        block = (3, gmsh.model.occ.addBox(0, 0, -edge, edge, edge, edge))
        gmsh.model.occ.cut([block], [_octant(gmsh, R)])

    return _tetrahedra(draw, R, h)


def _tetrahedra(draw: Callable[[Any], Any], r: float, h: float) -> Arrays:
    """Mesh a drawing; sizes grow from h around the point of contact (0, 0, -r)."""
    ends = CORE * r, (CORE + BLOCK_SIZE) * r
    return mesh_by_gmsh(draw, "tetrahedron", (0.0, 0.0, -r), (h, COARSEST * h), ends)

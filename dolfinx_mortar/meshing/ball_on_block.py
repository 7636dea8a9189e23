# SPDX-License-Identifier: MIT
"""A quarter of a half ball on a block, graded towards the first contact point.

Hexahedra are mapped: around the contact point, the block is a cube in shells that end at its sides.
The half ball is the image of such a half ball of twice the radius under the inversion in the sphere
of radius 2R around its highest point's mirror image (0, 0, 2R): it takes the plane z = 0 to the
ball's surface and the sphere of radius 2R to the flat face, and as it is conformal, well-shaped
cells stay so. Tetrahedra come from gmsh.
"""

from collections.abc import Callable
from itertools import pairwise
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx_mortar.agreement import check_same_on_all_ranks
from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.arguments import check, number, one_of
from dolfinx_mortar.arrays import Floats, Longs
from dolfinx_mortar.meshing.two_bodies import (
    Arrays,
    TaggedMesh,
    check_sizes,
    distribute,
    gmsh_model,
    mirrored,
    name_sides,
    read_cells,
    set_graded_size,
)


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
    with raised_together(comm):
        check("cell", cell, one_of("hexahedron", "tetrahedron"))
        sizes = check_sizes(h, radius, block, gap, "width, length, thickness")
        inner = _check_core(core, sizes, radius, block)
    same = {"cell": cell, "h": h, "radius": radius, "block": block, "gap": gap, "core": core}
    check_same_on_all_ranks(comm, **same, half=half)
    corner = np.array([block[0] / 2, block[1] / 2, block[2]])

    def create() -> tuple[Arrays, Arrays]:
        of_hexahedra = cell == "hexahedron"
        of_block = _block_of_hexahedra if of_hexahedra else _block_of_tetrahedra
        of_ball = _ball_of_hexahedra if of_hexahedra else _ball_of_tetrahedra
        bodies = of_block(corner, inner, sizes[0]), of_ball(radius, gap, inner, sizes[1])
        return (mirrored(*bodies[0]), mirrored(*bodies[1])) if half else bodies

    mesh, first = distribute(comm, create, cell)
    mesh.name = "sphere"
    of = {"thickness": block[2], "radius": radius, "gap": gap}
    planes = ("symmetry_x", "symmetry_y")  # the first is no side of the half
    return name_sides(mesh, first, **of, names=("ball", "sphere"), planes=planes)


def _check_core(core: Any, sizes: tuple[float, ...], radius: float, block: Any) -> float:
    """Return the size of the core, or raise a ValueError."""
    largest = 0.5 * min(radius, block[0] / 2, block[1] / 2, block[2])
    what = "a number, at most half of what the radius and the block leave,"
    wanted = number(what, above=0.0, most=largest)
    inner = check("core", radius / 8 if core is None else core, wanted)
    what = "at most the core, by default an eighth of the radius,"
    check("h", max(sizes), number(what, most=inner))
    return inner


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
    gmsh.option.setNumber("Mesh.Algorithm3D", 10)  # HXT, a fast Delaunay algorithm
    gmsh.model.mesh.generate(3)
    return read_cells(gmsh, "tetrahedron")


def graded_octant(edge: float, n: int, radius: float, outer: Callable[[Floats], Floats]) -> Arrays:
    """Mesh an octant x, y, z >= 0 whose outer boundary can be seen from the origin, by hexahedra.

    The cube at the origin has n^3 equal cells; each shell around it repeats the 3 n^2 facets of its
    three outer faces, a little larger. So cells grow in proportion to their distance from the
    origin, nearly cubes everywhere, about n^3 (1 + 3 log(outer radius / edge)) of them.

    Args:
        edge: edge of the cube.
        n: cells along it.
        radius: typical distance of the outer boundary, which sets the number of shells.
        outer: maps points (p, 3) on the three far faces of the unit cube to the outer boundary;
            points with a zero coordinate must keep it.

    Returns:
        Nodes (p, 3) and cells (m, 8) in the order of dolfinx.

    >>> x, cells = graded_octant(1.0, 2, 2.0, lambda p: 2.0 * p)
    >>> x.shape, cells.shape
    ((46, 3), (20, 8))
    """
    lattice = np.stack(np.meshgrid(*[np.arange(n + 1)] * 3, indexing="ij"), axis=-1)
    lattice = lattice.reshape(-1, 3)
    far = np.flatnonzero(lattice.max(axis=1) == n)  # nodes on the three far faces
    shells = max(1, round(n * np.log(radius / edge)))
    radii = edge * (radius / edge) ** (np.arange(1, shells + 1) / shells)
    s = ((radii - edge) / (radius - edge))[:, None, None]
    inner, boundary = edge * lattice[far] / n, outer(lattice[far] / n)
    x = np.concatenate([edge * lattice / n, ((1.0 - s) * inner + s * boundary).reshape(-1, 3)])
    return x, np.concatenate([_cube_cells(n), _shell_cells(n, far, shells)])


def _cube_cells(n: int) -> Longs:
    """Return the cells (n^3, 8) of the cube's lattice; the last coordinate runs fastest."""
    i, j, k = (a.ravel() for a in np.meshgrid(*[np.arange(n)] * 3, indexing="ij"))
    corners = [(a, b, c) for a in (0, 1) for b in (0, 1) for c in (0, 1)]
    at = [((i + a) * (n + 1) + j + b) * (n + 1) + k + c for a, b, c in corners]
    return np.stack(at, axis=1).astype(np.int64)


def _shell_cells(n: int, far: Longs, shells: int) -> Longs:
    """Return the cells (3 n^2 shells, 8) between the cube and the outer boundary."""
    cube = _cube_cells(n)
    position = np.full((n + 1) ** 3, -1, dtype=np.int64)
    position[far] = np.arange(len(far))
    facets = []
    for axis in range(3):
        on = [corner for corner in range(8) if corner >> (2 - axis) & 1]
        coordinate = cube[:, on] // (n + 1) ** (2 - axis) % (n + 1)
        facets.append(cube[:, on][(coordinate == n).all(axis=1)])
    quads = position[np.concatenate(facets)]
    levels = [far] + [
        (n + 1) ** 3 + len(far) * level + np.arange(len(far)) for level in range(shells)
    ]
    return np.concatenate([np.hstack([low[quads], high[quads]]) for low, high in pairwise(levels)])

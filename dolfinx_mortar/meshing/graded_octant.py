# SPDX-License-Identifier: MIT
"""Hexahedra graded towards a corner: a cube at the corner and shells around it.

The domain is an octant x, y, z >= 0 whose outer boundary can be seen from the origin. The cube at
the origin has n^3 equal cells; each shell repeats the 3 n^2 facets of its three outer faces, a
little larger. So cells grow in proportion to their distance from the origin, nearly cubes
everywhere, about n^3 (1 + 3 log(outer radius / edge of the cube)) of them.
"""

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from dolfinx_mortar.arrays import Floats, Longs
from dolfinx_mortar.meshing.two_bodies import Arrays


def graded_octant(edge: float, n: int, radius: float, outer: Callable[[Floats], Floats]) -> Arrays:
    """Mesh an octant around a cube at the origin.

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

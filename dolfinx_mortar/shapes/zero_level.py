# SPDX-License-Identifier: MIT
"""Zero level of a signed distance in a box."""

from itertools import permutations

import numpy as np

from dolfinx_mortar.common.arrays import LIMIT, ROUND_OFF, TINY, Floats, Longs
from dolfinx_mortar.shapes.shape import Shape

GRID = {2: (64, 500), 3: (16, 5000)}
"""Cells along the longest side of the box at first, and least number near the surface."""


def find_zero_level(shape: Shape, low: Floats, high: Floats) -> tuple[Floats, Longs]:
    """Points (n, d) on the surface of a shape, and lines or triangles (m, d), in a box.

    Edges of simplices of a grid that cross the surface have a point each.

    Example:
        >>> from dolfinx_mortar.shapes import Cylinder
        >>> x, lines = find_zero_level(Cylinder((0.0, 0.0), 1.0), -2.0 * np.ones(2), np.ones(2))
        >>> bool(np.abs(np.linalg.norm(x, axis=1) - 1.0).max() < 1e-14)
        True
    """
    d, size = len(low), float((high - low).max())
    origins, cell = _near_surface(shape, low, high)
    paths = [np.cumsum([0 * row[0], *row], axis=0) for row in permutations(np.eye(d, dtype=int))]
    nodes = (origins[:, None, None] + np.array(paths)).reshape(-1, d)  # of simplices (Kuhn)
    keys = nodes @ (nodes.max(initial=0) + 1) ** np.arange(d)
    _, first, of = np.unique(keys, return_index=True, return_inverse=True)
    x = low + cell * nodes[first]
    phi = shape.values(x)
    edges, cells = _cross(of.reshape(-1, d + 1), phi < 0.0)
    a, b = edges.T
    points = x[a] + (phi[a] / (phi[a] - phi[b]))[:, None] * (x[b] - x[a])
    far: Longs = np.arange(len(points))
    for _ in range(LIMIT):
        found = shape.distance(points[far])
        off = np.abs(found.value) > ROUND_OFF * size
        if not off.any():
            break
        far, phi, slope = far[off], found.value[off], found.gradient[off]
        square = np.maximum((slope**2).sum(axis=1), TINY)
        points[far] -= (phi / square)[:, None] * slope
    return points, cells


def _near_surface(shape: Shape, low: Floats, high: Floats) -> tuple[Longs, Floats]:
    """Indices (n, d) of grid cells near the surface, and their sides (d,)."""
    d, sides = len(low), high - low
    longest, least = GRID[d]
    counts = np.maximum(np.ceil(sides / sides.max() * longest), 1)
    found: Longs = np.indices(counts.astype(int)).reshape(d, -1).T
    cell = sides / counts
    halves = np.indices(d * [2]).reshape(d, -1).T
    for _ in range(14):  # for nodes with integer keys
        middles = low + cell * (found + 0.5)
        found = found[np.abs(shape.values(middles)) <= np.linalg.norm(cell) / 2]
        if not 0 < len(found) < least:
            break
        found, cell = (2 * found[:, None] + halves).reshape(-1, d), cell / 2
    return found, cell


def _cross(simplices: Longs, inside: np.ndarray) -> tuple[Longs, Longs]:
    """Edges (n, 2) crossed by a surface, and lines or triangles (m, d) of these."""
    d = simplices.shape[1] - 1
    of = inside[simplices]
    order = np.argsort(of, axis=1, kind="stable")
    nodes, count = np.take_along_axis(simplices, order, axis=1), of.sum(axis=1)
    parts = []
    for k in range(1, d + 1):
        out, within = range(d + 1 - k), range(d + 1 - k, d + 1)
        ends = [(i, j) for i in out for j in within]
        # two and two nodes: two triangles
        cut = [ends] if len(ends) == d else [ends[:3], ends[1:]]
        parts += [nodes[count == k][:, cell] for cell in cut]
    crossed = np.concatenate(parts)
    low, high = np.sort(crossed, axis=2).reshape(-1, 2).T
    keys, cells = np.unique(low * len(inside) + high, return_inverse=True)
    return np.stack(np.divmod(keys, len(inside)), axis=1), cells.reshape(-1, d).astype(np.int64)

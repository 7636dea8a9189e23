# SPDX-License-Identifier: MIT
"""Zero level of a signed distance in a box."""

from itertools import permutations, product

import numpy as np

from dolfinx_mortar.common.arrays import LIMIT, ROUND_OFF, TINY, Floats, Longs
from dolfinx_mortar.shapes.shape import Shape

GRID = {2: 400, 3: 60}
"""Cells along the longest side of the box."""


def find_zero_level(shape: Shape, low: Floats, high: Floats) -> tuple[Floats, Longs]:
    """Points (n, d) on the surface of a shape, and lines or triangles (m, d), in a box.

    Edges of simplices of a grid that cross the surface have a point each.

    Example:
        >>> from dolfinx_mortar.shapes import Cylinder
        >>> x, lines = find_zero_level(Cylinder((0.0, 0.0), 1.0), -2.0 * np.ones(2), np.ones(2))
        >>> bool(np.abs(np.linalg.norm(x, axis=1) - 1.0).max() < 1e-14)
        True
    """
    low, high = _around(shape, low, high)
    d, size = len(low), float((high - low).max())
    counts = _counts(low, high, GRID[d])
    axes = [np.linspace(a, b, n + 1) for a, b, n in zip(low, high, counts, strict=True)]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, d)
    phi = shape.values(x)
    edges, cells = _cross(_simplices(counts, phi < 0.0), phi < 0.0)
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


def _around(shape: Shape, low: Floats, high: Floats) -> tuple[Floats, Floats]:
    """Corners (d,) of a box around the surface, by a coarse grid."""
    for _ in range(LIMIT):
        counts = _counts(low, high, GRID[len(low)] // 4)
        cell = (high - low) / counts
        axes = [a + c * (np.arange(n) + 0.5) for a, c, n in zip(low, cell, counts, strict=True)]
        every = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(low))
        x = every[np.abs(shape.values(every)) <= np.linalg.norm(cell)]
        if not len(x):
            break
        smaller = x.min(axis=0) - cell / 2, x.max(axis=0) + cell / 2
        done = (smaller[1] - smaller[0]).max() > 0.5 * (high - low).max()
        low, high = smaller
        if done:
            break
    return low, high


def _counts(low: Floats, high: Floats, most: int) -> Longs:
    sides = high - low
    return np.maximum(np.ceil(sides / sides.max() * most), 1).astype(np.int64)


def _simplices(counts: Longs, inside: np.ndarray) -> Longs:
    """Simplices (m, d + 1) of grid cells with nodes on both sides (Kuhn)."""
    d = len(counts)
    steps = np.array([np.prod(counts[i + 1 :] + 1, dtype=np.int64) for i in range(d)])
    first = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1)
    first = first.reshape(-1, d) @ steps
    corners = first[:, None] + np.array(list(product((0, 1), repeat=d))) @ steps
    first = first[inside[corners].any(axis=1) & ~inside[corners].all(axis=1)]
    paths = [np.cumsum([0, *steps[list(order)]]) for order in permutations(range(d))]
    return np.asarray(first[:, None, None] + np.array(paths)).reshape(-1, d + 1)


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

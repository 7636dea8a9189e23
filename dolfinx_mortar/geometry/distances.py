# SPDX-License-Identifier: MIT
"""Distances between flat facets: lines in the plane, triangles in space."""

import numpy as np

from dolfinx_mortar.arrays import EPS, TINY, Bools, Floats
from dolfinx_mortar.geometry.elements import TRI3
from dolfinx_mortar.geometry.facets import Facets, are_inside, facet_normals


def distances(a: Floats, b: Floats) -> Floats:
    """Return the distance (p,) of each facet of a to that of b; 0 where they meet.

    The least of those between edges, in space also between the vertices of one and the face of the
    other; 0 where an edge of one pierces the face of the other (Ericson, Real-Time Collision
    Detection, 2005, sections 5.1.9 and 5.1.10).

    Args:
        a: vertices (p, d, d) of lines or triangles.
        b: those of the others (p, d, d).

    Example:
        >>> a = np.array([[[0.0, 0.0], [1.0, 0.0]]] * 2)
        >>> b = np.array([[[4.0, 4.0], [9.0, 4.0]], [[0.5, -1.0], [0.5, 1.0]]])
        >>> distances(a, b).tolist()
        [5.0, 0.0]
    """
    d = a.shape[2]
    edges = [(k, (k + 1) % d) for k in range(1 if d == 2 else 3)]
    square: Floats = np.full(len(a), np.inf)
    for i, j in edges:
        for k, m in edges:
            square = np.minimum(square, _between_lines(a[:, i], a[:, j], b[:, k], b[:, m]))
    if d > 2:
        for x, y in ((a, b), (b, a)):
            n = facet_normals(Facets(TRI3, y))
            for k in range(3):
                above = np.einsum("pi,pi->p", x[:, k] - y[:, 0], n)
                over = are_inside(y, n, x[:, k])
                square = np.where(over, np.minimum(square, above**2), square)
            for i, j in edges:
                square[_pierce(x[:, i], x[:, j], y, n)] = 0.0
    return np.sqrt(square)


def _between_lines(p: Floats, q: Floats, r: Floats, s: Floats) -> Floats:
    """Return the squared distances (m,) of the lines from p to q and from r to s, (m, d) each."""
    v, w, across = q - p, s - r, p - r
    a, e, b = (np.einsum("mi,mi->m", *of) for of in ((v, v), (w, w), (v, w)))
    c, f = (np.einsum("mi,mi->m", of, across) for of in (v, w))
    found = np.full(len(p), np.inf)
    for point, end, way, length in ((p, r, w, e), (q, r, w, e), (r, p, v, a), (s, p, v, a)):
        share = np.einsum("mi,mi->m", point - end, way) / np.maximum(length, TINY)
        nearest = end + np.clip(share, 0.0, 1.0)[:, None] * way
        found = np.minimum(found, ((point - nearest) ** 2).sum(axis=1))
    angle = a * e - b * b  # of parallel lines an end is as near as any point
    skew = angle > EPS * a * e
    angle = np.where(skew, angle, 1.0)
    t, u = (b * f - c * e) / angle, (a * f - b * c) / angle
    inside = skew & (t >= 0.0) & (t <= 1.0) & (u >= 0.0) & (u <= 1.0)
    apart = across + t[:, None] * v - u[:, None] * w
    return np.where(inside, np.minimum(found, (apart**2).sum(axis=1)), found)


def _pierce(p: Floats, q: Floats, x: Floats, n: Floats) -> Bools:
    """Tell (m,) whether the lines from p to q, (m, 3) each, pierce triangles x with normals n."""
    before, after = (np.einsum("mi,mi->m", end - x[:, 0], n) for end in (p, q))
    crosses = before * after < 0.0
    share = before / np.where(crosses, before - after, 1.0)
    return np.asarray(crosses & are_inside(x, n, p + share[:, None] * (q - p)))


def facet_distances(a: Facets, b: Facets) -> Floats:
    """Return the distances (p,) of facets a (p) and b (p), each flat between its vertices.

    Quadrilaterals count as their two halves.
    """
    found = np.full(len(a.x), np.inf)
    for x in _halves(a):
        for y in _halves(b):
            found = np.minimum(found, distances(x, y))
    return found


def _halves(facets: Facets) -> list[Floats]:
    """Return the lines or triangles (m, d, d) of which facets consist, see `sweep.flat_parts`."""
    x = facets.x[:, np.array(facets.element.vertices)]
    return [x[:, [0, 1, 2]], x[:, [0, 2, 3]]] if facets.element.bilinear else [x]

# SPDX-License-Identifier: MIT
"""Points that pass through facets, and edges through edges, while both move during a step."""

import numpy as np
from scipy.spatial import cKDTree

from dolfinx_mortar.arrays import HALF_OF_DIGITS, Floats, Longs
from dolfinx_mortar.geometry.elements import LINE2, TRI3
from dolfinx_mortar.geometry.facets import Facets, are_inside, facet_normals, facet_sizes


def flat_parts(facets: Facets) -> Floats:
    """Return lines (m, 2, 2) or triangles (m or 2m, 3, 3) between the vertices of facets.

    Example:
        >>> from dolfinx_mortar.geometry.elements import QUAD4
        >>> x = np.array([[[0.0, 0, 5], [2, 0, 5], [2, 1, 5], [0, 1, 5]]])
        >>> flat_parts(Facets(QUAD4, x)).shape
        (2, 3, 3)
    """
    x = facets.x[:, np.array(facets.element.vertices)]
    if not facets.element.bilinear:
        return x
    return np.concatenate([x[:, [0, 1, 2]], x[:, [0, 2, 3]]])


def find_passing(p: tuple[Floats, Floats], x: tuple[Floats, Floats]) -> Longs:
    """Return which points (q,) pass from before a facet to behind it, ascending.

    Points, vertices and distances are taken as linear in time, which they are in the frame of a
    facet that does not rotate.

    Args:
        p: points (n, d) at the start and at the end.
        x: vertices (m, d, d) of lines or triangles at the start and at the end, with outward
            normals as in `area_vectors`.

    Example:
        >>> line = np.array([[[1.0, 0.0], [-1.0, 0.0]]])  # y > 0 is before it
        >>> points = np.array([[0.0, 1], [5, 1], [0, -1]])
        >>> find_passing((points, points * [1, -1]), (line, line)).tolist()
        [0]
        >>> find_passing((points, points * [1, -1]), (line, line - [[0.0, 3]])).tolist()
        []
    """
    if len(p[0]) == 0 or len(x[0]) == 0:
        return np.zeros(0, dtype=np.int64)
    carried = (x[1] - x[0]).mean(axis=(0, 1))  # a common translation does not count
    p, x = (p[0], p[1] - carried), (x[0], x[1] - carried)
    middle = (x[0] + x[1]).mean(axis=1) / 2
    reach = np.linalg.norm(np.stack(x) - middle[:, None], axis=3).max()
    way = np.linalg.norm(p[1] - p[0], axis=1)
    near = cKDTree(middle).query_ball_point(
        (p[0] + p[1]) / 2, way / 2 + reach * (1 + HALF_OF_DIGITS)
    )
    a = np.repeat(np.arange(len(near)), [len(b) for b in near])
    b = np.concatenate([np.array(b, dtype=np.int64) for b in near])
    element = LINE2 if x[0].shape[2] == 2 else TRI3
    normals = [facet_normals(Facets(element, y)) for y in x]
    d0, d1 = (((p[k][a] - x[k][b, 0]) * normals[k][b]).sum(axis=1) for k in (0, 1))
    crossing = (d0 > 0.0) & (d1 <= 0.0)
    a, b = a[crossing], b[crossing]
    t = (d0[crossing] / (d0 - d1)[crossing])[:, None]
    at = p[0][a] + t * (p[1][a] - p[0][a])
    facets = x[0][b] + t[:, None] * (x[1][b] - x[0][b])
    return np.unique(a[are_inside(facets, facet_normals(Facets(element, facets)), at)])


def find_entering(start: Floats, end: Floats, pairs: Longs, share: float) -> Longs:
    """Return which pairs of facets (q,) meet from outside in a step, perhaps more than once.

    A vertex or the middle of the first facet of a pair enters the second one through its outer
    face, and ends behind its plane, wherever that is. Points, vertices and distances are taken as
    linear in time. What passes nearer to the rim of the facet, or ends less deep, than a share of
    it is left out, so that what slides along a face and over its edge does not enter.

    Args:
        start: vertices (m, d, d) of lines or triangles at the start of the step.
        end: those at its end.
        pairs: (p, 2) numbers of facets.
        share: of the size of the second facet.

    Example:
        >>> x = np.array([[[0.5, 2.0], [-0.5, 2.0]], [[1.0, 0.0], [-1.0, 0.0]]])
        >>> moved = x - np.array([[[0.0, 9.0]], [[0.0, 0.0]]])
        >>> sorted({*find_entering(x, moved, np.array([[0, 1]]), 0.05).tolist()})
        [0]
    """
    element = LINE2 if start.shape[2] == 2 else TRI3
    a, b = pairs.T
    x = [(1.0 - share) * y + share * y.mean(axis=1, keepdims=True) for y in (start, end)]
    normals = [facet_normals(Facets(element, y)) for y in (start, end)]
    size, every = facet_sizes(start)[b], np.arange(len(pairs))
    points = [np.concatenate([y, y.mean(axis=1, keepdims=True)], axis=1) for y in (start, end)]
    which = []
    for k in range(points[0].shape[1]):

        def heights(i: int, some: Longs, k: int = k) -> Floats:
            above = points[i][a[some], k] - x[i][b[some], 0]
            return np.asarray(np.einsum("pi,pi->p", above, normals[i][b[some]]))

        d1 = heights(1, every)
        some = np.flatnonzero(d1 < -share * size)  # few: what does not end behind, does not enter
        d0, d1 = heights(0, some), d1[some]
        before = d0 > -HALF_OF_DIGITS * size[some]
        some, d0, d1 = some[before], d0[before], d1[before]
        t = np.maximum(d0 / (d0 - d1), 0.0)[:, None]
        at = (1.0 - t) * points[0][a[some], k] + t * points[1][a[some], k]
        y = (1.0 - t[:, None]) * x[0][b[some]] + t[:, None] * x[1][b[some]]
        which.append(some[are_inside(y, facet_normals(Facets(element, y)), at)])
    return np.concatenate(which)


def find_passing_edges(start: Floats, end: Floats, pairs: Longs, share: float) -> Longs:
    """Return which pairs of edges (q,) pass through each other in a step.

    In the direction across both they are on one side of each other at its start, and on the other
    one at its end, by a share of their lengths; and they meet farther than that from their ends.
    Points are taken as linear in time; edges that touch and turn meet at an end of one of them,
    which distances that are linear in time, too, would miss. Edges that are nearly parallel have no
    direction across.

    Args:
        start: ends (m, 2, 3) of the edges at the start of the step.
        end: those at its end.
        pairs: (p, 2) numbers of edges.
        share: of the length of the shorter edge; also of the sine of the angle between them.

    Example:
        >>> x = np.array([[[-1.0, 0, 1], [1, 0, 1]], [[0, -1.0, 0], [0, 1, 0]]])
        >>> moved = x - np.array([[[0.0, 0, 2]], [[0.0, 0, 0]]])
        >>> find_passing_edges(x, moved, np.array([[0, 1]]), 0.05).tolist()
        [0]
    """

    def distances(x: Floats, pairs: Longs) -> tuple[Floats, Floats]:
        one, other = x[pairs[:, 0]], x[pairs[:, 1]]
        u, v, between = one[:, 1] - one[:, 0], other[:, 1] - other[:, 0], one[:, 0] - other[:, 0]
        squares = [np.einsum("pi,pi->p", y, y) for y in (u, v)]
        across = np.cross(u, v)
        size = np.sqrt(np.einsum("pi,pi->p", across, across))
        apart = np.where(size > share * np.sqrt(squares[0] * squares[1]), size, np.inf)
        return np.einsum("pi,pi->p", between, across) / apart, np.sqrt(np.minimum(*squares))

    d1, length = distances(end, pairs)
    some = np.flatnonzero(np.abs(d1) > share * length)  # few where edges slide in a plane
    d1, length = d1[some], length[some]
    d0, _ = distances(start, pairs[some])
    passes = (d0 * d1 < 0.0) & (np.abs(d0) > HALF_OF_DIGITS * length)
    some, d0 = some[passes], d0[passes]
    low: Floats = np.zeros(len(some))
    high = low + 1.0
    while (high - low > HALF_OF_DIGITS).any():  # halved 26 times
        t = (low + high) / 2
        one, other = _edges_at(start, end, pairs[some], t)
        across = np.cross(one[:, 1] - one[:, 0], other[:, 1] - other[:, 0])
        before = ((one[:, 0] - other[:, 0]) * across).sum(axis=1) * d0 > 0.0
        low, high = np.where(before, t, low), np.where(before, high, t)
    one, other = _edges_at(start, end, pairs[some], high)
    a, b, between = one[:, 1] - one[:, 0], other[:, 1] - other[:, 0], other[:, 0] - one[:, 0]
    across = np.cross(a, b)
    square = (across**2).sum(axis=1)
    at = [(np.cross(between, y) * across).sum(axis=1) / square for y in (b, a)]
    inside = np.logical_and.reduce([(s > share) & (s < 1.0 - share) for s in at])
    return np.asarray(some[inside])


def _edges_at(start: Floats, end: Floats, pairs: Longs, t: Floats) -> tuple[Floats, Floats]:
    """Return both edges (p, 2, 3) of pairs (p, 2) at the times t (p,), on straight paths."""
    s = t[:, None, None]
    one, other = ((1.0 - s) * start[k] + s * end[k] for k in pairs.T)
    return one, other

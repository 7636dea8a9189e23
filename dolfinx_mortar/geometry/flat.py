# SPDX-License-Identifier: MIT
"""Flat facets, lines and triangles: distances, overlaps, passing points, thickness."""

import numpy as np

from dolfinx_mortar.common.arrays import EPS, HALF_OF_DIGITS, TINY, Bools, Floats, Longs
from dolfinx_mortar.geometry.facets import (
    LINE2,
    TRI3,
    Facets,
    are_inside,
    bounding_balls,
    facet_normals,
    facet_sizes,
    unit,
)
from dolfinx_mortar.geometry.segments import Cones, are_facing, as_cones, find_meeting


def distances(a: Floats, b: Floats) -> Floats:
    """Distances (p,) of lines or triangles a and b (p, d, d), 0 where they meet.

    Ericson, Real-Time Collision Detection, 2005, sections 5.1.9 and 5.1.10.

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
    v, w, apart = q - p, s - r, p - r
    every = (v, v), (w, w), (v, w), (v, apart), (w, apart)
    a, e, b, c, f = (np.einsum("mi,mi->m", *of) for of in every)
    a, e = np.maximum(a, TINY), np.maximum(e, TINY)
    angle = a * e - b * b  # 0 for parallel lines
    skew = angle > EPS * a * e
    t = np.where(skew, (b * f - c * e) / np.where(skew, angle, 1.0), 0.0).clip(0.0, 1.0)
    u = ((b * t + f) / e).clip(0.0, 1.0)
    t = ((b * u - c) / a).clip(0.0, 1.0)
    return ((apart + t[:, None] * v - u[:, None] * w) ** 2).sum(axis=1)


def _pierce(p: Floats, q: Floats, x: Floats, n: Floats) -> Bools:
    before, after = (np.einsum("mi,mi->m", end - x[:, 0], n) for end in (p, q))
    crosses = before * after < 0.0
    share = before / np.where(crosses, before - after, 1.0)
    return crosses & are_inside(x, n, p + share[:, None] * (q - p))


def facet_distances(a: Facets, b: Facets) -> Floats:
    """Distances (p,) of facets, flat or two halves between vertices."""
    found = np.full(len(a.x), np.inf)
    for x in _halves(a):
        for y in _halves(b):
            found = np.minimum(found, distances(x, y))
    return found


def _halves(facets: Facets) -> list[Floats]:
    x = facets.x[:, facets.element.vertices]
    return [x[:, [0, 1, 2]], x[:, [0, 2, 3]]] if facets.element.bilinear else [x]


def bounds(x: Floats) -> tuple[Floats, Floats]:
    """Smallest and largest coordinates (m, d) of points (m, k, d).

    Example:
        >>> [end.tolist() for end in bounds(np.array([[[0.0, 3.0], [1.0, 2.0]]]))]
        [[[0.0, 2.0]], [[1.0, 3.0]]]
    """
    return x.min(axis=1), x.max(axis=1)


def near_others(x: Floats, body: Longs, boxes: Floats) -> Bools:
    """Which facets (m,) of bodies meet the box (bodies, 2, d) of another one."""
    low, high = bounds(x)
    near = np.zeros(len(x), dtype=bool)
    for other in range(len(boxes)):
        meets = (low <= boxes[other, 1]) & (high >= boxes[other, 0])
        near |= meets.all(axis=1) & (body != other)
    return near


def find_overlaps(x: Floats, off: Floats, pairs: Longs) -> tuple[Floats, Floats]:
    """Penetrations (p,) of pairs of lines or triangles x (m, d, d), and their places.

    0 if some axis separates them. The shortest translation that parts them, along the normal of one
    out of its body or, in space, along a common normal of two edges, less `off` (m,), the distances
    of surfaces from facets, but not for vertices over the other facet.

    Example:
        >>> line = np.array([[[1.0, 0.0], [-1.0, 0.0]], [[0.5, 3.0], [0.5, -1.0]]])
        >>> depth, place = find_overlaps(line, np.zeros(2), np.array([[0, 1]]))
        >>> depth.tolist(), place.tolist()
        ([0.5], [[1.0, 0.0]])
    """
    d, size, found = x.shape[2], facet_sizes(x), np.zeros((len(pairs), 1 + x.shape[2]))
    n, noise = facet_normals(Facets(LINE2 if d == 2 else TRI3, x)), HALF_OF_DIGITS * size
    some: Longs = np.arange(len(pairs))
    best: Floats = np.full(found.shape, np.inf)  # depth, place
    for k, i, j in [(1, 0, 0), (-1, 0, 0)] + [(0, *ij) for ij in np.ndindex(3, 3)] * (d > 2):
        a, b = pairs[some, :: k or 1].T
        v = n[b] if k else np.cross(x[a, i] - x[a, i - 1], x[b, j] - x[b, j - 1])
        skew = np.linalg.norm(v, axis=1) > noise[a] * noise[b] / HALF_OF_DIGITS
        one, other = (np.einsum("pki,pi->pk", x[facet], unit(v)) for facet in (a, b))
        deep, back = other.max(axis=1) - one.min(axis=1), one.max(axis=1) - other.min(axis=1)
        p, less = (x[a, i] + x[a, i - 1]) / 2, off[a] + off[b]
        if k:  # the height of an arc at r is 4 r / L times its sagitta at most
            p = x[a, one.argmin(axis=1)]
            r = np.linalg.norm(x[b] - p[:, None], axis=2).min(axis=1)
            arc = off[b] * np.minimum(4.0 * r / size[b], 1.0)
            less = np.where(are_inside(x[b], n[b], p), arc, less)
        # facets that touch at their ends may belong to surfaces that cross there
        meet = ~skew | (np.minimum(deep, back) > -noise[a] - noise[b])
        deep = (deep if k else np.minimum(deep, back)) - less
        nearer = skew & (deep < best[:, 0])
        best = np.where(nearer[:, None], np.column_stack([deep, p]), best)
        some, best = some[meet], best[meet]
    found[some] = best
    return found[:, 0].clip(min=0.0), found[:, 1:]


def near_pairs(x: Floats, group: Longs, apart: Bools) -> Longs:
    """Pairs (p, 2) of facets with vertices x (m, k, d) whose boxes meet, each once.

    Of groups (m,) to be compared by `apart` (groups, groups), symmetric.
    """
    balls = bounding_balls(x)
    low, high = bounds(x)
    a, b = find_meeting(as_cones(*balls), *balls).T.astype(np.int64)
    meet = (a < b) & apart[group[a], group[b]]
    a, b = a[meet], b[meet]
    meet = ((low[a] <= high[b]) & (high[a] >= low[b])).all(axis=1)
    return np.stack([a[meet], b[meet]], axis=1)


def flat_parts(facets: Facets) -> Floats:
    """Lines (m, 2, 2) or triangles (m or 2m, 3, 3) between the vertices of facets.

    Example:
        >>> from dolfinx_mortar.geometry.facets import QUAD4
        >>> x = np.array([[[0.0, 0, 5], [2, 0, 5], [2, 1, 5], [0, 1, 5]]])
        >>> flat_parts(Facets(QUAD4, x)).shape
        (2, 3, 3)
    """
    return np.concatenate(_halves(facets))


def find_passing(p: tuple[Floats, Floats], x: tuple[Floats, Floats]) -> Longs:
    """Points (q,) that pass from before a facet to behind it, ascending.

    All is linear in time, from points p (n, d) and outward lines or triangles x (m, d, d) at start
    and end.

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
    carried = (x[1] - x[0]).mean(axis=(0, 1))  # the common translation
    p, x = (p[0], p[1] - carried), (x[0], x[1] - carried)
    ways, parts = (bounding_balls(v) for v in (np.stack(p, axis=1), np.concatenate(x, axis=1)))
    a, b = find_meeting(as_cones(*ways), *parts).T
    element = LINE2 if x[0].shape[2] == 2 else TRI3
    normals = [facet_normals(Facets(element, y)) for y in x]
    d0, d1 = (((p[k][a] - x[k][b, 0]) * normals[k][b]).sum(axis=1) for k in (0, 1))
    crossing = (d0 > 0.0) & (d1 <= 0.0)
    a, b = a[crossing], b[crossing]
    t = (d0[crossing] / (d0 - d1)[crossing])[:, None]
    at = p[0][a] + t * (p[1][a] - p[0][a])
    facets = x[0][b] + t[:, None] * (x[1][b] - x[0][b])
    passing = are_inside(facets, facet_normals(Facets(element, facets)), at)
    return np.unique(a[passing]).astype(np.int64)


def thickness(facets: Facets, others: Facets) -> Floats:
    """Thickness (m,) of the body behind facets, flat between their vertices.

    The distance from the centre, against the normal, to the nearest other facet that faces the
    opposite direction, or inf.

    Example:
        >>> from dolfinx_mortar.geometry.facets import LINE2
        >>> x = np.array([[[0.0, 0], [2, 0]], [[3, 1], [-1, 1]], [[2, 5], [0, 5]]])
        >>> strip = Facets(LINE2, x)
        >>> thickness(strip, strip)
        array([1., 1., 5.])
    """
    corners = facets.element.vertices
    x, y = facets.x[:, corners], others.x[:, corners]
    n, n_other = facet_normals(facets), facet_normals(others)
    size = facet_sizes(x)
    middle = x.mean(axis=1)
    rays = Cones(middle, n, HALF_OF_DIGITS * size, np.zeros(len(x)))
    a, b = find_meeting(rays, *bounding_balls(y)).T
    across = are_facing(n[a][:, None], n_other[b])
    a, b = a[across], b[across]
    along = np.einsum("pi,pi->p", middle[a] - y[b].mean(axis=1), n_other[b])
    depth = along / np.einsum("pi,pi->p", n[a], n_other[b])
    hit = are_inside(y[b], n_other[b], middle[a] - depth[:, None] * n[a])
    hit &= depth > HALF_OF_DIGITS * size[a]  # a crack's other face is in front
    result = np.full(len(x), np.inf)
    np.minimum.at(result, a[hit], depth[hit])
    return result

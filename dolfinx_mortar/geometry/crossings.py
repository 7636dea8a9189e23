# SPDX-License-Identifier: MIT
"""Where the boundaries of bodies cross: edges of one that pierce facets of the other."""

from dataclasses import dataclass, fields
from itertools import chain

import numpy as np
from scipy.spatial import cKDTree

from dolfinx_mortar.arrays import HALF_OF_DIGITS, TINY, Bools, Floats, Longs
from dolfinx_mortar.geometry.elements import LINE2, TRI3
from dolfinx_mortar.geometry.facets import Facets, are_inside, facet_normals


@dataclass(frozen=True, eq=False)
class Crossings:
    """Edges of flat facets that cross other flat facets."""

    pairs: Longs  # (p, 2) the facet with the edge, the facet that it crosses
    depth: Floats  # (p,) how far the edge reaches beyond that facet, to its nearer end
    place: Floats  # (p, d) where it crosses
    ends: Floats  # (p, 2 d) both ends of the edge, ordered: facets that share it have the same

    def part(self, which: Bools) -> "Crossings":
        """Return some of them."""
        return Crossings(*(getattr(self, field.name)[which] for field in fields(self)))


def bounds(x: Floats) -> tuple[Floats, Floats]:
    """Return the smallest and largest coordinates (m, d) of few points (m, k, d).

    NumPy's reduction along the middle axis takes two to five times as long.

    Example:
        >>> [end.tolist() for end in bounds(np.array([[[0.0, 3.0], [1.0, 2.0]]]))]
        [[[0.0, 2.0]], [[1.0, 3.0]]]
    """
    low = high = x[:, 0]
    for k in range(1, x.shape[1]):
        low, high = np.minimum(low, x[:, k]), np.maximum(high, x[:, k])
    return low, high


def near_others(x: Floats, body: Longs, boxes: Floats) -> Bools:
    """Tell (m,) which facets x (m, k, d) of bodies (m,) meet the box of another body.

    Args:
        x: vertices.
        body: number of the body of each facet.
        boxes: smallest and largest coordinates (bodies, 2, d).
    """
    low, high = bounds(x)
    near = np.zeros(len(x), dtype=bool)
    for other in range(len(boxes)):
        meets = (low <= boxes[other, 1]) & (high >= boxes[other, 0])
        near |= meets.all(axis=1) & (body != other)
    return near


def find_crossings(x: Floats, pairs: Longs) -> Crossings:
    """Return where facets cross.

    Args:
        x: vertices (m, d, d) of lines or triangles.
        pairs: (p, 2) those to look at, each once.

    Example:
        >>> line = np.array([[[1.0, 0.0], [-1.0, 0.0]], [[0.5, 3.0], [0.5, -1.0]]])
        >>> found = find_crossings(line, np.array([[0, 1]]))
        >>> found.pairs.tolist(), found.depth.tolist(), found.place.tolist()
        ([[0, 1], [1, 0]], [0.5, 1.0], [[0.5, 0.0], [0.5, 0.0]])
    """
    d = x.shape[2]
    pairs = np.concatenate([pairs, pairs[:, ::-1]])
    normals = facet_normals(Facets(LINE2 if d == 2 else TRI3, x))
    found = []
    for k in range(1 if d == 2 else 3):
        p, q, n = x[pairs[:, 0], k], x[pairs[:, 0], (k + 1) % d], normals[pairs[:, 1]]
        start = x[pairs[:, 1], 0]
        before, after = ((end - start) * n for end in (p, q))
        d0, d1 = before.sum(axis=1), after.sum(axis=1)
        some = np.flatnonzero(d0 * d1 < 0.0)
        share = (d0[some] / (d0 - d1)[some])[:, None]
        place = p[some] + share * (q - p)[some]
        inside = are_inside(x[pairs[some, 1]], n[some], place)
        some, place = some[inside], place[inside]
        depth, ends = np.minimum(np.abs(d0), np.abs(d1))[some], ordered(p[some], q[some])
        found.append((pairs[some], depth, place, ends))
    return Crossings(*(np.concatenate([part[i] for part in found]) for i in range(4)))


def ordered(p: Floats, q: Floats) -> Floats:
    """Return the points p and q (m, d) beside each other (m, 2 d), the lower one first.

    Example:
        >>> ordered(np.array([[1.0, 0.0]]), np.array([[1.0, -2.0]])).tolist()
        [[1.0, -2.0, 1.0, 0.0]]
    """
    differ = (p != q).argmax(axis=1)[:, None]
    turned = np.take_along_axis(p > q, differ, axis=1)
    return np.where(turned, np.hstack([q, p]), np.hstack([p, q]))


def near_pairs(x: Floats, group: Longs, apart: Bools) -> Longs:
    """Return pairs (p, 2) of facets whose boxes meet, each once.

    Args:
        x: vertices (m, k, d).
        group: number (m,) of the group of each.
        apart: (groups, groups) which of them to compare, symmetric.

    Facets are sorted into classes of size, each twice the last, so that a small one is not compared
    with all small ones within the reach of the largest. In each direction distances are measured in
    the largest extents there: boxes of flat facets are thin.
    """
    low, high = bounds(x)
    centre, half = (low + high) / 2, (high - low) / 2
    size = np.frexp(half.max(axis=1, initial=0.0))[1]
    found = [np.zeros((0, 2), dtype=np.int64)]
    for power, one in np.unique(np.stack([size, group], axis=1), axis=0):
        larger = np.flatnonzero((size == power) & (group == one))
        once = (size < power) | ((size == power) & (group >= one))
        within = (low <= high[larger].max(axis=0)) & (high >= low[larger].min(axis=0))
        smaller = np.flatnonzero(once & apart[one, group] & within.all(axis=1))
        if len(smaller) == 0:
            continue
        unit = half[larger].max(axis=0) + half[smaller].max(axis=0)
        unit = np.maximum(unit, HALF_OF_DIGITS * np.maximum(unit.max(), TINY))
        tree = cKDTree(centre[larger] / unit)
        reach = 1.0 + HALF_OF_DIGITS  # beyond round-off
        near = tree.query_ball_point(centre[smaller] / unit, reach, p=np.inf)
        counts = [len(b) for b in near]
        a = np.repeat(smaller, counts)
        b = larger[np.fromiter(chain.from_iterable(near), np.int64, sum(counts))]
        meet = ((low[a] <= high[b]) & (high[a] >= low[b])).all(axis=1)
        meet &= (size[a] < power) | (group[a] != one) | (a < b)
        found.append(np.stack([a[meet], b[meet]], axis=1))
    return np.concatenate(found)

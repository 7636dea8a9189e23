# SPDX-License-Identifier: MIT
"""Where the boundaries of bodies cross: edges of one that pierce facets of the other."""

from dataclasses import dataclass
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
    cosine: Floats  # (p,) of the angle between the outward normals of both


def near_others(x: Floats, body: Longs, boxes: Floats) -> Bools:
    """Tell (m,) which facets x (m, k, d) of bodies (m,) meet the box of another body.

    Args:
        x: vertices.
        body: number of the body of each facet.
        boxes: smallest and largest coordinates (bodies, 2, d).
    """
    low, high = x.min(axis=1), x.max(axis=1)
    near = np.zeros(len(x), dtype=bool)
    for other in range(len(boxes)):
        meets = (low <= boxes[other, 1]) & (high >= boxes[other, 0])
        near |= meets.all(axis=1) & (body != other)
    return near


def find_crossings(x: Floats, body: Longs) -> Crossings:
    """Return where facets of different bodies cross.

    Args:
        x: vertices (m, d, d) of lines or triangles.
        body: number (m,) of the body of each.

    Example:
        >>> line = np.array([[[1.0, 0.0], [-1.0, 0.0]], [[0.5, 3.0], [0.5, -1.0]]])
        >>> found = find_crossings(line, np.array([0, 1]))
        >>> found.pairs.tolist(), found.depth.tolist(), found.place.tolist()
        ([[0, 1], [1, 0]], [0.5, 1.0], [[0.5, 0.0], [0.5, 0.0]])
    """
    d, pairs = x.shape[2], near_pairs(x, body)
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
        found.append((pairs[some], np.minimum(np.abs(d0), np.abs(d1))[some], place))
    pairs, depth, place = (np.concatenate([part[i] for part in found]) for i in range(3))
    cosine = (normals[pairs[:, 0]] * normals[pairs[:, 1]]).sum(axis=1)
    return Crossings(pairs, depth, place, cosine)


def near_pairs(x: Floats, body: Longs) -> Longs:
    """Return pairs (p, 2) of facets of different bodies whose boxes meet, each once.

    Args:
        x: points (m, k, d) whose boxes hold the facets, such as vertices at two times.
        body: number (m,) of the body of each.

    Facets are sorted into classes of size, each twice the last, so that a small one is not compared
    with all small ones within the reach of the largest. In each direction distances are measured in
    the largest extents there: where all slide in one direction, boxes are long and thin.
    """
    low, high = x.min(axis=1), x.max(axis=1)
    centre, half = (low + high) / 2, (high - low) / 2
    size = np.frexp(half.max(axis=1, initial=0.0))[1]
    found = [np.zeros((0, 2), dtype=np.int64)]
    for power, one in np.unique(np.stack([size, body], axis=1), axis=0):
        larger = np.flatnonzero((size == power) & (body == one))
        once = (size < power) | ((size == power) & (body > one))
        within = (low <= high[larger].max(axis=0)) & (high >= low[larger].min(axis=0))
        smaller = np.flatnonzero(once & (body != one) & within.all(axis=1))
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
        found.append(np.stack([a[meet], b[meet]], axis=1))
    return np.concatenate(found)

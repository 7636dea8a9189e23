# SPDX-License-Identifier: MIT
"""Broad phase: which facets can lie over each other, at any distance, in n log n.

A projection reaches as far as it must, so the region that belongs to a slave facet is a double
cone of unbounded length, narrow as a rule. Facets are enclosed by balls in a hierarchy, and each
cone descends into the balls that it meets. Trees of axis-aligned boxes (those of dolfinx) would
have to be given boxes around the cones: of bounded length, and fat where the cones are oblique.
"""

from dataclasses import dataclass

import numba
import numpy as np

from dolfinx_mortar.arrays import Floats, Ints
from dolfinx_mortar.geometry.facets import bounding_balls
from dolfinx_mortar.geometry.tolerances import EPS, HALF_OF_DIGITS, TINY

_BRANCHES = 8  # balls that are enclosed by a ball of the next level, a power of 2


@dataclass(frozen=True, eq=False)
class Cones:
    """Regions that the projections of slave facets, or of groups of them, cannot leave.

    A cone is the set of points p with |lateral part of p - c| <= radius + |axial part| * slope,
    lateral and axial with respect to its axis, on both sides of c.
    """

    centre: Floats  # (m, d)
    axis: Floats  # (m, d) unit vectors
    radius: Floats  # (m,)
    slope: Floats  # (m,)


def create_cones(x_s: Floats, n_s: Floats, margin: Floats) -> Cones:
    """Bound the projections of slave facets, plus a margin.

    Args:
        x_s: Node coordinates (m, k, d); a group of facets is a facet with many nodes.
        n_s: Unit nodal normals (m, k, d).
        margin: Lateral margin (m,).
    """
    centre, radius = bounding_balls(x_s)
    axis = n_s.mean(axis=1)
    axis /= np.maximum(np.linalg.norm(axis, axis=1), TINY)[:, None]
    # of a half space or more: further than coordinates can tell
    cosine = np.clip((n_s * axis[:, None]).sum(axis=2).min(axis=1, initial=1.0), EPS, 1)
    slope = np.sqrt(1 - cosine**2) / cosine
    # Normals start anywhere in the ball, hence the slope acts on one radius more; the last
    # factor makes the cone contain its own facet in spite of round-off.
    return Cones(centre, axis, (radius * (1 + slope) + margin) * (1 + HALF_OF_DIGITS), slope)


@numba.njit(cache=True)
def _meets(c, axis, radius, slope, p, rho):  # type: ignore[no-untyped-def]
    """Tell whether the cone at c can meet the ball at p."""
    axial = 0.0
    square = 0.0
    for i in range(c.size):
        axial += (p[i] - c[i]) * axis[i]
        square += (p[i] - c[i]) ** 2
    lateral = np.sqrt(max(square - axial * axial, 0.0))
    return lateral <= radius + rho + (abs(axial) + rho) * slope


@numba.njit(cache=True)
def _meeting(centre, axis, radius, slope, ball, rho, start):  # type: ignore[no-untyped-def]
    """Return all pairs (cone, ball of the first level) that can meet.

    Level l has the balls start[l] to start[l + 1]; the ball i of a level encloses the balls
    i * _BRANCHES ... of the level below.
    """
    pairs = np.empty((8 * (len(radius) + start[1]) + 64, 2), dtype=np.int32)
    levels = len(start) - 1
    stack = np.empty((levels * _BRANCHES + start[levels] - start[levels - 1], 2), dtype=np.int32)
    p = 0
    for s in range(len(radius)):
        c, a, r, t = centre[s], axis[s], radius[s], slope[s]
        top = 0
        for i in range(start[levels] - start[levels - 1]):
            stack[top, 0], stack[top, 1] = levels - 1, i
            top += 1
        while top > 0:
            top -= 1
            level, k = stack[top, 0], stack[top, 1]
            if not _meets(c, a, r, t, ball[start[level] + k], rho[start[level] + k]):
                continue
            if level > 0:
                size = start[level] - start[level - 1]
                for j in range(k * _BRANCHES, min((k + 1) * _BRANCHES, size)):
                    stack[top, 0], stack[top, 1] = level - 1, j
                    top += 1
                continue
            if p == len(pairs):
                longer = np.empty((2 * p, 2), dtype=np.int32)
                for i in range(p):
                    longer[i, 0], longer[i, 1] = pairs[i, 0], pairs[i, 1]
                pairs = longer
            pairs[p, 0], pairs[p, 1] = s, k
            p += 1
    return pairs[:p]


@numba.njit(cache=True)
def _select(order, value, a, b, middle):  # type: ignore[no-untyped-def]
    """Reorder order[a:b] so that no value before `middle` is larger than one behind it."""
    b -= 1
    while a < b:
        pivot = value[order[(a + b) // 2]]
        i, j = a, b
        while i <= j:
            while value[order[i]] < pivot:
                i += 1
            while value[order[j]] > pivot:
                j -= 1
            if i <= j:
                order[i], order[j] = order[j], order[i]
                i += 1
                j -= 1
        if middle <= j:
            b = j
        elif middle >= i:
            a = i
        else:
            return


@numba.njit(cache=True)
def _sort_in_space(x):  # type: ignore[no-untyped-def]
    """Return an order of points x (d, n) in which aligned blocks of 2^j points are compact.

    Ranges are halved across their longest side, again and again. The first half is always a power
    of two, so that blocks never straddle a cut. Those of scipy's cKDTree do, and the search in its
    order takes two to six times as long; halving by numpy.argpartition costs up to a third more.
    """
    d, n = x.shape
    order = np.arange(n)
    stack = np.empty((64, 2), dtype=np.int64)
    stack[0, 0], stack[0, 1], top = 0, n, 1
    while top > 0:
        top -= 1
        a, b = stack[top, 0], stack[top, 1]
        if b - a <= _BRANCHES:
            continue
        axis, widest = 0, -1.0
        for i in range(d):
            low, high = np.inf, -np.inf
            for k in range(a, b):
                low, high = min(low, x[i, order[k]]), max(high, x[i, order[k]])
            if high - low > widest:
                axis, widest = i, high - low
        half = _BRANCHES
        while 2 * half < b - a:
            half *= 2
        _select(order, x[axis], a, b, a + half)
        stack[top, 0], stack[top, 1] = a, a + half
        stack[top + 1, 0], stack[top + 1, 1] = a + half, b
        top += 2
    return order


def _enclose(centre: Floats, radius: Floats) -> tuple[Floats, Floats]:
    """Return balls (centre, radius) around groups of _BRANCHES successive balls."""
    first = np.arange(0, len(radius), _BRANCHES)
    count = np.diff(np.append(first, len(radius)))
    middle = np.add.reduceat(centre, first) / count[:, None]
    reach = np.linalg.norm(centre - np.repeat(middle, count, axis=0), axis=1) + radius
    return middle, np.maximum.reduceat(reach, first) * (1 + HALF_OF_DIGITS)


def find_meeting(cones: Cones, centre: Floats, radius: Floats) -> Ints:
    """Return the pairs (p, 2) of cones and balls that can meet, ordered by cone, then ball."""
    n = len(radius)
    if len(cones.radius) == 0 or n == 0:
        return np.empty((0, 2), dtype=np.int32)
    order = _sort_in_space(np.ascontiguousarray(centre.T))  # neighbours in space become neighbours
    levels = [(np.ascontiguousarray(centre[order]), radius[order])]
    while len(levels[-1][1]) > _BRANCHES:
        levels.append(_enclose(*levels[-1]))
    start = np.cumsum([0] + [len(rho) for _, rho in levels])
    balls, radii = (np.concatenate([level[i] for level in levels]) for i in range(2))
    pairs = _meeting(cones.centre, cones.axis, cones.radius, cones.slope, balls, radii, start)
    keys = np.sort(pairs[:, 0].astype(np.int64) * n + order[pairs[:, 1]])
    return np.stack(np.divmod(keys, n), axis=1).astype(np.int32)

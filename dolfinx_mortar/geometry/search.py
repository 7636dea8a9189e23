# SPDX-License-Identifier: MIT
"""Broad phase: which facets can lie over each other, at any distance, in n log n.

The length of a projection is not bounded, so what a slave facet can be projected on lies in an
unbounded double cone, as a rule a narrow one. Master facets are enclosed in a hierarchy of balls,
and each cone is tested from the largest balls down to the smallest. Trees of axis-aligned boxes
(those of dolfinx) would need bounded boxes around the cones, large ones where these are oblique.
"""

from dataclasses import dataclass

import numba
import numpy as np

from dolfinx_mortar.arrays import EPS, HALF_OF_DIGITS, Floats, Ints, Longs
from dolfinx_mortar.geometry.facets import bounding_balls
from dolfinx_mortar.geometry.tolerances import TINY


@dataclass(frozen=True, eq=False)
class Cones:
    """Regions that contain the projections of slave facets, or of groups of them.

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

    Level l has the balls start[l] to start[l + 1]; ball i of a level encloses the balls i b to
    (i + 1) b - 1 of the level below, b = 2^d.
    """
    branches = 2 ** centre.shape[1]
    pairs = np.empty((8 * (len(radius) + start[1]) + 64, 2), dtype=np.int32)
    levels = len(start) - 1
    highest = start[levels] - start[levels - 1]
    stack = np.empty((highest + levels * branches, 2), dtype=np.int32)
    p = 0
    for s in range(len(radius)):
        c, a, r, t = centre[s], axis[s], radius[s], slope[s]
        for top in range(highest):
            stack[top, 0], stack[top, 1] = levels - 1, highest - 1 - top
        top = highest
        while top > 0:
            top -= 1
            level, k = stack[top, 0], stack[top, 1]
            if not _meets(c, a, r, t, ball[start[level] + k], rho[start[level] + k]):
                continue
            if level > 0:
                size = start[level] - start[level - 1]
                for j in range(branches * k, min(branches * (k + 1), size)):
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


def sort_in_space(x: Floats) -> Longs:
    """Return an order of points x (n, d) with compact aligned blocks of 2^j points, j >= d.

    Each is half of one twice as long, cut across its longest side. Blocks in the order of scipy's
    cKDTree or of Morton's curve straddle cuts: the search takes two to four times as long.
    """
    order = np.arange(len(x))
    half = smallest = 2 ** x.shape[1]
    while 2 * half < len(x):
        half *= 2
    while half >= smallest:
        full = len(x) - len(x) % (2 * half)
        for blocks in (order[:full].reshape(-1, 2 * half), order[None, full:]):  # views
            if len(blocks) and blocks.shape[1] > half:
                points = x[blocks]
                widest = np.argmax(np.ptp(points, axis=1), axis=1)[:, None, None]
                along = np.take_along_axis(points, widest, axis=2)[:, :, 0]
                halves = np.argpartition(along, half, axis=1)
                blocks[:] = np.take_along_axis(blocks, halves, axis=1)
        half //= 2
    return order


def _enclose(centre: Floats, radius: Floats) -> tuple[Floats, Floats]:
    """Return balls (centre, radius) around groups of 2^d successive balls."""
    first = np.arange(0, len(radius), 2 ** centre.shape[1])
    count = np.diff(np.append(first, len(radius)))
    middle = np.add.reduceat(centre, first) / count[:, None]
    reach = np.linalg.norm(centre - np.repeat(middle, count, axis=0), axis=1) + radius
    return middle, np.maximum.reduceat(reach, first) * (1 + HALF_OF_DIGITS)


def find_meeting(cones: Cones, centre: Floats, radius: Floats) -> Ints:
    """Return the pairs (p, 2) of cones and balls that can meet, ordered by cone, then ball."""
    n = len(radius)
    if len(cones.radius) == 0 or n == 0:
        return np.empty((0, 2), dtype=np.int32)
    order = sort_in_space(centre)
    levels = [(centre[order], radius[order])]
    while len(levels[-1][1]) > 1:
        levels.append(_enclose(*levels[-1]))
    start = np.cumsum([0] + [len(rho) for _, rho in levels])
    balls, radii = (np.concatenate([level[i] for level in levels]) for i in range(2))
    pairs = _meeting(cones.centre, cones.axis, cones.radius, cones.slope, balls, radii, start)
    keys = np.sort(pairs[:, 0].astype(np.int64) * n + order[pairs[:, 1]])
    return np.stack(np.divmod(keys, n), axis=1).astype(np.int32)

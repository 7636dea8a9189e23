# SPDX-License-Identifier: MIT
r"""Segments: the parts of slave facets that are projected on one master facet, with their points.

This module chooses by the space dimension, except for area vectors: directions of projection,
clipping and splitting (`line`, `area`).

A slave facet is projected along the interpolated averaged nodal normals in 2D, along its own mean
normal in 3D.

Which facets can lie over each other is found first, at any distance, in n log n. The length of a
projection is not bounded, so what a slave facet can be projected on lies in an unbounded double
cone, as a rule a narrow one. Master facets are enclosed in a hierarchy of balls, and each cone is
tested from the largest balls down to the smallest. Trees of axis-aligned boxes (those of dolfinx)
would need bounded boxes around the cones, large ones where these are oblique.
"""

from dataclasses import dataclass
from functools import cached_property

import numba
import numpy as np

from dolfinx_mortar.arrays import EPS, HALF_OF_DIGITS, TINY, Bools, Floats, Ints, Longs
from dolfinx_mortar.geometry import area, line, plane
from dolfinx_mortar.geometry.elements import FacetElement
from dolfinx_mortar.geometry.facets import (
    Facets,
    bounding_balls,
    facet_normals,
    facet_sizes,
    tributary_weights,
)
from dolfinx_mortar.geometry.parts import count, parts_of
from dolfinx_mortar.geometry.tolerances import KERNEL

FACING = 0.2
"""A master facet faces a slave facet if n_s . n_m < -FACING for all n_s of the slave facet.

A decision: the projection on the slave is FACING times as large, and steeper facets are taken for
the flanks of a body, on which one slave point would act over five times its length.
"""
_SLIDING = {2: 1.0, 3: 0.35}
"""Margin over a slave facet's diameter, by dimension (cost only: candidates against searches)."""


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


@numba.njit(**KERNEL)
def _meets(c, axis, radius, slope, p, rho):  # type: ignore[no-untyped-def]
    """Tell whether the cone at c can meet the ball at p."""
    axial = 0.0
    square = 0.0
    for i in range(c.size):
        axial += (p[i] - c[i]) * axis[i]
        square += (p[i] - c[i]) ** 2
    lateral = np.sqrt(max(square - axial * axial, 0.0))
    return lateral <= radius + rho + (abs(axial) + rho) * slope


@numba.njit(**KERNEL)
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


@numba.njit(**KERNEL)
def _enclose(ball, rho, start):  # type: ignore[no-untyped-def]
    """Fill in the balls of all levels but the first: see `_meeting`."""
    branches, d = 2 ** ball.shape[1], ball.shape[1]
    for level in range(1, len(start) - 1):
        for k in range(start[level], start[level + 1]):
            first = start[level - 1] + (k - start[level]) * branches
            last = min(first + branches, start[level])
            for j in range(first, last):
                for i in range(d):
                    ball[k, i] += ball[j, i] / (last - first)
            for j in range(first, last):
                square = 0.0
                for i in range(d):
                    square += (ball[j, i] - ball[k, i]) ** 2
                rho[k] = max(rho[k], (np.sqrt(square) + rho[j]) * (1 + HALF_OF_DIGITS))


def find_meeting(cones: Cones, centre: Floats, radius: Floats, order: Longs | None = None) -> Ints:
    """Return the pairs (p, 2) of cones and balls that can meet, ordered by cone, then ball.

    An order of the balls in space decides how fast they are found, not which: one of places where
    they have been serves as well. By default it is made here.
    """
    n = len(radius)
    if len(cones.radius) == 0 or n == 0:
        return np.empty((0, 2), dtype=np.int32)
    order = sort_in_space(centre) if order is None else order
    sizes = [n]
    while sizes[-1] > 1:
        sizes.append(-(-sizes[-1] // 2 ** centre.shape[1]))
    start = np.cumsum([0, *sizes])
    balls, radii = np.zeros((start[-1], centre.shape[1])), np.zeros(start[-1])
    balls[:n], radii[:n] = centre[order], radius[order]
    _enclose(balls, radii, start)
    pairs = _meeting(cones.centre, cones.axis, cones.radius, cones.slope, balls, radii, start)
    keys = np.sort(pairs[:, 0].astype(np.int64) * n + order[pairs[:, 1]])
    return np.stack(np.divmod(keys, n), axis=1).astype(np.int32)


@dataclass(frozen=True, eq=False)
class Segments:
    """Quadrature points of all segments, ordered by slave facet.

    The weights contain the Jacobian of the slave facet: over the points of one slave facet they
    add up to the length (area) of its part that is covered by the master side.
    """

    pair: Ints  # (q,) index into the candidate pairs
    slave: Ints  # (q,) slave facet, ascending
    master: Ints  # (q,) master facet
    xi_s: Floats  # (q, d-1) reference coordinates on the slave facet
    xi_m: Floats  # (q, d-1) reference coordinates of the projection on the master facet
    weight: Floats  # (q,) quadrature weight times Jacobian, positive
    facet_weights: Floats  # (ms, k) integral of N_j over each whole slave facet, covered or not
    element: FacetElement  # of the slave facets
    reach: Floats | None = None  # (ms, 2) gap from which on weights fall, and how fast; None: none

    @cached_property
    def N(self) -> Floats:
        """Values (q, k) of the slave's functions at the points."""
        return self.element.shape_functions(self.xi_s)

    @property
    def covered(self) -> Ints:
        """Slave facets (c,), ascending, of which some part is covered."""
        first = np.ones(len(self.slave), dtype=bool)
        np.not_equal(self.slave[1:], self.slave[:-1], out=first[1:])
        return self.slave[first]


def projection_directions(slave: Facets, n_s: Floats) -> Floats:
    """Return the directions (m, k, d) in which slave facets are projected, (m, 1, d) if it is one.

    Args:
        slave: Slave facets (m,).
        n_s: Unit averaged normals (m, k, d) at their nodes.
    """
    if slave.x.shape[2] == 2:
        return n_s
    return facet_normals(slave)[:, None]


def bounding_directions(slave: Facets, n_s: Floats) -> Floats:
    """Return unit vectors (m, k or 1, d) whose cone holds all directions of projection.

    Args:
        slave: Slave facets (m,).
        n_s: Unit averaged normals (m, k, d) at their nodes.
    """
    if slave.x.shape[2] > 2:
        n = facet_normals(parts_of(slave))
        return n.reshape(len(slave.x), count(slave.element), 3)
    if slave.element.degree == 1:
        return n_s
    v = len(slave.element.vertices)
    control = 2 * n_s[:, v:] - n_s[:, :v].mean(axis=1, keepdims=True)  # of the Bezier curve
    n_s = np.concatenate([n_s[:, :v], control], axis=1)
    return np.asarray(n_s / np.maximum(np.linalg.norm(n_s, axis=2, keepdims=True), TINY))


def sliding_margins(x_s: Floats) -> Floats:
    """Return the sliding (m,) within which candidates of slave facets x_s (m, k, d) suffice.

    It is one facet in 2D and about half an edge in 3D, where candidates grow with the area.
    """
    return _SLIDING[x_s.shape[2]] * facet_sizes(x_s)


def are_facing(n_s: Floats, n_m: Floats) -> Bools:
    """Tell (p,) whether facets with directions n_s (p, k, d) face those with n_m (p, d)."""
    return np.einsum("pki,pi->pk", n_s, n_m).max(axis=1, initial=-1.0) < -FACING


def find_candidates(
    slave: Facets, n_s: Floats, master: Facets, margin: Floats, order: Longs | None = None
) -> Ints:
    """Find the pairs of facets that can share a segment, at any distance from each other.

    Args:
        slave: Slave facets (ms,).
        n_s: Unit averaged normals (ms, k, d) at their nodes.
        master: Master facets (mm,).
        margin: Lateral margin (ms,) for which to provide.
        order: Of the master facets in space, if it is known; see `find_meeting`.

    Returns:
        Pairs (p, 2) of slave and master facet, ordered by slave, then master. Without margins they
        are still a superset of the pairs that have segments.
    """
    cones = create_cones(slave.x, bounding_directions(slave, n_s), margin)
    pairs = find_meeting(cones, *bounding_balls(master.x), order)
    if slave.x.shape[2] == 3:
        pairs = pairs[plane.are_near(slave, master, pairs, margin)]
    n_s, n_m = projection_directions(slave, n_s), facet_normals(master)
    return pairs[are_facing(n_s[pairs[:, 0]], n_m[pairs[:, 1]])]


def create_segments(
    slave: Facets, n_s: Floats, master: Facets, pairs: Ints, deepest: Floats | None = None
) -> Segments:
    """Project, clip, split and place quadrature points.

    Where projections of several master facets overlap, the nearest one covers the slave. Facets too
    deep behind the slave facet, on the far side of a body, cover and hide nothing.

    Args:
        slave: Slave facets (ms,).
        n_s: Averaged normals (ms, k, d) at their nodes.
        master: Master facets (mm,).
        pairs: Candidates (p, 2), ordered by slave facet.
        deepest: How far (p,) behind the slave facet, against its mean normal, the master may lie;
            any depth if not given.
    """
    deepest = np.full(len(pairs), np.inf) if deepest is None else deepest
    n_s, n_m = projection_directions(slave, n_s), facet_normals(master)
    facing = np.flatnonzero(are_facing(n_s[pairs[:, 0]], n_m[pairs[:, 1]]))
    partners = master, pairs[facing], deepest[facing]
    if slave.x.shape[2] == 2:
        which, xi_s, xi_m, weight = line.place_points(slave, n_s, *partners)
    else:
        which, xi_s, xi_m, weight = area.place_points(slave, *partners)
    pair = facing[which].astype(np.int32)
    s, m = np.ascontiguousarray(pairs[pair].T)  # kernels compile anew for each layout
    return Segments(pair, s, m, xi_s, xi_m, weight, tributary_weights(slave), slave.element)

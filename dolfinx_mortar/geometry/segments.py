# SPDX-License-Identifier: MIT
"""Segments: parts of slave facets projected on one master facet, with their quadrature points.

Projection is along the interpolated averaged nodal normals in 2D (`line`), along the mean normal in
3D (`area`). Candidate pairs are found at any distance, in O(n sqrt n): double cones around
the projections against balls around groups of master facets.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numba
import numpy as np
import scipy

from dolfinx_mortar.common.arrays import EPS, HALF_OF_DIGITS, TINY, Bools, Floats, Ints, Longs
from dolfinx_mortar.geometry import area, line, plane
from dolfinx_mortar.geometry.facets import (
    FacetElement,
    Facets,
    bounding_balls,
    facet_normals,
    facet_sizes,
    tributary_weights,
)
from dolfinx_mortar.geometry.plane import count, parts_of
from dolfinx_mortar.geometry.tolerances import KERNEL

FACING = 0.2
"""A master facet faces a slave facet if n_s . n_m < -FACING for all n_s of the slave facet.

A choice: steeper facets are taken for the flanks of a body; a slave point would act there over five
times its length.
"""
_SLIDING = {2: 1.0, 3: 0.35}
"""Margin over a slave facet's diameter, by dimension (cost only: candidates against searches)."""


class Cones(NamedTuple):
    """Regions that contain the projections of slave facets, or of groups of them.

    Points p with |lateral part of p - c| <= radius + |axial part| * slope, on both sides of c.
    """

    centre: Floats  # (m, d)
    axis: Floats  # (m, d) unit
    radius: Floats  # (m,)
    slope: Floats  # (m,)


def create_cones(x_s: Floats, n_s: Floats, margin: Floats) -> Cones:
    """Bound the projections of facets, or groups, with nodes x_s and unit normals n_s (m, k, d).

    With a lateral margin (m,).
    """
    centre, radius = bounding_balls(x_s)
    axis = n_s.mean(axis=1)
    axis /= np.maximum(np.linalg.norm(axis, axis=1), TINY)[:, None]
    # a half space or more: beyond all coordinates
    cosine = np.clip((n_s * axis[:, None]).sum(axis=2).min(axis=1, initial=1.0), EPS, 1)
    slope = np.sqrt(1 - cosine**2) / cosine
    # normals start anywhere in the ball; last factor: round-off
    return Cones(centre, axis, (radius * (1 + slope) + margin) * (1 + HALF_OF_DIGITS), slope)


def as_cones(centre: Floats, radius: Floats) -> Cones:
    """Balls as cones without axis."""
    return Cones(centre, 0.0 * centre, radius * (1 + HALF_OF_DIGITS), 0.0 * radius)


@numba.njit(**KERNEL)
def _meets(c, axis, radius, slope, p, rho):  # type: ignore[no-untyped-def]
    axial = 0.0
    square = 0.0
    for i in range(c.size):
        axial += (p[i] - c[i]) * axis[i]
        square += (p[i] - c[i]) ** 2
    lateral = np.sqrt(max(square - axial * axial, 0.0))
    return lateral <= radius + rho + (abs(axial) + rho) * slope


@numba.njit(**KERNEL)
def _meeting(cones, groups, balls, size, order):  # type: ignore[no-untyped-def]
    """Cone times number of balls plus ball, of all that can meet; groups are around `size`."""
    n, found = len(order), [np.int64(0) for _ in range(0)]
    for s in range(len(cones[0])):
        c, a, r, t = cones[0][s], cones[1][s], cones[2][s], cones[3][s]
        for g in range(len(groups[0])):
            if _meets(c, a, r, t, groups[0][g], groups[1][g]):
                for k in range(g * size, min((g + 1) * size, n)):
                    if _meets(c, a, r, t, balls[0][k], balls[1][k]):
                        found.append(s * n + order[k])
    return np.array(found)


def groups_in_space(x: Floats) -> tuple[Longs, int]:
    """Order of points x (n, d) with compact groups, and the size sqrt(n) of these."""
    order = scipy.spatial.cKDTree(np.nan_to_num(x)).indices
    return np.asarray(order, dtype=np.int64), math.isqrt(max(len(x) - 1, 0)) + 1


def find_meeting(cones: Cones, centre: Floats, radius: Floats) -> Ints:
    """Pairs (p, 2) of cones and balls that can meet, ordered by cone, then ball."""
    n = len(radius)
    if len(cones.radius) == 0 or n == 0:
        return np.empty((0, 2), dtype=np.int32)
    order, size = groups_in_space(centre)
    balls, start = (centre[order], radius[order]), np.arange(0, n, size)
    count = np.diff(np.append(start, n))
    middle = np.add.reduceat(balls[0], start) / count[:, None]
    apart = np.linalg.norm(balls[0] - middle.repeat(count, axis=0), axis=1) + balls[1]
    groups = middle, np.maximum.reduceat(apart, start) * (1 + HALF_OF_DIGITS)
    keys = np.sort(_meeting(tuple(cones), groups, balls, size, order))
    return np.stack(np.divmod(keys, n), axis=1).astype(np.int32)


@dataclass(frozen=True, eq=False)
class Segments:
    """Quadrature points of all segments, ordered by slave facet.

    Weights contain the Jacobian: they add up to the length (area) of a facet's covered part.
    """

    pair: Ints  # (q,) index into the candidate pairs
    slave: Ints  # (q,) slave facet, ascending
    master: Ints
    xi_s: Floats  # (q, d-1)
    xi_m: Floats  # (q, d-1) of the projected point
    weight: Floats  # (q,) positive
    facet_weights: Floats  # (ms, k) int N_j over whole facets
    element: FacetElement  # of the slave facets
    reach: Floats | None = None  # (ms, 2) gap above which weights fall, and slope

    @cached_property
    def N(self) -> Floats:
        """Values (q, k) of the slave's shape functions at the points."""
        return self.element.shape_functions(self.xi_s)

    @property
    def covered(self) -> Ints:
        """Slave facets (c,), ascending, with points."""
        return np.unique(self.slave)


def projection_directions(slave: Facets, n_s: Floats) -> Floats:
    """Directions of projection (m, k, d) in 2D, n_s, or (m, 1, d) in 3D."""
    if slave.x.shape[2] == 2:
        return n_s
    return facet_normals(slave)[:, None]


def bounding_directions(slave: Facets, n_s: Floats) -> Floats:
    """Unit vectors whose cone contains all projections."""
    if slave.x.shape[2] > 2:
        n = facet_normals(parts_of(slave))
        return n.reshape(len(slave.x), count(slave.element), 3)
    if slave.element.degree == 1:
        return n_s
    v = len(slave.element.vertices)
    control = 2 * n_s[:, v:] - n_s[:, :v].mean(axis=1, keepdims=True)  # of the Bezier curve
    n_s = np.concatenate([n_s[:, :v], control], axis=1)
    return n_s / np.maximum(np.linalg.norm(n_s, axis=2, keepdims=True), TINY)


def sliding_margins(x_s: Floats) -> Floats:
    """Sliding (m,) for which candidates suffice."""
    return _SLIDING[x_s.shape[2]] * facet_sizes(x_s)


def are_facing(n_s: Floats, n_m: Floats) -> Bools:
    """Whether (p,) facets with directions n_s (p, k, d) face those with n_m (p, d)."""
    return np.einsum("pki,pi->pk", n_s, n_m).max(axis=1, initial=-1.0) < -FACING


def find_candidates(slave: Facets, n_s: Floats, master: Facets, margin: Floats) -> Ints:
    """Pairs (p, 2) of facets that can share a segment, ordered, at any distance.

    A superset, also without margins (ms,). n_s (ms, k, d) are averaged unit normals.
    """
    cones = create_cones(slave.x, bounding_directions(slave, n_s), margin)
    pairs = find_meeting(cones, *bounding_balls(master.x))
    if slave.x.shape[2] == 3:
        pairs = pairs[plane.are_near(slave, master, pairs, margin)]
    n_s, n_m = projection_directions(slave, n_s), facet_normals(master)
    return pairs[are_facing(n_s[pairs[:, 0]], n_m[pairs[:, 1]])]


def create_segments(
    slave: Facets, n_s: Floats, master: Facets, pairs: Ints, deepest: Floats | None = None
) -> Segments:
    """Project, clip, split and place quadrature points.

    The nearest master facet covers the slave; those too deep neither cover nor hide.

    Args:
        n_s: (ms, k, d) averaged normals at the nodes.
        pairs: (p, 2) candidates, ordered by slave facet.
        deepest: (p,) largest distance of the master behind the slave facet; any if None.
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
    s, m = np.ascontiguousarray(pairs[pair].T)  # kernels compile for each layout
    return Segments(pair, s, m, xi_s, xi_m, weight, tributary_weights(slave), slave.element)

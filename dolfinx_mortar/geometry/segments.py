# SPDX-License-Identifier: MIT
r"""Segments: the parts of slave facets that are projected on one master facet, with their points.

This module chooses by the space dimension, except for area vectors: directions of projection,
clipping and splitting (`line`, `area`).

A slave facet is projected along the interpolated averaged nodal normals in 2D, along its own mean
normal in 3D.
"""

from dataclasses import dataclass

import numpy as np

from dolfinx_mortar.arrays import Bools, Floats, Ints
from dolfinx_mortar.geometry import area, line, plane
from dolfinx_mortar.geometry.facets import (
    Facets,
    bounding_balls,
    facet_normals,
    facet_sizes,
    tributary_weights,
)
from dolfinx_mortar.geometry.parts import count, parts_of
from dolfinx_mortar.geometry.search import create_cones, find_meeting
from dolfinx_mortar.geometry.tolerances import TINY

FACING = 0.2
"""A master facet faces a slave facet if n_s . n_m < -FACING for all n_s of the slave facet.

A decision: the projection on the slave is FACING times as large, and steeper facets are taken for
the flanks of a body, on which one slave point would act over five times its length.
"""
_SLIDING = {2: 1.0, 3: 0.35}
"""Margin over a slave facet's diameter, by dimension (cost only: candidates against searches)."""


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


def find_candidates(slave: Facets, n_s: Floats, master: Facets, margin: Floats) -> Ints:
    """Find the pairs of facets that can share a segment, at any distance from each other.

    Args:
        slave: Slave facets (ms,).
        n_s: Unit averaged normals (ms, k, d) at their nodes.
        master: Master facets (mm,).
        margin: Lateral margin (ms,) for which to provide.

    Returns:
        Pairs (p, 2) of slave and master facet, ordered by slave, then master. Without margins they
        are still a superset of the pairs that have segments.
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
    s, m = pairs[pair].T
    return Segments(pair, s, m, xi_s, xi_m, weight, tributary_weights(slave))

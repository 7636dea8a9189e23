# SPDX-License-Identifier: MIT
r"""Which part of a slave facet lies over which master facet, and quadrature points there.

Everything that depends on the space dimension is chosen here: the directions of projection,
clipping and splitting (`line`, `area`). Facets are plain arrays of node coordinates;
dofs, ranks and matrices are unknown here.

A slave facet is projected along the interpolated averaged nodal normals in 2D, along its own mean
normal in 3D.
"""

from dataclasses import dataclass

import numpy as np

from dolfinx_mortar.arrays import Bools, Floats, Ints
from dolfinx_mortar.geometry import area, line, plane
from dolfinx_mortar.geometry.facets import (
    bounding_balls,
    facet_normals,
    facet_sizes,
    tributary_weights,
)
from dolfinx_mortar.geometry.search import create_cones, find_meeting

FACING = 0.2
"""A master facet faces a slave facet if n_s . n_m < -FACING for all n_s of the slave facet."""
TURN = 0.03
"""Rotation (radians) after the search for which the margin of the candidate pairs provides."""
FACING_MARGIN = 0.3
"""Change of n_s . n_m after the search for which the candidate pairs provide."""
_SLIDING = {2: 1.0, 3: 0.35}  # margin in parts of a slave facet's diameter, by dimension


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


def projection_directions(x_s: Floats, n_s: Floats) -> Floats:
    """Return the directions (m, k, d) in which slave facets are projected, (m, 1, d) if it is one.

    Args:
        x_s: Node coordinates (m, k, d) of the slave facets.
        n_s: Unit averaged normals (m, k, d) at these nodes.
    """
    if x_s.shape[2] == 2:
        return n_s
    return facet_normals(x_s)[:, None]


def sliding_margins(x_s: Floats) -> Floats:
    """Return the sliding (m,) for which the candidates of slave facets x_s (m, k, d) provide.

    It is one facet in 2D. In 3D, where the candidates grow with the area, it is about half an edge.
    """
    return _SLIDING[x_s.shape[2]] * facet_sizes(x_s)


def are_facing(n_s: Floats, n_m: Floats, slack: float = 0.0) -> Bools:
    """Tell (p,) whether facets with directions n_s (p, k, d) face those with n_m (p, d)."""
    return np.einsum("pki,pi->pk", n_s, n_m).max(axis=1, initial=-1.0) < slack - FACING


def find_candidates(
    x_s: Floats, n_s: Floats, x_m: Floats, margin: Floats, *, moving: bool = True
) -> Ints:
    """Find the pairs of facets that can share a segment, at any distance from each other.

    Args:
        x_s: Node coordinates (ms, k, d) of the slave facets.
        n_s: Unit averaged normals (ms, k, d) at these nodes.
        x_m: Node coordinates (mm, k', d) of the master facets.
        margin: Lateral margin (ms,) for which to provide.
        moving: Provide for the rotations TURN and FACING_MARGIN as well.

    Returns:
        Pairs (p, 2) of slave and master facet, ordered by slave, then master. Without margins they
        are still a superset of the pairs that have segments.
    """
    n_s, turn = projection_directions(x_s, n_s), TURN if moving else 0.0
    pairs = find_meeting(create_cones(x_s, n_s, margin, turn), *bounding_balls(x_m))
    if x_s.shape[2] == 3:
        pairs = pairs[plane.are_near(x_s, x_m, pairs, margin, turn)]
    n_m = facet_normals(x_m)
    return pairs[are_facing(n_s[pairs[:, 0]], n_m[pairs[:, 1]], FACING_MARGIN if moving else 0.0)]


def create_segments(x_s: Floats, n_s: Floats, x_m: Floats, pairs: Ints) -> Segments:
    """Project, clip, split and place quadrature points.

    Where several master facets lie behind each other, the one at the smallest distance covers the
    slave.

    Args:
        x_s: Node coordinates (ms, k, d) of the slave facets.
        n_s: Averaged normals (ms, k, d) at these nodes.
        x_m: Node coordinates (mm, k', d) of the master facets.
        pairs: Candidates (p, 2), ordered by slave facet.
    """
    n_s = projection_directions(x_s, n_s)
    n_m = facet_normals(x_m)
    facing = np.flatnonzero(are_facing(n_s[pairs[:, 0]], n_m[pairs[:, 1]]))
    if x_s.shape[2] == 2:
        which, xi_s, xi_m, weight = line.place_points(x_s, n_s, x_m, pairs[facing])
    else:
        which, xi_s, xi_m, weight = area.place_points(x_s, x_m, pairs[facing])
    pair = facing[which].astype(np.int32)
    slave, master = pairs[pair].T
    return Segments(pair, slave, master, xi_s, xi_m, weight, tributary_weights(x_s))

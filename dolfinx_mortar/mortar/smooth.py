# SPDX-License-Identifier: MIT
"""The gap between the smooth surfaces that facets stand for, instead of that between facets."""

from __future__ import annotations

import numpy as np

import dolfinx
from dolfinx.common import timed
from dolfinx_mortar.arrays import Bools, Floats
from dolfinx_mortar.geometry.facets import facet_normals
from dolfinx_mortar.geometry.segments import Segments
from dolfinx_mortar.geometry.smooth import (
    NodeNormals,
    common_rises,
    curvatures,
    fan_sums,
    heights,
    rises,
    unit,
)
from dolfinx_mortar.geometry.tolerances import HALF_OF_DIGITS
from dolfinx_mortar.mortar.pairing import Pairing, receive, received_facets
from dolfinx_mortar.mortar.surface import Surface, coordinates, facets_at, sum_at_nodes


def smooth_normals(surface: Surface, x: Floats, fixed: Bools, feature_angle: float) -> NodeNormals:
    """Return the normals of the smooth surface at the nodes; collective.

    On a plane of symmetry the facets are completed by their mirror images, which takes from the
    normal the components with Dirichlet data; but not where that turns it by more than half of the
    feature angle: what holds the end of a surface need not be its symmetry.

    Args:
        surface: the surface.
        x: coordinates (n, d) of its nodes.
        fixed: (n, d) components of the nodes with Dirichlet data.
        feature_angle: degrees between facets from which on they meet in an edge.
    """
    facets = facets_at(surface, x)
    parts, around = fan_sums(facets)
    columns = np.concatenate([parts, around, np.abs(around).sum(axis=2, keepdims=True)], axis=2)
    total = sum_at_nodes(surface, columns)
    d = x.shape[1]
    n, gap, size = unit(total[:, :d]), total[:, d:-1], total[:, -1]
    is_open = np.linalg.norm(gap, axis=1) > HALF_OF_DIGITS * size
    mirrored = unit(np.where(fixed, 0.0, n))
    turn = np.einsum("ni,ni->n", mirrored, n)
    completed = is_open & fixed.any(axis=1) & (turn > np.cos(np.radians(feature_angle / 2)))
    if d > 2:  # one mirror closes a fan that begins and ends on it; in the plane any does
        off_plane = np.linalg.norm(np.where(fixed, gap, 0.0), axis=1) > HALF_OF_DIGITS * size
        completed &= (fixed.sum(axis=1) > 1) | ~off_plane
    n = np.where(completed[:, None], mirrored, n)
    apart = np.einsum("mki,mi->mk", n[surface.facets], facet_normals(facets))
    beyond = apart < np.cos(np.radians(feature_angle / 2))
    sharp = sum_at_nodes(surface, beyond[:, :, None])[:, 0] > 0
    return NodeNormals(n, np.asarray(is_open & ~completed), np.asarray(sharp))


@timed("~Mortar: heights")
def point_heights(
    pairing: Pairing,
    segments: Segments,
    u: dolfinx.fem.Function | None,
    fixed: Bools,
    feature_angle: float,
) -> Floats:
    """Return by how much (q,) the smooth surfaces are nearer than the facets; collective.

    The facets of both sides stand off the surface that these share where they touch.

    Args:
        pairing: the pair of surfaces.
        segments: its segments at X + u.
        u: displacement, None for X.
        fixed: (local nodes, d) components of the nodes of V with Dirichlet data.
        feature_angle: see `smooth_normals`.
    """
    slave, master = pairing.slave, pairing.master
    x_s, x_m = coordinates(slave, u), coordinates(master, u)
    n_s = smooth_normals(slave, x_s, fixed[slave.nodes], feature_angle)
    own = smooth_normals(master, x_m, fixed[master.nodes], feature_angle)
    n_m = _received(pairing, own)
    f_s, f_m = facets_at(slave, x_s), received_facets(pairing, u)
    c_s, c_m = rises(f_s, n_s, slave.facets), rises(f_m, n_m, pairing.master_facets)
    s, m = pairing.pairs.T
    at_s = common_rises(f_s[s], c_s[s], curvatures(f_m, c_m)[m])
    at_m = common_rises(f_m[m], c_m[m], curvatures(f_s, c_s)[s])
    h_s = heights(f_s, at_s, segments.pair, segments.xi_s)
    return h_s + heights(f_m, at_m, segments.pair, segments.xi_m)


def _received(pairing: Pairing, own: NodeNormals) -> NodeNormals:
    """Return the normals at the master nodes that this rank has received; collective."""
    kind = np.zeros_like(own.n)
    kind[:, 0], kind[:, 1] = own.open, own.sharp
    n, kind = receive(pairing, own.n), receive(pairing, kind)
    return NodeNormals(n, kind[:, 0] > 0.5, kind[:, 1] > 0.5)

# SPDX-License-Identifier: MIT
"""The smooth surfaces that facets stand for: the gap between them, and how they are tied."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

import dolfinx
from dolfinx.common import timed
from dolfinx_mortar.arrays import Bools, Floats, Ints
from dolfinx_mortar.geometry.arms import arm_motions
from dolfinx_mortar.geometry.facets import Facets, facet_normals, points_of
from dolfinx_mortar.geometry.segments import Segments
from dolfinx_mortar.geometry.smooth import NodeNormals, fan_sums, heights, rise_tensors, rises
from dolfinx_mortar.geometry.tolerances import HALF_OF_DIGITS, TINY
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
    n, gap, size = _unit(total[:, :d]), total[:, d:-1], total[:, -1]
    is_open = np.linalg.norm(gap, axis=1) > HALF_OF_DIGITS * size
    mirrored = _unit(np.where(fixed, 0.0, n))
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


def _unit(v: Floats) -> Floats:
    """Return vectors (n, d) of length one, zero for zero."""
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=1), TINY)[:, None])


@timed("~Mortar: heights")
def point_heights(
    pairing: Pairing,
    segments: Segments,
    u: dolfinx.fem.Function | None,
    fixed: Bools,
    feature_angle: float,
) -> Floats:
    """Return by how much (q,) the smooth surfaces are nearer than the facets; collective.

    Args:
        pairing: the pair of surfaces.
        segments: its segments at X + u.
        u: displacement, None for X.
        fixed: (local nodes, d) components of the nodes of V with Dirichlet data.
        feature_angle: see `smooth_normals`.
    """
    result = np.zeros(len(segments.slave))
    for s in _smooth_sides(pairing, segments, u, fixed, feature_angle):
        result += heights(s.facets, rises(s.facets, s.normals, s.nodes), s.which, s.xi)
    return result


def point_motions(
    pairing: Pairing,
    segments: Segments,
    u: dolfinx.fem.Function | None,
    fixed: Bools,
    feature_angle: float,
) -> Callable[[slice], Floats]:
    """Return a function that gives A_l (q, k, d, d) at a part of the points; collective.

    By these the arms from master to slave move, see `dolfinx_mortar.geometry.arms`. The arguments
    are those of `point_heights`.
    """
    slave, master = _smooth_sides(pairing, segments, u, fixed, feature_angle)
    rises_s, rises_m = (rise_tensors(s.facets, s.normals, s.nodes) for s in (slave, master))

    def at(part: slice) -> Floats:
        s, m = slave.which[part], master.which[part]
        xi_s, xi_m = slave.xi[part], master.xi[part]
        H = heights(slave.facets, rises_s, s, xi_s) + heights(master.facets, rises_m, m, xi_m)
        arms = points_of(slave.facets, s, xi_s) - points_of(master.facets, m, xi_m)
        return arm_motions(master.facets, m, xi_m, arms, H)

    return at


@dataclass(frozen=True)
class _SmoothSide:
    """The points of segments on one side, and the normals of its smooth surface."""

    facets: Facets
    normals: NodeNormals
    nodes: Ints  # (m, k) which normals are a facet's
    which: Ints  # (q,) facet of each point
    xi: Floats  # (q, d-1)


def _smooth_sides(
    pairing: Pairing,
    segments: Segments,
    u: dolfinx.fem.Function | None,
    fixed: Bools,
    feature_angle: float,
) -> tuple[_SmoothSide, _SmoothSide]:
    """Return the slave and the master side at X + u; collective."""
    slave, master = pairing.slave, pairing.master
    x_s, x_m = coordinates(slave, u), coordinates(master, u)
    n_s = smooth_normals(slave, x_s, fixed[slave.nodes], feature_angle)
    own = smooth_normals(master, x_m, fixed[master.nodes], feature_angle)
    n_m = _received(pairing, own)
    facets = facets_at(slave, x_s), received_facets(pairing, u)
    return (
        _SmoothSide(facets[0], n_s, slave.facets, segments.slave, segments.xi_s),
        _SmoothSide(facets[1], n_m, pairing.master_facets, segments.master, segments.xi_m),
    )


def _received(pairing: Pairing, own: NodeNormals) -> NodeNormals:
    """Return the normals at the master nodes that this rank has received; collective."""
    kind = np.zeros_like(own.n)
    kind[:, 0], kind[:, 1] = own.open, own.sharp
    n, kind = receive(pairing, own.n), receive(pairing, kind)
    return NodeNormals(n, kind[:, 0] > 0.5, kind[:, 1] > 0.5)

# SPDX-License-Identifier: MIT
"""Dual functions at the edges and corners of a slave side; normals are in `common_normals`.

The gap of a corner is not that of its facets. If a node of them has no multiplier, because of
Dirichlet data or of little coverage, its dual function is shared out to the others, so that a
constant pressure acts on all that is covered. But where the facets are open up to that node, the
gap of the corner then is a mean over the opening, and the corner penetrates until that vanishes.
There the dual function is not shared out, and has no constraint: the other functions are
biorthogonal to it, too, and have the gaps at their own nodes.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

import dolfinx
from dolfinx_mortar.algebra.parallel import any_rank
from dolfinx_mortar.arguments import is_number
from dolfinx_mortar.arrays import TINY, Bools, Floats, Longs
from dolfinx_mortar.geometry.curvature import unit
from dolfinx_mortar.geometry.facets import (
    Facets,
    facet_normals,
    facet_sizes,
    normals_at_nodes,
    points_of,
)
from dolfinx_mortar.geometry.segments import Segments
from dolfinx_mortar.mortar.duals import weighted_duals
from dolfinx_mortar.mortar.integrals import SUNK, sums_of_products
from dolfinx_mortar.mortar.pairing import Pairing, received_facets
from dolfinx_mortar.mortar.surface import (
    Surface,
    accumulate,
    coordinates,
    facets_at,
    nodal_normals,
    sum_at_nodes,
)


def check_angle(feature_angle: Any) -> float:
    """Return the angle from which on facets meet in an edge, if it is one.

    Raises:
        ValueError: unless 0 < feature_angle <= 180.
    """
    if not is_number(feature_angle) or not 0.0 < feature_angle <= 180.0:
        raise ValueError(
            f"feature_angle is {feature_angle!r}: give degrees, 0 < feature_angle <= 180"
        )
    return float(feature_angle)


def find_edges(surface: Surface, feature_angle: float) -> Bools | None:
    """Return the nodes (n,) on convex edges and corners at X, None without any; collective.

    The normal of some facet there differs from the averaged normal by more than half of the feature
    angle, and the facets lie below the node along that normal.

    Args:
        feature_angle: Degrees between facets from which on they meet in an edge.
    """
    facets = facets_at(surface, surface.X)
    n = nodal_normals(surface, surface.X)[surface.facets]
    along = np.einsum("mki,mki->mk", n, normals_at_nodes(facets))
    beyond = np.asarray(along < np.cos(np.radians(feature_angle / 2)))
    offsets = facets.x - facets.x.mean(axis=1, keepdims=True)
    height = np.einsum("mki,mki->mk", n, offsets)
    sums = sum_at_nodes(surface, np.stack([beyond, height], axis=2))
    edges = np.asarray((sums > 0).all(axis=1))
    return edges if any_rank(surface.V.mesh.comm, edges.any())[0] else None


def facing_edges(pairing: Pairing, segments: Segments, feature_angle: float) -> Bools:
    """Return the slave facets (m,) that convex edges or corners of the master face; collective.

    On more than `SUNK` of what such a facet faces, the normal of the master is turned from the mean
    there by more than half of the feature angle, and normals point apart. At X.

    Args:
        feature_angle: Degrees between facets from which on they meet in an edge.
    """
    on, count, w = segments.slave, len(pairing.slave.facets), segments.weight
    received = received_facets(pairing, None)
    n = facet_normals(received)[segments.master]
    x = points_of(received, segments.master, segments.xi_m)
    whole = np.maximum(np.bincount(on, w, count), TINY)
    middle, mean = (
        np.stack([np.bincount(on, w * part, count) for part in v.T], axis=1) / whole[:, None]
        for v in (x, n)
    )
    turned = (n * unit(mean)[on]).sum(axis=1) < np.cos(np.radians(feature_angle / 2))
    apart = ((x - middle[on]) * (n - mean[on])).sum(axis=1)
    convex = np.bincount(on, w * apart, count) > 0.0
    return np.asarray(convex & (np.bincount(on, w * turned, count) > SUNK * whole))


@dataclass(frozen=True, eq=False)
class Sharing:
    """How far dual functions of nodes without multiplier beside edges are shared out."""

    silent: Bools  # (n,) such nodes
    closed: Floats  # (m,) share of each slave facet: 1 where they are closed, 0 where one is open


def find_sharing(
    pairing: Pairing,
    segments: Segments,
    u: dolfinx.fem.Function | None,
    keep: Bools,
    edges: Bools,
    claimed: Bools,
) -> Sharing | None:
    """Return what is shared out beside edges, None without such nodes on any rank; collective.

    Args:
        u: Displacement, None for X.
        keep: Nodes (n,) that carry a multiplier.
        edges: Nodes (n,) on edges, of `find_edges`.
        claimed: Nodes (n,) with a multiplier of another interface: always shared out.
    """
    slave, nodes = pairing.slave, pairing.slave.facets
    at_edges = nodes[np.asarray((edges & keep)[nodes].any(axis=1))]
    beside = accumulate(slave, np.bincount(at_edges.ravel(), minlength=len(keep))) > 0
    silent = np.asarray(beside & ~keep & ~claimed)
    if not any_rank(slave.V.mesh.comm, silent.any())[0]:
        return None
    return Sharing(silent, _closed(pairing, segments, u, silent))


def open_duals(
    pairing: Pairing, segments: Segments, Phi: Floats, keep: Bools, sharing: Sharing | None
) -> Floats:
    """Return the weighted dual functions (q, k), not shared out beside open edges.

    Args:
        pairing: The pair of surfaces.
        segments: Its segments at X + u.
        Phi: Functions (q, k) of `weighted_duals` for the nodes kept.
        keep: Nodes (n,) that carry a multiplier.
        sharing: What is shared out, of `find_sharing`.
    """
    if sharing is None:
        return Phi
    kept = keep[pairing.slave.facets][segments.slave]
    full = weighted_duals(pairing, segments, keep | sharing.silent) * kept
    closed = sharing.closed[segments.slave, None]
    return np.asarray(closed * Phi + (1.0 - closed) * full)


@dataclass(frozen=True, eq=False)
class _Openings:
    """How far slave facets (m,) are open at their silent nodes: o_j, the mean of gaps over N_j."""

    facets: Facets
    opening: Floats  # (m, k) o_j, 0 at other nodes
    weight: Floats  # (m, k) int N_j, of which only what is positive counts


def _openings(
    pairing: Pairing, segments: Segments, u: dolfinx.fem.Function | None, silent: Bools
) -> _Openings:
    """Return the openings at silent nodes (n,); collective."""
    slave = pairing.slave
    facets = facets_at(slave, coordinates(slave, u))
    x_s = points_of(facets, segments.slave, segments.xi_s)
    x_m = points_of(received_facets(pairing, u), segments.master, segments.xi_m)
    gap = ((x_m - x_s) * facet_normals(facets)[segments.slave]).sum(axis=1)
    N = np.clip(slave.element.shape_functions(segments.xi_s), 0.0, None) * segments.weight[:, None]
    values = np.stack([np.ones_like(gap), gap], axis=1)
    weight, moment = np.moveaxis(sums_of_products(N, values, segments.slave, len(facets.x)), 2, 0)
    opening = np.where(silent[slave.facets], moment / np.maximum(weight, TINY), 0.0)
    return _Openings(facets, opening, weight)


def _closed(
    pairing: Pairing, segments: Segments, u: dolfinx.fem.Function | None, silent: Bools
) -> Floats:
    """Return the part (m,) in which slave facets share out functions of silent nodes; collective.

    1 where these nodes are closed, 0 where one of them is open; 1 without such nodes.
    """
    found = _openings(pairing, segments, u, silent)
    widest = found.opening.max(axis=1, initial=0.0) / (SUNK * facet_sizes(found.facets.x))
    return np.asarray(np.clip(1.0 - widest, 0.0, 1.0))


def widest_openings(
    pairing: Pairing, segments: Segments, u: dolfinx.fem.Function, sharing: Sharing
) -> Longs:
    """Return the node of the widest opening of slave facets (m,), its number there; collective.

    -1 on facets that do not share out in part.

    Args:
        segments: Those at X + u, of all slave facets or of some.
        sharing: Of the same.
    """
    widest = _openings(pairing, segments, u, sharing.silent).opening.argmax(axis=1)
    partly = (sharing.closed > 0.0) & (sharing.closed < 1.0)
    return np.where(partly, widest, -1)

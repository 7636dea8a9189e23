# SPDX-License-Identifier: MIT
r"""Derivatives of the normals at the edges of a slave side, and of what acts along them.

The normal n_j of a node on an edge is a function of the sums S_j = sum w N_j g over the points of
its segments, with the `products` g of the normals of both sides, see `dolfinx_mortar.mortar.edges`:

    dn_j = dn_j/dS_j sum (d(w N_j) g + w N_j dg).

A facet turns by dn = -sum_k G_k (n.dx_k), with the gradients G_k in its middle. In 2D the weights
and places of the points move with both sides, and with the averaged normals along which they
project. In 3D, where facets are projected along their own normals, the integral of N_j over the
segments of a pair changes with the areas there, and by all edges of the master facet: what it gains
has its own normal, what its neighbour loses another one, see `geometry.facet_derivatives`. Second
order in 3D is exact up to the quadrature of N_j, of which only what is positive counts.
"""

from dataclasses import dataclass

import numpy as np

import dolfinx
from dolfinx_mortar.algebra.block_sums import Blocks
from dolfinx_mortar.arrays import Bools, Floats, Ints
from dolfinx_mortar.geometry.facet_derivatives import (
    Points,
    differentiate_integrals,
    place_on_edges,
)
from dolfinx_mortar.geometry.facets import Facets, facet_normals, normal_slopes, points_of
from dolfinx_mortar.geometry.line_derivatives import differentiate_points
from dolfinx_mortar.geometry.segments import Segments
from dolfinx_mortar.mortar.curvature_correction import distinct
from dolfinx_mortar.mortar.derivatives import Tractions, log_slopes
from dolfinx_mortar.mortar.edges import edge_normals_by_sums, edged, products, sums_at_edges
from dolfinx_mortar.mortar.integrals import some_points, sums_of_products
from dolfinx_mortar.mortar.pairing import Pairing, received_facets
from dolfinx_mortar.mortar.surface import coordinates, facets_at, nodal_normals


@dataclass(frozen=True, eq=False)
class EdgeDerivatives:
    """What this rank's slave facets add; numbers of master nodes follow those of slave nodes."""

    n_x: Blocks  # normals of the nodes on edges by coordinates
    n_n: Blocks | None  # the same by the averaged normals; None in 3D
    F: Blocks  # forces by the normals of the nodes on edges
    G: Blocks  # weighted gaps by these


def differentiate_edges(
    pairing: Pairing,
    u: dolfinx.fem.Function,
    segments: Segments,
    edges: Bools,
    Phi: Floats,
    given: Tractions,
) -> EdgeDerivatives:
    """Return the derivatives of normals on edges at X + u, and those by them (collective).

    Args:
        pairing: The pair of surfaces.
        u: Displacement.
        segments: Its segments at X + u, of all slave facets or of some.
        edges: Local slave nodes (n,) on edges.
        Phi: Weighted functions (q, k) of `open_duals`.
        given: Normals and tractions, and their changes with the normals before Dirichlet data
            restricts them; those off the edges are not used.
    """
    sums = sums_at_edges(pairing, segments, u, edges)
    d = pairing.slave.X.shape[1]
    by_sums = np.zeros((len(edges), d, sums.shape[1]))
    by_sums[edges] = edge_normals_by_sums(sums, d)
    some = edged(pairing.slave, edges, segments)
    at = pairing, u, some_points(segments, some), by_sums, edges, Phi[some], given
    return _in_plane(*at) if d == 2 else _in_space(*at)


def _in_plane(
    pairing: Pairing,
    u: dolfinx.fem.Function,
    segments: Segments,
    by_sums: Floats,
    edges: Bools,
    Phi: Floats,
    given: Tractions,
) -> EdgeDerivatives:
    """Return those of surfaces in 2D, by points; collective."""
    slave, master = pairing.slave, received_facets(pairing, u)
    x = coordinates(slave, u)
    facets, n_s = facets_at(slave, x), nodal_normals(slave, x)[slave.facets]
    points = differentiate_points(facets, n_s, master, segments, log_slopes(pairing, segments))
    s, m, w = segments.slave, segments.master, segments.weight
    N = slave.element.shape_functions(segments.xi_s)
    slopes = slave.element.derivatives(segments.xi_s)[:, :, 0] * (N > 0.0)
    q, k = N.shape
    own, other = slave.facets[s], len(x) + pairing.master_facets[m]
    both = np.concatenate([own, other], axis=1)

    values = products(facet_normals(facets)[s], -facet_normals(master)[m])
    by_x = np.zeros((q, values.shape[1], points.weight.shape[1]))
    _add_turning(by_x, facets[s], 1.0, 0, 0)
    _add_turning(by_x, master[m], -1.0, 1, 4 * k)
    part = np.clip(N, 0.0, None)
    moved = (w[:, None] * slopes)[..., None] * points.xi_s[:, None]
    moved += part[..., None] * points.weight[:, None]
    change = moved[:, :, None] * values[:, None, :, None]
    change += (part * w[:, None])[:, :, None, None] * by_x[:, None]
    normals = by_sums[own] @ change  # (q, k, 2, p)
    n_x = np.concatenate([normals[..., : 2 * k], normals[..., 4 * k :]], axis=3)
    N_m = master.element.shape_functions(segments.xi_m)
    products_of = Phi[..., None] * np.hstack([N, -N_m])[:, None]
    o = points_of(master, m, segments.xi_m) - points_of(facets, s, segments.xi_s)
    return EdgeDerivatives(
        Blocks(own, both, n_x.reshape(q, k, 2, both.shape[1], 2)),
        Blocks(own, own, normals[..., 2 * k : 4 * k].reshape(q, k, 2, k, 2)),
        *_by_normals(own, both, edges, given, products_of, Phi[..., None] * o[:, None]),
    )


def _in_space(
    pairing: Pairing,
    u: dolfinx.fem.Function,
    segments: Segments,
    by_sums: Floats,
    edges: Bools,
    Phi: Floats,
    given: Tractions,
) -> EdgeDerivatives:
    """Return those of surfaces in 3D, by pairs; collective."""
    slave, master = pairing.slave, received_facets(pairing, u)
    facets = facets_at(slave, coordinates(slave, u))
    used, of = distinct(segments.pair)
    pairs, of = np.ascontiguousarray(pairing.pairs[used]), of.astype(np.int32)
    s, m = pairs.T
    own, other = slave.facets[s], len(slave.nodes) + pairing.master_facets[m]
    both = np.concatenate([own, other], axis=1)
    p, k = own.shape

    N_s = slave.element.shape_functions(segments.xi_s)
    N_m = master.element.shape_functions(segments.xi_m)
    every = np.ones((p, len(master.element.vertices)), dtype=bool)
    on_edges = place_on_edges(facets, master, pairs, every)
    N = [np.clip(N, 0.0, None) for N in (N_s, slave.element.shape_functions(on_edges.xi_s))]
    sums = sums_of_products(N[0] * segments.weight[:, None], np.ones((len(of), 1)), of, p)
    inner = Points(of.astype(np.int64), segments.xi_s, segments.xi_m, segments.weight)
    none, areas = np.zeros((len(facets.x), 3)), -np.ones(len(facets.x))
    moved = differentiate_integrals(
        facets, master, pairs, (inner, on_edges), (N[0], N[1]), none, areas
    ).reshape(p, k, 3 * both.shape[1])
    values = products(facet_normals(facets)[s], -facet_normals(master)[m])
    by_x = np.zeros((p, values.shape[1], 3 * both.shape[1]))
    _add_turning(by_x, facets[s], 1.0, 0, 0)
    _add_turning(by_x, master[m], -1.0, 1, 3 * k)
    change = moved[:, :, None] * values[:, None, :, None] + sums[..., None] * by_x[:, None]
    n_x = (by_sums[own] @ change).reshape(p, k, 3, both.shape[1], 3)
    o = points_of(master, segments.master, segments.xi_m)
    o -= points_of(facets, segments.slave, segments.xi_s)
    products_of, offsets = (
        sums_of_products(Phi, values, of, p) for values in (np.hstack([N_s, -N_m]), o)
    )
    return EdgeDerivatives(
        Blocks(own, both, n_x), None, *_by_normals(own, both, edges, given, products_of, offsets)
    )


def _by_normals(
    own: Ints, both: Ints, edges: Bools, given: Tractions, products_of: Floats, offsets: Floats
) -> tuple[Blocks, Blocks]:
    """Return the derivatives of forces and gaps by the normals of nodes on edges.

    Args:
        own: Slave nodes (q, k) of points or pairs.
        both: These and the master nodes (q, k + l).
        edges: Local slave nodes (n,) on edges.
        given: Normals and tractions, and their changes.
        products_of: Sums (q, k, k + l) of w Phi_j times N_k and -N_l.
        offsets: Sums (q, k, d) of w Phi_j times x_m - x_s.
    """
    on, each = edges[own][:, :, None, None], own.reshape(-1, 1)
    changes = np.swapaxes(given.changes[own] * on, 1, 2)[:, None]  # (q, 1, d, k, d)
    forces = np.swapaxes(products_of, 1, 2)[:, :, None, :, None] * changes
    gaps = offsets[:, :, None] @ (given.turning[own] * on)
    return Blocks(both, own, forces), Blocks(each, each, gaps.reshape(-1, 1, 1, 1, gaps.shape[3]))


def _add_turning(by_x: Floats, facets: Facets, sign: float, side: int, first: int) -> None:
    """Add the derivatives of `products` (q, c, p) by the nodes of the facets (q,) of one side.

    Args:
        by_x: where they are added.
        facets: of each point or pair.
        sign: 1 where the normal is that of the facet, -1 where it is opposite.
        side: 0 for slaves, 1 for masters.
        first: column of the first coordinate.
    """
    n, slopes = sign * facet_normals(facets), sign * normal_slopes(facets)
    q, k, d, _ = slopes.shape
    i, j = np.triu_indices(d)
    e = np.arange(len(i))
    by_n = np.zeros((q, d + len(i), d))
    by_n[:, :d] = np.eye(d)
    by_n[:, d + e, i] += n[:, j]
    by_n[:, d + e, j] += n[:, i]
    rows = 1 + np.r_[d * side + np.arange(d), 2 * d + len(i) * side + e]
    change = by_n @ np.swapaxes(slopes, 1, 2).reshape(q, d, k * d)
    by_x[:, rows, first : first + k * d] += change

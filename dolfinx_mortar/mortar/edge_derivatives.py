# SPDX-License-Identifier: MIT
r"""Derivatives of the normals at the edges of a slave side in 2D, and of what acts along them.

The normal n_j of a node on an edge is a function of the sums S_j = sum w N_j g over the points of
its segments, with the `products` g of the normals of both sides, see `dolfinx_mortar.mortar.edges`:

    dn_j = dn_j/dS_j sum (d(w N_j) g + w N_j dg).

A facet turns by dn = -t (n.(dx_2 - dx_1)) / L, t being its direction and L its length. Weights and
places of the points move with both sides, and with the averaged normals along which they project.
"""

from dataclasses import dataclass

import numpy as np

import dolfinx
from dolfinx_mortar.algebra.block_sums import Blocks
from dolfinx_mortar.arrays import Bools, Floats
from dolfinx_mortar.geometry.facets import Facets, facet_normals, points_of
from dolfinx_mortar.geometry.line_derivatives import differentiate_points
from dolfinx_mortar.geometry.segments import Segments
from dolfinx_mortar.mortar.derivatives import Tractions, log_slopes
from dolfinx_mortar.mortar.edges import edge_normals_by_sums, edged, products, sums_at_edges
from dolfinx_mortar.mortar.integrals import some_points
from dolfinx_mortar.mortar.pairing import Pairing, received_facets
from dolfinx_mortar.mortar.surface import coordinates, facets_at, nodal_normals


@dataclass(frozen=True, eq=False)
class EdgeDerivatives:
    """What this rank's slave facets add; numbers of master nodes follow those of slave nodes."""

    n_x: Blocks  # normals of the nodes on edges by coordinates
    n_n: Blocks  # the same by the averaged normals
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
        pairing: The pair of surfaces, in 2D.
        u: Displacement.
        segments: Its segments at X + u, of all slave facets or of some.
        edges: Local slave nodes (n,) on edges.
        Phi: Weighted functions (q, k) of `open_duals`.
        given: Normals and tractions, and their changes with the normals before Dirichlet data
            restricts them; those off the edges are not used.
    """
    sums = sums_at_edges(pairing, segments, u, edges)
    by_sums = np.zeros((len(edges), 2, sums.shape[1]))
    by_sums[edges] = edge_normals_by_sums(sums, 2)
    slave, some = pairing.slave, edged(pairing.slave, edges, segments)
    master, x, Phi = received_facets(pairing, u), coordinates(slave, u), Phi[some]
    segments = some_points(segments, some)
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
    on = edges[own][..., None, None]
    forces = np.hstack([N, -N_m])[:, :, None, None, None] * np.swapaxes(
        (Phi[..., None, None] * given.changes[own] * on)[:, None], 2, 3
    )
    o = points_of(master, m, segments.xi_m) - points_of(facets, s, segments.xi_s)
    gaps = Phi[..., None] * (o[:, None, None] @ (given.turning[own] * on))[:, :, 0]
    each = own.reshape(-1, 1)
    return EdgeDerivatives(
        Blocks(own, both, n_x.reshape(q, k, 2, both.shape[1], 2)),
        Blocks(own, own, normals[..., 2 * k : 4 * k].reshape(q, k, 2, k, 2)),
        Blocks(both, own, forces),
        Blocks(each, each, gaps.reshape(-1, 1, 1, 1, 2)),
    )


def _add_turning(by_x: Floats, facets: Facets, sign: float, side: int, first: int) -> None:
    """Add the derivatives of `products` (q, c, p) by the nodes of the facets (q,) of one side.

    Args:
        by_x: where they are added.
        facets: of each point.
        sign: 1 where the normal is that of the facet, -1 where it is opposite.
        side: 0 for slaves, 1 for masters.
        first: column of the first coordinate.
    """
    ends = facets.element.vertices
    chord = facets.x[:, ends[1]] - facets.x[:, ends[0]]
    n, square = sign * facet_normals(facets), (chord**2).sum(axis=1)
    turn = -chord[:, :, None] * n[:, None] / square[:, None, None]
    i, j = np.triu_indices(2)
    by_n = np.zeros((len(n), 5, 2))
    by_n[:, :2] = np.eye(2)
    for row, (a, b) in enumerate(zip(i, j, strict=True)):
        by_n[:, 2 + row, a] += n[:, b]
        by_n[:, 2 + row, b] += n[:, a]
    rows = np.r_[1 + 2 * side : 3 + 2 * side, 5 + 3 * side : 8 + 3 * side]
    change = by_n @ turn
    for end, direction in zip(ends, (-1.0, 1.0), strict=True):
        for h in range(2):
            by_x[:, rows, first + 2 * end + h] += direction * change[:, :, h]

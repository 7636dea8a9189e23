# SPDX-License-Identifier: MIT
"""Mortar operators D and M of a pair of surfaces, and P = D^-1 M.

    D_jl = int Phi_j N_l^s,      M_jl = int Phi_j N_l^m      over the covered part of the slave side

(eqs. 19 and 20 of the paper). D is diagonal over the nodes with a multiplier, but for mid-side
nodes that depend on vertices.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

import dolfinx
from dolfinx.common import timed
from dolfinx_mortar.algebra.parallel import any_rank
from dolfinx_mortar.arrays import CHUNK, Bools, Floats
from dolfinx_mortar.geometry.elements import FacetElement
from dolfinx_mortar.geometry.segments import Segments
from dolfinx_mortar.mortar.curvature_correction import SmoothSide, point_heights, point_motions
from dolfinx_mortar.mortar.duals import (
    Coverage,
    choose_duals,
    find_coverage,
    node_weights,
    weighted_duals,
)
from dolfinx_mortar.mortar.integrals import Integrated, integrate_values, sums_of_products
from dolfinx_mortar.mortar.pairing import Pairing

SmoothSides = tuple[SmoothSide, SmoothSide]


@dataclass(frozen=True, eq=False)
class MortarOperators:
    """D, M and P in one configuration, for c choices of the nodes with a multiplier.

    One choice per direction of the multipliers, as Dirichlet data allow. Nodes are the n owned
    slave nodes; entries follow the patterns of the pairing.
    """

    segments: Segments
    normals: Floats  # (n, d) outward, unit
    kept: Bools  # (n, c) nodes with a multiplier
    D: Floats  # (e, c) entries of D; 0 in rows of other nodes
    M: Floats  # (f, c) entries of M
    weight: Floats  # (n, c) D_jj, 0 where not kept
    P: Floats  # (g, c) D_jj^-1 (M - D_other), D_other off-diagonal
    heights: Floats  # (n,) of smooth surfaces, to be subtracted from gaps
    coverage: Coverage
    motions: Floats | None = None  # (f, d, d) D_jj^-1 int Phi_j A_l, see `point_motions`


def create_operators(
    pairing: Pairing,
    u: dolfinx.fem.Function | None,
    segments: Segments,
    normals: Floats,
    allowed: Bools,
    *,
    heights_of: SmoothSides | None = None,
    motions_of: SmoothSides | None = None,
) -> MortarOperators:
    """Integrate D and M over segments at X + u (collective).

    Args:
        normals: outward unit normals (n, d) of the local slave nodes.
        allowed: (n, c) local slave nodes that may carry a multiplier.
        heights_of: smooth surfaces at X for heights.
        motions_of: smooth surfaces at X for offsets in P.
    """
    comm, own = pairing.slave.V.mesh.comm, slice(None, pairing.slave.owned)
    weights = node_weights(pairing, segments)
    # choices that keep the same nodes share one integration
    differ = any_rank(comm, *(allowed != allowed[:, :1]).any(axis=0))
    choices = [c if differ[c] else 0 for c in range(allowed.shape[1])]
    Phi: dict[int, Floats] = {}
    matrices: dict[int, tuple[Floats, Floats]] = {}
    for c in sorted(set(choices)):
        keep, Phi[c] = choose_duals(pairing, segments, weights, allowed[:, c])
        matrices[c] = integrate_matrices(pairing, segments, keep, Phi[c])
    entries_D, entries_M = (np.column_stack([matrices[c][i] for c in choices]) for i in (0, 1))
    weight = np.zeros((pairing.slave.owned, len(choices)))
    places, nodes = pairing.diagonal
    weight[nodes] = entries_D[places]
    P = np.concatenate([-entries_D[pairing.off_diagonal], entries_M]) * inverse(weight)[pairing.row]
    heights: Floats = np.zeros(pairing.slave.owned)
    motions: Floats | None = None
    if heights_of is not None:
        at_points = point_heights(pairing, segments, u, heights_of)
        heights = mean_values(pairing, segments, Phi[0], weight[:, 0], at_points)
    if motions_of is not None:
        at = point_motions(segments, motions_of)
        row = pairing.row[len(pairing.off_diagonal) :]
        total = integrate_motions(pairing, segments, [Phi[c] for c in choices], at)
        motions = total * inverse(weight)[row, :, None]
    return MortarOperators(
        segments=segments,
        normals=normals[own],
        kept=weight > 0,
        D=entries_D,
        M=entries_M,
        weight=weight,
        P=P,
        heights=heights,
        coverage=find_coverage(pairing, segments, *weights),
        motions=motions,
    )


def inverse(weight: Floats) -> Floats:
    """Return 1 / D_jj, zero at nodes without multiplier."""
    return np.divide(1.0, weight, out=np.zeros_like(weight), where=weight > 0)


@timed("~Mortar: assemble D and M")
def integrate_matrices(
    pairing: Pairing,
    segments: Segments,
    keep: Bools,
    Phi: Floats | None = None,
) -> tuple[Floats, Floats]:
    """Return the entries of D (eq. 19) and M (eq. 20) on the patterns of the pairing (collective).

    Args:
        keep: (n,) slave nodes with a multiplier, equal on all ranks.
        Phi: of `weighted_duals`, if known.

    Returns:
        Entries (e,) of D and (f,) of M. Rows of removed nodes vanish; their columns in D do not.
        Over the kept nodes D is exactly diagonal, but for mid-side nodes that depend on vertices.
    """
    N_m = pairing.master.element.shape_functions(segments.xi_m)
    kept = keep[pairing.slave.facets]
    Phi = weighted_duals(pairing, segments, keep) if Phi is None else Phi
    paired = np.unique(pairing.pairs[:, 0])
    blocks_D = sums_of_products(Phi, segments.N, segments.slave, len(kept))[paired]
    both = kept[paired][:, :, None] & kept[paired][:, None, :]
    blocks_D[both & ~in_D(pairing.slave.element)] = 0.0
    blocks_M = sums_of_products(Phi, N_m, segments.pair, len(pairing.pairs))
    return pairing.D.sum(blocks_D), pairing.M.sum(blocks_M)


def in_D(element: FacetElement) -> Bools:
    """Return (k, k) entries of D between kept nodes of a facet."""
    found = np.eye(element.nodes, dtype=bool)
    for middle, *ends in element.shares:
        found[middle, ends] = True
    return found


@timed("~Mortar: assemble motions")
def integrate_motions(
    pairing: Pairing,
    segments: Segments,
    Phi: Sequence[Floats],
    motions: Callable[[slice], Floats],
) -> Floats:
    """Return int Phi_j A_l (f, d, d) at the entries of M (collective).

    Phi (q, k) of `weighted_duals` for each row of A_l; for motions see `point_motions`.
    """
    d, k, m = len(Phi), pairing.slave.element.nodes, pairing.master.element.nodes
    blocks = np.zeros((d, len(pairing.pairs), k, m * d))
    for first in range(0, len(segments.pair), CHUNK):
        part = slice(first, first + CHUNK)
        A = motions(part)
        for i, P in enumerate(Phi):
            rows = A[:, :, i].reshape(len(A), -1)
            blocks[i] += sums_of_products(P[part], rows, segments.pair[part], len(pairing.pairs))
    components = np.moveaxis(blocks.reshape(d, -1, k, m, d), 4, 1).reshape(d * d, -1, k, m)
    columns = [pairing.M.sum(values) for values in components]
    return np.stack(columns, axis=1).reshape(-1, d, d)


def mean_values(
    pairing: Integrated, segments: Segments, Phi: Floats, weight: Floats, at_points: Floats
) -> Floats:
    """Return int Phi_j f / D_jj (n,) at the owned slave nodes, or 0 (collective).

    Phi of `weighted_duals`, weight D_jj (n,), f (q,).
    """
    total = integrate_values(pairing, segments, Phi, at_points)[: pairing.slave.owned]
    return np.asarray(total * inverse(weight))

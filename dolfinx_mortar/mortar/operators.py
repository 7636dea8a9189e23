# SPDX-License-Identifier: MIT
"""Mortar operators over the covered part of the slave side (eqs. 19 and 20), and P = D^-1 M.

    D_jl = int Phi_j N_l^s,      M_jl = int Phi_j N_l^m

D is diagonal over the nodes with a multiplier, except at mid-side nodes that depend on vertices.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

import dolfinx
from dolfinx.common import timed
from dolfinx_mortar.algebra.csr import Triplets
from dolfinx_mortar.algebra.parallel import any_rank
from dolfinx_mortar.common.arrays import CHUNK, Bools, Floats, Ints, Longs, flat
from dolfinx_mortar.geometry.facets import (
    FacetElement,
    points_of,
    rule_on,
    scaled_normals,
    tributary_weights,
)
from dolfinx_mortar.geometry.segments import Segments
from dolfinx_mortar.mortar.curvature_correction import SmoothSides, point_heights, point_motions
from dolfinx_mortar.mortar.duals import (
    Coverage,
    choose_duals,
    find_coverage,
    node_weights,
    weighted_duals,
)
from dolfinx_mortar.mortar.integrals import Integrated, integrate_values, sums_of_products, weigh
from dolfinx_mortar.mortar.pairing import Pairing, Weight, create_triplets, pattern_of_P
from dolfinx_mortar.mortar.surface import Surface, facets_at, mean_facet_length


class MortarOperators(NamedTuple):
    """D, M and P in one configuration, for c choices of the nodes with a multiplier.

    One per direction of the multipliers, as Dirichlet data allow, at the n owned slave nodes;
    entries follow the pairing.
    """

    segments: Segments
    normals: Floats  # (n, d) outward, unit
    kept: Bools  # (n, c) nodes with a multiplier
    D: Floats  # (e, c) entries; 0 in rows without multiplier
    M: Floats  # (f, c) entries
    weight: Floats  # (n, c) D_jj, 0 where not kept
    P: Floats  # (g, c) D_jj^-1 (M - D_other)
    heights: Floats  # (n,) of smooth surfaces, subtracted from gaps
    coverage: Coverage
    motions: Floats | None = None  # (f, d, d) D_jj^-1 int Phi_j A_l


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
        allowed: (n, c) local slave nodes that may have a multiplier.
        heights_of: smooth surfaces at X for heights.
        motions_of: the same for offsets in P.
    """
    comm, own = pairing.slave.V.mesh.comm, slice(None, pairing.slave.owned)
    weights = node_weights(pairing, segments)
    # equal choices share one integration
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
        heights = mean_values(pairing, segments, Phi[0], weight[:, :1], at_points[:, None])[:, 0]
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
    """Entries of D (e,) and M (f,) on the patterns of the pairing (collective).

    `keep` (n,) is equal on all ranks. Rows without multiplier vanish, their columns in D do not.
    """
    N_m = pairing.master.element.shape_functions(segments.xi_m)
    Phi = weighted_duals(pairing, segments, keep) if Phi is None else Phi
    blocks_D = _blocks_of_D(pairing.slave, segments, keep, Phi)[np.unique(pairing.pairs[:, 0])]
    blocks_M = sums_of_products(Phi, N_m, segments.pair, len(pairing.pairs))
    return pairing.D.sum(blocks_D), pairing.M.sum(blocks_M)


def _blocks_of_D(slave: Surface, segments: Segments, keep: Bools, Phi: Floats) -> Floats:
    """Blocks (m, k, k); between kept nodes only D_jj and those of mid-side nodes."""
    kept, mine = keep[slave.facets], np.eye(slave.element.nodes, dtype=bool)
    for middle, *ends in slave.element.shares:
        mine[middle, ends] = True
    blocks = sums_of_products(Phi, segments.N, segments.slave, len(kept))
    blocks[kept[:, :, None] & kept[:, None] & ~mine] = 0.0
    return blocks


@timed("~Mortar: assemble motions")
def integrate_motions(
    pairing: Pairing,
    segments: Segments,
    Phi: Sequence[Floats],
    motions: Callable[[slice], Floats],
) -> Floats:
    """Int Phi_j A_l (f, d, d) at the entries of M, see `point_motions` (collective)."""
    d, k, m = len(Phi), pairing.slave.element.nodes, pairing.master.element.nodes
    blocks = np.zeros((d, len(pairing.pairs), k, m * d))
    for first in range(0, len(segments.pair), CHUNK):
        part = slice(first, first + CHUNK)
        A = motions(part)
        for i, P in enumerate(Phi):
            rows = flat(A[:, :, i])
            blocks[i] += sums_of_products(P[part], rows, segments.pair[part], len(pairing.pairs))
    components = np.moveaxis(blocks.reshape(d, -1, k, m, d), 4, 1).reshape(d * d, -1, k, m)
    columns = [pairing.M.sum(values) for values in components]
    return np.stack(columns, axis=1).reshape(-1, d, d)


def mean_values(
    pairing: Integrated, segments: Segments, Phi: Floats, weight: Floats, at_points: Floats
) -> Floats:
    """Int Phi_j f / D_jj (n, c) at the owned slave nodes, or 0, for f (q, c) (collective).

    The weights D_jj are (n, 1).
    """
    total = integrate_values(pairing, segments, Phi, at_points)[: pairing.slave.owned]
    return total * inverse(weight)


class WholeSide(NamedTuple):
    """A slave side and the pattern of D."""

    slave: Surface
    D: Triplets  # of all facets
    row: Ints  # (e,) owned slave node of each entry off the diagonal
    column: Longs  # (e,) its global node
    off_diagonal: Ints  # (e,) its position in D
    diagonal: tuple[Ints, Ints]  # positions of D_jj in D, and nodes j
    facet_length: float  # mean, at X
    weight: Weight | None = None  # of all integrals, at X


class SideOperators(NamedTuple):
    """D of a side, see `MortarOperators`."""

    segments: Segments  # whole facets
    x: Floats  # (q, d) their points
    Phi: Floats  # (q, k) weighted dual functions
    kept: Bools  # (n, 1) owned
    weight: Floats  # (n, 1) D_jj, 0 where not kept
    P: Floats  # (e, 1) - D_jl / D_jj off the diagonal
    coverage: Coverage


def create_whole_side(slave: Surface, weight: Weight | None) -> WholeSide:
    """Fix the pattern of D of all facets; collective."""
    nodes = slave.V.dofmap.index_map.local_to_global(slave.nodes)[slave.facets]
    D = create_triplets(slave, nodes, nodes)
    length = mean_facet_length(slave)
    return WholeSide(slave=slave, D=D, **pattern_of_P(slave, D), facet_length=length, weight=weight)


def rule_of(element: FacetElement) -> tuple[Floats, Floats]:
    """Points and weights, sum 1, exact for products of functions."""
    if len(element.rule[1]) >= element.nodes:
        return element.rule
    return rule_on("triangle", 4)


def whole_facets(side: WholeSide, x: Floats, facing: Bools) -> tuple[Segments, Floats]:
    """Facing facets (m,) as segments, and their points (q, d)."""
    slave = side.slave
    facets, element = facets_at(slave, x), slave.element
    xi, weights = rule_of(element)
    jacobians = np.linalg.norm(scaled_normals(facets, xi), axis=2) * weights
    some = np.flatnonzero(facing).astype(np.int32)
    which, at = some.repeat(len(xi)), np.tile(xi, (len(some), 1))
    none, weight = np.full(len(which), -1, dtype=np.int32), jacobians[some].ravel()
    sums = tributary_weights(facets)
    segments = Segments(none, which, none, at, 0.0 * at, weight, sums, element)
    return weigh(slave, side.weight, segments, facets), points_of(facets, which, at)


def integrate_side(side: WholeSide, x: Floats, facing: Bools, allowed: Bools) -> SideOperators:
    """Integrate D over the facing facets (m,) of this rank, at x; collective."""
    slave = side.slave
    segments, points = whole_facets(side, x, facing)
    weights = node_weights(side, segments)
    keep, Phi = choose_duals(side, segments, weights, allowed)
    entries = side.D.sum(_blocks_of_D(slave, segments, keep, Phi))
    weight = np.zeros((slave.owned, 1))
    places, nodes = side.diagonal
    weight[nodes, 0] = entries[places]
    return SideOperators(
        segments=segments,
        x=points,
        Phi=Phi,
        kept=weight > 0.0,
        weight=weight,
        P=-entries[side.off_diagonal, None] * inverse(weight)[side.row],
        coverage=find_coverage(side, segments, *weights),
    )

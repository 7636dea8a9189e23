# SPDX-License-Identifier: MIT
"""A slave side without a master: D and mean values over whole facets.

    D_jl = int Phi_j N_l,      mean_j f = int Phi_j f / D_jj

over the whole facets that face the tool, with the dual functions of the nodes with a multiplier.
"""

from dataclasses import dataclass

import numpy as np

from dolfinx_mortar.algebra.triplets import Triplets
from dolfinx_mortar.arrays import Bools, Floats, Ints, Longs
from dolfinx_mortar.geometry.elements import FacetElement, triangle_rule
from dolfinx_mortar.geometry.facets import points_of, scaled_normals, tributary_weights
from dolfinx_mortar.geometry.segments import Segments
from dolfinx_mortar.mortar.duals import (
    Coverage,
    choose_duals,
    find_coverage,
    node_weights,
)
from dolfinx_mortar.mortar.integrals import sums_of_products
from dolfinx_mortar.mortar.operators import in_D, inverse, mean_values
from dolfinx_mortar.mortar.pairing import Weight, pattern_of_P
from dolfinx_mortar.mortar.surface import Surface, facets_at, mean_facet_length


@dataclass(frozen=True, eq=False)
class WholeSide:
    """A slave side and the pattern of D between its nodes."""

    slave: Surface
    D: Triplets  # between nodes of V, of all facets
    row: Ints  # (e,) owned slave node of each entry of D off its diagonal
    column: Longs  # (e,) its global node
    off_diagonal: Ints  # (e,) its position among D's entries
    diagonal: tuple[Ints, Ints]  # positions of D_jj among D's entries, and nodes j
    facet_length: float  # mean, at X
    weight: Weight | None = None  # of all integrals, at X; None for 1


@dataclass(frozen=True, eq=False)
class SideOperators:
    """D of a side in one configuration; see `MortarOperators`."""

    segments: Segments  # whole facets
    x: Floats  # (q, d) their points
    Phi: Floats  # (q, k) weighted dual functions
    keep: Bools  # (local slave nodes,)
    kept: Bools  # (n, 1) owned
    weight: Floats  # (n, 1) D_jj, 0 where not kept
    P: Floats  # (e, 1) - D_jl / D_jj off the diagonal
    coverage: Coverage


def create_whole_side(slave: Surface, weight: Weight | None) -> WholeSide:
    """Fix the pattern of D for all facets of a side; collective."""
    index_map = slave.V.dofmap.index_map
    nodes = index_map.local_to_global(slave.nodes)[slave.facets]
    block = (*nodes.shape, nodes.shape[1])
    places = (np.broadcast_to(v, block) for v in (nodes[:, :, None], nodes[:, None]))
    D = Triplets(slave.V.mesh.comm, index_map, *places)
    length = mean_facet_length(slave)
    return WholeSide(slave=slave, D=D, **pattern_of_P(slave, D), facet_length=length, weight=weight)


def rule_of(element: FacetElement) -> tuple[Floats, Floats]:
    """Return points (q, d-1) and weights (q,), sum 1, exact for products of functions."""
    if len(element.rule[1]) >= element.nodes:
        return element.rule
    return triangle_rule(4)


def whole_facets(side: WholeSide, x: Floats, facing: Bools) -> tuple[Segments, Floats]:
    """Return facing facets (m,) at x (n, d) as segments, and their points (q, d)."""
    slave = side.slave
    facets, element = facets_at(slave, x), slave.element
    xi, weights = rule_of(element)
    jacobians = np.linalg.norm(scaled_normals(facets, xi), axis=2) * weights
    m, q = jacobians.shape
    which = np.repeat(np.arange(m, dtype=np.int32), q)
    at, whole = np.tile(xi, (m, 1)), None
    if side.weight is not None:  # at X, where it is positive
        points, _ = element.rule
        others = np.repeat(np.arange(m, dtype=np.int32), len(points))
        at_X = facets_at(slave, slave.X)
        jacobians *= side.weight(points_of(at_X, which, at)).reshape(m, q)
        at_rule = points_of(at_X, others, np.tile(points, (m, 1)))
        whole = side.weight(at_rule).reshape(m, len(points))
    some = facing[which]
    which, at = which[some], at[some]
    none = np.full(len(which), -1, dtype=np.int32)
    sums = tributary_weights(facets, whole)
    weight = jacobians.ravel()[some]
    segments = Segments(none, which, none, at, 0.0 * at, weight, sums, element)
    return segments, points_of(facets, which, at)


def integrate_side(side: WholeSide, x: Floats, facing: Bools, allowed: Bools) -> SideOperators:
    """Integrate D over the facing facets (m,) of this rank, at x (n, d); collective.

    Only `allowed` local nodes (n,) may carry a multiplier.
    """
    slave, own = side.slave, slice(None, side.slave.owned)
    segments, points = whole_facets(side, x, facing)
    weights = node_weights(side, segments)
    keep, Phi = choose_duals(side, segments, weights, allowed)
    blocks = sums_of_products(Phi, segments.N, segments.slave, len(slave.facets))
    among = keep[slave.facets]
    blocks[(among[:, :, None] & among[:, None]) & ~in_D(slave.element)] = 0.0
    entries = side.D.sum(blocks)
    weight = np.zeros((slave.owned, 1))
    places, nodes = side.diagonal
    weight[nodes, 0] = entries[places]
    return SideOperators(
        segments=segments,
        x=points,
        Phi=Phi,
        keep=keep,
        kept=keep[own, None] & (weight > 0.0),
        weight=weight,
        P=-entries[side.off_diagonal, None] * inverse(weight)[side.row],
        coverage=find_coverage(side, segments, *weights),
    )


def means(side: WholeSide, found: SideOperators, at_points: Floats) -> Floats:
    """Return int Phi_j f / D_jj (n, c) at the owned nodes for f (q, c), or 0; collective."""
    weight = found.weight[:, 0]
    at = side, found.segments, found.Phi, weight
    return np.stack([mean_values(*at, f) for f in at_points.T], axis=1)

# SPDX-License-Identifier: MIT
r"""Derivatives of the heights of smooth surfaces over pairs of facets in 3D.

Over both facets h = sum_ab N_a N_b c_ab / 2, see
`dolfinx_mortar.mortar.curvature_correction.point_heights`. In first order the c_ab are those of the
surface that the sides share. With the edges e of a facet and the curvatures K of the other one,
functions of the coordinates of its nodes,

    c_ab = (c_0 - e.K e) / 2,      dc_ab = -e.K de - e.dK e / 2.

In second order each side has its own, which only strains of the bodies change; these are held.
"""

from dataclasses import dataclass

import numpy as np

import dolfinx
from dolfinx_mortar.arrays import Floats, Ints, Longs
from dolfinx_mortar.geometry.curvature import (
    common_sagittas,
    curvature_slopes,
    edges,
    height_element,
    node_pairs,
)
from dolfinx_mortar.geometry.elements import FacetElement
from dolfinx_mortar.geometry.facet_derivatives import Heights
from dolfinx_mortar.geometry.facets import Facets
from dolfinx_mortar.mortar.curvature_correction import (
    Curved,
    SmoothSide,
    facet_stretches,
    find_curved,
)
from dolfinx_mortar.mortar.integrals import sums_of_products
from dolfinx_mortar.mortar.pairing import Pairing


@dataclass(frozen=True, eq=False)
class PairHeights:
    """Heights over pairs (p,) of facets with k and l nodes, and their derivatives."""

    slave: FacetElement
    master: FacetElement
    c: tuple[Floats, Floats]  # (p, e) c_ab over slave and master facets
    by_x: tuple[Floats, Floats] | None  # (p, e, k + l, 3) their derivatives; None for 0

    def at(self, pair: Longs, xi_s: Floats, xi_m: Floats) -> Heights:
        """Return the heights at points (q,) of pairs, and their derivatives by xi_m."""
        sides = zip((self.slave, self.master), (xi_s, xi_m), self.c, strict=True)
        (h_s, _), (h_m, y) = (_heights(element, xi, c, pair) for element, xi, c in sides)
        slopes = height_element(self.master, self.c[1]).derivatives(xi_m)
        return Heights(h_s + h_m, 2.0 * (y[:, None] @ slopes)[:, 0])

    def integrals(self, Phi: Floats, pair: Ints, xi_s: Floats, xi_m: Floats) -> Floats:
        """Return int Phi_j dh (p, k, k + l, 3) by the nodes, at given points of both facets.

        Where `by_x` is not None.

        Args:
            Phi: Values of Phi_j times weights at the points (q, k).
            pair: Their pairs (q,).
            xi_s: Points (q, 2) on slave facets.
            xi_m: Points (q, 2) on master facets.
        """
        assert self.by_x is not None
        p, k, (size, d) = len(self.by_x[0]), Phi.shape[1], self.by_x[0].shape[2:]
        total = np.zeros((p, k, size, d))
        sides = (self.slave, xi_s), (self.master, xi_m)
        for (element, xi), by_x in zip(sides, self.by_x, strict=True):
            means = sums_of_products(Phi, _products(element, xi), pair, p)
            total += (means @ by_x.reshape(p, by_x.shape[1], size * d)).reshape(total.shape)
        return total


def _heights(element: FacetElement, xi: Floats, c: Floats, pair: Longs) -> tuple[Floats, Floats]:
    """Return h (q,) over facets, and half of its derivatives (q, k) by the N_a."""
    element = height_element(element, c)
    i, j = node_pairs(element)
    N, S = element.shape_functions(xi), np.zeros((len(c), *2 * [element.nodes]))
    S[:, i, j] = S[:, j, i] = c / 4
    y = (S[pair] @ N[:, :, None])[:, :, 0]
    return (N * y).sum(axis=1), y


def _products(element: FacetElement, xi: Floats) -> Floats:
    """Return N_a N_b / 2 (q, e) of the pairs of nodes of a facet of first order."""
    (i, j), N = node_pairs(element), element.shape_functions(xi)
    return N[:, i] * N[:, j] / 2


def pair_heights(
    pairing: Pairing,
    pairs: Ints,
    u: dolfinx.fem.Function,
    sides: tuple[SmoothSide, SmoothSide],
) -> PairHeights:
    """Return the heights over pairs of facets in 3D; collective.

    Args:
        pairs: (p,) which of its candidates.
        sides: the smooth surfaces at X.
    """
    a, b = find_curved(pairing, u, sides, pairs)
    elements = a.facets.element, b.facets.element
    s, m = pairing.pairs[pairs].T
    if pairing.slave.element.degree > 1:
        stretches = facet_stretches(pairing, u)
        return PairHeights(
            *elements, (a.sagitta * stretches[0][s], b.sagitta * stretches[1][m]), None
        )
    of_s = [_by_own(a.facets, b.K), _by_other(a.facets, b, m)]
    of_m = [_by_other(b.facets, a, s), _by_own(b.facets, a.K)]
    by_x = np.concatenate(of_s, axis=2), np.concatenate(of_m, axis=2)
    c = common_sagittas(a.facets, a.sagitta, b.K), common_sagittas(b.facets, b.sagitta, a.K)
    return PairHeights(*elements, c, by_x)


def _by_own(facets: Facets, K: Floats) -> Floats:
    """Return the derivatives (p, e, k, 3) of c_ab by the nodes of their own facets."""
    change = np.einsum("pij,pej->pei", K, edges(facets))
    result = np.zeros((*change.shape[:2], facets.x.shape[1], 3))
    for e, (first, last) in enumerate(zip(*node_pairs(facets.element), strict=True)):
        result[:, e, first], result[:, e, last] = change[:, e], -change[:, e]
    return result


def _by_other(facets: Facets, other: Curved, which: Ints) -> Floats:
    """Return the derivatives (p, e, l, 3) of c_ab by the nodes of the other facets.

    Args:
        facets: the facets (p,) themselves.
        other: those of the other side (p,).
        which: their numbers (p,): a facet is in several pairs.
    """
    _, first, again = np.unique(which, return_index=True, return_inverse=True)
    dK, e = curvature_slopes(other.facets[first], other.sagitta[first]), edges(facets)
    both = (e[:, :, :, None] * e[:, :, None]).reshape(*e.shape[:2], 9)
    by_K = dK.reshape(len(first), 3 * dK.shape[1], 9)[again]
    change = -0.5 * both @ np.swapaxes(by_K, 1, 2)
    return np.asarray(change.reshape(*e.shape[:2], *other.facets.x.shape[1:]))

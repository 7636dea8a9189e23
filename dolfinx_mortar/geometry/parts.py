# SPDX-License-Identifier: MIT
"""The first-order facets that clipping in space sees: of each facet itself, or its four parts.

A second-order facet is divided at the middles of its edges. Its parts are projected, clipped and
mapped back like any other facets; points then belong to the facet whose part they lie in, and to
its surface as it is, curved or not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_mortar.arrays import Floats, Ints
from dolfinx_mortar.geometry.elements import FacetElement
from dolfinx_mortar.geometry.facets import Facets, facet_normals
from dolfinx_mortar.geometry.polynomials import area_ratios, coefficients, meet, points_at


def count(element: FacetElement) -> int:
    """Return how many parts s a facet has."""
    return len(element.sub_facets)


def parts_of(facets: Facets) -> Facets:
    """Return the parts (m * s,) of facets (m,), those of a facet one after the other."""
    element = facets.element
    if element.part is None:
        return facets
    x = facets.x[:, np.array(element.sub_facets)]
    return Facets(element.part, np.ascontiguousarray(x.reshape(-1, *x.shape[2:])))


def pairs_of_parts(pairs: Ints, slave: FacetElement, master: FacetElement) -> tuple[Ints, Ints]:
    """Return the pairs of parts (p', 2), ordered by the slave's, and the pair (p',) of each.

    >>> from dolfinx_mortar.geometry.elements import TRI3
    >>> pairs, of = pairs_of_parts(np.array([[0, 3], [0, 5]], dtype=np.int32), TRI3, TRI3)
    >>> pairs.tolist(), of.tolist()
    ([[0, 3], [0, 5]], [0, 1])
    """
    a, b = count(slave), count(master)
    if a * b == 1:
        return pairs, np.arange(len(pairs), dtype=np.int32)
    of = np.repeat(np.arange(len(pairs)), a * b)
    i, j = (np.tile(k.ravel(), len(pairs)) for k in np.indices((a, b)))
    every = np.stack([pairs[of, 0] * a + i, pairs[of, 1] * b + j], axis=1)
    order = np.argsort(every[:, 0], kind="stable")
    return every[order].astype(np.int32), of[order].astype(np.int32)


def to_facets(element: FacetElement, part: Ints, xi: Floats) -> Floats:
    """Return the reference coordinates (q, d-1) on facets of points xi on their parts (q,)."""
    if element.part is None:
        return xi
    x = element.points[np.array(element.sub_facets)]  # (s, k', d-1)
    corners = Facets(element.part, np.pad(x, ((0, 0), (0, 0), (0, 1))))
    return np.asarray(points_at(coefficients(corners), part % count(element), xi)[:, :2])


def stretches(facets: Facets, which: Ints, xi: Floats, part: Ints, xi_part: Floats) -> Floats:
    """Return the area (q,) of facets at points over that of their parts there.

    Args:
        facets: the facets (m,).
        which: (q,) facet of each point.
        xi: (q, 2) its coordinates there.
        part: (q,) part of each point.
        xi_part: (q, 2) its coordinates there.
    """
    parts = parts_of(facets)
    scale = facets.element.size / (count(facets.element) * parts.element.size)
    ratios = area_ratios(coefficients(facets), which, xi, coefficients(parts), part, xi_part)
    return np.asarray(scale * ratios)


@dataclass(frozen=True, eq=False)
class PartPoints:
    """Quadrature points on parts of slave and master facets that lie over each other."""

    slave: Ints  # (q,) part
    master: Ints  # (q,) part
    xi_s: Floats  # (q, 2) reference coordinates on the slave's part
    xi_m: Floats  # (q, 2) and on the master's
    weight: Floats  # (q,) of the slave's part


def on_facets(slave: Facets, master: Facets, points: PartPoints) -> tuple[Floats, Floats, Floats]:
    """Return xi_s, xi_m (q, 2) and weights (q,) of points on the facets' true surfaces.

    Args:
        slave: Slave facets (ms,), whose parts are projected along their mean normals.
        master: Master facets (mm,).
        points: The points on their parts.
    """
    s, m = points.slave // count(slave.element), points.master // count(master.element)
    xi_s = to_facets(slave.element, points.slave, points.xi_s)
    weight = points.weight * stretches(slave, s, xi_s, points.slave, points.xi_s)
    xi_m = to_facets(master.element, points.master, points.xi_m)
    x, n = points_at(coefficients(slave), s, xi_s), facet_normals(parts_of(slave))
    return xi_s, meet(master, m, xi_m, x, n, points.slave), weight

# SPDX-License-Identifier: MIT
"""Thickness of a body behind the facets of a side that encloses it."""

import numpy as np

from dolfinx_mortar.arrays import HALF_OF_DIGITS, Floats
from dolfinx_mortar.geometry.facets import (
    Facets,
    are_inside,
    bounding_balls,
    facet_normals,
    facet_sizes,
)
from dolfinx_mortar.geometry.segments import Cones, are_facing, find_meeting


def thickness(facets: Facets, others: Facets) -> Floats:
    """Return the thickness (m,) of the body behind facets.

    The distance from the middle of a facet, against its outward normal, to the nearest of the other
    facets that faces the opposite way; infinite where there is none. Facets are taken as the flat
    ones of their vertices.

    Args:
        facets: Facets (m,).
        others: Facets of the same side, with or without these ones.

    Example:
        >>> from dolfinx_mortar.geometry.elements import LINE2
        >>> x = np.array([[[0.0, 0], [2, 0]], [[3, 1], [-1, 1]], [[2, 5], [0, 5]]])
        >>> strip = Facets(LINE2, x)
        >>> thickness(strip, strip)
        array([1., 1., 5.])
    """
    corners = np.array(facets.element.vertices)
    x, y = facets.x[:, corners], others.x[:, corners]
    n, n_other = facet_normals(facets), facet_normals(others)
    size = facet_sizes(x)
    middle = x.mean(axis=1)
    rays = Cones(middle, n, HALF_OF_DIGITS * size, np.zeros(len(x)))
    a, b = find_meeting(rays, *bounding_balls(y)).T
    across = are_facing(n[a][:, None], n_other[b])
    a, b = a[across], b[across]
    along = np.einsum("pi,pi->p", middle[a] - y[b].mean(axis=1), n_other[b])
    depth = along / np.einsum("pi,pi->p", n[a], n_other[b])
    hit = are_inside(y[b], n_other[b], middle[a] - depth[:, None] * n[a])
    hit &= depth > HALF_OF_DIGITS * size[a]  # the other face of a crack lies before the facet
    result = np.full(len(x), np.inf)
    np.minimum.at(result, a[hit], depth[hit])
    return result

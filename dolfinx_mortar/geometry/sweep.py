# SPDX-License-Identifier: MIT
"""Points that pass through facets while both move during a step."""

import numpy as np
from scipy.spatial import cKDTree

from dolfinx_mortar.arrays import HALF_OF_DIGITS, Floats, Longs
from dolfinx_mortar.geometry.elements import LINE2, TRI3
from dolfinx_mortar.geometry.facets import Facets, are_inside, facet_normals


def flat_parts(facets: Facets) -> Floats:
    """Return lines (m, 2, 2) or triangles (m or 2m, 3, 3) between the vertices of facets.

    Example:
        >>> from dolfinx_mortar.geometry.elements import QUAD4
        >>> x = np.array([[[0.0, 0, 5], [2, 0, 5], [2, 1, 5], [0, 1, 5]]])
        >>> flat_parts(Facets(QUAD4, x)).shape
        (2, 3, 3)
    """
    x = facets.x[:, np.array(facets.element.vertices)]
    if not facets.element.bilinear:
        return x
    return np.concatenate([x[:, [0, 1, 2]], x[:, [0, 2, 3]]])


def find_passing(p: tuple[Floats, Floats], x: tuple[Floats, Floats]) -> Longs:
    """Return which points (q,) pass from before a facet to behind it, ascending.

    Points, vertices and distances are taken as linear in time, which they are in the frame of a
    facet that does not rotate.

    Args:
        p: points (n, d) at the start and at the end.
        x: vertices (m, d, d) of lines or triangles at the start and at the end, with outward
            normals as in `area_vectors`.

    Example:
        >>> line = np.array([[[1.0, 0.0], [-1.0, 0.0]]])  # y > 0 is before it
        >>> points = np.array([[0.0, 1], [5, 1], [0, -1]])
        >>> find_passing((points, points * [1, -1]), (line, line)).tolist()
        [0]
        >>> find_passing((points, points * [1, -1]), (line, line - [[0.0, 3]])).tolist()
        []
    """
    if len(p[0]) == 0 or len(x[0]) == 0:
        return np.zeros(0, dtype=np.int64)
    carried = (x[1] - x[0]).mean(axis=(0, 1))  # a common translation does not count
    p, x = (p[0], p[1] - carried), (x[0], x[1] - carried)
    middle = (x[0] + x[1]).mean(axis=1) / 2
    reach = np.linalg.norm(np.stack(x) - middle[:, None], axis=3).max()
    way = np.linalg.norm(p[1] - p[0], axis=1)
    near = cKDTree(middle).query_ball_point(
        (p[0] + p[1]) / 2, way / 2 + reach * (1 + HALF_OF_DIGITS)
    )
    a = np.repeat(np.arange(len(near)), [len(b) for b in near])
    b = np.concatenate([np.array(b, dtype=np.int64) for b in near])
    element = LINE2 if x[0].shape[2] == 2 else TRI3
    normals = [facet_normals(Facets(element, y)) for y in x]
    d0, d1 = (((p[k][a] - x[k][b, 0]) * normals[k][b]).sum(axis=1) for k in (0, 1))
    crossing = (d0 > 0.0) & (d1 <= 0.0)
    a, b = a[crossing], b[crossing]
    t = (d0[crossing] / (d0 - d1)[crossing])[:, None]
    at = p[0][a] + t * (p[1][a] - p[0][a])
    facets = x[0][b] + t[:, None] * (x[1][b] - x[0][b])
    return np.unique(a[are_inside(facets, facet_normals(Facets(element, facets)), at)])

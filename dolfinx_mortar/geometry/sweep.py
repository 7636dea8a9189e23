# SPDX-License-Identifier: MIT
"""Points and facets that move during a step: which point passes through which facet, inwards."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from dolfinx_mortar.arrays import Bools, Floats, Longs
from dolfinx_mortar.geometry.facets import Facets
from dolfinx_mortar.geometry.tolerances import HALF_OF_DIGITS, TINY


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

    Points, vertices and the distances between them are taken to move linearly in time, which they
    do in the frame of a facet unless it turns.

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
    carried = (x[1] - x[0]).mean(axis=(0, 1))  # what both do together is no passing
    p, x = (p[0], p[1] - carried), (x[0], x[1] - carried)
    middle = (x[0] + x[1]).mean(axis=1) / 2
    reach = np.linalg.norm(np.stack(x) - middle[:, None], axis=3).max()
    way = np.linalg.norm(p[1] - p[0], axis=1)
    near = cKDTree(middle).query_ball_point(
        (p[0] + p[1]) / 2, way / 2 + reach * (1 + HALF_OF_DIGITS)
    )
    a = np.repeat(np.arange(len(near)), [len(b) for b in near])
    b = np.concatenate([np.array(b, dtype=np.int64) for b in near])
    distance = [_distances(p[k][a], x[k][b]) for k in (0, 1)]
    crossing = (distance[0] > 0.0) & (distance[1] <= 0.0)
    a, b = a[crossing], b[crossing]
    d0, d1 = (d[crossing] for d in distance)
    t = (d0 / (d0 - d1))[:, None]
    at = p[0][a] + t * (p[1][a] - p[0][a])
    facet = x[0][b] + t[:, None] * (x[1][b] - x[0][b])
    return np.unique(a[_inside(at, facet)])


def _distances(p: Floats, x: Floats) -> Floats:
    """Return the distances (n,) of points (n, d) before the planes of facets (n, d, d)."""
    edge = x[:, 1] - x[:, 0]
    if p.shape[1] == 2:
        n = edge[:, ::-1] * [1.0, -1.0]
    else:
        n = np.asarray(np.cross(edge, x[:, 2] - x[:, 0]), dtype=np.float64)
    size = np.maximum(np.linalg.norm(n, axis=1), TINY)
    return np.asarray(((p - x[:, 0]) * n).sum(axis=1) / size)


def _inside(p: Floats, x: Floats) -> Bools:
    """Tell whether the projections of points (n, d) lie in facets (n, d, d), edges included."""
    edges = np.swapaxes(x[:, 1:] - x[:, :1], 1, 2)  # (n, d, d - 1)
    gram = np.swapaxes(edges, 1, 2) @ edges
    right = np.einsum("nij,ni->nj", edges, p - x[:, 0])
    # of a facet that is no more than a line, or a point, any solution will do
    share = (np.linalg.pinv(gram, hermitian=True) @ right[:, :, None])[:, :, 0]
    least = np.minimum(share.min(axis=1), 1.0 - share.sum(axis=1))
    return np.asarray(least >= -HALF_OF_DIGITS)

# SPDX-License-Identifier: MIT
"""Geometry of single facets: intervals in 2D, triangles and bilinear quadrilaterals in 3D.

Facets are arrays of node coordinates x (m, k, d), the nodes in the order in which they are passed
on the way around the facet. Reference facets are [-1, 1] with k = 2, the triangle (0, 0), (1, 0),
(0, 1) with k = 3 and [-1, 1]^2 with k = 4.
"""

import numpy as np

from dolfinx_mortar.arrays import Floats

FLATTEST = 1e-10
"""A triangle is degenerate if its area is below this part of its squared radius."""
_TINY = np.finfo(float).tiny


def area_vectors(x: Floats) -> Floats:
    """Return the integral (m, d) of the outward unit normal over facets x (m, k, d).

    In 2D it is (t_y, -t_x) with t = x_2 - x_1, in 3D it points to where the nodes run around
    anticlockwise.

    Example:
        >>> area_vectors(np.array([[[0.0, 0, 5], [2, 0, 5], [2, 1, 5], [0, 1, 5]]])) + 0.0
        array([[0., 0., 2.]])
    """
    if x.shape[2] == 2:
        t = x[:, 1] - x[:, 0]
        return np.stack([t[:, 1], -t[:, 0]], axis=1)
    if x.shape[1] == 3:
        return np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]) / 2
    return np.cross(x[:, 2] - x[:, 0], x[:, 3] - x[:, 1]) / 2


def facet_normals(x: Floats) -> Floats:
    """Return the mean outward unit normals (m, d) of facets x (m, k, d).

    Example:
        >>> facet_normals(np.array([[[7.0, 7.0], [4.0, 3.0]]])) * 5
        array([[-4.,  3.]])
    """
    n = area_vectors(x)
    return n / np.maximum(np.linalg.norm(n, axis=1), _TINY)[:, None]


def bounding_balls(x: Floats) -> tuple[Floats, Floats]:
    """Return centre (m, d) and radius (m,) of balls around facets x (m, k, d)."""
    centre = x.mean(axis=1)
    return centre, np.sqrt(((x - centre[:, None]) ** 2).sum(axis=2).max(axis=1, initial=0.0))


def facet_sizes(x: Floats) -> Floats:
    """Return the diameter (m,) of facets with the node coordinates x (m, k, d)."""
    return 2 * bounding_balls(x)[1]


def shape_functions(xi: Floats, k: int = 2) -> Floats:
    """Return the values (q, k) of the nodal shape functions at reference points xi (q, d-1).

    Example:
        >>> shape_functions(np.array([[-1.0], [0.5]]))
        array([[1.  , 0.  ],
               [0.25, 0.75]])
        >>> shape_functions(np.array([[0.0, 0.5]]), 4)
        array([[0.125, 0.125, 0.375, 0.375]])
    """
    if k == 2:
        return np.concatenate([(1 - xi) / 2, (1 + xi) / 2], axis=1)
    (r, s), N = xi.T, np.empty((len(xi), k))
    if k == 3:
        N[:, 0], N[:, 1], N[:, 2] = 1 - r - s, r, s
        return N
    a, b, c, d = (1 - r) / 2, (1 + r) / 2, (1 - s) / 2, (1 + s) / 2
    for i, factors in enumerate(((a, c), (b, c), (b, d), (a, d))):
        np.multiply(*factors, out=N[:, i])
    return N


def tributary_weights(x: Floats) -> Floats:
    """Return the integrals (m, k) of N_j over whole facets x (m, k, d).

    Example:
        >>> tributary_weights(np.array([[[0.0, 0], [3, 4]]]))
        array([[2.5, 2.5]])
    """
    k = x.shape[1]
    if k < 4:
        area = np.linalg.norm(area_vectors(x), axis=1)
        return np.repeat(area[:, None] / k, k, axis=1)
    points, weights = np.polynomial.legendre.leggauss(3)
    xi = np.stack(np.meshgrid(points, points), axis=-1).reshape(-1, 2)
    # of the bilinear map centre + r a + s b + r s c
    a, b, c = (np.einsum("k,mki->mi", np.array(v) / 4, x) for v in _BILINEAR)
    normal = np.cross(a[:, None] + xi[:, 1:] * c[:, None], b[:, None] + xi[:, :1] * c[:, None])
    jacobian = np.linalg.norm(normal, axis=2) * np.outer(weights, weights).ravel()
    result: Floats = jacobian @ shape_functions(xi, 4)
    return result


_BILINEAR = ([-1, 1, 1, -1], [-1, -1, 1, 1], [1, -1, 1, -1])


def distortions(x: Floats) -> Floats:
    """Return the quality (m,) of the worst corner of facets: 1 is perfect, 0 or less is useless.

    It is the cosine between the normal at a corner of a quadrilateral and the mean normal; negative
    where the facet is folded or inverted there. Degenerate facets have 0.

    Example:
        >>> distortions(np.array([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]]))
        array([0.])
    """
    size = np.maximum(bounding_balls(x)[1], _TINY)
    large = np.linalg.norm(area_vectors(x), axis=1) > FLATTEST * size ** (x.shape[2] - 1)
    if x.shape[1] < 4:
        return large.astype(float)
    ahead, behind = np.roll(x, -1, axis=1) - x, np.roll(x, 1, axis=1) - x
    corner = np.cross(ahead, behind)
    length = np.maximum(np.linalg.norm(corner, axis=2), FLATTEST * size[:, None] ** 2)
    cosine = np.einsum("mki,mi->mk", corner, facet_normals(x)) / length
    return np.where(large, cosine.min(axis=1, initial=1.0), 0.0)

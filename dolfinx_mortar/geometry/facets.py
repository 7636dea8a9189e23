# SPDX-License-Identifier: MIT
"""Geometry of single facets: normals, sizes, weights and quality."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_mortar.common.arrays import HALF_OF_DIGITS, TINY, Bools, Floats, Ints, Longs
from dolfinx_mortar.geometry.elements import FacetElement


@dataclass(frozen=True, eq=False)
class Facets:
    """Facets of one type in space."""

    element: FacetElement
    x: Floats  # (m, k, d) nodes

    def __getitem__(self, which: Bools | Ints | Longs) -> Facets:
        return Facets(self.element, self.x[which])


def area_vectors(facets: Facets) -> Floats:
    """Integral (m, d) of the outward unit normal over facets.

    (t_y, -t_x) with t = x_2 - x_1 in 2D; in 3D nodes are anticlockwise as seen from outside.

    Example:
        >>> from dolfinx_mortar.geometry.elements import QUAD4
        >>> x = np.array([[[0.0, 0, 5], [2, 0, 5], [2, 1, 5], [0, 1, 5]]])
        >>> area_vectors(Facets(QUAD4, x)) + 0.0
        array([[0., 0., 2.]])
    """
    first = facets.element.first
    return scaled_normals(Facets(first, facets.x[:, : first.nodes]), first.centre)[:, 0]


def facet_normals(facets: Facets) -> Floats:
    """Mean outward unit normals (m, d) of facets.

    Example:
        >>> from dolfinx_mortar.geometry.elements import LINE2
        >>> facet_normals(Facets(LINE2, np.array([[[7.0, 7.0], [4.0, 3.0]]]))) * 5
        array([[-4.,  3.]])
    """
    return unit(area_vectors(facets))


def unit(v: Floats) -> Floats:
    """Vectors (.., d) of length one, zero for zero; complex ones by the real formula."""
    size = np.sqrt((v * v).sum(axis=-1))
    return np.asarray(v / np.where(size.real > 0.0, size, np.inf)[..., None])


def normals_at_nodes(facets: Facets) -> Floats:
    """Outward unit normals (m, k, d) of facets at nodes; for degree 1 the mean normal."""
    return unit(scaled_normals(facets, facets.element.normal_points))


def points_of(facets: Facets, which: Ints, xi: Floats) -> Floats:
    """Points x = sum_l N_l x_l (q, d) of facets `which` (q,) at xi (q, d-1)."""
    N = facets.element.shape_functions(xi)
    return np.asarray(np.einsum("ql,qli->qi", N, facets.x[which]))


def surface_gradients(facets: Facets, which: Ints, xi: Floats) -> tuple[Floats, Floats]:
    """Surface gradients (q, k, d) of shape functions, and outward unit normals (q, d).

    grad N_l = sum_a dN_l/dxi_a a^a with a^a dual to the tangents a_a = sum_l dN_l/dxi_a x_l.

    >>> from dolfinx_mortar.geometry.elements import LINE2
    >>> line = Facets(LINE2, np.array([[[7.0, 7.0], [4.0, 3.0]]]))
    >>> g, n = surface_gradients(line, np.zeros(1, dtype=np.int32), np.zeros((1, 1)))
    >>> (25 * g).tolist(), (5 * n).tolist()
    ([[[3.0, 4.0], [-3.0, -4.0]]], [[-4.0, 3.0]])
    """
    dN = facets.element.functions(xi)[1]
    dual, normal = dual_basis(dN @ facets.x[which])
    size = np.sqrt(np.maximum((normal**2).sum(axis=1), TINY))
    return np.swapaxes(dN, 1, 2) @ dual, np.asarray(normal / size[:, None])


def dual_basis(a: Floats) -> tuple[Floats, Floats]:
    """Dual tangents (.., d-1, d) of a, and normals (.., d) as long as its size."""
    normal, dual = _normals(a), a
    if a.shape[-1] > 2:
        turned = np.stack([a[..., 1, :], -a[..., 0, :]], axis=-2)
        dual = np.asarray(np.cross(turned, normal[..., None, :]), dtype=np.float64)
    size = np.maximum((normal**2).sum(axis=-1), TINY)
    return dual / size[..., None, None], normal


def _normals(a: Floats) -> Floats:
    if a.shape[-1] == 2:
        return np.stack([a[..., 0, 1], -a[..., 0, 0]], axis=-1)
    return np.asarray(np.cross(a[..., 0, :], a[..., 1, :]))


def bounding_balls(x: Floats) -> tuple[Floats, Floats]:
    """Centres (m, d) and radii (m,) of balls around facets with nodes x (m, k, d).

    Second-order facets, too, unless the audit refuses their distortion.
    """
    centre = x.mean(axis=1)
    return centre, np.sqrt(((x - centre[:, None]) ** 2).sum(axis=2).max(axis=1, initial=0.0))


def facet_sizes(x: Floats) -> Floats:
    """Diameters (m,) of facets with nodes x (m, k, d)."""
    return 2 * bounding_balls(x)[1]


def are_inside(x: Floats, n: Floats, p: Floats) -> Bools:
    """Whether (m,) points p (m, d), along n (m, d), lie in facets x (m, k, d), with edges.

    Example:
        >>> x = np.array([[[0.0, 0], [2, 0]]])
        >>> [are_inside(x, np.array([[0.0, -1]]), np.array([[p, 7.0]])).item() for p in (2, 2.1)]
        [True, False]
    """
    edges = np.roll(x, -1, axis=1) - x
    inward = edges if x.shape[2] == 2 else np.cross(n[:, None], edges)
    inside = np.einsum("mki,mki->mk", inward, p[:, None] - x)
    least = -HALF_OF_DIGITS * facet_sizes(x) ** 2
    return np.asarray(inside.min(axis=1, initial=np.inf) >= least)


def scaled_normals(facets: Facets, xi: Floats) -> Floats:
    """Normals (m, q, d) at xi (q, d-1), as long as the Jacobian; means are areas."""
    dN = facets.element.functions(xi)[1]
    return facets.element.size * _normals(np.einsum("qak,mki->mqai", dN, facets.x))


def tributary_weights(facets: Facets, factor: Floats | None = None) -> Floats:
    """Integrals (m, k) of N_j over facets, times a factor (m, q) at the rule's points.

    Example:
        >>> from dolfinx_mortar.geometry.elements import LINE2
        >>> tributary_weights(Facets(LINE2, np.array([[[0.0, 0], [3, 4]]])))
        array([[2.5, 2.5]])
    """
    points, weights = facets.element.rule
    N = facets.element.shape_functions(points)
    jacobians = np.linalg.norm(scaled_normals(facets, points), axis=2)
    weights = jacobians * weights
    return np.asarray((weights if factor is None else weights * factor) @ N)


def distortions(facets: Facets) -> Floats:
    """Least quality (m,) over the nodes of facets: 1 is best, 0 or less degenerate.

    The cosine between the normal there and the mean normal; for second order at most the ratio of
    the Jacobian to its mean.

    Example:
        >>> from dolfinx_mortar.geometry.elements import QUAD4
        >>> x = np.array([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]])
        >>> distortions(Facets(QUAD4, x))
        array([0.])
    """
    element = facets.element
    x = facets.x[:, element.vertices]
    size = np.maximum(bounding_balls(x)[1], TINY)
    # the normal of a narrow facet is as inexact as its height
    area = np.linalg.norm(area_vectors(facets), axis=1)
    least = HALF_OF_DIGITS * size ** (x.shape[2] - 1)
    large = area > least
    if not element.bilinear and element.degree == 1:
        return large.astype(float)
    normal = scaled_normals(facets, element.points)
    length = np.maximum(np.linalg.norm(normal, axis=2), least[:, None])
    along = np.einsum("mki,mi->mk", normal, facet_normals(facets))
    quality = along / length
    if element.degree > 1:
        quality = np.minimum(quality, along / np.maximum(area, TINY)[:, None])
    return np.where(large, quality.min(axis=1, initial=1.0), 0.0)

# SPDX-License-Identifier: MIT
"""Types of facets (shape functions, quadrature, numbering), and geometry of single facets.

Vertices come first, in their order around the facet; nodes on edges and inside follow. Reference
facets are the interval [-1, 1], the triangle (0, 0), (1, 0), (0, 1) and the square [-1, 1]^2.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

import basix
from dolfinx_mortar.common.arrays import HALF_OF_DIGITS, TINY, Bools, Floats, Ints, Longs


@dataclass(frozen=True, eq=False)
class FacetElement:
    """Type of a facet."""

    cell: str  # dolfinx's name of the reference facet
    size: float  # length or area of the reference facet
    degree: int  # of the displacement along an edge
    rule: tuple[Floats, Floats]  # points (q, d-1) and weights (q,), sum 1
    sub_facets: tuple[tuple[int, ...], ...]  # nodes of the parts that are clipped in 3D
    order: tuple[int, ...]  # node i of the cyclic order is dolfinx's order[i]
    mirrored: tuple[int, ...]  # nodes in the opposite cyclic order
    part: FacetElement | None = None  # type of the parts; None if undivided
    # mid-side nodes and the ends of their edges
    shares: tuple[tuple[int, int, int], ...] = ()

    @cached_property
    def points(self) -> Floats:
        """Nodes (k, d-1) on the reference facet."""
        cell, equal = basix.CellType[self.cell], basix.LagrangeVariant.equispaced
        found = basix.create_element(basix.ElementFamily.P, cell, self.degree, equal)
        x = np.asarray(found.points)[list(self.order)]
        return x if self.cell == "triangle" else 2.0 * x - 1.0

    @property
    def nodes(self) -> int:
        """Number of nodes k."""
        return len(self.order)

    @property
    def first(self) -> FacetElement:
        """The type of straight facets with these vertices."""
        return self.part or self

    @property
    def vertices(self) -> tuple[int, ...]:
        """The vertices among the nodes."""
        return tuple(range(self.first.nodes))

    @cached_property
    def centre(self) -> Floats:
        """The centre (1, d-1) of the reference facet."""
        return self.first.points.mean(axis=0, keepdims=True)

    @cached_property
    def normal_points(self) -> Floats:
        """Points (k, d-1) at which nodes take normals: of degree 1 the centre, the mean."""
        return self.points if self.degree > 1 else np.repeat(self.centre, self.nodes, axis=0)

    @property
    def bilinear(self) -> bool:
        """Whether the map of the vertices is bilinear, else affine."""
        return self.cell == "quadrilateral"

    def shape_functions(self, xi: Floats) -> Floats:
        """Values N (q, k) at xi (q, d-1), contiguous by function.

        >>> LINE3.shape_functions(np.array([[0.5]]))
        array([[-0.125,  0.375,  0.75 ]])
        """
        n, e = self.degree + 1, xi.shape[1]
        table = self.table.reshape(-1, *e * [3])[:, *e * [slice(n)]]
        return (table.reshape(-1, n**e) @ powers(xi, n)).T

    def functions(self, xi: Floats) -> tuple[Floats, Floats, Floats]:
        """Values N (.., k) at xi (.., d-1), dN (.., d-1, k) and ddN (.., d-1, d-1, k).

        >>> LINE3.functions(np.array([[0.5]]))[1].tolist()
        [[[0.0, 1.0, -1.0]]]
        """
        e, k = xi.shape[-1], self.nodes
        found = (self.slopes @ powers(xi.reshape(-1, e))).T
        found = found.reshape(*xi.shape[:-1], len(self.slopes))
        N, first, second = np.split(found, [k, k + k * e], axis=-1)
        return N, first.reshape(*xi.shape, k), second.reshape(*xi.shape, e, k)

    @cached_property
    def table(self) -> Floats:
        """Coefficients (k, 3^(d-1)) of the shape functions, see `powers`.

        >>> TRI3.table[:, [0, 1, 3]].tolist()
        [[1.0, -1.0, -1.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]
        """
        e = self.points.shape[1]
        exponents = np.indices(e * [3]).reshape(e, -1)
        order = exponents.max(axis=0) if self.bilinear else exponents.sum(axis=0)
        mine, found = order <= self.degree, np.zeros((self.nodes, len(order)))
        found[:, mine] = np.linalg.inv(powers(self.points)[mine]).round(12) + 0.0  # n / 4
        return found

    @cached_property
    def slopes(self) -> Floats:
        """Coefficients (n, 3^(d-1)) of N and its first and second derivatives."""
        one, by = np.eye(3), np.diag([1.0, 2.0], -1)  # of the powers of one coordinate
        both = [np.kron(by, one), np.kron(one, by)] if self.points.shape[1] == 2 else [by]
        first = [self.table @ D for D in both]
        return np.concatenate([self.table, *first, *(f @ D for f in first for D in both)])


def powers(xi: Floats, n: int = 3) -> Floats:
    """First powers xi^a (n, q) of coordinates (q, 1), or xi^a eta^b (n^2, q) of (q, 2).

    >>> powers(np.array([[2.0, 3.0]])).T.tolist(), powers(np.array([[2.0]])).T.tolist()
    ([[1.0, 3.0, 9.0, 2.0, 6.0, 18.0, 4.0, 12.0, 36.0]], [[1.0, 2.0, 4.0]])
    """
    first, *others = (np.stack([np.ones(len(xi)), v, v * v][:n]) for v in xi.T)
    return (first[:, None] * others[0]).reshape(n * n, len(xi)) if others else first


def rule_on(cell: str, degree: int) -> tuple[Floats, Floats]:
    """Points (q, d-1) and weights (q,), sum 1, of a rule on a reference facet."""
    found = basix.make_quadrature(basix.CellType[cell], degree)
    points, weights = (np.array(part, dtype=np.float64, order="C") for part in found)
    return points if cell == "triangle" else 2.0 * points - 1.0, weights / weights.sum()


LINE2 = FacetElement(
    cell="interval",
    size=2.0,
    degree=1,
    rule=rule_on("interval", 3),  # exact also with a linear weight such as 2 pi r
    sub_facets=((0, 1),),
    order=(0, 1),
    mirrored=(1, 0),
)
LINE3 = replace(
    LINE2,
    degree=2,
    rule=rule_on("interval", 9),
    sub_facets=((0, 2), (2, 1)),
    order=(0, 1, 2),
    mirrored=(1, 0, 2),
    part=LINE2,
)
TRI3 = FacetElement(
    cell="triangle",
    size=0.5,
    degree=1,
    rule=rule_on("triangle", 1),
    sub_facets=((0, 1, 2),),
    order=(0, 1, 2),
    mirrored=(2, 1, 0),
)
TRI6 = replace(
    TRI3,
    degree=2,
    rule=rule_on("triangle", 8),
    sub_facets=((0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)),
    shares=((3, 0, 1), (4, 1, 2), (5, 2, 0)),
    order=(0, 1, 2, 5, 3, 4),
    mirrored=(2, 1, 0, 4, 3, 5),
    part=TRI3,
)
QUAD4 = FacetElement(
    cell="quadrilateral",
    size=4.0,
    degree=1,
    rule=rule_on("quadrilateral", 5),
    sub_facets=((0, 1, 2, 3),),
    order=(0, 1, 3, 2),  # dolfinx has a tensor product
    mirrored=(3, 2, 1, 0),
)
QUAD9 = replace(
    QUAD4,
    degree=2,
    rule=rule_on("quadrilateral", 9),
    sub_facets=((0, 4, 8, 7), (4, 1, 5, 8), (8, 5, 2, 6), (7, 8, 6, 3)),
    order=(0, 1, 3, 2, 4, 6, 7, 5, 8),
    mirrored=(3, 2, 1, 0, 6, 5, 4, 7, 8),
    part=QUAD4,
)

FACETS_OF = {
    ("triangle", 1): LINE2,
    ("triangle", 2): LINE3,
    ("quadrilateral", 1): LINE2,
    ("quadrilateral", 2): LINE3,
    ("tetrahedron", 1): TRI3,
    ("tetrahedron", 2): TRI6,
    ("hexahedron", 1): QUAD4,
    ("hexahedron", 2): QUAD9,
}
"""Facets of the supported cells, by cell and degree of the displacement."""


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
        >>> from dolfinx_mortar.geometry.facets import QUAD4
        >>> x = np.array([[[0.0, 0, 5], [2, 0, 5], [2, 1, 5], [0, 1, 5]]])
        >>> area_vectors(Facets(QUAD4, x)) + 0.0
        array([[0., 0., 2.]])
    """
    first = facets.element.first
    return scaled_normals(Facets(first, facets.x[:, : first.nodes]), first.centre)[:, 0]


def facet_normals(facets: Facets) -> Floats:
    """Mean outward unit normals (m, d) of facets.

    Example:
        >>> from dolfinx_mortar.geometry.facets import LINE2
        >>> facet_normals(Facets(LINE2, np.array([[[7.0, 7.0], [4.0, 3.0]]]))) * 5
        array([[-4.,  3.]])
    """
    return unit(area_vectors(facets))


def unit(v: Floats) -> Floats:
    """Vectors (.., d) of length one, zero for zero; complex ones by the real formula."""
    size = np.sqrt((v * v).sum(axis=-1))
    return v / np.where(size.real > 0.0, size, np.inf)[..., None]


def normals_at_nodes(facets: Facets) -> Floats:
    """Outward unit normals (m, k, d) of facets at nodes; for degree 1 the mean normal."""
    return unit(scaled_normals(facets, facets.element.normal_points))


def points_of(facets: Facets, which: Ints, xi: Floats) -> Floats:
    """Points x = sum_l N_l x_l (q, d) of facets `which` (q,) at xi (q, d-1)."""
    N = facets.element.shape_functions(xi)
    return np.einsum("ql,qli->qi", N, facets.x[which])


def surface_gradients(facets: Facets, which: Ints, xi: Floats) -> tuple[Floats, Floats]:
    """Surface gradients (q, k, d) of shape functions, and outward unit normals (q, d).

    grad N_l = sum_a dN_l/dxi_a a^a with a^a dual to the tangents a_a = sum_l dN_l/dxi_a x_l.

    >>> from dolfinx_mortar.geometry.facets import LINE2
    >>> line = Facets(LINE2, np.array([[[7.0, 7.0], [4.0, 3.0]]]))
    >>> g, n = surface_gradients(line, np.zeros(1, dtype=np.int32), np.zeros((1, 1)))
    >>> (25 * g).tolist(), (5 * n).tolist()
    ([[[3.0, 4.0], [-3.0, -4.0]]], [[-4.0, 3.0]])
    """
    dN = facets.element.functions(xi)[1]
    dual, normal = dual_basis(dN @ facets.x[which])
    size = np.sqrt(np.maximum((normal**2).sum(axis=1), TINY))
    return np.swapaxes(dN, 1, 2) @ dual, normal / size[:, None]


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
    return inside.min(axis=1, initial=np.inf) >= least


def scaled_normals(facets: Facets, xi: Floats) -> Floats:
    """Normals (m, q, d) at xi (q, d-1), as long as the Jacobian; means are areas."""
    dN = facets.element.functions(xi)[1]
    return facets.element.size * _normals(np.einsum("qak,mki->mqai", dN, facets.x))


def tributary_weights(facets: Facets, factor: Floats | None = None) -> Floats:
    """Integrals (m, k) of N_j over facets, times a factor (m, q) at the rule's points.

    Example:
        >>> from dolfinx_mortar.geometry.facets import LINE2
        >>> tributary_weights(Facets(LINE2, np.array([[[0.0, 0], [3, 4]]])))
        array([[2.5, 2.5]])
    """
    points, weights = facets.element.rule
    N = facets.element.shape_functions(points)
    jacobians = np.linalg.norm(scaled_normals(facets, points), axis=2)
    weights = jacobians * weights
    return (weights if factor is None else weights * factor) @ N


def distortions(facets: Facets) -> Floats:
    """Least quality (m,) over the nodes of facets: 1 is best, 0 or less degenerate.

    The cosine between the normal there and the mean normal; for second order at most the ratio of
    the Jacobian to its mean.

    Example:
        >>> from dolfinx_mortar.geometry.facets import QUAD4
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

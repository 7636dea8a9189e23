# SPDX-License-Identifier: MIT
"""Types of facets: shape functions, quadrature, numbering. No other module depends on the type.

Vertices come first, in their order around the facet; nodes on edges and inside follow. Reference
facets are the interval [-1, 1], the triangle (0, 0), (1, 0), (0, 1) and the square [-1, 1]^2.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial, reduce

import numpy as np

import basix
from dolfinx_mortar.arrays import Floats

Functions = Callable[[Floats], Floats]
"""Reference coordinates (q, d-1) -> values (q, ..)."""


@dataclass(frozen=True, eq=False)
class FacetElement:
    """Type of a facet."""

    cell: str  # dolfinx's name of the reference facet
    size: float  # length or area of the reference facet
    degree: int  # of the displacement along an edge
    points: Floats  # (k, d-1) nodes on the reference facet
    shape_functions: Functions  # N (q, k)
    derivatives: Functions  # dN_i / dxi_a (q, k, d-1)
    vertex_functions: Functions  # N (q, k') of the vertices, first order
    bilinear: bool  # map of the vertices, else affine
    rule: tuple[Floats, Floats]  # points (q, d-1) and weights (q,), sum 1
    vertices: tuple[int, ...]
    sub_facets: tuple[tuple[int, ...], ...]  # nodes of the parts that are clipped in 3D
    order: tuple[int, ...]  # node i of the cyclic order is dolfinx's order[i]
    mirrored: tuple[int, ...]  # nodes in the opposite cyclic order
    part: FacetElement | None = None  # type of the parts; None if undivided
    # mid-side nodes and the ends of their edges
    shares: tuple[tuple[int, int, int], ...] = ()

    @property
    def nodes(self) -> int:
        """Number of nodes k."""
        return len(self.points)

    @cached_property
    def table(self) -> Floats:
        """Coefficients (k, 9) of the shape functions: of xi^a eta^b at 3 a + b.

        >>> TRI3.table[:, [0, 1, 3]].tolist()
        [[1.0, -1.0, -1.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]
        """
        a, b = (i.ravel() for i in np.indices((3, 3)))
        flat = self.points.shape[1] == 2
        order = np.maximum(a, b) if self.bilinear else a + b
        mine = (order <= self.degree) & (flat | (b == 0))
        values = self.points[:, :1] ** a[mine] * (self.points[:, 1:] ** b[mine] if flat else 1.0)
        found = np.zeros((self.nodes, 9))
        found[:, mine] = np.linalg.inv(values).T.round(12) + 0.0  # multiples of 1/4
        return found

    @cached_property
    def slopes(self) -> Floats:
        """Coefficients (n, 9) of N and its first and second derivatives."""
        e = self.points.shape[1]

        def by(table: Floats, a: int) -> Floats:
            powers = np.moveaxis(table.reshape(-1, 3, 3), 1 + a, 1)
            slopes = np.pad(powers[:, 1:] * [[1.0], [2.0]], ((0, 0), (0, 1), (0, 0)))
            return np.moveaxis(slopes, 1, 1 + a).reshape(-1, 9)

        first = [by(self.table, a) for a in range(e)]
        return np.concatenate([self.table, *first, *(by(f, a) for f in first for a in range(e))])


def _interval(xi: Floats) -> Floats:
    """Linear functions of the interval (q, 2) at xi (q, 1).

    >>> _interval(np.array([[-1.0], [0.5]]))
    array([[1.  , 0.  ],
           [0.25, 0.75]])
    """
    return np.concatenate([(1 - xi) / 2, (1 + xi) / 2], axis=1)


def _interval_derivatives(xi: Floats) -> Floats:
    return np.broadcast_to(np.array([[-0.5], [0.5]]), (len(xi), 2, 1))


def _quadratic_interval(xi: Floats) -> Floats:
    """Quadratic functions of the interval (q, 3): ends, middle.

    >>> _quadratic_interval(np.array([[0.5]]))
    array([[-0.125,  0.375,  0.75 ]])
    """
    r, N = xi[:, 0] / 2, np.empty((3, len(xi)))
    square = 2 * r * r
    N[0], N[1], N[2] = square - r, square + r, 1 - 2 * square
    return N.T


def _quadratic_interval_derivatives(xi: Floats) -> Floats:
    return np.stack([xi - 0.5, xi + 0.5, -2 * xi], axis=1)


def _triangle(xi: Floats) -> Floats:
    (r, s), N = xi.T, np.empty((3, len(xi)))  # contiguous by function
    N[0], N[1], N[2] = 1 - r - s, r, s
    return N.T


def _triangle_derivatives(xi: Floats) -> Floats:
    return np.broadcast_to(np.array([[-1.0, -1.0], [1.0, 0.0], [0.0, 1.0]]), (len(xi), 3, 2))


def _quadratic_triangle(xi: Floats) -> Floats:
    """Quadratic functions of the triangle (q, 6): vertices, edges 01, 12, 20."""
    L, N = _triangle(xi).T, np.empty((6, len(xi)))
    for i in range(3):
        np.multiply(L[i], 2 * L[i] - 1, out=N[i])
        np.multiply(L[i], 4 * L[(i + 1) % 3], out=N[i + 3])
    return N.T


def _quadratic_triangle_derivatives(xi: Floats) -> Floats:
    L, dL = _triangle(xi)[:, :, None], _triangle_derivatives(xi)
    beside, d_beside = np.roll(L, -1, axis=1), np.roll(dL, -1, axis=1)
    return np.concatenate([(4 * L - 1) * dL, 4 * (L * d_beside + beside * dL)], axis=1)


# functions of the interval for each node of the square
_R, _S = [0, 1, 1, 0, 2, 1, 2, 0, 2], [0, 0, 1, 1, 0, 2, 1, 2, 2]


def _products(functions: Functions, xi: Floats) -> Floats:
    """Products (q, k) of functions of the interval on the square.

    >>> _products(_interval, np.array([[0.0, 0.5]]))
    array([[0.125, 0.125, 0.375, 0.375]])
    """
    r, s = (functions(x[:, None]).T for x in xi.T)
    N = np.empty((len(r) ** 2, len(xi)))
    for i in range(len(N)):
        np.multiply(r[_R[i]], s[_S[i]], out=N[i])
    return N.T


def _product_derivatives(functions: Functions, derivatives: Functions, xi: Floats) -> Floats:
    """Derivatives of `_products` (q, k, 2).

    >>> _product_derivatives(_interval, _interval_derivatives, np.array([[0.0, 0.5]]))[0].T
    array([[-0.125,  0.125,  0.375, -0.375],
           [-0.25 , -0.25 ,  0.25 ,  0.25 ]])
    """
    r, s = (functions(xi[:, [i]]) for i in range(2))
    dr, ds = (derivatives(xi[:, [i]])[:, :, 0] for i in range(2))
    i, j = _R[: r.shape[1] ** 2], _S[: r.shape[1] ** 2]
    return np.stack([dr[:, i] * s[:, j], r[:, i] * ds[:, j]], axis=2)


def _gauss(n: int, tdim: int) -> tuple[Floats, Floats]:
    """Gauss points and weights, sum 1."""
    points, weights = np.polynomial.legendre.leggauss(n)
    xi = np.stack(np.meshgrid(*tdim * [points]), axis=-1).reshape(-1, tdim)
    return xi, np.asarray(reduce(np.multiply.outer, tdim * [weights / 2])).ravel()


def triangle_rule(degree: int) -> tuple[Floats, Floats]:
    """Points (q, 2) and weights (q,), sum 1, of a rule on the triangle."""
    found = basix.make_quadrature(basix.CellType.triangle, degree)
    points, weights = (np.array(part, dtype=np.float64, order="C") for part in found)
    return points, weights / weights.sum()


LINE2 = FacetElement(
    cell="interval",
    size=2.0,
    degree=1,
    points=np.array([[-1.0], [1.0]]),
    shape_functions=_interval,
    derivatives=_interval_derivatives,
    vertex_functions=_interval,
    bilinear=False,
    rule=_gauss(2, 1),  # exact also with a linear weight such as 2 pi r
    vertices=(0, 1),
    sub_facets=((0, 1),),
    order=(0, 1),
    mirrored=(1, 0),
)
LINE3 = replace(
    LINE2,
    degree=2,
    points=np.array([[-1.0], [1.0], [0.0]]),
    shape_functions=_quadratic_interval,
    derivatives=_quadratic_interval_derivatives,
    rule=_gauss(5, 1),
    sub_facets=((0, 2), (2, 1)),
    order=(0, 1, 2),
    mirrored=(1, 0, 2),
    part=LINE2,
)
TRI3 = FacetElement(
    cell="triangle",
    size=0.5,
    degree=1,
    points=np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]),
    shape_functions=_triangle,
    derivatives=_triangle_derivatives,
    vertex_functions=_triangle,
    bilinear=False,
    rule=(np.full((1, 2), 1 / 3), np.ones(1)),
    vertices=(0, 1, 2),
    sub_facets=((0, 1, 2),),
    order=(0, 1, 2),
    mirrored=(2, 1, 0),
)
TRI6 = replace(
    TRI3,
    degree=2,
    points=np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.5, 0.0], [0.5, 0.5], [0.0, 0.5]]),
    shape_functions=_quadratic_triangle,
    derivatives=_quadratic_triangle_derivatives,
    rule=triangle_rule(8),
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
    points=LINE3.points[:, 0][np.column_stack([_R, _S])[:4]],
    shape_functions=partial(_products, _interval),
    derivatives=partial(_product_derivatives, _interval, _interval_derivatives),
    vertex_functions=partial(_products, _interval),
    bilinear=True,
    rule=_gauss(3, 2),
    vertices=(0, 1, 2, 3),
    sub_facets=((0, 1, 2, 3),),
    order=(0, 1, 3, 2),  # dolfinx has a tensor product
    mirrored=(3, 2, 1, 0),
)
QUAD9 = replace(
    QUAD4,
    degree=2,
    points=LINE3.points[:, 0][np.column_stack([_R, _S])],
    shape_functions=partial(_products, _quadratic_interval),
    derivatives=partial(_product_derivatives, _quadratic_interval, _quadratic_interval_derivatives),
    rule=_gauss(5, 2),
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

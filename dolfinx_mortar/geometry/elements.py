# SPDX-License-Identifier: MIT
"""Types of facets: shape functions, quadrature, numbering. No other module depends on the type.

Vertices come first, in their order around the facet; nodes on edges and inside follow. Reference
facets are the interval [-1, 1], the triangle (0, 0), (1, 0), (0, 1) and the square [-1, 1]^2.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, reduce

import numpy as np
from numpy.polynomial.legendre import leggauss

import basix
from dolfinx_mortar.common.arrays import Floats


@dataclass(frozen=True, eq=False)
class FacetElement:
    """Type of a facet."""

    cell: str  # dolfinx's name of the reference facet
    size: float  # length or area of the reference facet
    degree: int  # of the displacement along an edge
    points: Floats  # (k, d-1) nodes on the reference facet
    rule: tuple[Floats, Floats]  # points (q, d-1) and weights (q,), sum 1
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

    @property
    def first(self) -> FacetElement:
        """The type of straight facets with these vertices."""
        return self.part or self

    @property
    def vertices(self) -> tuple[int, ...]:
        """The vertices among the nodes."""
        return tuple(range(self.first.nodes))

    @property
    def centre(self) -> Floats:
        """The centre (1, d-1) of the reference facet."""
        return self.first.points.mean(axis=0, keepdims=True)

    @property
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
        a, b = self.degree + 1, self.degree * (xi.shape[1] - 1) + 1
        table = self.table.reshape(-1, 3, 3)[:, :a, :b]
        return np.asarray((table.reshape(-1, a * b) @ powers(xi, self.degree)).T)

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
        """Coefficients (k, 9) of the shape functions: of xi^a eta^b at 3 a + b.

        >>> TRI3.table[:, [0, 1, 3]].tolist()
        [[1.0, -1.0, -1.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]
        """
        a, b = (i.ravel() for i in np.indices((3, 3)))
        order = np.maximum(a, b) if self.bilinear else a + b
        mine = (order <= self.degree) & ((self.points.shape[1] == 2) | (b == 0))
        found = np.zeros((self.nodes, 9))
        found[:, mine] = np.linalg.inv(powers(self.points)[mine]).round(12) + 0.0  # n / 4
        return found

    @cached_property
    def slopes(self) -> Floats:
        """Coefficients (n, 9) of N and its first and second derivatives."""
        one, by = np.eye(3), np.diag([1.0, 2.0], -1)  # of the powers of one coordinate
        both = [np.kron(by, one), np.kron(one, by)][: self.points.shape[1]]
        first = [self.table @ D for D in both]
        return np.concatenate([self.table, *first, *(f @ D for f in first for D in both)])


def powers(xi: Floats, degree: int | None = None) -> Floats:
    """Products xi^a eta^b (n, q) for xi (q, d-1); without a degree a, b <= 2, eta = 0 in the plane.

    >>> powers(np.array([[2.0, 3.0]])).T.tolist(), powers(np.array([[2.0]]), 2).T.tolist()
    ([[1.0, 3.0, 9.0, 2.0, 6.0, 18.0, 4.0, 12.0, 36.0]], [[1.0, 2.0, 4.0]])
    """
    one, n = np.ones(len(xi)), 3 if degree is None else degree + 1
    r, s = ([one, v, v * v][:n] for v in (*xi.T, 0.0 * one)[:2])
    s = s[:1] if degree is not None and xi.shape[1] == 1 else s
    return np.stack([x * y for x in r for y in s])


_SQUARE = np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1], [0, -1], [1, 0], [0, 1], [-1, 0], [0, 0]])


def _gauss(n: int, tdim: int) -> tuple[Floats, Floats]:
    """Gauss points and weights, sum 1."""
    points, weights = leggauss(n)
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
    rule=_gauss(2, 1),  # exact also with a linear weight such as 2 pi r
    sub_facets=((0, 1),),
    order=(0, 1),
    mirrored=(1, 0),
)
LINE3 = replace(
    LINE2,
    degree=2,
    points=np.array([[-1.0], [1.0], [0.0]]),
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
    rule=(np.full((1, 2), 1 / 3), np.ones(1)),
    sub_facets=((0, 1, 2),),
    order=(0, 1, 2),
    mirrored=(2, 1, 0),
)
TRI6 = replace(
    TRI3,
    degree=2,
    points=np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.5, 0.0], [0.5, 0.5], [0.0, 0.5]]),
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
    points=_SQUARE[:4],
    rule=_gauss(3, 2),
    sub_facets=((0, 1, 2, 3),),
    order=(0, 1, 3, 2),  # dolfinx has a tensor product
    mirrored=(3, 2, 1, 0),
)
QUAD9 = replace(
    QUAD4,
    degree=2,
    points=_SQUARE,
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

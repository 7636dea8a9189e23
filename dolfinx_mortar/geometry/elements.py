# SPDX-License-Identifier: MIT
"""How a facet interpolates: all that depends on its type is said here, and asked nowhere else.

The vertices of a facet stand first, in the order in which they are passed on the way around it; the
nodes inside an edge or a facet follow. Reference facets are the interval [-1, 1], the triangle
(0, 0), (1, 0), (0, 1) and the square [-1, 1]^2.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

import basix
from dolfinx_mortar.arrays import Floats


@dataclass(frozen=True, eq=False)
class FacetElement:
    """Type of a facet. A number of nodes never stands for it."""

    cell: str  # the reference facet in dolfinx's words
    size: float  # its length or area
    degree: int  # of the displacement along an edge
    points: Floats  # (k, d-1) the nodes on the reference facet
    shape_functions: Callable[[Floats], Floats]  # xi (q, d-1) -> N (q, k)
    derivatives: Callable[[Floats], Floats]  # xi (q, d-1) -> dN_i / dxi_a (q, k, d-1)
    vertex_functions: Callable[[Floats], Floats]  # of the first-order facet with these vertices
    bilinear: bool  # the map of the vertices is bilinear, otherwise it is affine
    rule: tuple[Floats, Floats]  # points (q, d-1) and weights (q,), sum 1, of an integral over it
    vertices: tuple[int, ...]  # the nodes at the corners
    sub_facets: tuple[tuple[int, ...], ...]  # nodes of the parts that clipping in space sees
    order: tuple[int, ...]  # node i on the way around is dolfinx's node order[i]
    mirrored: tuple[int, ...]  # the nodes on the way around in the other direction
    part: FacetElement | None = None  # type of the parts, where a facet is not its only one
    # middles and their ends, where these take a share, see mortar.dual.absorbed
    shares: tuple[tuple[int, int, int], ...] = ()

    @property
    def nodes(self) -> int:
        """Number of nodes k."""
        return len(self.points)


def _interval(xi: Floats) -> Floats:
    """Return the linear functions of the interval (q, 2) at xi (q, 1).

    >>> _interval(np.array([[-1.0], [0.5]]))
    array([[1.  , 0.  ],
           [0.25, 0.75]])
    """
    return np.concatenate([(1 - xi) / 2, (1 + xi) / 2], axis=1)


def _quadratic_interval(xi: Floats) -> Floats:
    """Return the quadratic functions of the interval (q, 3) at xi (q, 1): the ends, the middle.

    >>> _quadratic_interval(np.array([[0.5]]))
    array([[-0.125,  0.375,  0.75 ]])
    """
    r, N = xi[:, 0] / 2, np.empty((3, len(xi)))
    square = 2 * r * r
    N[0], N[1], N[2] = square - r, square + r, 1 - 2 * square
    return N.T


def _triangle(xi: Floats) -> Floats:
    """Return the linear functions of the triangle (q, 3) at xi (q, 2)."""
    (r, s), N = xi.T, np.empty((3, len(xi)))  # a function's values side by side, as sums take them
    N[0], N[1], N[2] = 1 - r - s, r, s
    return N.T


def _square(xi: Floats) -> Floats:
    """Return the bilinear functions of the square (q, 4) at xi (q, 2).

    >>> _square(np.array([[0.0, 0.5]]))
    array([[0.125, 0.125, 0.375, 0.375]])
    """
    (r, s), N = xi.T, np.empty((4, len(xi)))
    a, b, c, d = (1 - r) / 2, (1 + r) / 2, (1 - s) / 2, (1 + s) / 2
    for i, factors in enumerate(((a, c), (b, c), (b, d), (a, d))):
        np.multiply(*factors, out=N[i])
    return N.T


def _quadratic_triangle(xi: Floats) -> Floats:
    """Return the quadratic functions of the triangle (q, 6): vertices, middles of 01, 12, 20."""
    L, N = _triangle(xi).T, np.empty((6, len(xi)))
    for i in range(3):
        np.multiply(L[i], 2 * L[i] - 1, out=N[i])
        np.multiply(L[i], 4 * L[(i + 1) % 3], out=N[i + 3])
    return N.T


def _quadratic_triangle_derivatives(xi: Floats) -> Floats:
    """Return the derivatives of `_quadratic_triangle` (q, 6, 2)."""
    L, dL = _triangle(xi)[:, :, None], _triangle_derivatives(xi)
    beside, d_beside = np.roll(L, -1, axis=1), np.roll(dL, -1, axis=1)
    return np.concatenate([(4 * L - 1) * dL, 4 * (L * d_beside + beside * dL)], axis=1)


# Of the biquadratic square: which functions of the interval (ends, middle) a node's product has.
_R, _S = [0, 1, 1, 0, 2, 1, 2, 0, 2], [0, 0, 1, 1, 0, 2, 1, 2, 2]


def _quadratic_square(xi: Floats) -> Floats:
    """Return the biquadratic functions of the square (q, 9): vertices, edges around, centre."""
    (r, s), N = (_quadratic_interval(x[:, None]).T for x in xi.T), np.empty((9, len(xi)))
    for i in range(9):
        np.multiply(r[_R[i]], s[_S[i]], out=N[i])
    return N.T


def _quadratic_square_derivatives(xi: Floats) -> Floats:
    """Return the derivatives of `_quadratic_square` (q, 9, 2)."""
    r, s = (_quadratic_interval(xi[:, [i]]) for i in range(2))
    dr, ds = (_quadratic_interval_derivatives(xi[:, [i]])[:, :, 0] for i in range(2))
    return np.stack([dr[:, _R] * s[:, _S], r[:, _R] * ds[:, _S]], axis=2)


def _interval_derivatives(xi: Floats) -> Floats:
    """Return the derivatives of `_interval` (q, 2, 1)."""
    return np.broadcast_to(np.array([[-0.5], [0.5]]), (len(xi), 2, 1))


def _quadratic_interval_derivatives(xi: Floats) -> Floats:
    """Return the derivatives of `_quadratic_interval` (q, 3, 1)."""
    return np.stack([xi - 0.5, xi + 0.5, -2 * xi], axis=1)


def _triangle_derivatives(xi: Floats) -> Floats:
    """Return the derivatives of `_triangle` (q, 3, 2)."""
    return np.broadcast_to(np.array([[-1.0, -1.0], [1.0, 0.0], [0.0, 1.0]]), (len(xi), 3, 2))


def _square_derivatives(xi: Floats) -> Floats:
    """Return the derivatives of `_square` (q, 4, 2).

    >>> _square_derivatives(np.array([[0.0, 0.5]]))[0].T
    array([[-0.125,  0.125,  0.375, -0.375],
           [-0.25 , -0.25 ,  0.25 ,  0.25 ]])
    """
    corner = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    factors = (1 + xi[:, None] * corner) / 2  # of N_i, one for each direction
    return np.asarray(corner / 2 * factors[:, :, ::-1])


def _gauss_interval(n: int) -> tuple[Floats, Floats]:
    """Return n Gauss points and their weights on the interval."""
    points, weights = np.polynomial.legendre.leggauss(n)
    return points[:, None], weights / 2


def _gauss_square(n: int) -> tuple[Floats, Floats]:
    """Return points and weights of n x n Gauss points on the square."""
    points, weights = np.polynomial.legendre.leggauss(n)
    xi = np.stack(np.meshgrid(points, points), axis=-1).reshape(-1, 2)
    return xi, np.outer(weights, weights).ravel() / 4


def _gauss_triangle(degree: int) -> tuple[Floats, Floats]:
    """Return points and weights of a rule of such a degree on the triangle."""
    found = basix.make_quadrature(basix.CellType.triangle, degree)
    points, weights = (np.asarray(part, dtype=np.float64) for part in found)
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
    rule=_gauss_interval(2),  # exact also with a weight that is linear, such as 2 pi r
    vertices=(0, 1),
    sub_facets=((0, 1),),
    order=(0, 1),
    mirrored=(1, 0),
)
LINE3 = FacetElement(
    cell="interval",
    size=2.0,
    degree=2,
    points=np.array([[-1.0], [1.0], [0.0]]),
    shape_functions=_quadratic_interval,
    derivatives=_quadratic_interval_derivatives,
    vertex_functions=_interval,
    bilinear=False,
    rule=_gauss_interval(5),
    vertices=(0, 1),
    sub_facets=((0, 1),),
    order=(0, 1, 2),
    mirrored=(1, 0, 2),
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
QUAD4 = FacetElement(
    cell="quadrilateral",
    size=4.0,
    degree=1,
    points=np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]),
    shape_functions=_square,
    derivatives=_square_derivatives,
    vertex_functions=_square,
    bilinear=True,
    rule=_gauss_square(3),
    vertices=(0, 1, 2, 3),
    sub_facets=((0, 1, 2, 3),),
    order=(0, 1, 3, 2),  # dolfinx counts like a tensor product
    mirrored=(3, 2, 1, 0),
)

QUAD9 = FacetElement(
    cell="quadrilateral",
    size=4.0,
    degree=2,
    points=np.array([-1.0, 1.0, 0.0])[np.column_stack([_R, _S])],
    shape_functions=_quadratic_square,
    derivatives=_quadratic_square_derivatives,
    vertex_functions=_square,
    bilinear=True,
    rule=_gauss_square(5),
    vertices=(0, 1, 2, 3),
    sub_facets=((0, 4, 8, 7), (4, 1, 5, 8), (8, 5, 2, 6), (7, 8, 6, 3)),
    order=(0, 1, 3, 2, 4, 6, 7, 5, 8),
    mirrored=(3, 2, 1, 0, 6, 5, 4, 7, 8),
    part=QUAD4,
)

TRI6 = FacetElement(
    cell="triangle",
    size=0.5,
    degree=2,
    points=np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.5, 0.0], [0.5, 0.5], [0.0, 0.5]]),
    shape_functions=_quadratic_triangle,
    derivatives=_quadratic_triangle_derivatives,
    vertex_functions=_triangle,
    bilinear=False,
    rule=_gauss_triangle(8),
    vertices=(0, 1, 2),
    sub_facets=((0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)),
    shares=((3, 0, 1), (4, 1, 2), (5, 2, 0)),
    order=(0, 1, 2, 5, 3, 4),
    mirrored=(2, 1, 0, 4, 3, 5),
    part=TRI3,
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
"""The facets of the supported cells, by cell and degree of the displacement."""

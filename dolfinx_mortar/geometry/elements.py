# SPDX-License-Identifier: MIT
"""How a facet interpolates: all that depends on its type is said here, and asked nowhere else.

The nodes of a facet stand in the order in which they are passed on the way around it. Reference
facets are the interval [-1, 1], the triangle (0, 0), (1, 0), (0, 1) and the square [-1, 1]^2.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dolfinx_mortar.arrays import Floats


@dataclass(frozen=True, eq=False)
class FacetElement:
    """Type of a facet. A number of nodes never stands for it."""

    cell: str  # the reference facet in dolfinx's words
    nodes: int  # k
    shape_functions: Callable[[Floats], Floats]  # xi (q, d-1) -> N (q, k)
    derivatives: Callable[[Floats], Floats]  # xi (q, d-1) -> dN_i / dxi_a (q, k, d-1)
    bilinear: bool  # the map from the reference facet is bilinear, otherwise it is affine
    rule: tuple[Floats, Floats]  # points (q, d-1) and weights (q,), sum 1, of an integral over it
    vertices: tuple[int, ...]  # the nodes at the corners
    sub_facets: tuple[tuple[int, ...], ...]  # nodes of the linear facets that clipping sees
    multiplier: str  # kind of the multiplier's basis, a key of mortar.dual.BASES
    order: tuple[int, ...]  # node i on the way around is dolfinx's node order[i]
    mirrored: tuple[int, ...]  # the nodes on the way around in the other direction


def _interval(xi: Floats) -> Floats:
    """Return the linear functions of the interval (q, 2) at xi (q, 1).

    >>> _interval(np.array([[-1.0], [0.5]]))
    array([[1.  , 0.  ],
           [0.25, 0.75]])
    """
    return np.concatenate([(1 - xi) / 2, (1 + xi) / 2], axis=1)


def _triangle(xi: Floats) -> Floats:
    """Return the linear functions of the triangle (q, 3) at xi (q, 2)."""
    (r, s), N = xi.T, np.empty((len(xi), 3))
    N[:, 0], N[:, 1], N[:, 2] = 1 - r - s, r, s
    return N


def _square(xi: Floats) -> Floats:
    """Return the bilinear functions of the square (q, 4) at xi (q, 2).

    >>> _square(np.array([[0.0, 0.5]]))
    array([[0.125, 0.125, 0.375, 0.375]])
    """
    (r, s), N = xi.T, np.empty((len(xi), 4))
    a, b, c, d = (1 - r) / 2, (1 + r) / 2, (1 - s) / 2, (1 + s) / 2
    for i, factors in enumerate(((a, c), (b, c), (b, d), (a, d))):
        np.multiply(*factors, out=N[:, i])
    return N


def _interval_derivatives(xi: Floats) -> Floats:
    """Return the derivatives of `_interval` (q, 2, 1)."""
    return np.broadcast_to(np.array([[-0.5], [0.5]]), (len(xi), 2, 1))


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


def _gauss_square(n: int) -> tuple[Floats, Floats]:
    """Return points and weights of n x n Gauss points on the square."""
    points, weights = np.polynomial.legendre.leggauss(n)
    xi = np.stack(np.meshgrid(points, points), axis=-1).reshape(-1, 2)
    return xi, np.outer(weights, weights).ravel() / 4


LINE2 = FacetElement(
    cell="interval",
    nodes=2,
    shape_functions=_interval,
    derivatives=_interval_derivatives,
    bilinear=False,
    rule=(np.zeros((1, 1)), np.ones(1)),
    vertices=(0, 1),
    sub_facets=((0, 1),),
    multiplier="biorthogonal",
    order=(0, 1),
    mirrored=(1, 0),
)
TRI3 = FacetElement(
    cell="triangle",
    nodes=3,
    shape_functions=_triangle,
    derivatives=_triangle_derivatives,
    bilinear=False,
    rule=(np.full((1, 2), 1 / 3), np.ones(1)),
    vertices=(0, 1, 2),
    sub_facets=((0, 1, 2),),
    multiplier="biorthogonal",
    order=(0, 1, 2),
    mirrored=(2, 1, 0),
)
QUAD4 = FacetElement(
    cell="quadrilateral",
    nodes=4,
    shape_functions=_square,
    derivatives=_square_derivatives,
    bilinear=True,
    rule=_gauss_square(3),
    vertices=(0, 1, 2, 3),
    sub_facets=((0, 1, 2, 3),),
    multiplier="biorthogonal",
    order=(0, 1, 3, 2),  # dolfinx counts like a tensor product
    mirrored=(3, 2, 1, 0),
)

FACETS_OF = {"triangle": LINE2, "quadrilateral": LINE2, "tetrahedron": TRI3, "hexahedron": QUAD4}
"""The supported cells and their facets."""

# SPDX-License-Identifier: MIT
"""Clipping in space takes first-order facets: each facet itself, or its four parts.

A second-order facet is divided at its mid-side nodes. Its parts are projected, clipped and mapped
back like first-order facets; the points found then belong to the facet itself, and to its surface,
curved or not.

Facets of all types are x = sum_ab c_ab xi^a eta^b with a, b <= 2, so that one kernel serves them: a
point and its two tangents take a third of the operations that shape functions do.
"""

import numba
import numpy as np

from dolfinx_mortar.arrays import Floats, Ints
from dolfinx_mortar.geometry.elements import FacetElement
from dolfinx_mortar.geometry.facets import Facets, facet_normals
from dolfinx_mortar.geometry.tolerances import HALF_OF_DIGITS

_STEPS = 32
"""Limit of Newton's steps to a curved facet; the coordinates of a line that is not met are NaN.

Convergence is quadratic from within the part's sagitta times its slope: two or three steps where
the normal of a part changes by a tenth of a radian, one where facets are straight.
"""


def count(element: FacetElement) -> int:
    """Return how many parts s a facet has."""
    return len(element.sub_facets)


def parts_of(facets: Facets) -> Facets:
    """Return the parts (m * s,) of facets (m,), those of a facet one after the other."""
    element = facets.element
    if element.part is None:
        return facets
    x = facets.x[:, np.array(element.sub_facets)]
    return Facets(element.part, np.ascontiguousarray(x.reshape(-1, *x.shape[2:])))


def pairs_of_parts(pairs: Ints, slave: FacetElement, master: FacetElement) -> tuple[Ints, Ints]:
    """Return the pairs of parts (p', 2), ordered by the slave's, and the pair (p',) of each.

    >>> from dolfinx_mortar.geometry.elements import TRI3
    >>> pairs, of = pairs_of_parts(np.array([[0, 3], [0, 5]], dtype=np.int32), TRI3, TRI3)
    >>> pairs.tolist(), of.tolist()
    ([[0, 3], [0, 5]], [0, 1])
    """
    a, b = count(slave), count(master)
    if a * b == 1:
        return pairs, np.arange(len(pairs), dtype=np.int32)
    of = np.repeat(np.arange(len(pairs)), a * b)
    i, j = (np.tile(k.ravel(), len(pairs)) for k in np.indices((a, b)))
    every = np.stack([pairs[of, 0] * a + i, pairs[of, 1] * b + j], axis=1)
    order = np.argsort(every[:, 0], kind="stable")
    return every[order].astype(np.int32), of[order].astype(np.int32)


def to_facets(element: FacetElement, part: Ints, xi: Floats) -> Floats:
    """Return the reference coordinates (q, d-1) on facets of points xi on their parts (q,)."""
    if element.part is None:
        return xi
    x = element.points[np.array(element.sub_facets)]  # (s, k', d-1)
    parts = Facets(element.part, np.pad(x, ((0, 0), (0, 0), (0, 1))))
    return np.asarray(points_at(coefficients(parts), part % count(element), xi)[:, :2])


def coefficients(facets: Facets) -> Floats:
    """Return the coefficients c (m, 3, 9) of facets: of x_i at 3 a + b.

    Example:
        >>> from dolfinx_mortar.geometry.elements import TRI3
        >>> x = np.array([[[5.0, 0, 0], [7, 0, 0], [5, 1, 0]]])
        >>> coefficients(Facets(TRI3, x))[0, 0].tolist()
        [5.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    """
    element = facets.element
    a, b = (i.ravel() for i in np.indices((3, 3)))
    order = np.maximum(a, b) if element.bilinear else a + b
    mine = order <= element.degree
    values = element.points[:, :1] ** a[mine] * element.points[:, 1:] ** b[mine]
    to_c = np.zeros((9, element.nodes))
    to_c[mine] = np.linalg.inv(values)
    return np.ascontiguousarray(np.swapaxes(to_c @ facets.x, 1, 2))


@numba.njit(cache=True, error_model="numpy")
def _component(c, r, s):  # type: ignore[no-untyped-def]
    """Return one component of a point and of its tangents at (r, s)."""
    low, mid = c[0] + s * (c[1] + s * c[2]), c[3] + s * (c[4] + s * c[5])
    high = c[6] + s * (c[7] + s * c[8])
    along = (c[1] + 2 * s * c[2]) + r * ((c[4] + 2 * s * c[5]) + r * (c[7] + 2 * s * c[8]))
    return low + r * (mid + r * high), mid + 2 * r * high, along


@numba.njit(cache=True, error_model="numpy")
def points_at(c, which, xi):  # type: ignore[no-untyped-def]
    """Return the points (q, 3) of facets at xi (q, 2), as `points_of`, in a fifth of the time."""
    x = np.empty((len(which), 3))
    for q in range(len(which)):
        for i in range(3):
            x[q, i] = _component(c[which[q], i], xi[q, 0], xi[q, 1])[0]
    return x


@numba.njit(cache=True, error_model="numpy")
def _area(c, r, s):  # type: ignore[no-untyped-def]
    """Return the area of a facet (3, 9) at (r, s) per area of the reference facet."""
    _, a0, b0 = _component(c[0], r, s)
    _, a1, b1 = _component(c[1], r, s)
    _, a2, b2 = _component(c[2], r, s)
    n0, n1, n2 = a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0
    return np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)


@numba.njit(cache=True, error_model="numpy")
def area_ratios(c, which, xi, c_part, part, xi_part):  # type: ignore[no-untyped-def]
    """Return the area (q,) of facets at xi (q, 2) over that of others at xi_part (q, 2)."""
    ratio = np.empty(len(which))
    for q in range(len(which)):
        whole = _area(c[which[q]], xi[q, 0], xi[q, 1])
        ratio[q] = whole / _area(c_part[part[q]], xi_part[q, 0], xi_part[q, 1])
    return ratio


def stretches(facets: Facets, which: Ints, xi: Floats, part: Ints, xi_part: Floats) -> Floats:
    """Return the area (q,) of facets at points over that of their parts there.

    Args:
        facets: the facets (m,).
        which: (q,) facet of each point.
        xi: (q, 2) its coordinates there.
        part: (q,) part of each point.
        xi_part: (q, 2) its coordinates there.
    """
    parts = parts_of(facets)
    scale = facets.element.size / (count(facets.element) * parts.element.size)
    ratios = area_ratios(coefficients(facets), which, xi, coefficients(parts), part, xi_part)
    return np.asarray(scale * ratios)


@numba.njit(cache=True, error_model="numpy")
def _step(c, r, s, x, n):  # type: ignore[no-untyped-def]
    """Return Newton's step from (r, s) towards the line through x along n.

    With a, b the tangents and e = x - x(r, s): e + t n = a dr + b ds, multiplied by the cross
    products of a and b with n.
    """
    y0, a0, b0 = _component(c[0], r, s)
    y1, a1, b1 = _component(c[1], r, s)
    y2, a2, b2 = _component(c[2], r, s)
    e0, e1, e2 = x[0] - y0, x[1] - y1, x[2] - y2
    u0, u1, u2 = b1 * n[2] - b2 * n[1], b2 * n[0] - b0 * n[2], b0 * n[1] - b1 * n[0]
    v0, v1, v2 = a1 * n[2] - a2 * n[1], a2 * n[0] - a0 * n[2], a0 * n[1] - a1 * n[0]
    size = a0 * u0 + a1 * u1 + a2 * u2
    return (e0 * u0 + e1 * u1 + e2 * u2) / size, -(e0 * v0 + e1 * v1 + e2 * v2) / size


@numba.njit(cache=True, error_model="numpy")
def _meet(c, which, xi, x, n, direction):  # type: ignore[no-untyped-def]
    """See `meet`; the direction of a point is n[direction[q]]."""
    found = np.empty(xi.shape)
    for q in range(len(which)):
        r, s = xi[q, 0], xi[q, 1]
        for _ in range(_STEPS):
            dr, ds = _step(c[which[q]], r, s, x[q], n[direction[q]])
            r, s = r + dr, s + ds
            if max(abs(dr), abs(ds)) <= HALF_OF_DIGITS:  # the next one is round-off
                break
        else:
            r = s = np.nan
        found[q, 0], found[q, 1] = r, s
    return found


def meet(facets: Facets, which: Ints, xi: Floats, x: Floats, n: Floats, direction: Ints) -> Floats:
    """Return the coordinates (q, 2) at which lines through x meet curved facets, NaN if nowhere.

    Args:
        facets: the facets (m,).
        which: (q,) facet of each point.
        xi: (q, 2) where its parts are met.
        x: (q, 3) points.
        n: (v, 3) directions.
        direction: (q,) which of them a line has.
    """
    return np.asarray(_meet(coefficients(facets), which, xi, x, n, direction))


def on_facets(
    slave: Facets, master: Facets, part: Ints, *, xi_s: Floats, xi_m: Floats, weight: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return xi_s, xi_m (q, 2) and weights (q,) of points on the facets' true surfaces.

    Args:
        slave: Slave facets (ms,), whose parts are projected along their mean normals.
        master: Master facets (mm,).
        part: (q, 2) parts of slave and master that lie over each other.
        xi_s: (q, 2) reference coordinates on the slave's part.
        xi_m: (q, 2) and on the master's.
        weight: (q,) of the slave's part.
    """
    part_s, part_m = part.T
    s, m = part_s // count(slave.element), part_m // count(master.element)
    xi = to_facets(slave.element, part_s, xi_s)
    weight = weight * stretches(slave, s, xi, part_s, xi_s)
    x, n = points_at(coefficients(slave), s, xi), facet_normals(parts_of(slave))
    return xi, meet(master, m, to_facets(master.element, part_m, xi_m), x, n, part_s), weight

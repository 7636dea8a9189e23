# SPDX-License-Identifier: MIT
"""First-order parts of facets for clipping in 3D: a facet itself, or four parts between its nodes.

Facets of all types are x = sum_ab c_ab xi^a eta^b with a, b <= 2: one kernel, with a third of the
operations of shape functions.
"""

import numba
import numpy as np

from dolfinx_mortar.arrays import HALF_OF_DIGITS, LIMIT, Floats, Ints
from dolfinx_mortar.geometry.elements import FacetElement
from dolfinx_mortar.geometry.facets import Facets, facet_normals, facet_sizes
from dolfinx_mortar.geometry.tolerances import FIRST, KERNEL, ROUND_OFF, SECOND, THIRD


def count(element: FacetElement) -> int:
    """Return the number s of parts of a facet."""
    return len(element.sub_facets)


def parts_of(facets: Facets) -> Facets:
    """Return the parts (m * s,) of facets (m,), ordered by facet."""
    element = facets.element
    if element.part is None:
        return facets
    x = facets.x[:, np.array(element.sub_facets)]
    return Facets(element.part, np.ascontiguousarray(x.reshape(-1, *x.shape[2:])))


def first_order(facets: Facets) -> Facets | None:
    """Return equal facets of first order, None unless all are straight and flat."""
    element, x = facets.element, facets.x
    if element.part is None:
        return facets
    corners = x[:, list(element.vertices)]
    off = x - element.vertex_functions(element.points) @ corners
    heights = np.einsum(
        "mki,mi->mk", corners - corners.mean(axis=1, keepdims=True), facet_normals(facets)
    )
    limit = 8 * ROUND_OFF * facet_sizes(x)[:, None]
    if (np.abs(off).max(axis=2, initial=0.0) > limit).any() or (np.abs(heights) > limit).any():
        return None
    return Facets(element.part, np.ascontiguousarray(corners))


def pairs_of_parts(pairs: Ints, slave: FacetElement, master: FacetElement) -> tuple[Ints, Ints]:
    """Return the pairs of parts (p', 2), ordered by slave, and the pair (p',) of each.

    >>> from dolfinx_mortar.geometry.elements import TRI3
    >>> pairs, of = pairs_of_parts(np.array([[0, 3], [0, 5]], dtype=np.int32), TRI3, TRI3)
    >>> pairs.tolist(), of.tolist()
    ([[0, 3], [0, 5]], [0, 1])
    """
    a, b = count(slave), count(master)
    if a * b == 1:
        return pairs, np.arange(len(pairs), dtype=np.int32)
    every, of = all_pairs(pairs, a, b)
    return every, of


@numba.njit(**KERNEL)
def all_pairs(pairs, a, b):  # type: ignore[no-untyped-def]
    """See `pairs_of_parts`, for a and b parts."""
    size = len(pairs) * a * b
    every, of = np.empty((size, 2), np.int32), np.empty(size, np.int32)
    first, k = 0, 0
    while first < len(pairs):
        last = first
        while last < len(pairs) and pairs[last, 0] == pairs[first, 0]:
            last += 1
        for i in range(a):
            for p in range(first, last):
                for j in range(b):
                    every[k, 0], every[k, 1], of[k] = pairs[p, 0] * a + i, pairs[p, 1] * b + j, p
                    k += 1
        first = last
    return every, of


def on_reference(element: FacetElement) -> Floats:
    """Return the coefficients (s, 3, 9) of the parts of the reference facet."""
    x = element.points[np.array(element.sub_facets)]  # (s, k', d-1)
    return coefficients(Facets(element.part or element, np.pad(x, ((0, 0), (0, 0), (0, 1)))))


def coefficients(facets: Facets) -> Floats:
    """Return the coefficients c (m, 3, 9) of facets: of x_i at 3 a + b.

    Example:
        >>> from dolfinx_mortar.geometry.elements import TRI3
        >>> x = np.array([[[5.0, 0, 0], [7, 0, 0], [5, 1, 0]]])
        >>> coefficients(Facets(TRI3, x))[0, 0].tolist()
        [5.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    """
    return np.ascontiguousarray(np.swapaxes(facets.element.table.T @ facets.x, 1, 2))


# by number: a view of each facet costs as much as a point


@numba.njit(**KERNEL)
def _component(c, m, i, r, s):  # type: ignore[no-untyped-def]
    """Return component i of a point of facet m and of its tangents."""
    c1, c2, c4, c5, c7, c8 = c[m, i, 1], c[m, i, 2], c[m, i, 4], c[m, i, 5], c[m, i, 7], c[m, i, 8]
    mid, high = c[m, i, 3] + s * (c4 + s * c5), c[m, i, 6] + s * (c7 + s * c8)
    along = (c1 + 2 * s * c2) + r * ((c4 + 2 * s * c5) + r * (c7 + 2 * s * c8))
    return c[m, i, 0] + s * (c1 + s * c2) + r * (mid + r * high), mid + 2 * r * high, along


@numba.njit(**KERNEL)
def _point(c, m, r, s):  # type: ignore[no-untyped-def]
    """Return a point of facet m, and the area per reference area."""
    x0, a0, b0 = _component(c, m, FIRST, r, s)
    x1, a1, b1 = _component(c, m, SECOND, r, s)
    x2, a2, b2 = _component(c, m, THIRD, r, s)
    n0, n1, n2 = a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0
    return x0, x1, x2, np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)


@numba.njit(**KERNEL)
def _on_facet(c, r, s):  # type: ignore[no-untyped-def]
    """Return the coordinates on the facet of a point of part c (3, 9)."""
    return c[0, 0] + s * c[0, 1] + r * c[0, 3], c[1, 0] + s * c[1, 1] + r * c[1, 3]


@numba.njit(**KERNEL)
def along(c, m, axes, P):  # type: ignore[no-untyped-def]
    """Write the coefficients of facet m in a plane into P (1, 2, 9)."""
    for a in range(2):
        for k in range(9):
            P[0, a, k] = 0.0
            for j in range(3):
                P[0, a, k] += axes[a, j] * c[m, j, k]


@numba.njit(**KERNEL)
def meet(P, x, y, r, s):  # type: ignore[no-untyped-def]
    """Return (r, s) where a projected facet P (1, 2, 9) has the point (x, y), or NaN, by Newton."""
    for _ in range(LIMIT):
        y0, a0, b0 = _component(P, FIRST, FIRST, r, s)
        y1, a1, b1 = _component(P, FIRST, SECOND, r, s)
        e0, e1, inverse = x - y0, y - y1, 1.0 / (a0 * b1 - a1 * b0)
        dr, ds = (e0 * b1 - e1 * b0) * inverse, (a0 * e1 - a1 * e0) * inverse
        r, s = r + dr, s + ds
        if max(abs(dr), abs(ds)) <= HALF_OF_DIGITS:  # the next one is round-off
            return r, s
    return np.nan, np.nan


@numba.njit(**KERNEL)
def _place(  # type: ignore[no-untyped-def]
    slave, master, reference_s, reference_m, axes, part, xi_s, xi_m, weight, scale
):
    """See `on_facets`; facets by their coefficients."""
    on_s, on_m, area = np.empty(xi_s.shape), np.empty(xi_m.shape), np.empty(len(weight))
    P = np.empty((1, 2, 9))
    a, b = len(reference_s), len(reference_m)
    i = j = of_i = of_j = np.int64(0)  # one type of integers: compiled once
    for q in range(len(weight)):
        if q == 0 or part[q, 0] != i or part[q, 1] != j:
            i, j = np.int64(part[q, 0]), np.int64(part[q, 1])
            of_i, of_j = i // a, j // b
            along(master, of_j, axes[i], P)
        r, s = _on_facet(reference_s[i - a * of_i], xi_s[q, 0], xi_s[q, 1])
        x, y, z, J = _point(slave, of_i, r, s)
        u = axes[i, 0, 0] * x + axes[i, 0, 1] * y + axes[i, 0, 2] * z
        v = axes[i, 1, 0] * x + axes[i, 1, 1] * y + axes[i, 1, 2] * z
        p, t = _on_facet(reference_m[j - b * of_j], xi_m[q, 0], xi_m[q, 1])
        on_s[q, 0], on_s[q, 1], area[q] = r, s, weight[q] * scale * J
        on_m[q, 0], on_m[q, 1] = meet(P, u, v, p, t)
    return on_s, on_m, area


def on_facets(
    slave: Facets,
    master: Facets,
    axes: Floats,
    part: Ints,
    *,
    xi_s: Floats,
    xi_m: Floats,
    weight: Floats,
) -> tuple[Floats, Floats, Floats]:
    """Return xi_s, xi_m (q, 2) and weights (q,) of points on the facets' true surfaces.

    xi_m is NaN where the line through a point misses the master.

    Args:
        axes: (ms * s, 3, 3) of the slave parts' planes; the last is the direction of projection.
        part: (q, 2) parts of slave and master, to which xi_s, xi_m and weight belong.
    """
    part_s = slave.element.part or slave.element
    scale = slave.element.size / (count(slave.element) * part_s.size)
    facets = (coefficients(f) for f in (slave, master))
    references = (on_reference(f.element) for f in (slave, master))
    on_s, on_m, area = _place(*facets, *references, axes, part, xi_s, xi_m, weight, scale)
    return on_s, on_m, area

# SPDX-License-Identifier: MIT
"""Parts of slave facets in space, their auxiliary planes, convex polygons in these (kernels).

A part is a facet of first order, or one of four between the nodes of a facet of second order. All
are x = sum_ab c_ab xi^a eta^b with a, b <= 2. In a plane the slave facet has radius 1. Polygons are
anticlockwise, with `n` vertices in an array; vertices nearer to a line than ROUND_OFF lie on it.
Numba's cache of a caller in another file does not notice changes here: touch that file, too.
"""

import numba
import numpy as np

from dolfinx_mortar.common.arrays import HALF_OF_DIGITS, LIMIT, TINY, Bools, Floats, Ints
from dolfinx_mortar.geometry.facets import FacetElement, Facets, bounding_balls, facet_normals, unit
from dolfinx_mortar.geometry.tolerances import FIRST, KERNEL, ROUND_OFF, SECOND, THIRD


def count(element: FacetElement) -> int:
    """Number s of parts of a facet."""
    return len(element.sub_facets)


def parts_of(facets: Facets) -> Facets:
    """Parts (m * s,) of facets (m,), ordered by facet."""
    element = facets.element
    if element.part is None:
        return facets
    x = facets.x[:, np.array(element.sub_facets)]
    return Facets(element.part, np.ascontiguousarray(x.reshape(-1, *x.shape[2:])))


def pairs_of_parts(pairs: Ints, slave: FacetElement, master: FacetElement) -> tuple[Ints, Ints]:
    """Pairs of parts (p', 2), ordered by slave, and the pair (p',) of each.

    >>> from dolfinx_mortar.geometry.facets import TRI3
    >>> pairs, of = pairs_of_parts(np.array([[0, 3], [0, 5]], dtype=np.int32), TRI3, TRI3)
    >>> pairs.tolist(), of.tolist()
    ([[0, 3], [0, 5]], [0, 1])
    """
    a, b = count(slave), count(master)
    each = np.stack(np.divmod(np.arange(a * b), b), axis=1)
    every = (pairs[:, None] * [a, b] + each).reshape(-1, 2).astype(np.int32)
    order = np.argsort(every[:, 0], kind="stable")
    return every[order], np.repeat(np.arange(len(pairs), dtype=np.int32), a * b)[order]


def reference_parts(element: FacetElement) -> Floats:
    """Nodes (s, k, 2) of parts on the reference facet."""
    return element.points[np.array(element.sub_facets)]


def coefficients(facets: Facets) -> Floats:
    """Coefficients c (m, 3, 9) of facets: of x_i at 3 a + b.

    Example:
        >>> from dolfinx_mortar.geometry.facets import TRI3
        >>> x = np.array([[[5.0, 0, 0], [7, 0, 0], [5, 1, 0]]])
        >>> coefficients(Facets(TRI3, x))[0, 0].tolist()
        [5.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    """
    return np.ascontiguousarray(np.swapaxes(facets.element.table.T @ facets.x, 1, 2))


# by number: a view of each facet costs as much as a point


@numba.njit(**KERNEL)
def _component(c, m, i, r, s):  # type: ignore[no-untyped-def]
    c1, c2, c4, c5, c7, c8 = c[m, i, 1], c[m, i, 2], c[m, i, 4], c[m, i, 5], c[m, i, 7], c[m, i, 8]
    mid, high = c[m, i, 3] + s * (c4 + s * c5), c[m, i, 6] + s * (c7 + s * c8)
    along = (c1 + 2 * s * c2) + r * ((c4 + 2 * s * c5) + r * (c7 + 2 * s * c8))
    return c[m, i, 0] + s * (c1 + s * c2) + r * (mid + r * high), mid + 2 * r * high, along


@numba.njit(**KERNEL)
def meet(P, x, y, r, s):  # type: ignore[no-untyped-def]
    """Where (r, s) a projected facet P (1, 2, 9) has the point (x, y), or NaN, by Newton."""
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
def locate(c, i, centre, axes, r, s):  # type: ignore[no-untyped-def]
    """Coordinates in a plane of a facet's point (r, s), and its Jacobian."""
    x, a0, b0 = _component(c, i, FIRST, r, s)
    y, a1, b1 = _component(c, i, SECOND, r, s)
    z, a2, b2 = _component(c, i, THIRD, r, s)
    x, y, z = x - centre[0], y - centre[1], z - centre[2]
    n0, n1, n2 = a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0
    u = axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z
    v = axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z
    return u, v, np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)


@numba.njit(**KERNEL)
def project_map(c, j, centre, axes, P):  # type: ignore[no-untyped-def]
    """Write the coefficients of a facet in a plane into P (1, 2, 9)."""
    for a in range(2):
        for k in range(9):
            P[0, a, k] = 0.0
            for i in range(3):
                P[0, a, k] += axes[a, i] * (c[j, i, k] - (centre[i] if k == 0 else 0.0))


VERTICES = 16
"""Space for the vertices of a polygon (cost only): 8 common to two quadrilaterals."""


@numba.njit(**KERNEL)
def cut(P, n, ax, ay, bx, by, Q):  # type: ignore[no-untyped-def]
    """Write the part of P left of the line from a to b into Q; return its size."""
    dx, dy = bx - ax, by - ay
    scale = 1.0 / np.sqrt(dx**2 + dy**2)
    dx, dy = scale * dx, scale * dy
    m = 0
    before = n - 1
    d0 = dx * (P[before, 1] - ay) - dy * (P[before, 0] - ax)
    for i in range(n):
        d1 = dx * (P[i, 1] - ay) - dy * (P[i, 0] - ax)
        apart = min(d0, d1) < -ROUND_OFF and max(d0, d1) > ROUND_OFF
        if apart and m < VERTICES:
            t = d0 / (d0 - d1)
            Q[m, 0] = P[before, 0] + t * (P[i, 0] - P[before, 0])
            Q[m, 1] = P[before, 1] + t * (P[i, 1] - P[before, 1])
            m += 1
        if d1 >= -ROUND_OFF and m < VERTICES:
            Q[m, 0], Q[m, 1] = P[i, 0], P[i, 1]
            m += 1
        before, d0 = i, d1
    return m


@numba.njit(**KERNEL)
def copy(P, n, Q):  # type: ignore[no-untyped-def]
    """Write the polygon P into Q: loops, as array assignments take a second each to compile."""
    for i in range(n):
        Q[i, 0], Q[i, 1] = P[i, 0], P[i, 1]


@numba.njit(**KERNEL)
def measure(P, n):  # type: ignore[no-untyped-def]
    """Area and centroid of P, or the mean of its vertices if the area is 0."""
    area, x, y, mx, my = 0.0, 0.0, 0.0, P[0, 0], P[0, 1]
    for i in range(1, n):
        mx, my = mx + P[i, 0], my + P[i, 1]
    mx, my = mx / n, my / n
    for i in range(n):
        j = i + 1 if i + 1 < n else 0
        ux, uy = P[i, 0] - mx, P[i, 1] - my
        vx, vy = P[j, 0] - mx, P[j, 1] - my
        part = (ux * vy - uy * vx) / 2
        area += part
        x, y = x + part * (ux + vx) / 3, y + part * (uy + vy) / 3
    if area > 0.0:
        mx, my = mx + x / area, my + y / area
    return area, mx, my


@numba.njit(**KERNEL)
def is_thin(P, n):  # type: ignore[no-untyped-def]
    """Whether P is as narrow as errors of cuts, or no polygon."""
    if n < 3:
        return True
    square = 0.0
    for i in range(1, n):
        dx, dy = (P[i, 0] - P[0, 0]), (P[i, 1] - P[0, 1])
        square = max(square, dx * dx + dy * dy)
    return measure(P, n)[0] <= 8 * ROUND_OFF * np.sqrt(square)


@numba.njit(**KERNEL)
def orientation(P, n):  # type: ignore[no-untyped-def]
    """Sign 1 or -1 of an anticlockwise or clockwise convex polygon, 0 for any other.

    Corners below HALF_OF_DIGITS of the areas are straight.
    """
    least, most, whole = np.inf, -np.inf, 0.0
    for i in range(n):
        j, h = (i + 1) % n, (i + n - 1) % n
        ux, uy = P[j, 0] - P[i, 0], P[j, 1] - P[i, 1]
        vx, vy = P[h, 0] - P[i, 0], P[h, 1] - P[i, 1]
        corner = ux * vy - uy * vx
        least, most, whole = min(least, corner), max(most, corner), whole + abs(corner)
    if least > HALF_OF_DIGITS * whole:
        return 1
    return -1 if most < -HALF_OF_DIGITS * whole else 0


@numba.njit(**KERNEL)
def intersect(P, n, Q, m, sign, out, spare):  # type: ignore[no-untyped-def]
    """Write P cut by the convex Q into out; return its size."""
    copy(P, n, out)
    for i in range(m):
        j = i + 1 if i + 1 < m else 0
        a, b = (i, j) if sign > 0 else (j, i)
        n = cut(out, n, Q[a, 0], Q[a, 1], Q[b, 0], Q[b, 1], spare)
        copy(spare, n, out)
        if n < 3:
            return 0
    return n


@numba.njit(**KERNEL)
def is_beside(P, n, Q, m, sign, distance):  # type: ignore[no-untyped-def]
    """Whether an edge of P has all of Q beyond a distance."""
    for i in range(n):
        j = i + 1 if i + 1 < n else 0
        dx, dy = sign * (P[j, 0] - P[i, 0]), sign * (P[j, 1] - P[i, 1])
        length = np.sqrt(dx * dx + dy * dy)
        beside = length > 0.0
        for k in range(m):
            d = dx * (Q[k, 1] - P[i, 1]) - dy * (Q[k, 0] - P[i, 0])
            if d > -distance * length:
                beside = False
                break
        if beside:
            return True
    return False


def create_planes(facets: Facets) -> tuple[Floats, Floats, Floats]:
    """Centres (m, 3), axes (m, 3, 3) and radii (m,) of the auxiliary planes of facets.

    Rows of the axes are two tangents and the normal, over the radius.
    """
    centre, radius = bounding_balls(facets.x)
    radius, n = np.maximum(radius, TINY), facet_normals(facets)
    first = facets.x[:, 1] - facets.x[:, 0]
    first = unit(first - (first * n).sum(axis=1)[:, None] * n)
    return centre, np.stack([first, np.cross(n, first), n], axis=1) / radius[:, None, None], radius


@numba.njit(**KERNEL)
def project(x, centre, axes, P):  # type: ignore[no-untyped-def]
    """Write a facet in a plane's tangents and height into P."""
    for j in range(x.shape[0]):
        for i in range(3):
            P[j, i] = 0.0
            for h in range(3):
                P[j, i] += axes[i, h] * (x[j, h] - centre[h])


@numba.njit(**KERNEL)
def bilinear_map(P, i):  # type: ignore[no-untyped-def]
    """Coefficients m, a, b, c of component i of the map m + xi a + eta b + xi eta c of a facet."""
    p, q, r = P[0, i], P[1, i], P[2, i]
    if len(P) == 3:
        return p, q - p, r - p, 0.0
    s = P[3, i]
    return (p + q + r + s) / 4, (q + r - p - s) / 4, (r + s - p - q) / 4, (p + r - q - s) / 4


@numba.njit(**KERNEL)
def inverse(P, x, y):  # type: ignore[no-untyped-def]
    """Coordinates xi, eta and the Jacobian's size where the projected facet P meets (x, y).

    With p = m - (x, y), p + xi a + eta (b + xi c) = 0 times b + xi c is C + B xi + A xi^2 = 0,
    whose derivative is the Jacobian: at the root inside it has the sign of a x b.
    """
    m0, a0, b0, c0 = bilinear_map(P, FIRST)
    m1, a1, b1, c1 = bilinear_map(P, SECOND)
    p0, p1 = m0 - x, m1 - y
    A = a0 * c1 - a1 * c0
    centre = a0 * b1 - a1 * b0
    B = centre + p0 * c1 - p1 * c0
    C = p0 * b1 - p1 * b0
    sign = 1.0 if centre > 0.0 else -1.0
    J = np.sqrt(max(B * B - 4 * A * C, 0.0))
    if sign * B > 0.0:  # without cancellation
        xi = -2 * C / (B + sign * J)
    else:
        xi = (sign * J - B) / (2 * A)
    # by projection: on slivers xi is inexact, the point is not
    d0, d1 = b0 + xi * c0, b1 + xi * c1
    eta = -((p0 + xi * a0) * d0 + (p1 + xi * a1) * d1) / (d0 * d0 + d1 * d1)
    return xi, eta, J


@numba.njit(**KERNEL)
def evaluate(P, i, xi, eta):  # type: ignore[no-untyped-def]
    """Component i of the facet's point (xi, eta)."""
    m, a, b, c = bilinear_map(P, i)
    return m + xi * a + eta * (b + xi * c)


@numba.njit(**KERNEL)
def slopes(P, xi, eta):  # type: ignore[no-untyped-def]
    """Both slopes s of a facet against the plane at (xi, eta), minus those of its normal.

    Its area is sqrt(1 + s_0^2 + s_1^2) of the projection.
    """
    _, a0, b0, c0 = bilinear_map(P, FIRST)
    _, a1, b1, c1 = bilinear_map(P, SECOND)
    _, a2, b2, c2 = bilinear_map(P, THIRD)
    a0, a1, a2 = a0 + eta * c0, a1 + eta * c1, a2 + eta * c2
    b0, b1, b2 = b0 + xi * c0, b1 + xi * c1, b2 + xi * c2
    J = a0 * b1 - a1 * b0
    return (a2 * b1 - a1 * b2) / J, (a0 * b2 - a2 * b0) / J


@numba.njit(**KERNEL)
def are_apart(P, Q, distance):  # type: ignore[no-untyped-def]
    """Whether an edge of one projected facet has all of the other beyond a distance."""
    p, q = len(P), len(Q)
    one, other = orientation(P, p), orientation(Q, q)
    return (one != 0 and is_beside(P, p, Q, q, one, distance)) or (
        other != 0 and is_beside(Q, q, P, p, other, distance)
    )


@numba.njit(**KERNEL)
def _are_near(x_s, x_m, pairs, centre, axes, radius, margin):  # type: ignore[no-untyped-def]
    near = np.empty(len(pairs), dtype=np.bool_)
    S, M = np.empty((x_s.shape[1], 3)), np.empty((x_m.shape[1], 3))
    for p in range(len(pairs)):
        s = pairs[p, 0]
        if p == 0 or s != pairs[p - 1, 0]:
            project(x_s[s], centre[s], axes[s], S)
        project(x_m[pairs[p, 1]], centre[s], axes[s], M)
        near[p] = not are_apart(S, M, margin[s] / radius[s] + HALF_OF_DIGITS)
    return near


def are_near(slave: Facets, master: Facets, pairs: Ints, margin: Floats) -> Bools:
    """Which ordered pairs (p,), projected on the slave's plane, are within a margin (ms,)."""
    a, b = parts_of(slave), parts_of(master)
    of_parts, of = pairs_of_parts(pairs, slave.element, master.element)
    margins = np.repeat(margin, count(slave.element))
    near = _are_near(a.x, b.x, of_parts, *create_planes(a), margins)
    return np.bincount(of, near, minlength=len(pairs)) > 0

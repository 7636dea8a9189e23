# SPDX-License-Identifier: MIT
r"""Segments in 2D: intervals of slave facets, straight or curved.

A slave facet is x_s(xi) = sum_i N_i(xi) x_i with xi in [-1, 1], and it is projected along the
interpolated averaged nodal normals n(xi) = sum_i N_i n_i (not normalised). The point x_m(eta) of
the master facet that belongs to xi solves (x_s(xi) - x_m(eta)) x n(xi) = 0.

Second-order facets are clipped as parabolas, not as two chords: the ends of a segment are where the
normals of the curved slave facet meet the ends of the curved master facet, so that no function has
a kink inside a segment. With chords, ends and normals are off by a share of the sagitta, and the
master's functions are extrapolated beyond their ends. The kernels take the coefficients of
a + b xi + c xi^2; straight facets have c = 0. They are generic in the number type, see `moments`.
"""

from functools import cache
from typing import Any, NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from dolfinx_mortar.arrays import EPS, HALF_OF_DIGITS, Floats, Ints
from dolfinx_mortar.geometry.elements import FacetElement
from dolfinx_mortar.geometry.facets import Facets
from dolfinx_mortar.geometry.moments import (
    KERNEL,
    add_point,
    fill_functions,
    reciprocal,
    root,
)
from dolfinx_mortar.geometry.tolerances import ROUND_OFF


@numba.njit(**KERNEL)
def _at(v, xi, i):  # type: ignore[no-untyped-def]
    """Return component i of the polynomial v (3, 2) at xi."""
    return v[0, i] + xi * (v[1, i] + xi * v[2, i])


@numba.njit(**KERNEL)
def _moment(x, n, y0, y1, xi):  # type: ignore[no-untyped-def]
    """Return (x(xi) - y) x n(xi) and its derivative."""
    p0, p1 = _at(x, xi, 0) - y0, _at(x, xi, 1) - y1
    n0, n1 = _at(n, xi, 0), _at(n, xi, 1)
    dx0, dx1 = x[1, 0] + 2 * xi * x[2, 0], x[1, 1] + 2 * xi * x[2, 1]
    dn0, dn1 = n[1, 0] + 2 * xi * n[2, 0], n[1, 1] + 2 * xi * n[2, 1]
    return p0 * n1 - p1 * n0, dx0 * n1 - dx1 * n0 + p0 * dn1 - p1 * dn0


@numba.njit(**KERNEL)
def _project_node(x, n, y0, y1):  # type: ignore[no-untyped-def]
    """Return xi in [-1, 1] of the slave facet whose normal meets y; beyond an end, that end.

    f(xi) = (x(xi) - y) x n(xi) falls along the facet as long as y is nearer than the point where
    the normals of a concave facet meet; there is no answer (nan) behind that point. The root is
    bracketed: the interval is halved unless Newton's step stays in it and is at most half of the
    last step, so that the loop ends whatever f is.
    """
    zero = 0.0 * (x[0, 0] + n[0, 0] + y0)
    first, last = _moment(x, n, y0, y1, -1.0)[0].real, _moment(x, n, y0, y1, 1.0)[0].real
    if first <= 0.0 or last >= 0.0:
        if first <= 0.0 and last >= 0.0:
            return zero + np.nan
        return zero + (-1.0 if first <= 0.0 else 1.0)
    low, high, step = -1.0, 1.0, 2.0
    xi = (first + last) / (first - last)  # of the chord of f
    while step > 2 * EPS:
        f, slope = _moment(x, n, y0, y1, xi)
        if f.real > 0.0:
            low = xi
        else:
            high = xi
        new = xi - f.real / slope.real if slope.real < 0.0 else np.inf
        if not (low <= new <= high and abs(new - xi) <= max(step / 2, 2 * EPS)):
            new = (low + high) / 2
        step, xi = abs(new - xi), new
    if x.itemsize == 8:
        return zero + xi
    if abs(xi) > 1.0 - HALF_OF_DIGITS:  # where sides end together
        return zero + (1.0 if xi > 0.0 else -1.0)
    f, slope = _moment(x, n, y0, y1, xi)  # by one more step in full: exact to first order
    return zero + xi - (f / slope if slope.real < 0.0 else zero)


@numba.njit(**KERNEL)
def _opposite(x, n, y, xi):  # type: ignore[no-untyped-def]
    """Return eta on the master facet y (3, 2) that the normal of the slave facet meets at xi.

    Of the two roots of a curved facet, the one that tends to the root of the straight facet. Where
    the facets of an iterate are so curved that normals meet one of them more than once, a root may
    lie beyond its ends, where functions have no bounds: then the nearest end.
    """
    n0, n1 = _at(n, xi, 0), _at(n, xi, 1)
    C = (y[0, 0] - _at(x, xi, 0)) * n1 - (y[0, 1] - _at(x, xi, 1)) * n0
    B = y[1, 0] * n1 - y[1, 1] * n0
    A = y[2, 0] * n1 - y[2, 1] * n0
    r = root(B * B - 4 * A * C)  # the form that does not cancel
    eta = -2 * C * reciprocal(B + r if B.real > 0.0 else B - r)
    return eta if abs(eta.real) <= 1.0 else 0.0 * eta + (1.0 if eta.real > 0.0 else -1.0)


@numba.njit(**KERNEL)
def _distances(x, n, y, xi):  # type: ignore[no-untyped-def]
    """Return the distance along n(xi) to the master facet y, and how far y lies behind the slave.

    The latter against the slave's mean normal.
    """
    eta = _opposite(x, n, y, xi)
    p0, p1 = _at(x, xi, 0) - _at(y, eta, 0), _at(x, xi, 1) - _at(y, eta, 1)
    p0, p1, t0, t1 = p0.real, p1.real, x[1, 0].real, x[1, 1].real
    return np.sqrt(p0 * p0 + p1 * p1), (p0 * t1 - p1 * t0) / np.sqrt(t0 * t0 + t1 * t1)


@numba.njit(**KERNEL)
def _nearest(x, n, x_m, master, deepest, low, high, a, b):  # type: ignore[no-untyped-def]
    """Return the candidate that covers [a, b] at the smallest distance, -1 if there is none."""
    best, least = -1, np.inf
    for c in range(len(master)):
        if low[c].real <= a.real and high[c].real >= b.real:
            distance, depth = _distances(x, n, x_m[master[c]], (a + b) / 2)
            if distance < least and depth <= deepest[c]:
                best, least = c, distance
    return best


@numba.njit(**KERNEL)
def _insert(cuts, count, value):  # type: ignore[no-untyped-def]
    """Insert a value into the first `count` ascending ones."""
    while count > 0 and cuts[count - 1].real > value.real:
        cuts[count] = cuts[count - 1]
        count -= 1
    cuts[count] = value


@numba.njit(**KERNEL)
def _clip_facet(x, n, x_m, ends_m, pairs, deepest, first, last, which, ends, q):  # type: ignore[no-untyped-def]
    """Append the segments of one slave facet, of pairs first to last; no part of it occurs twice.

    Return how many there are, and whether masters hide others.
    """
    p, c, start, hidden = last - first, 0, q, False
    low, high, cuts = np.empty(p, x.dtype), np.empty(p, x.dtype), np.empty(2 * p, x.dtype)
    index, master, most = np.empty(p, np.int32), np.empty(p, np.int32), np.empty(p)
    for r in range(first, last):
        y = ends_m[pairs[r, 1]]
        # the two sides are passed in opposite directions
        a = _project_node(x, n, y[1, 0], y[1, 1])
        b = _project_node(x, n, y[0, 0], y[0, 1])
        if (b - a).real > 8 * ROUND_OFF:
            low[c], high[c], index[c], master[c] = a, b, r, pairs[r, 1]
            most[c] = deepest[r]
            for i in range(c):
                common = min(high[i].real, b.real) - max(low[i].real, a.real)
                hidden = hidden or common > 8 * ROUND_OFF
            _insert(cuts, 2 * c, a)
            _insert(cuts, 2 * c + 1, b)
            c += 1
    for i in range(2 * c - 1):
        a, b = cuts[i], cuts[i + 1]
        if (b - a).real <= 8 * ROUND_OFF:
            continue
        best = _nearest(x, n, x_m, master[:c], most, low, high, a, b)
        if best < 0:
            continue
        if q > start and which[q - 1] == index[best] and ends[q - 1, 1].real == a.real:
            ends[q - 1, 1] = b
            continue
        which[q], ends[q, 0], ends[q, 1] = index[best], a, b
        q += 1
    return q, hidden


@numba.njit(cache=True)
def _clip(x_s, n_s, x_m, ends_m, pairs, deepest):  # type: ignore[no-untyped-def]
    """Return the pair and the ends in xi of all segments."""
    p = len(pairs)
    which, ends = np.empty(2 * p, dtype=np.int32), np.empty((2 * p, 2))
    q = last = np.int64(0)
    while last < p:
        first, s = last, pairs[last, 0]
        while last < p and pairs[last, 0] == s:
            last += 1
        at = x_s[s], n_s[s], x_m, ends_m, pairs, deepest, first, last
        q, _ = _clip_facet(*at, which, ends, q)
    return which[:q], ends[:q]


@numba.njit(**KERNEL)
def _point(x, n, y, low, high, t):  # type: ignore[no-untyped-def]
    """Return xi, eta and the length per t at t in [-1, 1] of a segment."""
    half = (high - low) / 2
    xi = (low + high) / 2 + half * t
    dx0, dx1 = x[1, 0] + 2 * xi * x[2, 0], x[1, 1] + 2 * xi * x[2, 1]
    return xi, _opposite(x, n, y, xi), half * root(dx0 * dx0 + dx1 * dx1)


@numba.njit(cache=True)
def _place(x_s, n_s, x_m, pairs, which, ends, points, weights):  # type: ignore[no-untyped-def]
    """Return xi_s, xi_m and weight of all quadrature points, those of a segment together."""
    k = len(points)
    xi_s, xi_m = np.empty(len(which) * k), np.empty(len(which) * k)
    weight = np.empty(len(which) * k)
    for i in range(len(which)):
        s, m = pairs[which[i]]
        for j in range(k):
            q, ab = i * k + j, ends[i]
            at = _point(x_s[s], n_s[s], x_m[m], ab[0], ab[1], points[j])
            xi_s[q], xi_m[q], weight[q] = at[0], at[1], weights[j] * at[2]
    return xi_s, xi_m, weight


@numba.njit(**KERNEL)
def _polynomial(v, table, result):  # type: ignore[no-untyped-def]
    """Write the coefficients (3, 2) of the field with nodal values v (k, 2), see `_polynomials`."""
    for a in range(3):
        for i in range(2):
            result[a, i] = 0.0
            for j in range(len(v)):
                result[a, i] += table[j, 3 * a] * v[j, i]


class Tables(NamedTuple):
    """What `moments` needs of the two types of facets."""

    slave: Floats  # (k, 9) coefficients of functions, see `moments.fill_functions`
    master: Floats  # (l, 9)
    points: Floats  # (q,)
    weights: Floats  # (q,)


def tables(slave: FacetElement, master: FacetElement, smooth: bool) -> Tables:
    """Return the tables of two types, the same for smooth surfaces."""
    rule = gauss_points(2 * max(slave.degree, master.degree) + 1)
    return Tables(slave.table, master.table, *rule)


@numba.njit(**KERNEL)
def moments(x, n, Y, deepest, reach, factor, heights, positive, tables, S, R, H):  # type: ignore[no-untyped-def]
    """Add the moments of a slave facet x (k, 2) and its masters Y (c, l, 2) to S, R (c, k, l), H.

    Return whether masters hide others. For the other arguments see `moments.add_point`.

    Args:
        n: (k, 2) directions of projection.
        deepest: (c,) see `place_points`.
        tables: of `tables`.
    """
    c, zero = len(Y), x.dtype
    p_s, p_n, p_m = np.empty((3, 2), zero), np.empty((3, 2), zero), np.empty((c, 3, 2), zero)
    N, M = np.empty(len(x), zero), np.empty(Y.shape[1], zero)
    pairs, which = np.empty((c, 2), np.int32), np.empty(2 * c, np.int32)
    ends = np.empty((2 * c, 2), zero)
    given = reach, factor, heights, positive, S, R, H
    _polynomial(x, tables.slave, p_s)
    _polynomial(n, tables.slave, p_n)
    for r in range(c):
        _polynomial(Y[r], tables.master, p_m[r])
        pairs[r, 0], pairs[r, 1] = 0, r
    count, hidden = _clip_facet(p_s, p_n, p_m, Y, pairs, deepest, 0, c, which, ends, 0)
    for i in range(count):
        r = which[i]
        for q in range(len(tables.points)):
            xi, eta, size = _point(p_s, p_n, p_m[r], ends[i, 0], ends[i, 1], tables.points[q])
            fill_functions(tables.slave, xi, 0.0, N)
            fill_functions(tables.master, eta, 0.0, M)
            add_point(N, M, tables.weights[q] * size, r, x, Y[r], *given)
    return hidden


def _polynomials(element: FacetElement, v: Floats) -> Floats:
    """Return the coefficients (m, 3, 2) of 1, xi and xi^2 of fields with nodal values v (m, k, 2).

    >>> from dolfinx_mortar.geometry.elements import LINE3
    >>> _polynomials(LINE3, np.array([[[0.0, 1.0], [2.0, 1.0], [1.0, 3.0]]])).tolist()
    [[[1.0, 3.0], [1.0, 0.0], [0.0, -2.0]]]
    """
    return np.asarray(element.table[:, ::3].T @ v)


@cache
def gauss_points(n: int) -> tuple[Floats, Floats]:
    """Return n Gauss points on [-1, 1] and their weights, sum 2; nobody may change them.

    >>> gauss_points(1)[0].tolist(), gauss_points(1)[1].tolist()
    ([0.0], [2.0])
    """
    points, weights = np.polynomial.legendre.leggauss(n)  # .5 ms: eigenvalues of a matrix
    return points, weights


def place_points(
    slave: Facets, n_s: Floats, master: Facets, pairs: Ints, deepest: Floats
) -> tuple[npt.NDArray[Any], Floats, Floats, Floats]:
    """Project, clip and place Gauss points on every segment: three, on facets of degree two five.

    On straight parallel facets they integrate Phi_j N_l of both sides exactly. On others the map
    between them is no polynomial, nor is the length of a curved one.

    Args:
        slave: Slave facets (ms,).
        n_s: Averaged normals (ms, k, 2) at their nodes.
        master: Master facets (mm,).
        pairs: Pairs (p, 2) that face each other, ordered by slave facet.
        deepest: How far (p,) behind the slave facet the master may lie, in the middle of a part.

    Returns:
        Index into the pairs (q,), xi_s (q, 1), xi_m (q, 1) and weight (q,) of the points.
    """
    x_s, n = (_polynomials(slave.element, v) for v in (slave.x, n_s))
    x_m = _polynomials(master.element, master.x)
    corners = np.ascontiguousarray(master.x[:, master.element.vertices])
    which, ends = _clip(x_s, n, x_m, corners, pairs, deepest)
    degree = max(slave.element.degree, master.element.degree)
    points, weights = gauss_points(2 * degree + 1)
    xi_s, xi_m, weight = _place(x_s, n, x_m, pairs, which, ends, points, weights)
    return np.repeat(which, len(points)), xi_s[:, None], xi_m[:, None], weight

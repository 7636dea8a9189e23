# SPDX-License-Identifier: MIT
r"""Segments in 2D: intervals of slave facets, straight or curved.

A slave facet is x_s(xi) = sum_i N_i(xi) x_i with xi in [-1, 1], and it is projected along the
interpolated averaged nodal normals n(xi) = sum_i N_i n_i (not normalised). The point x_m(eta) of
the master facet that belongs to xi solves (x_s(xi) - x_m(eta)) x n(xi) = 0.

Second-order facets are clipped as parabolas, not as two chords: the ends of a segment are where the
normals of the curved slave facet meet the ends of the curved master facet, so that no function has
a kink inside a segment. With chords, ends and normals are off by a share of the sagitta, and the
master's functions are extrapolated beyond their ends. The kernels take the coefficients of
a + b xi + c xi^2; straight facets have c = 0.
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
    add_heights,
    add_row,
    begin_point,
    create_point,
    fill_functions,
    fill_rows,
    fill_slopes,
    fill_turns,
    gather,
    move_to,
    take_row,
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
    first, last = _moment(x, n, y0, y1, -1.0)[0], _moment(x, n, y0, y1, 1.0)[0]
    if first <= 0.0 or last >= 0.0:
        if first <= 0.0 and last >= 0.0:
            return np.nan
        return -1.0 if first <= 0.0 else 1.0
    low, high, step = -1.0, 1.0, 2.0
    xi = (first + last) / (first - last)  # of the chord of f
    while step > 2 * EPS:
        f, slope = _moment(x, n, y0, y1, xi)
        if f > 0.0:
            low = xi
        else:
            high = xi
        new = xi - f / slope if slope < 0.0 else np.inf
        if not (low <= new <= high and abs(new - xi) <= max(step / 2, 2 * EPS)):
            new = (low + high) / 2
        step, xi = abs(new - xi), new
    return xi


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
    r = np.sqrt(max(B * B - 4 * A * C, 0.0))  # the form that does not cancel
    eta = -2 * C / (B + r if B > 0.0 else B - r)
    return min(max(eta, -1.0), 1.0)


@numba.njit(**KERNEL)
def _distances(x, n, y, xi):  # type: ignore[no-untyped-def]
    """Return the distance along n(xi) to the master facet y, and how far y lies behind the slave.

    The latter against the slave's mean normal.
    """
    eta = _opposite(x, n, y, xi)
    p0, p1 = _at(x, xi, 0) - _at(y, eta, 0), _at(x, xi, 1) - _at(y, eta, 1)
    t0, t1 = x[1, 0], x[1, 1]
    return np.sqrt(p0 * p0 + p1 * p1), (p0 * t1 - p1 * t0) / np.sqrt(t0 * t0 + t1 * t1)


@numba.njit(**KERNEL)
def _nearest(x, n, x_m, master, deepest, low, high, a, b):  # type: ignore[no-untyped-def]
    """Return the candidate that covers [a, b] at the smallest distance, -1 if there is none."""
    best, least = -1, np.inf
    for c in range(len(master)):
        if low[c] <= a and high[c] >= b:
            distance, depth = _distances(x, n, x_m[master[c]], (a + b) / 2)
            if distance < least and depth <= deepest[c]:
                best, least = c, distance
    return best


@numba.njit(**KERNEL)
def _insert(cuts, count, value):  # type: ignore[no-untyped-def]
    """Insert a value into the first `count` ascending ones."""
    while count > 0 and cuts[count - 1] > value:
        cuts[count] = cuts[count - 1]
        count -= 1
    cuts[count] = value


@numba.njit(**KERNEL)
def _clip_facet(x, n, x_m, ends_m, pairs, deepest, first, last, which, ends, q):  # type: ignore[no-untyped-def]
    """Append the segments of one slave facet, of pairs first to last; no part of it occurs twice.

    Return how many there are, and whether masters hide others.
    """
    p, c, start, hidden = last - first, 0, q, False
    low, high, cuts = np.empty(p), np.empty(p), np.empty(2 * p)
    index, master, most = np.empty(p, np.int32), np.empty(p, np.int32), np.empty(p)
    for r in range(first, last):
        y = ends_m[pairs[r, 1]]
        # the two sides are passed in opposite directions
        a = _project_node(x, n, y[1, 0], y[1, 1])
        b = _project_node(x, n, y[0, 0], y[0, 1])
        if (b - a) > 8 * ROUND_OFF:
            low[c], high[c], index[c], master[c] = a, b, r, pairs[r, 1]
            most[c] = deepest[r]
            for i in range(c):
                common = min(high[i], b) - max(low[i], a)
                hidden = hidden or common > 8 * ROUND_OFF
            _insert(cuts, 2 * c, a)
            _insert(cuts, 2 * c + 1, b)
            c += 1
    for i in range(2 * c - 1):
        a, b = cuts[i], cuts[i + 1]
        if (b - a) <= 8 * ROUND_OFF:
            continue
        best = _nearest(x, n, x_m, master[:c], most, low, high, a, b)
        if best < 0:
            continue
        if q > start and which[q - 1] == index[best] and ends[q - 1, 1] == a:
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
    return xi, _opposite(x, n, y, xi), half * np.sqrt(dx0 * dx0 + dx1 * dx1)


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
    corners: int  # of a slave facet
    points: Floats  # (q,)
    weights: Floats  # (q,)


def tables(slave: FacetElement, master: FacetElement, smooth: bool) -> Tables:
    """Return the tables of two types, the same for smooth surfaces."""
    rule = gauss_points(2 * max(slave.degree, master.degree) + 1)
    return Tables(slave.table, master.table, len(slave.vertices), *rule)


@numba.njit(**KERNEL)
def moments(x, n, y, start, place, deepest, reach, factor, heights, positive, tables, found):  # type: ignore[no-untyped-def]
    """Add the moments of slave facets x (p, k, 2) and their masters, and derivatives.

    Args:
        n: (p, k, 2) directions of projection.
        y: (p, m, 2) the different nodes of the masters.
        start: (p + 1,) first pairs of the facets.
        place: (c, l) nodes of the pairs' masters.
        deepest: (c,) see `place_points`.
        reach: (p, 2) the gap from which on weights fall, and how fast; (p, 0) where nothing falls.
        factor: (p, k) of `moments.begin_point`, as heights.
        positive: of `moments.fill_rows`.
        tables: of `tables`.
        found: `moments.Sums`, by the coordinates of x, n and y.
    """
    (k, d), m, l = x.shape[1:], y.shape[1], place.shape[1]  # noqa: E741
    p, p_s, p_n = create_point(k, l), np.empty((3, d)), np.empty((3, d))
    last = d * (2 * k + m)  # the values themselves, then derivatives by both ends
    turns, totals = np.zeros((2, d)), np.zeros((last + 3, k * (k + l + 1)))
    for f in range(len(x)):
        first, c, facet = start[f], start[f + 1] - start[f], x[f, :2]
        which, ends = np.empty(2 * c, np.int32), np.empty((2 * c, 2))
        p_m, Y, pairs = np.empty((c, 3, d)), np.empty((c, l, d)), np.zeros((c, 2), np.int32)
        _polynomial(x[f], tables.slave, p_s)
        _polynomial(n[f], tables.slave, p_n)
        for r in range(c):
            gather(y[f], place[first + r], Y[r])
            _polynomial(Y[r], tables.master, p_m[r])
            pairs[r, 1] = r
        least, zero = deepest[first : start[f + 1]], np.int64(0)
        count, _ = _clip_facet(p_s, p_n, p_m, Y, pairs, least, zero, c, which, ends, zero)
        for i in range(count):
            r, half = which[i], (ends[i, 1] - ends[i, 0]) / 2
            at = p_s, p_n, p_m[r], p, facet, turns, reach[f], factor[f], heights, first + r
            for q in range(len(tables.points)):
                t = tables.points[q]
                w, e_s, e_m, motion = _weigh_at(ends[i, 0] + half * (1.0 + t), *at, tables)
                fill_rows(p, k, tables.weights[q] * half * w, positive, True)
                add_row(p, 4, 1.0, totals, last)
                add_heights(p, k, first + r, e_s, e_m, found)
                _add_changes(p, k, motion, turns, place[first + r], p.f[k : k + l], totals)
                for j in range(2):
                    sign = 1.0 if j == 1 else -1.0
                    add_row(p, 0, (1.0 + sign * t) / 2, totals, last + 1 + j)
                    add_row(p, 4, sign / (2.0 * half), totals, last + 1 + j)
            for j in range(2):
                take_row(p, 4, totals, last + 1 + j)
                if abs(ends[i, j]) < 1.0 - HALF_OF_DIGITS:  # otherwise sides end together
                    masters = y[f], place[first : start[f + 1]], r
                    _add_end(ends[i, j], p_s, p_n, *masters, p, k, turns, tables, totals)
            for z in range(last):
                move_to(totals, z, k, place, first + r, found.changes[f, z])
            move_to(totals, last, k, place, first + r, found.values[f])


@numba.njit(**KERNEL)
def _add_end(xi, x, n, y, place, r, p, k, turns, tables, totals):  # type: ignore[no-untyped-def]
    """Add the derivatives by an end of a segment of pair r, which the last row holds."""
    node = _node_at(x, n, y, place, r, xi)
    fill_functions(tables.slave, xi, 0.0, p.f, 0)
    _, slope = _moment(x, n, y[node, 0], y[node, 1], xi)
    p0, p1 = _at(x, xi, 0) - y[node, 0], _at(x, xi, 1) - y[node, 1]
    n0, n1 = _at(n, xi, 0), _at(n, xi, 1)
    motion = n0, n1, p0, p1, 0.0, -1.0 / slope, 0.0, 0.0, 0.0, 0.0, 0.0
    _add_changes(p, k, motion, turns, np.full(1, node), np.ones(1), totals)


@numba.njit(**KERNEL)
def _node_at(x, n, y, place, r, xi):  # type: ignore[no-untyped-def]
    """Return the end of a master, of r first, that the normal of the slave facet meets at xi."""
    best, least = -1, np.inf
    for c in range(len(place)):
        for b in range(2):
            i = place[(r + c) % len(place), b]
            f, slope = _moment(x, n, y[i, 0], y[i, 1], xi)
            if abs(f) < least:
                best, least = i, abs(f)
        if least <= HALF_OF_DIGITS * abs(slope):
            break
    return best


@numba.njit(**KERNEL)
def _weigh_at(xi, x, n, y, p, facet, turns, reach, factor, heights, c, tables):  # type: ignore[no-untyped-def]
    """Place a point of pair c; return its weight per xi, dh/d(N.Q N), and how it moves.

    The latter are n(xi) and the offset x - y, whose cross product eta keeps at 0, the derivatives
    by that product of eta and of xi, those of the logarithm of the length by the tangent, and of
    that of the weight by the gap along a normal, which `turns`. Derivatives by xi of the slave
    facet are those with eta.
    """
    k, eta = len(factor), _opposite(x, n, y, xi)
    for i in range(len(p.f)):
        p.df[0, i] = 0.0
    fill_functions(tables.slave, xi, 0.0, p.f, 0)
    fill_slopes(tables.slave, xi, 0.0, p.df, 0, 0)
    fill_functions(tables.master, eta, 0.0, p.f, k)
    fill_slopes(tables.master, eta, 0.0, p.df, 2, k)
    p.by_weight[0] = p.by_weight[1] = p.by_weight[2] = p.by_weight[3] = 0.0
    scale, e_s, e_m = begin_point(p, factor, c, heights)
    t0, t1 = x[1, 0] + 2 * xi * x[2, 0], x[1, 1] + 2 * xi * x[2, 1]
    e0, e1 = y[1, 0] + 2 * eta * y[2, 0], y[1, 1] + 2 * eta * y[2, 1]
    n0, n1, square = _at(n, xi, 0), _at(n, xi, 1), t0 * t0 + t1 * t1
    p0, p1 = _at(x, xi, 0) - _at(y, eta, 0), _at(x, xi, 1) - _at(y, eta, 1)
    rate = 1.0 / (e0 * n1 - e1 * n0) if abs(eta) < 1.0 else 0.0  # held at an end
    part, fall, m0, m1 = 1.0, 0.0, facet[1, 1] - facet[0, 1], facet[0, 0] - facet[1, 0]
    length = np.sqrt(m0 * m0 + m1 * m1)
    m0, m1 = m0 / length, m1 / length
    if len(reach):
        part = 1.0 + reach[1] * (p0 * m0 + p1 * m1 + reach[0])
        if 0.0 < part < 1.0:
            fall = -reach[1] / part
            p.by_weight[2] += fall * (e0 * m0 + e1 * m1)
            fill_turns(np.array([-p0, -p1]), facet, turns)
        part = min(max(part, 0.0), 1.0)
    along = 2.0 * (t0 * x[2, 0] + t1 * x[2, 1]) / square - fall * (t0 * m0 + t1 * m1)
    slope = rate * _moment(x, n, _at(y, eta, 0), _at(y, eta, 1), xi)[1]
    p.by_weight[0] += along + slope * p.by_weight[2]
    for i in range(len(p.f)):
        p.df[0, i] += slope * p.df[2, i]
    motion = n0, n1, p0, p1, rate, 0.0, t0 / square, t1 / square, fall * m0, fall * m1, fall
    return scale * part * np.sqrt(square), e_s, e_m, motion


@numba.njit(**KERNEL)
def _add_changes(p, k, motion, turns, nodes, shares, totals):  # type: ignore[no-untyped-def]
    """Add the derivatives of a point, or of what an end of a segment moves across.

    Args:
        motion: of `_weigh_at`, or of an end, where the second derivative is that of xi.
        turns: (2, 2) derivatives of the gap by the ends of the slave facet, as its normal turns.
        nodes: those of the master that move the point, with shares.
        totals: (z, ..) derivatives.
    """
    n0, n1, p0, p1, eta, end, t0, t1, m0, m1, fall = motion
    for a in range(k):
        for i in range(2):
            F, rate = p.f[a] * (n1 if i == 0 else -n0), p.df[0, a] * (t0 if i == 0 else t1)
            rate += end * F - p.f[a] * (m0 if i == 0 else m1)
            if fall != 0.0 and a < 2:
                rate += fall * turns[a, i]
            add_row(p, 2, eta * F, totals, 2 * a + i)
            add_row(p, 4, rate, totals, 2 * a + i)
            F = p.f[a] * (-p1 if i == 0 else p0)
            add_row(p, 2, eta * F, totals, 2 * (k + a) + i)
            add_row(p, 4, end * F, totals, 2 * (k + a) + i)
    for b in range(len(nodes)):
        for i in range(2):
            F, z = -shares[b] * (n1 if i == 0 else -n0), 2 * (2 * k + nodes[b]) + i
            rate = end * F + shares[b] * (m0 if i == 0 else m1)
            add_row(p, 2, eta * F, totals, z)
            add_row(p, 4, rate, totals, z)


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

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

from dolfinx_mortar.arrays import EPS, HALF_OF_DIGITS, Bools, Floats, Ints, Longs
from dolfinx_mortar.geometry.elements import FacetElement
from dolfinx_mortar.geometry.facets import Facets
from dolfinx_mortar.geometry.moments import FIRST, KERNEL, SECOND, Sums
from dolfinx_mortar.geometry.tolerances import ROUND_OFF


@numba.njit(**KERNEL)
def _at(v, xi, i):  # type: ignore[no-untyped-def]
    """Return component i of the polynomial v (3, 2) at xi."""
    return v[0, i] + xi * (v[1, i] + xi * v[2, i])


@numba.njit(**KERNEL)
def _moment(x, n, y0, y1, xi):  # type: ignore[no-untyped-def]
    """Return (x(xi) - y) x n(xi) and its derivative."""
    p0, p1 = _at(x, xi, FIRST) - y0, _at(x, xi, SECOND) - y1
    n0, n1 = _at(n, xi, FIRST), _at(n, xi, SECOND)
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
    n0, n1 = _at(n, xi, FIRST), _at(n, xi, SECOND)
    C = (y[0, 0] - _at(x, xi, FIRST)) * n1 - (y[0, 1] - _at(x, xi, SECOND)) * n0
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
    p0, p1 = _at(x, xi, FIRST) - _at(y, eta, FIRST), _at(x, xi, SECOND) - _at(y, eta, SECOND)
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
    """Append the segments of one slave facet, of pairs first to last; return how many there are.

    No part of it occurs twice.
    """
    p, c, start = last - first, 0, q
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
    return q


@numba.njit(**KERNEL)
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
        q = _clip_facet(*at, which, ends, q)
    return which[:q], ends[:q]


@numba.njit(**KERNEL)
def _point(x, n, y, low, high, t):  # type: ignore[no-untyped-def]
    """Return xi, eta and the length per t at t in [-1, 1] of a segment."""
    half = (high - low) / 2
    xi = (low + high) / 2 + half * t
    dx0, dx1 = x[1, 0] + 2 * xi * x[2, 0], x[1, 1] + 2 * xi * x[2, 1]
    return xi, _opposite(x, n, y, xi), half * np.sqrt(dx0 * dx0 + dx1 * dx1)


@numba.njit(**KERNEL)
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


class Tables(NamedTuple):
    """What `moments` needs of the two types of facets."""

    slave: Floats  # (k, 3) coefficients of 1, xi, xi^2 of the functions
    master: Floats  # (l, 3)
    corners: int  # of a slave facet
    points: Floats  # (q,)
    weights: Floats  # (q,)


def tables(slave: FacetElement, master: FacetElement, smooth: bool) -> Tables:
    """Return the tables of two types, the same for smooth surfaces."""
    rule = gauss_points(2 * max(slave.degree, master.degree) + 1)
    return Tables(slave.table[:, ::3], master.table[:, ::3], len(slave.vertices), *rule)


class _Points(NamedTuple):
    """Points (s, q) of segments."""

    N: Floats  # (s, q, k) functions of the slave facet
    M: Floats  # (s, q, m) functions of the masters' nodes
    apart: Floats  # (s, q, 2) x - y
    n: Floats  # (s, q, 2) direction of projection
    tangent: Floats  # (s, q, 2) dx/dxi
    slope: Floats  # (s, q) of f = (x - y) x n by xi, with fixed y

    def by_nodes(self) -> Floats:
        """Return the derivatives (s, q, 2 k + m, 2) of f by x, n and y."""
        along, across = _turned(self.n)[:, :, None], _turned(self.apart)[:, :, None]
        N, M = self.N[..., None], self.M[..., None]
        return np.concatenate([N * along, -N * across, -M * along], axis=2)


def _points(N: Floats, dN: Floats, M: Floats, x: Floats, n: Floats, y: Floats) -> _Points:
    """Return points with functions N and M at the nodes x (s, k, 2) and y (s, m, 2)."""
    apart, normal, tangent = N @ x - M @ y, N @ n, dN @ x
    slope = _cross(tangent, normal) + _cross(apart, dN @ n)
    return _Points(N, M, apart, normal, tangent, slope)


class _Height(NamedTuple):
    """Heights of a smooth surface at points (s, q)."""

    h: Floats
    by_xi: Floats
    by_chord: Floats  # by the logarithm of the chord's length, of arcs


def _height(N: Floats, dN: Floats, Q: Floats, arcs: Floats) -> _Height:
    """Return N.Q N as heights of arcs (s, 1, 2), see `curvature.heights_of_arcs`."""
    QN, curvature, square = N @ Q, arcs[..., 0], arcs[..., 1]
    h, left = (QN * N).sum(axis=2), 1.0 - square
    root, across = np.sqrt(square), np.sqrt(square + 2.0 * curvature * h)
    # curvature is c / L^2, left a quarter of c times that
    rate = left / root + (left - 2.0 * curvature * h) / across
    both, by_xi = root + across, 2.0 * (QN * dN).sum(axis=2) / across
    return _Height(2.0 * h / both, by_xi, -2.0 * h / both**2 * rate)


def _functions(table: Floats, xi: Floats) -> list[Floats]:
    """Return functions with coefficients (k, 3) at xi (s, q), and their first two derivatives."""
    one, none = np.ones_like(xi), np.zeros_like(xi)
    powers = (one, xi, xi**2), (none, one, 2.0 * xi), (none, none, 2.0 * one)
    return [np.stack(p, axis=-1) @ table.T for p in powers]


def _cross(a: Floats, b: Floats) -> Floats:
    """Return a x b of vectors (.., 2)."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def _turned(v: Floats) -> Floats:
    """Return vectors (.., 2) turned clockwise by a right angle."""
    return np.asarray(v[..., ::-1] * [1.0, -1.0])


def moments(
    x: Floats,
    n: Floats,
    y: Floats,
    start: Longs,
    place: Longs,
    deepest: Floats,
    reach: Floats,
    factor: Floats,
    heights: tuple[Floats, Floats, Floats],
    positive: bool,
    tables: Tables,
    found: Sums,
) -> None:
    """Add the moments of slave facets x (p, k, 2) and their masters, and derivatives.

    Args:
        n: (p, k, 2) directions of projection.
        y: (p, m, 2) the different nodes of the masters.
        start: (p + 1,) first pairs of the facets.
        place: (c, l) nodes of the pairs' masters.
        deepest: (c,) see `place_points`.
        reach: (p, 2) the gap from which on weights fall, and how fast; (p, 0) where nothing falls.
        factor: (p, k) that of the weight at the nodes, interpolated.
        heights: Q of both facets, (c, k, k) and (c, l, l), and arcs (c, 2, 2); empty without.
        positive: whether only what is positive of N_j counts.
        tables: of `tables`.
        found: by the coordinates of x, n and y.
    """
    k, m, t = x.shape[1], y.shape[1], tables.points
    of = np.repeat(np.arange(len(x), dtype=np.int32), np.diff(start))
    pairs = np.stack([of, np.arange(len(of), dtype=np.int32)], axis=1)
    Y, kinds = y[of[:, None], place], (tables.slave, tables.slave, tables.master)
    facets = [table.T @ v for table, v in zip(kinds, (x, n, Y), strict=True)]
    which, ends = _clip(*facets, np.ascontiguousarray(Y[:, :2]), pairs, deepest)
    xi, eta, _ = _place(*facets, pairs, which, ends, t, tables.weights)
    xi, eta, half = xi.reshape(-1, len(t)), eta.reshape(-1, len(t)), np.diff(ends)[:, :, None] / 2
    on, spread = of[which], np.eye(m)[place[which]]
    (N, dN, ddN), (N_m, dN_m, _) = _functions(tables.slave, xi), _functions(tables.master, eta)
    at, along_m = _points(N, dN, N_m @ spread, x[on], n[on], y[on]), dN_m @ Y[which]
    by_gap = np.where(np.abs(eta) < 1.0, 1.0 / _cross(along_m, at.n), 0.0)  # held at an end
    # functions of both sides and heights, and their derivatives by xi and by eta
    f, by_xi, by_eta = (np.zeros((*xi.shape, k + m + 1)) for _ in range(3))
    f[..., :k], f[..., k:-1], by_xi[..., :k], by_eta[..., k:-1] = N, at.M, dN, dN_m @ spread
    sides = [(N, dN, by_xi), (N_m, dN_m, by_eta)] if heights[0].size else []
    arcs = []
    for i, (one, d_one, by) in enumerate(sides):
        arcs.append(_height(one, d_one, heights[i][which], heights[2][which, i, None]))
        f[..., -1] += arcs[i].h
        by[..., -1] = arcs[i].by_xi
    slope = (by_gap * at.slope)[..., None]  # deta/dxi
    by_xi += slope * by_eta
    w, w_xi, fall, by_weight = _weigh(at, dN, ddN @ x[on], x[on], factor[on], reach[on])
    w, w_eta = w * tables.weights * half[..., 0], (along_m * fall).sum(axis=2)[..., None]
    if positive:
        dN, N = np.where(N < 0.0, 0.0, dN), np.maximum(N, 0.0)
    v, dv = (w[..., None] * u for u in (N, dN + N * (w_xi[..., None] + slope * w_eta)))
    rows, rows_xi, rows_eta = (v[..., None] * g[:, :, None] for g in (f, by_xi, by_eta + w_eta * f))
    rows_xi += dv[..., None] * f[:, :, None]
    rows, rows_xi, rows_eta = (
        r.reshape(*xi.shape, k * (k + m + 1)) for r in (rows, rows_xi, rows_eta)
    )
    signs = np.array([[-1.0], [1.0]])
    by_ends = (1.0 + signs * t) / 2 @ rows_xi + signs / (2.0 * half) * rows.sum(axis=1)[:, None]
    is_end = np.zeros((len(x), m), dtype=bool)
    is_end[of[:, None], place[:, :2]] = True
    moving = _end_rates(tables.slave, ends, x[on], n[on], y[on], is_end[on])
    rates = np.concatenate([by_gap[..., None, None] * at.by_nodes(), by_weight, moving], axis=1)
    rates = rates.reshape(*rates.shape[:2], 4 * k + 2 * m).swapaxes(1, 2)
    change = rates @ np.concatenate([rows_eta, rows, by_ends], axis=1)
    np.add.at(found.values, on, rows.sum(axis=1).reshape(-1, *found.values.shape[1:]))
    np.add.at(found.changes, on, change.reshape(-1, *found.changes.shape[1:]))
    for i, (one, _, _) in enumerate(sides):
        if len(found.chords):
            np.add.at(found.chords[:, :, i], which, (v * arcs[i].by_chord[..., None]).sum(axis=1))
        elif len(E := (found.E_s, found.E_m)[i]):
            np.add.at(E, which, np.einsum("sqj,sqa,sqb->sjab", v, one, one))


def _weigh(
    at: _Points, dN: Floats, bend: Floats, x: Floats, factor: Floats, reach: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the weight (s, q) of points per xi, and the derivatives of its logarithm.

    Those by xi (s, q), by y (s, q, 2), and by the nodes (s, q, 2 k + m, 2) at fixed xi and eta.
    """
    N, t, square = at.N, at.tangent, (at.tangent**2).sum(axis=2, keepdims=True)
    scale, chord = (N @ factor[:, :, None])[..., 0], (x[:, 1] - x[:, 0])[:, None]
    w_xi = (dN @ factor[:, :, None])[..., 0] / np.where(scale > 0.0, scale, np.inf)  # on an axis
    w_xi += (t * bend).sum(axis=2) / square[..., 0]
    w, fall = scale * np.sqrt(square[..., 0]), np.zeros_like(t)
    by_nodes = np.zeros((*w.shape, 2 * N.shape[2] + at.M.shape[2], 2))
    by_x, by_y = by_nodes[:, :, : N.shape[2]], by_nodes[:, :, 2 * N.shape[2] :]
    by_x += dN[..., None] * (t / square)[:, :, None]
    if reach.size:
        length = np.sqrt((chord**2).sum(axis=2, keepdims=True))
        normal = _turned(chord) / length
        gap = -(at.apart * normal).sum(axis=2)
        part = 1.0 - reach[:, 1:] * (gap - reach[:, :1])
        rate = -reach[:, 1:] / np.where((part > 0.0) & (part < 1.0), part, np.inf)
        fall = rate[..., None] * normal
        w, w_xi = w * np.clip(part, 0.0, 1.0), w_xi - (t * fall).sum(axis=2)
        by_x -= N[..., None] * fall[:, :, None]
        by_y += at.M[..., None] * fall[:, :, None]
        turning = rate[..., None] / length * _turned(-at.apart - gap[..., None] * normal)
        by_x[:, :, 0] += turning
        by_x[:, :, 1] -= turning
    return w, w_xi, fall, by_nodes


def _end_rates(
    table: Floats, ends: Floats, x: Floats, n: Floats, y: Floats, is_end: Bools
) -> Floats:
    """Return the derivatives (s, 2, 2 k + m, 2) of the ends of segments, 0 where a side ends.

    Args:
        is_end: (s, m) which of y are ends of masters: an end of a segment moves with the nearest.
    """
    (s, m, _), (N, dN, _) = y.shape, _functions(table, ends)
    M = np.tile(np.eye(m), (s, 2, 1))
    at = _points(N.repeat(m, axis=1), dN.repeat(m, axis=1), M, x, n, y)
    off, slopes = np.abs(_cross(at.apart, at.n)).reshape(s, 2, m), at.slope.reshape(s, 2, m)
    best = np.where(is_end[:, None], off, np.inf).argmin(axis=2)[..., None]
    slope = np.take_along_axis(slopes, best, axis=2)
    inside = np.abs(ends) < 1.0 - HALF_OF_DIGITS  # otherwise sides end together
    by_nodes = at.by_nodes()
    all_rates = by_nodes.reshape(s, 2, m, *by_nodes.shape[2:])
    rates = np.take_along_axis(all_rates, best[..., None, None], axis=2)[:, :, 0]
    return np.where(inside[..., None, None], -rates / slope[..., None], 0.0)


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

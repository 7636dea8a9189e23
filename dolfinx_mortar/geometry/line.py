# SPDX-License-Identifier: MIT
"""Segments in 2D: intervals of slave facets, straight or curved.

A slave facet x_s(xi) = sum_i N_i(xi) x_i, xi in [-1, 1], is projected along the interpolated
averaged nodal normals n(xi) = sum_i N_i n_i: (x_s(xi) - x_m(eta)) x n(xi) = 0. Second-order facets
are clipped as parabolas a + b xi + c xi^2, not as chords.
"""

from collections.abc import Sequence
from typing import Any

import numba
import numpy as np
import numpy.typing as npt
from numpy.polynomial.legendre import leggauss

from dolfinx_mortar.common.arrays import EPS, HALF_OF_DIGITS, Bools, Floats, Ints
from dolfinx_mortar.geometry.facets import FacetElement, Facets
from dolfinx_mortar.geometry.moments import Sides, Sums, create_points
from dolfinx_mortar.geometry.tolerances import FIRST, KERNEL, ROUND_OFF, SECOND


@numba.njit(**KERNEL)
def _at(v, xi, i):  # type: ignore[no-untyped-def]
    return v[0, i] + xi * (v[1, i] + xi * v[2, i])


@numba.njit(**KERNEL)
def _moment(x, n, y0, y1, xi):  # type: ignore[no-untyped-def]
    p0, p1 = _at(x, xi, FIRST) - y0, _at(x, xi, SECOND) - y1
    n0, n1 = _at(n, xi, FIRST), _at(n, xi, SECOND)
    dx0, dx1 = x[1, 0] + 2 * xi * x[2, 0], x[1, 1] + 2 * xi * x[2, 1]
    dn0, dn1 = n[1, 0] + 2 * xi * n[2, 0], n[1, 1] + 2 * xi * n[2, 1]
    return p0 * n1 - p1 * n0, dx0 * n1 - dx1 * n0 + p0 * dn1 - p1 * dn0


@numba.njit(**KERNEL)
def _project_node(x, n, y0, y1):  # type: ignore[no-untyped-def]
    """Coordinate xi in [-1, 1] where the slave's normal meets y, or the nearer end.

    NaN behind the centre of curvature of a concave facet.
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
    """Coordinate eta in [-1, 1] of the master on the slave's normal at xi."""
    n0, n1 = _at(n, xi, FIRST), _at(n, xi, SECOND)
    C = (y[0, 0] - _at(x, xi, FIRST)) * n1 - (y[0, 1] - _at(x, xi, SECOND)) * n0
    B = y[1, 0] * n1 - y[1, 1] * n0
    A = y[2, 0] * n1 - y[2, 1] * n0
    r = np.sqrt(max(B * B - 4 * A * C, 0.0))  # without cancellation
    eta = -2 * C / (B + r if B > 0.0 else B - r)
    return min(max(eta, -1.0), 1.0)


@numba.njit(**KERNEL)
def _distances(x, n, y, xi):  # type: ignore[no-untyped-def]
    """Distance along n(xi) to y, and the depth of y behind the mean plane."""
    eta = _opposite(x, n, y, xi)
    p0, p1 = _at(x, xi, FIRST) - _at(y, eta, FIRST), _at(x, xi, SECOND) - _at(y, eta, SECOND)
    t0, t1 = x[1, 0], x[1, 1]
    return np.sqrt(p0 * p0 + p1 * p1), (p0 * t1 - p1 * t0) / np.sqrt(t0 * t0 + t1 * t1)


@numba.njit(**KERNEL)
def _nearest(x, n, x_m, master, deepest, low, high, a, b):  # type: ignore[no-untyped-def]
    best, least = -1, np.inf
    for c in range(len(master)):
        if low[c] <= a and high[c] >= b:
            distance, depth = _distances(x, n, x_m[master[c]], (a + b) / 2)
            if distance < least and depth <= deepest[c]:
                best, least = c, distance
    return best


@numba.njit(**KERNEL)
def _clip_facet(x, n, x_m, ends_m, pairs, deepest, first, last, which, ends, q):  # type: ignore[no-untyped-def]
    """Append one slave facet's disjoint segments; return the count."""
    p, c, start = last - first, 0, q
    low, high, cuts = np.empty(p), np.empty(p), np.empty(2 * p)
    index, master, most = np.empty(p, np.int32), np.empty(p, np.int32), np.empty(p)
    for r in range(first, last):
        y = ends_m[pairs[r, 1]]
        # the two sides have opposite directions
        a = _project_node(x, n, y[1, 0], y[1, 1])
        b = _project_node(x, n, y[0, 0], y[0, 1])
        if (b - a) > 8 * ROUND_OFF:
            low[c], high[c], index[c], master[c] = a, b, r, pairs[r, 1]
            most[c] = deepest[r]
            cuts[2 * c], cuts[2 * c + 1] = a, b
            c += 1
    cuts[: 2 * c].sort()
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
    half = (high - low) / 2
    xi = (low + high) / 2 + half * t
    dx0, dx1 = x[1, 0] + 2 * xi * x[2, 0], x[1, 1] + 2 * xi * x[2, 1]
    return xi, _opposite(x, n, y, xi), half * np.sqrt(dx0 * dx0 + dx1 * dx1)


@numba.njit(**KERNEL)
def _place(x_s, n_s, x_m, pairs, which, ends, points, weights):  # type: ignore[no-untyped-def]
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


def moments(
    sides: Sides, heights: Sequence[Floats], types: tuple[FacetElement, FacetElement], found: Sums
) -> None:
    """Add the moments of slave facets and their masters, and derivatives by x, n and y.

    `heights` of pairs (c,) are those of `create_points`.
    """
    x, n, y, _, place, deepest, factor, reach = sides
    pairs = sides.pairs()
    slave, master = types
    k, m, of = x.shape[1], y.shape[1], pairs[:, 0]
    Y = y[of[:, None], place]
    which, ends, t, *points = _segments(types, x, n, Y, pairs, deepest)
    xi, eta, w = (v.reshape(-1, len(t), 1) for v in points)
    on, half, n = of[which], np.diff(ends)[:, :, None] / 2, n[of[which]]
    at = create_points(
        slave.functions(xi),
        master.functions(eta)[:2],
        (x[on], Y[which]),
        w[..., 0],
        (factor[on], reach[on]),
        slave,
        [v[which] for v in heights],
        np.eye(m)[place[which]],
    )
    is_end = np.zeros((len(x), m), dtype=bool)
    is_end[of[:, None], place[:, :2]] = True
    moving = _end_rates(slave, ends, x[on], n, y[on], is_end[on])
    by_s = np.stack([1.0 - t, 1.0 + t], axis=1) / 2 @ moving
    normal, M = at.N @ n, at.f[..., k:-1]
    across = np.where(np.abs(eta) < 1.0, _cross(at.U, normal[:, :, None]), np.inf)  # at an end
    slope = _cross(at.T[:, :, 0], normal) - _cross(at.apart, (at.dN @ n[:, None])[:, :, 0])
    by_m = (_by_nodes(at.N, M, normal, -at.apart) + slope[..., None] * by_s) / across
    by_w = np.insert(at.by_nodes, [k] * k, 0.0, axis=2).reshape(by_s.shape)
    by_w += np.diff(moving, axis=1) / (2.0 * half)
    values, changes = at.differentiate(by_s[:, :, None], by_m[:, :, None], by_w)
    np.add.at(found.values, on, values)
    np.add.at(found.changes, on, changes)
    found.add_heights(at, which)


def _cross(a: Floats, b: Floats) -> Floats:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _by_nodes(N: Floats, M: Floats, n: Floats, apart: Floats) -> Floats:
    along, across = (v[:, :, None, ::-1] * [1.0, -1.0] for v in (n, apart))
    N, M = N[..., None], M[..., None]
    parts = np.concatenate([N * along, -N * across, -M * along], axis=2)
    return parts.reshape(*parts.shape[:2], 2 * parts.shape[2])


def _end_rates(
    slave: FacetElement, ends: Floats, x: Floats, n: Floats, y: Floats, is_end: Bools
) -> Floats:
    N, dN, _ = slave.functions(ends[..., None])
    normal, apart = N @ n, (N @ x)[:, :, None] - y[:, None]
    off = np.where(is_end[:, None], np.abs(_cross(apart, normal[:, :, None])), np.inf)
    best = off.argmin(axis=2)[..., None]
    apart = np.take_along_axis(apart, best[..., None], axis=2)[:, :, 0]
    M = (best == np.arange(y.shape[1])).astype(float)
    slope = _cross(dN[:, :, 0] @ x, normal) + _cross(apart, dN[:, :, 0] @ n)
    inside = np.abs(ends) < 1.0 - HALF_OF_DIGITS  # otherwise sides end together
    rates = -_by_nodes(N, M, normal, apart) / slope[..., None]
    return np.where(inside[..., None], rates, 0.0)


def _polynomials(element: FacetElement, v: Floats) -> Floats:
    """Coefficients (m, 3, 2) of 1, xi, xi^2 for nodal values v (m, k, 2).

    >>> from dolfinx_mortar.geometry.facets import LINE3
    >>> _polynomials(LINE3, np.array([[[0.0, 1.0], [2.0, 1.0], [1.0, 3.0]]])).tolist()
    [[[1.0, 3.0], [1.0, 0.0], [0.0, -2.0]]]
    """
    return element.table.T @ v


def _segments(
    types: tuple[FacetElement, FacetElement],
    x: Floats,
    n: Floats,
    y: Floats,
    pairs: Ints,
    deepest: Floats,
) -> tuple[Any, ...]:
    """Pairs (s,), ends (s, 2) on the slave, Gauss points t (q,), and (s q,) both xi and weights."""
    slave, master = types
    facets = _polynomials(slave, x), _polynomials(slave, n), _polynomials(master, y)
    which, ends = _clip(*facets, np.ascontiguousarray(y[:, :2]), pairs, deepest)
    t, weights = leggauss(2 * max(slave.degree, master.degree) + 1)
    return which, ends, t, *_place(*facets, pairs, which, ends, t, weights)


def place_points(
    slave: Facets, n_s: Floats, master: Facets, pairs: Ints, deepest: Floats
) -> tuple[npt.NDArray[Any], Floats, Floats, Floats]:
    """Project, clip and place Gauss points on every segment: three, or five for degree two.

    Integrals of Phi_j N_l are exact on straight parallel facets.

    Args:
        n_s: (ms, k, 2) averaged normals at the nodes.
        pairs: (p, 2) of facing facets, ordered by slave facet.
        deepest: (p,) largest distance of the master behind the slave facet.

    Returns:
        Index into the pairs (q,), xi_s (q, 1), xi_m (q, 1) and weight (q,).
    """
    types = slave.element, master.element
    which, _, t, xi_s, xi_m, weight = _segments(types, slave.x, n_s, master.x, pairs, deepest)
    return np.repeat(which, len(t)), xi_s[:, None], xi_m[:, None], weight

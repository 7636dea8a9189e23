# SPDX-License-Identifier: MIT
r"""Segments in 2D: intervals of straight slave facets.

A slave facet is x_s(xi) = N_1(xi) x_1 + N_2(xi) x_2 with xi in [-1, 1], and it is projected
along the interpolated averaged nodal normals n(xi) = N_1 n_1 + N_2 n_2 (not normalised). The
point of the master line that belongs to xi solves (x_s(xi) - x_m) x n(xi) = 0.
"""

from typing import Any

import numba
import numpy as np
import numpy.typing as npt

from dolfinx_mortar.arrays import Floats, Ints
from dolfinx_mortar.geometry.facets import Facets, facet_normals
from dolfinx_mortar.geometry.tolerances import ROUND_OFF

_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(3)


@numba.njit(cache=True)
def _moment(x, i, y, n):  # type: ignore[no-untyped-def]
    """Return (x_i - y) x n_i."""
    return (x[i, 0] - y[0]) * n[i, 1] - (x[i, 1] - y[1]) * n[i, 0]


@numba.njit(cache=True)
def _project_node(x, n, y):  # type: ignore[no-untyped-def]
    """Return xi in [-1, 1] of the slave facet whose normal meets y; beyond an end, that end.

    f(xi) = (x(xi) - y) x n(xi) falls along the facet as long as y is nearer than the point where
    the normals of a concave facet meet; there is no answer (nan) behind that point.
    """
    first, last = _moment(x, 0, y, n), _moment(x, 1, y, n)
    if first <= 0.0 or last >= 0.0:
        if first <= 0.0 and last >= 0.0:
            return np.nan
        return -1.0 if first <= 0.0 else 1.0
    h0, h1 = (x[1, 0] - x[0, 0]) / 2, (x[1, 1] - x[0, 1]) / 2
    d0, d1 = (n[1, 0] - n[0, 0]) / 2, (n[1, 1] - n[0, 1]) / 2
    # f = A + B xi + C xi^2 with f(-1) > 0 > f(1); the root in the form that does not cancel
    C = h0 * d1 - h1 * d0
    A, B = (first + last) / 2 - C, (last - first) / 2
    return min(max(2 * A / (np.sqrt(max(B * B - 4 * A * C, 0.0)) - B), -1.0), 1.0)


@numba.njit(cache=True)
def _distance(x, n, y, normal, xi):  # type: ignore[no-untyped-def]
    """Return the distance along n(xi) from the slave facet to the master line through y[0]."""
    height, slope, square = 0.0, 0.0, 0.0
    for i in range(2):
        p = (1 - xi) / 2 * (x[0, i] - y[0, i]) + (1 + xi) / 2 * (x[1, i] - y[0, i])
        m = (1 - xi) / 2 * n[0, i] + (1 + xi) / 2 * n[1, i]
        height += p * normal[i]
        slope += m * normal[i]
        square += m * m
    return abs(height / slope) * np.sqrt(square)


@numba.njit(cache=True)
def _nearest(x, n, x_m, n_m, master, low, high, a, b):  # type: ignore[no-untyped-def]
    """Return the candidate that covers [a, b] at the smallest distance, -1 if there is none."""
    best, least = -1, np.inf
    for c in range(len(master)):
        if low[c] <= a and high[c] >= b:
            m = master[c]
            distance = _distance(x, n, x_m[m], n_m[m], (a + b) / 2)
            if distance < least:
                best, least = c, distance
    return best


@numba.njit(cache=True)
def _insert(cuts, count, value):  # type: ignore[no-untyped-def]
    """Insert a value into the first `count` ascending ones."""
    while count > 0 and cuts[count - 1] > value:
        cuts[count] = cuts[count - 1]
        count -= 1
    cuts[count] = value


@numba.njit(cache=True)
def _clip(x_s, n_s, x_m, n_m, pairs):  # type: ignore[no-untyped-def]
    """Return the pair and the ends in xi of all segments; no part of a slave facet occurs twice."""
    p = len(pairs)
    which, ends = np.empty(2 * p, dtype=np.int32), np.empty((2 * p, 2))
    low, high, cuts = np.empty(p), np.empty(p), np.empty(2 * p)
    index, master = np.empty(p, dtype=np.int32), np.empty(p, dtype=np.int32)
    q = 0
    r = 0
    while r < p:
        s = pairs[r, 0]
        c = 0
        while r < p and pairs[r, 0] == s:
            y = x_m[pairs[r, 1]]
            # the two sides run against each other
            a, b = _project_node(x_s[s], n_s[s], y[1]), _project_node(x_s[s], n_s[s], y[0])
            if b - a > 8 * ROUND_OFF:
                low[c], high[c], index[c], master[c] = a, b, r, pairs[r, 1]
                _insert(cuts, 2 * c, a)
                _insert(cuts, 2 * c + 1, b)
                c += 1
            r += 1
        start = q
        for i in range(2 * c - 1):
            a, b = cuts[i], cuts[i + 1]
            if b - a <= 8 * ROUND_OFF:
                continue
            best = _nearest(x_s[s], n_s[s], x_m, n_m, master[:c], low, high, a, b)
            if best < 0:
                continue
            if q > start and which[q - 1] == index[best] and ends[q - 1, 1] == a:
                ends[q - 1, 1] = b
                continue
            which[q], ends[q, 0], ends[q, 1] = index[best], a, b
            q += 1
    return which[:q], ends[:q]


def _opposite(x_s: Floats, n_s: Floats, x_m: Floats, xi: Floats) -> Floats:
    """Return xi_m (s, q) on the master lines x_m (s, 2, 2) met by the normals at xi (s, q)."""

    def at(v: Floats, xi: Floats) -> Floats:
        return (1 - xi[..., None]) / 2 * v[:, None, 0] + (1 + xi[..., None]) / 2 * v[:, None, 1]

    n = at(n_s, xi)
    p = at(x_s - x_m.mean(axis=1, keepdims=True), xi)
    h = (x_m[:, 1] - x_m[:, 0])[:, None] / 2
    numerator = p[..., 0] * n[..., 1] - p[..., 1] * n[..., 0]
    return numerator / (h[..., 0] * n[..., 1] - h[..., 1] * n[..., 0])


def place_points(
    slave: Facets, n_s: Floats, master: Facets, pairs: Ints
) -> tuple[npt.NDArray[Any], Floats, Floats, Floats]:
    """Project, clip and place three Gauss points on every segment.

    On flat facets the points integrate Phi_j N_l of both sides exactly.

    Args:
        slave: Slave facets (ms,).
        n_s: Averaged normals (ms, 2, 2) at their nodes.
        master: Master facets (mm,).
        pairs: Pairs (p, 2) that face each other, ordered by slave facet.

    Returns:
        Index into the pairs (q,), xi_s (q, 1), xi_m (q, 1) and weight (q,) of the points.
    """
    x_s, x_m = slave.linear, master.linear
    which, ends = _clip(x_s, n_s, x_m, facet_normals(master), pairs)
    s, m = pairs[which].T
    half = (ends[:, 1] - ends[:, 0]) / 2
    xi = (ends[:, 0] + ends[:, 1])[:, None] / 2 + half[:, None] * _POINTS
    length = np.linalg.norm(x_s[:, 1] - x_s[:, 0], axis=1)
    weight = (half * length[s] / 2)[:, None] * _WEIGHTS
    xi_m = _opposite(x_s[s], n_s[s], x_m[m], xi)
    which = np.repeat(which, len(_POINTS))
    return which, xi.reshape(-1, 1), xi_m.reshape(-1, 1), weight.ravel()

# SPDX-License-Identifier: MIT
r"""Moments of pairs of facets: all that forces, gaps and dual functions of contact need.

Over the part of a slave facet that faces a master facet, with the functions N of both, the heights
h of smooth surfaces and the weight of the integrals,

    S_jk = int N_j N_k,     R_jl = int N_j N_l,     H_j = int N_j h.

`line.moments` and `area.moments` add them up over the points of all segments of a slave facet, with
their derivatives by the coordinates of the nodes. Points stay where they are on the slave facet in
the plane, in its auxiliary plane in space; there xi of both facets change by a step of Newton's
method, and the integrals by what crosses the ends of the segments (theorem of transport):

    d int f = int df + sum over ends of f times their velocity outwards.

An end of a segment moves with the node, or with the line between two nodes, that it lies on; so
nothing that cuts, hides or halves has derivatives.
"""

from typing import NamedTuple

import numba
import numpy as np

from dolfinx_mortar.arrays import Floats

KERNEL = {
    "cache": True,
    "error_model": "numpy",
    "fastmath": {"contract"},
    "no_cfunc_wrapper": True,
}
"""Of functions that clip and place: those with the same options share what numba makes of them."""
FIRST, SECOND, THIRD, FIFTH = (np.int64(i) for i in (0, 1, 2, 4))
"""Places: a literal number has a type of its own, so that what takes it compiles for each."""
INNER = {
    "error_model": "numpy",
    "fastmath": {"contract", "nsz", "reassoc"},
    "forceinline": True,
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
    "_nrt": False,
}
"""Of functions in loops that make no array: to count references takes longer than a point."""


# Arrays with numbers of rows: a view of each would cost as much as a point.


@numba.njit(**INNER)
def fill_functions(table, xi, eta, f, first):  # type: ignore[no-untyped-def]
    """Write N_j = sum_ab table[j, 3 a + b] xi^a eta^b to f[first + j]; in the plane eta is 0."""
    for j in range(len(table)):
        c0 = table[j, 0] + eta * (table[j, 1] + eta * table[j, 2])
        c1 = table[j, 3] + eta * (table[j, 4] + eta * table[j, 5])
        c2 = table[j, 6] + eta * (table[j, 7] + eta * table[j, 8])
        f[first + j] = c0 + xi * (c1 + xi * c2)


@numba.njit(**INNER)
def fill_slopes(table, xi, eta, df, h, first):  # type: ignore[no-untyped-def]
    """Write the derivatives of the functions of `fill_functions` to df[h] and df[h + 1]."""
    for j in range(len(table)):
        c1 = table[j, 3] + eta * (table[j, 4] + eta * table[j, 5])
        c2 = table[j, 6] + eta * (table[j, 7] + eta * table[j, 8])
        d1 = table[j, 1] + xi * (table[j, 4] + xi * table[j, 7])
        d2 = table[j, 2] + xi * (table[j, 5] + xi * table[j, 8])
        df[h, first + j], df[h + 1, first + j] = c1 + 2.0 * xi * c2, d1 + 2.0 * eta * d2


class Point(NamedTuple):
    """A point of a pair of facets with k and l nodes; in the plane eta counts for nothing."""

    f: Floats  # (k + l + 1,) N of the slave facet, N of the master, h
    df: Floats  # (4, k + l + 1) their derivatives by xi_s, eta_s, xi_m and eta_m
    by_weight: Floats  # (4,) those of the logarithm of the weight
    by_height: Floats  # (k + l + 1,) those of h by N
    rows: Floats  # (5, k (k + l + 1)) derivatives of N_j f w, and w N_j f itself


class Sums(NamedTuple):
    """Moments of slave facets (p,) with k nodes, of their masters m different ones, c pairs."""

    values: Floats  # (p, k, k + m + 1) S, R and H side by side
    changes: Floats  # (p, z, k, k + m + 1) their derivatives
    E_s: Floats  # (c, k, k, k) dH_j by Q_ab of heights over the slave facet; (0, ..) if not asked
    E_m: Floats  # (c, k, l, l) over the master
    chords: Floats  # (c, k, 2) dH_j by the logarithms of both chords' lengths; (0, ..) without arcs


@numba.njit(**KERNEL)
def create_point(k, l):  # type: ignore[no-untyped-def] # noqa: E741
    """Return room for a point."""
    n = k + l + 1
    return Point(np.zeros(n), np.zeros((4, n)), np.zeros(4), np.zeros(n), np.empty((5, k * n)))


@numba.njit(**INNER)
def _height(p, first, Q, c):  # type: ignore[no-untyped-def]
    """Return N.Q N over a facet, and write its derivatives by N."""
    h, by, n = 0.0, p.by_height, Q.shape[1]
    for i in range(n):
        by[first + i] = 0.0
        for j in range(n):
            by[first + i] += 2.0 * Q[c, i, j] * p.f[first + j]
        h += 0.5 * p.f[first + i] * by[first + i]
    return h


@numba.njit(**INNER)
def begin_point(p, factor, c, heights):  # type: ignore[no-untyped-def]
    """Write h and its derivatives, and add those of the weight; return the factor.

    Args:
        p: the point, of pair c, with all functions.
        factor: (k,) that of the weight at the nodes, interpolated.
        heights: Q of both facets, (c, k, k) and (c, l, l); empty without.
    """
    Q_s, Q_m, _ = heights
    k, scale, along, across = len(factor), 0.0, 0.0, 0.0
    for j in range(k):
        scale += factor[j] * p.f[j]
        along += factor[j] * p.df[0, j]
        across += factor[j] * p.df[1, j]
    inverse = 1.0 / scale if scale > 0.0 else 0.0  # on an axis
    p.by_weight[0] += along * inverse
    p.by_weight[1] += across * inverse
    if len(Q_s) == 0:
        return scale
    last, by = len(p.f) - 1, p.by_height
    p.f[last] = _height(p, FIRST, Q_s, c) + _height(p, k, Q_m, c)
    for h in range(4):
        p.df[h, last] = 0.0
        for a in range(last):
            p.df[h, last] += by[a] * p.df[h, a]
    return scale


@numba.njit(**INNER)
def fill_rows(p, k, w, positive, whole):  # type: ignore[no-untyped-def]
    """Write the rows of a point with weight w, only the last unless whole.

    If positive, only what is positive of N_j counts.
    """
    n = len(p.f)
    for j in range(k):
        size = 0.0 if positive and p.f[j] < 0.0 else w
        v = size * p.f[j]
        for h in range(4 if whole else 0):
            dv = v * p.by_weight[h] + size * p.df[h, j]
            for a in range(n):
                p.rows[h, n * j + a] = dv * p.f[a] + v * p.df[h, a]
        for a in range(n):
            p.rows[4, n * j + a] = v * p.f[a]


@numba.njit(**INNER)
def add_row(p, h, factor, totals, z):  # type: ignore[no-untyped-def]
    """Add a multiple of a row to totals[z]."""
    if factor != 0.0:
        for i in range(totals.shape[1]):
            totals[z, i] += factor * p.rows[h, i]


@numba.njit(**INNER)
def gather(x, ids, P):  # type: ignore[no-untyped-def]
    """Write some nodes of x (n, d) into P (v, d)."""
    for v in range(len(ids)):
        for i in range(x.shape[1]):
            P[v, i] = x[ids[v], i]


@numba.njit(**INNER)
def add_heights(p, k, c, found):  # type: ignore[no-untyped-def]
    """Add the derivatives of H by the heights' Q of pair c."""
    n = len(p.f)
    for j in range(k if len(found.E_s) else 0):
        for a in range(k):
            for b in range(k):
                found.E_s[c, j, a, b] += p.rows[4, n * j + a] * p.f[b]
        for a in range(k, n - 1):
            for b in range(k, n - 1):
                found.E_m[c, j, a - k, b - k] += p.rows[4, n * j + a] * p.f[b]


@numba.njit(**KERNEL)
def move_to(totals, z, k, place, r, by):  # type: ignore[no-untyped-def]
    """Add totals[z] of pair r, k (k + l + 1), to those of a facet (k, k + m + 1); clear them."""
    n = totals.shape[1] // k
    for j in range(k):
        for a in range(n):
            at = a if a < k else (k + place[r, a - k] if a < n - 1 else by.shape[1] - 1)
            by[j, at] += totals[z, n * j + a]
            totals[z, n * j + a] = 0.0


@numba.njit(**KERNEL)
def fill_turns(axis, x, turns):  # type: ignore[no-untyped-def]
    """Return axis.n for the mean normal n of a facet, and write its derivatives by x (v, d)."""
    v, d = x.shape
    a, b, last = np.zeros(3), np.zeros(3), v - 1
    b[2] = 1.0 if d == 2 else 0.0  # of a line: across its plane
    for i in range(d):
        a[i] = x[2, i] - x[0, i] if d > 2 else x[1, i] - x[0, i]
        b[i] += x[last, i] - x[1, i]
    n, t = np.empty(3), np.empty(3)
    square = size = along = 0.0
    for i in range(3):
        g, h = (i + 1) % 3, (i + 2) % 3
        n[i] = a[g] * b[h] - a[h] * b[g]
        square += n[i] * n[i]
        along += n[i] * axis[i] if i < d else 0.0
    size = np.sqrt(square)
    for i in range(3):
        t[i] = ((axis[i] if i < d else 0.0) - along / square * n[i]) / size
    for i in range(d):
        for j in range(v):
            turns[j, i] = 0.0
    for i in range(d):
        g, h = (i + 1) % 3, (i + 2) % 3
        by_a, by_b = b[g] * t[h] - b[h] * t[g], t[g] * a[h] - t[h] * a[g]
        turns[2 if d > 2 else 1, i] += by_a
        turns[0, i] -= by_a
        if d > 2:
            turns[last, i] += by_b
            turns[1, i] -= by_b
    return along / size


@numba.njit(**KERNEL)
def add_whole(x, by_x, rule, weights, phi, values, changes):  # type: ignore[no-untyped-def]
    """Add the moments of whole facets x (p, k, d) below a tool, H being minus int N_j phi.

    Args:
        by_x: (p, q, k, d) derivatives of phi by the nodes.
        rule: N (q, k) at the points of a rule, and their derivatives (q, k, d - 1).
        weights: (p, q).
        phi: (p, q).
        values: (p, k, k + 1).
        changes: (p, d k, k, k + 1).
    """
    (N, dN), (k, d) = rule, x.shape[1:]
    T, by_T, n = np.zeros((2, 3)), np.empty((2, 3)), np.empty(3)
    for f in range(len(x)):
        for q in range(len(N)):
            for i in range(3):
                T[0, i] = T[1, i] = 0.0
            T[1, 2] = 1.0 if d == 2 else 0.0  # of a line: across its plane
            for z in range(d * k):
                for h in range(d - 1):
                    T[h, z % d] += dN[q, z // d, h] * x[f, z // d, z % d]
            w = weights[f, q] * fill_area(T, n, by_T)
            for j in range(k):
                v = w * N[q, j]
                for b in range(k):
                    values[f, j, b] += v * N[q, b]
                values[f, j, k] -= v * phi[f, q]
                for z in range(d * k):
                    rate = by_T[0, z % d] * dN[q, z // d, 0]
                    rate += by_T[1, z % d] * dN[q, z // d, 1] if d > 2 else 0.0
                    for b in range(k):
                        changes[f, z, j, b] += rate * v * N[q, b]
                    changes[f, z, j, k] -= v * (rate * phi[f, q] + by_x[f, q, z // d, z % d])


@numba.njit(**KERNEL)
def fill_area(T, n, by_T):  # type: ignore[no-untyped-def]
    """Return the area of tangents T (2, 3), write n (3,) of its length, and dlog area/dT (2, 3)."""
    square = 0.0
    for i in range(3):
        g, h = (i + 1) % 3, (i + 2) % 3
        n[i] = T[0, g] * T[1, h] - T[0, h] * T[1, g]
        square += n[i] * n[i]
    for i in range(3):
        g, h = (i + 1) % 3, (i + 2) % 3
        by_T[0, i] = (T[1, g] * n[h] - T[1, h] * n[g]) / square
        by_T[1, i] = (n[g] * T[0, h] - n[h] * T[0, g]) / square
    return np.sqrt(square)

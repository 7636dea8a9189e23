# SPDX-License-Identifier: MIT
r"""Moments of pairs of facets: all that forces, gaps and dual functions of contact need (compiled).

Over the part of a slave facet that faces a master facet, with the functions N of both, the heights
h of smooth surfaces and the weight of the integrals,

    S_jk = int N_j N_k,     R_jl = int N_j N_l,     H_j = int N_j h.

`line.moments` and `area.moments` add them up over the points of all segments of a slave facet. They
are generic in the number type: of complex coordinates x + i STEP v real parts decide, and imaginary
ones over STEP are the derivatives along v, to round-off, whatever has been cut, projected or
inverted (complex step: Squire and Trapp, SIAM Review 40, 1998).
"""

import numba
import numpy as np

from dolfinx_mortar.arrays import EPS

STEP = EPS * EPS
"""Imaginary part of a coordinate: its square is nothing beside the round-off of any other one."""
KERNEL = {"cache": True, "error_model": "numpy", "fastmath": {"contract"}}
SUMS = {**KERNEL, "fastmath": {"contract", "nsz", "nnan", "reassoc"}}


@numba.njit(**SUMS)
def root(z):  # type: ignore[no-untyped-def]
    """Return the square root, exact to first order: that of the real part and a step of Heron."""
    r = np.sqrt(max(z.real, 0.0))
    return 0.0 * z if r == 0.0 else r + (0.5 / r) * (z - r * r)


@numba.njit(**SUMS)
def reciprocal(z):  # type: ignore[no-untyped-def]
    """Return 1 / z, exact to first order: of the real part, and a step of Newton's method."""
    r = 1.0 / z.real
    return r + r * (1.0 - z * r)


@numba.njit(**SUMS)
def fill_functions(table, xi, eta, N):  # type: ignore[no-untyped-def]
    """Write N_j = sum_ab table[j, 3 a + b] xi^a eta^b into N (k,); in the plane eta is 0."""
    x2, y2 = xi * xi, eta * eta
    for j in range(len(N)):
        c = table[j]
        along, across = c[3] + c[4] * eta + c[5] * y2, c[6] + c[7] * eta + c[8] * y2
        N[j] = c[0] + c[1] * eta + c[2] * y2 + xi * along + x2 * across


@numba.njit(**SUMS)
def _height(N, Q, arc):  # type: ignore[no-untyped-def]
    """Return N.Q N over a chord, or of an arc: see `curvature.heights_of_arcs`."""
    h = 0.0 * N[0]
    for i in range(len(N)):
        for j in range(len(N)):
            h += N[i] * Q[i, j] * N[j]
    if arc[0] == 0.0:
        return h
    return 2.0 * h / (np.sqrt(arc[1]) + np.sqrt(arc[1] + 2.0 * arc[0] * h))


@numba.njit(**SUMS)
def _remaining(N, M, x, y, reach):  # type: ignore[no-untyped-def]
    """Return the part of a weight that is left by the gap between x and y along a normal.

    Args:
        reach: (d + 2,) the gap from which on weights fall, how fast, and the normal.
    """
    gap = 0.0 * N[0]
    for i in range(x.shape[1]):
        for j in range(len(M)):
            gap += M[j] * y[j, i] * reach[2 + i]
        for j in range(len(N)):
            gap -= N[j] * x[j, i] * reach[2 + i]
    part = 1.0 - reach[1] * (gap - reach[0])
    if part.real >= 1.0:
        return 1.0 + 0.0 * part
    return part if part.real > 0.0 else 0.0 * part


@numba.njit(**SUMS)
def add_point(N, M, w, c, x, y, reach, factor, heights, positive, S, R, H):  # type: ignore[no-untyped-def]
    """Add a point of pair c with functions N (k,) and M (l,) and weight w to S, R[c] and H.

    Args:
        x: (k, d) nodes of the slave facet, y: (l, d) of the master.
        reach: of `_remaining`; empty where nothing falls.
        factor: (k,) that of the weight at the nodes, interpolated.
        heights: Q of both facets, (c, k, k) and (c, l, l), and arcs (c, 2, 2); empty without.
        positive: whether of the first N_j only what is positive counts.
    """
    Q_s, Q_m, arcs = heights
    scale = 0.0 * w
    for j in range(len(N)):
        scale += factor[j] * N[j]
    w = w * scale
    if len(reach):
        w = w * _remaining(N, M, x, y, reach)
    h = 0.0 * w
    if len(Q_s):
        h = _height(N, Q_s[c], arcs[c, 0]) + _height(M, Q_m[c], arcs[c, 1])
    for j in range(len(N)):
        if positive and N[j].real < 0.0:
            continue
        v = w * N[j]
        for k in range(len(N)):
            S[j, k] += v * N[k]
        for k in range(len(M)):
            R[c, j, k] += v * M[k]
        H[j] += v * h


@numba.njit(**KERNEL)
def add_whole(x, by_x, start, rule, weights, phi, S, H):  # type: ignore[no-untyped-def]
    """Add those of a whole facet x (k, d), with minus int N_j phi, to S (k, k) and H (k,).

    Args:
        by_x: (q, k, d) derivatives of phi by the nodes, which were at start (k, d).
        rule: N (q, k) at the points of a rule, and their derivatives (q, k, d - 1).
        weights: (q,).
        phi: (q,).
    """
    N, dN = rule
    k, d = x.shape
    a = np.zeros((2, 3), x.dtype)
    for q in range(len(weights)):
        value = phi[q] + 0.0 * x[0, 0]
        for i in range(3):
            a[0, i] = a[1, i] = 0.0
        a[1, 2] = 1.0 if d == 2 else 0.0  # of a line: across its plane
        for i in range(d):
            for j in range(k):
                value += by_x[q, j, i] * (x[j, i] - start[j, i])
                for h in range(d - 1):
                    a[h, i] += dN[q, j, h] * x[j, i]
        square = 0.0 * x[0, 0]
        for i in range(3):
            g, h = (i + 1) % 3, (i + 2) % 3
            n = a[0, g] * a[1, h] - a[0, h] * a[1, g]
            square += n * n
        v = weights[q] * np.sqrt(square)
        for i in range(k):
            H[i] -= v * N[q, i] * value
            for j in range(k):
                S[i, j] += v * N[q, i] * N[q, j]

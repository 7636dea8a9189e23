# SPDX-License-Identifier: MIT
"""Logarithmic strains at points, and the transformation of their stresses and moduli to P.

Formulas: theory.md, Small-strain laws at finite strain, with G = I + g, F = I + H, and x, logs, N,
y, m of C = (F G)^T F G. Components are stored as in `tensor.INDEX`: in the plane xx, xy, yx, yy, zz
of F and P, in space nine.
"""

import numba
import numpy as np

from dolfinx_mortar.arrays import LIMIT
from dolfinx_mortar.materials.tensor import INDEX

PAIRS = INDEX
SETTINGS = {"cache": True, "error_model": "numpy"}

# Relative difference of eigenvalues below which power series are exact to round-off.
NEAR = 0.08


@numba.njit(**SETTINGS)
def diagonalise(A, N):  # type: ignore[no-untyped-def]
    """Replace a symmetric A (3, 3) by its eigenvalues, N by its eigenvectors, by Jacobi's method.

    An A with A_02 = A_12 = 0 keeps its last eigenvector.
    """
    for i in range(3):
        for j in range(3):
            N[i, j] = 1.0 if i == j else 0.0
    for _ in range(LIMIT):  # five suffice
        turned = False
        for p, q, r in ((0, 1, 2), (0, 2, 1), (1, 2, 0)):
            off = A[p, q]
            if not abs(off) > 1e-18 * (abs(A[p, p]) + abs(A[q, q])):
                continue
            turned = True
            half = (A[q, q] - A[p, p]) / (2 * off)
            t = 1 / (abs(half) + np.sqrt(half * half + 1))
            t = -t if half < 0 else t
            c = 1 / np.sqrt(t * t + 1)
            s = t * c
            A[p, p] -= t * off
            A[q, q] += t * off
            A[p, q] = 0.0
            A[q, p] = 0.0
            a, b = A[p, r], A[q, r]
            A[p, r] = c * a - s * b
            A[r, p] = A[p, r]
            A[q, r] = s * a + c * b
            A[r, q] = A[q, r]
            for i in range(3):
                a, b = N[i, p], N[i, q]
                N[i, p] = c * a - s * b
                N[i, q] = s * a + c * b
        if not turned:
            break


@numba.njit(**SETTINGS)
def compose(N, values, A):  # type: ignore[no-untyped-def]
    """Set A to sum_a values_a N_a (x) N_a."""
    for i in range(3):
        for j in range(i, 3):
            A[i, j] = N[i, 0] * values[0] * N[j, 0]
            A[i, j] += N[i, 1] * values[1] * N[j, 1] + N[i, 2] * values[2] * N[j, 2]
            A[j, i] = A[i, j]


@numba.njit(**SETTINGS)
def compose_stored(N, values, size, components):  # type: ignore[no-untyped-def]
    """Fill columns of components (q, ..) with the stored sum_a values_a N_a N_a."""
    for q in range(len(N)):
        for p in range(size):
            i, j = PAIRS[p]
            components[q, p] = 0.0
            for a in range(3):
                components[q, p] += N[q, i, a] * values[q, a] * N[q, j, a]


@numba.njit(**SETTINGS)
def congruent(G, A, B):  # type: ignore[no-untyped-def]
    """Set B to G A G, G and A symmetric."""
    for i in range(3):
        for j in range(i, 3):
            total = 0.0
            for k in range(3):
                row = A[k, 0] * G[0, j] + A[k, 1] * G[1, j] + A[k, 2] * G[2, j]
                total += G[i, k] * row
            B[i, j] = total
            B[j, i] = total


@numba.njit(**SETTINGS)
def first_difference(x, y, log_x, log_y):  # type: ignore[no-untyped-def]
    """Divided difference of 1/2 ln(1 + .)."""
    t = (x - y) / (2 + x + y)
    if abs(t) < NEAR:
        q, total = t * t, 0.0
        for k in range(8, -1, -1):
            total = total * q + 1 / (2 * k + 1)
        return total / (2 + x + y)
    return (log_x - log_y) / (x - y)


@numba.njit(**SETTINGS)
def confluent_differences(x, y, f):  # type: ignore[no-untyped-def]
    """f_xxy and f_xyy of 1/2 ln(1 + .), f = f_xy."""
    total = 2 + x + y
    t = (x - y) / total
    even = 1 / (1 - t * t)
    odd = 0.0
    if abs(t) < NEAR:
        for k in range(8, 0, -1):
            odd = odd * t * t + 2 * k / (2 * k + 1)
        odd *= t
    else:
        odd = (even - f * total) / t
    return (odd - even) / (total * total), (-odd - even) / (total * total)


@numba.njit(**SETTINGS)
def second_difference(x, y, z, f_xy, f_yz, f_zx):  # type: ignore[no-untyped-def]
    """f_xyz of 1/2 ln(1 + .)."""
    m = 1 + (x + y + z) / 3
    a, b, c = (1 + x - m) / m, (1 + y - m) / m, (1 + z - m) / m
    if max(abs(a), abs(b), abs(c)) < NEAR:
        # complete homogeneous polynomials with zero sum
        second, third = a * b + b * c + c * a, a * b * c
        h0, h1, h2 = 0.0, 0.0, 1.0
        total, sign = 0.0, -1.0
        for k in range(16):
            total += sign * h2 / (2 * (k + 2))
            h0, h1, h2 = h1, h2, third * h0 - second * h1
            sign = -sign
        return total / (m * m)
    if abs(x - z) >= abs(x - y) and abs(x - z) >= abs(y - z):
        return (f_xy - f_yz) / (x - z)
    if abs(x - y) >= abs(y - z):
        return (f_zx - f_yz) / (x - y)
    return (f_xy - f_zx) / (y - z)


@numba.njit(**SETTINGS)
def decompose(H, g, shared, x, logs, N, y, m):  # type: ignore[no-untyped-def]
    """Fill x and logs (q, 3), and the columns N, y, m (q, 3, 3), for H and g (q, 3, 3).

    A `shared` g is (1, 3, 3). Where det F is not positive, all is NaN.
    """
    G, C, D = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for q in range(len(H)):
        h, root = H[q], g[0 if shared else q]
        for i in range(3):
            for j in range(i, 3):
                C[i, j] = h[i, j] + h[j, i]
                C[i, j] += h[0, i] * h[0, j] + h[1, i] * h[1, j] + h[2, i] * h[2, j]
                C[j, i] = C[i, j]
                G[i, j] = root[i, j] + (1.0 if i == j else 0.0)
                G[j, i] = G[i, j]
        if not shared:
            congruent(G, C, D)
            add_square_minus_one(root, D)
            C, D = D, C
        diagonalise(C, N[q])
        undefined = 0.0 if determinant(h) > 0.0 else np.nan
        for a in range(3):
            x[q, a] = C[a, a] + undefined
            logs[q, a] = np.log1p(x[q, a]) / 2
            for i in range(3):
                m[q, i, a] = G[i, 0] * N[q, 0, a] + G[i, 1] * N[q, 1, a] + G[i, 2] * N[q, 2, a]
            for i in range(3):
                y[q, i, a] = m[q, i, a] + h[i, 0] * m[q, 0, a]
                y[q, i, a] += h[i, 1] * m[q, 1, a] + h[i, 2] * m[q, 2, a]


@numba.njit(**SETTINGS)
def add_square_minus_one(g, A):  # type: ignore[no-untyped-def]
    """Add (I + g)^2 - I = 2 g + g^2 to A, g symmetric."""
    for i in range(3):
        for j in range(3):
            A[i, j] += 2 * g[i, j] + g[i, 0] * g[0, j] + g[i, 1] * g[1, j] + g[i, 2] * g[2, j]


@numba.njit(**SETTINGS)
def determinant(h):  # type: ignore[no-untyped-def]
    """det(I + h)."""
    a, b, c = 1 + h[0, 0], 1 + h[1, 1], 1 + h[2, 2]
    total = a * (b * c - h[1, 2] * h[2, 1]) - h[0, 1] * (h[1, 0] * c - h[1, 2] * h[2, 0])
    return total + h[0, 2] * (h[1, 0] * h[2, 1] - b * h[2, 0])


@numba.njit(**SETTINGS)
def _isotropic_moduli(pairs, law, x, logs, S, M):  # type: ignore[no-untyped-def]
    """Fill S and M from T_aa, L_aabb (upper triangle), G_12, G_23, G_13, T = 2 G E."""
    k = 3
    for a in range(3):
        for b in range(a, 3):
            M[a, b] = law[k] / (4 * (1 + x[a]) * (1 + x[b]))
            M[b, a] = M[a, b]
            k += 1
    for a in range(3):
        S[a, a] = law[a] / (1 + x[a])
        M[a, a] -= S[a, a] / (2 * (1 + x[a]))
    for i in range(3, len(pairs)):
        a, b = PAIRS[i]
        f = first_difference(x[a], x[b], logs[a], logs[b])
        f_a, f_b = confluent_differences(x[a], x[b], f)
        M[i, i] = 4 * law[6 + i] * f * f + 2 * (law[a] * f_a + law[b] * f_b)


@numba.njit(**SETTINGS)
def _moduli(pairs, law, x, logs, N, S, M, f, h, T, R, L):  # type: ignore[no-untyped-def]
    s = len(pairs)
    _differences(s, x, logs, f, h)
    _turn(s, N, R)
    k = s
    for i in range(s):
        a, b = PAIRS[i]
        total = 0.0
        for j in range(s):
            total += R[i, j] * law[j]
        T[a, b] = total
        T[b, a] = total
        S[a, b] = 2 * f[a, b] * total
        S[b, a] = S[a, b]
        for j in range(i, s):
            L[i, j] = law[k]
            L[j, i] = law[k]
            k += 1
    for i in range(s):
        a, b = PAIRS[i]
        factor = f[a, b] * (1.0 if i < 3 else 2.0)
        for j in range(s):
            R[i, j] *= factor
    _transform(s, R, L, M)
    _add_curvature(s, T, h, M)


@numba.njit(**SETTINGS)
def _turn(s, N, R):  # type: ignore[no-untyped-def]
    for i in range(s):
        a, b = PAIRS[i]
        for j in range(s):
            c, d = PAIRS[j]
            R[i, j] = N[c, a] * N[d, b] + (N[d, a] * N[c, b] if j > 2 else 0.0)


@numba.njit(**SETTINGS)
def _transform(s, R, L, M):  # type: ignore[no-untyped-def]
    for i in range(s):
        for j in range(s):
            M[i, j] = 0.0
        for k in range(s):
            part = 0.0
            for j in range(s):
                part += R[i, j] * L[j, k]
            for j in range(s):
                M[i, j] += part * R[j, k]


@numba.njit(**SETTINGS)
def _add_curvature(s, T, h, M):  # type: ignore[no-untyped-def]
    """Add T : d^2 E, 2 T_ab f_acb for each ac and cb."""
    for i in range(s):
        a, c = PAIRS[i]
        M[i, i] += 2 * T[a, a] * h[a, c, a]
        if i > 2:
            M[i, i] += 2 * T[c, c] * h[c, a, c]
            for n, b in ((a, c), (c, a)):
                M[i, n] += 2 * T[a, c] * h[n, n, b]
                M[n, i] += 2 * T[a, c] * h[n, n, b]
    if s > 4:
        for i, j, a, b in ((3, 4, 0, 2), (4, 5, 0, 1), (3, 5, 1, 2)):
            M[i, j] += 2 * T[a, b] * h[0, 1, 2]
            M[j, i] += 2 * T[a, b] * h[0, 1, 2]


@numba.njit(**SETTINGS)
def _differences(s, x, logs, f, h):  # type: ignore[no-untyped-def]
    for a in range(3):
        f[a, a] = 1 / (2 * (1 + x[a]))
        h[a, a, a] = -f[a, a] / (2 * (1 + x[a]))
    for i in range(3, s):
        a, b = PAIRS[i]
        f[a, b] = first_difference(x[a], x[b], logs[a], logs[b])
        f[b, a] = f[a, b]
        f_a, f_b = confluent_differences(x[a], x[b], f[a, b])
        h[a, a, b], h[a, b, a], h[b, a, a] = f_a, f_a, f_a
        h[b, b, a], h[b, a, b], h[a, b, b] = f_b, f_b, f_b
    if s > 4:
        h[0, 1, 2] = second_difference(x[0], x[1], x[2], f[0, 1], f[1, 2], f[0, 2])


@numba.njit(**SETTINGS)
def respond(pairs, isotropic, law, x, logs, N, y, m, P, A):  # type: ignore[no-untyped-def]
    """Fill P (q, k) and dP/dF, A (q, k (k + 1) / 2), upper triangle row by row."""
    S, M, B = np.zeros((3, 3)), np.zeros((6, 6)), np.empty((3, 3))
    Z, W = np.empty((6, 9)), np.empty((6, 9))
    f, h, T = np.empty((3, 3)), np.empty((3, 3, 3)), np.empty((3, 3))
    R, L = np.empty((6, 6)), np.empty((6, 6))
    for q in range(len(x)):
        if isotropic:
            _isotropic_moduli(pairs, law[q], x[q], logs[q], S, M)
        else:
            _moduli(pairs, law[q], x[q], logs[q], N[q], S, M, f, h, T, R, L)
        _fill_stress(pairs, y[q], m[q], S, Z, P[q])
        _couple(pairs, isotropic, M, Z, W)
        congruent_columns(m[q], S, B)
        _fill_tangent(pairs, B, Z, W, A[q])


@numba.njit(**SETTINGS)
def _fill_stress(pairs, y, m, S, Z, P):  # type: ignore[no-untyped-def]
    """Fill Z (s, k) = dC, and P (k,)."""
    s = len(pairs)
    k = s + 1 if s == 4 else s + 3
    for n in range(k):
        i, j = _entry(n, s)
        total = 0.0
        for p in range(s):
            a, b = PAIRS[p]
            Z[p, n] = y[i, a] * m[j, b] + y[i, b] * m[j, a]
            total += S[a, b] * Z[p, n] * (0.5 if p < 3 else 1.0)
        P[n] = total


@numba.njit(**SETTINGS)
def _couple(pairs, isotropic, M, Z, W):  # type: ignore[no-untyped-def]
    s = len(pairs)
    k = s + 1 if s == 4 else s + 3
    for p in range(s):
        for n in range(k):
            W[p, n] = M[p, p] * Z[p, n]
        coupled = s if not isotropic else 3 if p < 3 else 0
        for r in range(coupled):
            if r != p:
                for n in range(k):
                    W[p, n] += M[p, r] * Z[r, n]


@numba.njit(**SETTINGS)
def congruent_columns(m, S, B):  # type: ignore[no-untyped-def]
    """Set B to m S m^T, S symmetric."""
    for i in range(3):
        first = m[i, 0] * S[0, 0] + m[i, 1] * S[1, 0] + m[i, 2] * S[2, 0]
        second = m[i, 0] * S[0, 1] + m[i, 1] * S[1, 1] + m[i, 2] * S[2, 1]
        third = m[i, 0] * S[0, 2] + m[i, 1] * S[1, 2] + m[i, 2] * S[2, 2]
        for j in range(i, 3):
            B[i, j] = first * m[j, 0] + second * m[j, 1] + third * m[j, 2]
            B[j, i] = B[i, j]


@numba.njit(**SETTINGS)
def _fill_tangent(pairs, B, Z, W, A):  # type: ignore[no-untyped-def]
    """Set A to Z^T W + B, the stress part; upper triangle."""
    s = len(pairs)
    k = s + 1 if s == 4 else s + 3
    t = 0
    for n in range(k):
        i, j = _entry(n, s)
        for o in range(n, k):
            c, d = _entry(o, s)
            total = B[j, d] if i == c else 0.0
            for p in range(s):
                total += Z[p, n] * W[p, o]
            A[t] = total
            t += 1


@numba.njit(**SETTINGS)
def _entry(n, s):  # type: ignore[no-untyped-def]
    if s == 6:
        return n // 3, n % 3
    return (n // 2, n % 2) if n < 4 else (2, 2)


@numba.njit(**SETTINGS)
def roots(strain, g):  # type: ignore[no-untyped-def]
    """Fill g with exp(-strain) - I, both (q, 3, 3)."""
    A, N, values = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    for q in range(len(g)):
        A[:] = strain[q]
        diagonalise(A, N)
        for a in range(3):
            values[a] = np.expm1(-A[a, a])
        compose(N, values, g[q])


@numba.njit(**SETTINGS)
def flow(strain, increment, g, N, new):  # type: ignore[no-untyped-def]
    """Fill new (q, 3, 3) with -1/2 ln(G exp(-2 D) G), G = I + g = exp(-strain).

    D has the eigenvectors N and the eigenvalues increment (q, 3).
    """
    A, D, G = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    V, values = np.empty((3, 3)), np.empty(3)
    for q in range(len(new)):
        if increment[q, 0] == 0.0 and increment[q, 1] == 0.0 and increment[q, 2] == 0.0:
            new[q] = strain[q]
            continue
        for a in range(3):
            values[a] = np.expm1(-2 * increment[q, a])
        compose(N[q], values, D)
        for i in range(3):
            for j in range(3):
                G[i, j] = g[q, i, j] + (1.0 if i == j else 0.0)
        congruent(G, D, A)
        add_square_minus_one(g[q], A)
        diagonalise(A, V)
        for a in range(3):
            values[a] = -np.log1p(A[a, a]) / 2
        compose(V, values, new[q])


@numba.njit(**SETTINGS)
def lost(pairs, law, x, logs, N, share):  # type: ignore[no-untyped-def]
    """Fill share (q,) with 1 - |dev tau| / |dev T|, zero where T is zero.

    In the eigenvectors tau_ab = 2 f_ab sqrt(1 + x_a) sqrt(1 + x_b) T_ab.
    """
    for q in range(len(x)):
        mean = (law[q, 0] + law[q, 1] + law[q, 2]) / 3
        inner, outer = 0.0, 0.0
        for a in range(3):
            for b in range(a, 3):
                T = 0.0
                for j in range(len(pairs)):
                    c, d = PAIRS[j]
                    value = law[q, j] - (mean if j < 3 else 0.0)
                    T += N[q, c, a] * value * N[q, d, b]
                    if j > 2:
                        T += N[q, d, a] * value * N[q, c, b]
                f = 2 * first_difference(x[q, a], x[q, b], logs[q, a], logs[q, b])
                tau = f * np.sqrt((1 + x[q, a]) * (1 + x[q, b])) * T
                times = 1.0 if a == b else 2.0
                inner += times * T * T
                outer += times * tau * tau
        share[q] = 1 - np.sqrt(outer / inner) if inner > 0 else 0.0

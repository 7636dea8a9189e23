# SPDX-License-Identifier: MIT
"""Logarithmic strains at points, and the transformation of their stresses and moduli to P.

Formulas: theory.md, Small-strain laws at finite strain, with G = I + g, F = I + H, and x, logs, N,
y, m of C = (F G)^T F G. Components are stored as in `tensor.INDEX`: in the plane xx, xy, yx, yy, zz
of F and P, in space nine.
"""

from collections.abc import Callable

import numba
import numpy as np

from dolfinx_mortar.common.arrays import LIMIT, Floats
from dolfinx_mortar.materials.tensor import INDEX

IDENTITY = np.eye(3)
PAIRS = INDEX
NUMBER = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2]])  # of the stored component ij
SETTINGS = {"cache": True, "error_model": "numpy"}

# Relative difference of eigenvalues below which power series are exact to round-off.
NEAR = 0.08


@numba.njit(**SETTINGS)
def diagonalise(A, N):  # type: ignore[no-untyped-def]
    """Replace a symmetric A (3, 3) by its eigenvalues, N by its eigenvectors, by Jacobi's method.

    An A with A_02 = A_12 = 0 keeps its last eigenvector.
    """
    N[:] = IDENTITY
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
def _diagonalise_all(A, N):  # type: ignore[no-untyped-def]
    for q in range(len(A)):
        diagonalise(A[q], N[q])


def function_of(A: Floats, f: Callable[[Floats], Floats]) -> Floats:
    """Isotropic functions sum_a f(A_a) N_a (x) N_a of symmetric tensors A (q, 3, 3)."""
    D, N = A.copy(), np.empty_like(A)
    _diagonalise_all(D, N)
    return _compose(N, f(D[:, range(3), range(3)]))


def _compose(N: Floats, values: Floats) -> Floats:
    return (N * values[:, None]) @ np.swapaxes(N, 1, 2)


@numba.njit(**SETTINGS)
def compose_stored(pairs, N, values, components):  # type: ignore[no-untyped-def]
    """Fill the first columns of components (q, ..) with the stored sum_a values_a N_a N_a."""
    for q in range(len(N)):
        for p in range(len(pairs)):
            i, j = pairs[p]
            components[q, p] = 0.0
            for a in range(3):
                components[q, p] += N[q, i, a] * values[q, a] * N[q, j, a]


@numba.njit(**SETTINGS)
def congruent(G, A, B):  # type: ignore[no-untyped-def]
    """Set B to G A G^T, A symmetric."""
    for i in range(3):
        for j in range(i, 3):
            total = 0.0
            for a in range(3):
                for b in range(3):
                    total += G[i, a] * A[a, b] * G[j, b]
            B[i, j] = B[j, i] = total


@numba.njit(**SETTINGS)
def add_change(h, A):  # type: ignore[no-untyped-def]
    """Add (I + h)^T (I + h) - I to A."""
    for i in range(3):
        for j in range(3):
            A[i, j] += h[i, j] + h[j, i]
            for k in range(3):
                A[i, j] += h[k, i] * h[k, j]


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
def decompose(H, g, x, logs, N, y, m):  # type: ignore[no-untyped-def]
    """Fill x and logs (q, 3), and the columns N, y, m (q, 3, 3), for H and g (q or 0, 3, 3).

    Without g, G is I. Where det F is not positive, all is NaN.
    """
    F, G, C, D = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for q in range(len(H)):
        C[:] = 0.0
        add_change(H[q], C)
        for i in range(3):
            for j in range(3):
                F[i, j] = IDENTITY[i, j] + H[q, i, j]
                G[i, j] = IDENTITY[i, j] + (g[q, i, j] if len(g) else 0.0)
        if len(g):
            congruent(G, C, D)
            C[:] = D
            add_change(g[q], C)
        diagonalise(C, N[q])
        J = 0.0
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            J += F[0, i] * (F[1, j] * F[2, k] - F[1, k] * F[2, j])
        undefined = 0.0 if J > 0.0 else np.nan
        for a in range(3):
            x[q, a] = C[a, a] + undefined
            logs[q, a] = np.log1p(x[q, a]) / 2
            for i in range(3):
                m[q, i, a] = G[i, 0] * N[q, 0, a] + G[i, 1] * N[q, 1, a] + G[i, 2] * N[q, 2, a]
            for i in range(3):
                y[q, i, a] = F[i, 0] * m[q, 0, a] + F[i, 1] * m[q, 1, a] + F[i, 2] * m[q, 2, a]


@numba.njit(**SETTINGS)
def _differences(pairs, x, logs, f, h):  # type: ignore[no-untyped-def]
    """Fill f_ab, f_aab and f_abb of 1/2 ln(1 + .), in all orders of the indices."""
    for a in range(3):
        f[a, a] = 1 / (2 * (1 + x[a]))
        h[a, a, a] = -f[a, a] * f[a, a]
    for i in range(3, len(pairs)):
        a, b = PAIRS[i]
        f[a, b] = first_difference(x[a], x[b], logs[a], logs[b])
        f_a, f_b = confluent_differences(x[a], x[b], f[a, b])
        h[a, a, b] = h[a, b, a] = h[b, a, a] = f_a
        h[b, b, a] = h[b, a, b] = h[a, b, b] = f_b


@numba.njit(**SETTINGS)
def _isotropic_moduli(pairs, law, f, h, S, M):  # type: ignore[no-untyped-def]
    """Fill S and M from T_aa, L_aabb, G_12, G_23, G_13, T = 2 G E."""
    for a in range(3):
        S[a, a] = 2 * law[a] * f[a, a]
        for b in range(3):
            M[a, b] = law[3 + 3 * a + b] * f[a, a] * f[b, b]
        M[a, a] += 2 * law[a] * h[a, a, a]
    for i in range(3, len(pairs)):
        a, b = PAIRS[i]
        M[i, i] = 4 * law[9 + i] * f[a, b] ** 2
        M[i, i] += 2 * (law[a] * h[a, a, b] + law[b] * h[a, b, b])


@numba.njit(**SETTINGS)
def _moduli(pairs, law, x, N, f, h, S, M, T, R):  # type: ignore[no-untyped-def]
    """Fill S and M from T and L, row by row, of stored components."""
    s = len(pairs)
    if s > 4:
        mixed = second_difference(x[0], x[1], x[2], f[0, 1], f[1, 2], f[0, 2])
        h[0, 2, 1] = h[1, 0, 2] = h[0, 1, 2] = mixed
    M[:] = 0.0
    for i in range(s):
        a, b = PAIRS[i]
        T[i] = 0.0
        for j in range(s):
            c, d = PAIRS[j]
            R[i, j] = N[c, a] * N[d, b] + (N[d, a] * N[c, b] if j > 2 else 0.0)
            T[i] += R[i, j] * law[j]
            R[i, j] *= f[a, b] * (1.0 if i < 3 else 2.0)
        S[a, b] = S[b, a] = 2 * f[a, b] * T[i]
        for c in range(3):  # T : d^2 E
            j, k = NUMBER[a, c], NUMBER[c, b]
            M[j, k] += 2 * T[i] * h[a, c, b]
            if i > 2:
                M[k, j] += 2 * T[i] * h[a, c, b]
    for i in range(s):
        for k in range(s):
            part = 0.0
            for j in range(s):
                part += R[i, j] * law[s + s * j + k]
            for j in range(s):
                M[i, j] += part * R[j, k]


@numba.njit(**SETTINGS)
def respond(pairs, isotropic, law, x, logs, N, y, m, P, A):  # type: ignore[no-untyped-def]
    """Fill P (q, k) and dP/dF, A (q, k (k + 1) / 2), upper triangle row by row."""
    s = len(pairs)
    k = P.shape[1]
    S, M, B = np.zeros((3, 3)), np.zeros((6, 6)), np.empty((3, 3))
    f, h, T, R = np.empty((3, 3)), np.zeros((3, 3, 3)), np.empty(6), np.empty((6, 6))
    Z, W = np.empty((6, 9)), np.empty((6, 9))
    for q in range(len(x)):
        _differences(pairs, x[q], logs[q], f, h)
        if isotropic:
            _isotropic_moduli(pairs, law[q], f, h, S, M)
        else:
            _moduli(pairs, law[q], x[q], N[q], f, h, S, M, T, R)
        for n in range(k):
            i, j = _entry(n, s)
            P[q, n] = 0.0
            for p in range(s):
                a, b = PAIRS[p]
                Z[p, n] = y[q, i, a] * m[q, j, b] + y[q, i, b] * m[q, j, a]  # dC
                P[q, n] += S[a, b] * Z[p, n] * (0.5 if p < 3 else 1.0)
        congruent(m[q], S, B)
        _fill_tangent(s, k, M, B, Z, W, A[q])


@numba.njit(**SETTINGS)
def _fill_tangent(s, k, M, B, Z, W, A):  # type: ignore[no-untyped-def]
    """Set A to Z^T M Z + B, the stress part; upper triangle."""
    t = 0
    for p in range(s):
        for n in range(k):
            W[p, n] = M[p, p] * Z[p, n]
        for r in range(s):
            if r != p and M[p, r] != 0.0:
                for n in range(k):
                    W[p, n] += M[p, r] * Z[r, n]
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


def roots(strain: Floats) -> Floats:
    """Return exp(-strain) - I (q, 3, 3)."""
    return function_of(strain, lambda values: np.expm1(-values))


def flow(strain: Floats, increment: Floats, g: Floats, N: Floats) -> Floats:
    """Return -1/2 ln(G exp(-2 D) G) (q, 3, 3), G = I + g = exp(-strain).

    D has the eigenvectors N and the eigenvalues increment (q, 3).
    """
    D = _compose(N, np.expm1(-2 * increment))
    change = D + g @ D + D @ g + g @ D @ g + 2 * g + g @ g
    new = function_of(change, lambda values: -np.log1p(values) / 2)
    flows = np.any(increment, axis=1, keepdims=True)
    return np.where(flows[:, None], new, strain)

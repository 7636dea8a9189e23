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
def times(A, B):  # type: ignore[no-untyped-def]
    """Return A B; for small matrices faster than BLAS."""
    C = np.zeros((len(A), B.shape[1]))
    for i in range(len(A)):
        for k in range(len(B)):
            for j in range(B.shape[1]):
                C[i, j] += A[i, k] * B[k, j]
    return C


@numba.njit(**SETTINGS)
def compose(N, values):  # type: ignore[no-untyped-def]
    """Return sum_a values_a N_a (x) N_a."""
    return times(N * values, N.T)


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

    A g that is `shared` is (1, 3, 3), and zero. Where det F is not positive, all is NaN.
    """
    for q in range(len(H)):
        h = H[q]
        C = h + h.T + times(h.T, h)
        if not shared:
            C = congruent(g[q], C)
        diagonalise(C, N[q])
        undefined = 0.0 if determinant(h) > 0.0 else np.nan
        for a in range(3):
            x[q, a] = C[a, a] + undefined
            logs[q, a] = np.log1p(x[q, a]) / 2
        m[q] = N[q] if shared else N[q] + times(g[q], N[q])
        y[q] = m[q] + times(h, m[q])


@numba.njit(**SETTINGS)
def congruent(g, A):  # type: ignore[no-untyped-def]
    """Return G (I + A) G - I for G = I + g, g symmetric."""
    G = np.eye(3) + g
    return times(times(G, A), G) + 2 * g + times(g, g)


@numba.njit(**SETTINGS)
def determinant(h):  # type: ignore[no-untyped-def]
    """det(I + h)."""
    a, b, c = 1 + h[0, 0], 1 + h[1, 1], 1 + h[2, 2]
    total = a * (b * c - h[1, 2] * h[2, 1]) - h[0, 1] * (h[1, 0] * c - h[1, 2] * h[2, 0])
    return total + h[0, 2] * (h[1, 0] * h[2, 1] - b * h[2, 0])


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
        value = second_difference(x[0], x[1], x[2], f[0, 1], f[1, 2], f[0, 2])
        h[0, 1, 2], h[1, 0, 2], h[0, 2, 1] = value, value, value
        h[2, 1, 0], h[1, 2, 0], h[2, 0, 1] = value, value, value


@numba.njit(**SETTINGS)
def _add_curvature(s, T, h, M):  # type: ignore[no-untyped-def]
    """Add T : d^2 E to M, 2 T_ab f_acb for each ac and cb."""
    for i in range(s):
        for j in range(s):
            for u in range(1 if i < 3 else 2):
                for v in range(1 if j < 3 else 2):
                    a, c, b = PAIRS[i][u], PAIRS[i][1 - u], PAIRS[j][1 - v]
                    if PAIRS[j][v] == c:
                        M[i, j] += 2 * T[a, b] * h[a, c, b]


@numba.njit(**SETTINGS)
def _read(isotropic, law, N, T, L, R):  # type: ignore[no-untyped-def]
    """Fill T in the eigenvectors, L, and R, which maps stored components to those in them."""
    s = len(R)
    t = width = 3 if isotropic else s
    for i in range(s):
        a, b = PAIRS[i]
        for j in range(i, s):
            if j < 3 or i == j or not isotropic:
                L[i, j] = law[t]
                L[j, i] = law[t]
                t += 1
        total = 0.0
        for j in range(width):
            if not isotropic:
                c, d = PAIRS[j]
                R[i, j] = N[c, a] * N[d, b] + (N[d, a] * N[c, b] if j > 2 else 0.0)
            total += R[i, j] * law[j]
        T[a, b], T[b, a] = total, total


@numba.njit(**SETTINGS)
def respond(components, isotropic, law, x, logs, N, y, m, P, A):  # type: ignore[no-untyped-def]
    """Fill P (q, k) and the upper triangle of dP/dF, A (q, k (k + 1) / 2), row by row.

    The law gives T and the upper triangle of L; an isotropic one T_aa, L_aabb, and G_12, G_23, G_13
    of T = 2 G E.
    """
    k, s = len(components), 4 if len(components) == 5 else 6
    f, h, T = np.zeros((3, 3)), np.zeros((3, 3, 3)), np.zeros((3, 3))
    R, L, Z, scale = np.eye(s), np.zeros((s, s)), np.empty((s, k)), np.empty((s, 1))
    for q in range(len(x)):
        _differences(s, x[q], logs[q], f, h)
        _read(isotropic, law[q], N[q], T, L, R)
        P[q] = 0.0
        for i in range(s):
            a, b = PAIRS[i]
            scale[i] = f[a, b] * (1.0 if i < 3 else 2.0)
            for n in range(k):
                c, d = components[n]
                Z[i, n] = y[q, c, a] * m[q, d, b] + y[q, c, b] * m[q, d, a]
                P[q, n] += scale[i, 0] * T[a, b] * Z[i, n]
        M = L * scale * scale.T if isotropic else scale * times(times(R, L), R.T) * scale.T
        _add_curvature(s, T, h, M)
        B, tangent = times(times(m[q], 2 * f * T), m[q].T), times(Z.T, times(M, Z))
        t = 0
        for n in range(k):
            for o in range(n, k):
                same = components[n][0] == components[o][0]
                A[q, t] = tangent[n, o] + (B[components[n][1], components[o][1]] if same else 0.0)
                t += 1


@numba.njit(**SETTINGS)
def roots(strain, g):  # type: ignore[no-untyped-def]
    """Fill g (q, 3, 3) with exp(-strain) - I of symmetric tensors (q, 3, 3)."""
    A, N = np.empty((3, 3)), np.empty((3, 3))
    for q in range(len(g)):
        A[:] = strain[q]
        diagonalise(A, N)
        g[q] = compose(N, np.expm1(-np.diag(A)))


@numba.njit(**SETTINGS)
def flow(strain, increment, g, N, new):  # type: ignore[no-untyped-def]
    """Fill new (q, 3, 3) with -1/2 ln(G exp(-2 D) G), G = I + g = exp(-strain).

    D has the eigenvectors N and the eigenvalues increment (q, 3).
    """
    V = np.empty((3, 3))
    for q in range(len(new)):
        if (increment[q] == 0.0).all():
            new[q] = strain[q]
            continue
        A = congruent(g[q], compose(N[q], np.expm1(-2 * increment[q])))
        diagonalise(A, V)
        new[q] = compose(V, -np.log1p(np.diag(A)) / 2)

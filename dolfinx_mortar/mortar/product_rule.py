# SPDX-License-Identifier: MIT
r"""Derivatives of forces, gaps and dual functions of a slave facet from those of its moments.

With the moments S, R and H (`geometry.moments`), dual functions Phi_j = sum_b C_jb N_b, tractions
c_j = lambda_j n_j + tau_j and the nodes x_k and y_l of both sides

    D = C S,   M = C R,   F_k = sum_j D_jk c_j,   F_l = -sum_j M_jl c_j,
    G_j = n_j.(sum_l M_jl y_l - sum_k D_jk x_k) - (C H)_j,     b_j = sum_l M_jl n_l,

so that dD = dC S + C dS, dM = dC R + C dR, and the others follow. Over the nodes that carry a
multiplier, with N~ = T N of `duals.absorbed`, m = T S T^T and d = T S 1,

    A = diag(d) m^-1,   dA = (diag(dd) - A dm) m^-1,   C = (A - mean of its rows) T + 1 / count.

Beside open edges C is a mean of two such, with shares that depend on the opening (`edges`). Tools
have no master: for H stands minus the integral of N_j phi. In the plane, in space and for tools it
is the same; no other function has derivatives by coordinates.
"""

from typing import NamedTuple

import numba
import numpy as np

from dolfinx_mortar.arrays import Bools, Floats
from dolfinx_mortar.geometry.moments import KERNEL


class Basis(NamedTuple):
    """Dual functions of facets (p,), first with all shared out, then with nothing."""

    T: Floats  # (p, 2, k, k)
    inverse: Floats  # (p, 2, k, k) m^-1, 0 for nodes without multiplier
    kept: Bools  # (p, 2, k)
    closed: Floats  # (p,) share of the first


class Fixed(NamedTuple):
    """What does not change with the coordinates."""

    c: Floats  # (p, k, d)
    n: Floats  # (p, k, d)
    n_m: Floats  # (p, m, d) n_l


class Results(NamedTuple):
    """Derivatives by the z coordinates: of the slave facet, directions, and nodes of masters."""

    F: Floats  # (p, k + m, d, z)
    G: Floats  # (p, k, z)
    b: Floats  # (p, k, d, z)
    D: Floats  # (p, k, k) values
    M: Floats  # (p, k, m)


@numba.njit(**KERNEL)
def _add_product(factor, A, B, turned, C):  # type: ignore[no-untyped-def]
    """Add a factor times A B, or A B^T, to C."""
    for i in range(C.shape[0]):
        for j in range(C.shape[1]):
            total = 0.0
            for k in range(A.shape[1]):
                total += A[i, k] * (B[j, k] if turned else B[k, j])
            C[i, j] += factor * total


@numba.njit(**KERNEL)
def clear(A):  # type: ignore[no-untyped-def]
    """Set a matrix to zero."""
    for i in range(A.shape[0]):
        for j in range(A.shape[1]):
            A[i, j] = 0.0


@numba.njit(**KERNEL)
def _duals(S, T, inverse, kept, A, spare, C):  # type: ignore[no-untyped-def]
    """Write C (k, k) for the moments S, and A = diag(d) m^-1."""
    for i in range(2):
        clear(spare[i])
    _add_product(1.0, T, S, False, spare[0])
    for j in range(len(S)):
        d = 0.0
        for b in range(len(S)):
            d += spare[0, j, b]
        for b in range(len(S)):
            A[j, b] = d * inverse[j, b]
            spare[1, j, b] = A[j, b]
    _close(spare[1], T, kept, True, C)


@numba.njit(**KERNEL)
def _close(A, T, kept, whole, C):  # type: ignore[no-untyped-def]
    """Write (A - mean of its rows) T, and 1 / count of the nodes kept (k,) if whole; A is lost."""
    count = 0
    for j in range(len(A)):
        count += kept[j]
    count = max(count, 1)
    for b in range(len(A)):
        mean = 0.0
        for j in range(len(A)):
            mean += A[j, b] / count
        for j in range(len(A)):
            A[j, b] -= mean * kept[j]
            C[j, b] = kept[j] / count if whole else 0.0
    _add_product(1.0, A, T, False, C)


@numba.njit(**KERNEL)
def _dual_changes(dS, T, inverse, kept, A, spare, dC):  # type: ignore[no-untyped-def]
    """Write the derivatives of C for those of the moments, dS."""
    for i in range(4):
        clear(spare[i])
    _add_product(1.0, T, dS, False, spare[0])
    _add_product(1.0, spare[0], T, True, spare[1])  # dm
    _add_product(-1.0, A, spare[1], False, spare[2])
    for j in range(len(dS)):
        for b in range(len(dS)):
            spare[2, j, j] += spare[0, j, b]  # dd
    _add_product(1.0, spare[2], inverse, False, spare[3])
    _close(spare[3], T, kept, False, dC)


@numba.njit(**KERNEL)
def all_duals(S, dS, basis, f, shares, C, dC):  # type: ignore[no-untyped-def]
    """Write C (k, k) and its derivatives (z, k, k) of facet f; shares (z,): those of its share."""
    k, closed, mask = len(S), basis.closed[f], basis.kept[f, 0]
    both, A, spare, one = (np.empty((2, k, k)), np.empty((k, k)), np.empty((4, k, k)),
                           np.empty((k, k)))  # fmt: skip
    for z in range(len(dS)):
        clear(dC[z])
    for i in range(2 if closed < 1.0 else 1):
        at = basis.T[f, i], basis.inverse[f, i], basis.kept[f, i], A, spare
        _duals(S, *at, both[i])
        factor = 1.0 - closed if i else closed
        for z in range(len(dS)):
            _dual_changes(dS[z], *at, one)
            for j in range(k):
                for b in range(k):
                    dC[z, j, b] += factor * mask[j] * one[j, b]
    for j in range(k):
        for b in range(k):
            C[j, b] = both[0, j, b]
            if closed < 1.0:
                apart = both[0, j, b] - mask[j] * both[1, j, b]
                C[j, b] -= (1.0 - closed) * apart
                for z in range(len(dS)):
                    dC[z, j, b] += shares[z] * apart


@numba.njit(**KERNEL)
def apply(moments, changes, basis, shares, fixed, x, y, others, found):  # type: ignore[no-untyped-def]
    """Write the derivatives of facets, whose share in all shared out has the derivatives shares.

    Args:
        moments: (p, k, k + m + 1) S, R and H side by side.
        changes: (p, z, k, k + m + 1) their derivatives.
        basis: dual functions.
        shares: (p, z).
        fixed: what does not change.
        x: (p, k, d) nodes of the slave facets.
        y: (p, m, d) those of the masters.
        others: number of the first coordinate of a master.
        found: the result.
    """
    (p, k, _), m, size = x.shape, y.shape[1], changes.shape[1]
    C, dC, all_of = np.empty((k, k)), np.empty((size, k, k)), np.empty((k, k + m + 1))
    for f in range(p):
        all_duals(moments[f], changes[f], basis, f, shares[f], C, dC)
        clear(all_of)
        _add_product(1.0, C, moments[f], False, all_of)
        for j in range(k):
            for a in range(k):
                found.D[f, j, a] = all_of[j, a]
            for a in range(m):
                found.M[f, j, a] = all_of[j, k + a]
        for z in range(size):
            clear(all_of)
            _add_product(1.0, dC[z], moments[f], False, all_of)
            _add_product(1.0, C, changes[f, z], False, all_of)
            _contract(all_of, fixed, x[f], y[f], f, z, found)
        move(fixed.n[f], found.D[f], found.M[f], others, found.G[f])


@numba.njit(**KERNEL)
def _contract(changes, fixed, x, y, f, z, found):  # type: ignore[no-untyped-def]
    """Add what those of D, M and C H by z give to the derivatives of facet f."""
    c, n, n_m, (k, d), m = fixed.c[f], fixed.n[f], fixed.n_m[f], x.shape, len(y)
    for j in range(k):
        for i in range(d):
            moved = 0.0
            for a in range(k):
                found.F[f, a, i, z] += changes[j, a] * c[j, i]
                moved -= changes[j, a] * x[a, i]
            for a in range(m):
                dM = changes[j, k + a]
                found.F[f, k + a, i, z] -= dM * c[j, i]
                found.b[f, j, i, z] += dM * n_m[a, i]
                moved += dM * y[a, i]
            found.G[f, j, z] += n[j, i] * moved
        found.G[f, j, z] -= changes[j, k + m]


@numba.njit(**KERNEL)
def move(n, D, M, others, G):  # type: ignore[no-untyped-def]
    """Add n_j.(M_jl dy_l - D_jk dx_k) to G (k, z); the nodes of masters are the last columns."""
    k, d = n.shape
    for j in range(k):
        for i in range(d):
            for a in range(k):
                G[j, d * a + i] -= D[j, a] * n[j, i]
            for a in range(M.shape[1]):
                G[j, others + d * a + i] += M[j, a] * n[j, i]

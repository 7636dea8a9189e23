# SPDX-License-Identifier: MIT
r"""Dual basis functions of the multiplier, biorthogonal over the covered part of each slave facet.

On one facet with the covered part G, Phi = A N with A = D M^-1, D = diag(int_G N_j) and
M = int_G N N^T, so that int_G Phi_i N_j = delta_ij int_G N_j and sum_j Phi_j = 1. M is as good
as singular when little of the facet is covered, so it is never formed: with the weights w and
sqrt(w) N = Q R it follows that sqrt(w) Phi = Q R^-T D.

These are the Phi_j of the paper's eq. 20, and what makes D of eq. 19 diagonal. The closed form
given there, (1 -+ 3 xi) / 2, is that of a straight facet with two nodes, all of it covered.
"""

import numba
import numpy as np

from dolfinx_mortar.arrays import Bools, Floats, Ints
from dolfinx_mortar.geometry.tolerances import ROUND_OFF


def covered_weights(N_s: Floats, weight: Floats, slave: Ints, m: int) -> Floats:
    """Return the integrals (m, k) of N_j over the covered part of every slave facet (eq. 19).

    Args:
        N_s: Values (q, k) of the slave shape functions.
        weight: Weights (q,) of the quadrature points.
        slave: Slave facet (q,) of each point.
        m: Number of slave facets.

    Example:
        >>> covered_weights(np.array([[0.75, 0.25]]), np.array([1.0]), np.array([1]), 2)
        array([[0.  , 0.  ],
               [0.75, 0.25]])
    """
    columns = [np.bincount(slave, weight * N, minlength=m) for N in N_s.T]
    return np.stack(columns, axis=1)


# The kernels spell out their sums: array expressions would take three times as long to compile.


@numba.njit(cache=True)
def _product(A, i, B, j):  # type: ignore[no-untyped-def]
    """Return the scalar product of column i of A and column j of B."""
    result = 0.0
    for q in range(A.shape[0]):
        result += A[q, i] * B[q, j]
    return result


@numba.njit(cache=True)
def _orthonormalise(Q, R):  # type: ignore[no-untyped-def]
    """Replace the columns of Q (q, k) by Q of Q R; return False if they are dependent."""
    for j in range(Q.shape[1]):
        length = np.sqrt(_product(Q, j, Q, j))
        for _ in range(2):  # the second pass makes Q orthogonal to round-off
            for i in range(j):
                r = _product(Q, i, Q, j)
                R[i, j] += r
                for q in range(Q.shape[0]):
                    Q[q, j] -= r * Q[q, i]
        R[j, j] = np.sqrt(_product(Q, j, Q, j))
        if R[j, j] <= ROUND_OFF * length:
            return False
        for q in range(Q.shape[0]):
            Q[q, j] /= R[j, j]
    return True


@numba.njit(cache=True)
def _facet_dual(N, weight):  # type: ignore[no-untyped-def]
    """Return Phi (q, k) of one facet."""
    points, k = N.shape
    Q, R, D = np.empty((points, k)), np.zeros((k, k)), np.zeros(k)
    for q in range(points):
        for j in range(k):
            Q[q, j] = np.sqrt(weight[q]) * N[q, j]
            D[j] += weight[q] * N[q, j]
    if not _orthonormalise(Q, R):
        return N.copy()  # nothing but round-off is covered: any partition of unity will do
    Phi = np.zeros((points, k))
    y = np.empty(k)
    for j in range(k):
        for i in range(k):  # R^T y = D e_j
            y[i] = D[j] if i == j else 0.0
            for h in range(i):
                y[i] -= R[h, i] * y[h]
            y[i] /= R[i, i]
            for q in range(points):
                Phi[q, j] += y[i] * Q[q, i] / np.sqrt(weight[q])
    return Phi


@numba.njit(cache=True)
def _share_out(full, kept, count, Phi):  # type: ignore[no-untyped-def]
    """Add the functions (q, k) of one facet to Phi, removed ones in equal parts."""
    for q in range(full.shape[0]):
        for i in range(full.shape[1]):
            if kept[i]:
                Phi[q, i] += full[q, i]
                continue
            for j in range(full.shape[1]):
                if kept[j]:
                    Phi[q, j] += full[q, i] / count


@numba.njit(cache=True)
def _all_duals(N_s, weight, slave, keep):  # type: ignore[no-untyped-def]
    """Return Phi (q, k), removed functions shared out; points are ordered by slave facet."""
    Phi = np.zeros(N_s.shape)
    a = 0
    while a < len(slave):
        b = a
        while b < len(slave) and slave[b] == slave[a]:
            b += 1
        kept = keep[slave[a]]
        count = 0
        for j in range(len(kept)):
            count += kept[j]
        if count == 1:  # exact, and the only way where almost nothing is covered
            for q in range(a, b):
                for j in range(len(kept)):
                    Phi[q, j] = kept[j]
        elif count > 1:
            _share_out(_facet_dual(N_s[a:b], weight[a:b]), kept, count, Phi[a:b])
        a = b
    return Phi


def dual_values(N_s: Floats, weight: Floats, slave: Ints, keep: Bools) -> Floats:
    """Return the values (q, k) of the dual functions Phi (eq. 20) at the quadrature points.

    The function of a node that cannot carry a multiplier is shared out in equal parts to the kept
    nodes of the facet, Phi_k += c Phi_j with sum c = 1, and is zero itself: constants stay in the
    space of multipliers. Where a facet has no kept node, all functions vanish.

    Args:
        N_s: Values (q, k) of the slave shape functions.
        weight: Positive weights (q,) of the quadrature points.
        slave: Slave facet (q,) of each point, ascending.
        keep: For each slave facet and node (m, k), whether the node carries a multiplier.

    Returns:
        Phi with sum_q weight Phi_i N_j = delta_ij sum_q weight N_j on facets with all nodes kept.
    """
    N_s, weight = np.ascontiguousarray(N_s), np.ascontiguousarray(weight)
    return _all_duals(N_s, weight, np.ascontiguousarray(slave), np.ascontiguousarray(keep))


BASES = {"biorthogonal": dual_values}
"""Values of the multiplier's basis by the kind that a FacetElement names."""

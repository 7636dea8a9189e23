# SPDX-License-Identifier: MIT
r"""Derivatives of forces, gaps and dual functions of a slave facet from those of its moments.

With the moments S, R and H (`geometry.moments`), dual functions Phi_j = sum_b C_jb N_b, tractions
c_j = lambda_j n_j + tau_j and the nodes x_k and y_l of both sides

    D = C S,   M = C R,   F_k = sum_j D_jk c_j,   F_l = -sum_j M_jl c_j,
    G_j = n_j.(sum_l M_jl y_l - sum_k D_jk x_k) - (C H)_j,     b_j = sum_l M_jl n_l,

so that dD = dC S + C dS, dM = dC R + C dR, and the others follow. Over the nodes that carry a
multiplier, with N~ = T N of `duals.absorbed`, m = T S T^T and d = T S 1,

    A = diag(d) m^-1,   dA = (diag(dd) - A dm) m^-1,   C = (A - mean of its rows) T + 1 / count.

Tools have no master: for H stands minus the integral of N_j phi. In the plane, in space and for
tools it is the same; no other function has derivatives by coordinates.
"""

from typing import NamedTuple

import numpy as np

from dolfinx_mortar.arrays import Bools, Floats


class Basis(NamedTuple):
    """What the dual functions of facets (p,) are made of."""

    T: Floats  # (p, k, k)
    inverse: Floats  # (p, k, k) m^-1, 0 for nodes without multiplier
    kept: Bools  # (p, k)


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


def duals(S: Floats, dS: Floats, T: Floats, inverse: Floats, kept: Bools) -> tuple[Floats, Floats]:
    """Return C (p, k, k) of facets and its changes (p, z, k, k) for moments S and dS."""
    (p, z, k, _), V = dS.shape, inverse @ T
    part = kept / np.maximum(kept.sum(axis=1, keepdims=True), 1)
    AT = (T @ S).sum(axis=2)[:, :, None] * V
    # diag(dd) - A dm by dS: without m^-1, which may be large, so that nothing cancels after it
    rates = np.eye(k)[:, :, None, None] * T[:, :, None, :, None]
    rates = rates - AT[:, :, None, :, None] * T[:, None, :, None]
    change = dS.reshape(p, z, k * k) @ rates.reshape(p, k * k, k * k).swapaxes(1, 2)
    dC = (change.reshape(p, z * k, k) @ V).reshape(dS.shape)
    dC -= part[:, None, :, None] * dC.sum(axis=2, keepdims=True)
    return AT - part[:, :, None] * (AT.sum(axis=1, keepdims=True) - 1.0), dC


def apply(
    moments: Floats,
    changes: Floats,
    basis: Basis,
    fixed: Fixed,
    x: Floats,
    y: Floats,
    others: int,
) -> Results:
    """Return the derivatives of facets.

    Args:
        moments: (p, k, k + m + 1) S, R and H side by side.
        changes: (p, z, k, k + m + 1) their derivatives.
        basis: dual functions.
        fixed: what does not change.
        x: (p, k, d) nodes of the slave facets.
        y: (p, m, d) those of the masters.
        others: number of the first coordinate of a master.
    """
    (p, k, d), m, (_, z, _, size) = x.shape, y.shape[1], changes.shape
    C, dC = duals(moments[:, :, :k], changes[..., :k], *basis)
    C *= basis.kept[:, :, None]  # dC of others counts for nothing: they have no rows
    DM, w = C @ moments, 2 * d + 1
    D, M = DM[:, :, :k], DM[:, :, k:-1]
    by_nodes = np.zeros((p, size, w))  # gaps of D and M, b, and C H
    by_nodes[:, :k, :d], by_nodes[:, k:-1, :d] = -x, y
    by_nodes[:, k:-1, d:-1], by_nodes[:, -1, -1] = fixed.n_m, 1.0
    moved: Floats = (changes.reshape(p, z * k, size) @ by_nodes).reshape(p, z, k, w)
    moved = C[:, None] @ moved + dC @ (moments @ by_nodes)[:, None]
    G = np.einsum("pji,pzji->pjz", fixed.n, moved[..., :d]) - moved[..., -1].swapaxes(1, 2)
    G[:, :, : d * k] -= (D[:, :, :, None] * fixed.n[:, :, None]).reshape(p, k, k * d)
    G[:, :, others:] += (M[:, :, :, None] * fixed.n[:, :, None]).reshape(p, k, m * d)
    c = fixed.c.swapaxes(1, 2)
    by_C = ((c[:, None] @ dC).reshape(p, z * d, k) @ moments).reshape(p, z, d, size)
    F = (by_C + (c @ C)[:, None] @ changes)[..., :-1]
    F[..., k:] *= -1.0
    return Results(F.transpose(0, 3, 2, 1), G, moved[..., d:-1].transpose(0, 2, 3, 1), D, M)

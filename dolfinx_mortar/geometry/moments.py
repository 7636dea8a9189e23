# SPDX-License-Identifier: MIT
"""Moments of pairs of facets, for forces, gaps and dual functions (theory.md, The exact tangent).

    S_jk = int N_j N_k,     R_jl = int N_j N_l,     H_j = int N_j h

with the functions N of both sides, and the heights h of smooth surfaces.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dolfinx_mortar.arrays import Floats, Ints, Longs
from dolfinx_mortar.geometry.elements import FacetElement
from dolfinx_mortar.geometry.facets import Facets, dual_basis, surface_gradients


class Sides(NamedTuple):
    """Slave facets (p,) and the master facets (c,) that they face, ordered."""

    x: Floats  # (p, k, d)
    n: Floats  # (p, k, 2) directions of projection; (p, 0, 3) in 3D
    y: Floats  # (p, m, d) distinct nodes of the masters
    start: Longs  # (p + 1,)
    place: Longs  # (c, l) nodes of the masters among y
    deepest: Floats  # (c,)
    factor: Floats  # (p, k) nodal weights of the integrals
    reach: Floats  # (p, 2) see `Segments`; (p, 0) without

    def pairs(self) -> Ints:
        """Pairs (c, 2) of slave facets and masters."""
        of = np.repeat(np.arange(len(self.x), dtype=np.int32), np.diff(self.start))
        return np.stack([of, np.arange(len(of), dtype=np.int32)], axis=1)


class Sums(NamedTuple):
    """Moments of slave facets (p,) with k nodes, m nodes of their masters, c pairs."""

    values: Floats  # (p, k, k + m + 1) S, R and H
    changes: Floats  # (p, z, k, k + m + 1) derivatives
    E_s: Floats  # (c, k, k, k) dH_j by Q_ab of slave heights; (0, ..) unused
    E_m: Floats  # (c, k, l, l) of master heights
    chords: Floats  # (c, k, 2) dH_j by log lengths of chords; (0, ..) unused

    def add_heights(self, points: "Points", pairs: Ints) -> None:
        """Add the derivatives of H by heights, at the points of pairs (s,)."""
        v = points.weight[..., None] * points.N
        for i, (E, N) in enumerate(zip((self.E_s, self.E_m), points.own, strict=True)):
            if len(E):
                np.add.at(E, pairs, np.einsum("sqj,sqa,sqb->sjab", v, N, N, optimize=True))
            if len(self.chords):
                both = (v * points.by_chords[i][..., None]).sum(axis=1)
                np.add.at(self.chords[:, :, i], pairs, both)


class Points(NamedTuple):
    """Points (s, q) of pairs of facets with k and l nodes."""

    N: Floats  # (s, q, k) of the slave
    dN: Floats  # (s, q, d-1, k)
    dM: Floats  # (s, q, d-1, l) of the master
    f: Floats  # (s, q, k + l + 1) N of both and h
    by_N: Floats  # (s, q, k + l) dh by N
    T: Floats  # (s, q, d-1, d) tangents of the slave
    U: Floats  # (s, q, d-1, d) of the master
    apart: Floats  # (s, q, d) x_m - x_s
    weight: Floats  # (s, q)
    by_xi: Floats  # (s, q, 2 d-2) d log weight by both xi
    by_nodes: Floats  # (s, q, k + l, d) at fixed xi
    own: tuple[Floats, Floats]  # N of both facets
    by_chords: list[Floats]  # (s, q) dh by log lengths of chords

    def differentiate(self, by_s: Floats, by_m: Floats, by_w: Floats) -> tuple[Floats, Floats]:
        """Moments (s, k, k + l + 1), and their derivatives (s, z, k, k + l + 1).

        By derivatives (s, q, d-1, z) of both xi, and (s, q, z) of the log weight.
        """
        e, v = by_s.shape[2], self.weight[..., None] * self.N
        rates = self.by_xi[:, :, None]
        by_w = by_w + (rates[..., :e] @ by_s + rates[..., e:] @ by_m)[:, :, 0]
        sides = (by_s, self.dN), (by_m, self.dM)
        by_N = np.concatenate([np.swapaxes(by, 2, 3) @ df for by, df in sides], axis=3)
        by_f = np.concatenate([by_N, by_N @ self.by_N[..., None]], axis=3)
        by_v = self.weight[..., None, None] * by_f[..., : v.shape[2]]
        return products(v, self.f, by_v + by_w[..., None] * v[:, :, None], by_f)


def products(v: Floats, f: Floats, by_v: Floats, by_f: Floats) -> tuple[Floats, Floats]:
    """Sums over points of v_j f_a (s, k, n), and their derivatives (s, z, k, n)."""
    (s, q, z, k), n, v = by_v.shape, f.shape[2], np.swapaxes(v, 1, 2)
    changes = (np.swapaxes(by_v.reshape(s, q, z * k), 1, 2) @ f).reshape(s, z, k, n)
    changes += np.swapaxes((v @ by_f.reshape(s, q, z * n)).reshape(s, k, z, n), 1, 2)
    return v @ f, changes


def sums(N: Floats, x: Floats) -> Floats:
    """Sums of N_k x_k (s, q, .., d) for N (s, q, .., k) and nodes x (s, k, d)."""
    rows = N.reshape(len(x), math.prod(N.shape[1:-1]), x.shape[1])
    return (rows @ x).reshape(*N.shape[:-1], x.shape[2])


def turns(element: FacetElement, x: Floats) -> tuple[Floats, Floats]:
    """Normals n (m, d) of facets x (m, k, d), and g (m, k, d): dn = -sum_a g_a (n.dx_a).

    At the centre, by the vertices.
    """
    part = element.first
    xi = part.points[list(part.vertices)].mean(axis=0)
    corners = Facets(part, x[:, : part.nodes])
    which = np.arange(len(x), dtype=np.int32)
    g, n = surface_gradients(corners, which, np.broadcast_to(xi, (len(x), len(xi))))
    return n, np.pad(g, ((0, 0), (0, x.shape[1] - part.nodes), (0, 0)))


def height(N: Floats, Q: Floats, arcs: Floats) -> tuple[Floats, Floats, Floats]:
    """Heights N.Q N (s, q) of arcs (s, 2), and derivatives by N and the log chord length."""
    QN, curvature, square = N @ Q, arcs[:, None, 0], arcs[:, None, 1]
    h, left = (QN * N).sum(axis=2), 1.0 - square
    root, across = np.sqrt(square), np.sqrt(square + 2.0 * curvature * h)
    # curvature is c / L^2, left c / 4 times that
    rate = left / root + (left - 2.0 * curvature * h) / across
    both = root + across
    return 2.0 * h / both, 2.0 * QN / across[..., None], -2.0 * h / both**2 * rate


def create_points(
    slave: tuple[Floats, Floats, Floats],
    master: tuple[Floats, Floats],
    nodes: tuple[Floats, Floats],
    weight: Floats,
    given: tuple[Floats, Floats],
    tilts: tuple[Floats, Floats],
    heights: Sequence[Floats],
    spread: Floats | None = None,
) -> Points:
    """Points of pairs of facets.

    Args:
        slave: N, dN, ddN of `FacetElement.functions`.
        master: N and dN.
        nodes: (s, k, d) and (s, l, d).
        weight: (s, q) on the slave's reference facet.
        given: nodal weights (s, k); reach (s, 2) of `Segments`, or (s, 0).
        tilts: `turns` of the slave facets.
        heights: Q (s, k, k), (s, l, l) and arcs (s, 2, 2), or empty.
        spread: (s, l, m) the master's nodes among m.
    """
    (N, dN, ddN), (M, dM), (x, y), (factor, reach) = slave, master, nodes, given
    own, factor = (N, M), factor[:, :, None]
    T, U, apart = sums(dN, x), sums(dM, y), sums(M, y) - sums(N, x)
    dual, normal = dual_basis(T)
    scale = sums(N, factor)
    by_s = (dual[:, :, None] * sums(ddN, x)).sum(axis=(3, 4))
    by_s += sums(dN, factor)[..., 0] / np.where(scale > 0.0, scale, np.inf)  # on an axis
    weight = weight * scale[..., 0] * np.linalg.norm(normal, axis=2)
    h, by_N, by_chords = np.zeros(weight.shape), [np.zeros_like(N), np.zeros_like(M)], []
    for i, one in enumerate(own if heights[0].size else ()):
        rise, by_N[i], by_chord = height(one, heights[i], heights[2][:, i])
        h += rise
        by_chords.append(by_chord)
    if spread is not None:
        M, dM, by_N[1] = M @ spread, dM @ spread[:, None], by_N[1] @ spread
    by_m, by_x = np.zeros_like(by_s), np.swapaxes(dN, 2, 3) @ dual
    by_y = np.zeros((*M.shape, x.shape[2]))
    if reach.size:
        n, g = tilts
        part = 1.0 - reach[:, 1:] * ((apart @ n[:, :, None])[..., 0] - reach[:, :1])
        rate = -reach[:, 1:] / np.where((part > 0.0) & (part < 1.0), part, np.inf)
        fall, weight = rate[..., None] * n[:, None], weight * np.clip(part, 0.0, 1.0)
        by_s -= (T @ fall[..., None])[..., 0]
        by_m += (U @ fall[..., None])[..., 0]
        by_x -= (N + apart @ np.swapaxes(g, 1, 2))[..., None] * fall[:, :, None]
        by_y += M[..., None] * fall[:, :, None]
    f = np.concatenate([N, M, h[..., None]], axis=2)
    by_xi, by_nodes = np.concatenate([by_s, by_m], axis=2), np.concatenate([by_x, by_y], axis=2)
    by_both = np.concatenate(by_N, axis=2)
    return Points(N, dN, dM, f, by_both, T, U, apart, weight, by_xi, by_nodes, own, by_chords)


def whole(
    facets: Facets, xi: Floats, weights: Floats, phi: Floats, by_x: Floats
) -> tuple[Floats, Floats]:
    """Moments (p, k, k + 1) of whole facets below a tool, and derivatives (p, d k, k, k + 1).

    For weights (p, q) on the reference facet, distances phi (p, q) and derivatives (p, q, k, d) at
    xi; H = -int N_j phi.
    """
    N, dN, _ = (v[0] for v in facets.element.functions(xi[None]))
    dual, normal = dual_basis(dN @ facets.x[:, None])
    v = (weights * np.linalg.norm(normal, axis=2))[..., None] * N
    by_w = (np.swapaxes(dN, 1, 2) @ dual).reshape(*phi.shape, dN.shape[2] * dual.shape[3])
    f = np.concatenate([np.broadcast_to(N, v.shape), -phi[..., None]], axis=2)
    by_f = np.zeros((*by_w.shape, f.shape[2]))
    by_f[..., -1] = -by_x.reshape(by_w.shape)
    return products(v, f, by_w[..., None] * v[:, :, None], by_f)

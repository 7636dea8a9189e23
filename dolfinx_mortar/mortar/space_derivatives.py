# SPDX-License-Identifier: MIT
r"""Derivatives of contact forces and of weighted gaps in 3D, when both sides move.

As in `dolfinx_mortar.mortar.derivatives`, with which the definitions and the result are common; on
first-order facets. Facets are projected along their own mean normals, so that the averaged normals
n direct the tractions and the gaps alone. What belongs to the points of one pair is integrated by
compiled kernels, `dolfinx_mortar.geometry.facet_derivatives`; here the coefficients A' of the dual
functions Phi_j = 1/c + sum_b A'_jb N_b of a facet are added, which depend on all its pairs:

    dA = (diag(dd) - A dm) m^-1,      m_ab = int N_a N_b,      d_a = int N_a = sum_b m_ab.

On flat triangles that are covered without a free edge dA = 0, since dm is a multiple of m.
"""

from dataclasses import dataclass

import numpy as np
from scipy import sparse

import dolfinx
from dolfinx.common import timed
from dolfinx_mortar.arrays import Bools, Floats, Ints, Longs
from dolfinx_mortar.geometry.facet_derivatives import (
    PairIntegrals,
    PointHeights,
    Points,
    differentiate_pairs,
    place_on_edges,
)
from dolfinx_mortar.geometry.facets import Facets, facet_normals, points_of
from dolfinx_mortar.geometry.segments import Segments, are_facing
from dolfinx_mortar.geometry.tolerances import TINY
from dolfinx_mortar.mortar.derivatives import LEAST_MOMENT, Derivatives, Matrix, Tractions
from dolfinx_mortar.mortar.dual import sums_of_products
from dolfinx_mortar.mortar.operators import SmoothSides
from dolfinx_mortar.mortar.pair_heights import pair_heights
from dolfinx_mortar.mortar.pairing import Pairing, received_facets
from dolfinx_mortar.mortar.surface import coordinates, facets_at


@timed("~Mortar: derivatives")
def differentiate_in_space(
    pairing: Pairing,
    u: dolfinx.fem.Function,
    segments: Segments,
    keep: Bools,
    Phi: Floats,
    given: Tractions,
    smooth: SmoothSides | None = None,
) -> Derivatives:
    """Return the derivatives of forces and weighted gaps at X + u (collective).

    The arguments are those of `dolfinx_mortar.mortar.derivatives.differentiate`, of surfaces in 3D
    with first-order facets; smooth surfaces by themselves.
    """
    slave, master = pairing.slave, received_facets(pairing, u)
    facets, nodes = facets_at(slave, coordinates(slave, u)), slave.facets
    used, of = np.unique(segments.pair, return_inverse=True)
    pairs = np.ascontiguousarray(pairing.pairs[used])
    N_s, N_m = (
        side.element.shape_functions(xi)
        for side, xi in ((facets, segments.xi_s), (master, segments.xi_m))
    )
    m = sums_of_products(N_s * segments.weight[:, None], N_s, segments.slave, len(nodes))
    duals = _duals(m, keep[nodes])
    edges = place_on_edges(facets, master, pairs, _free_edges(pairing, facets, master, pairs))
    points = _joined(segments, of, edges)
    on_edges = _at(duals, keep[nodes], pairs[edges.pair, 0], facets, edges)
    Phi_all = np.concatenate([Phi, on_edges])
    sagittas, heights = None, None
    if smooth is not None:
        sagittas = pair_heights(pairing, used.astype(np.int32), u, smooth)
        heights = sagittas.at(points.pair, points.xi_s, points.xi_m)
    at_nodes = given.tractions[nodes], given.normals[nodes]
    found = differentiate_pairs(facets, master, pairs, points, Phi_all, *at_nodes, heights)
    gaps = found.gaps
    if sagittas is not None:
        gaps = gaps - sagittas.integrals(Phi, of.astype(np.int32), segments.xi_s, segments.xi_m)
    place = _Places(pairing, pairs, len(slave.nodes))
    own = _Own(segments, of, len(pairs), facets, master, N_s, N_m, Phi, heights)
    F, G = place.forces(found.forces), place.gaps(gaps)
    change = np.full(len(nodes), facets.element.bilinear)
    change[pairs[edges.pair, 0]] = True
    F_A, G_A, dA = _by_coefficients(place, own, duals, found, given, change[pairs[:, 0]])
    F_n, G_n = _by_normals(place, own, given)
    return Derivatives(F + F_A @ dA, F_n, G + G_A @ dA, G_n)


@dataclass(frozen=True, eq=False)
class _Duals:
    """Coefficients of the dual functions of facets, and their derivatives by the moments m."""

    A: Floats  # (f, k, k) A'
    slope: Floats  # (f, k, k, k, k) dA'_jb / dm_ac


def _duals(m: Floats, kept: Bools) -> _Duals:
    """Return the coefficients for moments (f, k, k) and the nodes (f, k) with a multiplier."""
    k, one = m.shape[1], np.eye(m.shape[1])
    both = kept[:, :, None] & kept[:, None, :]
    d = m.sum(axis=2) * kept
    size = np.maximum(np.trace(m, axis1=1, axis2=2), TINY)[:, None, None]
    whole = m * both + size * (~kept)[:, :, None] * one
    some = (np.linalg.det(whole / size) > LEAST_MOMENT) & (kept.sum(axis=1) > 1)
    inverse = np.linalg.inv(np.where(some[:, None, None], whole, one))
    inverse *= both & some[:, None, None]
    A = d[:, :, None] * inverse
    slope = np.einsum("ja,fjb,fj->fjba", one, inverse, kept)[..., None].repeat(k, axis=4)
    slope -= np.einsum("fja,fcb->fjbac", A, inverse)
    share = (kept / np.maximum(kept.sum(axis=1), 1)[:, None])[:, :, None]
    slope -= share[..., None, None] * slope.sum(axis=1, keepdims=True)
    return _Duals(A - share * A.sum(axis=1, keepdims=True), slope)


def _at(duals: _Duals, kept: Bools, facet: Ints, facets: Facets, points: Points) -> Floats:
    """Return the dual functions times weights (q, k) at points of facets (q,)."""
    N = facets.element.shape_functions(points.xi_s)
    share = kept / np.maximum(kept.sum(axis=1), 1)[:, None]
    values = share[facet] + np.einsum("qjb,qb->qj", duals.A[facet], N)
    return np.asarray(values * points.weight[:, None])


def _joined(segments: Segments, of: Longs, edges: Points) -> Points:
    """Return the points of the segments, then those on edges."""
    return Points(
        np.concatenate([of.astype(np.int64), edges.pair]),
        np.concatenate([segments.xi_s, edges.xi_s]),
        np.concatenate([segments.xi_m, edges.xi_m]),
        np.concatenate([segments.weight, edges.weight]),
        np.concatenate([np.zeros((len(of), 3)), edges.nu]),
    )


def _free_edges(pairing: Pairing, slave: Facets, master: Facets, pairs: Ints) -> Bools:
    """Return the edges (p, l) of master facets beyond which no other one faces the slave facet."""
    count = len(master.x)
    beside = _neighbours(pairing.master_facets)[pairs[:, 1]]
    s, m = pairing.pairs.T
    facing = are_facing(facet_normals(slave)[s][:, None], facet_normals(master)[m])
    known = (s.astype(np.int64) * count + m)[facing]
    asked = pairs[:, 0].astype(np.int64)[:, None] * count + beside
    return (beside < 0) | ~np.isin(asked, known)


def _neighbours(facets: Ints) -> Ints:
    """Return the facets (m, l) beyond the edges of facets, -1 where there is none.

    >>> _neighbours(np.array([[0, 1, 2], [2, 1, 3]], dtype=np.int32)).tolist()
    [[-1, 1, -1], [0, -1, -1]]
    """
    count, sides = facets.shape
    ends = np.stack([facets, np.roll(facets, -1, axis=1)], axis=2).reshape(-1, 2)
    low, high = ends.min(axis=1).astype(np.int64), ends.max(axis=1)
    key = low * (int(facets.max(initial=0)) + 1) + high
    order = np.argsort(key, kind="stable")
    same = np.flatnonzero(np.diff(key[order]) == 0)
    a, b = order[same], order[same + 1]
    result = np.full(count * sides, -1, dtype=np.int32)
    result[a], result[b] = b // sides, a // sides
    return result.reshape(count, sides)


class _Own:
    """Integrals over pairs (p,) that derivatives by tractions and coefficients need."""

    def __init__(
        self,
        segments: Segments,
        of: Longs,
        p: int,
        slave: Facets,
        master: Facets,
        N_s: Floats,
        N_m: Floats,
        Phi: Floats,
        heights: PointHeights | None,
    ) -> None:
        pair, wN = of.astype(np.int32), N_s * segments.weight[:, None]
        o = points_of(master, segments.master, segments.xi_m)
        o -= points_of(slave, segments.slave, segments.xi_s)
        self.D = sums_of_products(Phi, N_s, pair, p)  # (p, k, k) int Phi_j N_k
        self.M = sums_of_products(Phi, N_m, pair, p)  # (p, k, l) int Phi_j N_l
        self.v = sums_of_products(Phi, o, pair, p)  # (p, k, 3) int Phi_j o
        self.N_s = sums_of_products(wN, N_s, pair, p)  # (p, k, k) int N_a N_b
        self.N_m = sums_of_products(wN, N_m, pair, p)  # (p, k, l) int N_a N_l
        self.o = sums_of_products(wN, o, pair, p)  # (p, k, 3) int N_a o
        h = np.zeros((len(pair), 1)) if heights is None else heights.h[: len(pair), None]
        self.h = sums_of_products(wN, h, pair, p)  # (p, k, 1) int N_a h


class _Places:
    """Where the integrals over pairs stand in the matrices of a rank."""

    def __init__(self, pairing: Pairing, pairs: Ints, n: int) -> None:
        self.n, self.columns = n, 3 * (n + len(pairing.master_nodes))
        self.facet, self.facets = pairs[:, 0], pairing.slave.facets
        self.slave = self.facets[self.facet]
        both = [self.slave, n + pairing.master_facets[pairs[:, 1]]]
        self.nodes = np.concatenate(both, axis=1)  # (p, k + l)
        self.k = self.slave.shape[1]

    def sum(self, rows: Ints, columns: Ints, values: Floats, size: tuple[int, int]) -> Matrix:
        """Return the sums of values at rows and columns of their shape, or that broadcast to it."""
        where = (np.broadcast_to(v, values.shape).ravel() for v in (rows, columns))
        return Matrix(sparse.coo_array((values.ravel(), tuple(where)), shape=size).tocsr())

    @property
    def dofs(self) -> Ints:
        """Components (p, k + l, 3) of the nodes of pairs."""
        return 3 * self.nodes[:, :, None] + np.arange(3, dtype=np.int32)

    def forces(self, values: Floats) -> Matrix:
        """Return the sums of values (p, k + l, 3, k + l, 3)."""
        rows, columns = self.dofs[..., None, None], self.dofs[:, None, None]
        return self.sum(rows, columns, values, (self.columns, self.columns))

    def gaps(self, values: Floats) -> Matrix:
        """Return the sums of values (p, k, k + l, 3)."""
        rows, columns = self.slave[:, :, None, None], self.dofs[:, None]
        return self.sum(rows, columns, values, (self.n, self.columns))


def _by_coefficients(
    place: _Places,
    own: _Own,
    duals: _Duals,
    found: PairIntegrals,
    given: Tractions,
    which: Bools,
) -> tuple[Matrix, Matrix, Matrix]:
    """Return the derivatives of forces and gaps by A', and those of A' by the coordinates.

    Of some of the pairs (p,), those of the facets of which A' changes.
    """
    k, f, dofs, slave = place.k, place.facet[which], place.dofs[which], place.slave[which]
    slope = duals.slope[f].reshape(len(f), k * k, k * k)
    width = 3 * dofs.shape[1]
    dA = slope @ found.moments[which].reshape(len(f), k * k, width)
    item = k * k * f[:, None, None] + np.arange(k * k, dtype=np.int32).reshape(k, k)  # (p, j, b)
    c, n = (values[slave] for values in (given.tractions, given.normals))
    count = k * k * len(place.facets)
    by_A = np.concatenate([own.N_s, -own.N_m], axis=2)[which]  # (p, b, z)
    forces = np.einsum("pji,pbz->pzijb", c, by_A)
    F_A = place.sum(dofs[..., None, None], item[:, None, None], forces, (place.columns, count))
    gaps = np.einsum("pji,pbi->pjb", n, own.o[which]) - own.h[which][:, None, :, 0]
    G_A = place.sum(slave[:, :, None], item, gaps, (place.n, count))
    rows, columns = item.reshape(len(f), k * k, 1), dofs.reshape(len(f), 1, width)
    return F_A, G_A, place.sum(rows, columns, dA, (count, place.columns))


def _by_normals(place: _Places, own: _Own, given: Tractions) -> tuple[Matrix, Matrix]:
    """Return the derivatives of forces and gaps by the averaged normals."""
    xyz = np.arange(3, dtype=np.int32)
    at = 3 * place.slave[:, :, None] + xyz  # (p, j, 3)
    by_c = np.concatenate([own.D, -own.M], axis=2)  # (p, j, z)
    forces = np.einsum("pjz,pjih->pzijh", by_c, given.changes[place.slave])
    rows, columns = place.dofs[..., None, None], at[:, None, None]
    F_n = place.sum(rows, columns, forces, (place.columns, 3 * place.n))
    gaps = np.einsum("pji,pjih->pjh", own.v, given.turning[place.slave])
    return F_n, place.sum(place.slave[:, :, None], at, gaps, (place.n, 3 * place.n))

# SPDX-License-Identifier: MIT
r"""Derivatives of contact forces and of weighted gaps in 2D, when both sides move.

With the tractions c_j = lambda_j n_j (+ tau_j t_j) at the kept slave nodes, s = sum_j Phi_j c_j and
o = x_m - x_s, forces on nodes and weighted gaps are the sums over the points of all segments

    F_k = sum w s N_k (slave),   F_l = -sum w s N_l (master),   G_j = sum w (Phi_j n_j.o - Phi_j h).

Their derivatives are taken in two stages: with regard to the coordinates of both sides and to the
normals n (which direct the projection, the tractions and the gaps), and of the normals with regard
to the coordinates of the slave side, which may be another rank's. On a facet

    Phi_j = 1/c + sum_b A'_jb N_b,    A = diag(d) m^-1,   m_ab = sum w N_a N_b,   d_a = sum w N_a

over its c kept nodes, A' being A less its mean over the rows, see `mortar.duals`. So
dA m = diag(dd) - A dm, which is zero where w is constant and all of a straight facet is covered.
Beside open edges Phi is a mean of two such bases, whose shares change with the opening (`edges`).
At the points derivatives are those by the nodes of their own pair. Those of all segments are summed
in sparse matrices, of which the columns are, in this order, slave coordinates, normals, and the
coordinates of the received master nodes of this rank.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from typing import TypeAlias

import numpy as np
from scipy import sparse

import dolfinx
from dolfinx.common import timed
from dolfinx_mortar.algebra.block_sums import Blocks, Matrix
from dolfinx_mortar.arrays import QUARTER_OF_DIGITS, Bools, Floats, Ints
from dolfinx_mortar.geometry.facets import Facets, facet_normals, normal_slopes, points_of
from dolfinx_mortar.geometry.line_derivatives import PointDerivatives, differentiate_points
from dolfinx_mortar.geometry.segments import Segments
from dolfinx_mortar.mortar.curvature_correction import HeightSlopes
from dolfinx_mortar.mortar.duals import Duals, find_duals, weighted_duals
from dolfinx_mortar.mortar.edges import PartlyOpen, Sharing, find_partly_open
from dolfinx_mortar.mortar.integrals import some_points
from dolfinx_mortar.mortar.pairing import Pairing, received_facets
from dolfinx_mortar.mortar.surface import (
    coordinates,
    facets_at,
    nodal_normals,
)

Part: TypeAlias = Matrix | Blocks


@dataclass(frozen=True, eq=False)
class Tractions:
    """Constraint normals and tractions at the local slave nodes, as functions of the normals."""

    normals: Floats  # (n, 2) n_j of gaps; zero where no multiplier is carried
    turning: Floats  # (n, 2, 2) dn_j/dn of the normals n before Dirichlet data restrict them
    tractions: Floats  # (n, 2) c_j
    changes: Floats  # (n, 2, 2) dc_j/dn


@dataclass(frozen=True, eq=False)
class Derivatives:
    """Derivatives of the part of forces F and gaps G that this rank's slave facets have.

    Rows of F belong to the coordinates of the slave nodes, then of the received master nodes. Each
    is the sum of parts.
    """

    F_x: Sequence[Part]  # (d n + d nm, d n + d nm) by the coordinates of the same nodes
    F_n: Sequence[Part]  # (d n + d nm, d n) by the normals of contact
    G_x: Sequence[Part]  # (n, d n + d nm)
    G_n: Sequence[Part]  # (n, d n)
    F_p: Sequence[Part] = ()  # (d n + d nm, d n) by the averaged normals, the directions in 2D
    G_p: Sequence[Part] = ()  # (n, d n)
    b_x: Sequence[Part] = ()  # (d n, d n + d nm) of sum_l M_jl n_l with fixed n_l, in 2D
    b_p: Sequence[Part] = ()  # (d n, d n)


@dataclass(frozen=True, eq=False)
class _Field:
    """Values at points, with their derivatives in the order of `PointDerivatives`."""

    value: Floats  # (q,)
    d: Floats  # (q, p)

    def __add__(self, other: "_Field") -> "_Field":
        return _Field(self.value + other.value, self.d + other.d)

    def __mul__(self, other: "_Field") -> "_Field":
        d = other.value[:, None] * self.d + self.value[:, None] * other.d
        return _Field(self.value * other.value, d)


@dataclass(frozen=True, eq=False)
class _Side:
    """Shape functions of the facets of a side at the points, and derivatives of their places."""

    N: Floats  # (q, k)
    slopes: Floats  # (q, k) dN/dxi
    d_xi: Floats  # (q, p) derivatives of xi

    @property
    def k(self) -> int:
        """How many nodes a facet has."""
        return int(self.N.shape[1])


def _side(facets: Facets, xi: Floats, d_xi: Floats) -> _Side:
    """Return the functions of facets at xi (q, 1)."""
    functions = facets.element
    return _Side(functions.shape_functions(xi), functions.derivatives(xi)[:, :, 0], d_xi)


@timed("~Mortar: derivatives")
def differentiate(
    pairing: Pairing,
    u: dolfinx.fem.Function,
    segments: Segments,
    keep: Bools,
    Phi: Floats,
    given: Tractions,
    normals: Floats,
    slopes: HeightSlopes | None,
    sharing: Sharing | None = None,
) -> Derivatives:
    """Return the derivatives of forces and weighted gaps at X + u (collective).

    Args:
        pairing: The pair of surfaces, in 2D.
        segments: Its segments at X + u, of all slave facets or of some.
        keep: Local slave nodes (n,) that carry a multiplier.
        Phi: Their weighted functions (q, k) of `open_duals`.
        given: Normals and tractions.
        normals: Those of the received master nodes (nm, 2).
        slopes: Heights of smooth surfaces and their derivatives; None for facets.
        sharing: What is shared out beside edges; None without.
    """
    slave, master = pairing.slave, received_facets(pairing, u)
    x = coordinates(slave, u)
    facets, n_s = facets_at(slave, x), nodal_normals(slave, x)[slave.facets]
    points = differentiate_points(facets, n_s, master, segments, log_slopes(pairing, segments))
    chain = _Chain(segments, facets, master, points, given, slave.facets[segments.slave])
    A, slope = _coefficients(find_duals(pairing, segments, keep))
    if sharing is not None:
        whole = _coefficients(find_duals(pairing, segments, keep | sharing.silent))
        kept, closed = keep[slave.facets][:, :, None], sharing.closed[:, None, None]
        A = closed * A + (1.0 - closed) * kept * whole[0]
        closed, kept = closed[..., None], kept[..., None]
        slope = closed * slope + (1.0 - closed) * kept * whole[1]
    duals = chain.duals(A, Phi)
    F_x, F_A = chain.forces(duals)
    G_x, G_A = chain.gaps(duals, slopes)
    place = _Places(pairing, segments, len(x))
    dA = place.by_coefficients(slope, chain.moments())
    F = place.forces(F_x) + place.forces_by_coefficients(F_A) @ dA
    G = place.gaps(G_x) + place.gaps_by_coefficients(G_A) @ dA
    if sharing is not None:
        partly = find_partly_open(pairing, segments, u, sharing)
        heights = np.zeros(len(segments.slave)) if slopes is None else slopes.height
        F_c, G_c = by_closed_parts(pairing, u, segments, keep, sharing, given, heights)
        by_x = place.by_facets(chain.closed_parts(partly, facets), partly)
        F, G = F + F_c @ by_x, G + G_c @ by_x
    n, z = 2 * len(x), place.columns
    coordinate_columns, normal_columns = np.r_[0:n, 2 * n : z], np.arange(n, 2 * n)
    by_x, along = (
        [[Matrix(B)[:, c]] for B in (F, G)] for c in (coordinate_columns, normal_columns)
    )
    F_n, G_n = place.by_normals(*chain.by_normals(Phi))
    facing, by_A = chain.facing(duals, normals[pairing.master_facets][segments.master])
    b = place.facing(facing) + place.facing_by_coefficients(by_A) @ dA
    b_x, b_p = ([Matrix(b)[:, c]] for c in (coordinate_columns, normal_columns))
    return Derivatives(by_x[0], [F_n], by_x[1], [G_n], along[0], along[1], b_x, b_p)


def by_closed_parts(
    pairing: Pairing,
    u: dolfinx.fem.Function,
    segments: Segments,
    keep: Bools,
    sharing: Sharing,
    given: Tractions,
    heights: Floats,
) -> tuple[Matrix, Matrix]:
    """Return forces (d n + d nm, m) and weighted gaps (n, m) by the parts that facets share out.

    Collective. The arguments are those of `differentiate`, with the heights (q,) at the points.
    """
    slave, master, d = pairing.slave, received_facets(pairing, u), pairing.slave.X.shape[1]
    n, size = len(slave.nodes), (len(slave.nodes) + len(pairing.master_nodes), len(slave.facets))
    partly = (sharing.closed > 0.0) & (sharing.closed < 1.0)
    some = partly[segments.slave]
    segments, heights = some_points(segments, some), heights[some]
    s, m = segments.slave, segments.master
    own, other = slave.facets[s], n + pairing.master_facets[m]
    change = weighted_duals(pairing, segments, keep)
    change -= weighted_duals(pairing, segments, keep | sharing.silent) * keep[own]
    N = [
        side.element.shape_functions(xi)
        for side, xi in ((slave, segments.xi_s), (master, segments.xi_m))
    ]
    o = points_of(master, m, segments.xi_m)
    o -= points_of(facets_at(slave, coordinates(slave, u)), s, segments.xi_s)
    c, gap = (
        np.einsum("qj,qji->qi", change, given.tractions[own]),
        given.normals[own] @ o[:, :, None],
    )
    forces = np.hstack([N[0], -N[1]])[:, :, None] * c[:, None]
    rows = d * np.concatenate([own, other], axis=1)[:, :, None] + np.arange(d)
    F = summed(rows, s[:, None, None], forces, (d * size[0], size[1]))
    return F, summed(own, s[:, None], change * (gap[:, :, 0] - heights[:, None]), (n, size[1]))


def summed(rows: Ints, columns: Ints, values: Floats, size: tuple[int, int]) -> Matrix:
    """Return the sums of values at rows and columns that broadcast to their shape."""
    where = (np.broadcast_to(v, values.shape).ravel() for v in (rows, columns))
    return Matrix(sparse.coo_array((values.ravel(), tuple(where)), shape=size).tocsr())


def log_slopes(pairing: Pairing, segments: Segments) -> Floats:
    """Return the derivatives (q,) of ln f by xi_s for the weight f of a pairing, linear at X."""
    if pairing.weight is None:
        return np.zeros(len(segments.slave))
    at_X, weight = facets_at(pairing.slave, pairing.slave.X), pairing.weight
    N, dN = (f(segments.xi_s) for f in (at_X.element.shape_functions, at_X.element.derivatives))
    X = at_X.x[segments.slave]
    x, slope = np.einsum("qk,qki->qi", N, X), np.einsum("qk,qki->qi", dN[:, :, 0], X)
    step = QUARTER_OF_DIGITS * slope  # short: beyond the axis there is no weight
    difference = weight(x + step) - weight(x - step)
    return np.asarray(difference / (2 * QUARTER_OF_DIGITS * weight(x)))


def _coefficients(duals: Duals) -> tuple[Floats, Floats]:
    """Return A' (facets, k, k), and its derivative by d and m.

    The latter (facets, k, k, k + k^2) belongs to the k integrals d_a and the k^2 m_ac.
    """
    k, inverse, A = duals.kept.shape[1], duals.inverse, duals.A
    by_d = np.einsum("ja,fab->fjba", np.eye(k), inverse)
    by_m = -np.einsum("fjc,fab->fjbca", A, inverse).reshape(-1, k, k, k * k)
    return duals.share_out(A), duals.share_out(np.concatenate([by_d, by_m], axis=3))


class _Chain:
    """Derivatives at the points of segments, for the nodes of their own pairs.

    The coefficients A' of the dual functions depend on all segments of a facet: derivatives with
    regard to them are kept apart.
    """

    def __init__(
        self,
        segments: Segments,
        slave: Facets,
        master: Facets,
        points: PointDerivatives,
        given: Tractions,
        nodes: Ints,
    ) -> None:
        s, m = segments.slave, segments.master
        self.facet, self.count, self.nodes, self.given = s, len(slave.x), nodes, given
        self.w = _Field(segments.weight, points.weight)
        self.slave = _side(slave, segments.xi_s, points.xi_s)
        self.master = _side(master, segments.xi_m, points.xi_m)
        self.k, self.p = self.slave.k, points.weight.shape[1]
        self.offsets = [self._offset(i, slave.x[s], master.x[m]) for i in range(2)]

    def _offset(self, i: int, x: Floats, y: Floats) -> _Field:
        """Return component i of x_m - x_s."""
        sides = (self.slave, x[:, :, i]), (self.master, y[:, :, i])
        along_s, along_m = (
            np.einsum("qk,qk->q", side.slopes, v)[:, None] * side.d_xi for side, v in sides
        )
        d = along_m - along_s
        d[:, i : 2 * self.k : 2] -= self.slave.N
        d[:, 4 * self.k + i :: 2] += self.master.N
        x_s, x_m = (np.einsum("qk,qk->q", side.N, v) for side, v in sides)
        return _Field(x_m - x_s, d)

    def _nodal(self, values: Floats, j: int, i: int) -> _Field:
        """Return component i of fixed vectors at nodes (n, 2), at node j."""
        return _Field(values[self.nodes[:, j], i], np.zeros((len(self.facet), self.p)))

    def by_normals(self, Phi: Floats) -> tuple[Floats, Floats]:
        """Return the derivatives of forces (q, k + l, 2, k, 2) and gaps (q, k, 2) by normals n_j.

        Args:
            Phi: (q, k) weighted dual functions.
        """
        N, o = np.hstack([self.slave.N, -self.master.N]), [v.value for v in self.offsets]
        changes = np.moveaxis(Phi[:, :, None, None] * self.given.changes[self.nodes], 1, 2)
        turned = Phi[:, :, None, None] * self.given.turning[self.nodes]
        gaps = np.einsum("qi,qjih->qjh", np.stack(o, axis=1), turned)
        return N[:, :, None, None, None] * changes[:, None], gaps

    def moments(self) -> Floats:
        """Return the derivatives (q, k + k^2, p) of w N_a and w N_a N_c."""
        s = self.slave
        N = [_Field(s.N[:, b], s.slopes[:, b, None] * s.d_xi) for b in range(self.k)]
        first = [self.w * one for one in N]
        return np.stack([f.d for f in first] + [(f * one).d for f in first for one in N], axis=1)

    def duals(self, A: Floats, Phi: Floats) -> list[_Field]:
        """Return the dual functions of the nodes of the facets for given coefficients.

        Args:
            A: (facets, k, k) their coefficients.
            Phi: (q, k) their values times weights.
        """
        slopes = np.einsum("qjb,qb->qj", A[self.facet], self.slave.slopes)
        values = Phi / self.w.value[:, None]
        return [_Field(values[:, j], slopes[:, j, None] * self.slave.d_xi) for j in range(self.k)]

    def forces(self, duals: list[_Field]) -> tuple[Floats, Floats]:
        """Return the derivatives (q, k + l, 2, p) of the forces, and those by A' (.., k, k)."""
        c, s, m = self.given.tractions[self.nodes], self.slave, self.master
        N, dN = np.hstack([s.N, -m.N]), np.hstack([s.slopes, -m.slopes])
        d_xi = np.stack([s.d_xi] * s.k + [m.d_xi] * m.k, axis=1)
        by_x = []
        for i in range(2):
            terms = (dual * self._nodal(self.given.tractions, j, i) for j, dual in enumerate(duals))
            density = self.w * reduce(_Field.__add__, terms)
            along = (density.value[:, None] * dN)[:, :, None] * d_xi
            by_x.append(N[:, :, None] * density.d[:, None] + along)
        by_A = np.einsum("q,qji,qa,qb->qbija", self.w.value, c, s.N, N)
        return np.stack(by_x, axis=2), by_A

    def gaps(self, duals: list[_Field], slopes: HeightSlopes | None) -> tuple[Floats, Floats]:
        """Return the derivatives (q, k, p) of the weighted gaps, and those by A' (q, k, k).

        The latter of node j by A'_ja.
        """
        by_x, values = [], []
        for j, dual in enumerate(duals):
            parts = (self._nodal(self.given.normals, j, i) * self.offsets[i] for i in range(2))
            gap = self.w * reduce(_Field.__add__, parts, self._below(slopes))
            by_x.append((gap * dual).d)
            values.append(gap.value)
        return np.stack(by_x, axis=1), np.stack(values, axis=1)[:, :, None] * self.slave.N[:, None]

    def facing(self, duals: list[_Field], normals: Floats) -> tuple[Floats, Floats]:
        """Return those of sum_l M_jl n_l, (q, k, 2, p), and by A' (q, k, 2, k).

        Args:
            normals: n_l (q, l, 2), fixed.
        """
        found, values, side = [], [], self.master
        for n in np.moveaxis(normals, 2, 0):
            along = (side.slopes * n).sum(axis=1)[:, None] * side.d_xi
            density = self.w * _Field((side.N * n).sum(axis=1), along)
            found.append(np.stack([(density * dual).d for dual in duals], axis=1))
            values.append(density.value)
        by_A = np.stack(values, axis=1)[:, None, :, None] * self.slave.N[:, None, None]
        return np.stack(found, axis=2), np.repeat(by_A, self.k, axis=1)

    def closed_parts(self, partly: PartlyOpen, slave: Facets) -> Floats:
        """Return the derivatives (q, p) of the parts that slave facets share out, but by size."""
        place = np.full(self.count, -1)
        place[partly.facets] = np.arange(len(partly.facets))
        some = np.flatnonzero(place[self.facet] >= 0)
        at, s = place[self.facet[some]], self.slave
        f, j = self.facet[some], partly.node[at]
        n = facet_normals(slave[f])
        o = np.stack([offset.value[some] for offset in self.offsets], axis=1)
        moved = np.stack([offset.d[some] for offset in self.offsets], axis=1)
        d_gap = (n[:, None] @ moved)[:, 0]
        turned = np.einsum("qi,qkih->qkh", o, normal_slopes(slave[f]))
        d_gap[:, : 2 * s.k] += turned.reshape(len(some), 2 * s.k)
        gap = _Field((o * n).sum(axis=1) - partly.opening[at], d_gap)
        N, slope = s.N[some, j], s.slopes[some, j]
        N_j = _Field(np.maximum(N, 0.0), np.where(N > 0.0, slope, 0.0)[:, None] * s.d_xi[some])
        found = np.zeros((len(self.facet), self.p))
        w = _Field(self.w.value[some], self.w.d[some])
        found[some] = partly.by_moment[at, None] * (w * N_j * gap).d
        return found

    def _below(self, slopes: HeightSlopes | None) -> _Field:
        """Return minus the heights, 0 for facets."""
        q = len(self.facet)
        if slopes is None:
            return _Field(np.zeros(q), np.zeros((q, self.p)))
        d = slopes.by_xi_s[:, None] * self.slave.d_xi + slopes.by_xi_m[:, None] * self.master.d_xi
        d[:, : 2 * self.k] += slopes.by_x_s.reshape(q, 2 * self.k)
        d[:, 4 * self.k :] += slopes.by_x_m.reshape(q, self.p - 4 * self.k)
        return _Field(-slopes.height, -d)


class _Places:
    """Where the values at points stand in the matrices of a rank."""

    def __init__(self, pairing: Pairing, segments: Segments, n: int) -> None:
        xy, self.n = np.arange(2), n
        self.slave, self.facet = pairing.slave.facets[segments.slave], segments.slave
        self.master = pairing.master_facets[segments.master]
        self.columns = 4 * n + 2 * len(pairing.master_nodes)
        self.facets, self.k = pairing.slave.facets, self.slave.shape[1]
        self.count = len(self.facets)
        q, x_s = len(self.slave), 2 * self.slave[:, :, None] + xy
        x_m = 2 * self.master[:, :, None] + xy
        parts = x_s, 2 * n + x_s, 4 * n + x_m
        self.stencil = np.concatenate(
            [part.reshape(q, 2 * part.shape[1]) for part in parts], axis=1
        )
        self.force_rows = np.concatenate([x_s, 2 * n + x_m], axis=1)
        items = np.arange(self.k**2).reshape(self.k, self.k)
        self.coefficients = self.k**2 * self.facet[:, None, None] + items

    def by_facets(self, values: Floats, partly: PartlyOpen) -> Matrix:
        """Return the sums (m, columns) of values (q, p) of facets, with those by their size."""
        size = self.count, self.columns
        own = 2 * self.facets[partly.facets][:, :, None] + np.arange(2)
        by_size = summed(partly.facets[:, None, None], own, partly.by_x, size)
        return Matrix(by_size + summed(self.facet[:, None], self.stencil, values, size))

    def forces(self, values: Floats) -> Matrix:
        """Return the sums of values (q, k + l, 2, p)."""
        rows, columns = self.force_rows[..., None], self.stencil[:, None, None]
        return summed(rows, columns, values, (self.columns - 2 * self.n, self.columns))

    def gaps(self, values: Floats) -> Matrix:
        """Return the sums of values (q, k, p)."""
        where = self.slave[..., None], self.stencil[:, None]
        return summed(*where, values, (self.n, self.columns))

    def by_normals(self, forces: Floats, gaps: Floats) -> tuple[Matrix, Matrix]:
        """Return the sums of `_Chain.by_normals`."""
        columns, size = 2 * self.slave[:, :, None] + np.arange(2), 2 * self.n
        rows, of_forces = self.force_rows[..., None, None], (self.columns - 2 * self.n, size)
        return (
            summed(rows, columns[:, None, None], forces, of_forces),
            summed(self.slave[:, :, None], columns, gaps, (self.n, size)),
        )

    def facing(self, values: Floats) -> Matrix:
        """Return the sums of values (q, k, 2, p)."""
        rows, columns = self.force_rows[:, : self.k, :, None], self.stencil[:, None, None]
        return summed(rows, columns, values, (2 * self.n, self.columns))

    def facing_by_coefficients(self, values: Floats) -> Matrix:
        """Return the sums of values (q, k, 2, k)."""
        rows, columns = self.force_rows[:, : self.k, :, None], self.coefficients[:, :, None]
        return summed(rows, columns, values, (2 * self.n, self.k**2 * self.count))

    def forces_by_coefficients(self, values: Floats) -> Matrix:
        """Return the sums of values (q, k + l, 2, k, k)."""
        rows, columns = self.force_rows[..., None, None], self.coefficients[:, None, None]
        return summed(rows, columns, values, (self.columns - 2 * self.n, self.k**2 * self.count))

    def gaps_by_coefficients(self, values: Floats) -> Matrix:
        """Return the sums of values (q, k, k)."""
        where = self.slave[..., None], self.coefficients
        return summed(*where, values, (self.n, self.k**2 * self.count))

    def by_coefficients(self, slope: Floats, moments: Floats) -> Matrix:
        """Return the derivatives of A' on all facets.

        Args:
            slope: (facets, k, k, i) by the integrals d and m.
            moments: (q, i, p) derivatives of these at the points.
        """
        i, f = moments.shape[1], np.arange(self.count)[:, None, None]
        rows = i * self.facet[:, None, None] + np.arange(i)[:, None]
        integrals = summed(rows, self.stencil[:, None], moments, (i * self.count, self.columns))
        entry = self.k**2 * f + np.arange(self.k**2)[:, None]
        slope = slope.reshape(self.count, self.k**2, i)
        size = self.k**2 * self.count, i * self.count
        return Matrix(summed(entry, i * f + np.arange(i), slope, size) @ integrals)

# SPDX-License-Identifier: MIT
"""Dual functions of the Lagrange multiplier, and the slave nodes with a multiplier.

Phi = D m^-1 N (eq. 20), D = diag(int_G N_j), m = int_G N N^T over the covered part G of each facet.
m, almost singular at little coverage, is not formed: with sqrt(w) N = Q R, sqrt(w) Phi = Q R^-T D
and m^-1 = R^-1 R^-T; if a diagonal entry of R is round-off, all functions of the facet are equal.

1 - sum_j Phi_j over the nodes with a multiplier, orthogonal to their N_j, is added to these in
equal parts: constants remain (theory.md, Partly covered facets).

Vertex functions of six-node triangles integrate to zero. So Phi is biorthogonal to N~ (after Popp,
Wohlmuth, Gee and Wall, SIAM J. Sci. Comput. 34, 2012, whose 1 / 5 loses half an order in ties),

    N~_v = N_v + alpha sum_m N_m,      N~_m = (1 - 2 alpha) N_m,      alpha = 1 / 12,

and D_mv = -alpha D_mm at both ends of an edge, unless the mid-side node has no multiplier.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np

from dolfinx.common import timed
from dolfinx_mortar.algebra.parallel import any_rank
from dolfinx_mortar.common.arrays import (
    HALF_OF_DIGITS,
    QUARTER_OF_DIGITS,
    TINY,
    Bools,
    Floats,
    Ints,
    Longs,
)
from dolfinx_mortar.geometry.facets import facet_sizes
from dolfinx_mortar.geometry.segments import Segments
from dolfinx_mortar.geometry.tolerances import ROUND_OFF
from dolfinx_mortar.mortar.integrals import (
    SUMS,
    Integrated,
    add,
    integrate_values,
    product,
    sums_of_values,
)
from dolfinx_mortar.mortar.surface import accumulate, sum_at_nodes

LEAST_COVERAGE = 0.05
"""A slave node carries a multiplier if more than this part of its tributary weight is covered.

Under the edges of punches, pressures are at most twice those beside them with 0.025 to 0.1, five
times with 0.005 and 80 times with 1e-5; forces differ by up to 0.5 % in 2D, 2 % in 3D.
"""
LEAST_WEIGHT = 0.01
"""Least weight of a node, as part of the area of its facets: 1/36 or more on straight facets,
phi^2/120 on an axis where a facet bends by an angle phi."""

ALPHA = 1 / 12
"""Share of a mid-side function that is added to each end of its edge: int (x - x_v) N~_v = 0.

With the area A and the edges d_1, d_2 at v, int N_v = 0, int (x - x_v) N_v = -A/60 (d_1 + d_2), and
int (x - x_v) sum_m N_m = A/5 (d_1 + d_2) of the two mid-side functions.
"""


def absorbed(
    shares: Sequence[tuple[int, int, int]], values: Floats, kept: Bools | None = None
) -> Floats:
    """N~ (q, k) for values N (q, k), or integrals, of the slave shape functions.

    Args:
        shares: of the FacetElement.
        kept: (q, k) nodes with a multiplier; all if None.

    Example:
        >>> 12 * absorbed([(2, 0, 1)], np.array([[0.0, 0.0, 1.0]])).round(12)
        array([[ 1.,  1., 10.]])
    """
    if not shares:
        return values
    kept = np.ones(values.shape, dtype=bool) if kept is None else kept
    return (absorbing(shares, kept) @ values[:, :, None])[:, :, 0]


def absorbing(shares: Sequence[tuple[int, int, int]], kept: Bools) -> Floats:
    """T (m, k, k) with N~ = T N on facets, for nodes (m, k) with multipliers."""
    T = np.repeat(np.eye(kept.shape[1])[None], len(kept), axis=0)
    for middle, *ends in shares:
        part = ALPHA * kept[:, middle]
        T[:, ends, middle] = part[:, None]
        T[:, middle, middle] -= 2 * part
    return T


@numba.njit(**SUMS)
def _biorthogonalise(Q, roots, Phi, inverse):  # type: ignore[no-untyped-def]
    """Fill Phi, biorthogonal to N of Q = (sqrt(w) N, I), and m^-1 if accurate, unless dependent.

    Q becomes (Q, z) with Q = z sqrt(w) N and m^-1 = z^T z, row by row.
    """
    (k, n), least, D = Phi.shape, 1.0, np.empty(len(Q))
    for j in range(k):
        row = Q[j, :n]
        length, D[j] = np.sqrt(product(row, row)), product(roots, row)
        for _ in range(2):  # the second pass is accurate to round-off
            for i in range(j):
                add(-product(Q[i, :n], row), Q[i], Q[j])
        size = np.sqrt(product(row, row))
        if size <= ROUND_OFF * length:
            return
        least = min(least, size / length)
        for q in range(n + k):
            Q[j, q] /= size
    for j in range(k):
        for i in range(j, k):
            add(D[j] * Q[i, n + j], Q[i, :n], Phi[j])
            if least > QUARTER_OF_DIGITS:
                add(Q[i, n + j], Q[i, n:], inverse[j])
        for q in range(n):
            Phi[j, q] /= roots[q]


@numba.njit(**SUMS)
def _all_duals(N, weight, slave, keep):  # type: ignore[no-untyped-def]
    """Phi (k, q) and m^-1 (m, k, k) of kept nodes; points ordered by facet."""
    Phi, inverse = np.zeros(N.shape), np.zeros((len(keep), len(N), len(N)))
    last = np.int64(0)  # literals have another type: compiled twice
    while last < len(slave):
        first, s = last, slave[last]
        while last < len(slave) and slave[last] == s:
            last += 1
        roots, which = np.sqrt(weight[first:last]), np.flatnonzero(keep[s])
        n, k = len(roots), len(which)
        Q, found, among = np.zeros((k, n + k)), np.zeros((k, n)), np.zeros((k, k))
        for j in range(k):
            Q[j, n + j] = 1.0
            for q in range(n):
                Q[j, q] = roots[q] * N[which[j], first + q]
        _biorthogonalise(Q, roots, found, among)
        missing = np.full(n, 1.0 / max(k, 1))
        for j in range(k):
            add(-1.0 / k, found[j], missing)
        for j in range(k):
            for q in range(n):
                Phi[which[j], first + q] = found[j, q] + missing[q]
        for j in range(k):
            for i in range(k):
                inverse[s, which[i], which[j]] = among[i, j]
    return Phi, inverse


class Duals(NamedTuple):
    """Dual functions of slave facets (m,).

    Phi_j = sum_b A_jb N~_b + (1 - sum_ib A_ib N~_b) / count over the kept nodes of a facet, A =
    diag(d) m^-1, d = int N~, m = int N~ N~^T.
    """

    Phi: Floats  # (q, k) at the points
    kept: Bools  # (m, k) nodes with a multiplier
    inverse: Floats  # (m, k, k) m^-1, 0 for others, and where inaccurate

    def of(self, facets: Longs) -> "Duals":
        """Data of some facets."""
        return Duals(self.Phi, self.kept[facets], self.inverse[facets])


def create_duals(N: Floats, weight: Floats, slave: Ints, kept: Bools) -> Duals:
    """Return the dual functions Phi (eq. 20) of slave facets.

    sum_q w Phi_i N_j = delta_ij sum_q w N_j for i and j kept; the kept ones of a facet add up to
    one, others are zero.

    Args:
        N: (q, k) values N~.
        weight: (q,) positive.
        slave: (q,) facet of each point, ascending.
        kept: (m, k) nodes with a multiplier.
    """
    Phi, inverse = _all_duals(np.ascontiguousarray(N.T), weight, slave, kept)
    return Duals(Phi.T, kept, inverse)


@timed("~Mortar: node weights")
def node_weights(
    pairing: Integrated, segments: Segments, keep: Bools | None = None
) -> tuple[Floats, Floats]:
    """Int N~_j (n,) over the covered part, and over the whole slave side (collective).

    The former is D_jj if all nodes have a multiplier and N~ is N.
    """
    slave = pairing.slave
    shares, kept = slave.element.shares, None if keep is None else keep[slave.facets]
    at = segments.weight, segments.slave, len(slave.facets)
    covered = sums_of_values(segments.N, *at)
    covered, whole = (absorbed(shares, v, kept) for v in (covered, segments.facet_weights))
    both = sum_at_nodes(slave, np.stack([covered, whole], axis=2))
    return both[:, 0], both[:, 1]


@dataclass(frozen=True)
class Coverage:
    """Coverage of the owned slave nodes by the master."""

    share: Floats  # (n,) covered share of the tributary weight
    reached: Bools  # (n,) on a partly covered facet
    weightless: Bools  # (n,) without tributary weight: no multiplier
    near: Bools | None = None  # (n,) of a tool: within its reach

    @property
    def faces(self) -> Bools:
        """Nodes (n,) with enough coverage for a multiplier."""
        return (self.share > LEAST_COVERAGE) & (True if self.near is None else self.near)


def find_coverage(
    pairing: Integrated, segments: Segments, covered: Floats, tributary: Floats
) -> Coverage:
    """Coverage of the owned slave nodes."""
    slave = pairing.slave
    nodes = slave.facets[segments.covered].ravel()
    reached = accumulate(slave, np.bincount(nodes, minlength=len(slave.nodes))) > 0
    own, (none, facets) = slice(None, slave.owned), _find_weightless(pairing, segments)
    share = np.where(none, facets, covered / np.where(none, 1.0, tributary))
    return Coverage(share[own], reached[own], none[own])


def _find_weightless(pairing: Integrated, segments: Segments) -> tuple[Bools, Floats]:
    """Slave nodes without weight (on an axis), and the coverage of their facets."""
    slave = pairing.slave
    if slave.element.degree == 1:  # positive functions
        return np.zeros(len(slave.nodes), dtype=bool), np.zeros(len(slave.nodes))
    whole = absorbed(slave.element.shares, segments.facet_weights)
    covered = np.bincount(segments.slave, segments.weight, minlength=len(whole))
    sizes = np.repeat(np.stack([whole.sum(axis=1), covered], axis=1)[:, None], whole.shape[1], 1)
    sums = sum_at_nodes(slave, np.concatenate([whole[:, :, None], sizes], axis=2))
    none = sums[:, 0] <= LEAST_WEIGHT * sums[:, 1]
    return none, sums[:, 2] / np.maximum(sums[:, 1], TINY)


def default_keep(
    pairing: Integrated,
    segments: Segments,
    covered: Floats,
    tributary: Floats,
    allowed: Bools | None = None,
) -> Bools:
    """Slave nodes (n,) that may have a multiplier, the same on any ranks (collective).

    With more coverage than `LEAST_COVERAGE`, or the best `allowed` node of a covered facet.
    """
    allowed = np.ones(len(covered), dtype=bool) if allowed is None else allowed
    none, _ = _find_weightless(pairing, segments)
    coverage = np.where(allowed & ~none, covered, 0.0) / np.where(none, 1.0, tributary)
    keep = coverage > LEAST_COVERAGE
    if pairing.slave.element.shares:  # vertices need mid-side nodes that share
        left = node_weights(pairing, segments, keep)[0] / np.where(none, 1.0, tributary)
        coverage = np.where(left > HALF_OF_DIGITS * coverage, coverage, 0.0)
        keep &= left > LEAST_COVERAGE
    facets = pairing.slave.facets[segments.covered]
    facets = facets[~keep[facets].any(axis=1) & (coverage[facets] > 0).any(axis=1)]
    rescued = np.zeros(len(covered))
    if len(facets):
        best = _best_nodes(coverage[facets], pairing.slave.X[facets])
        rescued[facets[np.arange(len(facets)), best]] = 1.0
    return keep | (accumulate(pairing.slave, rescued) > 0)


def choose_duals(
    pairing: Integrated,
    segments: Segments,
    weights: tuple[Floats, Floats],
    allowed: Bools,
) -> tuple[Bools, Floats]:
    """Slave nodes (n,) with a multiplier, and w Phi_j (q, k) (collective).

    Nodes of `default_keep` with int Phi_j > 0, the force of a unit pressure; chosen again without
    the others.
    """
    while True:  # with fewer nodes each time
        keep = default_keep(pairing, segments, *weights, allowed)
        Phi = weighted_duals(pairing, segments, keep)
        force = integrate_values(pairing, segments, Phi, np.ones((len(Phi), 1)))[:, 0]
        pulls = keep & (force <= LEAST_COVERAGE * weights[0])
        if not any_rank(pairing.slave.V.mesh.comm, pulls.any())[0]:
            return keep, Phi
        allowed = allowed & ~pulls


def _best_nodes(coverage: Floats, X: Floats) -> Ints:
    """Best covered node of each facet, of equal ones the last by x, y, z."""
    best = coverage >= (1 - HALF_OF_DIGITS) * coverage.max(axis=1, initial=0.0)[:, None]
    size = facet_sizes(X)
    for x in np.moveaxis(X, 2, 0):
        furthest = np.where(best, x, -np.inf).max(axis=1, initial=-np.inf)
        best &= x >= (furthest - HALF_OF_DIGITS * size)[:, None]
    return np.asarray(np.argmax(best, axis=1), dtype=np.int32)


def find_duals(pairing: Integrated, segments: Segments, keep: Bools) -> Duals:
    """Dual functions at the points; `keep` (n,) is equal on all ranks."""
    element, kept = pairing.slave.element, keep[pairing.slave.facets]
    N = absorbed(element.shares, segments.N, kept[segments.slave])
    return create_duals(N, segments.weight, segments.slave, kept)


def weighted_duals(pairing: Integrated, segments: Segments, keep: Bools) -> Floats:
    """Return w Phi_j (q, k) at the points."""
    return find_duals(pairing, segments, keep).Phi * segments.weight[:, None]

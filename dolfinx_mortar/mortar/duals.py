# SPDX-License-Identifier: MIT
r"""Dual functions of the multiplier, and which slave nodes carry one.

The dual basis functions are biorthogonal over the covered part of each facet. On one facet with
the covered part G, Phi = A N with A = D m^-1, D = diag(int_G N_j) and m = int_G N N^T, so that
int_G Phi_i N_j = delta_ij int_G N_j and sum_j Phi_j = 1. m is as good as singular when little of
the facet is covered, so it is never formed: with the weights w and sqrt(w) N = Q R it follows that
sqrt(w) Phi = Q R^-T D and m^-1 = R^-1 R^-T. Where a diagonal entry of R is round-off of its column,
nothing but round-off is covered, and the functions of the nodes are equal. Where m^-1 has lost its
digits, derivatives take the functions as they are. All that values and derivatives need to know of
a facet is in `Duals`.

These are the Phi_j of the paper's eq. 20, and what makes D of eq. 19 diagonal. The closed form
given there, (1 -+ 3 xi) / 2, is that of a straight facet with two nodes, all of it covered.

Not every node keeps its function: too little of it may be covered, or its integral may be negative,
as that of a second-order vertex function is over the far part of its facet. Then the functions of
the kept nodes are biorthogonal among themselves, Phi_i = sum_j A_ij N_j over these nodes only, and
what their sum misses of 1, which is orthogonal to all N_j kept, is shared out to them in equal
parts. So constants stay in the space of multipliers and D stays diagonal over the kept nodes,
however little is covered, and of a three-node facet none exceeds 4 where the vertex beyond is
removed. (To share out removed functions of the whole basis has the same properties, but its
functions grow as the inverse of the covered part: 21 at a fifth, 700 at a hundredth.)

Vertex functions of six-node triangles integrate to zero, so D would be singular. So a share of the
mid-side functions is added to them (Popp, Wohlmuth, Gee and Wall, SIAM J. Sci. Comput. 34, 2012),

    N~_v = N_v + alpha sum_m N_m,      N~_m = (1 - 2 alpha) N_m,      alpha = 1 / 12,

and Phi is biorthogonal to N~. For the displacement's own functions that leaves D_vv and D_mm on the
diagonal, and D_mv = -alpha D_mm at the two ends of an edge: mid-side nodes depend on their ends.
The function of a mid-side node without multiplier is not added, so that no vertex depends on
another one.

With alpha = 1/12 the centroid of N~_v is the vertex, on every flat facet by itself, as for the
other facets, where the centroids of functions are their nodes; that of N~_m lies a fifth of the way
to the opposite vertex whatever alpha is, on each side of the edge. So linear functions are nearly,
not quite in the space. Ties of blocks of tetrahedra, the coarser side as slave, have the orders 3.0
and 1.98 in L2 and H1 (jittered 2.9 and 1.86); with the 1/5 of that paper 2.54 and 1.54, which is
what constants alone give, and an error 1.5 times as large. Pressures of a ball on a block, eight
facets across the contact radius, differ from Hertz' by 1.0 % (rms over the inner 0.7 of the
radius), with 1/5 by 0.7 %; forces are the same to 5e-4.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np

from dolfinx.common import timed
from dolfinx_mortar.algebra.parallel import any_rank
from dolfinx_mortar.arrays import (
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
    covered_weights,
    integrate_values,
    product,
)
from dolfinx_mortar.mortar.surface import accumulate, sum_at_nodes

LEAST_COVERAGE = 0.05
"""A slave node carries a multiplier if more than this part of its tributary weight is covered.

The pressure shown there is a force over what is covered. Under punches whose edges are anywhere in
a facet (2D, hexahedra, tetrahedra) 1e-5 shows up to 80 times the pressure beside it, 0.005 five
times, 0.025 to 0.1 at most twice. From 1e-5 to 0.1 forces differ by up to 0.5 % in 2D, 2 % in 3D,
and iterations by two.
"""
LEAST_WEIGHT = 0.01
"""A node has a weight if it is more than this part of the area of its facets: those of straight
facets have 1/36 or more, those on an axis phi^2/120, phi being the angle by which a facet bends."""

ALPHA = 1 / 12
"""Share of a mid-side function that is added to each end of its edge: int (x - x_v) N~_v = 0.

With the area A and the edges d_1, d_2 at v, int N_v = 0, int (x - x_v) N_v = -A/60 (d_1 + d_2), and
int (x - x_v) sum_m N_m = A/5 (d_1 + d_2) of the two mid-side functions.
"""


def absorbed(
    shares: Sequence[tuple[int, int, int]], values: Floats, kept: Bools | None = None
) -> Floats:
    """Return N~ (q, k) for values N (q, k) of the slave shape functions, or of their integrals.

    Args:
        shares: of the FacetElement: mid-side nodes and the two ends of their edges.
        values: N.
        kept: (q, k) whether the nodes have multipliers; all if not given.

    Example:
        >>> 12 * absorbed([(2, 0, 1)], np.array([[0.0, 0.0, 1.0]])).round(12)
        array([[ 1.,  1., 10.]])
    """
    if not shares:
        return values
    result = np.copy(values)  # in the same layout
    for middle, *ends in shares:
        part = ALPHA * values[:, middle] * (1.0 if kept is None else kept[:, middle])
        for end in ends:
            result[:, end] += part
        result[:, middle] -= 2 * part
    return result


def absorbing(shares: Sequence[tuple[int, int, int]], kept: Bools) -> Floats:
    """Return T (m, k, k) with N~ = T N on facets of which nodes (m, k) have multipliers."""
    T = np.repeat(np.eye(kept.shape[1])[None], len(kept), axis=0)
    for middle, *ends in shares:
        part = ALPHA * kept[:, middle]
        T[:, ends, middle] = part[:, None]
        T[:, middle, middle] -= 2 * part
    return T


@numba.njit(**SUMS)
def _orthonormalise(Q, R):  # type: ignore[no-untyped-def]
    """Replace the rows of Q (k, q) by those of Q^T with Q R; return the least R_jj / |row j|.

    It is 0 if the rows are dependent.
    """
    least = 1.0
    for j in range(len(Q)):
        length = np.sqrt(product(Q[j], Q[j]))
        for _ in range(2):  # the second pass makes Q orthogonal to round-off
            for i in range(j):
                r = product(Q[i], Q[j])
                R[i, j] += r
                add(-r, Q[i], Q[j])
        R[j, j] = np.sqrt(product(Q[j], Q[j]))
        if R[j, j] <= ROUND_OFF * length:
            return 0.0
        least = min(least, R[j, j] / length)
        for q in range(Q.shape[1]):
            Q[j, q] /= R[j, j]
    return least


@numba.njit(**SUMS)
def _biorthogonalise(Q, roots, Phi, inverse):  # type: ignore[no-untyped-def]
    """Fill Phi (k, q), biorthogonal to sqrt(w) N = Q, which is lost, and m^-1 (k, k); both are 0.

    The roots are sqrt(w) (q,). m^-1 stays 0 where it has lost its digits.
    """
    k = len(Q)
    R, D, z = np.zeros((k, k)), np.empty(k), np.zeros((k, k))
    for j in range(k):
        D[j] = product(roots, Q[j])
    least = _orthonormalise(Q, R)
    if least == 0.0:
        return False
    for j in range(k):
        for i in range(j, k):  # R^T z = e_j
            z[j, i] = 1.0 if i == j else 0.0
            for h in range(j, i):
                z[j, i] -= R[h, i] * z[j, h]
            z[j, i] /= R[i, i]
            add(D[j] * z[j, i], Q[i], Phi[j])
        for q in range(len(roots)):
            Phi[j, q] /= roots[q]
        for i in range(j + 1 if least > QUARTER_OF_DIGITS else 0):
            inverse[i, j] = inverse[j, i] = product(z[i], z[j])
    return True


@numba.njit(**SUMS)
def _facet_dual(N, weight, kept, count, first, last, Phi, inverse):  # type: ignore[no-untyped-def]
    """Fill the functions (k, q) of one facet, of the `count` nodes kept, and m^-1 (k, k)."""
    Q, found = np.empty((count, last - first)), np.zeros((count, last - first))
    roots, which = np.sqrt(weight[first:last]), np.flatnonzero(kept)
    among = np.zeros((count, count))
    for j in range(count):
        values = N[which[j], first:last]
        for q in range(len(roots)):
            Q[j, q] = roots[q] * values[q]
    if _biorthogonalise(Q, roots, found, among):
        for j in range(count):
            for i in range(count):
                inverse[which[i], which[j]] = among[i, j]
    missing = np.full(len(roots), 1.0 / count)
    for j in range(count):
        add(-1.0 / count, found[j], missing)
    for j in range(count):
        values = Phi[which[j], first:last]
        for q in range(len(missing)):
            values[q] = found[j, q] + missing[q]


@numba.njit(**SUMS)
def _all_duals(N, weight, slave, keep):  # type: ignore[no-untyped-def]
    """Return Phi (k, q) of the kept nodes and m^-1 (m, k, k); points are ordered by facet."""
    Phi, inverse = np.zeros(N.shape), np.zeros((len(keep), len(N), len(N)))
    a = np.int64(0)  # a literal 0 has a type of its own, also below: compiled twice
    while a < len(slave):
        b = a
        while b < len(slave) and slave[b] == slave[a]:
            b += 1
        kept = keep[slave[a]]
        count = np.int64(0)
        for j in range(len(kept)):
            count += kept[j]
        if count == 1:  # exact, and the only way where almost nothing is covered
            for j in range(len(kept)):
                for q in range(a, b):
                    Phi[j, q] = kept[j]
        elif count > 1:
            _facet_dual(N, weight, kept, count, a, b, Phi, inverse[slave[a]])
        a = b
    return Phi, inverse


@dataclass(frozen=True, eq=False)
class Duals:
    """Dual functions of slave facets (m,), and what they depend on.

    Phi_j = sum_b A_jb N~_b + (1 - sum_ib A_ib N~_b) / count over the kept nodes of a facet, with
    A = diag(d) m^-1, d = int N~ and m = int N~ N~^T; N~ is that of `absorbed`.
    """

    Phi: Floats  # (q, k) at the points
    kept: Bools  # (m, k) nodes with a multiplier
    inverse: Floats  # (m, k, k) m^-1, 0 for other nodes, and where it has lost its digits

    def of(self, facets: Longs) -> "Duals":
        """Return those of some facets, at all points."""
        return Duals(self.Phi, self.kept[facets], self.inverse[facets])


def create_duals(N: Floats, weight: Floats, slave: Ints, kept: Bools) -> Duals:
    """Return the dual functions Phi (eq. 20) of slave facets.

    The function of a node that cannot carry a multiplier is zero; those of the kept nodes of the
    facet add up to one all the same, so that constants stay in the space of multipliers. Where a
    facet has no kept node, all functions vanish.

    Args:
        N: Values N~ (q, k) of the slave shape functions, see `absorbed`.
        weight: Positive weights (q,) of the quadrature points.
        slave: Slave facet (q,) of each point, ascending.
        kept: For each slave facet and node (m, k), whether the node carries a multiplier.

    Returns:
        Phi with sum_q weight Phi_i N_j = delta_ij sum_q weight N_j for i and j kept.
    """
    columns, weight = np.ascontiguousarray(N.T), np.ascontiguousarray(weight)
    at = np.ascontiguousarray(slave), np.ascontiguousarray(kept)
    Phi, inverse = _all_duals(columns, weight, *at)
    return Duals(np.asarray(Phi.T), kept, inverse)


@timed("~Mortar: node weights")
def node_weights(
    pairing: Integrated, segments: Segments, keep: Bools | None = None
) -> tuple[Floats, Floats]:
    """Return int N~_j over the covered part and the whole slave side, (n,) each (collective).

    The former is D_jj of eq. 19 where all nodes carry a multiplier and N~ is N, see `absorbed`.

    Args:
        keep: Slave nodes (n,) that carry a multiplier; all if not given.
    """
    slave = pairing.slave
    shares, kept = slave.element.shares, None if keep is None else keep[slave.facets]
    covered = covered_weights(segments.N, segments.weight, segments.slave, len(slave.facets))
    covered, whole = (absorbed(shares, v, kept) for v in (covered, segments.facet_weights))
    both = sum_at_nodes(slave, np.stack([covered, whole], axis=2))
    return both[:, 0], both[:, 1]


@dataclass(frozen=True)
class Coverage:
    """How far the owned slave nodes face the master."""

    share: Floats  # (n,) covered share of the tributary weight
    reached: Bools  # (n,) on a facet of which some part is covered
    weightless: Bools  # (n,) without tributary weight: no multiplier, whatever is covered
    near: Bools | None = None  # (n,) of a tool: within its reach; None for all

    @property
    def faces(self) -> Bools:
        """Which nodes (n,) face the master: enough is covered to carry a multiplier."""
        return np.asarray(
            (self.share > LEAST_COVERAGE) & (True if self.near is None else self.near)
        )


def find_coverage(
    pairing: Integrated, segments: Segments, covered: Floats, tributary: Floats
) -> Coverage:
    """Return the coverage of the owned slave nodes; the weights are of `node_weights`."""
    slave = pairing.slave
    nodes = slave.facets[segments.covered].ravel()
    reached = accumulate(slave, np.bincount(nodes, minlength=len(slave.nodes))) > 0
    own, (none, facets) = slice(None, slave.owned), _find_weightless(pairing, segments)
    share = np.where(none, facets, covered / np.where(none, 1.0, tributary))
    return Coverage(np.asarray(share[own]), np.asarray(reached[own]), none[own])


def _find_weightless(pairing: Integrated, segments: Segments) -> tuple[Bools, Floats]:
    """Return the slave nodes (n,) without weight, and the covered share of nodes' facets (n,).

    Of second order, with a weight 2 pi r, the functions of nodes on the axis integrate to nothing
    but what the curvature of their facet leaves, of either sign: these have no D_jj. Collective.
    """
    slave = pairing.slave
    if slave.element.degree == 1:  # positive functions
        return np.zeros(len(slave.nodes), dtype=bool), np.zeros(len(slave.nodes))
    whole = absorbed(slave.element.shares, segments.facet_weights)
    covered = np.bincount(segments.slave, segments.weight, minlength=len(whole))
    sizes = np.repeat(np.stack([whole.sum(axis=1), covered], axis=1)[:, None], whole.shape[1], 1)
    sums = sum_at_nodes(slave, np.concatenate([whole[:, :, None], sizes], axis=2))
    none = sums[:, 0] <= LEAST_WEIGHT * sums[:, 1]
    return np.asarray(none), np.asarray(sums[:, 2] / np.maximum(sums[:, 1], TINY))


def default_keep(
    pairing: Integrated,
    segments: Segments,
    covered: Floats,
    tributary: Floats,
    allowed: Bools | None = None,
) -> Bools:
    """Choose the slave nodes that carry a multiplier, the same on any number of ranks (collective).

    A node is kept if it has a weight of which more than 5 % is covered. Where that leaves a covered
    facet without a kept node, the facet's best covered node is kept, so that no covered part of
    the slave side is without multiplier.

    Args:
        covered: Covered weight (n,) of each slave node, of `node_weights`.
        tributary: Whole weight (n,), of `node_weights`.
        allowed: Nodes (n,) that may be kept; all if not given.
    """
    allowed = np.ones(len(covered), dtype=bool) if allowed is None else allowed
    none, _ = _find_weightless(pairing, segments)
    coverage = np.where(allowed & ~none, covered, 0.0) / np.where(none, 1.0, tributary)
    keep = coverage > LEAST_COVERAGE
    if pairing.slave.element.shares:  # a vertex needs mid-side nodes whose functions it shares
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
    """Return the slave nodes (n,) that carry a multiplier, and w Phi_j (q, k) (collective).

    Of those of `default_keep` the ones whose multipliers push: int Phi_j, the force of a unit
    pressure and the row sum of D, contains what nodes without multiplier share out, and may be
    negative where D_jj is positive, as that of a second-order vertex whose facets are covered in
    their far corners. Such nodes may carry none, and the choice is made anew.

    Args:
        weights: Covered and whole weights of `node_weights`.
        allowed: Nodes (n,) that may be kept.
    """
    while True:  # each time with fewer nodes
        keep = default_keep(pairing, segments, *weights, allowed)
        Phi = weighted_duals(pairing, segments, keep)
        force = integrate_values(pairing, segments, Phi, np.ones(len(Phi)))
        pulls = keep & (force <= LEAST_COVERAGE * weights[0])
        if not any_rank(pairing.slave.V.mesh.comm, pulls.any())[0]:
            return keep, Phi
        allowed = allowed & ~pulls


def _best_nodes(coverage: Floats, X: Floats) -> Ints:
    """Return (m,) which node of each facet is covered best; of equal ones the last in space.

    That is the one at the largest x, then y, then z, whatever the numbers and the round-off.

    Args:
        coverage: Covered part (m, k) of the nodes.
        X: Coordinates (m, k, d).
    """
    best = coverage >= (1 - HALF_OF_DIGITS) * coverage.max(axis=1, initial=0.0)[:, None]
    size = facet_sizes(X)
    for x in np.moveaxis(X, 2, 0):
        furthest = np.where(best, x, -np.inf).max(axis=1, initial=-np.inf)
        best &= x >= (furthest - HALF_OF_DIGITS * size)[:, None]
    return np.asarray(np.argmax(best, axis=1), dtype=np.int32)


def find_duals(pairing: Integrated, segments: Segments, keep: Bools) -> Duals:
    """Return the dual functions at the points of segments.

    Args:
        keep: Slave nodes (n,) that carry a multiplier; a node has the same value on all ranks.
    """
    element, kept = pairing.slave.element, keep[pairing.slave.facets]
    N = absorbed(element.shares, segments.N, kept[segments.slave])
    return create_duals(N, segments.weight, segments.slave, kept)


def weighted_duals(pairing: Integrated, segments: Segments, keep: Bools) -> Floats:
    """Return w Phi_j (q, k) at the points of segments, w their weights; see `find_duals`."""
    return find_duals(pairing, segments, keep).Phi * segments.weight[:, None]

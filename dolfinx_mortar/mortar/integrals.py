# SPDX-License-Identifier: MIT
r"""Segments of a pair at X + u, dual functions and integrals over them, and which nodes they cover.

Each slave facet is integrated by the rank that owns it; copies of the master facets travel to it.
The weight of a pairing, such as 2 pi r, is a factor of all these integrals. It is taken at the
points of the slave side where they are at X: there it stays what it was, and positive.

The dual basis functions of the multiplier are biorthogonal over the covered part of each facet. On
one facet with the covered part G, Phi = A N with A = D M^-1, D = diag(int_G N_j) and
M = int_G N N^T, so that int_G Phi_i N_j = delta_ij int_G N_j and sum_j Phi_j = 1. M is as good
as singular when little of the facet is covered, so it is never formed: with the weights w and
sqrt(w) N = Q R it follows that sqrt(w) Phi = Q R^-T D.

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

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

from mpi4py import MPI

import numba
import numpy as np

import dolfinx
from dolfinx.common import timed
from dolfinx_mortar.arrays import HALF_OF_DIGITS, TINY, Bools, Floats, Ints
from dolfinx_mortar.geometry.facets import Facets, facet_sizes, points_of, tributary_weights
from dolfinx_mortar.geometry.segments import Segments, create_segments
from dolfinx_mortar.geometry.tolerances import ROUND_OFF
from dolfinx_mortar.mortar.pairing import Pairing, received_facets
from dolfinx_mortar.mortar.surface import (
    Surface,
    accumulate,
    coordinates,
    facets_at,
    nodal_normals,
    sum_at_nodes,
)

_OF_POINTS = "pair", "slave", "master", "xi_s", "xi_m", "weight"  # what segments say of each point
LEAST_COVERAGE = 0.05
"""A slave node carries a multiplier if more than this part of its tributary weight is covered.

The pressure shown there is a force over what is covered. Under punches whose edges are anywhere in
a facet (2D, hexahedra, tetrahedra) 1e-5 shows up to 80 times the pressure beside it, 0.005 five
times, 0.025 to 0.1 at most twice. From 1e-5 to 0.1 forces differ by up to 0.5 % in 2D, 2 % in 3D,
and iterations by two.
"""
STAYS = 0.5
"""A node that has lost its multiplier in the course of a step, and got it back, keeps it down to
this part of that coverage. Its multiplier moves the bodies, and so changes its coverage: where the
rim of a box presses into another one (sweep second3, seed 20001) it alternated without end between
.042 with a multiplier and .053 without one."""

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


# The kernels spell out their sums: array expressions would take three times as long to compile.
# Values of one function at all points lie side by side, and sums may be taken in any order, so that
# the compiler adds up several points at once.
_SUMS = {"cache": True, "error_model": "numpy", "fastmath": {"reassoc", "contract", "nsz"}}


@numba.njit(**_SUMS)
def _product(a, b):  # type: ignore[no-untyped-def]
    """Return the scalar product of a and b (q,)."""
    result = 0.0
    for q in range(len(a)):
        result += a[q] * b[q]
    return result


@numba.njit(**_SUMS)
def _add(factor, a, b):  # type: ignore[no-untyped-def]
    """Add a factor times a (q,) to b."""
    for q in range(len(a)):
        b[q] += factor * a[q]


@numba.njit(**_SUMS)
def _add_products(blocks, Phi, N, where):  # type: ignore[no-untyped-def]
    """Add Phi (k, q) times N (l, q) of all points to blocks (size, k, l)."""
    first = 0
    while first < len(where):
        last = first  # points of the same block mostly follow each other
        while last < len(where) and where[last] == where[first]:
            last += 1
        for i in range(len(Phi)):
            for j in range(len(N)):
                blocks[where[first], i, j] += _product(Phi[i, first:last], N[j, first:last])
        first = last


def sums_of_products(Phi: Floats, N: Floats, where: Ints, size: int) -> Floats:
    """Return the sums (size, k, l) of Phi (q, k) times N (q, l) over the points of each place.

    Args:
        Phi: Values of functions, times the weights of the points.
        N: Values of others.
        where: Place (q,) of each point.
    """
    blocks = np.zeros((size, Phi.shape[1], N.shape[1]))
    _add_products(blocks, np.ascontiguousarray(Phi.T), np.ascontiguousarray(N.T), where)
    return blocks


def sums_of_values(Phi: Floats, values: Floats, where: Ints, size: int) -> Floats:
    """Return the sums (size, k) of Phi (q, k) times values (q,) over the points of each place.

    In the order of the points, as `np.bincount` of each function, in a tenth of the time.

    Args:
        Phi: Values of functions, times the weights of the points.
        values: Values at the points.
        where: Place (q,) of each point.
    """
    sums = np.zeros((size, Phi.shape[1]))
    _add_values(sums, np.ascontiguousarray(Phi.T), np.ascontiguousarray(values), where)
    return sums


@numba.njit(cache=True)
def _add_values(sums, Phi, values, where):  # type: ignore[no-untyped-def]
    """Add Phi (k, q) times values (q,) to sums (size, k)."""
    for i in range(len(Phi)):
        for q in range(len(where)):
            sums[where[q], i] += Phi[i, q] * values[q]


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
    return sums_of_products(weight[:, None], N_s, slave, m)[:, 0]


@numba.njit(**_SUMS)
def _orthonormalise(Q, R):  # type: ignore[no-untyped-def]
    """Replace the rows of Q (k, q) by those of Q^T with Q R; return False if they are dependent."""
    for j in range(len(Q)):
        length = np.sqrt(_product(Q[j], Q[j]))
        for _ in range(2):  # the second pass makes Q orthogonal to round-off
            for i in range(j):
                r = _product(Q[i], Q[j])
                R[i, j] += r
                _add(-r, Q[i], Q[j])
        R[j, j] = np.sqrt(_product(Q[j], Q[j]))
        if R[j, j] <= ROUND_OFF * length:
            return False
        for q in range(Q.shape[1]):
            Q[j, q] /= R[j, j]
    return True


@numba.njit(**_SUMS)
def _biorthogonalise(Q, roots, Phi):  # type: ignore[no-untyped-def]
    """Fill Phi (k, q), which is zero, biorthogonal to sqrt(w) N = Q, which is lost.

    The roots are sqrt(w) (q,). Returns False if the functions are dependent.
    """
    k = len(Q)
    R, D, y = np.zeros((k, k)), np.empty(k), np.empty(k)
    for j in range(k):
        D[j] = _product(roots, Q[j])
    if not _orthonormalise(Q, R):
        return False
    for j in range(k):
        for i in range(k):  # R^T y = D e_j
            y[i] = D[j] if i == j else 0.0
            for h in range(i):
                y[i] -= R[h, i] * y[h]
            y[i] /= R[i, i]
        for i in range(j, k):
            _add(y[i], Q[i], Phi[j])
        for q in range(len(roots)):
            Phi[j, q] /= roots[q]
    return True


@numba.njit(**_SUMS)
def _facet_dual(N, weight, kept, count, first, last, Phi):  # type: ignore[no-untyped-def]
    """Fill the functions (k, q) of one facet at its points, for the `count` nodes kept."""
    Q, found = np.empty((count, last - first)), np.zeros((count, last - first))
    roots, which = np.sqrt(weight[first:last]), np.flatnonzero(kept)
    for j in range(count):
        values = N[which[j], first:last]
        for q in range(len(roots)):
            Q[j, q] = roots[q] * values[q]
    if not _biorthogonalise(Q, roots, found):
        found[:] = 0.0  # nothing but round-off is covered: any partition of unity will do
    missing = np.full(len(roots), 1.0 / count)
    for j in range(count):
        _add(-1.0 / count, found[j], missing)
    for j in range(count):
        values = Phi[which[j], first:last]
        for q in range(len(missing)):
            values[q] = found[j, q] + missing[q]


@numba.njit(cache=True)
def _all_duals(N, weight, slave, keep):  # type: ignore[no-untyped-def]
    """Return Phi (k, q) of the kept nodes; points are ordered by slave facet."""
    Phi = np.zeros(N.shape)
    a = np.int64(0)  # a literal 0 has a type of its own: _facet_dual would compile twice
    while a < len(slave):
        b = a
        while b < len(slave) and slave[b] == slave[a]:
            b += 1
        kept = keep[slave[a]]
        count = 0
        for j in range(len(kept)):
            count += kept[j]
        if count == 1:  # exact, and the only way where almost nothing is covered
            for j in range(len(kept)):
                for q in range(a, b):
                    Phi[j, q] = kept[j]
        elif count > 1:
            _facet_dual(N, weight, kept, count, a, b, Phi)
        a = b
    return Phi


def dual_values(N_s: Floats, weight: Floats, slave: Ints, keep: Bools) -> Floats:
    """Return the values (q, k) of the dual functions Phi (eq. 20) at the quadrature points.

    The function of a node that cannot carry a multiplier is zero; those of the kept nodes of the
    facet add up to one all the same, so that constants stay in the space of multipliers. Where a
    facet has no kept node, all functions vanish.

    Args:
        N_s: Values (q, k) of the slave shape functions.
        weight: Positive weights (q,) of the quadrature points.
        slave: Slave facet (q,) of each point, ascending.
        keep: For each slave facet and node (m, k), whether the node carries a multiplier.

    Returns:
        Phi with sum_q weight Phi_i N_j = delta_ij sum_q weight N_j for i and j kept.
    """
    N, weight = np.ascontiguousarray(N_s.T), np.ascontiguousarray(weight)
    Phi = _all_duals(N, weight, np.ascontiguousarray(slave), np.ascontiguousarray(keep))
    return np.asarray(Phi.T)


class Integrated(Protocol):
    """Data for integrals over a slave side: a `Pairing`, or a side alone."""

    @property
    def slave(self) -> Surface:
        """The side."""


@timed("~Mortar: segments")
def find_segments(pairing: Pairing, u: dolfinx.fem.Function | None) -> tuple[Segments, Floats]:
    """Find the segments and the averaged slave normals (n, d) at X + u (collective).

    Their weights contain that of the pairing.
    """
    slave = pairing.slave
    x = coordinates(slave, u)
    normals = nodal_normals(slave, x)
    master = received_facets(pairing, u)
    facets = facets_at(slave, x)
    n_s = normals[slave.facets]
    segments = create_segments(facets, n_s, master, pairing.pairs, pairing.deepest)
    return _weigh(pairing, segments, facets), normals


def point_distances(
    pairing: Pairing, segments: Segments, u: dolfinx.fem.Function | None
) -> tuple[Floats, Floats]:
    """Return |x_s - x_m| at the points (q,), and the larger of their two facets (q,) (collective).

    The size of a facet is its diameter at X.
    """
    slave = facets_at(pairing.slave, coordinates(pairing.slave, u))
    offsets = points_of(slave, segments.slave, segments.xi_s)
    offsets -= points_of(received_facets(pairing, u), segments.master, segments.xi_m)
    sizes = facet_sizes(pairing.slave.X[pairing.slave.facets])
    of_master = facet_sizes(pairing.master_X[pairing.master_facets])
    larger = np.maximum(sizes[segments.slave], of_master[segments.master])
    return np.linalg.norm(offsets, axis=1), larger


def drop_far(
    pairing: Pairing,
    segments: Segments,
    u: dolfinx.fem.Function | None,
    reach: Callable[[Floats, float], Floats],
) -> Segments:
    """Return the segments without the pairs that are too far apart (collective).

    A pair stays if all its points do, so that what stays is whole: functions of the nodes are
    independent on it.

    Args:
        u: Displacement, None for X.
        reach: Largest distances (q,) for sizes of facets (q,), see `point_distances`, and the least
            distance of all.
    """
    distances, larger = point_distances(pairing, segments, u)
    comm = pairing.slave.V.mesh.comm
    nearest = float(comm.allreduce(distances.min(initial=np.inf), op=MPI.MIN))
    far = distances > reach(larger, nearest) + HALF_OF_DIGITS * larger
    near = (np.bincount(segments.pair, far, minlength=len(pairing.pairs)) == 0.0)[segments.pair]
    return some_points(segments, near)


def some_points(segments: Segments, which: Bools) -> Segments:
    """Return the segments with some of their points (q,) only."""
    points = {name: getattr(segments, name)[which] for name in _OF_POINTS}
    return replace(segments, **points)


def _weigh(pairing: Pairing, segments: Segments, facets: Facets) -> Segments:
    """Return segments on the slave facets (m,) at X + u with the weight of the pairing."""
    if pairing.weight is None:
        return segments
    at_X, xi = facets_at(pairing.slave, pairing.slave.X), facets.element.rule[0]
    which = np.repeat(np.arange(len(facets.x), dtype=np.int32), len(xi))
    points = points_of(at_X, which, np.tile(xi, (len(facets.x), 1)))
    whole = pairing.weight(points).reshape(len(facets.x), len(xi))
    at_points = pairing.weight(points_of(at_X, segments.slave, segments.xi_s))
    return replace(
        segments,
        weight=segments.weight * at_points,
        facet_weights=tributary_weights(facets, whole),
    )


@timed("~Mortar: node weights")
def node_weights(
    pairing: Integrated, segments: Segments, keep: Bools | None = None, N_s: Floats | None = None
) -> tuple[Floats, Floats]:
    """Return int N~_j over the covered part and the whole slave side, (n,) each (collective).

    The former is D_jj of eq. 19 where all nodes carry a multiplier and N~ is N, see `absorbed`.

    Args:
        keep: Slave nodes (n,) that carry a multiplier; all if not given.
        N_s: Values (q, k) of the slave shape functions, if they are at hand.
    """
    slave = pairing.slave
    shares, kept = slave.element.shares, None if keep is None else keep[slave.facets]
    N_s = slave.element.shape_functions(segments.xi_s) if N_s is None else N_s
    covered = covered_weights(N_s, segments.weight, segments.slave, len(slave.facets))
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
    stays: Bools | None = None,
    N_s: Floats | None = None,
) -> Bools:
    """Choose the slave nodes that carry a multiplier, the same on any number of ranks (collective).

    A node is kept if it has a weight of which more than 5 % is covered. Where that leaves a covered
    facet without a kept node, the facet's best covered node is kept, so that no covered part of
    the slave side is without multiplier.

    Args:
        covered: Covered weight (n,) of each slave node, of `node_weights`.
        tributary: Whole weight (n,), of `node_weights`.
        allowed: Nodes (n,) that may be kept; all if not given.
        stays: Nodes (n,) that are kept down to less, `STAYS`; none if not given.
        N_s: Values (q, k) of the slave shape functions, if they are at hand.
    """
    least = LEAST_COVERAGE * np.where(False if stays is None else stays, STAYS, 1.0)
    allowed = np.ones(len(covered), dtype=bool) if allowed is None else allowed
    none, _ = _find_weightless(pairing, segments)
    coverage = np.where(allowed & ~none, covered, 0.0) / np.where(none, 1.0, tributary)
    keep = coverage > least
    if pairing.slave.element.shares:  # a vertex needs mid-side nodes whose functions it shares
        left = node_weights(pairing, segments, keep, N_s)[0] / np.where(none, 1.0, tributary)
        coverage = np.where(left > HALF_OF_DIGITS * coverage, coverage, 0.0)
        keep &= left > least
    facets = pairing.slave.facets[segments.covered]
    facets = facets[~keep[facets].any(axis=1) & (coverage[facets] > 0).any(axis=1)]
    best = _best_nodes(coverage[facets], pairing.slave.X[facets])
    rescued = np.bincount(facets[np.arange(len(facets)), best], minlength=len(covered))
    return keep | (accumulate(pairing.slave, rescued) > 0)


def _best_nodes(coverage: Floats, X: Floats) -> Ints:
    """Return (m,) which node of each facet is covered best; of equal ones the last in space.

    That is the one at the largest x, then y, then z, whatever the numbers and the round-off.

    Args:
        coverage: Covered part (m, k) of the nodes.
        X: Coordinates (m, k, d).
    """
    best = coverage >= (1 - HALF_OF_DIGITS) * coverage.max(axis=1, initial=0.0)[:, None]
    for x in np.moveaxis(X, 2, 0):
        furthest = np.where(best, x, -np.inf).max(axis=1, initial=-np.inf)
        best &= x >= (furthest - HALF_OF_DIGITS * facet_sizes(X))[:, None]
    return np.asarray(np.argmax(best, axis=1), dtype=np.int32)


def weighted_duals(
    pairing: Integrated, segments: Segments, keep: Bools, N_s: Floats | None = None
) -> Floats:
    """Return w Phi_j (q, k) at the points of the segments, w their weights.

    Args:
        keep: Slave nodes (n,) that carry a multiplier; a node has the same value on all ranks.
        N_s: Values (q, k) of the slave shape functions, if they are at hand.
    """
    element, kept = pairing.slave.element, keep[pairing.slave.facets]
    N_s = element.shape_functions(segments.xi_s) if N_s is None else N_s
    N_s = absorbed(element.shares, N_s, kept[segments.slave])
    Phi = dual_values(N_s, segments.weight, segments.slave, kept)
    Phi *= segments.weight[:, None]
    return Phi


def integrate_values(
    pairing: Integrated, segments: Segments, Phi: Floats, values: Floats
) -> Floats:
    """Return int Phi_j f (n,) at the slave nodes for values f (q,) at the points (collective).

    Args:
        Phi: Weighted dual functions (q, k) of `weighted_duals`.
        values: f.
    """
    slave = pairing.slave
    parts = sums_of_values(Phi, values, segments.slave, len(slave.facets))
    return sum_at_nodes(slave, parts[:, :, None])[:, 0]

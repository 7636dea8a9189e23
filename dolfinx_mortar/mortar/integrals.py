# SPDX-License-Identifier: MIT
"""Segments of a pair of surfaces at X + u, integrals over them, and which nodes these cover.

Each slave facet is integrated by the rank that owns it; copies of the master facets travel to it.
The weight of a pairing, such as 2 pi r, is a factor of all these integrals. It is taken at the
points of the slave side where they are at X: there it stays what it was, and positive.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

from mpi4py import MPI

import numpy as np

import dolfinx
from dolfinx.common import timed
from dolfinx_mortar.arrays import HALF_OF_DIGITS, Bools, Floats, Ints
from dolfinx_mortar.geometry.facets import Facets, facet_sizes, points_of, tributary_weights
from dolfinx_mortar.geometry.segments import Segments, create_segments
from dolfinx_mortar.geometry.tolerances import TINY
from dolfinx_mortar.mortar.dual import absorbed, covered_weights, dual_values, sums_of_values
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
"""A slave node carries a multiplier if more than this part of its tributary weight is covered."""
STAYS = 0.5
"""A node that has lost its multiplier in the course of a step, and got it back, keeps it down to
this part of that coverage. Its multiplier moves the bodies, and so changes its coverage: where the
rim of a box presses into another one (sweep second3, seed 20001) it alternated without end between
.042 with a multiplier and .053 without one."""

LEAST_WEIGHT = 0.01
"""A node has a weight if it is more than this part of the area of its facets: those of straight
facets have 1/36 or more, those on an axis phi^2/120, phi being the angle by which a facet bends."""


class Integrated(Protocol):
    """What integrals over a slave side need to know; a `Pairing` does, or a side alone."""

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
        pairing: The pair of surfaces.
        segments: Its segments at X + u.
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
        pairing: The pair of surfaces.
        segments: Its segments.
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
        pairing: The pair of surfaces.
        segments: Its segments.
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
        pairing: The pair of surfaces.
        segments: Its segments.
        keep: Slave nodes (n,) that carry a multiplier; a node has the same value on all ranks.
        N_s: Values (q, k) of the slave shape functions, if they are at hand.
    """
    element, kept = pairing.slave.element, keep[pairing.slave.facets]
    N_s = element.shape_functions(segments.xi_s) if N_s is None else N_s
    N_s = absorbed(element.shares, N_s, kept[segments.slave])
    Phi = dual_values(N_s, segments.weight, segments.slave, kept)
    return np.asarray(Phi * segments.weight[:, None])


def integrate_values(
    pairing: Integrated, segments: Segments, Phi: Floats, values: Floats
) -> Floats:
    """Return int Phi_j f (n,) at the slave nodes for values f (q,) at the points (collective).

    Args:
        pairing: The pair of surfaces.
        segments: Its segments.
        Phi: Weighted dual functions (q, k) of `weighted_duals`.
        values: f.
    """
    slave = pairing.slave
    parts = sums_of_values(Phi, values, segments.slave, len(slave.facets))
    return sum_at_nodes(slave, parts[:, :, None])[:, 0]

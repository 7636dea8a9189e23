# SPDX-License-Identifier: MIT
r"""Mortar operators D and M of a pair of surfaces as PETSc matrices.

    D_jl = int Phi_j N_l^s,      M_jl = int Phi_j N_l^m      over the covered part of the slave side

(eqs. 19 and 20 of the paper; the second function of eq. 20 has to be the master's)
with the dual functions Phi_j of the kept slave nodes. D is diagonal over the kept nodes. Rows are
integrated by the ranks that own the slave facets; copies of the master facets travel to them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from petsc4py import PETSc

import numba
import numpy as np

import dolfinx
from dolfinx.common import timed
from dolfinx_mortar.algebra import triplets
from dolfinx_mortar.arrays import Bools, Floats, Ints
from dolfinx_mortar.geometry.facets import facet_sizes
from dolfinx_mortar.geometry.segments import Segments, create_segments
from dolfinx_mortar.geometry.tolerances import HALF_OF_DIGITS, TINY
from dolfinx_mortar.mortar.dual import BASES, covered_weights
from dolfinx_mortar.mortar.pairing import Pairing, received_facets
from dolfinx_mortar.mortar.surface import (
    accumulate,
    coordinates,
    facets_at,
    nodal_normals,
    sum_at_nodes,
)

_CHUNK = 2**14
"""Points at which the motions of arms are known at a time: 5 MB in 3D, against calls."""
LEAST_COVERAGE = 0.05
"""A slave node carries a multiplier if more than this part of its tributary weight is covered."""


@timed("~Mortar: segments")
def find_segments(pairing: Pairing, u: dolfinx.fem.Function | None) -> tuple[Segments, Floats]:
    """Find the segments and the averaged slave normals (n, d) at X + u (collective)."""
    slave = pairing.slave
    x = coordinates(slave, u)
    normals = nodal_normals(slave, x)
    master = received_facets(pairing, u)
    segments = create_segments(facets_at(slave, x), normals[slave.facets], master, pairing.pairs)
    return segments, normals


@timed("~Mortar: node weights")
def node_weights(pairing: Pairing, segments: Segments) -> tuple[Floats, Floats]:
    """Return int N_j over the covered part and the whole slave side, (n,) each (collective).

    The former is D_jj of eq. 19 where all nodes carry a multiplier.
    """
    slave = pairing.slave
    N_s = slave.element.shape_functions(segments.xi_s)
    covered = covered_weights(N_s, segments.weight, segments.slave, len(slave.facets))
    both = sum_at_nodes(slave, np.stack([covered, segments.facet_weights], axis=2))
    return both[:, 0], both[:, 1]


@dataclass(frozen=True)
class Coverage:
    """How far the owned slave nodes face the master."""

    share: Floats  # (n,) covered share of the tributary weight
    reached: Bools  # (n,) on a facet of which some part is covered

    @property
    def faces(self) -> Bools:
        """Which nodes (n,) face the master: enough is covered to carry a multiplier."""
        return np.asarray(self.share > LEAST_COVERAGE)


def find_coverage(
    pairing: Pairing, segments: Segments, covered: Floats, tributary: Floats
) -> Coverage:
    """Return the coverage of the owned slave nodes; the weights are of `node_weights`."""
    slave = pairing.slave
    nodes = slave.facets[np.unique(segments.slave)].ravel()
    reached = accumulate(slave, np.bincount(nodes, minlength=len(slave.nodes))) > 0
    own = slice(None, slave.owned)
    return Coverage(np.asarray(covered[own] / tributary[own]), np.asarray(reached[own]))


def default_keep(
    pairing: Pairing,
    segments: Segments,
    covered: Floats,
    tributary: Floats,
    allowed: Bools | None = None,
) -> Bools:
    """Choose the slave nodes that carry a multiplier, the same on any number of ranks (collective).

    A node is kept if more than 5 % of its tributary weight is covered. Where that leaves a covered
    facet without a kept node, the facet's best covered node is kept, so that no covered part of
    the slave side is without multiplier.

    Args:
        pairing: The pair of surfaces.
        segments: Its segments.
        covered: Covered weight (n,) of each slave node, of `node_weights`.
        tributary: Whole weight (n,), of `node_weights`.
        allowed: Nodes (n,) that may be kept; all if not given.
    """
    allowed = np.ones(len(covered), dtype=bool) if allowed is None else allowed
    coverage = np.where(allowed, covered, 0.0) / np.maximum(tributary, TINY)
    keep = coverage > LEAST_COVERAGE
    facets = pairing.slave.facets[np.unique(segments.slave)]
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


def weighted_duals(pairing: Pairing, segments: Segments, keep: Bools) -> Floats:
    """Return w Phi_j (q, k) at the points of the segments, w their weights.

    Args:
        pairing: The pair of surfaces.
        segments: Its segments.
        keep: Slave nodes (n,) that carry a multiplier; a node has the same value on all ranks.
    """
    element = pairing.slave.element
    N_s, kept = element.shape_functions(segments.xi_s), keep[pairing.slave.facets]
    Phi = BASES[element.multiplier](N_s, segments.weight, segments.slave, kept)
    return np.asarray(Phi * segments.weight[:, None])


def integrate_values(pairing: Pairing, segments: Segments, Phi: Floats, values: Floats) -> Floats:
    """Return int Phi_j f (n,) at the slave nodes for values f (q,) at the points (collective).

    Args:
        pairing: The pair of surfaces.
        segments: Its segments.
        Phi: Weighted dual functions (q, k) of `weighted_duals`.
        values: f.
    """
    slave = pairing.slave
    count = len(slave.facets)
    parts = [np.bincount(segments.slave, P * values, minlength=count) for P in Phi.T]
    return sum_at_nodes(slave, np.stack(parts, axis=1)[:, :, None])[:, 0]


@timed("~Mortar: assemble D and M")
def assemble_node_matrices(
    pairing: Pairing, segments: Segments, keep: Bools, Phi: Floats | None = None
) -> tuple[PETSc.Mat, PETSc.Mat]:
    """Refill the matrices D (eq. 19) and M (eq. 20) of the pairing in place (collective).

    Args:
        pairing: The pair of surfaces.
        segments: Its segments.
        keep: Slave nodes (n,) that carry a multiplier; a node has the same value on all ranks.
        Phi: Their weighted functions of `weighted_duals`, if they are at hand.

    Returns:
        D and M in the numbering of V's nodes. Rows of removed nodes vanish; their columns in D do
        not. Over the kept nodes D is diagonal (exactly: the other integrals vanish by construction,
        and their round-off is set to zero).
    """
    N_s = pairing.slave.element.shape_functions(segments.xi_s)
    N_m = pairing.master.element.shape_functions(segments.xi_m)
    kept = keep[pairing.slave.facets]
    Phi = weighted_duals(pairing, segments, keep) if Phi is None else Phi
    paired = np.unique(pairing.pairs[:, 0])
    blocks_D = _integrate(Phi, N_s, segments.slave, len(kept))[paired]
    both = kept[paired][:, :, None] & kept[paired][:, None, :]
    blocks_D[both & ~np.eye(kept.shape[1], dtype=bool)] = 0.0
    triplets.set_values(pairing.D, blocks_D)
    triplets.set_values(pairing.M, _integrate(Phi, N_m, segments.pair, len(pairing.pairs)))
    return pairing.D, pairing.M


@timed("~Mortar: assemble motions")
def assemble_motions(
    pairing: Pairing,
    segments: Segments,
    Phi: Sequence[Floats],
    motions: Callable[[slice], Floats],
) -> Floats:
    """Return int Phi_j A_l (e, d, d) at the entries of M (collective).

    M serves as the room in which ranks add up, and has to be refilled.

    Args:
        pairing: The pair of surfaces.
        segments: Its segments.
        Phi: Weighted dual functions (q, k) of `weighted_duals` for each row of A_l.
        motions: A_l (q, k, d, d) at a part of the points for each node of their master facets.
    """
    d, k, m = len(Phi), pairing.slave.element.nodes, pairing.master.element.nodes
    blocks = np.zeros((d, len(pairing.pairs), k, m * d))
    for first in range(0, len(segments.pair), _CHUNK):
        part = slice(first, first + _CHUNK)
        A = motions(part)
        for i, P in enumerate(Phi):
            rows = np.ascontiguousarray(A[:, :, i].reshape(len(A), -1))
            _add_products(blocks[i], np.ascontiguousarray(P[part]), rows, segments.pair[part])
    columns = []
    for values in np.moveaxis(blocks.reshape(d, -1, k, m, d), 4, 1).reshape(d * d, -1, k, m):
        triplets.set_values(pairing.M, values)
        columns.append(pairing.M.getValuesCSR()[2])
    return np.stack(columns, axis=1).reshape(-1, d, d)


def _integrate(Phi: Floats, N: Floats, where: Ints, size: int) -> Floats:
    """Return the sums (size, k, l) of weighted Phi (q, k) times N (q, l) over points by `where`."""
    blocks = np.zeros((size, Phi.shape[1], N.shape[1]))
    _add_products(blocks, np.ascontiguousarray(Phi), np.ascontiguousarray(N), where)
    return blocks


@numba.njit(cache=True)
def _add_products(blocks, Phi, N, where):  # type: ignore[no-untyped-def]
    """Add Phi (q, k) times N (q, l) of all points to blocks (size, k, l)."""
    for q in range(len(where)):
        for i in range(Phi.shape[1]):
            for j in range(N.shape[1]):
                blocks[where[q], i, j] += Phi[q, i] * N[q, j]

# SPDX-License-Identifier: MIT
"""Normals of contact nodes, common to both sides (theory.md, Normals).

C_s = a_j a_j^T + S_s + eps I, where eps has a part of neighbouring spreads, so that the end of a
flat part yields to the other side's face. On planes of symmetry sums include mirror images, without
facets in the plane.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from dolfinx.fem import Function, FunctionSpace
from dolfinx_mortar.algebra.parallel import any_rank, sums_at_nodes, values_at
from dolfinx_mortar.common.arrays import HALF_OF_DIGITS, TINY, Bools, Floats, Ints, Longs
from dolfinx_mortar.geometry.curvature import STEP
from dolfinx_mortar.geometry.facets import Facets, facet_normals, surface_gradients, unit
from dolfinx_mortar.geometry.segments import Segments
from dolfinx_mortar.mortar.integrals import sums_of_values
from dolfinx_mortar.mortar.pairing import Pairing, received_facets
from dolfinx_mortar.mortar.surface import (
    Boundary,
    Surface,
    accumulate,
    coordinates,
    facets_at,
    marks,
    means_at_nodes,
    nodal_normals,
)

BLUR = 1e-3
"""Part of eps: share of the spreads at neighbouring vertices. From 1e-5 to 1e-1 resultants on a
face differ by 1e-4, of crossing edges by 0.002."""


class Spreads(NamedTuple):
    """Spreads of normals around the nodes of contacts."""

    V: FunctionSpace
    nodes: Ints  # (s,) local nodes, ascending
    S: Floats  # (s, d, d) S + eps I at X
    mirrors: Bools  # (local nodes, d) components across planes of symmetry
    turned: Longs  # nodes with a spread
    boundary: Boundary  # facets around these
    gradients: Floats  # (m, k, d) of N at facets' centres at X
    normals: Floats  # (m, d) at these

    def at(self, u: Function | None) -> Floats:
        """Spreads S + eps I (s, d, d) at X + u, turned by the rotations of dx/dX; collective."""
        S, d = self.S.copy(), self.S.shape[1]
        if u is None:
            return S
        facets = self.boundary.at(u)
        F = np.swapaxes(facets.x, 1, 2) @ self.gradients
        F += facet_normals(facets)[:, :, None] * self.normals[:, None]
        turned = self.nodes[self.turned]
        mean = means_at_nodes(self.V, self.boundary.nodes, F.reshape(len(F), d * d))[turned]
        R = _rotations(_with_images(mean.reshape(-1, d, d), self.mirrors[turned]))
        S[self.turned] = R @ S[self.turned] @ np.swapaxes(R, 1, 2)
        return S


def find_spreads(
    boundary: Boundary,
    contacts: Sequence[Surface],
    ties: Sequence[Surface] = (),
    mirrors: Bools | None = None,
) -> Spreads:
    """Spreads of normals at X; collective.

    `contacts` are sides of contacts, `ties` tied sides, which do not count, `mirrors` (local nodes,
    d) those of `judge_supports`.
    """
    V, nodes = contacts[0].V, boundary.nodes
    of_contacts = marks(V.dofmap.index_map, np.concatenate([side.nodes for side in contacts]))
    free = of_contacts[nodes].any(axis=1)
    for side in ties:
        free &= ~np.isin(boundary.entities, side.entities)
    if mirrors is None:
        mirrors = np.zeros((len(of_contacts), V.dofmap.index_map_bs), dtype=bool)
    along = facet_normals(boundary.facets)[:, None] ** 2 > 0.5  # in the plane
    free &= ~(along & mirrors[nodes]).any(axis=(1, 2))
    boundary = boundary[np.flatnonzero(free)]
    nodes = boundary.nodes
    vertices = boundary.facets.element.vertices
    at_vertices = nodes[:, vertices]
    S = _covariances(V, at_vertices, boundary.facets, mirrors)
    width = np.trace(S, axis1=1, axis2=2)
    beside = width[at_vertices].mean(axis=1, keepdims=True)
    blur = BLUR * means_at_nodes(V, nodes, beside)[:, 0] + HALF_OF_DIGITS
    between = np.delete(nodes, vertices, axis=1)
    if V.element.basix_element.degree > 1:
        of_facets = S[at_vertices].mean(axis=1).reshape(len(nodes), S.shape[1] ** 2)
        S += means_at_nodes(V, between, of_facets).reshape(S.shape)
    nodes = np.flatnonzero(of_contacts).astype(np.int32)
    S = _with_images(S, mirrors)[nodes]
    turned = np.flatnonzero(np.trace(S, axis1=1, axis2=2) > HALF_OF_DIGITS)
    near = np.isin(boundary.nodes, nodes[turned]).any(axis=1)
    around = boundary[np.flatnonzero(near)]
    S += blur[nodes, None, None] * np.eye(S.shape[1])
    every = np.arange(len(around.nodes), dtype=np.int32)
    middle = around.facets.element.centre.repeat(len(every), axis=0)
    slopes = surface_gradients(around.facets, every, middle)
    return Spreads(V, nodes, S, mirrors, turned, around, *slopes)


def _with_images(S: Floats, mirrors: Bools) -> Floats:
    off = ~np.eye(S.shape[1], dtype=bool) & (mirrors[:, :, None] | mirrors[:, None])
    return np.where(off, 0.0, S)


def _covariances(V: FunctionSpace, nodes: Ints, facets: Facets, mirrors: Bools) -> Floats:
    n = facet_normals(facets)
    d = n.shape[1]
    products = (n[:, :, None] * n[:, None]).reshape(len(n), d * d)
    found = means_at_nodes(V, nodes, np.hstack([n, products]))
    mean = np.where(mirrors, 0.0, found[:, :d])
    S = found[:, d:].reshape(-1, d, d) - mean[:, :, None] * mean[:, None]
    return _with_images(S, mirrors)


def _rotations(F: Floats) -> Floats:
    """Nearest rotations (n, d, d)."""
    U, _, V = np.linalg.svd(F)
    return U @ V


class CommonNormals(NamedTuple):
    """Normals at the owned slave nodes, and their derivatives."""

    n: Floats  # (n, d)
    of_master: Floats  # (m, d) n_l at the owned master nodes
    below_edges: Bools  # (n,) coupled to an edge of the master, not on one
    # -> derivatives (n, d, d) by the averaged normal of the node, and by sum_l M_jl n_l
    differentiate: Callable[[], tuple[Floats, Floats]]

    def everywhere(self, slave: Surface) -> Floats:
        """Normals at all local slave nodes (n, d); collective."""
        local = np.zeros_like(slave.X)
        local[: slave.owned] = self.n
        return accumulate(slave, local)


def common_normals(
    pairing: Pairing,
    segments: Segments,
    M: Floats,
    u: Function | None,
    averaged: Floats,
    spreads: Spreads,
    feature_angle: float,
) -> CommonNormals:
    """Normals of both sides at X + u; collective.

    Averaged ones (n, d) where nothing is coupled, or no direction agrees with both sides. M has
    entries (f,); the angle is in degrees.
    """
    slave, master, V = pairing.slave, pairing.master, pairing.slave.V
    own, nodes, d = slave.nodes[: slave.owned], master.nodes[: master.owned], slave.X.shape[1]
    S, limit = spreads.at(u), np.sin(np.radians(feature_angle / 2)) ** 2
    S_s, S_m = (S[np.searchsorted(spreads.nodes, side.nodes)] for side in (slave, master))
    across, across_m = (spreads.mirrors[of] for of in (own, nodes))
    n_m = nodal_normals(master, coordinates(master, u))[: len(nodes)]
    (n, by_averaged), (n_m, _) = in_planes(averaged[: len(own)], across), in_planes(n_m, across_m)
    of_slave, of_master = _facing(pairing, segments, u, _edged(S, limit).any())
    S_s, S_m, n_s = S_s[: len(own)], S_m[: len(nodes)], n.copy()
    a = _of_side(n, np.where(across, 0.0, of_slave), S_s, limit)
    values = np.zeros((V.dofmap.index_map.size_local, d + d * d))
    values[nodes, :d] = _of_side(n_m, np.where(across_m, 0.0, of_master), S_m, limit)
    values[nodes, d:] = S_m.reshape(-1, d * d)
    facing = values_at(V.mesh.comm, values, pairing.M.columns)
    row, one = pairing.row[len(pairing.off_diagonal) :], np.ones((len(M), 1))
    total = sums_of_values(np.hstack([one, facing[:, :d]]), M, row, len(own))
    spread = sums_of_values(np.hstack([one, facing[:, d:]]), np.maximum(M, 0.0), row, len(own))
    total = np.where(across, 0.0, -np.sign(total[:, :1]) * total[:, 1:])
    S_b = (spread[:, 1:] / np.maximum(spread[:, :1], TINY)).reshape(-1, d, d)
    S_b, size, b = _with_images(S_b, across), np.linalg.norm(total, axis=1), unit(total)
    mean = _mean(a, b, S_s, S_b)
    towards = np.stack([(mean * v).sum(axis=1) for v in (a, b)])
    met = np.flatnonzero((size > 0.0) & (towards > HALF_OF_DIGITS).all(axis=0))
    n[met] = unit(mean[met])

    def differentiate() -> tuple[Floats, Floats]:
        by_slave, by_master = by_averaged.copy(), np.zeros_like(by_averaged)
        turning = _across(n[met]) / np.linalg.norm(mean[met], axis=1)[:, None, None]
        by_a, by_b = _mean_slopes(a[met], b[met], S_s[met], S_b[met])
        by_master[met] = -turning @ by_b @ _across(b[met]) / size[met, None, None]
        by_slave[met] = turning @ by_a @ carried(n_s[met], a[met]) @ by_averaged[met]
        return by_slave, np.where(across[:, :, None], 0.0, by_master)

    sharp = _edged(facing[:, d:].reshape(-1, d, d), limit) & (M != 0.0)
    below = (np.bincount(row, sharp, minlength=len(own)) > 0.0) & ~_edged(S_s, limit)
    return CommonNormals(n, values[nodes, :d], below, differentiate)


def in_planes(n: Floats, mirrors: Bools) -> tuple[Floats, Floats]:
    """Unit vectors (n, d) without the components across planes, and their derivatives.

    m = P n / |P n| has (I - m m^T) P / |P n|; I without a plane, as dn is normal to n.
    """
    some: Longs = np.flatnonzero(mirrors.any(axis=1))
    n, by_n = n.copy(), np.eye(n.shape[1])[None].repeat(len(n), axis=0)
    if not len(some):
        return n, by_n
    m = np.where(mirrors[some], 0.0, n[some])
    size = np.linalg.norm(m, axis=1)[:, None, None]
    n[some] = unit(m)
    by_m = _across(n[some]) / np.where(size > 0.0, size, np.inf)
    by_n[some] = np.where(mirrors[some, None], 0.0, by_m)
    return n, by_n


def carried(n: Floats, a: Floats) -> Floats:
    """Derivatives (n, d, d) of unit vectors a that turn with n."""
    along = (n * a).sum(axis=1)[:, None, None]
    return along * np.eye(n.shape[1]) - n[:, :, None] * a[:, None]


def _across(n: Floats) -> Floats:
    return np.eye(n.shape[1]) - n[:, :, None] * n[:, None]


def _facing(
    pairing: Pairing, segments: Segments, u: Function | None, edged: np.bool_
) -> tuple[Floats, Floats]:
    """Sums (owned nodes, d) of w N_j n_s and w N_l n_m if there are edges; collective."""
    V, slave, master = pairing.slave.V, pairing.slave, pairing.master
    own = slave.nodes[: slave.owned], master.nodes[: master.owned]
    if not any_rank(V.mesh.comm, edged)[0]:
        return np.zeros_like(slave.X[: len(own[0])]), np.zeros_like(master.X[: len(own[1])])
    numbers = V.dofmap.index_map.local_to_global(slave.nodes).astype(np.int64)
    facets, others = facets_at(slave, coordinates(slave, u)), received_facets(pairing, u)
    of_others = pairing.master_nodes[pairing.master_facets]
    found = []
    for side, xi, on, nodes in (
        (facets, segments.xi_s, segments.slave, numbers[slave.facets]),
        (others, segments.xi_m, segments.master, of_others),
    ):
        N = np.clip(side.element.shape_functions(xi), 0.0, None)
        weights = sums_of_values(N, segments.weight, on, len(nodes))
        sums = weights[:, :, None] * facet_normals(side)[:, None]
        at = nodes.ravel(), sums.reshape(-1, sums.shape[2])
        found.append(sums_at_nodes(V.mesh.comm, V.dofmap.index_map, *at))
    return found[0][own[0]], found[1][own[1]]


def _edged(S: Floats, limit: float) -> Bools:
    return np.trace(S, axis1=1, axis2=2) > limit / 2


def _of_side(averaged: Floats, facing: Floats, S: Floats, limit: float) -> Floats:
    """Normals (n, d) of a side: averaged, on edges `facing`."""
    edged = np.flatnonzero(_edged(S, limit) & facing.any(axis=1))
    if not len(edged):
        return averaged.copy()
    result, n, c = averaged.copy(), averaged[edged], unit(facing[edged])
    Q = _across(n)
    widths, axes = np.linalg.eigh(Q @ S[edged] @ Q)
    smooth = np.clip(2.0 - 2.0 * widths / limit, 0.0, 1.0)
    K = Q @ (axes * smooth[:, None]) @ np.swapaxes(axes, 1, 2) @ Q
    result[edged] = unit(c - (K @ c[:, :, None])[:, :, 0])
    return result


def _mean(a: Floats, b: Floats, S_a: Floats, S_b: Floats) -> Floats:
    """Mean y (n, d) of unit vectors with given spreads.

    A = a a^T + S_a, B = b b^T + S_b, K = (A + B)^-1, z = K (b - a): y = B K a + A K b = a + A z.
    """
    A, B = (v[:, :, None] * v[:, None] + S for v, S in ((a, S_a), (b, S_b)))
    z = np.linalg.solve(A + B, (b - a)[:, :, None])
    return a + (A @ z)[:, :, 0]


def _mean_slopes(a: Floats, b: Floats, S_a: Floats, S_b: Floats) -> tuple[Floats, Floats]:
    """Derivatives of `_mean` by a and b, with which the spreads turn, by complex steps.

    dS = W S - S W, W = da a^T - a da^T.
    """
    found = np.zeros((2, *S_a.shape))
    for k, i in np.ndindex(2, a.shape[1]):
        moved: list[Any] = [v + 0j for v in (a, b, S_a, S_b)]
        v, S, dv = moved[k], moved[2 + k], np.eye(a.shape[1])[i]
        W = dv[:, None] * v[:, None] - v[:, :, None] * dv
        moved[k], moved[2 + k] = v + 1j * STEP * dv, S + 1j * STEP * (W @ S - S @ W)
        found[k, :, :, i] = _mean(*moved).imag / STEP
    return found[0], found[1]

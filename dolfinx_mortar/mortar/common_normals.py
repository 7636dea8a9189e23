# SPDX-License-Identifier: MIT
r"""Normals of contact nodes, which are normals of both sides.

A contact force without friction is normal to both sides. How well a side knows its normal at a node
is the spread of the normals n_f of all exterior facets there,

    S = mean (n_f - n')(n_f - n')^T,      n' = mean n_f:

nothing on a face, less the finer an arc, and on an edge much across it and nothing along it. So the
normal of node j is the least-squares mean of those of both sides, a_j and b_j,

    n_j = unit [C_m (C_s + C_m)^-1 a_j + C_s (C_s + C_m)^-1 b_j],   C_s = a_j a_j^T + S_s + eps I,

C_m likewise: the normal of the face or of the flatter side where the other one has an edge, a
corner or an arc, t_s x t_m where edges with the tangents t cross, the mean of equal sides; no angle
decides. The force at slave node j goes to the master nodes l in parts of M_jl (paper, eq. 20). So

    b_j = -unit sum_l M_jl n_l:

each node of either side is pressed along its own normal. The resultant on a flat side is then
normal to it: with the nodal forces f and the symmetric compliance C of its normal motions, averaged
normals turn by G C f, G being the central difference. Along equal facets far from the ends C and G
commute and G is antisymmetric: the tangential resultant f.G C f is zero for any f. That of facet
normals, or of means with other weights, is as large as the dent is steep.

Spreads are those at X, which turn with the surface: a flat side does not become an edge where it is
dented. Facets that are tied are none of them. Between vertices, at nodes of second order, S is
the mean of the vertices'. eps has a part of the spreads at the vertices beside a node, so that the
end of a flat part, where an arc or a corner begins, yields to the other side's face as these do.

The normal of a side at a node, a_j or n_l, is the averaged one, but across an edge that of the
facets that face the other side: of a block that stands flush on another one, not that of its flank.
Up to half of the spread at the feature angle it is the averaged one, then a part of both.

On a plane of symmetry all sums are those of the whole: with the images of the facets, and without
the facets in the plane.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numba
import numpy as np

from dolfinx import fem, la
from dolfinx_mortar.algebra.parallel import sums_at_nodes
from dolfinx_mortar.arrays import HALF_OF_DIGITS, TINY, Bools, Floats, Ints, Longs
from dolfinx_mortar.geometry.curvature import unit
from dolfinx_mortar.geometry.facets import Facets, facet_normals, surface_gradients
from dolfinx_mortar.geometry.segments import Segments
from dolfinx_mortar.mortar.integrals import sums_of_values
from dolfinx_mortar.mortar.pairing import Pairing, receive, received_facets
from dolfinx_mortar.mortar.surface import (
    Boundary,
    Surface,
    accumulate,
    coordinates,
    facets_at,
    nodal_normals,
)

BLUR = 1e-3
"""Part of eps: share of the spreads beside a node.

Of 1e-5 to 1e-1 resultants on a face differ by 1e-4, of crossing edges by .002.
"""


@dataclass(frozen=True, eq=False)
class Spreads:
    """How the normals of the exterior facets around nodes spread."""

    V: fem.FunctionSpace
    boundary: Boundary  # facets of the sides, and those beside them
    S: Floats  # (local nodes, d, d) at X
    blur: Floats  # (local nodes,) eps
    mirrors: Bools  # (local nodes, d) components of planes of symmetry

    def at(self, u: fem.Function | None) -> Floats:
        """Return S + eps I (local nodes, d, d) at X + u; collective."""
        S = self.S + self.blur[:, None, None] * np.eye(self.S.shape[1])
        if u is None:
            return S
        some = np.flatnonzero(np.trace(self.S, axis1=1, axis2=2) > HALF_OF_DIGITS)
        R = _rotations(self.V, self.boundary, u, self.mirrors, some)
        S[some] = R @ S[some] @ np.swapaxes(R, 1, 2)
        return S


def find_spreads(
    boundary: Boundary,
    contacts: Sequence[Surface],
    ties: Sequence[Surface] = (),
    mirrors: Bools | None = None,
) -> Spreads:
    """Return the spreads of normals at X; collective.

    Args:
        boundary: All exterior facets.
        contacts: Sides of contacts, one or more.
        ties: Sides that are tied.
        mirrors: (local nodes, d) components of planes of symmetry, see `find_mirrors`.
    """
    V, nodes = contacts[0].V, boundary.nodes
    marks = la.vector(V.dofmap.index_map)
    marks.array[:] = 0.0
    for side in contacts:
        marks.array[side.nodes[: side.owned]] = 1.0
    marks.scatter_forward()
    free = marks.array[nodes].any(axis=1)
    for side in ties:
        free &= ~np.isin(boundary.entities, side.entities)
    if mirrors is None:
        mirrors = np.zeros((len(marks.array), V.dofmap.index_map_bs), dtype=bool)
    along = facet_normals(boundary.facets)[:, None] ** 2 > 0.5  # rather in the plane than across it
    free &= ~(along & mirrors[nodes]).any(axis=(1, 2))
    names = "facets", "cells", "entities", "nodes"
    boundary = replace(boundary, **{name: getattr(boundary, name)[free] for name in names})
    nodes = boundary.nodes
    vertices = list(boundary.facets.element.vertices)
    at_vertices = nodes[:, vertices]
    S = _covariances(V, at_vertices, boundary.facets, mirrors)
    width = np.trace(S, axis1=1, axis2=2)
    beside = width[at_vertices].mean(axis=1, keepdims=True)
    blur = BLUR * _means(V, nodes, beside)[:, 0] + HALF_OF_DIGITS
    between = np.delete(nodes, vertices, axis=1)
    if V.element.basix_element.degree > 1:
        of_facets = S[at_vertices].mean(axis=1).reshape(len(nodes), S.shape[1] ** 2)
        S += _means(V, between, of_facets).reshape(S.shape)
    return Spreads(V, boundary, _with_images(S, mirrors), blur, mirrors)


def _rotations(
    V: fem.FunctionSpace, boundary: Boundary, u: fem.Function, mirrors: Bools, some: Longs
) -> Floats:
    """Return how surfaces have turned around some of the local nodes (s, d, d); collective.

    The rotations of the means of dx/dX over facets, normals being carried to normals.
    """
    at_X, facets = boundary.facets, boundary.at(u)
    middle = np.broadcast_to(at_X.element.points.mean(axis=0), (len(at_X.x), at_X.x.shape[2] - 1))
    G, N = surface_gradients(at_X, np.arange(len(at_X.x), dtype=np.int32), middle)
    F = np.swapaxes(facets.x, 1, 2) @ G + facet_normals(facets)[:, :, None] * N[:, None]
    d = F.shape[1]
    mean = _means(V, boundary.nodes, F.reshape(len(F), d * d)).reshape(-1, d, d)
    left, _, right = np.linalg.svd(_with_images(mean[some], mirrors[some]))
    return np.asarray(left @ right)


def _means(V: fem.FunctionSpace, nodes: Ints, values: Floats) -> Floats:
    """Return the means (local nodes, c) over facets at nodes (m, k) of values (m, c); collective.

    Zero at other nodes.
    """
    c = values.shape[1] + 1
    sums = la.vector(V.dofmap.index_map, c)
    sums.array[:] = 0.0
    at, each = sums.array.reshape(-1, c), np.column_stack([values, np.ones(len(values))])
    _add_at(at, nodes, each)
    sums.scatter_reverse(la.InsertMode.add)
    sums.scatter_forward()
    return np.asarray(at[:, :-1] / np.maximum(at[:, -1:], 1.0))


def _with_images(S: Floats, mirrors: Bools) -> Floats:
    """Return the means (n, d, d) of tensors and their images in planes of symmetry."""
    off = ~np.eye(S.shape[1], dtype=bool) & (mirrors[:, :, None] | mirrors[:, None])
    return np.where(off, 0.0, S)


def _covariances(V: fem.FunctionSpace, nodes: Ints, facets: Facets, mirrors: Bools) -> Floats:
    """Return S (local nodes, d, d) of facets at their nodes (m, k); collective."""
    n = facet_normals(facets)
    d = n.shape[1]
    products = (n[:, :, None] * n[:, None]).reshape(len(n), d * d)
    found = _means(V, nodes, np.hstack([n, products]))
    mean = np.where(mirrors, 0.0, found[:, :d])
    S = found[:, d:].reshape(-1, d, d) - mean[:, :, None] * mean[:, None]
    return _with_images(S, mirrors)


@numba.njit(cache=True)
def _add_at(sums, nodes, values):  # type: ignore[no-untyped-def]
    """Add values (m, c) of facets to sums (n, c) at their nodes (m, k)."""
    for i in range(nodes.shape[1]):
        for f in range(len(nodes)):
            for c in range(values.shape[1]):
                sums[nodes[f, i], c] += values[f, c]


@dataclass(frozen=True, eq=False)
class CommonNormals:
    """The normals at the owned slave nodes, and their derivatives by the averaged ones."""

    n: Floats  # (n, d)
    by_slave: Floats  # (n, d, d) by the averaged normal of the node
    by_master: Floats  # (n, d, d) by sum_l M_jl n_l

    def everywhere(self, slave: Surface) -> Floats:
        """Return the normals at all local slave nodes (n, d); collective."""
        local = np.zeros_like(slave.X)
        local[: slave.owned] = self.n
        return accumulate(slave, local)


def common_normals(
    pairing: Pairing,
    segments: Segments,
    M: Floats,
    u: fem.Function | None,
    spreads: Spreads,
    feature_angle: float,
) -> CommonNormals:
    """Return the normals of both sides at X + u; collective.

    Averaged ones where nothing is coupled, or where no direction agrees with both sides, as of a
    facet that overhangs the other side's corner.

    Args:
        segments: Those at X + u.
        M: Its entries (f,).
        feature_angle: Degrees between facets from which on they meet in an edge.
    """
    slave, master, V = pairing.slave, pairing.master, pairing.slave.V
    own, d = slave.nodes[: slave.owned], slave.X.shape[1]
    S, limit = spreads.at(u), np.sin(np.radians(feature_angle / 2)) ** 2
    across: Bools = spreads.mirrors[: V.dofmap.index_map.size_local]
    averaged = nodal_normals(slave, coordinates(slave, u))[: slave.owned]
    averaged, by_averaged = in_planes(averaged, across[own])
    nodes = master.nodes[: master.owned]
    n_m = nodal_normals(master, coordinates(master, u))[: master.owned]
    n_m, _ = in_planes(n_m, across[nodes])
    edged = np.trace(S, axis1=1, axis2=2) > limit / 2
    of_slave, of_master = (np.where(across, 0.0, v) for v in _facing(pairing, segments, u, edged))
    a = _of_side(averaged, of_slave[own], S[own], limit)
    upper = np.triu_indices(d)
    values = np.zeros((V.dofmap.index_map.size_local, d + 1 + len(upper[0])))
    values[nodes, :d] = _of_side(n_m, of_master[nodes], S[nodes], limit)
    values[nodes, d], values[nodes, d + 1 :] = 1.0, S[nodes][:, *upper]
    total = _products(pairing, M, values[:, : d + 1])[own]
    total = -np.sign(total[:, d:]) * total[:, :d]
    total = np.where(across[own], 0.0, total)
    size = np.linalg.norm(total, axis=1)
    b = unit(total)
    spread = _products(pairing, np.maximum(M, 0.0), values[:, d:])[own]
    S_b = np.empty((len(own), d, d))
    S_b[:, *upper] = spread[:, 1:] / np.maximum(spread[:, :1], TINY)
    S_b[:, *upper[::-1]] = S_b[:, *upper]
    mean, by_a, by_b = _mean(a, b, S[own], _with_images(S_b, across[own]))
    length = np.linalg.norm(mean, axis=1)
    towards = np.stack([(mean * v).sum(axis=1) for v in (a, b)])
    met = np.flatnonzero((size > 0.0) & (towards > HALF_OF_DIGITS).all(axis=0))
    n, by_slave = averaged.copy(), by_averaged.copy()
    by_master = np.zeros_like(by_slave)
    n[met] = unit(mean[met])
    turning = _across(n[met]) / length[met, None, None]
    by_slave[met] = turning @ by_a[met] @ by_averaged[met]
    by_master[met] = -turning @ by_b[met] @ _across(b[met]) / size[met, None, None]
    by_master = np.where(across[own, None], 0.0, by_master)
    return CommonNormals(n, by_slave, by_master)


def in_planes(n: Floats, mirrors: Bools) -> tuple[Floats, Floats]:
    """Return unit vectors n (n, d) without the components across planes, and their derivatives.

    (I - m m^T) P / |P n| with m = P n / |P n|; I where there is no plane, as dn is normal to n.
    """
    some: Ints = np.flatnonzero(mirrors.any(axis=1)).astype(np.int32)
    n, by_n = n.copy(), np.eye(n.shape[1])[None].repeat(len(n), axis=0)
    m = np.where(mirrors[some], 0.0, n[some])
    size = np.linalg.norm(m, axis=1)[:, None, None]
    n[some] = unit(m)
    by_m = _across(n[some]) / np.where(size > 0.0, size, np.inf)
    by_n[some] = np.where(mirrors[some, None], 0.0, by_m)
    return n, by_n


def _across(n: Floats) -> Floats:
    """Return I - n n^T (n, d, d) of unit vectors, or of zero."""
    return np.asarray(np.eye(n.shape[1]) - n[:, :, None] * n[:, None])


def _facing(
    pairing: Pairing, segments: Segments, u: fem.Function | None, which: Bools
) -> tuple[Floats, Floats]:
    """Return the sums of w N_j n_s and w N_l n_m over the points (owned nodes, d); collective.

    All of them at the nodes `which` (local nodes,), at others parts.
    """
    V, slave, master = pairing.slave.V, pairing.slave, pairing.master
    facets = facets_at(slave, coordinates(slave, u)), received_facets(pairing, u)
    numbers = V.dofmap.index_map.local_to_global(slave.nodes).astype(np.int64)
    flags = np.zeros_like(master.X)
    flags[:, 0] = which[master.nodes]
    received = receive(pairing, flags)[:, 0] > 0.0
    of_slave, of_master = slave.facets, pairing.master_facets
    sides = (
        (segments.slave, segments.xi_s, numbers[of_slave], which[slave.nodes][of_slave]),
        (segments.master, segments.xi_m, pairing.master_nodes[of_master], received[of_master]),
    )
    found = []
    for side, (on, xi, nodes, asked) in zip(facets, sides, strict=True):
        some = np.flatnonzero(asked[on].any(axis=1))
        on = on[some]
        N = np.clip(side.element.shape_functions(xi[some]), 0.0, None)
        N *= segments.weight[some, None]
        weights = sums_of_values(N, np.ones(len(on)), on, len(nodes))
        sums = weights[:, :, None] * facet_normals(side)[:, None]
        at = nodes.ravel(), sums.reshape(-1, sums.shape[2])
        found.append(sums_at_nodes(V.mesh.comm, V.dofmap.index_map, *at))
    return found[0], found[1]


def _of_side(averaged: Floats, facing: Floats, S: Floats, limit: float) -> Floats:
    """Return the normals (n, d) of one side.

    Args:
        averaged: (n, d).
        facing: Sums (n, d) over what faces the other side.
        S: (n, d, d).
        limit: Spread from which on facets meet in an edge; up to half of it the averaged one.
    """
    edged = np.flatnonzero(np.trace(S, axis1=1, axis2=2) > limit / 2)
    result, n, facing = averaged.copy(), averaged[edged], facing[edged]
    some = np.linalg.norm(facing, axis=1, keepdims=True) > 0.0
    c = np.where(some, unit(facing), n)
    Q = _across(n)
    widths, axes = np.linalg.eigh(Q @ S[edged] @ Q)
    smooth = np.clip(2.0 - 2.0 * widths / limit, 0.0, 1.0)
    K = Q @ (axes * smooth[:, None]) @ np.swapaxes(axes, 1, 2) @ Q
    result[edged] = unit(c - (K @ c[:, :, None])[:, :, 0])
    return result


def _products(pairing: Pairing, M: Floats, values: Floats) -> Floats:
    """Return sum_l M_jl v_l (owned nodes, c) for entries of M and values at nodes; collective."""
    matrix, result = pairing.M.matrix(M), np.empty_like(values)
    v, w = matrix.createVecs()
    for i, column in enumerate(values.T):
        v.array[:] = column
        matrix.mult(v, w)
        result[:, i] = w.array_r
    return result


def _mean(a: Floats, b: Floats, S_a: Floats, S_b: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the mean y (n, d) of unit vectors with given spreads, and its derivatives by them.

    With A and B = a a^T + S_a and b b^T + S_b, K = (A + B)^-1 and z = K (b - a),
    y = B K a + A K b = a + A K (b - a),
    dy = B K (da + dA z) + A K (db - dB z),
    dA = da a^T + a da^T + W S_a - S_a W with W = da a^T - a da^T: spreads turn with their normals.
    """
    one = np.eye(a.shape[1])
    A, B = (v[:, :, None] * v[:, None] + S for v, S in ((a, S_a), (b, S_b)))
    K = np.linalg.inv(A + B)
    z = (K @ (b - a)[:, :, None])[:, :, 0]
    turned = []
    for v, S in ((a, S_a), (b, S_b)):
        vz, Sz = v[:, :, None] * z[:, None], (S @ z[:, :, None])[:, :, 0]
        along, across = ((v * w).sum(axis=1)[:, None, None] for w in (z, Sz))
        turned.append(along * (one - S) + across * one + vz + S @ vz - v[:, :, None] * Sz[:, None])
    by_a, by_b = B @ K, A @ K
    y = a + (by_b @ (b - a)[:, :, None])[:, :, 0]
    return y, by_a @ (one + turned[0]), by_b @ (one - turned[1])

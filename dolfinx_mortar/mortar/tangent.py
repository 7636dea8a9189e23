# SPDX-License-Identifier: MIT
"""Derivatives of contact forces and weighted gaps by coordinates (theory.md, The exact tangent).

For tools H = -int N_j phi. Derivatives by the normals n_j, which depend on facets of other ranks,
are separate.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

import dolfinx
from dolfinx.common import timed
from dolfinx_mortar.algebra.csr import Blocks
from dolfinx_mortar.common.arrays import CHUNK, HALF_OF_DIGITS, TINY, Bools, Floats, Ints, Longs
from dolfinx_mortar.geometry import line
from dolfinx_mortar.geometry.curvature import edges as edges_of
from dolfinx_mortar.geometry.curvature import height_table, node_pairs
from dolfinx_mortar.geometry.facets import FacetElement, Facets, normals_at_nodes, surface_gradients
from dolfinx_mortar.geometry.moments import Sides, Sums, moments_in_space, whole
from dolfinx_mortar.geometry.segments import Segments
from dolfinx_mortar.geometry.tolerances import ROUND_OFF
from dolfinx_mortar.mortar.curvature_correction import Curved, SmoothSide, find_curved
from dolfinx_mortar.mortar.duals import Duals, absorbing, find_duals
from dolfinx_mortar.mortar.pairing import Pairing, received_facets
from dolfinx_mortar.mortar.surface import (
    Surface,
    coordinates,
    facets_at,
    nodal_normals,
    sum_at_nodes,
)


@dataclass(frozen=True, eq=False)
class Tractions:
    """Normals, offsets, and tractions as functions of the normals, at local slave nodes."""

    normals: Floats  # (n, d) n_j; zero without multiplier
    tractions: Floats  # (n, d) c_j = lambda_j n_j + tau_j
    changes: Floats  # (n, d, d) dc_j/dn_j
    offset: Floats  # (n,) o_l, which adds D_jl o_l to the weighted gaps


@dataclass(frozen=True, eq=False)
class Derivatives:
    """Derivatives of forces F, gaps G and b; sums of parts.

    Coordinates are those of the slave nodes, then of the received master nodes.
    """

    F_x: Sequence[Blocks]  # (d n + d nm, d n + d nm) by the coordinates
    F_n: Sequence[Blocks]  # (d n + d nm, d n) by the normals
    G_x: Sequence[Blocks]
    G_n: Sequence[Blocks]  # (n, d n)
    F_p: Sequence[Blocks] = ()  # (d n + d nm, d n) by the directions of projection (2D)
    G_p: Sequence[Blocks] = ()  # (n, d n)
    b_x: Sequence[Blocks] = ()  # (d n, d n + d nm) of b_j with fixed n_l
    b_p: Sequence[Blocks] = ()  # (d n, d n)


class _Surfaces(NamedTuple):
    heights: Sequence[Floats]  # see `create_points`; of facets (P, 0, 0)
    slopes: Floats  # (P, s, k + l, d) of c_ab, or of log chord lengths
    tables: tuple[Floats, Floats]  # (e, k, k) see `height_table`
    lengths: bool  # slopes are of lengths


def _add_motions_of_heights(sides: Sides, surfaces: _Surfaces, sums: Sums) -> None:
    (p, k, d), others = sides.x.shape, sides.x.shape[2] * (sides.x.shape[1] + sides.n.shape[1])
    if surfaces.lengths:
        rates = sums.chords
    else:
        both = zip((sums.E_s, sums.E_m), surfaces.tables, strict=True)
        rates = np.concatenate([np.tensordot(E, t, ((2, 3), (1, 2))) for E, t in both], axis=2)
    s = surfaces.slopes
    by_x = (rates @ s.reshape(*s.shape[:2], -1)).reshape(len(s), k, -1, d)
    by_x = by_x.transpose(0, 2, 3, 1)
    of, H = np.repeat(np.arange(p), np.diff(sides.start)), sums.changes[..., -1]
    np.add.at(H[:, : d * k].reshape(p, k, d, k), of, by_x[:, :k])
    np.add.at(H[:, others:].reshape(p, -1, d, k), (of[:, None], sides.place), by_x[:, k:])


def _differentiate(
    sides: Sides,
    surfaces: _Surfaces,
    types: tuple[FacetElement, FacetElement],
    basis: Basis,
    fixed: Fixed,
) -> Results:
    (k, d), (c, l) = sides.x.shape[1:], sides.place.shape  # noqa: E741
    others, lengths = d * (k + sides.n.shape[1]), c * surfaces.lengths
    moved, p, m = surfaces.slopes.size > 0, len(sides.x), sides.y.shape[1]
    E_s, E_m = (np.zeros((c * moved - lengths, k, v, v)) for v in (k, l))
    z, n = others + d * m, k + m + 1
    sums = Sums(np.zeros((p, k, n)), np.zeros((p, z, k, n)), E_s, E_m, np.zeros((lengths, k, 2)))
    find = line.moments if d == 2 else moments_in_space
    find(sides, surfaces.heights, types, sums)
    if moved:
        _add_motions_of_heights(sides, surfaces, sums)
    return apply(sums.values, sums.changes, basis, fixed, sides.x, sides.y, others)


def differentiate_whole(
    facets: Facets,
    xi: Floats,
    weights: Floats,
    phi: Floats,
    by_x: Floats,
    duals: Duals,
    c: Floats,
    offset: Floats,
) -> tuple[Floats, Floats, Floats]:
    """Derivatives dF (f, k, d, k, d), dg (f, k, k, d), and D (f, k, k) on facets below a tool.

    For weights (f, q) on the reference facet, distances phi (f, q) and derivatives by_x (f, q, k,
    d) at xi, tractions c (f, k, d), offsets (f, k).
    """
    (p, k, d), element, kept = facets.x.shape, facets.element, duals.kept
    T = absorbing(element.shares, kept)
    basis = Basis(T, duals.inverse, kept)
    fixed = Fixed(c, np.zeros((p, k, d)), np.zeros((p, 0, d)), offset)
    sums = whole(facets, xi, weights, phi, by_x)
    found = apply(*sums, basis, fixed, facets.x, np.empty((p, 0, d)), k * d)
    return found.F.reshape(p, k, d, k, d), found.G.reshape(p, k, k, d), found.D


@timed("~Mortar: derivatives")
def differentiate(
    pairing: Pairing,
    u: dolfinx.fem.Function,
    segments: Segments,
    keep: Bools,
    given: Tractions,
    smooth: tuple[SmoothSide, SmoothSide] | None = None,
    normals: Floats | None = None,
) -> Derivatives:
    """Derivatives of forces and weighted gaps at X + u (collective).

    Args:
        segments: of all slave facets or of some.
        keep: (n,) local slave nodes with a multiplier.
        smooth: smooth surfaces at X; None for facets.
        normals: n_l (nm, d) of the received master nodes; zero if None.
    """
    slave, master = pairing.slave, received_facets(pairing, u)
    x = coordinates(slave, u)
    facets, d, n = facets_at(slave, x), x.shape[1], len(x)
    directions = (
        nodal_normals(slave, x)[slave.facets] if d == 2 else np.zeros((len(facets.x), 0, 3))
    )
    used = np.unique(segments.pair)
    surfaces = _surfaces(pairing, u, smooth, used)
    duals = find_duals(pairing, segments, keep)
    factor = np.ones(slave.facets.shape)
    if pairing.weight is not None:
        factor = pairing.weight(slave.X)[slave.facets]
    normals = np.zeros_like(pairing.master_X) if normals is None else normals
    y = np.empty_like(pairing.master_X)
    y[pairing.master_facets] = master.x
    types = facets.element, master.element
    parts: dict[str, list[Blocks]] = {field.name: [] for field in fields(Derivatives)}
    for group in _groups(pairing, used):
        s = group.facets
        own = slave.facets[s]
        sides = Sides(
            facets.x[s],
            directions[s],
            y[group.nodes],
            group.start,
            group.place,
            pairing.deepest[used[group.pairs]],
            factor[s],
            np.zeros((len(s), 0)) if segments.reach is None else segments.reach[s],
        )
        kept = duals.kept[s]
        basis = Basis(absorbing(slave.element.shares, kept), duals.inverse[s], kept)
        of_nodes = given.tractions[own], given.normals[own], normals[group.nodes]
        fixed = Fixed(*of_nodes, given.offset[own])
        *heights, slopes = (v[group.pairs] for v in (*surfaces.heights, surfaces.slopes))
        some = surfaces._replace(heights=heights, slopes=slopes)
        found = _differentiate(sides, some, types, basis, fixed)
        _add_parts(parts, found, given, sides, own, n + group.nodes)
    return Derivatives(**parts)


def _surfaces(
    pairing: Pairing,
    u: dolfinx.fem.Function,
    smooth: tuple[SmoothSide, SmoothSide] | None,
    used: Ints,
) -> _Surfaces:
    slave, master = pairing.slave.element, pairing.master.element
    none: Floats = np.empty((len(used), 0, 0))
    heights, tables, lengths = 3 * (none,), (none, none), False
    slopes: Floats = np.empty((len(used), 0, slave.nodes + master.nodes, pairing.slave.X.shape[1]))
    if smooth is not None:
        a, b = find_curved(pairing, u, smooth, used)
        c_s, c_m, arcs = a.shared(b), b.shared(a), np.stack([a.arcs, b.arcs], axis=1)
        tables = height_table(slave, c_s.shape[1]), height_table(master, c_m.shape[1])
        Q_s, Q_m = (
            np.asarray(np.tensordot(c, t, 1)) for c, t in zip((c_s, c_m), tables, strict=True)
        )
        heights = Q_s, Q_m, arcs
        lengths, shared = bool(arcs[:, :, 0].any()), slave.degree == 1
        if shared or lengths:
            of_s, of_m = _slopes(a, b, shared), _slopes(b, a, shared)[::-1]
            slopes = np.concatenate([np.concatenate(of, axis=2) for of in (of_s, of_m)], axis=1)
    return _Surfaces(heights, slopes, tables, lengths)


def _slopes(side: Curved, other: Curved, shared: bool) -> tuple[Floats, Floats]:
    e, (a, b) = edges_of(side.facets), node_pairs(side.facets.element.first)
    (P, k, d), count = side.facets.x.shape, len(a)
    by_nodes, by_others = (
        np.zeros((P, count, k, d)),
        np.zeros((P, count, *other.facets.x.shape[1:])),
    )
    if shared:  # c_ab / 2 - e.K e / 2
        by_e, by_K = -e @ other.K, e[..., None] * e[:, :, None] / -2.0
        slopes = other.slopes.reshape(P, d * other.facets.x.shape[1], d * d).swapaxes(1, 2)
        by_others[:] = (by_K.reshape(P, count, d * d) @ slopes).reshape(by_others.shape)
    else:
        by_e = e / (e**2).sum(axis=2, keepdims=True)
    by_nodes[:, range(count), b] = by_e
    by_nodes[:, range(count), a] -= by_e
    return by_nodes, by_others


@dataclass(frozen=True, eq=False)
class _Group:
    """Slave facets with the same number of master nodes."""

    facets: Longs  # (p,)
    nodes: Ints  # (p, m) received
    pairs: Longs  # (P,) positions, ordered by facet
    start: Longs  # (p + 1,) first pair of each facet
    place: Longs  # (P, l) master facets' nodes among `nodes`


def _groups(pairing: Pairing, used: Ints) -> list[_Group]:
    s, m = pairing.pairs[used].T.astype(np.int64)
    nodes = pairing.master_facets[m].astype(np.int64)
    size = len(pairing.master_nodes)
    keys, place = np.unique(s[:, None] * size + nodes, return_inverse=True)
    facets, first, count = np.unique(keys // max(size, 1), return_index=True, return_counts=True)
    of = np.searchsorted(facets, s)
    place = place.reshape(nodes.shape) - first[of][:, None]
    groups = []
    for which in _parts(count, pairing):
        m, pairs = count[which[0]], np.flatnonzero(np.isin(of, which))
        start = np.searchsorted(s[pairs], np.append(facets[which], np.iinfo(np.int64).max))
        all_nodes = (keys % size)[first[which][:, None] + np.arange(m)]
        groups.append(_Group(facets[which], all_nodes.astype(np.int32), pairs, start, place[pairs]))
    return groups


def _parts(count: Longs, pairing: Pairing) -> Iterator[Longs]:
    k, d = pairing.slave.element.nodes, pairing.slave.X.shape[1]
    for m in np.unique(count):
        which = np.flatnonzero(count == m)
        rows = d * (2 * k + m) * k * len(which)
        yield from np.array_split(which, min(rows // CHUNK + 1, len(which)))


def _add_parts(
    parts: dict[str, list[Blocks]],
    found: Results,
    given: Tractions,
    sides: Sides,
    own: Ints,
    others: Ints,
) -> None:
    (_, k, d), lines = sides.x.shape, sides.n.shape[1]
    both = np.concatenate([own, others], axis=1)
    z = found.F.shape[-1]
    by_x = np.r_[0 : d * k, d * (k + lines) : z]
    by_p = np.arange(d * k, d * (k + lines))
    values = {"F": (both, found.F), "G": (own, found.G[:, :, None]), "b": (own, found.b)}
    for name, (rows, value) in values.items():
        for of, nodes, columns in (("x", both, by_x), ("p", own, by_p)):
            if len(columns):
                shape = *value.shape[:-1], nodes.shape[1], d
                block = Blocks(rows, nodes, value[..., columns].reshape(shape))
                parts[f"{name}_{of}"].append(block)
    by_c = np.concatenate([found.D, -found.M], axis=2)
    forces = np.einsum("pjr,pjih->prijh", by_c, given.changes[own])
    parts["F_n"].append(Blocks(both, own, forces))
    v = found.M @ sides.y - found.D @ sides.x
    gaps = v.reshape(-1, 1, 1, 1, d)
    each = own.reshape(-1, 1)  # gaps depend on their own node's normal
    parts["G_n"].append(Blocks(each, each, gaps))


class Basis(NamedTuple):
    """Dual functions of facets (p,)."""

    T: Floats  # (p, k, k)
    inverse: Floats  # (p, k, k) m^-1, 0 without multiplier
    kept: Bools  # (p, k)


class Fixed(NamedTuple):
    """Data that do not depend on the coordinates."""

    c: Floats  # (p, k, d)
    n: Floats  # (p, k, d)
    n_m: Floats  # (p, m, d) n_l
    offset: Floats  # (p, k)


class Results(NamedTuple):
    """Values, and derivatives by the z coordinates: slave facet, directions, masters."""

    F: Floats  # (p, k + m, d, z)
    G: Floats  # (p, k, z)
    b: Floats  # (p, k, d, z)
    D: Floats  # (p, k, k) values
    M: Floats  # (p, k, m)


def duals(S: Floats, dS: Floats, T: Floats, inverse: Floats, kept: Bools) -> tuple[Floats, Floats]:
    """Coefficients C (p, k, k), Phi_j = sum_b C_jb N_b, and changes (p, z, k, k), for S and dS.

    C = (A - mean of its rows) T + 1 / count, A = diag(d) m^-1, m = T S T^T, d = T S 1.
    """
    (p, z, k, _), V = dS.shape, inverse @ T
    part = kept / np.maximum(kept.sum(axis=1, keepdims=True), 1)
    AT = (T @ S).sum(axis=2)[:, :, None] * V
    # diag(dd) - A dm before m^-1, which may be large: no cancellation
    rates = np.eye(k)[:, :, None, None] * T[:, :, None, :, None]
    rates = rates - AT[:, :, None, :, None] * T[:, None, :, None]
    change = dS.reshape(p, z, k * k) @ rates.reshape(p, k * k, k * k).swapaxes(1, 2)
    dC = (change.reshape(p, z * k, k) @ V).reshape(dS.shape)
    dC -= part[:, None, :, None] * dC.sum(axis=2, keepdims=True)
    return AT - part[:, :, None] * (AT.sum(axis=1, keepdims=True) - 1.0), dC


def apply(
    moments: Floats,
    changes: Floats,
    basis: Basis,
    fixed: Fixed,
    x: Floats,
    y: Floats,
    others: int,
) -> Results:
    """Derivatives of facets with nodes x (p, k, d) and masters' nodes y (p, m, d).

    From S, R and H side by side (p, k, k + m + 1) and changes (p, z, k, k + m + 1) by the
    coordinates; `others` is the first of a master.
    """
    (p, k, d), m, (_, z, _, size) = x.shape, y.shape[1], changes.shape
    C, dC = duals(moments[:, :, :k], changes[..., :k], *basis)
    C *= basis.kept[:, :, None]  # unused rows
    DM, w = C @ moments, 2 * d + 1
    D, M = DM[:, :, :k], DM[:, :, k:-1]
    by_nodes = np.zeros((p, size, w))  # gaps of D and M, b, and C H - D o
    by_nodes[:, :k, :d], by_nodes[:, k:-1, :d] = -x, y
    by_nodes[:, k:-1, d:-1], by_nodes[:, -1, -1] = fixed.n_m, 1.0
    by_nodes[:, :k, -1] = -fixed.offset
    moved: Floats = (changes.reshape(p, z * k, size) @ by_nodes).reshape(p, z, k, w)
    moved = C[:, None] @ moved + dC @ (moments @ by_nodes)[:, None]
    G = np.einsum("pji,pzji->pjz", fixed.n, moved[..., :d]) - moved[..., -1].swapaxes(1, 2)
    G[:, :, : d * k] -= (D[:, :, :, None] * fixed.n[:, :, None]).reshape(p, k, k * d)
    G[:, :, others:] += (M[:, :, :, None] * fixed.n[:, :, None]).reshape(p, k, m * d)
    c = fixed.c.swapaxes(1, 2)
    by_C = ((c[:, None] @ dC).reshape(p, z * d, k) @ moments).reshape(p, z, d, size)
    F = (by_C + (c @ C)[:, None] @ changes)[..., :-1]
    F[..., k:] *= -1.0
    return Results(F.transpose(0, 3, 2, 1), G, moved[..., d:-1].transpose(0, 2, 3, 1), D, M)


def normal_derivatives(surface: Surface, x: Floats) -> Floats:
    """Terms (m, k, d, k, d) of facets in the derivatives of nodal normals (collective).

    [f, j, :, l, :] is the change of n_j with x_l by facet f: dn_j = -(I - n_j n_j^T) / |S| sum_f
    G_l (n_f.dx_l), with surface gradients G_l at node j and S = sum_f n_f.
    """
    facets = facets_at(surface, x)
    at_nodes = normals_at_nodes(facets)
    total = sum_at_nodes(surface, at_nodes)
    size = np.linalg.norm(total, axis=1)
    n = total / np.maximum(size, TINY)[:, None]
    across = np.where((size > 8 * ROUND_OFF)[:, None, None], np.eye(x.shape[1]), 0.0)
    across = (across - n[:, :, None] * n[:, None, :]) / np.maximum(size, ROUND_OFF)[:, None, None]
    gradients = _gradients_at_nodes(facets)
    turned = -np.einsum("mjia,mjla->mjil", across[surface.facets], gradients)
    return turned[..., None] * at_nodes[:, :, None, None]


def _gradients_at_nodes(facets: Facets) -> Floats:
    """Surface gradients [f, j, l] of N_l at node j."""
    m, k, d = facets.x.shape
    which = np.repeat(np.arange(m, dtype=np.int32), k)
    points = np.tile(facets.element.normal_points, (m, 1))
    gradients, _ = surface_gradients(facets, which, points)
    return gradients.reshape(m, k, k, d)


def carrying(surface: Surface, x: Floats, n: Floats, vectors: Floats) -> Floats:
    """Coefficients W (m, k, k), by which tangential v_j (n, d) move with the surface; collective.

    sum_f sum_l W_fjl x_l over the facets of node j is v_j up to a part along n_j: the mean of F_f
    a_j with the deformation gradients F_f = sum_l x_l grad N_l^T. Zero where n_j is, or without a
    common tangent.
    """
    facets, d = facets_at(surface, x), x.shape[1]
    n_f = normals_at_nodes(facets)
    tangents = np.eye(d) - n_f[:, :, :, None] * n_f[:, :, None]
    one = np.ones((*surface.facets.shape, 1))
    columns = np.concatenate([tangents.reshape(*surface.facets.shape, d * d), one], axis=2)
    total = sum_at_nodes(surface, columns)
    count = np.maximum(total[:, -1], 1.0)
    mean = total[:, :-1].reshape(-1, d, d) / count[:, None, None]
    along = n[:, :, None] * n[:, None]
    across = np.eye(d) - along
    whole = across @ mean @ across + along
    some = (np.linalg.det(whole) > HALF_OF_DIGITS) & n.any(axis=1)
    whole[~some] = np.eye(d)
    a = np.where(some[:, None], np.linalg.solve(whole, vectors[:, :, None])[:, :, 0], 0.0)
    a /= count[:, None]
    return np.einsum("mjld,mjd->mjl", _gradients_at_nodes(facets), a[surface.facets])

# SPDX-License-Identifier: MIT
"""Derivatives of contact forces and weighted gaps by the coordinates of both sides.

Those of the moments of slave facets are those of `geometry.moments`, all others follow by the
`product_rule`. Those by the normals n_j, and of these by the coordinates, are apart: they
may depend on facets of other ranks.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from typing import NamedTuple

import numba
import numpy as np

import dolfinx
from dolfinx.common import timed
from dolfinx_mortar.algebra.block_sums import Blocks
from dolfinx_mortar.arrays import CHUNK, EPS, Bools, Floats, Ints, Longs
from dolfinx_mortar.geometry import area, line
from dolfinx_mortar.geometry.curvature import (
    fill_curvature,
    fill_heights,
    height_element,
    height_table,
    node_pairs,
)
from dolfinx_mortar.geometry.facets import Facets
from dolfinx_mortar.geometry.moments import (
    KERNEL,
    Sums,
    add_whole,
    fill_turns,
    gather,
)
from dolfinx_mortar.geometry.segments import Segments
from dolfinx_mortar.mortar import edges
from dolfinx_mortar.mortar.curvature_correction import SmoothSide, pair_sagittas
from dolfinx_mortar.mortar.duals import Duals, absorbing, find_duals
from dolfinx_mortar.mortar.edges import Sharing, widest_openings
from dolfinx_mortar.mortar.pairing import Pairing, received_facets
from dolfinx_mortar.mortar.product_rule import Basis, Fixed, Results, apply
from dolfinx_mortar.mortar.surface import coordinates, facets_at, nodal_normals

STEP = EPS * EPS
"""Imaginary part of a coordinate, whose square is nothing beside round-off (complex step: Squire
and Trapp, SIAM Review 40, 1998)."""


@dataclass(frozen=True, eq=False)
class Tractions:
    """Constraint normals and tractions at the local slave nodes, as functions of the normals."""

    normals: Floats  # (n, d) n_j of gaps; zero where no multiplier is carried
    tractions: Floats  # (n, d) c_j
    changes: Floats  # (n, d, d) dc_j/dn_j


@dataclass(frozen=True, eq=False)
class Derivatives:
    """Derivatives of the part of forces F, gaps G and b that this rank's slave facets have.

    Rows of F belong to the coordinates of the slave nodes, then of the received master nodes. Each
    is the sum of parts.
    """

    F_x: Sequence[Blocks]  # (d n + d nm, d n + d nm) by the coordinates of the same nodes
    F_n: Sequence[Blocks]  # (d n + d nm, d n) by the normals of contact
    G_x: Sequence[Blocks]  # (n, d n + d nm)
    G_n: Sequence[Blocks]  # (n, d n)
    F_p: Sequence[Blocks] = ()  # (d n + d nm, d n) by the directions of projection in the plane
    G_p: Sequence[Blocks] = ()  # (n, d n)
    b_x: Sequence[Blocks] = ()  # (d n, d n + d nm) of b_j with fixed n_l
    b_p: Sequence[Blocks] = ()  # (d n, d n)


class _Sides(NamedTuple):
    """Slave facets (p,) and the master facets (P,) that they face, those of a facet together."""

    x: Floats  # (p, k, d)
    n: Floats  # (p, k, 2) directions of projection; (p, 0, 3) in space
    y: Floats  # (p, m, d) the different nodes of the masters
    start: Longs  # (p + 1,)
    place: Longs  # (P, l) nodes of the masters among y
    deepest: Floats  # (P,)
    factor: Floats  # (p, k) weight of the integrals at the nodes
    partly: Longs  # (p,) node with the widest opening where it matters, else -1
    reach: Floats  # (p, 2) see `Segments`; (p, 0) where weights fall nowhere


class _Surfaces(NamedTuple):
    """Heights of smooth surfaces."""

    c_s: Floats  # (P, e) c_ab; (P, 0) without
    c_m: Floats  # (P, e')
    arcs: Floats  # (P, 2, 2) see `moments.add_point`
    shared: bool  # whether both sides share one surface
    table_s: Floats  # (e, k, k)
    table_m: Floats
    pairs_s: Longs  # (2, e) pairs of nodes
    pairs_m: Longs
    corners: tuple[int, int]


@numba.njit(**KERNEL)
def _fill_heights(x, y, c_s, c_m, surfaces, Q_s, Q_m):  # type: ignore[no-untyped-def]
    """Write Q of the heights N.Q N over a slave facet (k, d) and a master (l, d) with such c_ab."""
    p_s, p_m, d = surfaces.pairs_s, surfaces.pairs_m, x.shape[1]
    K_s, K_m = np.zeros((d, d), x.dtype), np.zeros((d, d), y.dtype)
    if surfaces.shared:
        fill_curvature(x, surfaces.corners[0], c_s, p_s[0], p_s[1], K_s)
        fill_curvature(y, surfaces.corners[1], c_m, p_m[0], p_m[1], K_m)
    fill_heights(x, c_s, surfaces.shared, K_m, p_s[0], p_s[1], surfaces.table_s, Q_s)
    fill_heights(y, c_m, surfaces.shared, K_s, p_m[0], p_m[1], surfaces.table_m, Q_m)


@numba.njit(**KERNEL)
def _fill_all_heights(sides, surfaces, heights):  # type: ignore[no-untyped-def]
    """Write the heights of all pairs."""
    Q_s, Q_m, _ = heights
    y = np.empty((sides.place.shape[1], sides.x.shape[2]))
    for f in range(len(sides.x)):
        for r in range(sides.start[f], sides.start[f + 1]):
            gather(sides.y[f], sides.place[r], y)
            c_ab = surfaces.c_s[r], surfaces.c_m[r]
            _fill_heights(sides.x[f], y, *c_ab, surfaces, Q_s[r], Q_m[r])


@numba.njit(**KERNEL)
def _add_motions_of_heights(sides, surfaces, sums):  # type: ignore[no-untyped-def]
    """Add the derivatives of H by those of the heights' Q, taken by the complex step."""
    (k, d), (_, l), m = sides.x.shape[1:], sides.place.shape, sides.y.shape[1]  # noqa: E741
    others, last = d * (k + sides.n.shape[1]), k + m
    x, y = np.empty((k, d), np.complex128), np.empty((l, d), np.complex128)
    Q_s, Q_m = np.empty((k, k), x.dtype), np.empty((l, l), x.dtype)
    for f in range(len(sides.x)):
        for z in range(d * k):
            x[z // d, z % d] = sides.x[f, z // d, z % d]
        for r in range(sides.start[f], sides.start[f + 1]):
            gather(sides.y[f], sides.place[r], y)
            for z in range(d * (k + l)):
                a, i = z // d, z % d
                at, node = (x, a) if a < k else (y, a - k)
                at[node, i] += 1j * STEP
                _fill_heights(x, y, surfaces.c_s[r], surfaces.c_m[r], surfaces, Q_s, Q_m)
                at[node, i] = at[node, i].real
                by = z if a < k else others + d * sides.place[r, node] + i
                for j in range(k):
                    change = _product(sums.E_s, r, j, Q_s) + _product(sums.E_m, r, j, Q_m)
                    sums.changes[f, by, j, last] += change / STEP


@numba.njit(**KERNEL)
def _add_motions_of_chords(sides, sums):  # type: ignore[no-untyped-def]
    """Add the derivatives of H by the lengths of the chords of arcs, whose vertices are first."""
    (k, d), m = sides.x.shape[1:], sides.y.shape[1]
    for f in range(len(sides.x)):
        for r in range(sides.start[f], sides.start[f + 1]):
            for side in range(2):
                nodes = sides.x[f] if side == 0 else sides.y[f]
                a, b = (0, 1) if side == 0 else (sides.place[r, 0], sides.place[r, 1])
                first, square = (0 if side == 0 else d * (k + sides.n.shape[1])), 0.0
                for i in range(d):
                    square += (nodes[b, i] - nodes[a, i]) ** 2
                for i in range(d):
                    rate = (nodes[b, i] - nodes[a, i]) / square
                    for j in range(k):
                        change = rate * sums.chords[r, j, side]
                        sums.changes[f, first + d * b + i, j, k + m] += change
                        sums.changes[f, first + d * a + i, j, k + m] -= change


@numba.njit(**KERNEL)
def _product(E, r, j, Q):  # type: ignore[no-untyped-def]
    """Return the sum of E[r, j] times the imaginary part of Q."""
    total = 0.0
    for a in range(len(Q)):
        for b in range(len(Q)):
            total += E[r, j, a, b] * Q[a, b].imag
    return total


@numba.njit(**KERNEL)
def _fill_shares(f, sides, corners, sunk, sums, shares):  # type: ignore[no-untyped-def]
    """Write the derivatives (z,) of 1 - o_j / (sunk L), see `edges`, of facet f.

    Args:
        f: the facet.
        sides: all facets.
        corners: of a slave facet.
        sunk: of `edges`.
        sums: (1, ..) moments of the positive part of N_j.
        shares: the result.
    """
    x, y, j, row = sides.x[f], sides.y[f], sides.partly[f], sums.values[0, sides.partly[f]]
    (k, d), m, weight = x.shape, len(y), row[: len(x)].sum()
    others, turns = d * (k + sides.n.shape[1]), np.empty((corners, d))
    axis, n, gap, middle = np.zeros(d), np.zeros(d), np.zeros(d), np.zeros(d)
    for i in range(d):
        axis[i] = 1.0
        n[i] = fill_turns(axis, x[:corners], turns)
        axis[i] = 0.0
        gap[i] = (row[k : k + m] * y[:, i]).sum() - (row[:k] * x[:, i]).sum()
        middle[i] = x[:, i].sum() / k
    far = ((x - middle) ** 2).sum(axis=1).argmax()
    offset = x[far] - middle
    square = (offset**2).sum()
    scale = 1.0 / (weight * sunk * 2.0 * np.sqrt(square))
    opening = scale * fill_turns(gap, x[:corners], turns)
    for z in range(len(shares)):
        change, own = sums.changes[0, z, j], d * k > z
        a, i = (z if own else z - others) // d, z % d
        shares[z] = opening * change[:k].sum() / weight
        for h in range(d):
            moved = (change[k : k + m] * y[:, h]).sum() - (change[:k] * x[:, h]).sum()
            shares[z] -= scale * n[h] * moved
        if own:
            shares[z] += scale * row[a] * n[i]
            shares[z] += opening * offset[i] * ((a == far) - 1.0 / k) / square
            shares[z] -= scale * turns[a, i] if a < corners else 0.0
        elif z >= others:
            shares[z] -= scale * row[k + a] * n[i]


def _differentiate(
    sides: _Sides, surfaces: _Surfaces, tables: NamedTuple, basis: Basis, fixed: Fixed
) -> Results:
    """Return the derivatives of all facets."""
    (p, k, d), m, (c, l) = sides.x.shape, sides.y.shape[1], sides.place.shape  # noqa: E741
    of, others, smooth = (
        (line if d == 2 else area),
        d * (k + sides.n.shape[1]),
        surfaces.c_s.size > 0,
    )
    z = others + d * m
    heights = np.empty((c * smooth, k, k)), np.empty((c * smooth, l, l)), surfaces.arcs
    E_s, E_m = (np.zeros((c * (smooth and surfaces.shared), k, v, v)) for v in (k, l))
    chords = np.zeros((c * bool(smooth and surfaces.arcs[:, :, 0].any()), k, 2))
    sums = Sums(np.zeros((p, k, k + m + 1)), np.zeros((p, z, k, k + m + 1)), E_s, E_m, chords)
    at = sides.place, sides.deepest
    if smooth:
        _fill_all_heights(sides, surfaces, heights)
    given = sides.reach, sides.factor, heights
    of.moments(sides.x, sides.n, sides.y, sides.start, *at, *given, False, tables, sums)
    if len(E_s):
        _add_motions_of_heights(sides, surfaces, sums)
    if len(chords):
        _add_motions_of_chords(sides, sums)
    shares = np.zeros((p, z))
    for f in np.flatnonzero(sides.partly >= 0):
        one = slice(f, f + 1)
        empty = np.zeros_like(sums.values[one]), np.zeros_like(sums.changes[one])
        part = Sums(*empty, E_s[:0], E_m[:0], chords[:0])
        given = sides.reach[one], sides.factor[one], heights
        where = sides.x[one], sides.n[one], sides.y[one], sides.start[f : f + 2]
        of.moments(*where, *at, *given, True, tables, part)
        _fill_shares(f, sides, surfaces.corners[0], edges.SUNK, part, shares[f])
    return apply(sums.values, sums.changes, basis, shares, fixed, sides.x, sides.y, others)


def differentiate_whole(
    facets: Facets, xi: Floats, weights: Floats, phi: Floats, by_x: Floats, duals: Duals, c: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return dF (f, k, d, k, d), dg (f, k, k, d) and D (f, k, k) on whole facets, below a tool.

    Args:
        facets: (f,) at X + u.
        xi: (q, d-1) points of a rule.
        weights: (f, q) its weights on the reference facet, times the factor of the integrals.
        phi: (f, q) distances.
        by_x: (f, q, k, d) their derivatives by the places of the nodes.
        duals: of the facets.
        c: (f, k, d) tractions.
    """
    (p, k, d), element, kept = facets.x.shape, facets.element, duals.kept
    T = absorbing(element.shares, kept)
    basis = Basis(T[:, None], duals.inverse[:, None], kept[:, None], np.ones(p))
    fixed = Fixed(c, np.zeros((p, k, d)), np.zeros((p, 0, d)))
    rule = tuple(
        np.ascontiguousarray(f(xi)) for f in (element.shape_functions, element.derivatives)
    )
    size = k * d
    moments, changes = np.zeros((p, k, k + 1)), np.zeros((p, size, k, k + 1))
    add_whole(facets.x, by_x, rule, weights, phi, moments, changes)
    shares, y = np.zeros((p, size)), np.empty((p, 0, d))
    found = apply(moments, changes, basis, shares, fixed, facets.x, y, size)
    return found.F.reshape(p, k, d, k, d), found.G.reshape(p, k, k, d), found.D


@timed("~Mortar: derivatives")
def differentiate(
    pairing: Pairing,
    u: dolfinx.fem.Function,
    segments: Segments,
    keep: Bools,
    given: Tractions,
    smooth: tuple[SmoothSide, SmoothSide] | None = None,
    sharing: Sharing | None = None,
    normals: Floats | None = None,
) -> Derivatives:
    """Return the derivatives of forces and weighted gaps at X + u (collective).

    Args:
        pairing: The pair of surfaces.
        segments: Its segments at X + u, of all slave facets or of some.
        keep: Local slave nodes (n,) that carry a multiplier.
        given: Normals and tractions.
        smooth: Smooth surfaces at X; None for facets.
        sharing: What is shared out beside edges; None without.
        normals: n_l (nm, d) of the received master nodes; zero if not given.
    """
    slave, master = pairing.slave, received_facets(pairing, u)
    x = coordinates(slave, u)
    facets, d, n = facets_at(slave, x), x.shape[1], len(x)
    directions = (
        nodal_normals(slave, x)[slave.facets] if d == 2 else np.zeros((len(facets.x), 0, 3))
    )
    used = np.unique(segments.pair)
    surfaces = _surfaces(pairing, u, smooth, used)
    bases = [find_duals(pairing, segments, keep)]
    closed: Floats = np.ones(len(facets.x))
    partly: Longs = np.full(len(facets.x), -1)
    if sharing is not None:
        bases.append(find_duals(pairing, segments, keep | sharing.silent))
        closed, partly = sharing.closed, widest_openings(pairing, segments, u, sharing)
    factor = np.ones(slave.facets.shape)
    if pairing.weight is not None:
        factor = pairing.weight(slave.X)[slave.facets]
    normals = np.zeros_like(pairing.master_X) if normals is None else normals
    y = np.empty_like(pairing.master_X)
    y[pairing.master_facets] = master.x
    types = facets.element, master.element
    tables = (line if d == 2 else area).tables(*types, surfaces.c_s.shape[1] > 0)
    parts: dict[str, list[Blocks]] = {field.name: [] for field in fields(Derivatives)}
    for group in _groups(pairing, used):
        s = group.facets
        own = slave.facets[s]
        sides = _Sides(
            facets.x[s],
            directions[s],
            y[group.nodes],
            group.start,
            group.place,
            pairing.deepest[used[group.pairs]],
            factor[s],
            partly[s],
            np.zeros((len(s), 0)) if segments.reach is None else segments.reach[s],
        )
        basis = Basis(
            np.stack([absorbing(slave.element.shares, one.kept[s]) for one in bases], axis=1),
            np.stack([one.inverse[s] for one in bases], axis=1),
            np.stack([one.kept[s] for one in bases], axis=1),
            closed[s],
        )
        fixed = Fixed(given.tractions[own], given.normals[own], normals[group.nodes])
        found = _differentiate(sides, _some(surfaces, group.pairs), tables, basis, fixed)
        _add_parts(parts, found, given, sides, own, n + group.nodes)
    return Derivatives(**parts)


def _surfaces(
    pairing: Pairing,
    u: dolfinx.fem.Function,
    smooth: tuple[SmoothSide, SmoothSide] | None,
    used: Ints,
) -> _Surfaces:
    """Return the heights of pairs (P,); collective."""
    slave, master = pairing.slave.element, pairing.master.element
    c_s: Floats = np.empty((len(used), 0))
    c_m, arcs = c_s, np.empty((len(used), 2, 2))
    if smooth is not None:
        c_s, c_m, arcs[:] = pair_sagittas(pairing, u, smooth, used)
    of_s, of_m = height_element(slave, c_s), height_element(master, c_m)
    return _Surfaces(
        c_s,
        c_m,
        arcs,
        slave.degree == 1,
        height_table(slave, c_s.shape[1]),
        height_table(master, c_m.shape[1]),
        np.array(node_pairs(of_s), dtype=np.int64),
        np.array(node_pairs(of_m), dtype=np.int64),
        (len(slave.vertices), len(master.vertices)),
    )


def _some(surfaces: _Surfaces, pairs: Longs) -> _Surfaces:
    """Return the heights of some pairs."""
    c_s, c_m, arcs = (np.ascontiguousarray(v[pairs]) for v in surfaces[:3])
    return surfaces._replace(c_s=c_s, c_m=c_m, arcs=arcs)


@dataclass(frozen=True, eq=False)
class _Group:
    """Slave facets with as many different master nodes each."""

    facets: Longs  # (p,)
    nodes: Ints  # (p, m) nodes that have been received
    pairs: Longs  # (P,) positions of their pairs among all, those of a facet together
    start: Longs  # (p + 1,) those of a facet
    place: Longs  # (P, l) nodes of the master facets among those of the slave facet


def _groups(pairing: Pairing, used: Ints) -> list[_Group]:
    """Return the groups of the slave facets of some pairs, which are ordered by these."""
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
    """Return facets with as many master nodes each, as many as fit into some MB."""
    k, d = pairing.slave.element.nodes, pairing.slave.X.shape[1]
    for m in np.unique(count):
        which = np.flatnonzero(count == m)
        rows = d * (2 * k + m) * k * len(which)
        yield from np.array_split(which, min(rows // CHUNK + 1, len(which)))


def _add_parts(
    parts: dict[str, list[Blocks]],
    found: Results,
    given: Tractions,
    sides: _Sides,
    own: Ints,
    others: Ints,
) -> None:
    """Add the derivatives of a group of facets with nodes (p, k) and (p, m) to the parts."""
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
    each = own.reshape(-1, 1)  # a gap depends on the normal of its own node
    parts["G_n"].append(Blocks(each, each, gaps))

# SPDX-License-Identifier: MIT
"""Derivatives of contact forces and weighted gaps by the coordinates of both sides.

Those of the moments of slave facets are taken by the complex step (`geometry.moments`), all others
by the `product_rule`. Those by the normals n_j, and of these by the coordinates, are apart: they
may depend on facets of other ranks.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import NamedTuple

import numba
import numpy as np

import dolfinx
from dolfinx.common import timed
from dolfinx_mortar.algebra.block_sums import Blocks
from dolfinx_mortar.arrays import Bools, Floats, Ints, Longs
from dolfinx_mortar.geometry import area, line
from dolfinx_mortar.geometry.curvature import (
    fill_curvature,
    fill_heights,
    height_element,
    height_table,
    node_pairs,
)
from dolfinx_mortar.geometry.facets import Facets
from dolfinx_mortar.geometry.moments import KERNEL, STEP, add_whole
from dolfinx_mortar.geometry.plane import fill_axes
from dolfinx_mortar.geometry.segments import Segments
from dolfinx_mortar.mortar import edges
from dolfinx_mortar.mortar.curvature_correction import SmoothSide, pair_sagittas
from dolfinx_mortar.mortar.duals import Duals, absorbing, find_duals
from dolfinx_mortar.mortar.edges import Sharing, widest_openings
from dolfinx_mortar.mortar.pairing import Pairing, received_facets
from dolfinx_mortar.mortar.product_rule import Basis, Fixed, Results, all_duals, apply, clear, move
from dolfinx_mortar.mortar.surface import coordinates, facets_at, nodal_normals


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
def _fill_normal(x, corners, n):  # type: ignore[no-untyped-def]
    """Write the mean normal of a facet into the last row of n (3, 3)."""
    if x.shape[1] > 2:
        fill_axes(x[:corners], 1.0, n)
        return
    t0, t1 = x[1, 0] - x[0, 0], x[1, 1] - x[0, 1]
    length = np.sqrt(t0 * t0 + t1 * t1)
    n[2, 0], n[2, 1] = t1 / length, -t0 / length


@numba.njit(**KERNEL)
def _fill_reach(x, corners, given, reach):  # type: ignore[no-untyped-def]
    """Write what `moments.add_point` needs into reach (d + 2,), if there is any."""
    if len(reach):
        n = np.empty((3, 3), x.dtype)
        _fill_normal(x, corners, n)
        reach[0], reach[1] = given[0], given[1]
        for i in range(x.shape[1]):
            reach[2 + i] = n[2, i]


@numba.njit(**KERNEL)
def _share(x, y, S, R, j, corners, sunk):  # type: ignore[no-untyped-def]
    """Return 1 - o_j / (sunk L), see `edges`, from the moments of the positive part of N_j."""
    k, d = x.shape
    n = np.empty((3, 3), x.dtype)
    _fill_normal(x, corners, n)
    weight, gap, size = 0.0 * x[0, 0], 0.0 * x[0, 0], 0.0 * x[0, 0]
    for a in range(k):
        weight, square = weight + S[j, a], 0.0 * x[0, 0]
        for i in range(d):
            gap -= S[j, a] * x[a, i] * n[2, i]
            offset = x[a, i]
            for b in range(k):
                offset -= x[b, i] / k
            square += offset * offset
        size = square if square.real > size.real else size
    for a in range(len(y)):
        for i in range(d):
            gap += R[j, a] * y[a, i] * n[2, i]
    return 1.0 - gap / (weight * sunk * 2.0 * np.sqrt(size))


@numba.njit(**KERNEL)
def _fill_heights(x, Y, which, surfaces, heights):  # type: ignore[no-untyped-def]
    """Write the heights over a slave facet and masters Y (c, l, d), see `moments.add_point`."""
    Q_s, Q_m, arcs = heights
    p_s, p_m, shared, d = surfaces.pairs_s, surfaces.pairs_m, surfaces.shared, x.shape[1]
    K = np.zeros((2, d, d), x.dtype)
    for r in range(len(Q_s)):
        c_s, c_m = surfaces.c_s[which[r]], surfaces.c_m[which[r]]
        if shared:
            fill_curvature(x, surfaces.corners[0], c_s, p_s[0], p_s[1], K[0])
            fill_curvature(Y[r], surfaces.corners[1], c_m, p_m[0], p_m[1], K[1])
        fill_heights(x, c_s, shared, K[1], p_s[0], p_s[1], surfaces.table_s, Q_s[r])
        fill_heights(Y[r], c_m, shared, K[0], p_m[0], p_m[1], surfaces.table_m, Q_m[r])
        for i in range(2):
            for j in range(2):
                arcs[r, i, j] = surfaces.arcs[which[r], i, j]


@numba.njit(**KERNEL)
def _at_node(place, first, last, node, some):  # type: ignore[no-untyped-def]
    """Write the pairs from first to last whose masters have a node (-1: all); return the count."""
    count = 0
    for r in range(first, last):
        has = node < 0
        for a in range(place.shape[1]):
            has = has or place[r, a] == node
        if has:
            some[count], count = r, count + 1
    return count


@numba.njit(**KERNEL)
def _parts(S, R, H, dS, dR, dH):  # type: ignore[no-untyped-def]
    """Write the derivatives that complex moments hold."""
    for i in range(R.shape[0]):
        dH[i] = H[i].imag / STEP
        for j in range(R.shape[0]):
            dS[i, j] = S[i, j].imag / STEP
        for j in range(R.shape[1]):
            dR[i, j] = R[i, j].imag / STEP


@numba.njit(**KERNEL)
def _real(S, R, H, S0, R0, H0):  # type: ignore[no-untyped-def]
    """Write the real parts of moments."""
    for i in range(R.shape[0]):
        H0[i] = H[i].real
        for j in range(R.shape[0]):
            S0[i, j] = S[i, j].real
        for j in range(R.shape[1]):
            R0[i, j] = R[i, j].real


@numba.njit(**KERNEL)
def _coordinate(sides, f, a, i):  # type: ignore[no-untyped-def]
    """Return coordinate i of node, direction or master's node a of facet f."""
    k, lines = sides.x.shape[1], sides.n.shape[1]
    if a < k:
        return sides.x[f, a, i]
    return sides.n[f, a - k, i] if a < k + lines else sides.y[f, a - k - lines, i]


def _moments(x, n, Y, deepest, reach, factor, heights, positive, tables, S, R, H):  # type: ignore[no-untyped-def]
    """Return `line.moments` or `area.moments`, by the type of their tables."""
    of = line if isinstance(tables, line.Tables) else area
    return of.moments(x, n, Y, deepest, reach, factor, heights, positive, tables, S, R, H)


@numba.extending.overload(_moments)
def _of_dimension(x, n, Y, deepest, reach, factor, heights, positive, tables, S, R, H):  # type: ignore[no-untyped-def]
    """Return what is compiled."""
    return (line if tables.instance_class is line.Tables else area).moments.py_func


@numba.njit(**KERNEL)
def _evaluate(v, f, some, sides, surfaces, tables, positive, S, R, H):  # type: ignore[no-untyped-def]
    """Write the moments of facet f and some of its masters at v; R (k, m) by their nodes."""
    k, lines, c, smooth = len(S), sides.n.shape[1], len(some), surfaces.c_s.shape[1] > 0
    x, n, l_m, d = v[:k], v[k : k + lines], sides.place.shape[1], v.shape[1]
    Y, each = np.empty((c, l_m, d), v.dtype), np.zeros((c, k, l_m), v.dtype)
    Q_s, Q_m = np.empty((c * smooth, k, k), v.dtype), np.empty((c * smooth, l_m, l_m), v.dtype)
    heights, deepest = (Q_s, Q_m, np.empty((c * smooth, 2, 2))), np.empty(c)
    clear(S)
    clear(R)
    for j in range(k):
        H[j] = 0.0
    for r in range(c):
        deepest[r] = sides.deepest[some[r]]
        for a in range(l_m):
            for i in range(d):
                Y[r, a, i] = v[k + lines + sides.place[some[r], a], i]
    _fill_heights(x, Y, some, surfaces, heights)
    reach = np.empty(sides.reach.shape[1] // 2 * (d + 2), v.dtype)
    _fill_reach(x, surfaces.corners[0], sides.reach[f], reach)
    at = reach, sides.factor[f], heights, positive, tables
    hidden = _moments(x, n, Y, deepest, *at, S, each, H)
    for r in range(c):
        for a in range(l_m):
            for j in range(k):
                R[j, sides.place[some[r], a]] += each[r, j, a]
    return hidden


@numba.njit(**KERNEL)
def _differentiate(sides, surfaces, tables, basis, fixed, sunk, found):  # type: ignore[no-untyped-def]
    """Write the derivatives of all facets."""
    (p, k, d), lines, m = sides.x.shape, sides.n.shape[1], sides.y.shape[1]
    size, v = d * (k + lines + m), np.empty((k + lines + m, d), np.complex128)
    S, R, H = np.empty((k, k), v.dtype), np.empty((k, m), v.dtype), np.empty(k, v.dtype)
    S0, R0, H0 = np.empty((k, k)), np.empty((k, m)), np.empty(k)
    dS, dR, dH = np.empty((size, k, k)), np.empty((size, k, m)), np.empty((size, k))
    C, dC, shares = np.empty((k, k)), np.empty((size, k, k)), np.zeros(size)
    every = np.empty(len(sides.place), np.int64)
    for f in range(p):
        first, last, hidden = sides.start[f], sides.start[f + 1], False
        for z in range(size):
            v[z // d, z % d] = _coordinate(sides, f, z // d, z % d)
        for z in range(size):
            a, node, shares[z] = z // d, -1, 0.0
            if a >= k + lines and not hidden:  # pairs do not know of each other
                node = a - k - lines
            v[a, z % d] += 1j * STEP
            for positive in range(2 if sides.partly[f] >= 0 else 1):
                count = _at_node(sides.place, first, last, -1 if positive else node, every)
                # fmt: off
                hidden = _evaluate(v, f, every[:count], sides, surfaces, tables, positive > 0,
                                  S, R, H) or hidden
                # fmt: on
                if positive:
                    j = sides.partly[f], surfaces.corners[0], sunk
                    shares[z] = _share(v[:k], v[k + lines :], S, R, *j).imag / STEP
                    continue
                if z == 0:
                    _real(S, R, H, S0, R0, H0)
                _parts(S, R, H, dS[z], dR[z], dH[z])
            v[a, z % d] = v[a, z % d].real
        all_duals(S0, dS, basis, f, shares, C, dC)
        apply(S0, R0, H0, dS, dR, dH, C, dC, fixed, sides.x[f], sides.y[f], f, found)
        move(fixed.n[f], found.D[f], found.M[f], d * (k + lines), found.G[f])


@numba.njit(**KERNEL)
def _differentiate_whole(x, by_x, rule, factor, phi, basis, fixed, found):  # type: ignore[no-untyped-def]
    """Write the derivatives of whole facets, see `differentiate_whole`."""
    p, k, d = x.shape
    size, shares, at = d * k, np.zeros(d * k), np.empty((k, d), np.complex128)
    S, H, R = np.empty((k, k), at.dtype), np.empty(k, at.dtype), np.empty((k, 0), at.dtype)
    S0, R0, H0 = np.empty((k, k)), np.empty((k, 0)), np.empty(k)
    dS, dR, dH = np.empty((size, k, k)), np.empty((size, k, 0)), np.empty((size, k))
    C, dC, y = np.empty((k, k)), np.empty((size, k, k)), np.empty((0, d))
    for f in range(p):
        for z in range(size):
            at[z // d, z % d] = x[f, z // d, z % d]
        for z in range(size):
            at[z // d, z % d] += 1j * STEP
            clear(S)
            for j in range(k):
                H[j] = 0.0
            add_whole(at, by_x[f], x[f], rule, factor[f], phi[f], S, H)
            _parts(S, R, H, dS[z], dR[z], dH[z])
            at[z // d, z % d] = x[f, z // d, z % d]
        _real(S, R, H, S0, R0, H0)
        all_duals(S0, dS, basis, f, shares, C, dC)
        apply(S0, R0, H0, dS, dR, dH, C, dC, fixed, x[f], y, f, found)


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
    shapes = (k, d, k * d), (k, k * d), (k, d, k * d), (k, k), (k, 0)
    found = Results(*(np.zeros((p, *shape)) for shape in shapes))
    rule = tuple(
        np.ascontiguousarray(f(xi)) for f in (element.shape_functions, element.derivatives)
    )
    _differentiate_whole(facets.x, by_x, rule, weights, phi, basis, fixed, found)
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
    tables = (line if d == 2 else area).tables(*types, smooth is not None)
    parts: dict[str, list[Blocks]] = {field.name: [] for field in fields(Derivatives)}
    for group in _groups(pairing, used):
        s, k, m = group.facets, slave.element.nodes, group.nodes.shape[1]
        own, lines = slave.facets[s], directions.shape[1]
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
        both = [bases[0], bases[-1]]
        basis = Basis(
            np.stack([absorbing(slave.element.shares, one.kept[s]) for one in both], axis=1),
            np.stack([one.inverse[s] for one in both], axis=1),
            np.stack([one.kept[s] for one in both], axis=1),
            closed[s],
        )
        fixed = Fixed(given.tractions[own], given.normals[own], normals[group.nodes])
        z = d * (k + lines + m)
        shapes = (k + m, d, z), (k, z), (k, d, z), (k, k), (k, m)
        found = Results(*(np.zeros((len(s), *shape)) for shape in shapes))
        heights = _some(surfaces, group.pairs)
        _differentiate(sides, heights, tables, basis, fixed, edges.SUNK, found)
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
    for m in np.unique(count):
        which = np.flatnonzero(count == m)
        pairs = np.flatnonzero(count[of] == m)
        start = np.searchsorted(s[pairs], np.append(facets[which], np.iinfo(np.int64).max))
        all_nodes = (keys % size)[first[which][:, None] + np.arange(m)]
        groups.append(_Group(facets[which], all_nodes.astype(np.int32), pairs, start, place[pairs]))
    return groups


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

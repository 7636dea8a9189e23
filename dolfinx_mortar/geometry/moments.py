# SPDX-License-Identifier: MIT
"""Moments of pairs of facets, for forces, gaps and dual functions (theory.md, The exact tangent).

    S_jk = int N_j N_k,     R_jl = int N_j N_l,     H_j = int N_j h

with the functions N of both sides, and the heights h of smooth surfaces.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numba
import numpy as np
from numpy.polynomial.legendre import leggauss

from dolfinx_mortar.common.arrays import HALF_OF_DIGITS, Floats, Ints, Longs
from dolfinx_mortar.geometry import area
from dolfinx_mortar.geometry.area import Overlaps, areas, find_overlaps
from dolfinx_mortar.geometry.facets import (
    FacetElement,
    Facets,
    dual_basis,
    rule_on,
    surface_gradients,
)
from dolfinx_mortar.geometry.plane import count, project, reference_parts
from dolfinx_mortar.geometry.tolerances import KERNEL


class Sides(NamedTuple):
    """Slave facets (p,) and the master facets (c,) that they face, ordered."""

    x: Floats  # (p, k, d)
    n: Floats  # (p, k, 2) directions of projection; (p, 0, 3) in 3D
    y: Floats  # (p, m, d) distinct nodes of the masters
    start: Longs  # (p + 1,)
    place: Longs  # (c, l) nodes of the masters among y
    deepest: Floats  # (c,)
    factor: Floats  # (p, k) nodal weights of the integrals
    reach: Floats  # (p, 2) see `Segments`; (p, 0) without

    def pairs(self) -> Ints:
        """Pairs (c, 2) of slave facets and masters."""
        of = np.repeat(np.arange(len(self.x), dtype=np.int32), np.diff(self.start))
        return np.stack([of, np.arange(len(of), dtype=np.int32)], axis=1)


class Sums(NamedTuple):
    """Moments of slave facets (p,) with k nodes, m nodes of their masters, c pairs."""

    values: Floats  # (p, k, k + m + 1) S, R and H
    changes: Floats  # (p, z, k, k + m + 1) derivatives
    E_s: Floats  # (c, k, k, k) dH_j by Q_ab of slave heights; (0, ..) unused
    E_m: Floats  # (c, k, l, l) of master heights
    chords: Floats  # (c, k, 2) dH_j by log lengths of chords; (0, ..) unused

    def add_heights(self, points: "Points", pairs: Ints) -> None:
        """Add the derivatives of H by heights, at the points of pairs (s,)."""
        v = points.weight[..., None] * points.N
        for i, (E, N) in enumerate(zip((self.E_s, self.E_m), points.own, strict=True)):
            if len(E):
                np.add.at(E, pairs, np.einsum("sqj,sqa,sqb->sjab", v, N, N, optimize=True))
            if len(self.chords):
                both = (v * points.by_chords[i][..., None]).sum(axis=1)
                np.add.at(self.chords[:, :, i], pairs, both)


class Points(NamedTuple):
    """Points (s, q) of pairs of facets with k and l nodes."""

    N: Floats  # (s, q, k) of the slave
    dN: Floats  # (s, q, d-1, k)
    dM: Floats  # (s, q, d-1, l) of the master
    f: Floats  # (s, q, k + l + 1) N of both and h
    by_N: Floats  # (s, q, k + l) dh by N
    T: Floats  # (s, q, d-1, d) tangents of the slave
    U: Floats  # (s, q, d-1, d) of the master
    apart: Floats  # (s, q, d) x_m - x_s
    weight: Floats  # (s, q)
    by_xi: Floats  # (s, q, 2 d-2) d log weight by both xi
    by_nodes: Floats  # (s, q, k + l, d) at fixed xi
    own: tuple[Floats, Floats]  # N of both facets
    by_chords: list[Floats]  # (s, q) dh by log lengths of chords

    def differentiate(self, by_s: Floats, by_m: Floats, by_w: Floats) -> tuple[Floats, Floats]:
        """Moments (s, k, k + l + 1), and their derivatives (s, z, k, k + l + 1).

        By derivatives (s, q, d-1, z) of both xi, and (s, q, z) of the log weight.
        """
        e, v = by_s.shape[2], self.weight[..., None] * self.N
        rates = self.by_xi[:, :, None]
        by_w = by_w + (rates[..., :e] @ by_s + rates[..., e:] @ by_m)[:, :, 0]
        sides = (by_s, self.dN), (by_m, self.dM)
        by_N = np.concatenate([np.swapaxes(by, 2, 3) @ df for by, df in sides], axis=3)
        by_f = np.concatenate([by_N, by_N @ self.by_N[..., None]], axis=3)
        by_v = self.weight[..., None, None] * by_f[..., : v.shape[2]]
        return products(v, self.f, by_v + by_w[..., None] * v[:, :, None], by_f)


def products(v: Floats, f: Floats, by_v: Floats, by_f: Floats) -> tuple[Floats, Floats]:
    """Sums over points of v_j f_a (s, k, n), and their derivatives (s, z, k, n)."""
    (s, q, z, k), n, v = by_v.shape, f.shape[2], np.swapaxes(v, 1, 2)
    changes = (np.swapaxes(by_v.reshape(s, q, z * k), 1, 2) @ f).reshape(s, z, k, n)
    changes += np.swapaxes((v @ by_f.reshape(s, q, z * n)).reshape(s, k, z, n), 1, 2)
    return v @ f, changes


def turns(element: FacetElement, x: Floats) -> tuple[Floats, Floats]:
    """Normals n (m, d) of facets x (m, k, d), and g (m, k, d): dn = -sum_a g_a (n.dx_a).

    At the centre, by the vertices.
    """
    part = element.first
    corners = Facets(part, x[:, : part.nodes])
    which = np.arange(len(x), dtype=np.int32)
    g, n = surface_gradients(corners, which, np.repeat(part.centre, len(x), axis=0))
    return n, np.pad(g, ((0, 0), (0, x.shape[1] - part.nodes), (0, 0)))


def height(N: Floats, Q: Floats, arcs: Floats) -> tuple[Floats, Floats, Floats]:
    """Heights N.Q N (s, q) of arcs (s, 2), and derivatives by N and the log chord length."""
    QN, curvature, square = N @ Q, arcs[:, None, 0], arcs[:, None, 1]
    h, left = (QN * N).sum(axis=2), 1.0 - square
    root, across = np.sqrt(square), np.sqrt(square + 2.0 * curvature * h)
    # curvature is c / L^2, left c / 4 times that
    rate = left / root + (left - 2.0 * curvature * h) / across
    both = root + across
    return 2.0 * h / both, 2.0 * QN / across[..., None], -2.0 * h / both**2 * rate


def create_points(
    slave: tuple[Floats, Floats, Floats],
    master: tuple[Floats, Floats],
    nodes: tuple[Floats, Floats],
    weight: Floats,
    given: tuple[Floats, Floats],
    element: FacetElement,
    heights: Sequence[Floats],
    spread: Floats | None = None,
) -> Points:
    """Points of pairs of facets.

    Args:
        slave: N, dN, ddN of `FacetElement.functions`.
        master: N and dN.
        nodes: (s, k, d) and (s, l, d).
        weight: (s, q) areas on the slave, or lengths.
        given: nodal weights (s, k); reach (s, 2) of `Segments`, or (s, 0).
        element: of the slave.
        heights: Q (s, k, k), (s, l, l) and arcs (s, 2, 2), or empty.
        spread: (s, l, m) the master's nodes among m.
    """
    (N, dN, ddN), (M, dM), (x, y), (factor, reach) = slave, master, nodes, given
    own, factor = (N, M), factor[:, :, None]
    T, U, apart = dN @ x[:, None], dM @ y[:, None], M @ y - N @ x
    dual, _ = dual_basis(T)
    scale = N @ factor
    by_s = (dual[:, :, None] * (ddN @ x[:, None, None])).sum(axis=(3, 4))
    by_s += (dN @ factor[:, None])[..., 0] / np.where(scale > 0.0, scale, np.inf)  # on an axis
    weight = weight * scale[..., 0]
    h, by_N, by_chords = np.zeros(weight.shape), [np.zeros_like(N), np.zeros_like(M)], []
    for i, one in enumerate(own if heights[0].size else ()):
        rise, by_N[i], by_chord = height(one, heights[i], heights[2][:, i])
        h += rise
        by_chords.append(by_chord)
    if spread is not None:
        M, dM, by_N[1] = M @ spread, dM @ spread[:, None], by_N[1] @ spread
    by_m, by_x = np.zeros_like(by_s), np.swapaxes(dN, 2, 3) @ dual
    by_y = np.zeros((*M.shape, x.shape[2]))
    if reach.size:
        n, g = turns(element, x)
        part = 1.0 - reach[:, 1:] * ((apart @ n[:, :, None])[..., 0] - reach[:, :1])
        rate = -reach[:, 1:] / np.where((part > 0.0) & (part < 1.0), part, np.inf)
        fall, weight = rate[..., None] * n[:, None], weight * np.clip(part, 0.0, 1.0)
        by_s -= (T @ fall[..., None])[..., 0]
        by_m += (U @ fall[..., None])[..., 0]
        by_x -= (N + apart @ np.swapaxes(g, 1, 2))[..., None] * fall[:, :, None]
        by_y += M[..., None] * fall[:, :, None]
    f = np.concatenate([N, M, h[..., None]], axis=2)
    by_xi, by_nodes = np.concatenate([by_s, by_m], axis=2), np.concatenate([by_x, by_y], axis=2)
    by_both = np.concatenate(by_N, axis=2)
    return Points(N, dN, dM, f, by_both, T, U, apart, weight, by_xi, by_nodes, own, by_chords)


def whole(
    facets: Facets, xi: Floats, weights: Floats, phi: Floats, by_x: Floats
) -> tuple[Floats, Floats]:
    """Moments (p, k, k + 1) of whole facets below a tool, and derivatives (p, d k, k, k + 1).

    For weights (p, q) on the reference facet, distances phi (p, q) and derivatives (p, q, k, d) at
    xi; H = -int N_j phi.
    """
    N, dN, _ = (v[0] for v in facets.element.functions(xi[None]))
    dual, normal = dual_basis(dN @ facets.x[:, None])
    v = (weights * np.linalg.norm(normal, axis=2))[..., None] * N
    by_w = (np.swapaxes(dN, 1, 2) @ dual).reshape(*phi.shape, dN.shape[2] * dual.shape[3])
    f = np.concatenate([np.broadcast_to(N, v.shape), -phi[..., None]], axis=2)
    by_f = np.zeros((*by_w.shape, f.shape[2]))
    by_f[..., -1] = -by_x.reshape(by_w.shape)
    return products(v, f, by_w[..., None] * v[:, :, None], by_f)


@numba.njit(**KERNEL)
def _nearest_line(c, e, P, r, best):  # type: ignore[no-untyped-def]
    """Distance, polygon r and its corner, of the line nearest to edge e."""
    f = (e + 1) % 3
    for v in range(len(P)):
        o = (v + 1) % len(P)
        dx, dy = P[o, 0] - P[v, 0], P[o, 1] - P[v, 1]
        one = dx * (c[e, 1] - P[v, 1]) - dy * (c[e, 0] - P[v, 0])
        two = dx * (c[f, 1] - P[v, 1]) - dy * (c[f, 0] - P[v, 0])
        distance = max(abs(one), abs(two)) / np.sqrt(dx * dx + dy * dy)
        if distance < best[0]:
            best = distance, r, v
    return best


@numba.njit(**KERNEL)
def _find_edges(x_s, x_m, pairs, centre, axes, which, corners, hidden):  # type: ignore[no-untyped-def]
    """Edges (q, 4) on edges of masters: triangle, edge, pair with the master, its corner."""
    found, q, none = np.empty((3 * len(which), 4), np.int64), 0, np.int64(-1)
    S, M, N = np.empty((x_s.shape[1], 3)), np.empty((x_m.shape[1], 3)), np.empty((x_m.shape[1], 3))
    for t in range(len(which)):
        r, (s, m) = which[t], pairs[which[t]]
        if t == 0 or which[t] != which[t - 1]:
            project(x_s[s], centre[s], axes[s], S)
            project(x_m[m], centre[s], axes[s], M)
        for e in range(3):
            if _nearest_line(corners[t], e, S, none, (HALF_OF_DIGITS, none, none))[2] >= 0:
                continue
            line = _nearest_line(corners[t], e, M, r, (HALF_OF_DIGITS, none, none))
            if line[2] < 0 and hidden[s]:
                while r > 0 and pairs[r - 1, 0] == s:
                    r -= 1
                while r < len(pairs) and pairs[r, 0] == s:
                    project(x_m[pairs[r, 1]], centre[s], axes[s], N)
                    line = _nearest_line(corners[t], e, N, r, line)
                    r += 1
                r = which[t]
            if line[2] >= 0:
                found[q, 0], found[q, 1], found[q, 2], found[q, 3] = t, e, line[1], line[2]
                q += 1
    return found[:q]


def moments_in_space(
    sides: Sides, heights: Sequence[Floats], types: tuple[FacetElement, FacetElement], found: Sums
) -> None:
    """Add the moments of slave facets and their masters, and derivatives by x and y.

    `heights` of pairs (c,) are those of `create_points`.
    """
    x, y, pairs, (slave, master) = sides.x, sides.y, sides.pairs(), types
    others = Facets(master, y[pairs[:, :1], sides.place])
    over = find_overlaps(Facets(slave, x), others, pairs, sides.deepest)
    degree = area.degree_of_moments(slave, master, heights[0].size > 0)
    points, weights = leggauss((degree + 3) // 2)
    t, rule = (1.0 + points) / 2, rule_on("triangle", degree)
    line, nodes = (np.stack([t, 0.0 * t], axis=1), weights / 2), np.concatenate([x, y], axis=1)
    inner = _create(over, sides, heights, over.which, over.corners, areas(over.corners), rule)
    _add_inner(over, inner, found)
    edges = _find_edges(*over.of_planes, over.hidden)
    ends = over.corners[edges[:, :1], (edges[:, 1:2] + [0, 1]) % 3]
    which, one = over.which[edges[:, 0]], np.ones(len(edges))
    crossing = _create(over, sides, heights, which, ends[:, [0, 1, 1]], one, line)
    ids = _nodes_of_lines(over, sides, edges[:, 2], edges[:, 3:] + [0, 1])
    lines = nodes[crossing.facet[:, None], ids]
    _add_edges(over, crossing, lines, ends, t, ids, found)


class _OfPairs(NamedTuple):
    """Points (s, q) of triangles, or of lines, of pairs."""

    at: Points
    xi: Floats  # (s, q, 2) on the slave
    part: Longs  # (s,) of the slave
    facet: Longs  # (s,)
    pair: Ints  # (s,)
    nodes: Longs  # (s, k + l) of both facets, slave's first
    x: Floats  # (s, k + l, 3) relative to the centre of the part
    u: Floats  # (s, 2, 3) axes of the part's plane
    n: Floats  # (s, 3) its normal
    g: Floats  # (s, k, 3) see `turns`

    def columns(self, found: Sums) -> Longs:
        """Columns (s, k + l + 1) of the points' functions and heights among the moments."""
        last = np.full((len(self.pair), 1), found.values.shape[2] - 1)
        return np.concatenate([self.nodes, last], axis=1)


def _create(
    over: Overlaps,
    sides: Sides,
    heights: Sequence[Floats],
    which: Longs,
    corners: Floats,
    size: Floats,
    rule: tuple[Floats, Floats],
) -> _OfPairs:
    """Points of a rule on triangles (s, 3, 2); weight 0 off the master."""
    slave, master, planes = over.slave, over.master, over.planes
    first, q = np.zeros(len(which), dtype=np.int64), len(rule[1])
    _, xi_s, xi_m, weight = over.place(which, corners, size, first, (*rule, np.array([0, q])))
    part, shape = over.pairs[which, 0].astype(np.int64), (len(which), q, 2)
    lost = np.isnan(xi_m[:, 0])
    xi_m[lost], weight[lost] = 0.0, 0.0
    xi_s, xi_m = (v.reshape(shape) for v in (xi_s, xi_m))
    facet, pair = part // count(slave.element), over.of[which]
    nodes = slave.x[facet], master.x[pair]
    points = create_points(
        slave.element.functions(xi_s),
        master.element.functions(xi_m)[:2],
        nodes,
        weight.reshape(shape[:2]),
        (sides.factor[facet], sides.reach[facet]),
        slave.element,
        [v[pair] for v in heights],
    )
    k = slave.x.shape[1]
    own = np.broadcast_to(np.arange(k), (len(which), k))
    which = np.concatenate([own, k + sides.place[pair]], axis=1)
    x = np.concatenate(nodes, axis=1) - planes[0][part][:, None]
    n, g = turns(over.parts[0].element, over.parts[0].x[part])
    u = planes[1][part, :2] * planes[2][part, None, None]
    g = np.swapaxes(_scattered(slave.element, part), 1, 2) @ g
    return _OfPairs(points, xi_s, part, facet, pair, which, x, u, n, g)


def _nodes_of_lines(over: Overlaps, sides: Sides, pair: Longs, corners: Longs) -> Longs:
    """Nodes (s, 2) of edges of masters."""
    element = over.master.element
    nodes = np.array(element.sub_facets)[over.pairs[pair, 1] % count(element)]
    ends = np.take_along_axis(nodes, corners % nodes.shape[1], axis=1)
    places = np.take_along_axis(sides.place[over.of[pair]], ends, axis=1)
    return over.slave.x.shape[1] + places


def _oblique(V: Floats, n: Floats) -> Floats:
    """Vectors (s, q, 2, 3) dual to tangents V, normal to n."""
    first, second = np.cross(V[:, :, 1], n), np.cross(n, V[:, :, 0])
    size = (V[:, :, 0] * first).sum(axis=2)[..., None, None]
    return np.stack([first, second], axis=2) / size


def _scattered(element: FacetElement, part: Longs) -> Floats:
    nodes = np.array(element.sub_facets)[part % count(element)]
    return np.eye(element.nodes)[nodes]


def _of_parts(element: FacetElement, part: Longs, xi: Floats) -> Floats:
    """Functions of parts at points xi (s, q, 2) of facets."""
    x = reference_parts(element)[part % count(element)]
    N, slopes, _ = element.first.functions(np.zeros((1, 2)))  # affine parts
    return element.first.functions((xi - N @ x) @ np.linalg.inv(slopes @ x))[0]


def _add_inner(over: Overlaps, inner: _OfPairs, found: Sums) -> None:
    """Add the moments of triangles, and their derivatives at points fixed on the slave.

    Points h n above them, on the master, move by G (dx_s + h dn - dx_m) in its coordinates.
    """
    at, n, g, (s, q, k) = inner.at, inner.n, inner.g, inner.at.N.shape
    G, h = _oblique(at.U, n[:, None]), at.apart @ n[:, :, None]
    by = np.empty((s, q, 2, inner.nodes.shape[1], 3))
    by[..., :k, :] = at.N[:, :, None, :, None] * G[..., None, :]
    by[..., :k, :] -= (h[..., None] * (G @ np.swapaxes(g, 1, 2)[:, None]))[..., None] * n[
        :, None, None, None
    ]
    by[..., k:, :] = -at.f[:, :, None, k:-1, None] * G[..., None, :]
    z = 3 * inner.nodes.shape[1]
    rates = by.reshape(s, q, 2, z)
    values, changes = at.differentiate(0.0 * rates, rates, at.by_nodes.reshape(s, q, z))
    columns, none = inner.columns(found), np.zeros((s, 1), dtype=np.int64)
    _scatter(found.values[:, None], inner.facet, none, columns, values[:, None])
    _scatter(found.changes, inner.facet, inner.nodes, columns, changes)
    found.add_heights(at, inner.pair)


def _add_edges(
    over: Overlaps,
    inner: _OfPairs,
    lines: Floats,
    ends: Floats,
    t: Floats,
    ids: Longs,
    found: Sums,
) -> None:
    """Add the derivatives by the motion of edges of triangles (s,), anticlockwise.

    Relative to the slave's part, by dx_m - dx_s - h dn.
    """
    at, part, k = inner.at, inner.part, inner.at.N.shape[2]
    u, n, g = inner.u, inner.n, inner.g
    radius, lines = over.planes[2][part], lines - over.planes[0][part][:, None]
    first, second = np.moveaxis(lines @ np.swapaxes(u, 1, 2) / radius[:, None, None], 1, 0)
    along, way = second - first, ends[:, 1] - ends[:, 0]
    points = ends[:, :1] + t[:, None] * way[:, None] - first[:, None]
    share = (points @ along[:, :, None])[..., 0] / (along**2).sum(axis=1)[:, None]
    share = np.stack([1.0 - share, share], axis=2)
    N = _of_parts(over.slave.element, part, inner.xi) @ _scattered(over.slave.element, part)
    h = (share @ lines - N @ inner.x[:, :k]) @ n[:, :, None]
    outwards = ((way[:, ::-1] * [1.0, -1.0] / radius[:, None])[:, None] @ u)[:, None]
    by_x = (h * (g @ outwards[:, 0, 0, :, None])[:, None, :, 0])[..., None] * n[:, None, None]
    by = np.concatenate([by_x - N[..., None] * outwards, share[..., None] * outwards], axis=2)
    rows = (at.weight[..., None] * at.N)[..., None] * at.f[:, :, None]
    (s, q), z = share.shape[:2], 3 * (k + 2)
    changes = np.swapaxes(by.reshape(s, q, z), 1, 2) @ rows.reshape(s, q, k * at.f.shape[2])
    nodes = np.concatenate([inner.nodes[:, :k], ids], axis=1)
    changes = changes.reshape(s, z, k, at.f.shape[2])
    _scatter(found.changes, inner.facet, nodes, inner.columns(found), changes)


@numba.njit(**KERNEL)
def _scatter(to, facets, nodes, columns, values):  # type: ignore[no-untyped-def]
    """Add values (s, r d, k, n) at nodes (s, r) and columns (s, n) to facets (s,)."""
    d = values.shape[1] // nodes.shape[1]
    for s in range(len(values)):
        for z in range(values.shape[1]):
            row = d * nodes[s, z // d] + z % d
            for j in range(values.shape[2]):
                for a in range(values.shape[3]):
                    to[facets[s], row, j, columns[s, a]] += values[s, z, j, a]

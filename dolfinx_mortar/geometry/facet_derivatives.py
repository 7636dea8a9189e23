# SPDX-License-Identifier: MIT
r"""Derivatives of integrals over the segments of pairs of facets in 3D (compiled kernels).

The points of a slave facet stay at their xi; each is projected along the mean normal n_0 of the
part of the facet on which it lies, which is the facet itself in first order. With the offset
o = x_m - x_s = gamma n_0, the surface gradients G_k of the slave's functions (G0_k those of the
part in its middle, where its normal is n_0) and m^a, dual to the tangents y_a of the master in the
plane across n_0,

    d n_0   = -sum_k G0_k (n_0.dx_k)
    d eta^a = m^a.(dx_s - dx_m + gamma dn_0)          dx_m at fixed eta
    dw / w  = sum_k G_k.dx_k                          of the weights

Edges between two master facets move, too, but what one of them gains the other one loses, as long
as they are straight: then functions are continuous there. Those without a neighbour bound the
covered part. In second order edges are clipped as straight lines beside which both facets are
continued, and gains differ from losses. With the normal nu of the edge in the plane, outward,
and the area c of the facet per area in the plane, integrals of f gain

    int f c nu.(dx_m - dx_s - gamma dn_0) ds.

Points on edges of the last two kinds are added to those of the segments: for them alone c ds is the
weight, and nu.(dx_m - dx_s - gamma dn_0) stands for dw / w. In it x_m is on the straight edge of a
part, and x_s on the part of the slave: it is these that are clipped. Edges that one master facet
casts on another one behind it are held.

The coefficients A of the dual functions Phi_j of a facet depend on all its points, too, see
`Coefficients`.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numba
import numpy as np

from dolfinx_mortar.arrays import HALF_OF_DIGITS, Bools, Floats, Ints, Longs
from dolfinx_mortar.geometry import plane
from dolfinx_mortar.geometry.elements import FacetElement
from dolfinx_mortar.geometry.facets import Facets, facet_normals, surface_gradients
from dolfinx_mortar.geometry.parts import (
    count,
    edges_of_parts,
    on_facets,
    pairs_of_parts,
    part_at,
    parts_of,
)
from dolfinx_mortar.geometry.plane import create_planes, inverse, project, slopes

_ON_EDGES = {True: 3, False: 8}
"""Gauss points on edges: of first-order triangles, where 3 are exact, and of other facets.

Measured, derivatives on facets of second order that are bent by a tenth: 3 points 1e-3 of the
largest entry, 4 6e-6, 5 2e-8, 6 4e-10. More for distorted quadrilaterals.
"""


@dataclass(frozen=True, eq=False)
class Points:
    """Points (q,) of segments."""

    pair: Longs  # (q,) pair
    xi_s: Floats  # (q, 2)
    xi_m: Floats  # (q, 2)
    weight: Floats  # (q,)


@dataclass(frozen=True, eq=False)
class EdgePoints(Points):
    """Points on edges of master facets, beyond which another one covers the slave or none does."""

    nu: Floats  # (q, 3)
    N_s: Floats  # (q, k) functions of the part of the slave that lies below
    N_m: Floats  # (q, l) functions of the part of the master
    free: Bools  # (q,) whether none does


@dataclass(frozen=True, eq=False)
class Heights:
    """Heights h at points, and their derivatives by eta."""

    h: Floats  # (q,)
    by_xi_m: Floats  # (q, 2)


@dataclass(frozen=True, eq=False)
class Integrands:
    """What is integrated: tractions s = sum_j Phi_j c_j, and gaps Phi_j (n_j.o - h)."""

    c: Floats  # (ms, k, 3) at the nodes of the slave facets
    n: Floats  # (ms, k, 3)


@dataclass(frozen=True, eq=False)
class Coefficients:
    r"""How the dual functions of slave facets (ms,) depend on their moments.

    Phi_j = sum_b A_jb N~_b over the kept nodes, and what their sum misses of 1 in equal parts. With
    m = int N~ N~^T and d = int N~, A = diag(d) m^-1, so that a change dw of weights gives

        dA_jb = sum_q dw (N~_j m^-1_jb - (sum_a A_ja N~_a) (m^-1 N~)_b)

    and s, of given c_j, changes by sum_b N~_b C_b, C_b = sum_q dw (sum_j c_j N~_j m^-1_jb - s (m^-1
    N~)_b). Likewise a gap, g_jb = int N~_b (n_j.o - h), by sum_q dw (sum_b g_jb m^-1_jb N~_j -
    Phi_j sum_b g_jb (m^-1 N~)_b).
    """

    which: Bools  # (ms,) facets of which they change
    inverse: Floats  # (ms, k, k) m^-1 over the kept nodes, 0 for others
    gaps: Floats  # (ms, k, k) g_jb


@dataclass(frozen=True, eq=False)
class PairIntegrals:
    """Derivatives of integrals over pairs (p,) by the coordinates of their k + l nodes."""

    forces: Floats  # (p, k + l, 3, k + l, 3) of int s N_k, and of -int s N_l, at fixed A
    gaps: Floats  # (p, k, k + l, 3) of int Phi_j (n_j.o - h)
    by_slave: Floats  # (ms, 3, k, k, 3) of C_b by the nodes of the slave facet
    by_master: Floats  # (e, 3, k, l, 3) by those of the master facets of pairs with free edges
    with_edges: Longs  # (e,) these pairs


_PRODUCTS = {"cache": True, "error_model": "numpy", "fastmath": {"reassoc", "contract", "nsz"}}


@numba.njit(cache=True)
def _clip_edge(S, k, ax, ay, bx, by):  # type: ignore[no-untyped-def]
    """Return the shares between which an edge is inside of S, none where it runs along its rim."""
    low, high = 0.0, 1.0
    for i in range(k):
        j = i + 1 if i + 1 < k else 0
        dx, dy = S[j, 0] - S[i, 0], S[j, 1] - S[i, 1]
        length = np.sqrt(dx * dx + dy * dy)
        a = (dx * (ay - S[i, 1]) - dy * (ax - S[i, 0])) / length
        b = (dx * (by - S[i, 1]) - dy * (bx - S[i, 0])) / length
        if a <= HALF_OF_DIGITS and b <= HALF_OF_DIGITS:
            return 0.0, 0.0
        if a < 0.0:
            low = max(low, a / (a - b))
        if b < 0.0:
            high = min(high, a / (a - b))
    return low, high


@numba.njit(cache=True)
def _edge_points(x_s, x_m, bilinear, pairs, which, centre, axes, radius, t, w):  # type: ignore[no-untyped-def]
    """Return pair, edge, xi_s, xi_m, weight and nu of the points on some edges."""
    total = which.sum() * len(t)
    pair, edge, weight = np.empty(total, np.int64), np.empty(total, np.int64), np.empty(total)
    xi_s, xi_m, nu = np.empty((total, 2)), np.empty((total, 2)), np.empty((total, 3))
    k, n = x_s.shape[1], x_m.shape[1]
    S, M = np.empty((k, 3)), np.empty((n, 3))
    q = 0
    for p in range(len(pairs)):
        for i in range(n):
            if not which[p, i]:
                continue
            s, m = pairs[p]
            project(x_s[s], centre[s], axes[s], S)
            project(x_m[m], centre[s], axes[s], M)
            j = i + 1 if i + 1 < n else 0
            ax, ay, dx, dy = M[i, 0], M[i, 1], M[j, 0] - M[i, 0], M[j, 1] - M[i, 1]
            low, high = _clip_edge(S, k, ax, ay, M[j, 0], M[j, 1])
            sign = plane.orientation(M, n)
            if high <= low or sign == 0:
                continue
            length = np.sqrt(dx * dx + dy * dy)
            for g in range(len(t)):
                share = low + (high - low) * t[g]
                x, y = ax + share * dx, ay + share * dy
                xi_s[q, 0], xi_s[q, 1], _ = inverse(S, bilinear[0], x, y)
                xi_m[q, 0], xi_m[q, 1], _ = inverse(M, bilinear[1], x, y)
                s0, s1 = slopes(S, bilinear[0], xi_s[q, 0], xi_s[q, 1])
                weight[q] = (
                    w[g] * (high - low) * length * radius[s] * np.sqrt(1 + s0 * s0 + s1 * s1)
                )
                for h in range(3):
                    nu[q, h] = sign * radius[s] * (dy * axes[s, 0, h] - dx * axes[s, 1, h]) / length
                pair[q], edge[q] = p, i
                q += 1
    return pair[:q], edge[:q], xi_s[:q], xi_m[:q], weight[:q], nu[:q]


def place_on_edges(slave: Facets, master: Facets, pairs: Ints, free: Bools) -> EdgePoints:
    """Return the points on edges of the master facets of pairs, inside the slave facets.

    On free edges, and in second order on all.

    Args:
        slave: Slave facets (ms,).
        master: Master facets (mm,).
        pairs: Pairs (p, 2).
        free: Edges (p, v) of the master facets without a neighbour that covers the slave, too; edge
            i is that from vertex i to the next one.
    """
    curved = master.element.degree > 1
    some = np.flatnonzero(free.any(axis=1) | curved)
    parts_s, parts_m = parts_of(slave), parts_of(master)
    bilinear = parts_s.element.bilinear, parts_m.element.bilinear
    t, w = np.polynomial.legendre.leggauss(_ON_EDGES[not (curved or any(bilinear))])
    of_parts, of = pairs_of_parts(pairs[some], slave.element, master.element)
    edge = edges_of_parts(master.element)[of_parts[:, 1] % count(master.element)]
    free_parts = np.take_along_axis(free[some][of], np.maximum(edge, 0), axis=1)
    which, planes = (free_parts | curved) & (edge >= 0), create_planes(parts_s)
    found = _edge_points(
        parts_s.x, parts_m.x, bilinear, of_parts, which, *planes, (1 + t) / 2, w / 2
    )
    pair, i, xi_s, xi_m, weight, nu = found
    at, nobody = of_parts[pair], free_parts[pair, i]
    N_s = _of_nodes(slave.element, at[:, 0], xi_s)
    N_m = _of_nodes(master.element, at[:, 1], xi_m)
    if slave.element.part is not None or master.element.part is not None:
        xi_s, xi_m, weight = on_facets(
            slave, master, planes[1], at, xi_s=xi_s, xi_m=xi_m, weight=weight
        )
    met = np.isfinite(xi_m).all(axis=1)
    columns = some[of[pair]], xi_s, xi_m, weight, nu, N_s, N_m, nobody
    return EdgePoints(*(column[met] for column in columns))


def _of_nodes(element: FacetElement, part: Ints, xi: Floats) -> Floats:
    """Return the functions of parts (q,) at xi (q, 2) as functions (q, k) of the facets' nodes."""
    N = (element.part or element).shape_functions(xi)
    nodes = np.array(element.sub_facets)[part % count(element)]
    result = np.zeros((len(N), element.nodes))
    np.put_along_axis(result, nodes, N, axis=1)
    return result


@numba.njit(**_PRODUCTS)
def _tangents(x, dN, a):  # type: ignore[no-untyped-def]
    """Write the tangents of the facet x (k, 3) into a (2, 3)."""
    for b in range(2):
        for i in range(3):
            a[b, i] = 0.0
            for j in range(len(x)):
                a[b, i] += dN[j, b] * x[j, i]


@numba.njit(**_PRODUCTS)
def _dual_across(a, n, dual):  # type: ignore[no-untyped-def]
    """Write the dual of the tangents a (2, 3) in the plane across n into dual (2, 3)."""
    for i in range(3):
        j, h = (i + 1) % 3, (i + 2) % 3
        dual[0, i] = a[1, j] * n[h] - a[1, h] * n[j]
        dual[1, i] = n[j] * a[0, h] - n[h] * a[0, j]
    size = dual[0, 0] * a[0, 0] + dual[0, 1] * a[0, 1] + dual[0, 2] * a[0, 2]
    for i in range(3):
        dual[0, i] /= size
        dual[1, i] /= size


@numba.njit(**_PRODUCTS)
def _find_offset(x, y, N_s, N_m, o):  # type: ignore[no-untyped-def]
    """Write x_m - x_s into o."""
    for i in range(3):
        o[i] = 0.0
        for j in range(len(x)):
            o[i] -= N_s[j] * x[j, i]
        for j in range(len(y)):
            o[i] += N_m[j] * y[j, i]


@numba.njit(**_PRODUCTS)
def _relative_motion(d, N_s, N_m, gamma, n_0, G0, row):  # type: ignore[no-untyped-def]
    """Write the derivative 3 (k + l) of d.(dx_s - dx_m + gamma dn_0) into row."""
    k = len(N_s)
    for j in range(k):
        turn = gamma * (d[0] * G0[j, 0] + d[1] * G0[j, 1] + d[2] * G0[j, 2])
        for i in range(3):
            row[3 * j + i] = N_s[j] * d[i] - turn * n_0[i]
    for j in range(len(N_m)):
        for i in range(3):
            row[3 * (k + j) + i] = -N_m[j] * d[i]


@numba.njit(**_PRODUCTS)
def _stretch(x, dN, a, normal, dual, row):  # type: ignore[no-untyped-def]
    """Write the derivatives of ln |a_1 x a_2| by the nodes x (k, 3) into row."""
    _tangents(x, dN, a)
    square = 0.0
    for i in range(3):
        j, h = (i + 1) % 3, (i + 2) % 3
        normal[i] = a[0, j] * a[1, h] - a[0, h] * a[1, j]
        square += normal[i] ** 2
    for i in range(3):
        normal[i] /= np.sqrt(square)
    _dual_across(a, normal, dual)
    for j in range(len(x)):
        for i in range(3):
            row[3 * j + i] = dN[j, 0] * dual[0, i] + dN[j, 1] * dual[1, i]


@numba.njit(**_PRODUCTS)
def _sum_tractions(Phi, c, s):  # type: ignore[no-untyped-def]
    """Write sum_j Phi_j c_j into s."""
    for i in range(3):
        s[i] = 0.0
        for j in range(len(Phi)):
            s[i] += Phi[j] * c[j, i]


@numba.njit(**_PRODUCTS)
def _add_row(factor, row, size, total):  # type: ignore[no-untyped-def]
    """Add a factor times the first entries of a row to a total."""
    for z in range(size):
        total[z] += factor * row[z]


@numba.njit(**_PRODUCTS)
def _add_weights(s, N_s, N_m, r, size, forces):  # type: ignore[no-untyped-def]
    """Add s N_k, and -s N_l, times dw / w = r to the forces of a pair."""
    k = len(N_s)
    for j in range(k + len(N_m)):
        N = N_s[j] if j < k else -N_m[j - k]
        for i in range(3):
            _add_row(s[i] * N, r, size, forces[j, i])


@numba.njit(**_PRODUCTS)
def _add_points(s, dN_m, e, k, forces, v):  # type: ignore[no-untyped-def]
    """Add -s dN_l to the forces of a pair, e being the derivatives of eta."""
    for j in range(len(dN_m)):
        for z in range(len(v)):
            v[z] = dN_m[j, 0] * e[0, z] + dN_m[j, 1] * e[1, z]
        for i in range(3):
            _add_row(-s[i], v, len(v), forces[k + j, i])


@numba.njit(**_PRODUCTS)
def _add_gap(n, Phi, b, slope, N_s, N_m, e, gap):  # type: ignore[no-untyped-def]
    """Add Phi_j d(n_j.o - h) at a fixed weight to one weighted gap of a pair."""
    k, m = len(N_s), len(N_m)
    along_0 = Phi * (n[0] * b[0, 0] + n[1] * b[0, 1] + n[2] * b[0, 2] - slope[0])
    along_1 = Phi * (n[0] * b[1, 0] + n[1] * b[1, 1] + n[2] * b[1, 2] - slope[1])
    for z in range(3 * (k + m)):
        gap[z] += along_0 * e[0, z] + along_1 * e[1, z]
    for z in range(k + m):
        N = Phi * (-N_s[z] if z < k else N_m[z - k])
        for h in range(3):
            gap[3 * z + h] += N * n[h]


@numba.njit(**_PRODUCTS)
def _dual_change(w, N, Phi, s, c, inverse, g, t, y, v):  # type: ignore[no-untyped-def]
    """Write w times the factors of dw / w in C_b and in the gaps into t (3, k) and y (k,).

    Phi and s are those of the point times its weight.
    """
    k = len(N)
    for b in range(k):
        v[b] = 0.0
        for a in range(k):
            v[b] += inverse[a, b] * N[a]
    for i in range(3):
        for b in range(k):
            t[i, b] = -s[i] * v[b]
    for j in range(k):
        own, across = 0.0, 0.0
        for b in range(k):
            own += g[j, b] * inverse[j, b]
            across += g[j, b] * v[b]
            for i in range(3):
                t[i, b] += w * N[j] * c[j, i] * inverse[j, b]
        y[j] = w * own * N[j] - Phi[j] * across


class _Sides(NamedTuple):
    """Pairs of facets, and the planes of the parts of the slave facets."""

    x_s: Floats  # (ms, k, 3)
    x_m: Floats  # (mm, l, 3)
    n_0: Floats  # (parts, 3)
    G0: Floats  # (parts, k, 3)
    pairs: Ints  # (p, 2)


class _AtPoints(NamedTuple):
    """Values at the points of segments."""

    pair: Longs  # (q,)
    part: Longs  # (q,) of the slave facet
    N_s: Floats  # (q, k)
    dN_s: Floats  # (q, k, 2)
    N_m: Floats  # (q, l)
    dN_m: Floats  # (q, l, 2)
    weight: Floats  # (q,)
    Phi: Floats  # (q, k) times the weight
    duals: Floats  # (q, k) N~_j
    height: Floats  # (q,), or one 0
    slope: Floats  # (q, 2), or one 0


class _OnEdges(NamedTuple):
    """Values at the points on edges; P_s and P_m are functions of parts."""

    pair: Longs
    part: Longs
    N_s: Floats
    N_m: Floats
    nu: Floats  # (q, 3)
    P_s: Floats
    P_m: Floats
    weight: Floats
    Phi: Floats
    duals: Floats
    height: Floats
    free: Bools  # (q,)


class _Given(NamedTuple):
    """The integrands and coefficients of the slave facets, see `Integrands` and `Coefficients`."""

    c: Floats
    n: Floats
    which: Bools
    inverse: Floats
    g: Floats


@numba.njit(cache=True)
def _integrate_points(sides, at, given, forces, gaps, by_slave):  # type: ignore[no-untyped-def]
    """Add all points of segments to the derivatives of their pairs."""
    x_s, x_m, n_0, G0, pairs = sides
    pair, part, N_s, dN_s, N_m, dN_m, weight, Phi, duals, height, slope = at
    c, n, which, inverse, g = given
    k, size = N_s.shape[1], N_s.shape[1] + N_m.shape[1]
    o, s, normal = np.empty(3), np.empty(3), np.empty(3)
    a, b, dual = np.empty((2, 3)), np.empty((2, 3)), np.empty((2, 3))
    r, e, v = np.empty(3 * k), np.empty((2, 3 * size)), np.empty(3 * size)
    t, y, u = np.empty((3, k)), np.zeros(k), np.empty(k)
    last = len(height) - 1  # 0 where there are no heights
    for q in range(len(pair)):
        p, z, i_0 = pair[q], min(q, last), part[q]
        f, m = pairs[p]
        _find_offset(x_s[f], x_m[m], N_s[q], N_m[q], o)
        gamma = n_0[i_0, 0] * o[0] + n_0[i_0, 1] * o[1] + n_0[i_0, 2] * o[2]
        _stretch(x_s[f], dN_s[q], a, normal, dual, r)
        _tangents(x_m[m], dN_m[q], b)
        _dual_across(b, n_0[i_0], dual)
        for h in range(2):
            _relative_motion(dual[h], N_s[q], N_m[q], gamma, n_0[i_0], G0[i_0], e[h])
        _sum_tractions(Phi[q], c[f], s)
        _add_weights(s, N_s[q], N_m[q], r, 3 * k, forces[p])
        _add_points(s, dN_m[q], e, k, forces[p], v)
        if which[f]:
            _dual_change(weight[q], duals[q], Phi[q], s, c[f], inverse[f], g[f], t, y, u)
            for h in range(3):
                for j in range(k):
                    _add_row(t[h, j], r, 3 * k, by_slave[f, h, j])
        for j in range(k):
            n_j = n[f, j]
            along = n_j[0] * o[0] + n_j[1] * o[1] + n_j[2] * o[2] - height[z]
            _add_row(Phi[q, j] * along + y[j] * which[f], r, 3 * k, gaps[p, j])
            _add_gap(n_j, Phi[q, j], b, slope[z], N_s[q], N_m[q], e, gaps[p, j])


@numba.njit(cache=True)
def _integrate_edges(  # type: ignore[no-untyped-def]
    sides, at, given, forces, gaps, by_slave, by_master, place
):
    """Add all points on edges to the derivatives of their pairs.

    Where another facet covers what one loses, functions of the slave stay as they are. The place of
    a pair with free edges is its row in ``by_master``.
    """
    x_s, x_m, n_0, G0, pairs = sides
    pair, part, N_s, N_m, nu, P_s, P_m, weight, Phi, duals, height, free = at
    c, n, _, inverse, g = given
    k, size = N_s.shape[1], N_s.shape[1] + N_m.shape[1]
    o, s, d = np.empty(3), np.empty(3), np.empty(3)
    r, t, y, u = np.empty(3 * size), np.empty((3, k)), np.zeros(k), np.empty(k)
    last = len(height) - 1
    for q in range(len(pair)):
        p, z, i_0 = pair[q], min(q, last), part[q]
        f, m = pairs[p]
        for i in range(3):
            d[i] = -nu[q, i]
        _find_offset(x_s[f], x_m[m], P_s[q], P_m[q], o)
        gamma = n_0[i_0, 0] * o[0] + n_0[i_0, 1] * o[1] + n_0[i_0, 2] * o[2]
        _relative_motion(d, P_s[q], P_m[q], gamma, n_0[i_0], G0[i_0], r)
        _find_offset(x_s[f], x_m[m], N_s[q], N_m[q], o)
        _sum_tractions(Phi[q], c[f], s)
        _add_weights(s, N_s[q], N_m[q], r, 3 * size, forces[p])
        if free[q]:
            _dual_change(weight[q], duals[q], Phi[q], s, c[f], inverse[f], g[f], t, y, u)
            for h in range(3):
                for j in range(k):
                    _add_row(t[h, j], r, 3 * k, by_slave[f, h, j])
                    _add_row(t[h, j], r[3 * k :], 3 * (size - k), by_master[place[p], h, j])
        for j in range(k):
            n_j = n[f, j]
            along = n_j[0] * o[0] + n_j[1] * o[1] + n_j[2] * o[2] - height[z]
            _add_row(Phi[q, j] * along + y[j] * free[q], r, 3 * size, gaps[p, j])


def differentiate_pairs(
    slave: Facets,
    master: Facets,
    pairs: Ints,
    points: tuple[Points, EdgePoints],
    Phi: tuple[Floats, Floats],
    duals: tuple[Floats, Floats],
    given: Integrands,
    coefficients: Coefficients,
    heights: tuple[Heights, Heights] | None = None,
) -> PairIntegrals:
    """Return the derivatives of forces and weighted gaps of pairs of facets.

    Those by the vectors c_j and n_j, and by h at given points of both facets are not among them.

    Args:
        slave: Slave facets (ms,).
        master: Master facets (mm,).
        pairs: Pairs (p, 2).
        points: Their points (q,), and those on edges (r,).
        Phi: Values of Phi_j times weights at both, (q, k) and (r, k).
        duals: Values of N~_j there.
        given: What is integrated.
        coefficients: Of the dual functions; they change on facets with free edges at least.
        heights: Heights at both; 0 if not given.
    """
    k, n = slave.element.nodes, master.element.nodes
    n_0, G0 = _planes_of_parts(slave)
    inner, edges = points
    with_edges, place = np.unique(edges.pair[edges.free]), np.zeros(len(pairs), dtype=np.int64)
    place[with_edges] = np.arange(len(with_edges))
    forces, gaps = (
        np.zeros((len(pairs), k + n, 3, 3 * (k + n))),
        np.zeros((len(pairs), k, 3 * (k + n))),
    )
    by_slave = np.zeros((len(slave.x), 3, k, 3 * k))
    by_master = np.zeros((len(with_edges), 3, k, 3 * n))
    none = Heights(np.zeros(1), np.zeros((1, 2)))
    h, h_e = (none, none) if heights is None else heights
    sides = _Sides(slave.x, master.x, n_0, G0, pairs)
    changed = coefficients.which, coefficients.inverse, coefficients.gaps
    fixed = _Given(given.c, given.n, *changed)
    parts = [
        pairs[at.pair, 0].astype(np.int64) * count(slave.element) + part_at(slave.element, at.xi_s)
        for at in points
    ]
    at_points = _AtPoints(
        inner.pair,
        parts[0],
        *_functions(slave, inner.xi_s),
        *_functions(master, inner.xi_m),
        inner.weight,
        Phi[0],
        duals[0],
        h.h,
        h.by_xi_m,
    )
    N_s, N_m = _functions(slave, edges.xi_s)[0], _functions(master, edges.xi_m)[0]
    of_parts, at_edges = (edges.nu, edges.N_s, edges.N_m), (edges.weight, Phi[1], duals[1])
    on_edges = _OnEdges(edges.pair, parts[1], N_s, N_m, *of_parts, *at_edges, h_e.h, edges.free)
    sums = forces, gaps, by_slave
    _integrate_points(sides, at_points, fixed, *sums)
    _integrate_edges(sides, on_edges, fixed, *sums, by_master, place)
    return PairIntegrals(
        forces.reshape(-1, k + n, 3, k + n, 3),
        gaps.reshape(-1, k, k + n, 3),
        by_slave.reshape(-1, 3, k, k, 3),
        by_master.reshape(-1, 3, k, n, 3),
        with_edges,
    )


def differentiate_integrals(
    slave: Facets,
    master: Facets,
    pairs: Ints,
    points: tuple[Points, EdgePoints],
    N: tuple[Floats, Floats],
    n: Floats,
    h: Floats,
) -> Floats:
    """Return the derivatives (p, k, k + l, 3) of int N_j (n.o - h) over pairs at fixed n and h.

    Args:
        slave: Slave facets (ms,).
        master: Master facets (mm,).
        pairs: Pairs (p, 2).
        points: Their points (q,), and those on edges (r,) that bound the pairs.
        N: Values of functions on the slave facets at both, (q, k) and (r, k).
        n: Vector (ms, 3) of each slave facet.
        h: Number (ms,) of each.
    """
    inner, edges = points
    m, k = slave.x.shape[:2]
    held = Coefficients(np.zeros(m, dtype=bool), np.zeros((m, k, k)), np.zeros((m, k, k)))
    vectors = Integrands(np.zeros((m, k, 3)), np.repeat(n[:, None], k, axis=1))
    a, b = (Heights(h[pairs[at.pair, 0]], np.zeros((len(at.pair), 2))) for at in points)
    edges = replace(edges, free=np.zeros_like(edges.free))  # functions do not change
    weighted = N[0] * inner.weight[:, None], N[1] * edges.weight[:, None]
    at = slave, master, pairs, (inner, edges), weighted, N, vectors, held, (a, b)
    return differentiate_pairs(*at).gaps


def _functions(facets: Facets, xi: Floats) -> tuple[Floats, Floats]:
    """Return shape functions (q, k) and their derivatives (q, k, 2), contiguous."""
    element = facets.element
    N, dN = element.shape_functions(xi), element.derivatives(xi)
    return np.ascontiguousarray(N), np.ascontiguousarray(dN)


def _planes_of_parts(facets: Facets) -> tuple[Floats, Floats]:
    """Return the normals (m * s, 3) of parts, and gradients (m * s, k, 3) in their middle."""
    parts, s = parts_of(facets), count(facets.element)
    middle = parts.element.points.mean(axis=0, keepdims=True).repeat(len(parts.x), axis=0)
    G0, _ = surface_gradients(parts, np.arange(len(parts.x), dtype=np.int32), middle)
    every = np.zeros((len(parts.x), facets.element.nodes, 3))
    nodes = np.tile(np.array(facets.element.sub_facets), (len(facets.x), 1))
    np.put_along_axis(every, nodes[:, :, None], G0, axis=1)
    assert len(every) == s * len(facets.x)
    return facet_normals(parts), every

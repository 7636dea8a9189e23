# SPDX-License-Identifier: MIT
r"""Derivatives of integrals over the segments of pairs of facets in 3D (compiled kernels).

Of first-order facets. The points of a slave facet stay at their xi; each is projected along the
mean normal n_0 of the facet. With the offset o = x_m - x_s = gamma n_0, the surface gradients G_k
of the slave's functions (G0_k in the middle of the facet, where its normal is n_0) and m^a, dual to
the tangents y_a of the master in the plane across n_0,

    d n_0   = -sum_k G0_k (n_0.dx_k)
    d eta^a = m^a.(dx_s - dx_m + gamma dn_0)          dx_m at fixed eta
    dw / w  = sum_k G_k.dx_k                          of the weights

Edges between two master facets move, too, but what one of them gains the other one loses. Those
without a neighbour bound the covered part: with the normal nu of the edge in the plane, outward,
and the area c of the facet per area in the plane, integrals of f gain

    int f c nu.(dx_m - dx_s - gamma dn_0) ds.

Points on such edges are added to those of the segments: for them alone c ds is the weight, and
nu.(dx_m - dx_s - gamma dn_0) stands for dw / w. Edges that one master facet casts on another one
behind it are held.
"""

from dataclasses import dataclass

import numba
import numpy as np

from dolfinx_mortar.arrays import Bools, Floats, Ints, Longs
from dolfinx_mortar.geometry import plane
from dolfinx_mortar.geometry.facets import Facets, facet_normals, surface_gradients
from dolfinx_mortar.geometry.plane import create_planes, inverse, project, slopes
from dolfinx_mortar.geometry.tolerances import HALF_OF_DIGITS

_ON_EDGES = {False: 3, True: 12}
"""Gauss points on edges; with quadrilaterals functions along straight lines are no polynomials."""


@dataclass(frozen=True, eq=False)
class Points:
    """Points (q,) of segments, and on free edges of master facets: there alone nu is not zero."""

    pair: Longs  # (q,) pair
    xi_s: Floats  # (q, 2)
    xi_m: Floats  # (q, 2)
    weight: Floats  # (q,)
    nu: Floats  # (q, 3)


@dataclass(frozen=True, eq=False)
class PairIntegrals:
    """Derivatives of integrals over pairs (p,) by the coordinates of their k + l nodes.

    With given functions Phi_j and vectors c_j and n_j at the slave's nodes, s = sum_j Phi_j c_j.
    """

    forces: Floats  # (p, k + l, 3, k + l, 3) of int s N_k, and of -int s N_l
    gaps: Floats  # (p, k, k + l, 3) of int Phi_j (n_j.o - h)
    moments: Floats  # (p, k, k, k + l, 3) of int N_a N_b


@dataclass(frozen=True, eq=False)
class PointHeights:
    """Heights h at points, and their derivatives by eta."""

    h: Floats  # (q,)
    by_xi_m: Floats  # (q, 2)


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
def _edge_points(x_s, x_m, bilinear, pairs, free, centre, axes, radius, t, w):  # type: ignore[no-untyped-def]
    """Return pair, xi_s, xi_m, weight and nu of the points on free edges."""
    total = free.sum() * len(t)
    pair, weight = np.empty(total, np.int64), np.empty(total)
    xi_s, xi_m, nu = np.empty((total, 2)), np.empty((total, 2)), np.empty((total, 3))
    k, n = x_s.shape[1], x_m.shape[1]
    S, M = np.empty((k, 3)), np.empty((n, 3))
    q = 0
    for p in range(len(pairs)):
        for i in range(n):
            if not free[p, i]:
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
                pair[q] = p
                q += 1
    return pair[:q], xi_s[:q], xi_m[:q], weight[:q], nu[:q]


def place_on_edges(slave: Facets, master: Facets, pairs: Ints, free: Bools) -> Points:
    """Return the points on the free edges of the master facets of pairs, inside the slave facets.

    Args:
        slave: Slave facets (ms,).
        master: Master facets (mm,).
        pairs: Pairs (p, 2).
        free: Edges (p, l) of the master facets without a neighbour that covers the slave, too; edge
            i is that from node i to the next one.
    """
    bilinear = slave.element.bilinear, master.element.bilinear
    t, w = np.polynomial.legendre.leggauss(_ON_EDGES[any(bilinear)])
    planes = create_planes(slave)
    found = _edge_points(slave.x, master.x, bilinear, pairs, free, *planes, (1 + t) / 2, w / 2)
    return Points(*found)


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
    """Write the derivative (k + l, 3) of d.(dx_s - dx_m + gamma dn_0) into row."""
    k = len(N_s)
    for j in range(k):
        turn = gamma * (d[0] * G0[j, 0] + d[1] * G0[j, 1] + d[2] * G0[j, 2])
        for i in range(3):
            row[j, i] = N_s[j] * d[i] - turn * n_0[i]
    for j in range(len(N_m)):
        for i in range(3):
            row[k + j, i] = -N_m[j] * d[i]


@numba.njit(**_PRODUCTS)
def _stretch(x, dN, a, normal, dual, row):  # type: ignore[no-untyped-def]
    """Write the derivatives of ln |a_1 x a_2| by the nodes x (k, 3) into the first rows."""
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
            row[j, i] = dN[j, 0] * dual[0, i] + dN[j, 1] * dual[1, i]


@numba.njit(**_PRODUCTS)
def _point_rows(  # type: ignore[no-untyped-def]
    x, y, n_0, G0, N_s, dN_s, N_m, dN_m, nu, on_edge, o, a, b, dual, normal, r, e
):
    """Write the offset, the master's tangents, and dw/w and d eta by the nodes into o, b, r, e."""
    _find_offset(x, y, N_s, N_m, o)
    gamma = n_0[0] * o[0] + n_0[1] * o[1] + n_0[2] * o[2]
    _tangents(y, dN_m, b)
    r[:], e[:] = 0.0, 0.0
    if on_edge:
        for i in range(3):
            dual[0, i] = -nu[i]
        _relative_motion(dual[0], N_s, N_m, gamma, n_0, G0, r)
        return
    _stretch(x, dN_s, a, normal, dual, r)
    _dual_across(b, n_0, dual)
    for c in range(2):
        _relative_motion(dual[c], N_s, N_m, gamma, n_0, G0, e[c])


@numba.njit(**_PRODUCTS)
def _add_forces(s, N_s, N_m, dN_m, r, e, forces):  # type: ignore[no-untyped-def]
    """Add what one point gives to the derivatives of the forces of its pair."""
    k, m = len(N_s), len(N_m)
    for j in range(k + m):
        for z in range(k + m):
            for h in range(3):
                if j < k:
                    value = N_s[j] * r[z, h]
                else:
                    value = -N_m[j - k] * r[z, h]
                    value -= dN_m[j - k, 0] * e[0, z, h] + dN_m[j - k, 1] * e[1, z, h]
                for i in range(3):
                    forces[j, i, z, h] += s[i] * value


@numba.njit(**_PRODUCTS)
def _add_gap(n, Phi, o, b, height, slope, N_s, N_m, r, e, area, gap):  # type: ignore[no-untyped-def]
    """Add what one point gives to the derivative (k + l, 3) of one weighted gap of its pair."""
    k, m = len(N_s), len(N_m)
    along = n[0] * o[0] + n[1] * o[1] + n[2] * o[2] - height
    along_0 = n[0] * b[0, 0] + n[1] * b[0, 1] + n[2] * b[0, 2] - slope[0]
    along_1 = n[0] * b[1, 0] + n[1] * b[1, 1] + n[2] * b[1, 2] - slope[1]
    for z in range(k + m):
        N = area * (-N_s[z] if z < k else N_m[z - k])
        for h in range(3):
            change = along * r[z, h] + along_0 * e[0, z, h] + along_1 * e[1, z, h]
            gap[z, h] += Phi * (change + N * n[h])


@numba.njit(**_PRODUCTS)
def _add_moments(w, N, r, moments):  # type: ignore[no-untyped-def]
    """Add what one point gives to the derivatives (k, k, k + l, 3) of int N_a N_b."""
    for i in range(len(N)):
        for j in range(len(N)):
            value = w * N[i] * N[j]
            for z in range(len(r)):
                for h in range(3):
                    moments[i, j, z, h] += value * r[z, h]


@numba.njit(cache=True)
def _add_points(  # type: ignore[no-untyped-def]
    x_s, x_m, n_0, G0, pairs, pair, N_s, dN_s, N_m, dN_m, weight, nu, Phi, c, n,
    height, slope, forces, gaps, moments,
):  # fmt: skip
    """Add all points to the derivatives of their pairs."""
    size = N_s.shape[1] + N_m.shape[1]
    k = N_s.shape[1]
    o, s, normal = np.empty(3), np.empty(3), np.empty(3)
    a, b, dual = np.empty((2, 3)), np.empty((2, 3)), np.empty((2, 3))
    r, e = np.empty((size, 3)), np.empty((2, size, 3))
    last = len(height) - 1  # 0 where there are no heights
    for q in range(len(pair)):
        p, z = pair[q], min(q, last)
        f, m = pairs[p]
        on_edge = nu[q, 0] ** 2 + nu[q, 1] ** 2 + nu[q, 2] ** 2 > 0.0
        _point_rows(
            x_s[f], x_m[m], n_0[f], G0[f], N_s[q], dN_s[q], N_m[q], dN_m[q], nu[q], on_edge,
            o, a, b, dual, normal, r, e,
        )  # fmt: skip
        for i in range(3):
            s[i] = 0.0
            for j in range(k):
                s[i] += Phi[q, j] * c[f, j, i]
        _add_forces(s, N_s[q], N_m[q], dN_m[q], r, e, forces[p])
        area = 0.0 if on_edge else 1.0
        for j in range(k):
            _add_gap(
                n[f, j], Phi[q, j], o, b, height[z], slope[z], N_s[q], N_m[q], r, e, area,
                gaps[p, j],
            )  # fmt: skip
        _add_moments(weight[q], N_s[q], r, moments[p])


def differentiate_pairs(
    slave: Facets,
    master: Facets,
    pairs: Ints,
    points: Points,
    Phi: Floats,
    c: Floats,
    n: Floats,
    heights: PointHeights | None = None,
) -> PairIntegrals:
    """Return the derivatives of forces, weighted gaps and moments of pairs of facets.

    Those by the functions Phi_j, by the vectors c_j and n_j, and by h at given points of both
    facets are not among them.

    Args:
        slave: First-order slave facets (ms,).
        master: First-order master facets (mm,).
        pairs: Pairs (p, 2).
        points: Their points (q,), those on free edges included.
        Phi: Values of Phi_j times weights at the points (q, k).
        c: Vectors c_j (ms, k, 3) at the nodes of the slave facets.
        n: Vectors n_j (ms, k, 3) there.
        heights: Heights at the points; 0 if not given.
    """
    k, count = slave.element.nodes, len(slave.x)
    size = k + master.element.nodes
    middle = slave.element.points.mean(axis=0, keepdims=True).repeat(count, axis=0)
    G0, _ = surface_gradients(slave, np.arange(count, dtype=np.int32), middle)
    found = PairIntegrals(
        np.zeros((len(pairs), size, 3, size, 3)),
        np.zeros((len(pairs), k, size, 3)),
        np.zeros((len(pairs), k, k, size, 3)),
    )
    if heights is None:
        heights = PointHeights(np.zeros(1), np.zeros((1, 2)))
    functions = [
        np.ascontiguousarray(v)
        for element, xi in ((slave.element, points.xi_s), (master.element, points.xi_m))
        for v in (element.shape_functions(xi), element.derivatives(xi))
    ]
    _add_points(
        slave.x, master.x, facet_normals(slave), G0, pairs, points.pair, *functions,
        points.weight, points.nu, Phi, c, n, heights.h, heights.by_xi_m,
        found.forces, found.gaps, found.moments,
    )  # fmt: skip
    return found

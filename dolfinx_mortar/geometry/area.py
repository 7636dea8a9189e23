# SPDX-License-Identifier: MIT
"""Segments in 3D: convex polygons in the auxiliary planes of the slave facets.

The plane is normal to the mean normal of a slave facet, through its centre. The intersection of
both projected facets is split into triangles; weights are areas in the plane over the cosine to the
slave facet. Facets of second order are clipped in four parts. Integrals of Phi_j N_l are exact on
flat triangles and parallelograms, else of a degree by the change of Jacobian and slopes.
"""

from functools import cache
from typing import Any, NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from dolfinx_mortar.common.arrays import SAME, Bools, Floats, Ints, Longs
from dolfinx_mortar.geometry import plane
from dolfinx_mortar.geometry.elements import FacetElement, triangle_rule
from dolfinx_mortar.geometry.facets import Facets, bounding_balls
from dolfinx_mortar.geometry.plane import (
    VERTICES,
    create_planes,
    height_at,
    inverse,
    on_facets,
    pairs_of_parts,
    parts_of,
    project,
    slopes,
)
from dolfinx_mortar.geometry.tolerances import KERNEL, ROUND_OFF

_HIGHEST = 24
"""Highest degree of the quadrature; it limits the accuracy on facets of low quality, see above."""


@cache
def _rules() -> tuple[Floats, Floats, Longs]:
    points, weights, start = [], [], [0]
    for degree in range(2, _HIGHEST + 2, 2):
        p, w = triangle_rule(degree)
        points.append(p)
        weights.append(w)
        start.append(start[-1] + len(w))
    return np.concatenate(points), np.concatenate(weights), np.array(start, dtype=np.int64)


@numba.njit(**KERNEL)
def _depth(S, M, bilinear, x, y):  # type: ignore[no-untyped-def]
    xi, eta, _ = inverse(S, bilinear[0], x, y)
    r, s, _ = inverse(M, bilinear[1], x, y)
    return height_at(S, bilinear[0], xi, eta) - height_at(M, bilinear[1], r, s)


@numba.njit(**KERNEL)
def _overlap(P, Q):  # type: ignore[no-untyped-def]
    p, q = P.shape[0], Q.shape[0]
    # overlaps as narrow as a thin polygon do not count
    if plane.is_beside(P, p, Q, q, plane.orientation(P, p), -64 * ROUND_OFF):
        return False
    return not plane.is_beside(Q, q, P, p, plane.orientation(Q, q), -64 * ROUND_OFF)


@numba.njit(**KERNEL)
def _any_overlap(M, count):  # type: ignore[no-untyped-def]
    low, high = np.empty(count), np.empty(count)
    for i in range(count):
        low[i] = high[i] = M[i, 0, 0]
        for k in range(1, M.shape[1]):
            low[i], high[i] = min(low[i], M[i, k, 0]), max(high[i], M[i, k, 0])
        for j in range(i):
            if high[j] > low[i] and high[i] > low[j] and _overlap(M[i], M[j]):
                return True
    return False


@numba.njit(**KERNEL)
def _is_hidden(S, M, bilinear, i, j, pieces, sizes, common, spare):  # type: ignore[no-untyped-def]
    """Whether facet j hides facet i, consistently in i and j."""
    a, b = min(i, j), max(i, j)
    if a == b or not _overlap(M[a], M[b]):
        return False
    n = M.shape[1]
    sign = plane.orientation(M[b], n)
    size = plane.intersect(pieces[a], sizes[a], M[b], n, sign, common, spare)
    if plane.is_thin(common, size):
        return False
    _, x, y = plane.measure(common, size)
    behind = abs(_depth(S, M[b], bilinear, x, y)) < abs(_depth(S, M[a], bilinear, x, y))
    return behind if i == a else not behind


@numba.njit(**KERNEL)
def _doubled(a):  # type: ignore[no-untyped-def]
    result = np.empty((2 * len(a),) + a.shape[1:], a.dtype)  # noqa: RUF005
    x, y = a.reshape(-1), result.reshape(-1)
    for i in range(len(x)):
        y[i] = x[i]
    return result


@numba.njit(**KERNEL)
def _visible(S, M, bilinear, given, given_sizes, i, n):  # type: ignore[no-untyped-def]
    pieces = np.empty((2 * VERTICES, VERTICES, 2))
    sizes = np.empty(2 * VERTICES, np.int64)
    common, spare = np.empty((VERTICES, 2)), np.empty((VERTICES, 2))
    plane.copy(given[i], given_sizes[i], pieces[0])
    sizes[0], count = given_sizes[i], 1
    for j in range(n):
        if not _is_hidden(S, M, bilinear, i, j, given, given_sizes, common, spare):
            continue
        sign = plane.orientation(M[j], M.shape[1])
        k = 0
        while k < count:  # a cut adds at most one corner
            if count + VERTICES > len(sizes):
                pieces, sizes = _doubled(pieces), _doubled(sizes)
            if sizes[k] + 2 * M.shape[1] > VERTICES:
                sizes[k], sizes[count] = plane.halve(pieces[k], sizes[k], pieces[count])
                count += 1
            else:
                k += 1
        for k in range(count):
            if count + VERTICES > len(sizes):
                pieces, sizes = _doubled(pieces), _doubled(sizes)
            size, sizes[k] = sizes[k], 0
            plane.copy(pieces[k], size, common)
            if size > 2:
                count = plane.subtract(
                    common, size, M[j], M.shape[1], sign, pieces, sizes, count, spare
                )
    return pieces, sizes, count


@numba.njit(**KERNEL)
def _is_far(middle, radius, centre, axes):  # type: ignore[no-untyped-def]
    x = y = square = 0.0
    for i in range(3):
        offset, along = middle[i] - centre[i], axes[0, i]
        x, y, square = x + along * offset, y + axes[1, i] * offset, square + along**2
    return x * x + y * y > (1.0 + radius * np.sqrt(square)) ** 2


@numba.njit(**KERNEL)
def _clip(  # type: ignore[no-untyped-def]
    S, x_m, balls, bilinear, pairs, deepest, first, last, centre, axes, M, pieces, sizes, row
):
    """Fill one slave facet's M, pieces, sizes and row (pair); return the count."""
    spare = np.empty((VERTICES, 2))
    count = 0
    k, n = S.shape[0], x_m.shape[1]
    if plane.orientation(S, k) <= 0:
        return 0  # folded: no inverse map
    for r in range(first, last):
        P, m = M[count], pairs[r, 1]
        if _is_far(balls[0][m], balls[1][m], centre, axes):
            continue
        project(x_m[m], centre, axes, P)
        sign = plane.orientation(P, n)
        if sign == 0 or plane.is_beside(P, n, S, k, sign, 0.0):
            continue
        size = plane.intersect(S, k, P, n, sign, pieces[count], spare)
        if plane.is_thin(pieces[count], size):
            continue
        if deepest[r] < np.inf:
            _, x, y = plane.measure(pieces[count], size)
            if _depth(S, P, bilinear, x, y) > deepest[r]:
                continue  # behind the body
        sizes[count], row[count] = size, r
        count += 1
    return count


@numba.njit(**KERNEL)
def _append_fan(P, n, which, corners, t, pair):  # type: ignore[no-untyped-def]
    if t + VERTICES > len(which):
        which, corners = _doubled(which), _doubled(corners)
    least = ROUND_OFF * plane.measure(P, n)[0]
    for v in range(1, n - 1):
        ux, uy = P[v, 0] - P[0, 0], P[v, 1] - P[0, 1]
        vx, vy = P[v + 1, 0] - P[0, 0], P[v + 1, 1] - P[0, 1]
        if (ux * vy - uy * vx) > least:
            which[t] = pair
            for h in range(2):
                corners[t, 0, h], corners[t, 1, h] = P[0, h], P[v, h]
                corners[t, 2, h] = P[v + 1, h]
            t += 1
    return which, corners, t


@numba.njit(**KERNEL)
def _split(S, x_m, balls, bilinear, pairs, deepest, first, last, centre, axes, which, corners, t):  # type: ignore[no-untyped-def]
    """Append one slave facet's triangles; return the arrays, and if masters overlap."""
    n = last - first
    M, row = np.empty((n, x_m.shape[1], 3)), np.empty(n, np.int64)
    pieces, sizes = np.empty((n, VERTICES, 2)), np.empty(n, np.int64)
    c, a = centre, axes
    n = _clip(S, x_m, balls, bilinear, pairs, deepest, first, last, c, a, M, pieces, sizes, row)
    overlap = _any_overlap(M, n)
    for i in range(n):
        if not overlap:
            which, corners, t = _append_fan(pieces[i], sizes[i], which, corners, t, row[i])
            continue
        parts, counts, count = _visible(S, M, bilinear, pieces, sizes, i, n)
        for k in range(count):
            if counts[k] > 2:
                which, corners, t = _append_fan(parts[k], counts[k], which, corners, t, row[i])
    return which, corners, t, overlap


@numba.njit(**KERNEL)
def _triangulate(x_s, x_m, balls, bilinear, pairs, deepest, centre, axes):  # type: ignore[no-untyped-def]
    """Pairs (t,) and corners (t, 3, 2) of triangles, and where masters overlap."""
    p, hidden = len(pairs), np.zeros(len(x_s), np.bool_)
    which, corners = np.empty(4 * p + 64, dtype=np.int64), np.empty((4 * p + 64, 3, 2))
    S = np.empty((x_s.shape[1], 3))
    t = last = np.int64(0)  # literals have another type: callees would compile twice
    while last < p:
        first, s = last, pairs[last, 0]
        while last < p and pairs[last, 0] == s:
            last += 1
        project(x_s[s], centre[s], axes[s], S)
        at = first, last, centre[s], axes[s]
        which, corners, t, hidden[s] = _split(
            S, x_m, balls, bilinear, pairs, deepest, *at, which, corners, t
        )
    return which[:t], corners[:t], hidden


@numba.njit(**KERNEL)
def _changes(P, bilinear, corners):  # type: ignore[no-untyped-def]
    if not bilinear:
        return 0.0, 0.0
    low, high, turn = np.inf, 0.0, 0.0
    s0, s1 = np.empty(3), np.empty(3)
    for v in range(3):
        xi, eta, J = inverse(P, bilinear, corners[v, 0], corners[v, 1])
        low, high = min(low, J), max(high, J)
        s0[v], s1[v] = slopes(P, bilinear, xi, eta)
    for v in range(3):
        turn = max(turn, (s0[v] - s0[v - 1]) ** 2 + (s1[v] - s1[v - 1]) ** 2)
    return (high - low) / (high + low), turn


@numba.njit(**KERNEL)
def _choose_rules(x_s, x_m, bilinear, pairs, centre, axes, which, corners, least):  # type: ignore[no-untyped-def]
    rule = np.full(len(which), least // 2 - 1)
    if not (bilinear[0] or bilinear[1]):
        return rule
    S, M = np.empty((x_s.shape[1], 3)), np.empty((x_m.shape[1], 3))
    for t in range(len(which)):
        s, m = pairs[which[t]]
        project(x_s[s], centre[s], axes[s], S)
        project(x_m[m], centre[s], axes[s], M)
        variation, turn = _changes(S, bilinear[0], corners[t])
        variation += _changes(M, bilinear[1], corners[t])[0]
        variation = max(variation, turn / 2)  # the weight contains sqrt(1 + slope^2)
        degree = float(least)
        if variation > 0.0:
            # inverse maps are singular 1 / variation triangles away; SAME is for one function
            degree = _HIGHEST
            if variation < 2.0:
                degree = min(least // 2 + np.log(SAME) / np.log(variation / 2), degree)
        rule[t] = min(max(np.ceil(degree / 2), least / 2), _HIGHEST // 2) - 1
    return rule


@numba.njit(**KERNEL)
def place(  # type: ignore[no-untyped-def]
    x_s, x_m, bilinear, pairs, centre, axes, radius, which, corners, size, rule, whole, points,
    weights, start
):  # fmt: skip
    """Points of a rule (t,) on triangles: pair of parts, both coordinates and weight."""
    total = 0
    for t in range(len(which)):
        total += start[rule[t] + 1] - start[rule[t]]
    pair, weight = np.empty(total, np.int64), np.empty(total)
    xi_s, xi_m = np.empty((total, 2)), np.empty((total, 2))
    S, M = np.empty((x_s.shape[1], 3)), np.empty((x_m.shape[1], 3))
    q = 0
    for t in range(len(which)):
        s, m = pairs[which[t]]
        if t == 0 or which[t] != which[t - 1]:
            project(x_s[s], centre[s], axes[s], S)
            project(x_m[m], centre[s], axes[s], M)
        for i in range(start[rule[t]], start[rule[t] + 1]):
            x, y = _inside(corners[t], points[i, 0], points[i, 1])
            xi_s[q, 0], xi_s[q, 1], J = inverse(S, bilinear[0], x, y)
            xi_m[q, 0], xi_m[q, 1], _ = inverse(M, bilinear[1], x, y)
            weight[q] = weights[i] * size[t] / J
            if whole:
                s0, s1 = slopes(S, bilinear[0], xi_s[q, 0], xi_s[q, 1])
                weight[q] *= radius[s] ** 2 * J * np.sqrt(1 + s0 * s0 + s1 * s1)
            pair[q] = which[t]
            q += 1
    return pair, xi_s, xi_m, weight


@numba.njit(**KERNEL)
def _inside(c, r, s):  # type: ignore[no-untyped-def]
    x = c[0, 0] + r * (c[1, 0] - c[0, 0]) + s * (c[2, 0] - c[0, 0])
    return x, c[0, 1] + r * (c[1, 1] - c[0, 1]) + s * (c[2, 1] - c[0, 1])


def areas(c: Floats) -> Floats:
    """Areas (t,) of triangles (t, 3, 2)."""
    u, v = c[:, 1] - c[:, 0], c[:, 2] - c[:, 0]
    return np.asarray(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]) / 2


def place_points(
    slave: Facets, master: Facets, pairs: Ints, deepest: Floats
) -> tuple[npt.NDArray[Any], Floats, Floats, Floats]:
    """See `line.place_points`; folded facets cover nothing."""
    least = least_degree(slave.element, master.element)
    over = find_overlaps(slave, master, pairs, deepest)
    at, triangles = (*over.sides, *over.planes), (over.which, over.corners)
    rule = _choose_rules(*at[:-1], *triangles, least)
    whole = slave.element.part is None and master.element.part is None
    sizes = areas(over.corners)
    pair, xi_s, xi_m, weight = place(*at, *triangles, sizes, rule, whole, *_rules())
    if whole:
        return pair, xi_s, xi_m, weight
    points = {"xi_s": xi_s, "xi_m": xi_m, "weight": weight}
    return over.of[pair], *on_facets(slave, master, at[5], over.pairs[pair], **points)


class Overlaps(NamedTuple):
    """Facets that overlap in the auxiliary planes of the slave's parts."""

    slave: Facets  # (ms,)
    master: Facets  # (mm,)
    parts: Facets  # of the slave
    sides: tuple[Floats, Floats, tuple[bool, bool], Ints]  # parts, whether bilinear, pairs of parts
    of: Ints  # (p',) pair of facets
    planes: tuple[Floats, Floats, Floats]  # see `create_planes`
    which: Longs  # (t,) pairs of parts of the triangles
    corners: Floats  # (t, 3, 2)
    hidden: Bools  # (parts,) whether masters hide others

    @property
    def pairs(self) -> Ints:
        """Pairs (p', 2) of parts."""
        return self.sides[3]


def find_overlaps(slave: Facets, master: Facets, pairs: Ints, deepest: Floats) -> Overlaps:
    """Where facets of pairs (p, 2) overlap."""
    parts_s, parts_m = parts_of(slave), parts_of(master)
    pairs, of = pairs_of_parts(pairs, slave.element, master.element)
    planes = create_planes(parts_s.x)
    sides = parts_s.x, parts_m.x, (parts_s.element.bilinear, parts_m.element.bilinear), pairs
    limits = deepest[of] / planes[2][pairs[:, 0]]  # lengths in the planes are relative
    balls = bounding_balls(parts_m.x)
    found = _triangulate(*sides[:2], balls, *sides[2:], limits, *planes[:2])
    return Overlaps(slave, master, parts_s, sides, of, planes, *found)


def least_degree(slave: FacetElement, master: FacetElement) -> int:
    """Degree for products of two functions on affine facets.

    With twists phi relative errors are up to 1e-5 phi^4 in D_jj and 2e-3 phi^2 in M; forces are
    exact.
    """
    return max(slave.degree, master.degree) * (4 if slave.bilinear or master.bilinear else 2)


def degree_of_moments(slave: FacetElement, master: FacetElement, smooth: bool) -> int:
    """Degree for `moments`, for errors of derivatives below 1e-3 on warped facets."""
    return max(2 + smooth, min(least_degree(slave, master), 4))

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
from dolfinx_mortar.geometry.facets import FacetElement, Facets, rule_on
from dolfinx_mortar.geometry.plane import (
    VERTICES,
    are_apart,
    coefficients,
    copy,
    count,
    create_planes,
    cut,
    evaluate,
    intersect,
    inverse,
    is_beside,
    is_thin,
    locate,
    measure,
    meet,
    orientation,
    pairs_of_parts,
    parts_of,
    project,
    project_map,
    reference_parts,
    slopes,
)
from dolfinx_mortar.geometry.tolerances import FIRST, KERNEL, ROUND_OFF, SECOND, THIRD

_HIGHEST = 24
"""Highest degree of the quadrature; it limits the accuracy on facets of low quality, see above."""


@cache
def _rules() -> tuple[Floats, Floats, Longs]:
    found = [rule_on("triangle", degree) for degree in range(2, _HIGHEST + 2, 2)]
    points, weights = map(np.concatenate, zip(*found, strict=True))
    return points, weights, np.cumsum([0, *(len(w) for _, w in found)])


@numba.njit(**KERNEL)
def _depth(S, M, x, y):  # type: ignore[no-untyped-def]
    xi, eta, _ = inverse(S, x, y)
    r, s, _ = inverse(M, x, y)
    return evaluate(S, THIRD, xi, eta) - evaluate(M, THIRD, r, s)


@numba.njit(**KERNEL)
def _is_hidden(S, M, i, j, pieces, sizes, common, spare):  # type: ignore[no-untyped-def]
    """Whether facet j hides facet i, consistently in i and j."""
    a, b = min(i, j), max(i, j)
    # overlaps as narrow as a thin polygon do not count
    if a == b or are_apart(M[a], M[b], -64 * ROUND_OFF):
        return False
    n = M.shape[1]
    size = intersect(pieces[a], sizes[a], M[b], n, orientation(M[b], n), common, spare)
    if is_thin(common, size):
        return False
    _, x, y = measure(common, size)
    behind = abs(_depth(S, M[b], x, y)) < abs(_depth(S, M[a], x, y))
    return behind if i == a else not behind


@numba.njit(**KERNEL)
def _doubled(a):  # type: ignore[no-untyped-def]
    result = np.empty((2 * len(a),) + a.shape[1:], a.dtype)  # noqa: RUF005
    x, y = a.reshape(-1), result.reshape(-1)
    for i in range(len(x)):
        y[i] = x[i]
    return result


@numba.njit(**KERNEL)
def _clip(  # type: ignore[no-untyped-def]
    S, x_m, pairs, deepest, first, last, centre, axes, M, pieces, sizes, row
):
    """Fill one slave facet's M, pieces, sizes and row (pair); return the count."""
    spare = np.empty((VERTICES, 2))
    count = 0
    k, n = S.shape[0], x_m.shape[1]
    if orientation(S, k) <= 0:
        return 0  # folded: no inverse map
    for r in range(first, last):
        P = M[count]
        project(x_m[pairs[r, 1]], centre, axes, P)
        sign = orientation(P, n)
        if sign == 0 or is_beside(P, n, S, k, sign, 0.0):
            continue
        size = intersect(S, k, P, n, sign, pieces[count], spare)
        if is_thin(pieces[count], size):
            continue
        if deepest[r] < np.inf:
            _, x, y = measure(pieces[count], size)
            if _depth(S, P, x, y) > deepest[r]:
                continue  # behind the body
        sizes[count], row[count] = size, r
        count += 1
    return count


@numba.njit(**KERNEL)
def _append_fan(P, n, which, corners, t, pair):  # type: ignore[no-untyped-def]
    if t + VERTICES > len(which):
        which, corners = _doubled(which), _doubled(corners)
    least = ROUND_OFF * measure(P, n)[0]
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
def _subtract(Q, which, corners, first, t, pair):  # type: ignore[no-untyped-def]
    """Subtract a convex polygon from triangles from the first on; return the arrays."""
    rest, inside, outside = np.empty((3, VERTICES, 2))
    last, m, sign = t, len(Q), orientation(Q, len(Q))
    for k in range(first, last):
        copy(corners[k], 3, rest)
        n = 3
        for i in range(m):
            j = i + 1 if i + 1 < m else 0
            a, b = (i, j) if sign > 0 else (j, i)
            size = cut(rest, n, Q[b, 0], Q[b, 1], Q[a, 0], Q[a, 1], outside)
            if not is_thin(outside, size):
                which, corners, t = _append_fan(outside, size, which, corners, t, pair)
            n = cut(rest, n, Q[a, 0], Q[a, 1], Q[b, 0], Q[b, 1], inside)
            copy(inside, n, rest)
            if n < 3:
                break
    for k in range(last, t):
        copy(corners[k], 3, corners[first + k - last])
        which[first + k - last] = pair
    return which, corners, first + t - last


@numba.njit(**KERNEL)
def _split(S, x_m, pairs, deepest, first, last, centre, axes, which, corners, t):  # type: ignore[no-untyped-def]
    """Append one slave facet's triangles; return the arrays, and if masters hide others."""
    n, hidden = last - first, False
    M, row = np.empty((n, x_m.shape[1], 3)), np.empty(n, np.int64)
    pieces, sizes = np.empty((n, VERTICES, 2)), np.empty(n, np.int64)
    common, spare = np.empty((VERTICES, 2)), np.empty((VERTICES, 2))
    c, a = centre, axes
    n = _clip(S, x_m, pairs, deepest, first, last, c, a, M, pieces, sizes, row)
    for i in range(n):
        start = t
        which, corners, t = _append_fan(pieces[i], sizes[i], which, corners, t, row[i])
        for j in range(n):
            if _is_hidden(S, M, i, j, pieces, sizes, common, spare):
                which, corners, t = _subtract(M[j], which, corners, start, t, row[i])
                hidden = True
    return which, corners, t, hidden


@numba.njit(**KERNEL)
def _triangulate(x_s, x_m, pairs, deepest, centre, axes):  # type: ignore[no-untyped-def]
    """Pairs (t,) and corners (t, 3, 2) of triangles, and where masters hide others."""
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
        which, corners, t, hidden[s] = _split(S, x_m, pairs, deepest, *at, which, corners, t)
    return which[:t], corners[:t], hidden


@numba.njit(**KERNEL)
def _changes(P, corners):  # type: ignore[no-untyped-def]
    if len(P) == 3:
        return 0.0, 0.0
    low, high, turn = np.inf, 0.0, 0.0
    s0, s1 = np.empty(3), np.empty(3)
    for v in range(3):
        xi, eta, J = inverse(P, corners[v, 0], corners[v, 1])
        low, high = min(low, J), max(high, J)
        s0[v], s1[v] = slopes(P, xi, eta)
    for v in range(3):
        turn = max(turn, (s0[v] - s0[v - 1]) ** 2 + (s1[v] - s1[v - 1]) ** 2)
    return (high - low) / (high + low), turn


@numba.njit(**KERNEL)
def _choose_rules(x_s, x_m, pairs, centre, axes, which, corners, least):  # type: ignore[no-untyped-def]
    rule = np.full(len(which), least // 2 - 1)
    S, M = np.empty((x_s.shape[1], 3)), np.empty((x_m.shape[1], 3))
    for t in range(len(which)):
        s, m = pairs[which[t]]
        project(x_s[s], centre[s], axes[s], S)
        project(x_m[m], centre[s], axes[s], M)
        variation, turn = _changes(S, corners[t])
        variation += _changes(M, corners[t])[0]
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
def _place(slave, master, pairs, centre, axes, which, corners, size, rule, points, weights, start):  # type: ignore[no-untyped-def]
    total = 0
    for t in range(len(which)):
        total += start[rule[t] + 1] - start[rule[t]]
    pair, weight = np.empty(total, np.int64), np.empty(total)
    xi_s, xi_m = np.empty((total, 2)), np.empty((total, 2))
    (x_s, c_s, parts_s), (x_m, c_m, parts_m) = slave, master
    S, M = np.empty((x_s.shape[1], 3)), np.empty((x_m.shape[1], 3))
    P, q = np.empty((1, 2, 9)), 0
    for t in range(len(which)):
        s, m = pairs[which[t]]
        i, j = s // len(parts_s), m // len(parts_m)
        on_s, on_m = parts_s[s % len(parts_s)], parts_m[m % len(parts_m)]
        if t == 0 or which[t] != which[t - 1]:
            project(x_s[s], centre[s], axes[s], S)
            project(x_m[m], centre[s], axes[s], M)
            project_map(c_m, j, centre[s], axes[s], P)
        for k in range(start[rule[t]], start[rule[t] + 1]):
            x, y = _inside(corners[t], points[k, 0], points[k, 1])
            a, b, J = inverse(S, x, y)
            xi_s[q, 0], xi_s[q, 1] = evaluate(on_s, FIRST, a, b), evaluate(on_s, SECOND, a, b)
            a, b, _ = inverse(M, x, y)
            a, b = evaluate(on_m, FIRST, a, b), evaluate(on_m, SECOND, a, b)
            x, y, area = locate(c_s, i, centre[s], axes[s], xi_s[q, 0], xi_s[q, 1])
            if len(parts_m) > 1:  # on slivers `inverse` is more accurate
                a, b = meet(P, x, y, a, b)
            xi_m[q, 0], xi_m[q, 1] = a, b
            weight[q], pair[q] = weights[k] * size[t] * area / J, which[t]
            q += 1
    return pair, xi_s, xi_m, weight


@numba.njit(**KERNEL)
def _inside(c, r, s):  # type: ignore[no-untyped-def]
    x = c[0, 0] + r * (c[1, 0] - c[0, 0]) + s * (c[2, 0] - c[0, 0])
    return x, c[0, 1] + r * (c[1, 1] - c[0, 1]) + s * (c[2, 1] - c[0, 1])


def areas(c: Floats) -> Floats:
    """Areas (t,) of triangles (t, 3, 2)."""
    u, v = c[:, 1] - c[:, 0], c[:, 2] - c[:, 0]
    return (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]) / 2


def place_points(
    slave: Facets, master: Facets, pairs: Ints, deepest: Floats
) -> tuple[npt.NDArray[Any], Floats, Floats, Floats]:
    """See `line.place_points`; folded facets cover nothing."""
    over = find_overlaps(slave, master, pairs, deepest)
    rule = _choose_rules(*over.of_planes, least_degree(slave.element, master.element))
    triangles = over.which, over.corners, areas(over.corners)
    pair, xi_s, xi_m, weight = over.place(*triangles, rule, _rules())
    return over.of[pair], xi_s, xi_m, weight


class Overlaps(NamedTuple):
    """Facets that overlap in the auxiliary planes of the slave's parts."""

    slave: Facets  # (ms,)
    master: Facets  # (mm,)
    parts: tuple[Facets, Facets]
    pairs: Ints  # (p', 2) of parts
    of: Ints  # (p',) pair of facets
    planes: tuple[Floats, Floats, Floats]  # see `create_planes`
    which: Longs  # (t,) pairs of parts of the triangles
    corners: Floats  # (t, 3, 2)
    hidden: Bools  # (parts,) whether masters hide others

    @property
    def of_planes(self) -> tuple[Any, ...]:
        """Parts, their pairs, planes and triangles, as kernels take them."""
        x_s, x_m = (f.x for f in self.parts)
        return x_s, x_m, self.pairs, *self.planes[:2], self.which, self.corners

    def place(
        self, which: Longs, corners: Floats, size: Floats, rule: Longs, rules: tuple[Any, ...]
    ) -> tuple[Longs, Floats, Floats, Floats]:
        """Points of rules on triangles: pair of parts, coordinates on both facets, weight.

        Weights are areas. A coordinate is NaN where the line through a point misses the master.
        """
        slave, master = (
            (part.x, coefficients(whole), reference_parts(whole.element))
            for part, whole in zip(self.parts, (self.slave, self.master), strict=True)
        )
        at = self.pairs, *self.planes[:2], which, corners, size, rule, *rules
        pair, xi_s, xi_m, weight = _place(slave, master, *at)
        element = self.slave.element
        return pair, xi_s, xi_m, weight * (element.size / (count(element) * element.first.size))


def find_overlaps(slave: Facets, master: Facets, pairs: Ints, deepest: Floats) -> Overlaps:
    """Where facets of pairs (p, 2) overlap."""
    parts = parts_of(slave), parts_of(master)
    pairs, of = pairs_of_parts(pairs, slave.element, master.element)
    planes = create_planes(parts[0])
    limits = deepest[of] / planes[2][pairs[:, 0]]  # lengths in the planes are relative
    found = _triangulate(parts[0].x, parts[1].x, pairs, limits, *planes[:2])
    return Overlaps(slave, master, parts, pairs, of, planes, *found)


def least_degree(slave: FacetElement, master: FacetElement) -> int:
    """Degree for products of two functions on affine facets.

    With twists phi relative errors are up to 1e-5 phi^4 in D_jj and 2e-3 phi^2 in M; forces are
    exact.
    """
    return max(slave.degree, master.degree) * (4 if slave.bilinear or master.bilinear else 2)


def degree_of_moments(slave: FacetElement, master: FacetElement, smooth: bool) -> int:
    """Degree for `moments`, for errors of derivatives below 1e-3 on warped facets."""
    return max(2 + smooth, min(least_degree(slave, master), 4))

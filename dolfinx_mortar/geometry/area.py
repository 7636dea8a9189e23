# SPDX-License-Identifier: MIT
r"""Segments in 3D: convex polygons in the auxiliary planes of the slave facets.

The auxiliary plane of a slave facet goes through its centre, normal to its mean normal. Both
facets are projected on it along that normal; their intersection is a convex polygon, which is
split into triangles. Straight edges stay straight, so that neighbours still share them and a
surface is covered without holes. A point of the plane belongs to the points of the two facets
above and below it: by an affine map for triangles, by the root of a quadratic equation for
quadrilaterals. The weight of a point is its area in the plane over the cosine between the plane
and the slave facet, which is 1 for plane facets.

Facets of second order are clipped as a whole where all are straight and flat, else in four parts.

On flat triangles the points integrate Phi_j N_l exactly, and so they do on parallelograms. The
inverse map of other quadrilaterals is not a polynomial, nor is the cosine on warped ones; there the
degree of the quadrature grows with the change of the Jacobian and of the slopes over a triangle, so
that the two sides still exchange a constant pressure without loss. Measured, in parts of the facet:
1e-14 where no corner of a quadrilateral has a quality (`facets.distortions`) below 0.6. Where one
has less, the degree ends at the highest there is, and the error grows to 1e-8 at 0.3, where a mesh
is refused.
"""

from functools import cache
from typing import Any, NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from dolfinx_mortar.arrays import HALF_OF_DIGITS, SAME, Floats, Ints, Longs
from dolfinx_mortar.geometry import plane
from dolfinx_mortar.geometry.elements import FacetElement, triangle_rule
from dolfinx_mortar.geometry.facets import Facets, bounding_balls
from dolfinx_mortar.geometry.moments import (
    FIFTH,
    FIRST,
    INNER,
    KERNEL,
    SECOND,
    THIRD,
    Sums,
    add_heights,
    add_row,
    begin_point,
    create_point,
    fill_area,
    fill_functions,
    fill_rows,
    fill_slopes,
    fill_turns,
    gather,
    move_to,
)
from dolfinx_mortar.geometry.parts import (
    all_pairs,
    carry,
    count,
    first_order,
    on_facets,
    on_reference,
    pairs_of_parts,
    parts_of,
)
from dolfinx_mortar.geometry.plane import (
    VERTICES,
    bilinear_map,
    create_planes,
    height_at,
    inverse,
    inverse_of,
    project,
    slopes,
    slopes_of,
)
from dolfinx_mortar.geometry.tolerances import ROUND_OFF

_HIGHEST = 24
"""Highest degree of the quadrature, which limits it on facets of low quality, as said above."""


@cache
def _rules() -> tuple[Floats, Floats, Longs]:
    """Return points, weights (sum 1) and first points of the rules of degree 2, 4, ... ."""
    points, weights, start = [], [], [0]
    for degree in range(2, _HIGHEST + 2, 2):
        p, w = triangle_rule(degree)
        points.append(p)
        weights.append(w)
        start.append(start[-1] + len(w))
    return np.concatenate(points), np.concatenate(weights), np.array(start, dtype=np.int64)


@numba.njit(**KERNEL)
def _depth(S, M, bilinear, x, y):  # type: ignore[no-untyped-def]
    """Return how far the projected facet M lies below S at (x, y)."""
    xi, eta, _ = inverse(S, bilinear[0], x, y)
    r, s, _ = inverse(M, bilinear[1], x, y)
    return height_at(S, bilinear[0], xi, eta) - height_at(M, bilinear[1], r, s)


@numba.njit(**KERNEL)
def _overlap(P, Q):  # type: ignore[no-untyped-def]
    """Tell whether two projected facets share more than a line."""
    p, q = P.shape[0], Q.shape[0]
    # a negative distance: an overlap as narrow as a thin polygon is none
    if plane.is_beside(P, p, Q, q, plane.orientation(P, p), -64 * ROUND_OFF):
        return False
    return not plane.is_beside(Q, q, P, p, plane.orientation(Q, q), -64 * ROUND_OFF)


@numba.njit(**KERNEL)
def _any_overlap(M, count):  # type: ignore[no-untyped-def]
    """Tell whether any of the first `count` projected facets overlap."""
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
    """Tell whether facet j is nearer to the slave than facet i where their projections overlap.

    The distances are compared at one point, whatever the order: of facets that coincide or cross,
    one and only one hides the other.
    """
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


# Loops in place of slices: each array assignment takes a second to compile.


@numba.njit(**KERNEL)
def _copy(P, n, Q):  # type: ignore[no-untyped-def]
    """Copy the first n points of P to Q."""
    for i in range(n):
        Q[i, 0], Q[i, 1] = P[i, 0], P[i, 1]


@numba.njit(**KERNEL)
def _doubled(a):  # type: ignore[no-untyped-def]
    """Return an array of twice the length that begins with the contiguous array a."""
    result = np.empty((2 * len(a),) + a.shape[1:], a.dtype)  # noqa: RUF005
    x, y = a.reshape(-1), result.reshape(-1)
    for i in range(len(x)):
        y[i] = x[i]
    return result


@numba.njit(**KERNEL)
def _visible(S, M, bilinear, given, given_sizes, i, n):  # type: ignore[no-untyped-def]
    """Return the parts of polygon i that no other of the n facets hides: points, sizes, number.

    The polygon is cut by the edges of the projected facets that hide it, not by those of other
    polygons, which can be as short as round-off and then have no direction.
    """
    pieces = np.empty((2 * VERTICES, VERTICES, 2))
    sizes = np.empty(2 * VERTICES, np.int64)
    common, spare = np.empty((VERTICES, 2)), np.empty((VERTICES, 2))
    _copy(given[i], given_sizes[i], pieces[0])
    sizes[0], count = given_sizes[i], 1
    for j in range(n):
        if not _is_hidden(S, M, bilinear, i, j, given, given_sizes, common, spare):
            continue
        sign = plane.orientation(M[j], M.shape[1])
        k = 0
        while k < count:  # a cut adds a corner at most
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
            _copy(pieces[k], size, common)
            if size > 2:
                count = plane.subtract(
                    common, size, M[j], M.shape[1], sign, pieces, sizes, count, spare
                )
    return pieces, sizes, count


@numba.njit(**KERNEL)
def _is_far(middle, radius, centre, axes):  # type: ignore[no-untyped-def]
    """Tell whether the projection of a ball is beside that of the slave facet's own ball."""
    x = y = square = 0.0
    for i in range(3):
        offset, along = middle[i] - centre[i], axes[0, i]
        x, y, square = x + along * offset, y + axes[1, i] * offset, square + along**2
    return x * x + y * y > (1.0 + radius * np.sqrt(square)) ** 2


@numba.njit(**KERNEL)
def _clip(  # type: ignore[no-untyped-def]
    S, x_m, balls, bilinear, pairs, deepest, first, last, centre, axes, M, pieces, sizes, row
):
    """Fill M, pieces, sizes and row (of the pair) for one slave facet; return the count."""
    spare = np.empty((VERTICES, 2))
    count = 0
    k, n = S.shape[0], x_m.shape[1]
    if plane.orientation(S, k) <= 0:
        return 0  # folded: no inverse map
    for r in range(first, last):
        P, m = M[count], pairs[r, 1]
        if _is_far(balls[0][m], balls[1][m], centre, axes):
            continue  # most candidates, in a third of the time
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
                continue  # on the far side of the body
        sizes[count], row[count] = size, r
        count += 1
    return count


@numba.njit(**KERNEL)
def _append_fan(P, n, which, corners, t, pair):  # type: ignore[no-untyped-def]
    """Append the triangles of a polygon that are larger than round-off; return the new arrays."""
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
    """Append the triangles of the segments of one slave facet.

    Return the pair (t,) and the corners (t, 3, 2) of all triangles, and whether pairs hide others.
    """
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
    """Return the pair (t,) and the corners (t, 3, 2) of the triangles of all segments.

    And whether masters of a slave facet hide others.
    """
    p, hidden = len(pairs), np.zeros(len(x_s), np.bool_)
    which, corners = np.empty(4 * p + 64, dtype=np.int64), np.empty((4 * p + 64, 3, 2))
    S = np.empty((x_s.shape[1], 3))
    t = last = np.int64(0)  # a literal 0 has a type of its own: what is called would compile twice
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
    """Return changes of a projected facet over a triangle, by its values at the corners.

    The relative change of the Jacobian, and the largest squared difference of slopes.
    """
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
    """Return the number (t,) of the quadrature rule of each triangle.

    `least` is the degree of the product of two functions.
    """
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
            # the singularities of the inverse maps lie 1 / variation triangles away; integrals of
            # one function, of half of the degree, are the SAME then, and both sides exchange a
            # constant pressure up to that: with EPS degrees are a third higher
            degree = _HIGHEST
            if variation < 2.0:
                degree = min(least // 2 + np.log(SAME) / np.log(variation / 2), degree)
        rule[t] = min(max(np.ceil(degree / 2), least / 2), _HIGHEST // 2) - 1
    return rule


@numba.njit(**KERNEL)
def _place(  # type: ignore[no-untyped-def]
    x_s, x_m, bilinear, pairs, centre, axes, radius, which, corners, rule, whole, points, weights,
    start
):  # fmt: skip
    """Return the pair, xi_s, xi_m and weight of all quadrature points.

    Weights are those on whole facets, otherwise on the reference facet of their parts.
    """
    total = 0
    for t in range(len(which)):
        total += start[rule[t] + 1] - start[rule[t]]
    pair, weight = np.empty(total, np.int64), np.empty(total)
    xi_s, xi_m = np.empty((total, 2)), np.empty((total, 2))
    S, M = np.empty((x_s.shape[1], 3)), np.empty((x_m.shape[1], 3))
    of_S, of_M = _maps(S, bilinear[0]), _maps(M, bilinear[1])
    q = 0
    for t in range(len(which)):
        s, m = pairs[which[t]]
        if t == 0 or which[t] != which[t - 1]:
            project(x_s[s], centre[s], axes[s], S)
            project(x_m[m], centre[s], axes[s], M)
            of_S, of_M = _maps(S, bilinear[0]), _maps(M, bilinear[1])
        size = _area(corners[t])
        for i in range(start[rule[t]], start[rule[t] + 1]):
            at = _inside(corners[t], points[i, 0], points[i, 1])
            r0, r1, s0, s1, J = _point(S, M, of_S, of_M, bilinear, *at)
            xi_s[q, 0], xi_s[q, 1], xi_m[q, 0], xi_m[q, 1] = r0, r1, s0, s1
            weight[q] = weights[i] * size / J
            if whole:
                weight[q] *= radius[s] ** 2 * _jacobian(of_S, bilinear[0], J, r0, r1)
            pair[q] = which[t]
            q += 1
    return pair, xi_s, xi_m, weight


@numba.njit(**KERNEL)
def _maps(P, bilinear):  # type: ignore[no-untyped-def]
    """Return the three maps of `plane.bilinear_map`, made once for a pair; zeros if affine."""
    if bilinear:
        return bilinear_map(P, FIRST), bilinear_map(P, SECOND), bilinear_map(P, THIRD)
    none = 0.0, 0.0, 0.0, 0.0
    return none, none, none


@numba.njit(**KERNEL)
def _inside(c, r, s):  # type: ignore[no-untyped-def]
    """Return the point (r, s) of the triangle c (3, 2)."""
    x = c[0, 0] + r * (c[1, 0] - c[0, 0]) + s * (c[2, 0] - c[0, 0])
    return x, c[0, 1] + r * (c[1, 1] - c[0, 1]) + s * (c[2, 1] - c[0, 1])


@numba.njit(**KERNEL)
def _point(S, M, of_S, of_M, bilinear, x, y):  # type: ignore[no-untyped-def]
    """Return xi_s, xi_m and the slave's plane Jacobian at a point of the plane."""
    if bilinear[0]:
        xi, eta, J = inverse_of(of_S[0], of_S[1], x, y)
    else:
        xi, eta, J = inverse(S, bilinear[0], x, y)
    if bilinear[1]:
        r0, r1, _ = inverse_of(of_M[0], of_M[1], x, y)
    else:
        r0, r1, _ = inverse(M, bilinear[1], x, y)
    return xi, eta, r0, r1, J


@numba.njit(**KERNEL)
def _area(c):  # type: ignore[no-untyped-def]
    """Return the area of a triangle (3, 2)."""
    ux, uy, vx, vy = c[1, 0] - c[0, 0], c[1, 1] - c[0, 1], c[2, 0] - c[0, 0], c[2, 1] - c[0, 1]
    return (ux * vy - uy * vx) / 2


@numba.njit(**KERNEL)
def _jacobian(maps, bilinear, J, xi, eta):  # type: ignore[no-untyped-def]
    """Return the area of a facet per reference area, J being that of its projection."""
    if not bilinear:
        return J  # in its own plane
    s0, s1 = slopes_of(*maps, xi, eta)
    return J * np.sqrt(1 + s0 * s0 + s1 * s1)


class Tables(NamedTuple):
    """What `moments` needs of the two types of facets."""

    slave: Floats  # (k, 9) coefficients of functions, see `moments.fill_functions`
    master: Floats  # (l, 9)
    part: Floats  # (v, 9) those of the slave's parts
    nodes_s: Longs  # (a, v) nodes of the parts
    nodes_m: Longs
    of_slave: Floats  # (a, 3, 9) the parts on the reference facet
    of_master: Floats
    bilinear: tuple[bool, bool]
    second: bool  # whether points are carried from parts to facets
    scale: float  # area of the reference facet over that of the parts' ones
    corners: int  # of a slave facet
    points: Floats  # (q, 2)
    weights: Floats  # (q,)
    ends: Floats  # (2, g) points and weights of a rule on [0, 1]


def tables(slave: FacetElement, master: FacetElement, smooth: bool) -> Tables:
    """Return the tables of two types, of smooth surfaces with their heights."""
    part_s, part_m = slave.part or slave, master.part or master
    degree = _degree_of_moments(slave, master, smooth)
    t, weights = np.polynomial.legendre.leggauss((degree + 3) // 2)
    return Tables(
        slave.table,
        master.table,
        part_s.table,
        np.array(slave.sub_facets, dtype=np.int64),
        np.array(master.sub_facets, dtype=np.int64),
        on_reference(slave),
        on_reference(master),
        (part_s.bilinear, part_m.bilinear),
        slave.part is not None or master.part is not None,
        slave.size / (count(slave) * part_s.size),
        len(slave.vertices),
        *triangle_rule(degree),
        np.stack([(1.0 + t) / 2, weights / 2]),
    )


def _degree_of_moments(slave: FacetElement, master: FacetElement, smooth: bool) -> int:
    """Return the degree of the quadrature of `moments`, of which derivatives are taken.

    Errors of these, in parts of the largest entry, on facets that noise warps and distorts:
    hexahedra 7e-4, of second order 1e-3, tetrahedra of second order 1e-4; with degree 6, of twice
    the points, 2e-5, 2e-4 and 1e-7. None on flat triangles of first order: functions have degree 1,
    heights 2.
    """
    return max(2 + smooth, min(_least_degree(slave, master), 4))


@numba.njit(**KERNEL)
def _fill_coefficients(x, table, c):  # type: ignore[no-untyped-def]
    """Write the coefficients (3, 9) of a facet x (k, 3), see `parts.coefficients`."""
    for i in range(3):
        for a in range(9):
            c[i, a] = 0.0
            for j in range(len(x)):
                c[i, a] += table[j, a] * x[j, i]


@numba.njit(**KERNEL)
def _fill_tangents(x, df, row, first, T):  # type: ignore[no-untyped-def]
    """Write the tangents (2, 3) of a facet x (k, 3), of derivatives df[row, first] and so on."""
    for h in range(2):
        for i in range(3):
            T[h, i] = 0.0
            for j in range(len(x)):
                T[h, i] += df[row + h, first + j] * x[j, i]


@numba.njit(**KERNEL)
def _invert(T, K):  # type: ignore[no-untyped-def]
    """Write dxi/dx (2, 2) of the map to the plane with tangents T (2, 3)."""
    scale = 1.0 / (T[0, 0] * T[1, 1] - T[0, 1] * T[1, 0])
    K[0, 0], K[0, 1], K[1, 0], K[1, 1] = T[1, 1], -T[1, 0], -T[0, 1], T[0, 0]
    for h in range(2):
        for i in range(2):
            K[h, i] *= scale


@numba.njit(**KERNEL)
def _dot(a, b):  # type: ignore[no-untyped-def]
    """Return a.b of vectors (3,)."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


class _Sides(NamedTuple):
    """Slave facet, its part, and a part of a master, in the plane; lengths over the part's size."""

    x: Floats  # (k, 3)
    y: Floats  # (l, 3)
    P: Floats  # (v, 3)
    Q: Floats  # (v', 3)
    C_s: Floats  # (1, 3, 9) coefficients of the facets
    C_m: Floats  # (1, 3, 9)
    n: Floats  # (3,) normal, along which distances are those of the facets


class _Maps(NamedTuple):
    """Maps to the plane at a point."""

    N: Floats  # (v,) functions of the slave's part
    dN: Floats  # (2, v)
    V: Floats  # (2, 3) its tangents
    K: Floats  # (2, 2) dxi/dx of the part
    T: Floats  # (2, 3) tangents of the slave facet
    U: Floats  # (2, 3) of the master
    G: Floats  # (2, 2) dxi/dx of the master
    by_T: Floats  # (2, 3) those of the logarithm of the area by T
    apart: Floats  # (3,) from the slave's point to the master's
    shares: Floats  # (k,) functions of the part at the nodes of the facet
    rates: Floats  # (k, 3) of the logarithm of the weight by these
    unit: Floats  # (3, 3)


@numba.njit(**KERNEL)
def _create_maps(v, k):  # type: ignore[no-untyped-def]
    """Return room for the maps of a part with v nodes of a facet with k."""
    V, T, U, by_T = np.empty((2, 3)), np.empty((2, 3)), np.empty((2, 3)), np.empty((2, 3))
    K, G = np.empty((2, 2)), np.empty((2, 2))
    at = np.empty(3), np.empty(k), np.empty((k, 3)), np.eye(3)
    return _Maps(np.empty(v), np.empty((2, v)), V, K, T, U, G, by_T, *at)


@numba.njit(**INNER)
def _place_at(x, y, i, j, sides, of_P, of_Q, tables, p, m):  # type: ignore[no-untyped-def]
    """Write the point over (x, y) of parts i and j; return area over that in the plane, or NaN."""
    k, last, n, C = len(sides.x), len(p.f) - 1, m.apart, sides.C_s
    r, s, t, u, J = _point(sides.P, sides.Q, of_P, of_Q, tables.bilinear, x, y)
    if tables.second:
        fill_functions(tables.part, r, s, m.N, FIRST)
        fill_slopes(tables.part, r, s, m.dN, FIRST, FIRST)
        _fill_tangents(sides.P, m.dN, FIRST, FIRST, m.V)
        places = tables.of_slave[i], tables.of_master[j], (r, s, t, u)
        r, s, t, u, _ = carry(C, FIRST, m.unit, sides.C_m, *places)
    for a in range(k, last):
        p.df[0, a] = p.df[1, a] = 0.0
    fill_functions(tables.slave, r, s, p.f, FIRST)
    fill_slopes(tables.slave, r, s, p.df, FIRST, FIRST)
    fill_functions(tables.master, t, u, p.f, k)
    fill_slopes(tables.master, t, u, p.df, THIRD, k)
    _fill_tangents(sides.x, p.df, FIRST, FIRST, m.T)
    _fill_tangents(sides.y, p.df, THIRD, k, m.U)
    _invert(m.U, m.G)
    _invert(m.V if tables.second else m.T, m.K)
    area = fill_area(m.T, n, m.by_T)
    p.by_weight[0] = p.by_weight[1] = p.by_weight[2] = p.by_weight[3] = 0.0
    for h in range(3):
        rr = 2.0 * (C[0, h, 6] + s * (C[0, h, 7] + s * C[0, h, 8]))
        rs = C[0, h, 4] + 2.0 * (s * C[0, h, 5] + r * (C[0, h, 7] + 2.0 * s * C[0, h, 8]))
        ss = 2.0 * (C[0, h, 2] + r * (C[0, h, 5] + r * C[0, h, 8]))
        p.by_weight[0] += m.by_T[0, h] * rr + m.by_T[1, h] * rs
        p.by_weight[1] += m.by_T[0, h] * rs + m.by_T[1, h] * ss
        m.apart[h] = 0.0
        for b in range(k, last):
            m.apart[h] += p.f[b] * sides.y[b - k, h]
        for a in range(k):
            m.apart[h] -= p.f[a] * sides.x[a, h]
    return tables.scale * area / J if np.isfinite(t) else np.nan


@numba.njit(**INNER)
def _fall(reach, sides, m, p):  # type: ignore[no-untyped-def]
    """Return the part of a weight that its gap leaves, and its logarithm's rate; add it by xi.

    Args:
        reach: (2,) the gap from which on weights fall, and how fast; empty where nothing falls.
    """
    if len(reach) == 0:
        return 1.0, 0.0
    part = 1.0 - reach[1] * (_dot(sides.n, m.apart) - reach[0])
    if part >= 1.0 or part <= 0.0:
        return min(max(part, 0.0), 1.0), 0.0
    rate = -reach[1] / part
    for h in range(2):
        p.by_weight[h] -= rate * _dot(sides.n, m.T[h])
        p.by_weight[2 + h] += rate * _dot(sides.n, m.U[h])
    return part, rate


@numba.njit(**INNER)
def _combine(p, h, a, b):  # type: ignore[no-untyped-def]
    """Replace two derivatives by two combinations of them."""
    for i in range(p.df.shape[1]):
        x, y = p.df[h, i], p.df[h + 1, i]
        p.df[h, i], p.df[h + 1, i] = a[0] * x + a[1] * y, b[0] * x + b[1] * y
    x, y = p.by_weight[h], p.by_weight[h + 1]
    p.by_weight[h], p.by_weight[h + 1] = a[0] * x + a[1] * y, b[0] * x + b[1] * y


@numba.njit(**INNER)
def _number(ids, a):  # type: ignore[no-untyped-def]
    """Return where a is among some numbers (v,), v if it is none of them."""
    v = 0
    while v < len(ids) and ids[v] != a:
        v += 1
    return v


@numba.njit(**INNER)
def _find_rates(p, m, i, of_P, sides, ids_s, tables, rate):  # type: ignore[no-untyped-def]
    """Write the changes of a point that stays where it is in the plane.

    Those of the logarithm of its weight by the slave's nodes at fixed xi, and in place of
    derivatives by xi those by places in the plane: where nodes of the part move by dx, its xi
    change by -K dx, those of the facet with them, and those of the master by G times what the
    slave's point moves more than the master's.
    """
    K, G, T, L, (c0, c1) = m.K, m.G, m.T, tables.of_slave, (of_P[0][3], of_P[1][3])
    curved = tables.second or tables.bilinear[0]
    for a in range(len(sides.x)):
        v, m.shares[a] = _number(ids_s, a), 0.0
        for t in range(3):
            m.rates[a, t] = -rate * p.f[a] * sides.n[t]
            if curved:
                m.rates[a, t] += p.df[0, a] * m.by_T[0, t] + p.df[1, a] * m.by_T[1, t]
        if v < len(ids_s):
            N, N0, N1 = p.f[a], p.df[0, a], p.df[1, a]
            if tables.second:
                N, N0, N1 = m.N[v], m.dN[0, v], m.dN[1, v]
            m.shares[a] = N
            for t in range(2 if curved else 0):  # the Jacobian of the part
                m.rates[a, t] -= N0 * K[0, t] + N1 * K[1, t]
                m.rates[a, t] += N * K[0, t] * (K[1, 0] * c0 + K[1, 1] * c1)
                m.rates[a, t] += N * K[1, t] * (K[0, 0] * c0 + K[0, 1] * c1)
    _combine(p, THIRD, (G[0, 0], G[1, 0]), (G[0, 1], G[1, 1]))
    if not tables.second:
        _combine(p, FIRST, (K[0, 0], K[1, 0]), (K[0, 1], K[1, 1]))
        return
    l0, l1, l2, l3 = L[i, 0, 3], L[i, 0, 1], L[i, 1, 3], L[i, 1, 1]
    B00, B01 = l0 * K[0, 0] + l1 * K[1, 0], l0 * K[0, 1] + l1 * K[1, 1]
    B10, B11 = l2 * K[0, 0] + l3 * K[1, 0], l2 * K[0, 1] + l3 * K[1, 1]
    _combine(p, FIRST, (B00, B10), (B01, B11))
    for h in range(2):
        _add_motion(p, h, T[0, h] * B00 + T[1, h] * B10, T[0, h] * B01 + T[1, h] * B11)


@numba.njit(**INNER)
def _add_motion(p, h, a, b):  # type: ignore[no-untyped-def]
    """Add multiples of a derivative by places over the master to those by motions of the part."""
    p.by_weight[0] += a * p.by_weight[2 + h]
    p.by_weight[1] += b * p.by_weight[2 + h]
    for q in range(p.df.shape[1]):
        p.df[0, q] += a * p.df[2 + h, q]
        p.df[1, q] += b * p.df[2 + h, q]


@numba.njit(**INNER)
def _add_changes(p, m, rate, sides, place, pair, tables, totals):  # type: ignore[no-untyped-def]
    """Add the derivatives of a point that stays where it is in the plane, see `_find_rates`."""
    k, n = len(sides.x), sides.n
    for a in range(k):
        for t in range(2):
            add_row(p, t, -m.shares[a], totals, 3 * a + t)
            if tables.second:
                add_row(p, 2 + t, p.f[a], totals, 3 * a + t)
        for t in range(3):
            add_row(p, FIFTH, m.rates[a, t], totals, 3 * a + t)
    for b in range(place.shape[1]):
        z, one = 3 * (k + place[pair, b]), p.f[k + b]
        for t in range(2):
            add_row(p, 2 + t, -one, totals, z + t)
        for t in range(3):
            add_row(p, FIFTH, rate * one * n[t], totals, z + t)
    for t in range(3):
        add_row(p, FIFTH, rate * m.apart[t], totals, len(totals) - 4 + t)


@numba.njit(**KERNEL)
def _nearest_line(c, e, X, ids, first, best):  # type: ignore[no-untyped-def]
    """Return how far edge e of a triangle is from the edges of a polygon, and which, if nearer.

    Args:
        c: (3, 2) the triangle.
        X: (n, 3) nodes.
        ids: (v,) those of the polygon, less first.
        best: distance, and nodes of an edge found before.
    """
    f = (e + 1) % 3
    for v in range(len(ids)):
        a, b = first + ids[v], first + ids[(v + 1) % len(ids)]
        dx, dy = X[b, 0] - X[a, 0], X[b, 1] - X[a, 1]
        one = dx * (c[e, 1] - X[a, 1]) - dy * (c[e, 0] - X[a, 0])
        two = dx * (c[f, 1] - X[a, 1]) - dy * (c[f, 0] - X[a, 0])
        distance = max(abs(one), abs(two)) / np.sqrt(dx * dx + dy * dy)
        if distance < best[0]:
            best = distance, a, b
    return best


@numba.njit(**KERNEL)
def _is_next(corners, which, t):  # type: ignore[no-untyped-def]
    """Tell whether triangle t shares the edge between corners 0 and 1 with the one before."""
    if t == 0 or t == len(corners) or which[t - 1] != which[t]:
        return False
    same = True
    for h in range(2):
        same = same and corners[t - 1, 0, h] == corners[t, 0, h]
        same = same and corners[t - 1, 2, h] == corners[t, 1, h]
    return same


@numba.njit(**KERNEL)
def _add_coordinates(radius, part, facet, X, axes, ids, falls, by_X, by_x):  # type: ignore[no-untyped-def]
    """Add derivatives by_X (3 n, ..) of coordinates in a plane to by_x (3 (n - 1), ..) in space.

    They do not change with a motion of all nodes in the plane and along its normal; it tilts with
    the nodes of the part. The last of the n vectors is the normal of the facet, if weights fall.
    """
    n, width, tilted = len(X), by_X.shape[1], np.empty((1, by_X.shape[1]))
    for z in range(9 * (n - 1)):
        a, i, t = z // 9, z // 3 % 3, z % 3
        for q in range(width):
            by_x[3 * a + i, q] += axes[t, i] * by_X[3 * a + t, q]
    for s in range(2):
        for q in range(width):
            tilted[0, q] = 0.0
        for a in range(n):
            for q in range(width):
                tilted[0, q] += X[a, s] * by_X[3 * a + 2, q] - X[a, 2] * by_X[3 * a + s, q]
        _add_turned(radius, axes[s], part, ids, tilted, FIRST, by_x)
    for t in range(3 if falls else 0):
        _add_turned(radius**2, axes[t], facet, np.arange(len(facet)), by_X, 3 * (n - 1) + t, by_x)


@numba.njit(**KERNEL)
def _add_turned(factor, axis, x, ids, by_turn, row, by_x):  # type: ignore[no-untyped-def]
    """Add derivatives by axis.n, in a row, to those by the nodes x (v, 3) with the normal n."""
    turns = np.empty(x.shape)
    fill_turns(axis, x, turns)
    for v in range(len(x)):
        for i in range(3):
            for q in range(by_x.shape[1]):
                by_x[3 * ids[v] + i, q] += factor * turns[v, i] * by_turn[row, q]


def moments(
    x: Floats,
    n: Floats,
    y: Floats,
    start: Longs,
    place: Longs,
    deepest: Floats,
    reach: Floats,
    factor: Floats,
    heights: tuple[Floats, Floats, Floats],
    positive: bool,
    tables: Tables,
    found: Sums,
) -> None:
    """Add the moments of slave facets x (p, k, 3) and their masters, and derivatives.

    Args:
        n: of no use in space.
        y: (p, m, 3) the different nodes of the masters.
        start: (p + 1,) first pairs of the facets.
        place: (c, l) nodes of the pairs' masters.
        deepest: (c,) see `place_points`.
        reach: (p, 2) see `_fall`; (p, 0) where nothing falls.
        factor: (p, k) of `moments.begin_point`, as heights.
        positive: of `moments.fill_rows`.
        tables: of `tables`.
        found: `moments.Sums`, by the coordinates of x and y.
    """
    a, b = len(tables.nodes_s), len(tables.nodes_m)
    of = np.repeat(np.arange(len(x), dtype=np.int32), np.diff(start))
    pairs, pair = all_pairs(np.stack([of, np.arange(len(of), dtype=np.int32)], axis=1), a, b)
    parts_s, parts_m = (
        np.take(v, nodes, axis=1).reshape(-1, nodes.shape[1], 3)
        for v, nodes in ((x, tables.nodes_s), (y[of[:, None], place], tables.nodes_m))
    )
    ids = np.take(place, tables.nodes_m, axis=1).reshape(len(parts_m), -1)
    centre, axes, radius = planes = create_planes(parts_s)
    at = tables.bilinear, pairs, deepest[pair] / radius[pairs[:, 0]], centre, axes
    which, corners, hidden = _triangulate(parts_s, parts_m, bounding_balls(parts_m), *at)
    slave, master = pairs[which].T.astype(np.int64)
    first = np.searchsorted(slave, np.arange(len(parts_s) + 1))
    normals = np.cross(x[:, 2] - x[:, 0], x[:, tables.corners - 1] - x[:, 1])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    triangles = first, master - b * start[slave // a], corners, hidden
    masters = start, place, ids
    given = reach, factor, heights
    _add_moments(
        x, y, normals, (parts_s, *planes), triangles, masters, given, positive, tables, found
    )


@numba.njit(**KERNEL)
def _add_moments(x, y, normals, parts, triangles, masters, given, positive, tables, found):  # type: ignore[no-untyped-def]
    """Add the moments of all parts of slave facets, and their derivatives; see `moments`."""
    (parts_s, centre, axes, radius), (first, which, corners, hidden) = parts, triangles
    (start, place, ids), (a, v), b = masters, tables.nodes_s.shape, len(tables.nodes_m)
    k, m, l, (reach, factor, heights) = x.shape[1], y.shape[1], place.shape[1], given  # noqa: E741
    z, size, X = 3 * (k + m + 1), k * (k + m + 1), np.zeros((k + m + 1, 3))
    sides = _Sides(X[:k], np.empty((l, 3)), np.empty((v, 3)), np.empty((ids.shape[1], 3)),
                   np.empty((1, 3, 9)), np.empty((1, 3, 9)), X[k + m])  # fmt: skip
    for s in range(len(radius)):
        f, ids_s, t, end = s // a, tables.nodes_s[s % a], first[s], first[s + 1]
        project(x[f], centre[s], axes[s], X[:k])
        project(y[f], centre[s], axes[s], X[k : k + m])
        for i in range(3):
            X[k + m, i] = radius[s] ** 2 * _dot(axes[s, i], normals[f])
        gather(X, ids_s, sides.P)
        _fill_coefficients(sides.x, tables.slave, sides.C_s[0])
        by_X = np.zeros((z, k, k + m + 1))
        ids_m = ids[b * start[f] : b * start[f + 1]]
        at, of = _list_points(corners[t:end], which[t:end], X, ids_s, ids_m, k, hidden[s], tables)
        to = sides, hidden[s], (reach[f], factor[f], heights), positive, tables, by_X, found
        _add_points(s % a, f, start[f], at, of, X, radius[s] ** 2, ids_m, place, *to)
        plane = radius[s], parts_s[s], x[f, : tables.corners], X, axes[s], ids_s, reach.shape[1] > 0
        _add_coordinates(*plane, by_X.reshape(z, size), found.changes[f].reshape(z - 3, size))


@numba.njit(**KERNEL)
def _list_points(corners, which, X, ids_s, ids_m, k, hidden, tables):  # type: ignore[no-untyped-def]
    """Return the points of triangles (t, 3, 2), and those on the edges that move with nodes.

    Returns:
        Place, weight and edge turned outwards (q, 5); part of a master, and two nodes (q, 3), less
        than 0 inside.
    """
    t, g = len(tables.weights), tables.ends.shape[1]
    at, of = (
        np.empty((len(corners) * (t + 3 * g), 5)),
        np.empty((len(corners) * (t + 3 * g), 3), np.int64),
    )
    n, none = 0, np.int64(-1)
    for s in range(len(corners)):
        c, size = corners[s], _area(corners[s])
        for q in range(t):
            at[n, 0], at[n, 1] = _inside(c, tables.points[q, 0], tables.points[q, 1])
            at[n, 2], of[n, 0], of[n, 1] = tables.weights[q] * size, which[s], -1
            n += 1
        for e in range(3):
            if e != 1 and _is_next(corners, which, s + e // 2):
                continue
            line = _nearest_line(c, e, X, ids_s, none + 1, (HALF_OF_DIGITS, none, none))
            if line[1] < 0:
                line = _nearest_line(c, e, X, ids_m[which[s]], k, line)
            for r in range(len(ids_m) if hidden and line[1] < 0 else 0):
                line = _nearest_line(c, e, X, ids_m[r], k, line)
            dx, dy = c[(e + 1) % 3, 0] - c[e, 0], c[(e + 1) % 3, 1] - c[e, 1]
            for q in range(g if line[1] >= 0 else 0):
                at[n, 0], at[n, 1] = (
                    c[e, 0] + tables.ends[0, q] * dx,
                    c[e, 1] + tables.ends[0, q] * dy,
                )
                at[n, 2], at[n, 3], at[n, 4] = tables.ends[1, q], dy, -dx
                of[n, 0], of[n, 1], of[n, 2] = which[s], line[1], line[2]
                n += 1
    return at[:n], of[:n]


@numba.njit(**KERNEL)
def _add_points(  # type: ignore[no-untyped-def]
    i, f, first, at, of, X, unit, ids_m, place, sides, hidden, given, positive, tables, by_X, found
):  # fmt: skip
    """Add the moments of points of part i of slave facet f, and their derivatives."""
    (reach, factor, heights), k, l, b = given, len(sides.x), place.shape[1], len(tables.nodes_m)  # noqa: E741
    of_P = of_Q = _maps(sides.P, tables.bilinear[0])
    p, maps, ids_s = create_point(k, l), _create_maps(len(sides.P), k), tables.nodes_s[i]
    last, values = len(by_X), found.values[f]
    totals = np.zeros((last + 1, k * (k + l + 1)))  # of a pair; values are the last
    for q in range(len(at)):
        r = of[q, 0]
        pair = first + r // b
        if q == 0 or of[q - 1, 0] != r:
            gather(X[k:], ids_m[r], sides.Q)
            gather(X[k:], place[pair], sides.y)
            _fill_coefficients(sides.y, tables.master, sides.C_m[0])
            of_Q = _maps(sides.Q, tables.bilinear[1])
        x, y, w = at[q, 0], at[q, 1], at[q, 2]
        w *= unit * _place_at(x, y, i, r % b, sides, of_P, of_Q, tables, p, maps)
        if np.isfinite(w):
            scale = begin_point(p, factor, pair, heights)
            left, rate = _fall(reach, sides, maps, p)
            w, inner = w * scale * left, of[q, 1] < 0
            if inner:
                _find_rates(p, maps, i, of_P, sides, ids_s, tables, rate)
                fill_rows(p, k, w, positive, inner)
                add_row(p, FIFTH, 1.0, totals, last)
                add_heights(p, k, pair, found)
                _add_changes(p, maps, rate, sides, place, pair, tables, totals)
            else:
                fill_rows(p, k, w, positive, inner)
                v, o = of[q, 1], of[q, 2]
                dx, dy = X[o, 0] - X[v, 0], X[o, 1] - X[v, 1]
                share = ((x - X[v, 0]) * dx + (y - X[v, 1]) * dy) / (dx * dx + dy * dy)
                for t in range(2):
                    add_row(p, FIFTH, (1.0 - share) * at[q, 3 + t], totals, 3 * v + t)
                    add_row(p, FIFTH, share * at[q, 3 + t], totals, 3 * o + t)
        if q + 1 == len(at) or of[q + 1, 0] != r:
            move_to(totals, last, k, place, pair, values)
            for a in range(last // 3 if hidden else k + l + 1):
                n = a if hidden or a < k else last // 3 - 1
                if not hidden and k <= a < k + l:
                    n = k + place[pair, a - k]
                for t in range(3):
                    move_to(totals, 3 * n + t, k, place, pair, by_X[3 * n + t])


def place_points(
    slave: Facets, master: Facets, pairs: Ints, deepest: Floats
) -> tuple[npt.NDArray[Any], Floats, Floats, Floats]:
    """Project, clip, split and place quadrature points.

    Facets whose projection is folded or inverted cover nothing.

    Args:
        slave: Slave facets (ms,).
        master: Master facets (mm,).
        pairs: Pairs (p, 2) that face each other, ordered by slave facet.
        deepest: How far (p,) behind the slave facet the master may lie, in the middle of a part.

    Returns:
        Index into the pairs (q,), xi_s (q, 2), xi_m (q, 2) and weight (q,) of the points.
    """
    least = _least_degree(slave.element, master.element)
    simple_s, simple_m = first_order(slave), first_order(master)
    if simple_s is not None and simple_m is not None:
        slave, master = simple_s, simple_m
    parts_s, parts_m = parts_of(slave), parts_of(master)
    of_parts, of = pairs_of_parts(pairs, slave.element, master.element)
    centre, axes, radius = create_planes(parts_s.x)
    bilinear = parts_s.element.bilinear, parts_m.element.bilinear
    sides = parts_s.x, parts_m.x, bilinear, of_parts
    limits = deepest[of] / radius[of_parts[:, 0]]  # lengths in the planes are relative
    balls = bounding_balls(parts_m.x)
    which, corners, _ = _triangulate(*sides[:2], balls, *sides[2:], limits, centre, axes)
    rule = _choose_rules(*sides, centre, axes, which, corners, least)
    whole = slave.element.part is None and master.element.part is None
    at = centre, axes, radius, which, corners, rule, whole
    pair, xi_s, xi_m, weight = _place(*sides, *at, *_rules())
    if whole:
        return pair, xi_s, xi_m, weight
    points = {"xi_s": xi_s, "xi_m": xi_m, "weight": weight}
    return of[pair], *on_facets(slave, master, axes, of_parts[pair], **points)


def _least_degree(slave: FacetElement, master: FacetElement) -> int:
    """Return the degree on a triangle of the product of two functions, where maps are affine.

    That is 2 and 4 for first-order triangles and quadrilaterals, 4 and 8 for those of second order.
    Maps and areas of curved facets are no polynomials. Measured, paraboloids whose facets turn by
    an angle phi: D_jj to 1e-5 phi^4, entries of M to 2e-3 phi^2 (triangles) and 1e-6 phi^2
    (quadrilaterals) of the largest D_jj. Both sides of a pair see the same points, so that forces
    and constants stay exact. The exact tangent has the derivatives of the integrals, not of the
    sums over points: for second-order tetrahedra at edges forces differ by 2e-7 to 6e-6 of their
    largest entry from differences, 4e-11 with degree 12.
    """
    return max(slave.degree, master.degree) * (4 if slave.bilinear or master.bilinear else 2)

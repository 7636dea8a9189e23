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

from dolfinx_mortar.arrays import SAME, Floats, Ints, Longs
from dolfinx_mortar.geometry import plane
from dolfinx_mortar.geometry.elements import FacetElement, triangle_rule
from dolfinx_mortar.geometry.facets import Facets, bounding_balls
from dolfinx_mortar.geometry.moments import (
    KERNEL,
    add_point,
    fill_functions,
    reciprocal,
    root,
)
from dolfinx_mortar.geometry.parts import (
    along,
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
    fill_axes,
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
    return (height_at(S, bilinear[0], xi, eta) - height_at(M, bilinear[1], r, s)).real


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
        low[i] = high[i] = M[i, 0, 0].real
        for k in range(1, M.shape[1]):
            low[i], high[i] = min(low[i], M[i, k, 0].real), max(high[i], M[i, k, 0].real)
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
    pieces = np.empty((2 * VERTICES, VERTICES, 2), given.dtype)
    sizes = np.empty(2 * VERTICES, np.int64)
    common, spare = np.empty((VERTICES, 2), given.dtype), np.empty((VERTICES, 2), given.dtype)
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
        offset, along = middle[i] - centre[i].real, axes[0, i].real
        x, y, square = x + along * offset, y + axes[1, i].real * offset, square + along**2
    return x * x + y * y > (1.0 + radius * np.sqrt(square)) ** 2


@numba.njit(**KERNEL)
def _clip(  # type: ignore[no-untyped-def]
    S, x_m, balls, bilinear, pairs, deepest, first, last, centre, axes, M, pieces, sizes, row
):
    """Fill M, pieces, sizes and row (of the pair) for one slave facet; return the count."""
    spare = np.empty((VERTICES, 2), S.dtype)
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
        if (ux * vy - uy * vx).real > least:
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
    M, row = np.empty((n, x_m.shape[1], 3), S.dtype), np.empty(n, np.int64)
    pieces, sizes = np.empty((n, VERTICES, 2), S.dtype), np.empty(n, np.int64)
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


@numba.njit(cache=True)
def _triangulate(x_s, x_m, balls, bilinear, pairs, deepest, centre, axes):  # type: ignore[no-untyped-def]
    """Return the pair (t,) and the corners (t, 3, 2) of the triangles of all segments."""
    p = len(pairs)
    which, corners = np.empty(4 * p + 64, dtype=np.int64), np.empty((4 * p + 64, 3, 2))
    S = np.empty((x_s.shape[1], 3))
    t = last = np.int64(0)  # a literal 0 has a type of its own: what is called would compile twice
    while last < p:
        first, s = last, pairs[last, 0]
        while last < p and pairs[last, 0] == s:
            last += 1
        project(x_s[s], centre[s], axes[s], S)
        at = first, last, centre[s], axes[s]
        which, corners, t, _ = _split(
            S, x_m, balls, bilinear, pairs, deepest, *at, which, corners, t
        )
    return which[:t], corners[:t]


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


@numba.njit(cache=True)
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


@numba.njit(cache=True)
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
    of_S, of_M = _maps(S, False), _maps(M, False)
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
        return bilinear_map(P, 0), bilinear_map(P, 1), bilinear_map(P, 2)
    zero = 0.0 * P[0, 0]
    none = zero, zero, zero, zero
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
        xi, eta, J = inverse(S, False, x, y)
    if bilinear[1]:
        r0, r1, _ = inverse_of(of_M[0], of_M[1], x, y)
    else:
        r0, r1, _ = inverse(M, False, x, y)
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
    return J * root(1 + s0 * s0 + s1 * s1)


class Tables(NamedTuple):
    """What `moments` needs of the two types of facets."""

    slave: Floats  # (k, 9) coefficients of functions, see `moments.fill_functions`
    master: Floats  # (l, 9)
    nodes_s: Ints  # (a, v) nodes of the parts
    nodes_m: Ints
    of_slave: Floats  # (a, 3, 9) the parts on the reference facet
    of_master: Floats
    bilinear: tuple[bool, bool]
    scale: float  # area of the reference facet over that of the parts' ones, 0 for first order
    points: Floats  # (q, 2)
    weights: Floats  # (q,)
    ends: Floats  # (2, g) points and weights of a rule on [0, 1]; none where `points` are exact


def tables(slave: FacetElement, master: FacetElement, smooth: bool) -> Tables:
    """Return the tables of two types, of smooth surfaces with their heights."""
    part_s, part_m = slave.part or slave, master.part or master
    second = slave.part is not None or master.part is not None
    flat = not (second or part_s.bilinear or part_m.bilinear)
    degree = _degree_of_moments(slave, master, smooth)
    t, weights = np.polynomial.legendre.leggauss(degree // 2 + 1)
    return Tables(
        slave.table,
        master.table,
        np.array(slave.sub_facets, dtype=np.int32),
        np.array(master.sub_facets, dtype=np.int32),
        on_reference(slave),
        on_reference(master),
        (part_s.bilinear, part_m.bilinear),
        slave.size / (count(slave) * part_s.size) if second else 0.0,
        *triangle_rule(degree),
        np.empty((2, 0)) if flat else np.stack([(1.0 + t) / 2, weights / 2]),
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
def _coefficients(x, table, c):  # type: ignore[no-untyped-def]
    """Write the coefficients (3, 9) of a facet x (k, 3), see `parts.coefficients`."""
    for i in range(3):
        for a in range(9):
            c[i, a] = 0.0
            for j in range(len(x)):
                c[i, a] += table[j, a] * x[j, i]


@numba.njit(**KERNEL)
def _ball(x, middle):  # type: ignore[no-untyped-def]
    """Write the centre (3,) of a ball around a facet x (k, 3); return its radius."""
    square = 0.0
    for i in range(3):
        middle[i] = 0.0
        for j in range(len(x)):
            middle[i] += x[j, i].real / len(x)
    for j in range(len(x)):
        distance = 0.0
        for i in range(3):
            distance += (x[j, i].real - middle[i]) ** 2
        square = max(square, distance)
    return np.sqrt(square)


@numba.njit(**KERNEL)
def _fill_parts(x, nodes, parts):  # type: ignore[no-untyped-def]
    """Write the parts (a, v, 3) of a facet x (k, 3)."""
    for a in range(nodes.shape[0]):
        for v in range(nodes.shape[1]):
            for i in range(3):
                parts[a, v, i] = x[nodes[a, v], i]


@numba.njit(**KERNEL)
def moments(x, n, Y, deepest, reach, factor, heights, positive, tables, S, R, H):  # type: ignore[no-untyped-def]
    """Add the moments of a slave facet x (k, 3) and its masters Y (c, l, 3) to S, R (c, k, l), H.

    Return whether masters hide others. For the other arguments see `moments.add_point`.

    Args:
        n: of no use in space.
        deepest: (c,) see `place_points`.
        tables: of `tables`.
    """
    c, a, b = len(Y), len(tables.nodes_s), len(tables.nodes_m)
    parts_s = np.empty((a, tables.nodes_s.shape[1], 3), x.dtype)
    parts_m = np.empty((c * b, tables.nodes_m.shape[1], 3), x.dtype)
    of_s, of_m = np.empty((1, 3, 9), x.dtype), np.empty((c, 3, 9), x.dtype)
    balls, most = (np.empty((c * b, 3)), np.empty(c * b)), np.empty(c * b)
    _fill_parts(x, tables.nodes_s, parts_s)
    if tables.scale > 0.0:
        _coefficients(x, tables.slave, of_s[0])
        for r in range(c):
            _coefficients(Y[r], tables.master, of_m[r])
    for r in range(c):
        _fill_parts(Y[r], tables.nodes_m, parts_m[b * r : b * (r + 1)])
        for j in range(b * r, b * (r + 1)):
            balls[1][j], most[j] = _ball(parts_m[j], balls[0][j]), deepest[r]
    given, hidden = (reach, factor, heights, positive, S, R, H), False
    for i in range(a):
        at = parts_s, parts_m, of_s, of_m
        hidden = _add_part(i, x, Y, at, balls, most, tables, given) or hidden
    return hidden


@numba.njit(**KERNEL)
def _is_next(corners, which, t, n):  # type: ignore[no-untyped-def]
    """Tell whether triangle t of n shares the edge between corners 0 and 1 with the one before."""
    if t == 0 or t == n or which[t - 1] != which[t]:
        return False
    same = True
    for h in range(2):
        same = same and corners[t - 1, 0, h] == corners[t, 0, h]
        same = same and corners[t - 1, 2, h] == corners[t, 1, h]
    return same


@numba.njit(**KERNEL)
def _fill_points(c, before, after, tables, x, w):  # type: ignore[no-untyped-def]
    """Write points (q, 2) of the plane and their weights for a triangle c (3, 2); return q.

    Where the rule is not exact, points stay where they are: corners move fast along edges that are
    nearly parallel, and errors would with them. What they move across edges is added there, as the
    strips between; not on edges that the triangles before and after have, too.
    """
    q = len(tables.weights)
    if tables.ends.shape[1] == 0:
        for k in range(q):
            x[k, 0], x[k, 1] = _inside(c, tables.points[k, 0], tables.points[k, 1])
            w[k] = tables.weights[k] * _area(c)
        return q
    still = np.empty((3, 2))
    for i in range(3):
        still[i, 0], still[i, 1] = c[i, 0].real, c[i, 1].real
    for k in range(q):
        x[k, 0], x[k, 1] = _inside(still, tables.points[k, 0], tables.points[k, 1])
        w[k] = tables.weights[k] * _area(still)
    for i in range(3):
        if (i == 0 and before) or (i == 2 and after):
            continue
        j = (i + 1) % 3
        dx, dy = still[j, 0] - still[i, 0], still[j, 1] - still[i, 1]
        a = (c[i, 0] - still[i, 0]) * dy - (c[i, 1] - still[i, 1]) * dx
        b = (c[j, 0] - still[j, 0]) * dy - (c[j, 1] - still[j, 1]) * dx
        for g in range(tables.ends.shape[1]):
            t, weight = tables.ends[0, g], tables.ends[1, g]
            x[q, 0], x[q, 1] = still[i, 0] + t * dx, still[i, 1] + t * dy
            w[q] = weight * (a + t * (b - a))
            q += 1
    return q


@numba.njit(inline="always")
def _add_part(i, facet, Y, sides, balls, deepest, tables, given):  # type: ignore[no-untyped-def]
    """Add the moments of part i of a slave facet; return whether parts of masters hide others."""
    parts_s, parts_m, of_s, of_m = sides
    kind, c, b, bilinear = parts_s.dtype, len(parts_m), len(tables.nodes_m), tables.bilinear
    N, M = np.empty(len(tables.slave), kind), np.empty(len(tables.master), kind)
    P, Q = np.empty(parts_s.shape[1:], kind), np.empty(parts_m.shape[1:], kind)
    centre, axes, seen = np.empty(3, kind), np.empty((3, 3), kind), np.empty((1, 2, 9), kind)
    corners, middle = np.empty((4 * c + 64, 3, 2), kind), np.empty(3)
    pairs, which = np.zeros((c, 2), np.int32), np.empty(len(corners), np.int64)
    x, second = parts_s[i], tables.scale > 0.0
    radius = _ball(x, middle)
    for h in range(3):
        centre[h] = 0.0
        for j in range(len(x)):
            centre[h] += x[j, h] / len(x)
    fill_axes(x, radius, axes)
    project(x, centre, axes, P)
    limits, most = np.empty(c), len(tables.weights) + 3 * tables.ends.shape[1]
    points, weights = np.empty((most, 2), kind), np.empty(most, kind)
    for r in range(c):
        pairs[r, 1], limits[r] = r, deepest[r] / radius
    at = pairs, limits, np.int64(0), c, centre, axes
    which, corners, n, hidden = _split(
        P, parts_m, balls, bilinear, *at, which, corners, np.int64(0)
    )
    of_P = of_Q = _maps(P, bilinear[0])
    for t in range(n):
        r = which[t]
        if t == 0 or which[t - 1] != r:
            project(parts_m[r], centre, axes, Q)
            of_Q = _maps(Q, bilinear[1])
            if second:
                along(of_m, r // b, axes, seen)
        before, after = _is_next(corners, which, t, n), _is_next(corners, which, t + 1, n)
        for q in range(_fill_points(corners[t], before, after, tables, points, weights)):
            point = points[q, 0], points[q, 1]
            r0, r1, s0, s1, J = _point(P, Q, of_P, of_Q, bilinear, *point)
            w = weights[q] * reciprocal(J)
            if second:
                places = tables.of_slave[i], tables.of_master[r % b], (r0, r1, s0, s1)
                r0, r1, s0, s1, J = carry(of_s, 0, axes, seen, *places)
                w = w * tables.scale * J
            else:
                w = w * radius**2 * _jacobian(of_P, bilinear[0], J, r0, r1)
            if np.isfinite(s0.real):
                fill_functions(tables.slave, r0, r1, N)
                fill_functions(tables.master, s0, s1, M)
                add_point(N, M, w, r // b, facet, Y[r // b], *given)
    return hidden


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
    centre, axes, radius = create_planes(parts_s)
    bilinear = parts_s.element.bilinear, parts_m.element.bilinear
    sides = parts_s.x, parts_m.x, bilinear, of_parts
    limits = deepest[of] / radius[of_parts[:, 0]]  # lengths in the planes are relative
    balls = bounding_balls(parts_m.x)
    which, corners = _triangulate(*sides[:2], balls, *sides[2:], limits, centre, axes)
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

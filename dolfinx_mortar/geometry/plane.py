# SPDX-License-Identifier: MIT
"""Facets in the auxiliary plane of a slave facet: projection, inverse maps, distances (3D)."""

import numba
import numpy as np

from dolfinx_mortar.arrays import Bools, Floats, Ints
from dolfinx_mortar.geometry import polygons
from dolfinx_mortar.geometry.facets import Facets, bounding_balls, facet_normals
from dolfinx_mortar.geometry.parts import count, pairs_of_parts, parts_of
from dolfinx_mortar.geometry.tolerances import HALF_OF_DIGITS, TINY


def create_planes(slave: Facets) -> tuple[Floats, Floats, Floats]:
    """Return centres (m, 3), axes (m, 3, 3) and radii (m,) of the facets' auxiliary planes.

    Rows of the axes are two tangents and the normal, over the radius: (x - centre) @ axes.T has
    the size of one.
    """
    x_s = slave.x
    centre, radius = bounding_balls(x_s)
    radius = np.maximum(radius, TINY)
    n = facet_normals(slave)
    t = x_s[:, 1] - x_s[:, 0]
    t = t - np.einsum("mi,mi->m", t, n)[:, None] * n
    t /= np.maximum(np.linalg.norm(t, axis=1), TINY)[:, None]
    axes = np.stack([t, np.cross(n, t), n], axis=1) / radius[:, None, None]
    return centre, axes, radius


@numba.njit(cache=True)
def project(x, centre, axes, P):  # type: ignore[no-untyped-def]
    """Write the facet x (k, 3) in the coordinates of a plane into P: tangents, then height."""
    for j in range(x.shape[0]):
        for i in range(3):
            P[j, i] = 0.0
            for h in range(3):
                P[j, i] += axes[i, h] * (x[j, h] - centre[h])


@numba.njit(cache=True)
def _bilinear(P, i):  # type: ignore[no-untyped-def]
    """Return m, a, b, c of component i of a bilinear map m + xi a + eta b + xi eta c."""
    p, q, r, s = P[0, i], P[1, i], P[2, i], P[3, i]
    return (p + q + r + s) / 4, (q + r - p - s) / 4, (r + s - p - q) / 4, (p + r - q - s) / 4


@numba.njit(cache=True)
def inverse(P, bilinear, x, y):  # type: ignore[no-untyped-def]
    """Return xi, eta and the size of the Jacobian where the projected facet P meets (x, y).

    With p = m - (x, y) of the bilinear map, the cross product of p + xi a + eta (b + xi c) = 0 and
    b + xi c is C + B xi + A xi^2 = 0, and the derivative of its left-hand side is the Jacobian: the
    root inside is the one where it has the sign of a x b.
    """
    if not bilinear:
        a0, a1, b0, b1 = P[1, 0] - P[0, 0], P[1, 1] - P[0, 1], P[2, 0] - P[0, 0], P[2, 1] - P[0, 1]
        J = a0 * b1 - a1 * b0
        p0, p1 = x - P[0, 0], y - P[0, 1]
        xi = (p0 * b1 - p1 * b0) / J
        # by projection on b: on slivers xi is inexact, but the point stays where it is
        return xi, ((p0 - xi * a0) * b0 + (p1 - xi * a1) * b1) / (b0 * b0 + b1 * b1), abs(J)
    (m0, a0, b0, c0), (m1, a1, b1, c1) = _bilinear(P, 0), _bilinear(P, 1)
    p0, p1 = m0 - x, m1 - y
    A = a0 * c1 - a1 * c0
    centre = a0 * b1 - a1 * b0
    B = centre + p0 * c1 - p1 * c0
    C = p0 * b1 - p1 * b0
    sign = 1.0 if centre > 0.0 else -1.0
    J = np.sqrt(max(B * B - 4 * A * C, 0.0))
    if sign * B > 0.0:  # the form that does not cancel
        xi = -2 * C / (B + sign * J)
    else:
        xi = (sign * J - B) / (2 * A)
    d0, d1 = b0 + xi * c0, b1 + xi * c1
    eta = -((p0 + xi * a0) * d0 + (p1 + xi * a1) * d1) / (d0 * d0 + d1 * d1)
    return xi, eta, J


@numba.njit(cache=True)
def height_at(P, bilinear, xi, eta):  # type: ignore[no-untyped-def]
    """Return the height of the point (xi, eta) of a facet over the plane."""
    if not bilinear:
        return (1 - xi - eta) * P[0, 2] + xi * P[1, 2] + eta * P[2, 2]
    m, a, b, c = _bilinear(P, 2)
    return m + xi * a + eta * (b + xi * c)


@numba.njit(cache=True)
def slopes(P, bilinear, xi, eta):  # type: ignore[no-untyped-def]
    """Return the two slopes of a facet against the plane at (xi, eta): minus those of its normal.

    The area of the facet per area in the plane is sqrt(1 + s_0^2 + s_1^2).
    """
    if not bilinear:
        return 0.0, 0.0
    (_, a0, b0, c0), (_, a1, b1, c1) = _bilinear(P, 0), _bilinear(P, 1)
    _, a2, b2, c2 = _bilinear(P, 2)
    a0, a1, a2 = a0 + eta * c0, a1 + eta * c1, a2 + eta * c2
    b0, b1, b2 = b0 + xi * c0, b1 + xi * c1, b2 + xi * c2
    n2 = a0 * b1 - a1 * b0
    return (a2 * b1 - a1 * b2) / n2, (a0 * b2 - a2 * b0) / n2


@numba.njit(cache=True)
def _are_near(x_s, x_m, pairs, centre, axes, radius, margin):  # type: ignore[no-untyped-def]
    """Tell (p,) whether the projections come closer than the margins."""
    near = np.ones(len(pairs), dtype=np.bool_)
    k, n = x_s.shape[1], x_m.shape[1]
    S, M = np.empty((k, 3)), np.empty((n, 3))
    for p in range(len(pairs)):
        s = pairs[p, 0]
        if p == 0 or s != pairs[p - 1, 0]:
            project(x_s[s], centre[s], axes[s], S)
            convex = polygons.orientation(S, k)
        project(x_m[pairs[p, 1]], centre[s], axes[s], M)
        reach = margin[s] / radius[s] + HALF_OF_DIGITS
        sign = polygons.orientation(M, n)
        if convex != 0 and polygons.is_beside(S, k, M, n, convex, reach):
            near[p] = False
        elif sign != 0 and polygons.is_beside(M, n, S, k, sign, reach):
            near[p] = False
    return near


def are_near(slave: Facets, master: Facets, pairs: Ints, margin: Floats) -> Bools:
    """Tell (p,) which pairs come closer than a margin when projected on the slave's plane.

    Args:
        slave: Slave facets (ms,).
        master: Master facets (mm,).
        pairs: Pairs (p, 2), ordered by slave facet.
        margin: Lateral margin (ms,).
    """
    a, b = parts_of(slave), parts_of(master)
    of_parts, of = pairs_of_parts(pairs, slave.element, master.element)
    margins = np.repeat(margin, count(slave.element))
    near = _are_near(a.x, b.x, of_parts, *create_planes(a), margins)
    return np.asarray(np.bincount(of, near, minlength=len(pairs)) > 0)

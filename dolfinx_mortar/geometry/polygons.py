# SPDX-License-Identifier: MIT
"""Convex polygons in the plane: clipping, overlap and difference (compiled kernels).

A polygon is an array of vertices, anticlockwise, of which the first `n` count. Lengths are
relative: the callers scale the plane so that a slave facet has radius 1. Vertices that are nearer
to a line than ROUND_OFF are taken to lie on it.

Numba's cache of a caller in another file does not notice changes here: touch that file, too.
"""

import numba
import numpy as np

from dolfinx_mortar.geometry.tolerances import HALF_OF_DIGITS, ROUND_OFF

VERTICES = 32
"""Space for the vertices of a polygon (cost only).

Two quadrilaterals have 8 in common; each cut adds one, and polygons are halved before it is full.
"""


@numba.njit(cache=True)
def cut(P, n, ax, ay, bx, by, Q):  # type: ignore[no-untyped-def]
    """Write the part of P on the left of the line from a to b into Q; return its size."""
    dx, dy = bx - ax, by - ay
    length = np.sqrt(dx * dx + dy * dy)
    dx, dy = dx / length, dy / length
    m = 0
    before = n - 1
    d0 = dx * (P[before, 1] - ay) - dy * (P[before, 0] - ax)
    for i in range(n):
        d1 = dx * (P[i, 1] - ay) - dy * (P[i, 0] - ax)
        apart = (d0 < -ROUND_OFF and d1 > ROUND_OFF) or (d0 > ROUND_OFF and d1 < -ROUND_OFF)
        if apart and m < VERTICES:
            t = d0 / (d0 - d1)
            Q[m, 0] = P[before, 0] + t * (P[i, 0] - P[before, 0])
            Q[m, 1] = P[before, 1] + t * (P[i, 1] - P[before, 1])
            m += 1
        if d1 >= -ROUND_OFF and m < VERTICES:
            Q[m, 0], Q[m, 1] = P[i, 0], P[i, 1]
            m += 1
        before, d0 = i, d1
    return m


@numba.njit(cache=True)
def halve(P, n, Q):  # type: ignore[no-untyped-def]
    """Leave one half of P on this side of a diagonal, write the other into Q; return the sizes."""
    half = n // 2
    for k in range(half, n):
        Q[k - half, 0], Q[k - half, 1] = P[k, 0], P[k, 1]
    Q[n - half, 0], Q[n - half, 1] = P[0, 0], P[0, 1]
    return half + 1, n - half + 1


@numba.njit(cache=True)
def measure(P, n):  # type: ignore[no-untyped-def]
    """Return area and centroid (the mean of the vertices where there is no area) of P."""
    area, x, y, mx, my = 0.0, 0.0, 0.0, P[0, 0], P[0, 1]
    for i in range(1, n):
        mx, my = mx + P[i, 0], my + P[i, 1]
    mx, my = mx / n, my / n
    for i in range(n):
        j = i + 1 if i + 1 < n else 0
        ux, uy = P[i, 0] - mx, P[i, 1] - my
        vx, vy = P[j, 0] - mx, P[j, 1] - my
        part = (ux * vy - uy * vx) / 2
        area += part
        x, y = x + part * (ux + vx) / 3, y + part * (uy + vy) / 3
    if area > 0.0:
        mx, my = mx + x / area, my + y / area
    return area, mx, my


@numba.njit(cache=True)
def is_thin(P, n):  # type: ignore[no-untyped-def]
    """Tell whether P is as narrow as the errors of some cuts, or no polygon at all."""
    if n < 3:
        return True
    square = 0.0
    for i in range(1, n):
        square = max(square, (P[i, 0] - P[0, 0]) ** 2 + (P[i, 1] - P[0, 1]) ** 2)
    return measure(P, n)[0] <= 8 * ROUND_OFF * np.sqrt(square)


@numba.njit(cache=True)
def orientation(P, n):  # type: ignore[no-untyped-def]
    """Return 1 or -1 for an anticlockwise or clockwise convex polygon, 0 for anything else.

    A corner is straight if its area is less than HALF_OF_DIGITS of the sum over the corners: there
    a quadrilateral has no inverse map. Corners of a triangle have equal areas.
    """
    least, most, whole = np.inf, -np.inf, 0.0
    for i in range(n):
        j, h = (i + 1) % n, (i + n - 1) % n
        ux, uy = P[j, 0] - P[i, 0], P[j, 1] - P[i, 1]
        vx, vy = P[h, 0] - P[i, 0], P[h, 1] - P[i, 1]
        corner = ux * vy - uy * vx
        least, most, whole = min(least, corner), max(most, corner), whole + abs(corner)
    if least > HALF_OF_DIGITS * whole:
        return 1
    return -1 if most < -HALF_OF_DIGITS * whole else 0


@numba.njit(cache=True)
def intersect(P, n, Q, m, sign, out, spare):  # type: ignore[no-untyped-def]
    """Write P cut by the convex Q of the given orientation into out; return its size."""
    for i in range(n):
        out[i, 0], out[i, 1] = P[i, 0], P[i, 1]
    for i in range(m):
        j = i + 1 if i + 1 < m else 0
        a, b = (i, j) if sign > 0 else (j, i)
        n = cut(out, n, Q[a, 0], Q[a, 1], Q[b, 0], Q[b, 1], spare)
        for k in range(n):
            out[k, 0], out[k, 1] = spare[k, 0], spare[k, 1]
        if n < 3:
            return 0
    return n


@numba.njit(cache=True)
def is_beside(P, n, Q, m, sign, distance):  # type: ignore[no-untyped-def]
    """Tell whether some edge of P, of the given orientation, has all of Q beyond a distance."""
    for i in range(n):
        j = i + 1 if i + 1 < n else 0
        dx, dy = sign * (P[j, 0] - P[i, 0]), sign * (P[j, 1] - P[i, 1])
        length = np.sqrt(dx * dx + dy * dy)
        beside = length > 0.0
        for k in range(m):
            d = dx * (Q[k, 1] - P[i, 1]) - dy * (Q[k, 0] - P[i, 0])
            if d > -distance * length:
                beside = False
                break
        if beside:
            return True
    return False


@numba.njit(cache=True)
def subtract(P, n, Q, m, sign, pieces, sizes, count, spare):  # type: ignore[no-untyped-def]
    """Append the convex pieces of P without Q, of the given orientation; return the new count.

    Each edge of Q cuts off a piece beyond it; the next edge cuts the rest.
    """
    rest = np.empty((VERTICES, 2))
    for i in range(n):
        rest[i, 0], rest[i, 1] = P[i, 0], P[i, 1]
    for i in range(m):
        j = i + 1 if i + 1 < m else 0
        a, b = (i, j) if sign > 0 else (j, i)
        size = cut(rest, n, Q[b, 0], Q[b, 1], Q[a, 0], Q[a, 1], pieces[count])
        if not is_thin(pieces[count], size):
            sizes[count] = size
            count += 1
        n = cut(rest, n, Q[a, 0], Q[a, 1], Q[b, 0], Q[b, 1], spare)
        for k in range(n):
            rest[k, 0], rest[k, 1] = spare[k, 0], spare[k, 1]
        if n < 3:
            break
    return count

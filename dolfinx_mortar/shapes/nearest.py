# SPDX-License-Identifier: MIT
r"""The nearest points of a surface of curved triangles, by a tree of boxes.

With the area coordinates s_i of a triangle, its corners p_i and the offsets m_ij of the middles of
its edges,

    S = sum_i s_i p_i + 4 sum_ij s_i s_j m_ij,

as of a six-node triangle. It lies in the convex hull of its corners and of the points p_ij + 2 m_ij
over the middles p_ij of the edges, the corners of its net as a Bezier triangle.
"""

import numba
import numpy as np

from dolfinx_mortar.arrays import EPS, LIMIT, Floats, Longs

FACE, EDGE, POINT = 0, 1, 4
"""Where the nearest point lies: in the triangle, on the edges 1 to 3, at the corners 4 to 6."""


def create_tree(corners: Floats, offsets: Floats) -> tuple[Floats, Longs]:
    """Return boxes (2 k, 2, 3) of a binary tree, and the triangles (k,) that are its leaves.

    Box 1 is the root, 2 i and 2 i + 1 are the halves of box i, leaf i the box k + i. Each is cut
    across its longest side; the last triangle is repeated up to a power of two.

    Args:
        corners: (m, 3, 3).
        offsets: (m, 3, 3) of the middles of the edges.
    """
    net = np.concatenate([corners, (corners + corners[:, [1, 2, 0]]) / 2 + 2 * offsets], axis=1)
    low, high, middles = net.min(axis=1), net.max(axis=1), corners.mean(axis=1)
    m = len(corners)
    levels = (m - 1).bit_length()
    order = np.minimum(np.arange(1 << levels), m - 1).reshape(1, -1)
    for _ in range(levels):
        x = middles[order]
        longest = np.argmax(np.ptp(x, axis=1), axis=1)
        along = np.take_along_axis(x, longest[:, None, None], axis=2)[..., 0]
        order = np.take_along_axis(order, np.argsort(along, axis=1, kind="stable"), axis=1)
        order = order.reshape(2 * len(order), -1)
    leaves = order.ravel().astype(np.int64)
    k = len(leaves)
    boxes = np.zeros((2 * k, 2, 3))
    boxes[k:, 0], boxes[k:, 1] = low[leaves], high[leaves]
    for _ in range(levels):
        k //= 2
        halves = boxes[2 * k : 4 * k].reshape(k, 2, 2, 3)
        boxes[k : 2 * k, 0] = halves[:, :, 0].min(axis=1)
        boxes[k : 2 * k, 1] = halves[:, :, 1].max(axis=1)
    return boxes, leaves


@numba.njit(cache=True)
def _dot(a, b):  # type: ignore[no-untyped-def]
    """Return a.b of vectors (3,), without a call of BLAS."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@numba.njit(cache=True)
def _on_edge(x, p, q, m):  # type: ignore[no-untyped-def]
    """Return t of the nearest point p + t (q - p) + 4 t (1 - t) m, and its distance squared.

    Newton's method in [0, 1], from the nearest point of the chord.
    """
    chord = q - p
    t = min(max(_dot(x - p, chord) / _dot(chord, chord), 0.0), 1.0)
    for _ in range(LIMIT):
        r = x - p - t * chord - 4.0 * t * (1.0 - t) * m
        slope = chord + 4.0 * (1.0 - 2.0 * t) * m
        curved = _dot(slope, slope) + 8.0 * (_dot(r, m))
        if curved <= 0.0:
            curved = _dot(slope, slope)
        new = min(max(t + (_dot(r, slope)) / curved, 0.0), 1.0)
        done = abs(new - t) <= EPS
        t = new
        if done:
            break
    r = x - p - t * chord - 4.0 * t * (1.0 - t) * m
    return t, _dot(r, r)


@numba.njit(cache=True)
def _in_face(x, p, m):  # type: ignore[no-untyped-def]
    """Return s_1, s_2 of the point inside whose normal meets x, and its distance squared.

    Infinite if there is none. Newton's method, from the nearest point of the plane.
    """
    a, b = p[1] - p[0], p[2] - p[0]
    r = x - p[0]
    aa, ab, bb = _dot(a, a), _dot(a, b), _dot(b, b)
    ra, rb = _dot(r, a), _dot(r, b)
    det = aa * bb - ab * ab
    s, t = (bb * ra - ab * rb) / det, (aa * rb - ab * ra) / det
    mss, mtt, mst = -8.0 * m[0], -8.0 * m[2], 4.0 * (m[1] - m[0] - m[2])
    for _ in range(LIMIT):
        if s < -0.5 or t < -0.5 or s + t > 1.5:
            return s, t, np.inf
        o = 1.0 - s - t
        r = x - o * p[0] - s * p[1] - t * p[2]
        r = r - 4.0 * (o * s * m[0] + s * t * m[1] + t * o * m[2])
        js = a + 4.0 * ((o - s) * m[0] + t * (m[1] - m[2]))
        jt = b + 4.0 * (s * (m[1] - m[0]) + (o - t) * m[2])
        gs, gt = _dot(r, js), _dot(r, jt)
        aa, ab, bb = (
            _dot(js, js) - _dot(r, mss),
            _dot(js, jt) - _dot(r, mst),
            _dot(jt, jt) - _dot(r, mtt),
        )
        det = aa * bb - ab * ab
        if aa <= 0.0 or det <= 0.0:  # beyond the centre of curvature
            return s, t, np.inf
        ds, dt = (bb * gs - ab * gt) / det, (aa * gt - ab * gs) / det
        s, t = s + ds, t + dt
        if abs(ds) + abs(dt) <= 4.0 * EPS:
            break
    if s < 0.0 or t < 0.0 or s + t > 1.0:
        return s, t, np.inf
    o = 1.0 - s - t
    r = x - o * p[0] - s * p[1] - t * p[2]
    r = r - 4.0 * (o * s * m[0] + s * t * m[1] + t * o * m[2])
    return s, t, _dot(r, r)


@numba.njit(cache=True)
def _box_distance(x, box):  # type: ignore[no-untyped-def]
    """Return the squared distance of a point from a box."""
    total = 0.0
    for i in range(3):
        off = max(box[0, i] - x[i], x[i] - box[1, i], 0.0)
        total += off * off
    return total


@numba.njit(cache=True)
def _from_flat(x, p):  # type: ignore[no-untyped-def]
    """Return the distance of a point from the flat triangle of the corners."""
    a, b, r = p[1] - p[0], p[2] - p[0], x - p[0]
    aa, ab, bb, ra, rb = _dot(a, a), _dot(a, b), _dot(b, b), _dot(r, a), _dot(r, b)
    det = aa * bb - ab * ab
    s, t = (bb * ra - ab * rb) / det, (aa * rb - ab * ra) / det
    if s >= 0.0 and t >= 0.0 and s + t <= 1.0:
        off = r - s * a - t * b
        return np.sqrt(_dot(off, off))
    least = np.inf
    for k in range(3):
        side, r = p[(k + 1) % 3] - p[k], x - p[k]
        along = min(max((_dot(r, side)) / (_dot(side, side)), 0.0), 1.0)
        off = r - along * side
        least = min(least, _dot(off, off))
    return np.sqrt(least)


@numba.njit(cache=True)
def _on_triangle(x, p, m):  # type: ignore[no-untyped-def]
    """Return distance squared, where the nearest point lies, and its two coordinates there."""
    s, t, least = _in_face(x, p, m)
    where = FACE
    if least < np.inf:
        return least, where, s, t
    for k in range(3):
        along, far = _on_edge(x, p[k], p[(k + 1) % 3], m[k])
        if far < least:
            least, where, s, t = far, EDGE + k, along, 0.0
            if along == 0.0:
                where = POINT + k
            elif along == 1.0:
                where = POINT + (k + 1) % 3
    return least, where, s, t


@numba.njit(cache=True)
def find_nearest(points, corners, offsets, boxes, leaves):  # type: ignore[no-untyped-def]
    """Return for points (n, 3) the nearest triangle (n,), where in it (n,), and s, t there (n, 2).

    Args:
        points: (n, 3).
        corners: (m, 3, 3).
        offsets: (m, 3, 3) of the middles of the edges.
        boxes: see `create_tree`.
        leaves: likewise.
    """
    n, k = len(points), len(leaves)
    nearest, where = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64)
    at = np.zeros((n, 2))
    stack = np.zeros(64, dtype=np.int64)
    for i in range(n):
        x, best, size = points[i], np.inf, 1
        stack[0] = 1
        while size:
            size -= 1
            box = stack[size]
            if _box_distance(x, boxes[box]) >= best:
                continue
            if box < k:
                near, far = 2 * box, 2 * box + 1
                if _box_distance(x, boxes[far]) < _box_distance(x, boxes[near]):
                    near, far = far, near
                stack[size], stack[size + 1] = far, near
                size += 2
                continue
            j = leaves[box - k]
            p, m = corners[j], offsets[j]
            # 4 sum s_i s_j is at most 4 / 3
            bulge = np.sqrt(max(_dot(m[0], m[0]), _dot(m[1], m[1]), _dot(m[2], m[2]))) * 4.0 / 3.0
            if max(_from_flat(x, p) - bulge, 0.0) ** 2 >= best:
                continue
            least, place, s, t = _on_triangle(x, p, m)
            if least < best:
                best, nearest[i], where[i] = least, j, place
                at[i, 0], at[i, 1] = s, t
    return nearest, where, at

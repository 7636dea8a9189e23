# SPDX-License-Identifier: MIT
"""Distances from curved lines in the plane and curved triangles in space.

The edge from p to q = p + c is a cubic with tangents c + a and c + b at its ends,

    x(t) = p + t c + t (1 - t)^2 a - t^2 (1 - t) b.

A triangle with corners p_i, area coordinates s_i and parabolic edges, b_ij = -a_ij, is

    S = sum_i s_i p_i + sum_ij s_i s_j a_ij.

Both lie in the convex hull of their corners, p + (c + a) / 2 and q - (c + b) / 2.
"""

from __future__ import annotations

import numba
import numpy as np

from dolfinx_mortar.common.arrays import EPS, HALF_OF_DIGITS, LIMIT, Floats, Longs
from dolfinx_mortar.shapes.shape import Distance, Shape, unit_vectors

FACE, EDGE, POINT = 0, 1, 4
"""Where the nearest point lies: in the triangle, on the edges 1 to 3, at the corners 4 to 6."""

Parts = tuple[Floats, Floats, Floats]


class Curved(Shape):
    """Region bounded by curved lines or triangles."""

    def _bend(self, corners: Floats, bends: Floats, *normals: Floats) -> None:
        self._corners, self._bends = _in_space(corners), _in_space(bends)
        self._normals = [_in_space(one) for one in normals]
        self._tree = create_tree(self._corners, self._bends)

    def distance(self, x: Floats) -> Distance:
        """Distances of points x (n, d)."""
        n, d = x.shape
        x = _in_space(x)
        near, where, at = find_nearest(x, self._corners, self._bends, *self._tree)
        if d == 2:
            offset, slope, _ = self._on_edges(x, near, 0 * near, at)
            past = np.abs((offset * slope).sum(axis=1)) > HALF_OF_DIGITS * (slope**2).sum(axis=1)
            where = np.where((where >= POINT) & past, where, FACE)
        value, gradient, hessian = np.zeros(n), np.zeros((n, 3)), np.zeros((n, 3, 3))
        for mine, part in ((where == FACE, self._from_inside), (where != FACE, self._from_edges)):
            if mine.any():
                parts = part(x[mine], near[mine], where[mine] - EDGE, at[mine])
                value[mine], gradient[mine], hessian[mine] = parts
        return Distance(value, gradient[:, :d], hessian[:, :d, :d])

    def _on_edges(self, x: Floats, near: Longs, k: Longs, at: Floats) -> Parts:
        """Offsets (n, 3) from edges, and both derivatives of the edges."""
        p, q = self._corners[near, k], self._corners[near, (k + 1) % self._corners.shape[1]]
        foot, slope, second = _edge(p, q, np.moveaxis(self._bends[near, k], 1, 0), at[:, :1])
        return x - foot, slope, second

    def _from_inside(self, x: Floats, near: Longs, where: Longs, at: Floats) -> Parts:
        """Distances of points (n, 3) from smooth nearest points.

        With tangents J, fundamental forms G and B, and F = G - phi B, the Hessian is -J G^-1 B F^-1
        J^T.
        """
        if self._bends.shape[1] == 1:
            offset, slope, second = self._on_edges(x, near, 0 * near, at)
            J, second = slope[:, :, None], second[:, None, None]
            normal = np.asarray(np.cross(slope, [0.0, 0.0, 1.0]), float)
        else:
            a = np.moveaxis(self._bends[near, :, 0], 1, 0)
            p = np.moveaxis(self._corners[near], 1, 0)
            foot, js, jt = _face(p, a, at[:, :1], at[:, 1:])
            mixed = a[1] - a[0] - a[2]
            second = np.stack([-2.0 * a[0], mixed, mixed, -2.0 * a[2]], axis=1)
            second = second.reshape(-1, 2, 2, 3)
            offset, J = x - foot, np.stack([js, jt], axis=2)
            normal = np.asarray(np.cross(js, jt), float)
        _, normal = unit_vectors(normal)
        phi = (offset * normal).sum(axis=1)
        B = (second * normal[:, None, None]).sum(axis=3)
        Jt = np.swapaxes(J, 1, 2)
        G = Jt @ J
        F = G - phi[:, None, None] * B
        return phi, normal, -J @ np.linalg.solve(G, B @ np.linalg.solve(F, Jt))

    def _from_edges(self, x: Floats, near: Longs, where: Longs, at: Floats) -> Parts:
        """Distances of points (n, 3) from edges and corners, with curvature 1 / r."""
        k, at_corner = where % 3, (where >= POINT - EDGE)[:, None]
        edge = k % self._bends.shape[1]
        offset, slope, second = self._on_edges(x, near, edge, at)
        curved = (slope**2).sum(axis=1) - (offset * second).sum(axis=1)
        along = slope[:, :, None] * slope[:, None] / curved[:, None, None]
        offset = np.where(at_corner, x - self._corners[near, k], offset)
        normal = np.where(at_corner, self._normals[1][near, k], self._normals[0][near, edge])
        _, normal = unit_vectors(normal)
        r = np.linalg.norm(offset, axis=1)
        sign = np.where((offset * normal).sum(axis=1) < 0.0, -1.0, 1.0)
        # round-off has no direction
        apart = r > HALF_OF_DIGITS * np.ptp(self._corners, axis=(0, 1)).max()
        divisor = np.where(apart, sign * r, 1.0)
        gradient = np.where(apart[:, None], offset / divisor[:, None], normal)
        across = np.eye(3) - gradient[:, :, None] * gradient[:, None]
        across -= np.where(at_corner[:, None], 0.0, along)
        hessian = np.where(apart[:, None, None], across / divisor[:, None, None], 0.0)
        return sign * r, gradient, hessian


def _in_space(x: Floats) -> Floats:
    return np.ascontiguousarray(np.pad(x, [*(x.ndim - 1) * [(0, 0)], (0, 3 - x.shape[-1])]))


def create_tree(corners: Floats, bends: Floats) -> tuple[Floats, Longs, Floats]:
    """Boxes (2 k, 2, 3) of a binary tree, indices (k,) at its leaves, and bulges (m,) of bends.

    Boxes 2 i and 2 i + 1 halve box i across its longest side, from the root 1; box k + i is leaf i;
    the last leaf is repeated up to a power of two.
    """
    half = (corners + np.roll(corners, -1, axis=1))[:, : bends.shape[1]] / 2
    net = np.hstack([corners, half + bends[:, :, 0] / 2, half - bends[:, :, 1] / 2])
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
    return boxes, leaves, np.linalg.norm(bends, axis=3).max(axis=(1, 2)) / 3.0


def _edge(p, q, bend, t):  # type: ignore[no-untyped-def]
    """Return x(t) and its two derivatives."""
    a, b, c = bend[0], bend[1], q - p
    x = p + t * c + t * (1.0 - t) ** 2 * a - t**2 * (1.0 - t) * b
    slope = c + (1.0 - 4.0 * t + 3.0 * t**2) * a + (3.0 * t**2 - 2.0 * t) * b
    return x, slope, (6.0 * t - 4.0) * a + (6.0 * t - 2.0) * b


def _face(p, a, s, t):  # type: ignore[no-untyped-def]
    """Return S and its derivatives by s and t."""
    o = 1.0 - s - t
    x = o * p[0] + s * p[1] + t * p[2] + o * s * a[0] + s * t * a[1] + t * o * a[2]
    by_s = p[1] - p[0] + (o - s) * a[0] + t * (a[1] - a[2])
    return x, by_s, p[2] - p[0] + s * (a[1] - a[0]) + (o - t) * a[2]


_compiled_edge, _compiled_face = numba.njit(cache=True)(_edge), numba.njit(cache=True)(_face)


@numba.njit(cache=True)
def _dot(a, b):  # type: ignore[no-untyped-def]
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@numba.njit(cache=True)
def _on_edge(x, p, q, bend):  # type: ignore[no-untyped-def]
    """Nearest t in [0, 1] to x, and distance squared; Newton's method from the chord."""
    t = min(max(_dot(x - p, q - p) / _dot(q - p, q - p), 0.0), 1.0)
    for _ in range(LIMIT):
        foot, slope, second = _compiled_edge(p, q, bend, t)
        square = _dot(slope, slope)
        curved = square - _dot(x - foot, second)
        last, step = t, _dot(x - foot, slope) / (curved if curved > 0.0 else square)
        t = min(max(t + step, 0.0), 1.0)
        if abs(t - last) <= 4.0 * EPS:
            break
    r = x - _compiled_edge(p, q, bend, t)[0]
    return t, _dot(r, r)


@numba.njit(cache=True)
def _in_face(x, p, a):  # type: ignore[no-untyped-def]
    """Coordinates s, t of the foot of x, and distance squared, inf without one."""
    s, t, bend = 0.0, 0.0, 0.0 * a
    for k in range(LIMIT):
        foot, js, jt = _compiled_face(p, bend, s, t)
        r = x - foot
        gs, gt = _dot(r, js), _dot(r, jt)
        ss = _dot(js, js) + 2.0 * _dot(r, bend[0])
        st = _dot(js, jt) - _dot(r, bend[1] - bend[0] - bend[2])
        tt = _dot(jt, jt) + 2.0 * _dot(r, bend[2])
        det = ss * tt - st * st
        if ss <= 0.0 or det <= 0.0:  # beyond the centre of curvature
            return s, t, np.inf
        ds, dt = (tt * gs - st * gt) / det, (ss * gt - st * gs) / det
        s, t, bend = s + ds, t + dt, a
        if k > 0 and abs(ds) + abs(dt) <= 4.0 * EPS:
            break
        if s < -0.5 or t < -0.5 or s + t > 1.5:
            return s, t, np.inf
    if s < 0.0 or t < 0.0 or s + t > 1.0:
        return s, t, np.inf
    r = x - _compiled_face(p, a, s, t)[0]
    return s, t, _dot(r, r)


@numba.njit(cache=True)
def _box_distance(x, box):  # type: ignore[no-untyped-def]
    total = 0.0
    for i in range(3):
        off = max(box[0, i] - x[i], x[i] - box[1, i], 0.0)
        total += off * off
    return total


@numba.njit(cache=True)
def _from_flat(x, p):  # type: ignore[no-untyped-def]
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
def _on_one(x, p, bends):  # type: ignore[no-untyped-def]
    where, s, t, least = FACE, 0.0, 0.0, np.inf
    if len(p) == 3:
        s, t, least = _in_face(x, p, bends[:, 0])
        if least < np.inf:
            return least, where, s, t
    for k in range(len(bends)):
        along, far = _on_edge(x, p[k], p[(k + 1) % len(p)], bends[k])
        if far < least:
            least, where, s, t = far, EDGE + k, along, 0.0
            if along in (0.0, 1.0):
                where = POINT + (k + int(along)) % len(p)
    return least, where, s, t


@numba.njit(cache=True)
def find_nearest(points, corners, bends, boxes, leaves, bulges):  # type: ignore[no-untyped-def]
    """Nearest element (n,) of points (n, 3), location in it (n,), s and t (n, 2)."""
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
            if len(corners[j]) == 3 and _from_flat(x, corners[j]) - bulges[j] > np.sqrt(best):
                continue
            least, place, s, t = _on_one(x, corners[j], bends[j])
            if least < best:
                best, nearest[i], where[i] = least, j, place
                at[i, 0], at[i, 1] = s, t
    return nearest, where, at

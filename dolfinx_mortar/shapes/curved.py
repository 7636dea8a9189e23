# SPDX-License-Identifier: MIT
"""Distances from curved lines in the plane and curved triangles in space.

The edge from p to q = p + c is a cubic with tangents c + a and c + b at its ends,

    x(t) = p + t c + t (1 - t)^2 a - t^2 (1 - t) b.

A triangle with corners p_i, area coordinates s_i and parabolic edges, b_ij = -a_ij, is

    S = sum_i s_i p_i + sum_ij s_i s_j a_ij.

Both lie in the convex hull of their corners, p + (c + a) / 2 and q - (c + b) / 2.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from inspect import signature
from typing import Any

import numba
import numpy as np

from dolfinx_mortar.common.arrays import EPS, HALF_OF_DIGITS, LIMIT, Floats, Longs
from dolfinx_mortar.shapes.shape import Distance, Shape, unit_vectors

FACE, EDGE, POINT = 0, 1, 4
"""Where the nearest point lies: in the triangle, on the edges 1 to 3, at the corners 4 to 6."""


class Curved(Shape):
    """Region bounded by curved lines or triangles."""

    def _bend(self, corners: Floats, bends: Floats, *normals: Floats) -> None:
        self._corners, self._bends = _in_space(corners), _in_space(bends)
        self._normals = [_in_space(one) for one in normals]
        self._tree = create_tree(self._corners, self._bends)
        self._digest = hashlib.sha256(self._corners.tobytes()).hexdigest()

    def given(self) -> Mapping[str, Any]:
        """See `Shape`; with a digest of the first argument."""
        first, *names = signature(type(self)).parameters
        return {first: self._digest, **{name: getattr(self, name) for name in names}}

    def distance(self, x: Floats) -> Distance:
        """Distances of points x (n, d).

        With the tangents J and the fundamental forms G and B of the surface, or the edge, at the
        nearest point, and F = G - phi B, the Hessian is -J G^-1 B F^-1 J^T, plus (I - n n^T - J
        G^-1 J^T) / phi at edges and corners.
        """
        n, d = x.shape
        x = _in_space(x)
        near, where, at = find_nearest(x, self._corners, self._bends, *self._tree)
        k = np.maximum(where - EDGE, 0) % 3
        edge, corners = k % self._bends.shape[1], self._corners
        p, q = corners[near, edge], corners[near, (edge + 1) % corners.shape[1]]
        bends = np.moveaxis(self._bends[near, edge], 1, 0)
        foot, slope, bend = _edge(p, q, bends, at[:, :1])
        J, second = np.zeros((n, 2, 3)), np.zeros((n, 2, 2, 3))
        J[:, 0], second[:, 0, 0] = slope, bend
        on_face, at_corner = where == FACE, where >= POINT
        if d == 2:
            off = np.abs(((x - foot) * slope).sum(axis=1))
            at_corner &= off > HALF_OF_DIGITS * (slope**2).sum(axis=1)
            on_face = ~at_corner
            across = np.cross(slope, [0.0, 0.0, 1.0])
        else:
            a = self._bends[near[on_face], :, 0]
            s, t = at[on_face].T[..., None]
            p, a = (np.moveaxis(v, 1, 0) for v in (corners[near[on_face]], a))
            foot[on_face], J[on_face, 0], J[on_face, 1] = _face(p, a, s, t)
            mixed = a[1] - a[0] - a[2]
            parts = np.stack([-2.0 * a[0], mixed, mixed, -2.0 * a[2]], axis=1)
            second[on_face] = parts.reshape(-1, 2, 2, 3)
            across = np.cross(J[:, 0], J[:, 1])
        foot[at_corner], J[at_corner], second[at_corner] = corners[near, k][at_corner], 0.0, 0.0
        normal = np.where(
            at_corner[:, None], self._normals[1][near, k], self._normals[0][near, edge]
        )
        _, normal = unit_vectors(np.where(on_face[:, None], across, normal))
        offset = x - foot
        value = (offset * normal).sum(axis=1)
        r = np.linalg.norm(offset, axis=1)
        # round-off has no direction
        apart = ~on_face & (r > HALF_OF_DIGITS * np.ptp(corners, axis=(0, 1)).max())
        value = np.where(on_face, value, np.where(value < 0.0, -r, r))
        divisor = np.where(apart, value, np.inf)[:, None]
        normal = np.where(apart[:, None], offset / divisor, normal)
        B = (second * normal[:, None, None]).sum(axis=3)
        G = J @ np.swapaxes(J, 1, 2)
        G[:, range(2), range(2)] += ~J.any(axis=2)
        inverse = np.linalg.inv(G)
        bent = inverse @ B @ np.linalg.solve(G - value[:, None, None] * B, J)
        rest = np.eye(3) - normal[:, :, None] * normal[:, None]
        rest = (rest - np.swapaxes(J, 1, 2) @ inverse @ J) / divisor[..., None]
        hessian = rest - np.swapaxes(J, 1, 2) @ bent
        return Distance(value, normal[:, :d], hessian[:, :d, :d])


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
        along = min(max(_dot(r, side) / _dot(side, side), 0.0), 1.0)
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

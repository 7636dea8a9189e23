# SPDX-License-Identifier: MIT
r"""Tools in the plane by points of their outline, from a drawing or a measured profile.

The edge from p to q, with the unit normals n_p, n_q there, is the parabola p + t (q - p)
+ 4 t (1 - t) m whose middle is moved by

    m = (n_p + n_q) (n_q - n_p).(q - p) / (4 |n_p + n_q|^2),

as are the edges of `Triangles`. Corners at which normals turn by more than ``crease`` stay sharp.
phi is the distance from this line, with the normal and the curvature of the nearest point.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from itertools import chain
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from dolfinx_mortar.arguments import as_numbers
from dolfinx_mortar.arrays import EPS, HALF_OF_DIGITS, LIMIT, Bools, Floats, Longs
from dolfinx_mortar.shapes.shape import (
    Distance,
    Shape,
    check_angle,
    check_vector,
    of_centre,
    unit_vectors,
)


class Polyline(Shape):
    """The region on the left of a line through points, such as within a polygon; in the plane.

    In axisymmetric problems points are (r, z), on both sides of the axis if the tool meets it.

    Args:
        points: (n, 2), with the tool on the left: counterclockwise around it.
        point: 2 coordinates that tell where the tool is, about which it turns; the middle of the
            box around the points if not given.
        crease: in degrees, from 0 to 90; a corner at which normals turn by more stays sharp, others
            are smooth. With 0 all edges are straight.
        closed: whether the last point is joined to the first one. If not, phi beyond an end is the
            distance from that: the body must not get there.

    Raises:
        ValueError: for what is no array of finite points, fewer than 3 of a polygon or 2 of a line,
            points that coincide with the next ones, edges that cross, a polygon whose points go
            clockwise, and a crease that is no such angle.
    """

    def __init__(
        self, points: Any, point: Any = None, *, crease: float = 30.0, closed: bool = True
    ) -> None:
        self.crease, self.closed = check_angle("crease", crease), bool(closed)
        self.points = _check_points(points, 3 if closed else 2)
        x = self.points
        self._point = (x.min(axis=0) + x.max(axis=0)) / 2
        if point is not None:
            self._point = check_vector("point", point, 2)
        self._p = x if closed else x[:-1]
        self._q = np.roll(x, -1, axis=0)[: len(self._p)]
        lengths, along = unit_vectors(self._q - self._p)
        _refuse(
            self._p, lengths <= HALF_OF_DIGITS * np.ptp(x, axis=0).max(), "points that coincide"
        )
        _refuse(self._p, _crossed(self._p, self._q, self.closed), "edges that cross others")
        if closed and (x[:, 0] * self._q[:, 1] - x[:, 1] * self._q[:, 0]).sum() < 0.0:  # area
            raise ValueError(
                "points go clockwise around the tool: reverse them, points[::-1], or for a body in "
                "a cavity give the Complement of that"
            )
        self._normals = np.column_stack([along[:, 1], -along[:, 0]])
        at_p, at_q = self._smooth_normals(lengths)
        both = at_p + at_q
        turn = ((at_q - at_p) * (self._q - self._p)).sum(axis=1) / (4.0 * (both**2).sum(axis=1))
        self._middles = turn[:, None] * both * (self.crease > 0.0)
        self._tree = cKDTree((self._p + self._q) / 2)

    @property
    def point(self) -> Floats:
        """As given, or the middle of the box around the points, (2,)."""
        return self._point

    @property
    def surface(self) -> tuple[Floats, Longs]:
        """Ends and middles of the edges (n, 2), and two lines (m, 2) for each."""
        p, q, n = self._p, self._q, np.arange(len(self._p))
        x = np.concatenate([p, (p + q) / 2 + self._middles, q])
        lines = np.concatenate([n, n + len(n)]), np.concatenate([n + len(n), n + 2 * len(n)])
        return x, np.stack(lines, axis=1)

    def given(self) -> Mapping[str, Any]:
        """Return the arguments by name, of the points a digest."""
        digest = hashlib.sha256(self.points.tobytes()).hexdigest()
        names = {"point": self._point, "crease": self.crease, "closed": self.closed}
        return {"points": digest, **names}

    def __repr__(self) -> str:
        return f"Polyline({len(self.points)} points{'' if self.closed else ', closed=False'})"

    def misfit(self, d: int, revolved: bool) -> str:
        """Say why it is no shape in d dimensions, or none of revolution; "" if it is one."""
        x, near = self.points, HALF_OF_DIGITS * np.abs(self.points).max()
        if d == 2 and revolved and x[:, 0].min() <= near:
            image = cKDTree(x).query(x * [-1.0, 1.0])[0].max()
            if image > near or x[:, 0].max() <= near:
                return (
                    f"{self!r} is not symmetric about the axis r = 0, which it meets: give the "
                    "points of the whole section, on both sides of it"
                )
        return super().misfit(d, revolved)

    def distance(self, x: Floats) -> Distance:
        """Return the distances of points x (n, 2)."""
        near, t = self._nearest(x)
        p, chord, m = self._p[near], (self._q - self._p)[near], self._middles[near]
        offset = x - p - t[:, None] * chord - (4.0 * t * (1.0 - t))[:, None] * m
        slope = chord + 4.0 * (1.0 - 2.0 * t)[:, None] * m
        square = (slope**2).sum(axis=1)
        normal = np.column_stack([slope[:, 1], -slope[:, 0]]) / np.sqrt(square)[:, None]
        past = np.abs((offset * slope).sum(axis=1)) > HALF_OF_DIGITS * square
        at_corner = past & ((t == 0.0) | (t == 1.0))
        phi = (offset * normal).sum(axis=1)
        bend = -8.0 * (m * normal).sum(axis=1)
        curved = -bend / (square * (square - phi * bend))
        hessian = curved[:, None, None] * slope[:, :, None] * slope[:, None]
        found = Distance(phi, normal, hessian)
        if not at_corner.any():
            return found
        corner = of_centre(offset)
        outside = (offset * self._corner_normals(near, t)).sum(axis=1) >= 0.0
        return found.where(~at_corner, corner.where(outside, -corner))

    def _nearest(self, x: Floats) -> tuple[Longs, Floats]:
        """Return the nearest edge (n,) of points (n, 2), and t there (n,)."""
        half = np.linalg.norm(self._q - self._p, axis=1).max() / 2
        # a point of an edge is no farther from its middle than half of it and its bulge
        bulge = 2.0 * np.linalg.norm(self._middles, axis=1).max()
        reach = self._tree.query(x)[0] + 2.0 * (half + bulge)
        lists = self._tree.query_ball_point(x, reach * (1.0 + HALF_OF_DIGITS))
        counts = np.array([len(some) for some in lists], dtype=np.int64)
        point = np.repeat(np.arange(len(x)), counts)
        edge = np.fromiter(chain.from_iterable(lists), np.int64, counts.sum())
        t, square = self._on_edges(x[point], edge)
        order = np.lexsort((square, point))
        first = order[np.flatnonzero(np.diff(point[order], prepend=-1))]
        return edge[first], t[first]

    def _on_edges(self, x: Floats, edge: Longs) -> tuple[Floats, Floats]:
        """Return t of the nearest points on edges (k,) to points (k, 2), and squared distances.

        Newton's method in [0, 1], from the nearest point of the chord.
        """
        p, chord, m = self._p[edge], (self._q - self._p)[edge], self._middles[edge]
        t = np.clip(((x - p) * chord).sum(axis=1) / (chord**2).sum(axis=1), 0.0, 1.0)
        for _ in range(LIMIT):
            r = x - p - t[:, None] * chord - (4.0 * t * (1.0 - t))[:, None] * m
            slope = chord + 4.0 * (1.0 - 2.0 * t)[:, None] * m
            square = (slope**2).sum(axis=1)
            curved = square + 8.0 * (r * m).sum(axis=1)
            step = (r * slope).sum(axis=1) / np.where(curved > 0.0, curved, square)
            last, t = t, np.clip(t + step, 0.0, 1.0)
            if (np.abs(t - last) <= 4.0 * EPS).all():
                break
        r = x - p - t[:, None] * chord - (4.0 * t * (1.0 - t))[:, None] * m
        return t, (r**2).sum(axis=1)

    def _smooth_normals(self, lengths: Floats) -> tuple[Floats, Floats]:
        """Return unit normals at the starts and the ends of edges (m, 2).

        With weights 1 / length they are exact where the points are those of a circle.
        """
        n = self._normals
        before = np.roll(n, 1, axis=0)
        smooth = (n * before).sum(axis=1) >= np.cos(np.radians(self.crease)) - HALF_OF_DIGITS
        if not self.closed:
            smooth[0] = False
        weighted = n / lengths[:, None]
        _, mean = unit_vectors(weighted + np.roll(weighted, 1, axis=0))
        at_p = np.where(smooth[:, None], mean, n)
        at_q = np.where(np.roll(smooth, -1)[:, None], np.roll(mean, -1, axis=0), n)
        return at_p, at_q

    def _corner_normals(self, edge: Longs, t: Floats) -> Floats:
        """Return the sum of the normals (n, 2) of the edges that meet at t = 0 or 1 of edges."""
        m = len(self._p)
        other = edge + np.where(t == 0.0, -1, 1)
        known = self.closed | ((other >= 0) & (other < m))
        slopes = 4.0 * self._middles
        ends = []
        for number, at_start in ((edge, t == 0.0), (other % m, t != 0.0)):
            turn = np.where(at_start, 1.0, -1.0)[:, None] * slopes[number]
            slope = (self._q - self._p)[number] + turn
            _, unit = unit_vectors(slope)
            ends.append(np.column_stack([unit[:, 1], -unit[:, 0]]))
        return np.asarray(ends[0] + np.where(known[:, None], ends[1], 0.0))


def _check_points(given: Any, least: int) -> Floats:
    """Return finite points (n, 2).

    Raises:
        ValueError: for anything else, and fewer than the least number of them.
    """
    found = as_numbers(given.tolist() if isinstance(given, np.ndarray) else given)
    if found is None or found.ndim != 2 or found.shape[1] != 2 or len(found) < least:
        has = "no numbers" if found is None else f"the shape {found.shape}"
        raise ValueError(f"points have {has}: give (n, 2) coordinates of {least} points or more")
    bad = ~np.isfinite(found).all(axis=1)
    if bad.any():
        k = int(np.argmax(bad))
        raise ValueError(f"points[{k}] is {found[k].tolist()}, which is not finite")
    return np.asarray(found, dtype=np.float64)


def _crossed(p: Floats, q: Floats, closed: bool) -> Bools:
    """Return which edges (m,) cross one that is not next to them."""

    def side(a: Floats, b: Floats, c: Floats) -> Floats:
        u, v = b - a, c - a
        return np.asarray(u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0])

    m = len(p)
    result = np.zeros(m, dtype=bool)
    number = np.arange(m)
    for k in range(m):
        between = side(p[k], q[k], p) * side(p[k], q[k], q) < 0.0
        between &= side(p, q, p[k]) * side(p, q, q[k]) < 0.0
        apart = np.abs(number - k)
        next_to = (apart <= 1) | (closed & (apart == m - 1))
        result[k] = (between & ~next_to).any()
    return result


def _refuse(x: Floats, wrong: Bools, what: str) -> None:
    """Raise a ValueError with number and place if some edges (m,) are wrong."""
    if wrong.any():
        place = ", ".join(f"{c:.4g}" for c in x[int(np.argmax(wrong))])
        raise ValueError(
            f"points have {int(wrong.sum())} {what} among {len(x)}, the first one at ({place}): "
            "leave them out, or put them in the order of the outline"
        )

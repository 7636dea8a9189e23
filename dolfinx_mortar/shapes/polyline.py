# SPDX-License-Identifier: MIT
"""Tools in the plane by points of their outline.

Edges are cubics of `curved` with unit tangents t_p and t_q, a = |c| t_p - c and b = |c| t_q - c. A
tangent is the mean of the two closest of five: edges before and after the point, and circles
through it and both neighbours, or the next two on one side. Lines are exact, distances from arcs of
order 4. Corners beyond ``crease`` are sharp, with edges as arcs.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy

from dolfinx_mortar.common.arguments import FLAG, array, check
from dolfinx_mortar.common.arrays import HALF_OF_DIGITS, Bools, Floats, Longs
from dolfinx_mortar.shapes.curved import Curved
from dolfinx_mortar.shapes.shape import CREASE, refuse, unit_vectors

REMEDY = "leave them out, or put them in the order of the outline"


class Polyline(Curved):
    """Region on the left of a line through points, such as the inside of a polygon; in the plane.

    In axisymmetric problems points are (r, z), on both sides of the axis if the tool meets it.

    Args:
        points: (n, 2), with the tool on the left: counterclockwise.
        point: 2 coordinates of the tool's reference point; default the middle of the points' box.
        crease: angle of normals in degrees, 0 to 90, above which a corner is sharp. With 0 all
            edges are straight.
        closed: whether the last point is joined to the first one. If not, phi beyond an end is the
            distance from it, where the body must not be.

    Raises:
        ValueError: also for coinciding points, edges that go back or cross others, and clockwise
            polygons.
    """

    def __init__(
        self, points: Any, point: Any = None, *, crease: float = 30.0, closed: bool = True
    ) -> None:
        self.crease, self.closed = check("crease", crease, CREASE), check("closed", closed, FLAG)
        least = 3 if closed else 2
        wanted = f"give finite coordinates (n, 2) of {least} points or more"
        rule = array((None, 2), holds=lambda x: len(x) >= least, remedy=wanted)
        self.points = x = check("points", points, rule)
        self.point = (x.min(axis=0) + x.max(axis=0)) / 2
        if point is not None:
            self.point = check("point", point, array((2,)))
        p, q = (x if closed else x[:-1]), np.roll(x, -1, axis=0)[: len(x) - (not closed)]
        lengths, along = unit_vectors(q - p)
        before, joined = np.roll(along, 1, axis=0), closed | (np.arange(len(p)) > 0)
        beside = before[:, 0] * along[:, 1] - before[:, 1] * along[:, 0]
        cosine = np.where(joined, (before * along).sum(axis=1), -np.inf)
        back = joined & (np.abs(beside) <= HALF_OF_DIGITS) & (cosine < 0.0)
        for what, wrong in (
            ("points that coincide", lengths <= HALF_OF_DIGITS * np.ptp(x, axis=0).max()),
            ("edges that go back along the one before", back),
            ("edges that cross others", _crossed(p, q)),
        ):
            refuse("points have", p, wrong, what, REMEDY)
        if closed and (x[:, 0] * q[:, 1] - x[:, 1] * q[:, 0]).sum() < 0.0:
            raise ValueError(
                "points go clockwise around the tool: reverse them, points[::-1], or for a body in "
                "a cavity give the Complement of that"
            )
        smooth = cosine >= np.cos(np.radians(self.crease)) - HALF_OF_DIGITS
        start, end = _tangents(lengths, along, smooth & (self.crease > 0.0))
        bends = np.stack([lengths[:, None] * t - (q - p) for t in (start, end)], axis=1)
        ends = np.stack([start[:, ::-1], end[:, ::-1]], axis=1) * [1.0, -1.0]
        around = ends.copy()
        around[joined, 0] += np.roll(ends[:, 1], 1, axis=0)[joined]
        around[np.roll(joined, -1), 1] += np.roll(ends[:, 0], -1, axis=0)[np.roll(joined, -1)]
        self._bend(np.stack([p, q], axis=1), bends[:, None], ends[:, :1], around)

    @property
    def surface(self) -> tuple[Floats, Longs]:
        """Points (n, 2), and lines (m, 2) between them."""
        first = np.arange(len(self._corners))
        return self.points, np.stack([first, (first + 1) % len(self.points)], axis=1)

    def __repr__(self) -> str:
        return f"Polyline({len(self.points)} points{'' if self.closed else ', closed=False'})"

    def misfit(self, d: int, revolved: bool) -> str:
        """See `Shape`."""
        x, near = self.points, HALF_OF_DIGITS * np.abs(self.points).max()
        if d == 2 and revolved and x[:, 0].min() <= near:
            image = scipy.spatial.cKDTree(x).query(x * [-1.0, 1.0])[0].max()
            if image > near or x[:, 0].max() <= near:
                return (
                    f"{self!r} is not symmetric about the axis r = 0, which it meets: give the "
                    "points of the whole section, on both sides of it"
                )
        return super().misfit(d, revolved)


def _tangents(lengths: Floats, along: Floats, smooth: Bools) -> tuple[Floats, Floats]:
    """Unit tangents (m, 2) at both ends of edges, which are ``smooth`` (m,) at their start."""
    weighted, before = along / lengths[:, None], np.roll(along, 1, axis=0)
    _, middle = unit_vectors(weighted + np.roll(weighted, 1, axis=0))
    last = np.roll(lengths, 1)
    found, spans = [middle, before, along], [last + lengths, last, lengths]
    for ways, way in ((before, -1), (along, 1)):
        of_circle = np.roll(_mirrored(middle, ways), way, axis=0)
        found.append(np.where(np.roll(smooth, way)[:, None], of_circle, np.inf))
        spans.append(np.roll(spans[0], way))
    start = _agreeing(np.array(found), np.array(spans))
    end, at_start, at_end = (
        np.roll(start, -1, axis=0),
        smooth[:, None],
        np.roll(smooth, -1)[:, None],
    )
    sharp_start = np.where(at_end, _mirrored(end, along), along)
    sharp_end = np.where(at_start, _mirrored(start, along), along)
    return np.where(at_start, start, sharp_start), np.where(at_end, end, sharp_end)


def _mirrored(tangent: Floats, along: Floats) -> Floats:
    """Tangent (n, 2) of a circle at the other end of a chord."""
    return 2.0 * (tangent * along).sum(axis=1)[:, None] * along - tangent


def _agreeing(directions: Floats, spans: Floats) -> Floats:
    """Mean (n, 2) of the two closest of k unit vectors (k, n, 2), short ``spans`` first."""
    one, other = np.triu_indices(len(directions), 1)
    with np.errstate(invalid="ignore"):
        apart = ((directions[one] - directions[other]) ** 2).sum(axis=2)
    apart = np.maximum(np.nan_to_num(apart, nan=np.inf, posinf=np.inf), HALF_OF_DIGITS**2)
    best = (apart * np.minimum(spans[one], spans[other]) ** 2).argmin(axis=0)
    n = np.arange(len(best))
    return unit_vectors(directions[one[best], n] + directions[other[best], n])[1]


def _crossed(p: Floats, q: Floats) -> Bools:
    """Mask (m,) of edges that cross another one."""

    def side(a: Floats, b: Floats, c: Floats) -> Floats:
        u, v = b - a, c - a
        return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]

    result = np.zeros(len(p), dtype=bool)
    for k in range(len(p)):  # exactly 0 at the common point of two neighbours
        between = side(p[k], q[k], p) * side(p[k], q[k], q) < 0.0
        result[k] = (between & (side(p, q, p[k]) * side(p, q, q[k]) < 0.0)).any()
    return result

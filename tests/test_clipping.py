# SPDX-License-Identifier: MIT
"""Clipping of convex polygons against exact rational arithmetic (Sutherland and Hodgman)."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from dolfinx_mortar.geometry import plane
from dolfinx_mortar.geometry.area import _append_fan, _subtract, areas

pytestmark = pytest.mark.serial
COORDINATES = st.integers(-16, 16).map(lambda i: Fraction(i, 16))  # floats hold them exactly


def cross(o, a, b):
    return (a[0] - o[0]) * (b[1] - o[1]) - (a[1] - o[1]) * (b[0] - o[0])


def area(polygon):
    turned = polygon[1:] + polygon[:1]
    return sum(a[0] * b[1] - a[1] * b[0] for a, b in zip(polygon, turned, strict=True)) / 2


def clipped(polygon, clip):
    for a, b in zip(clip, clip[1:] + clip[:1], strict=True):
        sides = [cross(a, b, x) for x in polygon]
        found = []
        for i, (x, side) in enumerate(zip(polygon, sides, strict=True)):
            before, last = polygon[i - 1], sides[i - 1]
            if last * side < 0:
                t = last / (last - side)
                found.append(tuple(p + t * (q - p) for p, q in zip(before, x, strict=True)))
            if side >= 0:
                found.append(x)
        polygon = found
    return polygon


@st.composite
def convex(draw):
    """Return a triangle or a strictly convex quadrilateral, anticlockwise."""
    count = draw(st.sampled_from([3, 4]))
    points = draw(st.lists(st.tuples(COORDINATES, COORDINATES), min_size=count, max_size=count))
    if area(points) < 0:
        points.reverse()
    corners = [cross(points[i - 2], points[i - 1], points[i]) for i in range(count)]
    assume(min(corners) > 0)
    return points


def compiled(polygon):
    """Return a polygon as the kernels take it."""
    P = np.zeros((plane.VERTICES, 2))
    P[: len(polygon)] = np.array(polygon, dtype=float)
    return P, len(polygon)


@given(convex(), convex(), st.integers(0, 3), st.booleans())
def test_common_part_and_difference(P, Q, first, mirrored):
    """P in Q and the pieces of P without Q have the exact areas, whatever the numbering of Q."""
    exact, whole = float(area(clipped(P, Q))), float(area(P))
    Q = Q[first:] + Q[:first]
    Q = Q[::-1] if mirrored else Q
    (p, n), (q, m) = compiled(P), compiled(Q)
    sign = plane.orientation(q, m)
    assert sign == (-1 if mirrored else 1)
    common, spare = np.empty((2, plane.VERTICES, 2))
    size = plane.intersect(p, n, q, m, sign, common, spare)
    found = plane.measure(common, size)[0] if size else 0.0
    assert found == pytest.approx(exact, abs=1e-11)
    which, corners, t = _append_fan(p, n, np.empty(64, np.int64), np.empty((64, 3, 2)), 0, 0)
    _, rest, t = _subtract(q[:m], which, corners, 0, t, 0)
    rest = areas(rest[:t]).sum()
    assert rest == pytest.approx(whole - exact, abs=1e-11)
    if plane.is_beside(p, n, q, m, 1, 0.0) or plane.is_beside(q, m, p, n, sign, 0.0):
        assert exact == 0.0

# SPDX-License-Identifier: MIT
"""What every shape satisfies: unit normals, derivatives, and distances from feet on the surface."""

import numpy as np
import pytest

from dolfinx_mortar import shapes
from tests.cases.outlines import RECTANGLE, disc
from tests.cases.triangles import ball, box

TURNED = np.array([0.36, 0.48, 0.8])
ACROSS = np.array([0.8, -0.6, 0.0])


class Half(shapes.Shape):
    """A user's half space y > 0.1."""

    point = np.zeros(2)

    def given(self):
        return {}

    def distance(self, x):
        """Return distances, gradients and Hessians."""
        gradient = np.tile([0.0, -1.0], (len(x), 1))
        return shapes.Distance(0.1 - x[:, 1], gradient, np.zeros((len(x), 2, 2)))


CENTRE = np.array([0.1, 0.2, 0.3])
POINTS, FACES = ball(1, centre=CENTRE)
LOW = FACES[POINTS[FACES, 2].max(axis=1) < 1.0]
DENTED = disc(24) * (1.0 + 0.15 * np.cos(3.0 * np.arange(24)))[:, None]
EXACT = [
    shapes.Plane([0.1, 0.2], [0.6, 0.8]),
    shapes.Sphere([0.0, 0.3], 0.7),
    shapes.Cylinder([0.2, 0.3], 0.7),
    shapes.Torus([0.0, 0.3], 0.9, 0.4),
    shapes.Cone([0.0, -0.4], 65.0, [0.0, 1.0], 0.3),
    shapes.Wedge([0.1, -0.4], 30.0, [0.6, 0.8], 0.2),
    shapes.Complement(shapes.Cylinder([0.2, 0.3], 2.7)),
    shapes.Union(shapes.Cylinder([0.9, 0.3], 0.2), shapes.Plane([0.0, -1.0], [0.0, 1.0])),
    Half(),
    shapes.Plane([0.1, 0.2, 0.3], TURNED),
    shapes.Sphere([0.1, 0.3, 0.2], 0.7),
    shapes.Cylinder([0.2, 0.3, 0.1], 0.7, axis=TURNED),
    shapes.Torus([0.1, 0.3, 0.0], 0.9, 0.4, axis=TURNED),
    shapes.Cone([0.0, -0.4, 0.1], 65.0, TURNED, 0.3),
    shapes.Wedge([0.1, -0.4, 0.2], 30.0, TURNED, 0.2, edge=ACROSS),
    shapes.Complement(shapes.Sphere([0.2, 0.3, 0.0], 2.7)),
    shapes.berkovich([0.1, 0.0, 0.2], TURNED, turned=20.0),
    shapes.Polyline(RECTANGLE),
    shapes.Triangles(box(low=(-0.7, -0.6, -0.5), high=(0.9, 1.0, 1.1))),
]
CURVED = [
    shapes.Polyline(disc(9)),
    shapes.Polyline(disc(9, share=0.6), closed=False),
    shapes.Polyline(DENTED, crease=50.0),
    shapes.Triangles((POINTS, FACES)),
    shapes.Triangles((POINTS, LOW), rim=True),
]


def near(d, n=400):
    """Return points around the origin."""
    return np.random.default_rng(1).uniform(-1.5, 1.5, (n, d))


@pytest.mark.parametrize("shape", EXACT + CURVED, ids=repr)
def test_derivatives_and_unit_normals(shape):
    """Gradient and Hessian against central differences, where the nearest point stays in place."""
    d, h = len(shape.point), 1e-5
    x = near(d)
    found = shape.distance(x)
    assert np.linalg.norm(found.gradient, axis=1) == pytest.approx(np.ones(len(x)), abs=1e-12)
    ends = [(shape.distance(x + way), shape.distance(x - way)) for way in h * np.eye(d)]
    slope = np.stack([(a.value - b.value) / (2 * h) for a, b in ends], axis=-1)
    bend = np.stack([(a.gradient - b.gradient) / (2 * h) for a, b in ends], axis=-1)
    turns = [np.abs(e.gradient - found.gradient).max(axis=1) for pair in ends for e in pair]
    same = np.max(turns, axis=0) < 1e-3
    size = 1.0 + np.abs(found.hessian).max(axis=(1, 2)) ** 3
    assert same.mean() > 0.9
    assert (np.abs(slope - found.gradient).max(axis=1) < 1e-8 * size)[same].all()
    bent = (np.abs(bend - found.hessian).max(axis=(1, 2)) < 1e-7 * size)[same]
    assert bent.all() if shape in EXACT else bent.mean() > 0.99


@pytest.mark.parametrize("shape", EXACT, ids=repr)
def test_it_is_the_distance(shape):
    """X - phi grad phi lies on the surface, and no other point of it is nearer."""
    x = near(len(shape.point))
    if isinstance(shape, shapes.Intersection):  # off its edges it is less than the distance
        x = x[shape.distance(x).value < -0.1]
    found = shape.distance(x)
    foot = x - found.value[:, None] * found.gradient
    assert shape.distance(foot).value == pytest.approx(np.zeros(len(x)), abs=1e-12)
    others = np.linalg.norm(x[:, None] - foot[None], axis=2).min(axis=1)
    assert (others >= np.abs(found.value) - 1e-12).all()


@pytest.mark.parametrize("shape", EXACT + CURVED, ids=repr)
def test_a_rank_without_points_has_no_distances(shape):
    d = len(shape.point)
    found = shape.distance(np.zeros((0, d)))
    assert found.value.shape == (0,) and found.hessian.shape == (0, d, d)

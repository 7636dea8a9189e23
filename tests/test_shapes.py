# SPDX-License-Identifier: MIT
"""Shapes of rigid tools: values in closed form, given distances, and what is no shape."""

import numpy as np
import pytest

import ufl
from basix.ufl import element
from dolfinx_mortar import shapes
from tests.cases.outlines import RECTANGLE
from tests.cases.pressed_blocks import rejected
from tests.cases.triangles import box


def test_a_ring_without_a_hole():
    """Its tube larger than its radius: outside phi is the distance from the whole surface."""
    shape, x = shapes.Torus([0.0, 0.0], 0.5, 0.8), np.random.default_rng(3).uniform(-2, 2, (300, 2))
    x[:, 0] = np.abs(x[:, 0])
    turn = np.linspace(0.0, 2 * np.pi, 20001)
    surface = 0.8 * np.column_stack([np.cos(turn), np.sin(turn)]) + [0.5, 0.0]
    surface = surface[surface[:, 0] >= 0.0]
    outside = shape.distance(x).value > 0.0
    exact = np.linalg.norm(x[outside, None] - surface[None], axis=2).min(axis=1)
    assert shape.distance(x[outside]).value == pytest.approx(exact, abs=2e-4)
    assert (np.linalg.norm(x[~outside] - [0.5, 0.0], axis=1) <= 0.8).all() and outside.any()


def test_values_in_closed_form():
    """The tip of a cone, the area of Berkovich's pyramid, and a point beside each."""
    cone = shapes.Cone([0.0, 0.0], 60.0, [0.0, 1.0], radius=0.5)
    x = np.array([[0.0, -1.0], [0.0, 0.25], [2.0, 0.5]])
    assert cone.distance(x[:1]).value == pytest.approx([1.0])
    # the flank touches the ball of the tip, whose centre is at height 0.5
    assert cone.distance(x[2:]).value == pytest.approx([2.0 * 0.5 - 0.5])
    assert cone.distance(x[1:2]).gradient == pytest.approx(np.array([[0.0, -1.0]]))
    pyramid = shapes.berkovich([0.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    width = np.linspace(-10.0, 10.0, 801)
    grid = np.stack(np.meshgrid(width, width), axis=-1).reshape(-1, 2)
    section = np.column_stack([grid, np.ones(len(grid))])
    area = (pyramid.distance(section).value < 0.0).sum() * (width[1] - width[0]) ** 2
    assert area == pytest.approx(3 * np.sqrt(3) * np.tan(np.radians(65.27)) ** 2, rel=5e-3)
    assert area == pytest.approx(24.5, rel=6e-3)  # Oliver and Pharr (1992)


@pytest.mark.parametrize("radius", [0.0, 0.3])
@pytest.mark.parametrize("d", [2, 3])
def test_normals_on_the_axis_of_a_tip(d, radius):
    """Within a cone or a wedge flanks are as near on all sides: their mean is along the axis."""
    tip, axis = np.arange(1.0, d + 1.0), np.eye(d)[-1]
    kinds = [shapes.Cone(tip, 35.0, axis, radius)]
    kinds += [shapes.Wedge(tip, 35.0, axis, radius)] if d == 2 else []
    for shape in kinds:
        x = tip + np.array([[1.0], [2.0]]) * axis
        assert (shape.distance(x).value < 0.0).all()
        assert shape.distance(x).gradient == pytest.approx(-np.tile(axis, (2, 1)), abs=1e-14)


@pytest.mark.parametrize("unit", [1.0, 1e-6])
def test_a_given_distance_by_differences(unit):
    """Of a ball, with differences of either order."""
    at, size = [0.0, 0.0, 0.0], {"length": 0.7 * unit}
    phi = lambda x: np.sqrt((x**2).sum(axis=0)) - 0.7 * unit  # noqa: E731
    x = unit * np.random.default_rng(2).uniform(0.2, 1.0, (20, 3))
    exact = shapes.Sphere(at, 0.7 * unit).distance(x)
    found = shapes.SignedDistance(phi, at, **size).distance(x)
    assert found.value == pytest.approx(exact.value, abs=1e-15 * unit)
    assert found.gradient == pytest.approx(exact.gradient, abs=1e-8)
    assert found.hessian == pytest.approx(exact.hessian, abs=1e-4 / unit)
    apart = exact.value > -0.1 * unit  # the step balances the errors of h^2 and eps / h^2
    assert apart.any()
    assert found.hessian[apart] == pytest.approx(exact.hessian[apart], abs=1e-6 / unit)
    gradient = lambda x: x / np.sqrt((x**2).sum(axis=0))  # noqa: E731
    found = shapes.SignedDistance(phi, at, gradient=gradient, **size).distance(x)
    assert found.hessian == pytest.approx(exact.hessian, abs=1e-7 / unit)


APART = shapes.Sphere([1.0, 2.0], 1.0), shapes.Sphere([4.0, 6.0], 3.9)
WRONG = [
    (lambda: shapes.Plane([0.0], [1.0, 0.0]), ("point is [0.0]", "2 or 3")),
    (lambda: shapes.Plane([0.0, 0.0], [0.0, 0.0]), ("normal", "no direction")),
    (lambda: shapes.Sphere([0.0, 0.0], -1.0), ("radius is -1.0", "> 0")),
    (lambda: shapes.Cylinder([0.0, 0.0, 0.0], 1.0), ("axis is None", "direction")),
    (lambda: shapes.Cone([0.0, 0.0], 90.0, [0.0, 1.0]), ("half_angle is 90.0", "> 0 and < 90")),
    (lambda: shapes.Wedge([0, 0, 0], 45.0, [0, 0, 1], edge=[0, 1, 1]), ("edge", "across")),
    (lambda: shapes.Union(3), ("Union: a shape is 3", "one or more")),
    (lambda: shapes.Union(APART[0], shapes.Sphere([0, 0, 0], 1.0)), ("[2, 3] coordinates",)),
    (
        lambda: shapes.berkovich([0, 0, 0], [0, 0, 1], True),
        ("turned is True", ">= -360 and <= 360"),
    ),
    (lambda: shapes.Intersection(*APART), ("Intersection(Sphere(", "is empty", "no point")),
    (lambda: shapes.SignedDistance(3, [0.0, 0.0], length=1.0), ("phi is 3", "function of points")),
    (lambda: shapes.SignedDistance(abs, [0.0, 0.0]), ("length is None", "gradient")),
]


PLANE_MESH, SPACE_MESH = (
    ufl.Mesh(element("Lagrange", cell, 1, shape=(d,)))
    for cell, d in (("triangle", 2), ("tetrahedron", 3))
)


def in_ufl(d):
    """Return the coordinates of a mesh in d dimensions."""
    return ufl.SpatialCoordinate({2: PLANE_MESH, 3: SPACE_MESH}[d])


def length(v):
    """Return the length of a vector in UFL."""
    return ufl.sqrt(ufl.dot(v, v))


def test_a_distance_in_ufl():
    """A ball in space, a level set over its slope, a disc: the shapes to round-off."""
    x, y = in_ufl(3), in_ufl(2)
    plane = 3.0 * (y[1] - 0.2)
    disc = length(y - ufl.as_vector([0.1, 0.2])) - 0.5
    for phi, shape in (
        (length(x) - 0.5, shapes.Sphere([0.0, 0.0, 0.0], 0.5)),
        (plane / length(ufl.grad(plane)), shapes.Plane([0.0, 0.2], [0.0, 1.0])),
        (disc, shapes.Cylinder([0.1, 0.2], 0.5)),
    ):
        at = np.random.default_rng(5).uniform(-1.0, 1.0, (30, len(shape.point)))
        found, exact = shapes.SignedDistance(phi, shape.point).distance(at), shape.distance(at)
        for name in ("value", "gradient", "hessian"):
            wanted = pytest.approx(getattr(exact, name), rel=1e-12, abs=1e-13)
            assert getattr(found, name) == wanted, name
    found, centre = shapes.SignedDistance(disc, [0.1, 0.2]), np.array([[0.1, 0.2]])
    with rejected("grad phi is NaN", "(0.1, 0.2)"):
        found.distance(centre)
    assert found.values(centre) == [-0.5]


def of_ufl(make, options):
    """Return a distance of the coordinates of a mesh in the plane."""
    return shapes.SignedDistance(make(in_ufl(2)), [0.0, 0.0], **options)


WRONG_IN_UFL = [
    (lambda x: x, {}, ("of shape (2,)", "scalar")),
    (lambda x: x[0] + ufl.Constant(PLANE_MESH), {}, ("phi contains c_", "position")),
    (lambda x: ufl.as_ufl(1.0), {}, ("no SpatialCoordinate",)),
    (lambda x: in_ufl(3)[0], {}, ("x of shape (3,)", "of 2 coordinates")),
    (lambda x: x[0], {"length": 1.0}, ("leave out",)),
]


@pytest.mark.parametrize(
    ("make", "words"),
    WRONG
    + [
        (lambda make=make, options=options: of_ufl(make, options), words)
        for make, options, words in WRONG_IN_UFL
    ],
)
def test_what_is_no_shape(make, words):
    with rejected(*words):
        make()


@pytest.mark.parametrize(
    ("phi", "words"),
    [
        (lambda x: x, ("phi(x) is [[0.0, 1.0", "shape (3,)")),
        (lambda x: np.where(x[1] > 0.5, np.nan, x[0]), ("phi is NaN or infinite at (1, 1)",)),
    ],
)
def test_what_a_given_distance_may_return(phi, words):
    shape = shapes.SignedDistance(phi, [0.0, 0.0], length=1.0)
    with rejected(*words):
        shape.distance(np.array([[0.0, 0.0], [1.0, 1.0], [2.0, 0.0]]))


PLANE, RING = (2, False), (2, True)
BOTH = shapes.Union(shapes.Plane([0.0, 1.0], [0.0, 1.0]), shapes.Sphere([0.1, 1.0], 1.0))
TIP, UP = [0.0, 1.0], [0.0, 1.0]


@pytest.mark.parametrize(
    ("shape", "problem", "words"),
    [
        (shapes.Cylinder(TIP, 1.0), RING, "Sphere"),
        (shapes.Cylinder(TIP, 1.0, axis=UP), RING, ""),
        (shapes.Cylinder(TIP, 1.0, axis=UP), PLANE, "across the plane"),
        (shapes.Sphere(TIP, 1.0), PLANE, "Cylinder"),
        (shapes.Cone(TIP, 70.0, UP), PLANE, "Wedge"),
        (shapes.Cone(TIP, 70.0, [1.0, 0.0]), RING, "about the axis"),
        (shapes.Wedge(TIP, 70.0, UP), RING, ""),  # a rim
        (shapes.Plane(TIP, [0.1, 1.0]), RING, "Cone"),
        (shapes.Plane(TIP, UP), (3, False), "mesh of 3"),
        (shapes.Torus([0.1, 1.0], 1.0, 0.5), RING, "about the axis"),
        (shapes.Torus([0.1, 1.0], 1.0, 0.5), PLANE, "plane figure"),
        (shapes.Complement(BOTH), RING, "Torus"),
        (shapes.Polyline(RECTANGLE), PLANE, ""),
        (shapes.Polyline(RECTANGLE), (3, False), "mesh of 3"),
        (shapes.Polyline(RECTANGLE[:3] + RECTANGLE[4:]), RING, ""),  # symmetric
        (shapes.Polyline(np.add(RECTANGLE, [2.0, 0.0])), RING, ""),
        *(
            (shapes.Polyline(np.add(RECTANGLE, [x, 0.0])), RING, "whole section")
            for x in (1.0, -2.0)
        ),
        (shapes.Triangles(box()), RING, "mesh of 2"),
    ],
)
def test_in_which_problems_a_shape_is_one(shape, problem, words):
    """Plane figures, solids, and shapes of revolution, each with what to give instead."""
    said = shape.misfit(*problem)
    assert words in said and bool(said) == bool(words)

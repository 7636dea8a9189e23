# SPDX-License-Identifier: MIT
"""Tools of points in the plane: distances, orders of convergence, contact, what is no outline."""

from mpi4py import MPI

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import dolfinx_mortar as dm
from dolfinx_mortar import shapes
from tests.cases.pressed_blocks import rejected
from tests.cases.tool import DEPTH, Block, R

COMM = MPI.COMM_WORLD
DISC = shapes.Cylinder([0.1, 0.2], 1.0)


def disc(n, radius=1.0, centre=(0.1, 0.2), share=1.0, uneven=0.3):
    """Return points of a circle, counterclockwise from the lowest one, at uneven distances."""
    t = np.arange(n) / n
    angle = 2.0 * np.pi * share * (t + uneven / (2.0 * np.pi) * np.sin(2.0 * np.pi * t)) - np.pi / 2
    return np.asarray(centre) + radius * np.column_stack([np.cos(angle), np.sin(angle)])


def around(n=1500):
    """Return points near the circle of DISC."""
    rng = np.random.default_rng(0)
    angle, r = rng.uniform(0.0, 2.0 * np.pi, n), rng.uniform(0.8, 1.4, n)
    return DISC.centre + r[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])


def test_a_disc_converges():
    """The distance with order 4, its gradient with 3, its Hessian with 2; straight edges 2 and 1.

    Normals at points at uneven distances are exact, so those on the circle are.
    """
    x = around()
    exact, errors = DISC.distance(x), []
    for n in (12, 24, 48):
        found = shapes.Polyline(disc(n), crease=60.0).distance(x)
        errors.append(
            [
                np.abs(found.value - exact.value).max(),
                np.abs(found.gradient - exact.gradient).max(),
                np.median(np.abs(found.hessian - exact.hessian).max(axis=(1, 2))),
            ]
        )
    orders = np.log2(np.array(errors)[:-1] / np.array(errors)[1:])
    assert (orders > [3.7, 2.7, 1.7]).all()
    over = DISC.centre + 1.1 * (disc(24) - DISC.centre)  # the points
    normals = shapes.Polyline(disc(24), crease=60.0).distance(over).gradient
    assert normals == pytest.approx(DISC.distance(over).gradient, abs=1e-12)
    flat = shapes.Polyline(disc(48), crease=0.0).distance(x)
    assert np.abs(flat.value - exact.value).max() > 1e2 * errors[-1][0]


def angle_iron(n, ends):
    """Return points of a line, a quarter of a unit circle about (1, 1) with n edges, and a line."""
    t = np.pi + np.pi / 2 * np.linspace(0.0, 1.0, n + 1)
    arc = 1.0 + np.column_stack([np.cos(t), np.sin(t)])
    return np.concatenate([[(0.0, y) for y in ends[::-1]], arc, [(x, 0.0) for x in ends]])


@pytest.mark.parametrize("ends", [(4.0,), (1.1, 1.3, 4.0)])
def test_lines_stay_straight_beside_arcs(ends):
    """A die's profile: lines to round-off, the arc with order 4, and normals without a jump."""
    y = np.linspace(1.0, 4.0, 41)
    t = np.pi + np.pi / 2 * np.linspace(0.0, 1.0, 101)
    out, errors = np.column_stack([np.cos(t), np.sin(t)]), []
    for n in (4, 8, 16):
        points = angle_iron(n, ends)
        shape = shapes.Polyline(points, closed=False)
        line = shape.distance(np.column_stack([0.0 * y - 0.1, y]))
        assert line.value == pytest.approx(0.0 * y + 0.1, abs=1e-14)
        assert line.gradient[:, 0] == pytest.approx(-np.ones(41), abs=1e-14)
        found = shape.distance(1.0 + out)
        errors.append([np.abs(found.value).max(), np.abs(found.gradient - out).max()])
        inner, step = points[1:-1], 1e-7 * np.array([1.0, -1.0])
        sides = [shape.distance(inner + way).gradient for way in (step, -step)]
        assert np.abs(sides[0] - sides[1]).max() < 1e-5
    assert (np.log2(np.array(errors)[:-1] / np.array(errors)[1:]) > [3.7, 2.7]).all()


@pytest.mark.parametrize("bend", [1.0, -1.0])
def test_a_line_between_arcs_is_straight(bend):
    """One edge between two quarter circles that bend to the same side, or to either side."""
    t, y = np.pi / 2 * np.linspace(0.0, 1.0, 6), np.linspace(2.0, 5.0, 41)
    first = np.column_stack([bend * (np.sin(t) - 1.0), 2.0 - np.cos(t)])
    second = np.column_stack([np.cos(t) - 1.0, 5.0 + np.sin(t)])
    shape = shapes.Polyline(np.concatenate([first, second]), closed=False)
    found = shape.distance(np.column_stack([0.0 * y, y]))
    assert np.abs(found.value).max() < 1e-14


def test_an_arc_ends_at_a_corner():
    """Half a disc: its last edge goes on as the arc, whose distances have order 4 up to there."""
    t, errors = np.pi * np.linspace(0.0, 1.0, 201), []
    for n in (8, 16, 32):
        angle = np.pi * np.linspace(0.0, 1.0, n + 1)
        shape = shapes.Polyline(np.column_stack([np.cos(angle), np.sin(angle)]))
        x = np.column_stack([np.cos(t), np.sin(t)])
        errors.append(np.abs(shape.distance(x).value).max())
    assert (np.log2(np.array(errors)[:-1] / np.array(errors)[1:]) > 3.7).all()


BOX = [(-1.0, -0.5), (1.0, -0.5), (1.0, 0.5), (0.2, 0.5), (-1.0, 0.5)]


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(*2 * [st.floats(-1.6, 1.6)]), min_size=1, max_size=20), st.booleans())
def test_a_box_is_a_box(points, reverse):
    """Sharp corners, by the closed form of the distance from a box; and its socket."""
    x, shape = np.array(points), shapes.Polyline(BOX)
    q = np.abs(x) - [1.0, 0.5]
    expected = np.linalg.norm(np.maximum(q, 0.0), axis=1) + np.minimum(q.max(axis=1), 0.0)
    found = (shapes.Complement(shape) if reverse else shape).distance(x)
    assert (-1.0 if reverse else 1.0) * found.value == pytest.approx(expected, abs=1e-12)
    assert np.linalg.norm(found.gradient, axis=1) == pytest.approx(np.ones(len(x)))


@pytest.mark.parametrize("kind", ["disc", "open", "box", "dent"])
def test_derivatives(kind):
    """Gradient and Hessian against central differences, where the nearest point stays in place."""
    points = {"disc": disc(9), "open": disc(9, share=0.6), "box": np.array(BOX)}.get(kind)
    if kind == "dent":
        points = disc(24) * (1.0 + 0.15 * np.cos(3.0 * np.arange(24)))[:, None]
    shape = shapes.Polyline(points, crease=50.0, closed=kind != "open")
    x, h = around(400), 1e-5
    found = shape.distance(x)
    ends = [(shape.distance(x + way), shape.distance(x - way)) for way in h * np.eye(2)]
    slope = np.stack([(a.value - b.value) / (2 * h) for a, b in ends], axis=-1)
    bend = np.stack([(a.gradient - b.gradient) / (2 * h) for a, b in ends], axis=-1)
    same = np.ones(len(x), dtype=bool)
    for end in (end for pair in ends for end in pair):
        same &= np.abs(end.gradient - found.gradient).max(axis=1) < 1e-3
    size = 1.0 + np.abs(found.hessian).max(axis=(1, 2)) ** 3
    assert same.mean() > 0.95
    assert (np.abs(slope - found.gradient).max(axis=1) < 1e-8 * size)[same].all()
    assert (np.abs(bend - found.hessian).max(axis=(1, 2)) < 1e-7 * size)[same].mean() > 0.99


def test_a_reentrant_corner():
    """What is nearest to it from within is inside: an L, and the corner at (1, 1)."""
    L = [(0.0, 0.0), (3.0, 0.0), (3.0, 1.0), (1.0, 1.0), (1.0, 3.0), (0.0, 3.0)]
    found = shapes.Polyline(L).distance(np.array([[0.7, 0.6], [1.2, 1.5]]))
    assert found.value == pytest.approx([-0.5, 0.2])
    assert found.gradient == pytest.approx(np.array([[0.6, 0.8], [1.0, 0.0]]))


def test_no_points():
    """As of a rank without a facet of the side."""
    found = shapes.Polyline(BOX).distance(np.zeros((0, 2)))
    assert found.value.shape == (0,) and found.hessian.shape == (0, 2, 2)


def press(shape, **options):
    """Press it into a block; return force and report."""
    case = Block(n=24)
    tool = case.tool(shape)
    problem = case.problem([tool], **options)
    tool.position.value[1] -= 3 * DEPTH
    report = dm.newton(problem, rtol=1e-10)
    return -tool.force[1], report


@pytest.mark.mpi
def test_a_flat_one_is_a_plane():
    """Uniform pressure under a box without Poisson's ratio, to round-off."""
    case = Block(n=6, size=1.0, fine=0.8)
    tool = case.tool(
        shapes.Polyline([(3.0, 1.0), (-1.0, 1.0), (-1.0, 0.0), (0.3, 0.0), (3.0, 0.0)])
    )
    problem = case.problem([tool], law=dm.Elastic(100.0, 0.0))
    tool.position.value[1] -= 0.02
    dm.newton(problem, rtol=1e-10)
    found = tool.gather(case.u)
    assert found["pressure"] == pytest.approx(100.0 * 0.02, rel=1e-9)


@pytest.mark.serial
@pytest.mark.parametrize("kinematics", ["plane_strain", "axisymmetric"])
def test_forces_converge_to_those_of_a_round_one(kinematics):
    """With order 4 in the length of the edges, as many iterations."""
    round_one = shapes.Cylinder if kinematics == "plane_strain" else shapes.Sphere
    exact, report = press(round_one([0.0, R], R), kinematics=kinematics)
    errors = []
    for n in (40, 80):
        shape = shapes.Polyline(disc(n, R, (0.0, R), uneven=0.0))
        force, found = press(shape, kinematics=kinematics)
        errors.append(abs(force / exact - 1.0))
        assert found.newton_iterations <= report.newton_iterations + 1
    assert errors[1] < 1e-6 or errors[1] < errors[0] / 8.0
    assert errors[1] < 1e-4


CROSSED = [(0.0, 0.0), (1.0, 1.0), (1.0, 0.0), (0.0, 1.0)]
WRONG = [
    (BOX[::-1], {}, ("clockwise", "points[::-1]", "Complement")),
    (CROSSED, {}, ("2 edges that cross", "(0, 0)", "order of the outline")),
    ([*BOX, BOX[-1]], {}, ("1 points that coincide", "(-1, 0.5)")),
    (BOX[:2], {}, ("points is [(-1.0", "3 points or more")),
    ([(0, 0), (1, 1), (2, 2)], {}, ("edges that go back along", "(2, 2)")),
    ([(0, 0), (2, 0), (2, 2), (2, 1), (1, 1)], {}, ("1 edges that go back along", "(2, 2)")),
    ([(0, 0), (2, 0), (1, 0)], {"closed": False}, ("1 edges that go back along", "(2, 0)")),
    (BOX, {"closed": "no"}, ("closed is 'no'", "True or False")),
    ([[0.0, 1.0, 2.0]] * 4, {}, ("shape (4, 3)",)),
    ("outline", {}, ("points is 'outline'",)),
    ([*BOX, (np.nan, 0.0)], {}, ("nan at [5, 0]", "finite coordinates")),
    (BOX, {"crease": -1.0}, ("crease is -1.0", ">= 0 and <= 90")),
    (BOX, {"point": [0.0]}, ("point is [0.0]", "2 finite")),
]


@pytest.mark.parametrize(("points", "options", "words"), WRONG)
def test_what_is_no_outline(points, options, words):
    with rejected(*words):
        shapes.Polyline(points, **options)


def test_where_it_fits():
    """In the plane; about an axis beside it, or symmetric about it."""
    shape, beside = shapes.Polyline(BOX[:3] + BOX[4:]), np.add(BOX, [2.0, 0.0])
    assert not shape.misfit(2, False) and "mesh of 3" in shape.misfit(3, False)
    assert not shape.misfit(2, True) and not shapes.Polyline(beside).misfit(2, True)
    for wrong in (BOX, beside - [1.0, 0.0], beside - [2.5, 0.0], beside - [4.0, 0.0]):
        assert "whole section" in shapes.Polyline(wrong).misfit(2, True)

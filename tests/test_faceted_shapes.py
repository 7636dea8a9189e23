# SPDX-License-Identifier: MIT
"""Tools of points: orders of convergence, boxes, files, contact, and what is no surface."""

from mpi4py import MPI

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dolfinx_mortar import shapes
from tests.cases.outlines import RECTANGLE, disc
from tests.cases.pressed_blocks import rejected
from tests.cases.triangles import ball, box, write_binary, write_text
from tests.tool_case import DEPTH, Block, Box, R

COMM = MPI.COMM_WORLD


def orders(errors):
    """Return the orders of errors (levels, kinds) of halved sizes."""
    return np.log2(np.array(errors)[:-1] / np.array(errors)[1:])


def polygon(n, crease=60.0):
    return shapes.Polyline(disc(12 * 2**n), crease=crease)


def icosahedron(n, crease=45.0):
    return shapes.Triangles(ball(n + 2, centre=(0.1, 0.2, 0.3)), crease=crease)


@pytest.mark.parametrize(
    ("create", "round_one"),
    [
        (polygon, shapes.Cylinder([0.1, 0.2], 1.0)),
        (icosahedron, shapes.Sphere([0.1, 0.2, 0.3], 1.0)),
    ],
)
def test_round_shapes_converge(create, round_one):
    """The distance with order 4, its gradient with 3, its Hessian with 2; without edges bent 2."""
    rng = np.random.default_rng(0)
    x = rng.standard_normal((1500, len(round_one.point)))
    x *= (rng.uniform(0.8, 1.4, len(x)) / np.linalg.norm(x, axis=1))[:, None]
    x += round_one.centre
    exact, errors = round_one.distance(x), []
    for n in range(3):
        found = create(n).distance(x)
        bent = np.abs(found.hessian - exact.hessian).max(axis=(1, 2))
        sizes = [np.abs(getattr(found, k) - getattr(exact, k)).max() for k in ("value", "gradient")]
        errors.append([*sizes, np.median(bent)])  # at edges two curvatures meet
    assert (orders(errors) > [3.7, 2.6, 1.7]).all()
    flat = create(2, crease=0.0).distance(x)
    assert np.abs(flat.value - exact.value).max() > 1e2 * errors[-1][0]


def test_lines_stay_straight_beside_arcs():
    """A die's profile: lines to round-off, the arc with order 4, and normals without a jump."""
    y, errors, ends = np.linspace(1.0, 4.0, 41), [], (1.1, 1.3, 4.0)
    quarter = lambda n: np.pi + np.pi / 2 * np.linspace(0.0, 1.0, n)  # noqa: E731
    circle = lambda n: np.column_stack([np.cos(quarter(n)), np.sin(quarter(n))])  # noqa: E731
    for n in (4, 8, 16):
        points = np.concatenate(
            [[(0.0, y) for y in ends[::-1]], 1.0 + circle(n + 1), [(x, 0.0) for x in ends]]
        )
        shape = shapes.Polyline(points, closed=False)
        line = shape.distance(np.column_stack([0.0 * y - 0.1, y]))
        assert line.value == pytest.approx(0.0 * y + 0.1, abs=1e-14)
        assert line.gradient[:, 0] == pytest.approx(-np.ones(41), abs=1e-14)
        found = shape.distance(1.0 + circle(101))
        errors.append([np.abs(found.value).max(), np.abs(found.gradient - circle(101)).max()])
        sides = [shape.distance(np.add(points[1:-1], [w, -w])).gradient for w in (1e-7, -1e-7)]
        assert np.abs(sides[0] - sides[1]).max() < 1e-5
    assert (orders(errors) > [3.7, 2.7]).all()


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(*3 * [st.floats(-1.6, 1.6)]), min_size=1, max_size=20), st.booleans())
def test_a_box_is_a_box(points, reverse):
    """Sharp edges and corners, by the closed form of the distance from a box; and its socket."""
    for d in (2, 3):
        x, half = np.array(points)[:, :d], np.array([1.0, 0.5, 1.0])[:d]
        faces = box(low=(-1.0, -0.5, -1.0), high=(1.0, 0.5, 1.0))
        shape = shapes.Polyline(RECTANGLE) if d == 2 else shapes.Triangles(faces)
        q = np.abs(x) - half
        expected = np.linalg.norm(np.maximum(q, 0.0), axis=1) + np.minimum(q.max(axis=1), 0.0)
        found = (shapes.Complement(shape) if reverse else shape).distance(x)
        assert (-1.0 if reverse else 1.0) * found.value == pytest.approx(expected, abs=1e-12)
        assert np.linalg.norm(found.gradient, axis=1) == pytest.approx(np.ones(len(x)))


def test_a_reentrant_corner():
    """What is nearest to it from within is inside: an L, and the corner at (1, 1)."""
    L = [(0.0, 0.0), (3.0, 0.0), (3.0, 1.0), (1.0, 1.0), (1.0, 3.0), (0.0, 3.0)]
    found = shapes.Polyline(L).distance(np.array([[0.7, 0.6], [1.2, 1.5]]))
    assert found.value == pytest.approx([-0.5, 0.2])
    assert found.gradient == pytest.approx(np.array([[0.6, 0.8], [1.0, 0.0]]))


def test_files(tmp_path):
    """Binary and text, the corners of which are single numbers, and arrays; corners are merged."""
    points, triangles = ball(2)
    x, read = np.random.default_rng(0).uniform(-1.5, 1.5, (50, 3)), []
    exact = shapes.Triangles((points, triangles)).distance(x).value
    for write, path in (write_binary, tmp_path / "ball.stl"), (write_text, tmp_path / "ball.txt"):
        write(path, points, triangles)
        shape = shapes.Triangles(path)
        assert len(shape.surface[0]) == len(points)
        assert shape.distance(x).value == pytest.approx(exact, abs=1e-6)
        assert repr(shape).startswith("Triangles('") and "320 triangles" in repr(shape)
        read.append(shape.given()["surface"])
    assert read[0] == read[1]
    assert shape.point == pytest.approx(np.zeros(3), abs=1e-6)
    assert shapes.Triangles(path, [0.0, 0.0, -1.0]).point.tolist() == [0.0, 0.0, -1.0]


# -- contact


def press(shape, **options):
    """Press a shape into a block or a skew box; return tool and report."""
    if len(shape.point) == 2:
        tool, _, report = Block(n=24).press(shape, 3 * DEPTH, **options)
        return tool, report
    skew = lambda x: x + [0.1, 0.0, 0.0] * x[:, 1:2]  # noqa: E731
    case = Box("hexahedron", (6, 6, 2), (-1.0, -1.0, -1.0), (1.0, 1.0, 0.0), move=skew)
    tool, _, report = case.press(shape, 0.1)
    return tool, report


CENTRE = (0.1, 0.2, 2.0)


@pytest.mark.serial
@pytest.mark.parametrize(
    ("kinematics", "round_one"),
    [
        ("plane_strain", shapes.Cylinder([0.0, R], R)),
        ("axisymmetric", shapes.Sphere([0.0, R], R)),
        (None, shapes.Sphere(CENTRE, 2.0)),
    ],
)
def test_forces_converge_to_those_of_a_round_one(kinematics, round_one):
    """With order 4 in the size of facets and as many iterations; of flat ones they are far off."""
    options, errors = {"kinematics": kinematics} if kinematics else {}, []
    exact, report = press(round_one, **options)
    for n, crease in ((0, 45.0), (1, 45.0), (1, 0.0)):
        if kinematics:
            points = disc((40, 80)[n], R, (0.0, R), uneven=0.0)
            shape = shapes.Polyline(points, crease=crease)
        else:
            shape = shapes.Triangles(ball((1, 3)[n], 2.0, CENTRE), crease=crease)
        tool, found = press(shape, **options)
        errors.append(np.linalg.norm(tool.force - exact.force) / np.linalg.norm(exact.force))
        assert not crease or found.newton_iterations <= report.newton_iterations + 1
    coarse, fine, flat = errors
    assert fine < 1e-6 or fine < coarse / (8.0 if kinematics else 2.0**7)
    assert fine < 1e-4 and flat > 1e1 * fine


# -- bad input


def turned():
    points, triangles = ball(2)
    triangles[[3, 50, 51]] = triangles[[3, 50, 51], ::-1]
    return points, triangles


POINTS, FACES = box()
CROSSED = [(0.0, 0.0), (1.0, 1.0), (1.0, 0.0), (0.0, 1.0)]
THIN = np.vstack([POINTS, POINTS[:1]]), np.vstack([FACES, [0, 1, 8]])
FIN = np.vstack([POINTS, [[5.0, 5.0, 5.0]]]), np.vstack([FACES, [*FACES[0, :2], 8]])
WRONG = [
    ((POINTS, FACES[2:]), {}, ("4 triangles at a hole among 10", "around (", "rim=True")),
    (turned(), {}, ("3 triangles that are turned", "around (", "counterclockwise")),
    (THIN, {}, ("1 triangles without area", "(-1, -1, 0.3333)")),
    (FIN, {}, ("three or more", "3 triangles with")),
    ((POINTS, FACES[:, ::-1]), {}, ("inside out", "Complement")),
    (3, {}, ("surface is 3", "path of an STL")),
    ((POINTS * np.nan, FACES), {}, ("points", "nan at [0, 0]")),
    (box(), {"rim": "x"}, ("rim is 'x'", "True or False")),
    (box(), {"crease": 120.0}, ("crease is 120.0", ">= 0 and <= 90")),
]
WRONG_OUTLINES = [
    (RECTANGLE[::-1], {}, ("clockwise", "points[::-1]", "Complement")),
    (CROSSED, {}, ("2 edges that cross", "(0, 0)", "order of the outline")),
    ([*RECTANGLE, RECTANGLE[-1]], {}, ("1 points that coincide", "(-1, 0.5)")),
    (RECTANGLE[:2], {}, ("points is [(-1.0", "3 points or more")),
    ([(0, 0), (2, 0), (1, 0)], {"closed": False}, ("1 edges that go back along", "(2, 0)")),
    (RECTANGLE, {"closed": "no"}, ("closed is 'no'", "True or False")),
    ([[0.0, 1.0, 2.0]] * 4, {}, ("shape (4, 3)",)),
    ([*RECTANGLE, (np.nan, 0.0)], {}, ("nan at [5, 0]", "finite coordinates")),
]


@pytest.mark.parametrize(
    ("kind", "surface", "options", "words"),
    [
        *((shapes.Triangles, *case) for case in WRONG),
        *((shapes.Polyline, *case) for case in WRONG_OUTLINES),
    ],
)
def test_what_is_no_surface(kind, surface, options, words):
    with rejected(*words):
        kind(surface, **options)


CORNERS = "vertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\n"


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, ("cannot be read",)),
        (b"\0" * 90, ("no STL file", "90 bytes")),
        (f"solid\n{CORNERS}{CORNERS[:-2]}0.0\n".encode(), ("ends after 2 triangles", "cut off")),
        (
            f"solid\n{CORNERS}{CORNERS[:-2]}nan\nendsolid\n".encode(),
            ("1 of 2 triangles", "not finite, first number 2"),
        ),
    ],
)
def test_what_is_no_file(tmp_path, content, words):
    path = tmp_path / "tool.stl"
    if content is not None:
        path.write_bytes(content)
    with rejected("tool.stl", *words):
        shapes.Triangles(path, rim=True).distance(np.zeros((1, 3)))


@pytest.mark.mpi
def test_a_file_that_ranks_lack(folder):
    """No rank leaves the others when it reads; all raise when a problem is made."""
    file = folder / "box.stl"
    if COMM.rank == 0:
        write_binary(file, *box())
    COMM.barrier()
    if COMM.rank == COMM.size - 1:
        file = file.with_name("none.stl")
    words = ["which cannot be read"]
    if COMM.size > 1:
        words = ["shape.surface differs between the ranks", "not read, ", "give all ranks"]
    with rejected(*words):
        Box().press(shapes.Triangles(file, [0.0, 0.0, 0.0]))

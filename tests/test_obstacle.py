# SPDX-License-Identifier: MIT
"""Contact with a rigid analytic tool: patches, Hertz, a meshed body, curved sides, bad input."""

import re
from dataclasses import replace

from mpi4py import MPI

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import dolfinx_mortar as dm
from dolfinx_mortar.interfaces import obstacle
from tests.cases.pressed_blocks import rejected
from tests.cases.solid import rollers
from tests.cases.triangles import box
from tests.tool_case import BALL, BASE, DEPTH, DISC, NU, TOP, Block, Box, E, R

COMM = MPI.COMM_WORLD
pytestmark = pytest.mark.mpi
BAR = dm.Elastic(1000.0, 0.0)


def said(notes, words):
    """Tell whether a note has these words."""
    return any(words in note for note in notes)


TURNED = Rotation.from_rotvec([0.7, -0.4, 1.1]).as_matrix()
FLAT = dm.shapes.Polyline([(3.0, 3.0), (-1.0, 3.0), (-1.0, 1.0), (0.3, 1.0), (3.0, 1.0)])
FILE = dm.shapes.Triangles(box(low=(-1.7, -1.3, 1.0), high=(1.9, 1.6, 1.5)))
ABOVE = dm.shapes.Plane(TURNED[:, 2], -TURNED[:, 2])


@pytest.mark.parametrize(
    ("cell", "degree", "shape"),
    [
        ("triangle", 1, FLAT),
        ("tetrahedron", 1, FILE),
        ("tetrahedron", 1, ABOVE),
        ("hexahedron", 1, ABOVE),
        *(pytest.param(c, 2, ABOVE, marks=pytest.mark.slow) for c in ("tetrahedron", "hexahedron")),
    ],
)
def test_uniform_pressure_on_a_box(cell, degree, shape):
    """Uneven facets of all types, six-node triangles with their dependent nodes as well."""
    turned = TURNED if shape is ABOVE else np.eye(len(shape.point))

    def move(x):
        x[:, 0] = x[:, 0] ** 1.3 + 0.1 * x[:, 0] * x[:, 1] * (1.0 - x[:, 0])
        return x @ turned.T

    case = Box(cell, (3, 2, 1)[: len(turned)], degree=degree, move=move)
    tool = case.tool(shape)
    problem = case.problem([tool], law=BAR)
    tool.position.value[:] -= 0.01 * turned[:, -1]
    report = dm.newton(problem, rtol=1e-10)
    assert tool.gather(case.u)["pressure"] == pytest.approx(10.0, rel=1e-8)
    force = 10.0 * turned[:, -1]
    assert tool.tool_force == pytest.approx(force, abs=1e-7)
    assert tool.force == pytest.approx(-force, abs=1e-7)
    arm = turned @ [*np.full(len(force) - 1, 0.5), 1.0] - tool.position.value  # of the resultant
    moment = np.cross(*(np.pad(v, (0, 3 - len(v))) for v in (arm, force)))
    assert tool.tool_moment == pytest.approx(moment, abs=1e-7)
    certificate = report.certificate
    assert max(certificate.gap, certificate.sign, certificate.complementarity) < 1e-12
    assert certificate.force_balance < 1e-10 and not report.notes


@pytest.mark.serial
@pytest.mark.parametrize(
    ("shape", "kinematics", "geometry"),
    [(DISC, "plane_strain", "updated"), (BALL, "axisymmetric", "reference")],
)
def test_hertz(shape, kinematics, geometry):
    """Half width and peak pressure of a line and a point contact, nine nodes or more."""
    case = Block(n=40, fine=0.6)
    tool, _, report = case.press(shape, rtol=1e-6, kinematics=kinematics, geometry=geometry)
    own, force = (R, E, NU, 1e9 * E, 0.0), -float(tool.force[1])
    if shape is DISC:
        exact = dm.analytic.hertz_line(2.0 * force, *own)  # of both halves
    else:
        exact = dm.analytic.hertz_point(force, *own)
    width = exact.half_width if shape is DISC else exact.contact_radius
    found = tool.gather(case.u)
    on = found["active"] > 0.0
    peak, size = dm.analytic.fit_pressure(found["x"][on, 0], found["pressure"][on])
    assert size == pytest.approx(width, rel=0.02) and on.sum() >= 9
    assert peak == pytest.approx(exact.peak_pressure, rel=0.015)
    assert np.abs(tool.tool_moment).max() < 1e-9  # all normals pass through its centre
    assert report.newton_iterations <= 4


def test_two_tools_share_a_side(monkeypatch):
    """Each node belongs to the tool that it faces; the first one takes all if it looks too far."""
    discs = [dm.shapes.Cylinder([x, 1.0], 1.0) for x in (2.0, 6.5)]

    def pressed(shapes):
        case = Block(n=24, fine=3.0)
        tools = [case.tool(shape) for shape in shapes]
        problem = case.problem(tools)
        for tool in tools:
            tool.position.value[1] -= DEPTH
        dm.newton(problem)
        return [-tool.force[1] for tool in tools]

    alone, both = [pressed([disc])[0] for disc in discs], pressed(discs)
    assert both == pytest.approx(alone, rel=0.2) and min(both) > 0.0
    monkeypatch.setattr(obstacle, "FACETS", 1e3)
    assert pressed(discs)[1] == pytest.approx(0.0, abs=1e-12)


def test_a_ball_smaller_than_a_facet_is_noted():
    """It sinks in beside all points of integration, without any force."""
    h, case = 0.25, Box("hexahedron", (4, 4, 4), (0.0, 0.0, -1.0), (1.0, 1.0, 0.0))
    tool = case.tool(dm.shapes.Sphere(np.array([0.5 + 0.37 * h, 0.5 + 0.37 * h, 0.0]), 0.02 * h))
    problem = case.problem([tool])
    for place, noted in ((0.0, False), (-0.28, True)):
        tool.position.value[-1] = place * h
        assert said(dm.newton(problem).notes, "deep in") == noted


# -- curved sides


def ring_on_a_shaft(cell, n, degree=2, uneven=0.0, surface=None):
    """Return pressure over Lame's at the bore of a ring on a shaft thicker by d, and notes."""
    d, dim = 2e-3, 2 if cell in ("triangle", "quadrilateral") else 3
    off = np.random.default_rng(0).uniform(-uneven, uneven, n + 1) * [0.0, *np.ones(n - 1), 0.0]

    def move(x):
        r, t = 1.0 + x[:, 0], x[:, 1]
        t = np.pi / 2 * (t + (2.0 - r) * off[np.rint(n * t).astype(int)] / n)
        return np.column_stack([r * np.cos(t), r * np.sin(t), x[:, 2:]])

    grid, high = (n // 2, n, 1)[:dim], (1.0, 1.0, 0.2)
    case = Box(cell, grid, high=high, axis=0, degree=degree, move=move)
    flat = rollers(case.V, (0, 1)) + rollers(case.V, range(2, dim), (0.0, 0.1, 0.2))
    shaft = dm.shapes.Cylinder(np.zeros(dim), 1.0 + d, *([[0.0, 0.0, 1.0]] * (dim - 2)))
    tool = dm.Obstacle(case.facets, slave=BASE, shape=shaft, surface=surface)
    report = dm.newton(case.problem([tool], bcs=flat), rtol=1e-8)
    found, exact = tool.gather(case.u), E * d * 3.0 / ((1.0 + NU) * (5.0 - 2.0 * NU))
    return found["pressure"][found["active"] > 0.0] / exact, report.notes


@pytest.mark.parametrize(
    ("cell", "n", "degree", "uneven", "bar"),
    [
        # mid-side nodes are 2.4 (n = 8) and 0.6 d (n = 16) off the circle at X
        ("quadrilateral", 8, 2, 0.0, 0.04),
        ("triangle", 16, 2, 0.0, 0.02),
        ("hexahedron", 16, 2, 0.0, 0.02),
        ("tetrahedron", 16, 2, 0.0, 0.07),
        # of first order 1.40 times Lame's force by the facets alone, 1.54 if they are uneven
        ("quadrilateral", 16, 1, 0.3, 0.01),
        ("hexahedron", 16, 1, 0.0, 0.01),
        # chords of 4 uneven facets leave the circle by up to .08 of their length
        ("quadrilateral", 4, 1, 0.45, 0.04),
    ],
)
def test_straight_facets_stand_for_a_round_bore(cell, n, degree, uneven, bar):
    pressure, notes = ring_on_a_shaft(cell, n, degree, uneven)
    assert pressure == pytest.approx(1.0, abs=bar) and notes == []


@pytest.mark.parametrize(("cell", "n"), [("quadrilateral", 64), ("hexahedron", 16)])
def test_even_facets_on_a_round_tool(cell, n):
    """Lame's force is 1.02 and 1.4 times too large, as a note says from 5 % on."""
    pressure, notes = ring_on_a_shaft(cell, n, 1, 0.0, "facets")
    wrong = 1.0 - 1.0 / pressure.mean()
    found = [re.search(r"up to (\d+) % of the contact forces", note) for note in notes]
    assert [int(one[1]) for one in found] == [round(100.0 * wrong)] * int(wrong > 0.05)
    assert all("surface='smooth'" in note.why for note in notes)


@pytest.mark.parametrize("x", [0.2, 0.75])
def test_facets_of_a_side_that_is_partly_round(x):
    """A disc stands off the facets of its trough; what dips into a flat part does not."""

    def move(p):
        p[:, 1] += (p[:, 1] + 1.0) * np.maximum(0.0, p[:, 0] - 0.5) * (p[:, 0] - 1)
        return p

    case = Box("triangle", (32, 16), (0.0, -1.0), (1.0, 0.0), move=move)
    low = max(0.0, x - 0.5) * (x - 1.0)
    tool = case.tool(dm.shapes.Cylinder([x, low + 0.4], 0.4), surface="facets")
    *_, report = case.press(tool, 0.001, rtol=1e-6)
    assert said(report.notes, "facets of curved sides") == (x > 0.5)


# -- bad input

UP, DOWN = (dm.shapes.Plane([0.0, 0.0], [0.0, way]) for way in (1.0, -1.0))
AXIS = {"kinematics": "axisymmetric"}
WRONG = [  # options of the obstacle, of the problem; words
    ({"slave": "lid"}, {}, ("lid",)),
    ({"shape": "ball"}, {}, ("shape is 'ball'", "dolfinx_mortar.shapes")),
    ({"shape": FILE}, {}, ("3 coordinates", "the mesh has 2")),
    ({}, AXIS, ("shape: Cylinder", "Sphere or a Torus")),
    ({"reference": [0.0, 0.0, 0.0]}, {}, ("reference", "2 finite")),
    ({"surface": "round"}, {}, ("surface is 'round'", "'smooth' or 'facets'")),
    ({"load": -1.0}, {}, ("load is -1.0", "dictionary", "'moment'")),
    ({"load": {"z": -1.0}}, {}, ("load is {'z': -1.0}", "'x', 'y', 'moment'")),
]


@pytest.mark.parametrize(("options", "problem", "words"), WRONG)
def test_what_is_no_obstacle(options, problem, words):
    case = Block(n=2)
    with rejected(*words):
        given = {"slave": TOP, "shape": DISC} | options
        case.problem([dm.Obstacle(case.facets, **given)], **problem)


@pytest.mark.parametrize(
    ("shape", "options", "axis", "value", "words"),
    [
        (DISC, {}, 1, np.nan, ("position is [0.0, nan]", "finite")),
        (BALL, AXIS, 0, 0.1, ("position is [0.1, 8.0]", "along the axis only")),
    ],
)
def test_where_a_tool_cannot_be(shape, options, axis, value, words):
    case = Block(n=2)
    tool = case.tool(shape)
    tool.position.value[axis] = value
    with rejected(*words):
        case.press(tool, 0.0, **options)


def test_what_the_audit_says_of_a_tool():
    """Nothing; that no facet faces it; how deep it is in the body from the start, and where."""
    for shape, told in (
        (DOWN, []),
        (UP, ["no facet of the side faces the tool"]),
        (dm.shapes.Cylinder([0.0, 1.0], 5.0), ["4 deep, around"]),
    ):
        case = Block(n=8)
        audit = case.problem([case.tool(shape, friction=0.3)]).audit()
        assert [words for words in told if not said(audit.warnings, words)] == []
        assert told or not audit.warnings
        assert f"Obstacle(slave=3, friction=0.3, shape={type(shape).__name__})" in str(audit)
    _, _, report = Block(n=2).press(UP)  # without an audit
    (note,) = report.notes
    assert "no slave node carries a multiplier" in note and "Plane" in note
    case = Block(n=2)
    with rejected("Obstacle", "20 deep", "reverse it"):
        case.problem([case.tool(dm.shapes.Plane([0.0, -20.0], [0.0, -1.0]))]).audit()


def test_what_is_no_distance():
    """A level set that is none: how far off, where, and what to give instead."""
    for slope in (1.05, 0.95, 0.8):
        phi = lambda x, slope=slope: -slope * (x[1] - 0.01)  # noqa: E731
        shape = dm.shapes.SignedDistance(phi, [0.0, 0.0], length=1.0)
        if slope == 0.8:
            with rejected("phi is no distance", "abs(grad phi) is 0.8", "phi / abs(grad phi)"):
                Block(n=2).press(shape, 0.0)
        else:
            Block(n=2).press(shape, 0.0)


class Half(dm.shapes.Shape):
    """The half space y > 0 of a user, with something else at points on the right."""

    point = np.zeros(2)

    def __init__(self, change):
        self.change = change

    def given(self):
        return {}

    def distance(self, x):
        """Return that of the half space, changed."""
        n = len(x)
        right = dm.shapes.Distance(-x[:, 1], np.tile([0.0, -1.0], (n, 1)), np.zeros((n, 2, 2)))
        return self.change(right, x[:, 0] > 5.0)


def fails(found, there):
    """Fail as a user's function may."""
    if there.any():
        raise KeyError("no such point")
    return found


def part(name, value):
    """Return a function that changes a part of a distance at some points."""

    def changed(found, there):
        array = getattr(found, name).copy()
        array[there] = value
        return replace(found, **{name: array})

    return changed


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (part("value", np.nan), "Half: the value of its distance is NaN or inf"),
        (lambda found, _: None, "Half.distance() is None: return a shapes.Distance"),
        (
            lambda found, _: replace(found, gradient=found.gradient[:, :1]),
            "Half: the gradient of its distance is [",
        ),
        (fails, "no such point"),
    ],
)
def test_a_shape_of_a_user_that_fails_somewhere(change, told):
    """Contact is not lost in silence, and no rank waits for one where it fails."""
    case = Block(n=8)
    with rejected(told, error=(KeyError, RuntimeError) if change is fails else ValueError):
        case.press(Half(change))
    assert not case.u.x.array.any()


def test_what_a_tool_does_is_undone_when_it_rolls_back():
    """Its way at points that slide on it, by which its work is told, is the opposite then."""
    case, rng = Block(n=4), np.random.default_rng(4)
    tool = case.tool(DISC)
    tool.take(None, case.V)
    before, ended = rng.uniform(-1.0, 1.0, (2, 30, 2))
    tool.position.value[:], tool.rotation.value = (0.7, R), 0.8
    way = tool.tool.way(before, ended)
    tool.restore(tool.state(True))
    tool.position.value[:], tool.rotation.value = (0.0, R), 0.0
    assert tool.tool.way(ended, before) == pytest.approx(-way, abs=1e-13)

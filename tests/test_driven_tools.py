# SPDX-License-Identifier: MIT
"""Tools driven by force and moment: the same as where they are prescribed, and what fails."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import default_real_type, fem
from dolfinx_mortar.interfaces.tool import SPACE
from dolfinx_mortar.problem import predictors
from dolfinx_mortar.steps import newton
from tests.cases.meshes import BOTTOM, LEFT
from tests.cases.pressed_blocks import rejected
from tests.cases.two_bodies import TwoBodies
from tests.tool_case import BASE, DEPTH, DISC, Block, Box, R

COMM = MPI.COMM_WORLD
pytestmark = pytest.mark.mpi
PLANE = dm.shapes.Plane([0.0, 0.1], [0.0, -1.0])


@pytest.mark.parametrize(("friction", "geometry"), [(None, "updated"), (0.3, "reference")])
def test_the_force_finds_the_position(friction, geometry):
    """From a distance, in as many iterations and two more, and to the tolerance."""
    case = Block(n=16, fine=0.6)
    tool, *_ = case.press(case.tool(DISC, friction=friction), geometry=geometry)
    force = tool.tool_force
    case = Block(n=16, fine=0.6)
    apart = 0.0 if friction else 0.1  # what slips depends on where it begins
    shape = dm.shapes.Cylinder([0.0, R + apart], R)
    driven = case.tool(shape, friction=friction, load={"y": -float(force[1])})
    report = dm.newton(case.problem([driven], geometry=geometry), rtol=1e-9)
    assert driven.tool_force[1] == pytest.approx(force[1], rel=1e-8)
    rel = 1e-4 if friction else 1e-5
    assert driven.travel == pytest.approx([0.0, -apart - DEPTH, 0.0], rel=rel)
    assert driven.tool_force[0] == pytest.approx(force[0], rel=rel, abs=1e-9)
    assert report.newton_iterations <= 12


def plate_on_a_box(cell, degree, place, **options):
    """Return a plate above a box, and its problem."""
    case = Box(cell, degree=degree)
    tool = case.tool(dm.shapes.Plane([0.5, 0.5, place], [0.0, 0.0, -1.0]), **options)
    return tool, case.problem([tool], law=dm.Elastic(100.0, 0.2))


@pytest.mark.parametrize(("cell", "degree"), [("hexahedron", 1), ("tetrahedron", 2)])
def test_in_space_a_plate_settles_on_a_box(cell, degree):
    """Three of six are given, the others stay prescribed; of six-node facets D is not diagonal."""
    load = {"z": -1.0, "moment x": 0.1, "moment y": 0.05}
    tool, problem = plate_on_a_box(cell, degree, 1.02, load=load)
    dm.newton(problem, rtol=1e-9)
    assert tool.tool_force[2] == pytest.approx(1.0, rel=1e-8)
    assert tool.tool_moment[:2] == pytest.approx([-0.1, -0.05], rel=1e-7)
    moved = tool.travel
    assert moved[:2] == pytest.approx(np.zeros(2), abs=1e-8) and moved[2] < -0.02
    assert abs(moved[5]) <= abs(moved[3] * moved[4])  # turns about x and y do not commute


def test_six_forces_and_moments_that_friction_holds():
    """A load of more than mu N is told, and nothing moves; all others are met."""
    tool, problem = plate_on_a_box("hexahedron", 1, 1.0, friction=0.5, load={"z": -0.5})
    dm.newton(problem, rtol=1e-7)
    problem.commit()
    tool.load, travel = {"x": 0.3, "z": -0.5}, tool.travel
    with rejected("up to its limit", error=dm.NewtonNotConverged):
        dm.newton(problem, rtol=1e-7)
    assert tool.travel == pytest.approx(travel, abs=0.0)
    given = np.array([0.05, -0.03, -0.5, 0.02, 0.01, 0.01])
    tool.load = dict(zip(SPACE, given.tolist(), strict=True))
    dm.newton(problem, rtol=1e-7)
    assert [*tool.tool_force, *tool.tool_moment] == pytest.approx(-given, abs=1e-6)
    assert (tool.travel * [1, -1, -1, 1, 1, 1] > 0.0).all()


# -- bad input


ROUND = dm.shapes.Cylinder([5.0, 3.0], 3.0)


@pytest.mark.parametrize(
    ("shape", "load", "mu", "words"),
    [
        (PLANE, {"y": 1.0}, None, ("'y' = 1", "change its sign")),
        (PLANE, {"x": 1.0}, None, ("'x' = 1", "along x the side carries nothing without friction")),
        (ROUND, {"x": 1.0}, None, ("'x'", "give friction")),  # before it moves, or after it
        (PLANE, {"x": 1.0}, 0.3, ("'x' = 1", "along x friction carries a load up to its limit")),
        # to no angle but round-off's; it was sought in a hundred QPs, or up to NaN
        (DISC, {"moment": 0.05}, None, ("'moment' = 0.05", "turns freely without friction")),
    ],
)
def test_loads_that_nothing_resists(shape, load, mu, words):
    case = Block(n=16, fine=0.6) if shape is DISC else Block(n=10, fine=10.0)
    with rejected("resist", *words, error=dm.NewtonNotConverged):
        dm.newton(case.problem([case.tool(shape, load=load, friction=mu)]))
    assert not case.u.x.array.any()


def test_loads_that_make_no_sense():
    case = Block(n=4)
    value = fem.Constant(case.mesh, default_real_type(np.nan))
    with rejected("load['y'] is nan", "finite"):
        dm.newton(case.problem([case.tool(DISC, load={"y": value})]))
    tool = case.tool(dm.shapes.Sphere([0.0, R], R), load={"x": -1.0})
    problem = case.problem([tool], kinematics="axisymmetric")
    with rejected("axisymmetric", "{'y': ..}"):
        dm.newton(problem)


# -- walks


def test_a_disc_rolls_over_facets_in_a_step():
    """Its angle is given, its way found: R times the angle."""
    case, radius = Block(n=20, fine=5.0, size=5.0), 3.0
    tool = case.tool(dm.shapes.Cylinder([2.0, radius], radius), friction=0.3, load={"y": -20.0})
    problem = case.problem([tool], bcs=[case.hold(BASE)])
    dm.newton(problem)
    problem.commit()
    tool.rotation.value[...] = -4 * 0.25 / radius
    tool.load = {"x": 0.0, "y": -20.0}
    assert dm.newton(problem).newton_iterations <= 8
    pose = tool.tool.pose()
    assert pose.position[0] - 2.0 == pytest.approx(-radius * pose.rotation[0], abs=0.1)


RUBBER = dm.NeoHooke(E=10.0, nu=0.3)
METAL = dm.VonMises(E=10.0, nu=0.3, Y=0.5, a=1.0)


def pressed_stack(load, law=RUBBER):
    """Press a block with bulging sides onto another one by a plane; return tool and problem."""

    def bulge(points):
        x, y = points.T
        return np.column_stack([x * (1 + 0.04 * np.sin(3 * y) * y * (1 - abs(y))), y])

    case = TwoBodies("quadrilateral", n_lower=(4, 3), n_upper=(4, 3), transform=bulge)
    bcs, shape = [case.held(LEFT, 0.0, 0), case.held(BOTTOM, 0.0, 1)], dm.shapes.Plane
    tool = dm.Obstacle(case.facets, slave=2, shape=shape((0.0, 1.0), (0.0, -1.0)), load=load)
    interfaces = [tool, case.interface(swap=True)]
    return tool, case.problem(interfaces, bcs, law, strain="finite")


def test_a_stack_pressed_by_a_force_at_finite_strain():
    """Quadratic, where the fixed point of the inner contact grows by 1.4 an iteration."""
    tool, problem = pressed_stack({"y": -1.875})
    report = dm.newton(problem)
    assert report.newton_iterations <= 8
    assert any(iteration.exact_tangent for iteration in report.iterations)
    moved, other = pressed_stack(None)  # prescribed there, it has the same force
    moved.position.value[1] += tool.travel[1]
    dm.newton(other)
    assert moved.tool_force[1] == pytest.approx(1.875, rel=1e-5)


LEVELS = np.arange(1, 6) / 5


def pressed_in_steps(levels=LEVELS, restored=None, law=METAL, rtol=1e-9):
    """Press the stack by a force that grows; return tool, problem and all Newton iterations."""
    load = fem.Constant(pressed_stack({})[1].V.mesh, default_real_type(0.0))
    tool, problem = pressed_stack({"y": load}, law)
    if restored is not None:
        problem.restore(restored)
    steps = dm.load_steps(problem, levels, ramp={load: [(0.0, 0.0), (1.0, -1.2)]}, rtol=rtol)
    return tool, problem, sum(step.report.newton_iterations for step in steps)


def test_a_step_goes_on_as_the_last_one_did(monkeypatch):
    """Tool and bodies start where the last step points to: fewer iterations, the same balance."""
    tool, problem, count = pressed_in_steps()
    with monkeypatch.context() as patch:
        patch.setattr(predictors, "_go_on", lambda *_: None)
        other, without, plain = pressed_in_steps()
    assert count < plain
    size = np.abs(without.u.x.array).max()
    assert np.abs(problem.u.x.array - without.u.x.array).max() < 1e-7 * size
    assert tool.travel == pytest.approx(other.travel, rel=1e-7)
    gained = problem.committed.gained
    before, _, _ = pressed_in_steps(LEVELS[:-1])
    assert gained.travel == pytest.approx((tool.travel - before.travel)[1:2], rel=1e-9)
    assert gained.duration == pytest.approx(0.2)
    _, elastic, _ = pressed_in_steps(LEVELS[:2], law=RUBBER)  # which does not
    assert elastic.begin_step(0.6, predictors.predict).travel is None


def test_a_step_that_fails_from_there_begins_without(monkeypatch):
    """It is told, and ends like one that began without."""
    tool, problem, _ = pressed_in_steps(LEVELS[:2])
    run, travels = newton._Step.run, []

    def failing(step, max_it):
        travels.append(tool.travel[1])
        if step.data.travel is not None:
            raise newton.failures.StepFailed("no luck")
        return run(step, max_it)

    monkeypatch.setattr(newton._Step, "run", failing)
    begun = tool.travel[1]
    report = dm.newton(problem, level=0.6)
    assert travels[0] < begun == travels[1] == pytest.approx(tool.travel[1], rel=0.5)
    assert any("led nowhere in 0 iterations" in note for note in report.notes)
    assert len(report.iterations) == report.newton_iterations > 0

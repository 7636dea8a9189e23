# SPDX-License-Identifier: MIT
"""Friction along rigid tools that move: what slips, what sticks, what is carried along."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from tests.tool_case import BASE, DEPTH, ELASTIC, Block, Box, R

COMM = MPI.COMM_WORLD
pytestmark = pytest.mark.mpi
MU, P = 0.3, 2.0
SOFT = dm.Elastic(100.0, 0.0)
GEOMETRIES = pytest.mark.parametrize("geometry", ["updated", "reference"])


class Held(Block):
    """A block whose base moves as a rigid body: by a vector, and by an angle about the origin."""

    def __init__(self, **options):
        super().__init__(**options)
        self.base = fem.Function(self.V)
        self.X = self.V.tabulate_dof_coordinates()[:, :2]

    def bcs(self):
        """Hold the base."""
        dofs = fem.locate_dofs_topological(self.V, 1, self.facets.find(BASE))
        return [fem.dirichletbc(self.base, dofs)]

    def carry(self, by=(0.0, 0.0), angle=0.0):
        """Move the base."""
        c, s = np.cos(angle), np.sin(angle)
        turned = self.X @ np.array([[c, s], [-s, c]])
        self.base.x.array[:] = (turned - self.X + by).ravel()


class Pressed:
    """A body pressed by a tool; further steps are committed."""

    def __init__(self, case, shape, depth, mu=MU, law=SOFT, **options):
        self.case, self.tool = case, case.tool(shape, friction=mu)
        _, self.problem, _ = case.press(self.tool, depth, law=law, **options)
        self.problem.commit()

    def step(self):
        """Return the report of a step that is committed."""
        report = dm.newton(self.problem, rtol=1e-10)
        self.problem.commit()
        return report

    def slips(self, component=0):
        """Return slips of the step at closed nodes of this rank."""
        on = self.tool.active.x.array[: self.problem.n] > 0.0
        return self.tool.step_slip.x.array.reshape(-1, 2)[: self.problem.n][on, component]


def bar(**options):
    """Return a square bar under a plane that presses it by 0.02."""
    case = Held(n=3, size=1.0, fine=0.8)
    return Pressed(case, dm.shapes.Plane([0.4, 0.0], [0.0, -1.0]), 0.02, **options)


@GEOMETRIES
def test_a_tool_drags_the_side_along(geometry):
    """It sticks, then slips: tau = mu p, along the motion of the tool, and what it dissipates."""
    pressed = bar(geometry=geometry)
    tool = pressed.tool
    tool.position.value[0] += 0.001
    pressed.step()
    closed = tool.active.x.array > 0.0
    assert (tool.status.x.array[closed] == 1.0).all()
    assert 0.0 < tool.force[0] < MU * P  # on the body, along the tool's motion
    for _ in range(2):
        spent = tool.dissipation
        tool.position.value[0] += 0.05
        pressed.step()
    assert (tool.status.x.array[closed] == 2.0).all()
    pressure, traction = tool.pressure.x.array, tool.traction.x.array[::2]
    assert traction[closed] == pytest.approx(MU * pressure[closed], rel=1e-8)
    assert tool.force[0] == pytest.approx(-MU * tool.force[1], rel=1e-9)
    assert tool.tool_force == pytest.approx(-tool.force, abs=1e-12)
    # the second step is all slip: of the tool relative to a body that stands still
    assert np.abs(pressed.slips()) == pytest.approx(0.05, rel=2e-3)
    assert tool.dissipation - spent == pytest.approx(0.05 * tool.force[0], rel=2e-3)


def test_a_turning_tool_carries_a_body():
    """Both turn by 40 degrees in a step, at finite strain: the forces turn with them."""
    pressed = bar(law=dm.NeoHooke(100.0, 0.3), strain="finite")
    tool, angle = pressed.tool, np.radians(40.0)
    tool.position.value[0] += 0.002
    pressed.step()
    force, moment = tool.tool_force.copy(), tool.tool_moment[2]
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    tool.position.value[:] = turn @ tool.position.value
    tool.rotation.value[...] = angle
    pressed.case.carry(angle=angle)
    pressed.step()
    assert tool.tool_force == pytest.approx(turn @ force, rel=1e-7)
    assert tool.tool_moment[2] == pytest.approx(moment, rel=1e-7)
    assert np.abs(tool.step_slip.x.array).max() < 1e-9


@pytest.mark.parametrize("early", [False, True])
def test_a_step_ends_where_the_tool_was(early):
    """Set for the next step before the commit of this one: its slip counts all of that motion."""
    pressed = bar()
    position = pressed.tool.position.value
    position[0] += 0.05
    dm.newton(pressed.problem, rtol=1e-10)
    position[0] += 0.04 * early
    pressed.problem.commit()
    position[0] += 0.04 * (not early)
    pressed.step()
    assert np.abs(pressed.slips()) == pytest.approx(0.04, rel=1e-2)


# -- rollers


def roller(n, depth, **options):
    """Return a disc pressed on the middle of a block."""
    disc = dm.shapes.Cylinder([4.0, R], R)
    return Pressed(Held(n=n, fine=8.0), disc, depth, law=ELASTIC, **options)


@GEOMETRIES
@pytest.mark.parametrize(("angle", "noted"), [(2.5, False), (4.0, True)])
def test_a_roller_that_turns_far_in_a_step(angle, noted, geometry):
    """All of it slips, by arcs: R times the angle to round-off, less what the side has moved."""
    pressed = roller(12, 6 * DEPTH, geometry=geometry)
    case, tool = pressed.case, pressed.tool
    before = case.u.x.array.copy()
    tool.rotation.value[...] = angle
    told = [note for note in pressed.step().notes if "the tool turns by" in note]
    assert len(told) == (noted and geometry == "updated")
    if told:
        assert f"{np.degrees(angle):.0f} degrees in this step" in told[0]
        return
    assert tool.tool_moment[2] < 0.0
    on = np.flatnonzero(tool.status.x.array[: pressed.problem.n] == 2.0)
    x = case.X[on] + np.stack([before, case.u.x.array]).reshape(2, -1, 2)[:, on]
    slip = tool.step_slip.x.array.reshape(-1, 2)[on]
    if geometry == "updated":
        arm = x - tool.position.value
        turned = np.diff(np.arctan2(arm[:, :, 0], -arm[:, :, 1]), axis=0)[0]
        size = np.sign(slip[:, 0]) * np.linalg.norm(slip, axis=1)
        assert size == pytest.approx(R * (turned - angle), rel=1e-12)
    else:
        way = angle * (tool.position.value[1] - case.X[on, 1])
        assert slip[:, 0] == pytest.approx((x[1] - x[0])[:, 0] - way, rel=1e-2)


def test_in_space_a_disc_of_slip():
    """A plane that turns about its normal drags a box around, without a resultant."""
    case = Box()
    pressed = Pressed(case, dm.shapes.Plane([0.5, 0.5, 1.0], [0.0, 0.0, -1.0]), 0.02)
    tool = pressed.tool
    tool.rotation.value[2] = 0.3
    assert not any("about normals" in note for note in pressed.step().notes)
    found = tool.gather(case.u)
    arm = found["x"][:, :2] - 0.5
    slides = np.linalg.norm(arm, axis=1) > 0.2
    assert (found["status"][slides] == 2.0).all()
    size = np.linalg.norm(found["traction"], axis=1)
    assert size[slides] == pytest.approx(MU * found["pressure"][slides], rel=1e-7)
    around = arm[:, 0] * found["traction"][:, 1] - arm[:, 1] * found["traction"][:, 0]
    assert (around[slides] > 0.0).all()  # on the body, with the tool
    assert tool.tool_moment[2] < -0.2 * MU * abs(tool.force[2])
    tool.rotation.value[2] += 0.8
    (told,) = [note for note in pressed.step().notes if "about normals" in note]
    assert "46 degrees" in told


def test_slips_on_a_tool_that_turns_and_slides_in_one_step():
    """On frozen surfaces they are those of the rigid motion, of the turn to third order."""
    case, turn, far = Held(n=3, size=1.0, fine=0.8), 0.01, 100.0
    plane = dm.shapes.Plane([0.4, 0.0], [0.0, -1.0])
    tool = case.tool(plane, friction=1e-9, reference=[0.5 + far, 0.0])
    _, problem, _ = case.press(tool, law=SOFT, geometry="reference")
    problem.commit()
    before = case.u.x.array.copy()
    tool.position.value[:] += far * np.array([np.cos(turn) - 1.0, np.sin(turn)])
    tool.rotation.value = turn
    dm.newton(problem, rtol=1e-10)
    closed = tool.active.x.array > 0.0
    way = (case.u.x.array - before).reshape(-1, 2) - tool.tool.way(case.X, case.X)
    slip = tool.step_slip.x.array.reshape(-1, 2)
    assert slip[closed, 0] == pytest.approx(way[closed, 0], abs=far * turn**3)
    assert COMM.allreduce(int(closed.sum())) > 0

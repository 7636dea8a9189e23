# SPDX-License-Identifier: MIT
"""Friction along rigid tools that move: what slips, what sticks, what is carried along."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from tests.cases.tool import BASE, DEPTH, TOP, Block, R

COMM = MPI.COMM_WORLD
pytestmark = pytest.mark.mpi
MU = 0.3
RUBBER = dm.NeoHooke(100.0, 0.3)
SOFT = dm.Elastic(100.0, 0.0)


class Held(Block):
    """A block whose base moves as a rigid body: by a vector, and by an angle about the origin."""

    def __init__(self, **options):
        """Create it."""
        super().__init__(**options)
        self.base = fem.Function(self.V)
        self.X = self.V.tabulate_dof_coordinates()[:, :2]

    def bcs(self):
        """Hold the base."""
        base = fem.locate_dofs_topological(self.V, 1, self.facets.find(BASE))
        return [fem.dirichletbc(self.base, base)]

    def carry(self, by=(0.0, 0.0), angle=0.0):
        """Move the base."""
        c, s = np.cos(angle), np.sin(angle)
        turned = self.X @ np.array([[c, s], [-s, c]])
        self.base.x.array[:] = (turned - self.X + by).ravel()


def pressed(geometry="updated", mu=MU, **options):
    """Return a square bar, the plane that presses it by 0.02, and the problem."""
    case = Held(n=3, size=1.0, fine=0.8)
    tool = case.tool(dm.shapes.Plane([0.4, 0.0], [0.0, -1.0]), friction=mu)
    problem = case.problem([tool], **({"law": SOFT} | options), geometry=geometry)
    tool.position.value[1] -= 0.02
    dm.newton(problem, rtol=1e-10)
    problem.commit()
    return case, tool, problem


@pytest.mark.parametrize("geometry", ["updated", "reference"])
def test_a_tool_drags_the_side_along(geometry):
    """It sticks, then slips: tau = mu p, along the motion of the tool, and what it dissipates."""
    _, tool, problem = pressed(geometry)
    p = 100.0 * 0.02
    tool.position.value[0] += 0.001
    dm.newton(problem, rtol=1e-10)
    problem.commit()
    closed = tool.active.x.array > 0.0
    assert (tool.status.x.array[closed] == 1.0).all()
    assert 0.0 < tool.force[0] < MU * p  # on the body, along the tool's motion
    for _ in range(2):
        before, spent = tool.slip.x.array.copy(), tool.dissipation
        tool.position.value[0] += 0.05
        dm.newton(problem, rtol=1e-10)
        problem.commit()
    assert (tool.status.x.array[closed] == 2.0).all()
    pressure, traction = tool.pressure.x.array, tool.traction.x.array[::2]
    assert traction[closed] == pytest.approx(MU * pressure[closed], rel=1e-8)
    assert tool.force[0] == pytest.approx(-MU * tool.force[1], rel=1e-9)
    assert tool.tool_force == pytest.approx(-tool.force, abs=1e-12)
    # the second step is all slip: of the tool relative to a body that stands still
    nodes = closed[: problem.n]
    assert tool.slip.x.array[: problem.n][nodes] - before[: problem.n][nodes] == pytest.approx(
        np.full(nodes.sum(), 0.05), rel=2e-3
    )
    assert tool.dissipation - spent == pytest.approx(0.05 * tool.force[0], rel=2e-3)


@pytest.mark.parametrize("geometry", ["updated", "reference"])
def test_what_is_carried_along_keeps_its_traction(geometry):
    """Body and tool move alike, by far more than what would slip."""
    case, tool, problem = pressed(geometry)
    tool.position.value[0] += 0.002
    dm.newton(problem, rtol=1e-10)
    problem.commit()
    force, status = tool.force.copy(), tool.status.x.array.copy()
    step = np.array([0.3, -0.1]) if geometry == "updated" else np.array([0.3, 0.0])
    tool.position.value[:] += step
    case.carry(by=step)
    dm.newton(problem, rtol=1e-10)
    assert tool.force == pytest.approx(force, rel=1e-7)
    assert tool.status.x.array == pytest.approx(status)
    assert np.abs(tool.step_slip.x.array).max() < 1e-9
    assert tool.dissipation == pytest.approx(0.0, abs=1e-10)


def test_a_second_try_has_the_friction_of_the_first():
    """Where the supports of nodes prescribe their slips, these count from the last commit alone."""
    case = Block(n=6)
    tool = case.tool(dm.shapes.Plane([0.0, 0.02], [0.0, -1.0]), friction=0.2)
    problem, forces = case.problem([tool]), []
    for place, tries in (((0.01, 0.0), 1), ((0.02, -0.01), 3)):
        tool.position.value[:] = place
        for _ in range(tries):
            dm.newton(problem, rtol=1e-10)
            forces.append(tool.force.copy())
        problem.commit()
    assert forces[2] == pytest.approx(forces[1], rel=1e-8)
    assert forces[3] == pytest.approx(forces[1], rel=1e-8) and forces[1][0] > 0.0


def test_slips_on_a_tool_that_turns_and_slides_in_one_step():
    """On frozen surfaces they are those of the rigid motion, of the turn to third order.

    It turns about the middle of the side, but its point is far away and goes far.
    """
    case, turn, far = Held(n=3, size=1.0, fine=0.8), 0.01, 100.0
    plane = dm.shapes.Plane([0.4, 0.0], [0.0, -1.0])
    tool = case.tool(plane, friction=1e-9, reference=[0.5 + far, 0.0])
    problem = case.problem([tool], law=SOFT, geometry="reference")
    tool.position.value[1] -= 0.02
    dm.newton(problem, rtol=1e-10)
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


@pytest.mark.parametrize("early", [False, True])
def test_a_step_ends_where_the_tool_was(early):
    """Set for the next step before the commit of this one: its slip counts all of that motion."""
    _, tool, problem = pressed()
    tool.position.value[0] += 0.05
    dm.newton(problem, rtol=1e-10)
    if early:
        tool.position.value[0] += 0.04
    problem.commit()
    if not early:
        tool.position.value[0] += 0.04
    dm.newton(problem, rtol=1e-10)
    nodes = tool.active.x.array[: problem.n] > 0.0
    slip = np.abs(tool.step_slip.x.array[: 2 * problem.n : 2][nodes])
    assert slip == pytest.approx(np.full(nodes.sum(), 0.04), rel=1e-2)


def test_held_nodes_have_friction_with_a_tool_that_moves():
    """They stand still, the tool slides over them: T = mu N; where both move alike, it stays."""
    case = Held(n=3, size=1.0, fine=0.8)
    tool = case.tool(dm.shapes.Plane([0.4, 0.0], [0.0, -1.0]), friction=MU)
    top = fem.locate_dofs_topological(case.V.sub(0), 1, case.facets.find(TOP))
    given = fem.Constant(case.mesh, 0.0)
    bcs = [*case.bcs(), fem.dirichletbc(given, top, case.V.sub(0))]
    problem = dm.ContactProblem(dm.Solid(case.u, SOFT), [tool], bcs=bcs)
    tool.position.value[:] += [0.0, -0.02]
    dm.newton(problem)
    problem.commit()
    assert np.abs(tool.force[0]) < 1e-12 * np.abs(tool.force[1])
    tool.position.value[0] += 0.3
    for alike in (0.0, 0.1):
        given.value, tool.position.value[0] = alike, tool.position.value[0] + alike
        dm.newton(problem)
        problem.commit()
        assert tool.force[0] == pytest.approx(MU * np.abs(tool.force[1]), rel=1e-9)
        assert tool.tool_force == pytest.approx(-tool.force, rel=1e-14)


def test_a_turning_tool_carries_a_body():
    """Both turn by 40 degrees in a step, at finite strain: the forces turn with them."""
    case, tool, problem = pressed(law=RUBBER, strain="finite")
    tool.position.value[0] += 0.002
    dm.newton(problem, rtol=1e-10)
    problem.commit()
    force, moment, angle = tool.tool_force.copy(), tool.tool_moment[2], np.radians(40.0)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    tool.position.value[:] = turn @ tool.position.value
    tool.rotation.value[...] = angle
    case.carry(angle=angle)
    dm.newton(problem, rtol=1e-10)
    assert tool.tool_force == pytest.approx(turn @ force, rel=1e-7)
    assert tool.tool_moment[2] == pytest.approx(moment, rel=1e-7)
    assert np.abs(tool.step_slip.x.array).max() < 1e-9


def test_a_roller_that_turns_in_place():
    """All of its contact slips: mu N along the surface, a moment of mu N R about its axis."""
    case = Held(n=40, fine=8.0)
    tool = case.tool(dm.shapes.Cylinder([4.0, R], R), friction=MU)
    problem = case.problem([tool], law=dm.Elastic(200.0, 0.3))
    tool.position.value[1] -= 3 * DEPTH
    dm.newton(problem)
    problem.commit()
    tool.rotation.value[...] = 0.05  # the side under it goes to the right
    dm.newton(problem, rtol=1e-9)
    assert tool.force[0] > 0.0
    total = float(np.linalg.norm(tool.force)) / np.sqrt(1.0 + MU**2)
    # normals pass through the axis, nodes within their gaps of the surface
    assert tool.tool_moment[2] == pytest.approx(-MU * total * R, rel=5e-3)
    status = tool.status.x.array[tool.active.x.array > 0.0]
    assert (status == 2.0).all()


FAR = [(np.pi / 6, False), (2.5, False), (4.0, True), (2.0 * np.pi, True)]


@pytest.mark.parametrize("geometry", ["updated", "reference"])
@pytest.mark.parametrize(("angle", "noted"), FAR)
def test_a_roller_that_turns_far_in_a_step(angle, noted, geometry):
    """All of it slips, by arcs: R times the angle to round-off, less what the side has moved.

    Friction would act the other way beyond half a turn: noted, but on frozen surfaces, where slips
    have no limit.
    """
    case = Held(n=12, fine=8.0)
    tool = case.tool(dm.shapes.Cylinder([4.0, R], R), friction=MU)
    problem = case.problem([tool], law=dm.Elastic(200.0, 0.3), geometry=geometry)
    tool.position.value[1] -= 6 * DEPTH
    dm.newton(problem)
    problem.commit()
    before = case.u.x.array.copy()
    tool.rotation.value[...] = angle
    noted = noted and geometry == "updated"
    told = [note for note in dm.newton(problem).notes if "the tool turns by" in note]
    assert len(told) == noted
    assert not noted or f"{np.degrees(angle):.0f} degrees in this step" in told[0]
    assert noted or tool.tool_moment[2] < 0.0
    if noted:
        return
    on = np.flatnonzero(tool.status.x.array[: problem.n] == 2.0)
    x = case.X[on] + np.stack([before, case.u.x.array]).reshape(2, -1, 2)[:, on]
    slip = tool.step_slip.x.array.reshape(-1, 2)[on]
    size = np.sign(slip[:, 0]) * np.linalg.norm(slip, axis=1)
    if geometry == "updated":
        arm = x - tool.position.value
        turned = np.diff(np.arctan2(arm[:, :, 0], -arm[:, :, 1]), axis=0)[0]
        assert size == pytest.approx(R * (turned - angle), rel=1e-12)
    else:
        way = angle * (tool.position.value[1] - case.X[on, 1])
        moved = x[1] - x[0]
        assert slip[:, 0] == pytest.approx(moved[:, 0] - way, rel=1e-2)


@pytest.mark.parametrize(("angle", "noted"), [(0.3, False), (0.8, True)])
def test_a_tool_that_turns_about_normals(angle, noted):
    """There slips are chords: noted where these are too short."""
    _, tool, problem = box_under_a_plane()
    tool.rotation.value[2] = angle
    told = [note for note in dm.newton(problem).notes if "about normals" in note]
    assert len(told) == noted and (not noted or "46 degrees" in told[0])


def box_under_a_plane():
    """Return displacement, tool and problem of a box that a plane has pressed."""
    from tests.test_obstacle import box

    tags, u = box("hexahedron", 1, np.eye(3))
    V = u.function_space
    base = fem.locate_dofs_topological(V, 2, tags.find(1))
    tool = dm.Obstacle(
        tags, slave=2, shape=dm.shapes.Plane([0.5, 0.5, 1.0], [0.0, 0.0, -1.0]), friction=MU
    )
    problem = dm.ContactProblem(
        dm.Solid(u, SOFT), [tool], bcs=[fem.dirichletbc(np.zeros(3), base, V)]
    )
    tool.position.value[2] -= 0.02
    dm.newton(problem, rtol=1e-9)
    problem.commit()
    return u, tool, problem


def test_in_space_a_disc_of_slip():
    """A plane that turns about its normal drags a box around, without a resultant."""
    u, tool, problem = box_under_a_plane()
    tool.rotation.value[2] = 0.3
    dm.newton(problem, rtol=1e-9)
    found = tool.gather(u)
    arm = found["x"][:, :2] - 0.5
    slides = np.linalg.norm(arm, axis=1) > 0.2
    assert (found["status"][slides] == 2.0).all()
    size = np.linalg.norm(found["traction"], axis=1)
    assert size[slides] == pytest.approx(MU * found["pressure"][slides], rel=1e-7)
    around = arm[:, 0] * found["traction"][:, 1] - arm[:, 1] * found["traction"][:, 0]
    assert (around[slides] > 0.0).all()  # on the body, with the tool
    assert tool.tool_moment[2] < -0.2 * MU * abs(tool.force[2])

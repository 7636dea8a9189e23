# SPDX-License-Identifier: MIT
"""Bodies that move through each other in one step: found, and only then."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from dolfinx.mesh import meshtags
from dolfinx_mortar.interfaces import tool as tool_poses
from dolfinx_mortar.mortar import passing
from dolfinx_mortar.steps.failures import describe_passing
from tests.cases.close_fits import rings
from tests.cases.hertz import create_mesh
from tests.cases.meshes import BOTTOM, BOTTOM_OF_UPPER, TOP_OF_LOWER, UPPER, skins
from tests.cases.meshes_3d import rotation
from tests.cases.solid import hold, plane
from tests.cases.triangles import box
from tests.cases.two_bodies import TwoBodies, create_problem, held
from tests.tool_case import BASE, TOP, Box

COMM = MPI.COMM_WORLD


# -- points and facets -----------------------------------------------------------------------------


# -- steps -----------------------------------------------------------------------------------------


class Pushed:
    """A half disc above a strip that is clamped at one end."""

    def __init__(self, slave="disc", top="skin"):
        """Create the problem."""
        mesh, cells, facets = create_mesh(
            "graded", 0.4, radius=2.0, block=(16.0, 1.0), gap=0.5, limit=3.0
        )
        V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
        tags = skins(mesh, cells, facets, keep=())
        if top != "skin":
            disc = facets.find("arc")
            disc = np.append(disc, facets.find("flat")) if top == "top" else disc
            marked = np.sort(np.append(disc, facets.find("top")))
            values = np.where(np.isin(marked, disc), BOTTOM_OF_UPPER, TOP_OF_LOWER)
            tags = meshtags(mesh, 1, marked, values.astype(np.int32))
        self.way = fem.Constant(mesh, np.zeros(2))
        bcs = [hold(V, plane(0, -8.0)), held(V, facets, "flat", self.way)]
        sides = {"strip": TOP_OF_LOWER, "disc": BOTTOM_OF_UPPER}
        master = next(name for name in sides if name != slave)
        self.contact = dm.Contact(tags, slave=sides[slave], master=sides[master])
        self.problem = create_problem(V, [self.contact], bcs)

    def move(self, *way):
        self.way.value[:] = way


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("slave", "top"),
    [("disc", "skin"), ("strip", "skin"), ("disc", "top"), ("strip", "top"), ("disc", "alone")],
)
def test_a_disc_through_a_strip_is_no_step(slave, top):
    """Four thicknesses down: refused as the first step and as a later one; nothing is changed."""
    pushed = Pushed(slave, top)
    for begun in (False, True):
        pushed.move(0.0, -0.1)
        if begun:
            dm.newton(pushed.problem)
            pushed.problem.commit()
        before = pushed.problem.u.x.array.copy()
        pushed.move(0.0, -6.0)
        with pytest.raises(dm.NewtonNotConverged, match="has passed through the other one"):
            dm.newton(pushed.problem)
        assert (pushed.problem.u.x.array == before).all()


@pytest.mark.mpi
@pytest.mark.parametrize("slave", [TOP_OF_LOWER, BOTTOM_OF_UPPER])
def test_a_body_that_is_prescribed_altogether(slave):
    """As master it presses; as slave it would pass without a force, which no cut can mend."""
    case = TwoBodies(n_lower=(8, 4), n_upper=(5, 3), x_upper=(0.2, 0.8))
    case.mesh.topology.create_connectivity(2, 2)
    body = fem.locate_dofs_topological(case.V, 2, case.cells.find(UPPER))
    way = fem.Constant(case.mesh, np.array([0.0, -0.02]))
    bcs = [case.held(BOTTOM), fem.dirichletbc(way, body, case.V)]
    problem = case.problem([case.interface(slave=slave)], bcs)
    if slave == TOP_OF_LOWER:
        dm.newton(problem, rtol=1e-10)
        carried = dm.reaction(problem, bcs[0]).force
        np.testing.assert_allclose(dm.reaction(problem, bcs[1]).force, -carried, atol=1e-8)
        assert carried[1] > 0.5 * 0.02 * 1000.0 * 0.6
        return
    way.value[1] = -0.6
    for solve in (lambda: dm.newton(problem), lambda: list(dm.load_steps(problem, [1.0]))):
        with pytest.raises(
            ValueError, match=r"prescribe all nodes of its slave side .* be the slave$"
        ):
            solve()
        assert not problem.u.x.array.any()


@pytest.mark.mpi
@pytest.mark.parametrize(
    "way",
    [(0.0, 30.0), (30.0, 0.1), (-20.0, 20.0), (0.0, -0.3)],
    ids=["up", "past the end", "away", "near"],
)
def test_bodies_may_part_and_slide_past(way):
    """However far they go, also from where they have touched."""
    pushed = Pushed()
    pushed.move(0.0, -0.55)
    dm.newton(pushed.problem)
    pushed.problem.commit()
    assert abs(pushed.contact.force[1]) > 0.0
    pushed.move(*way)
    dm.newton(pushed.problem)
    assert not describe_passing(pushed.problem)
    assert np.linalg.norm(pushed.contact.force) < 1e-12


@pytest.mark.parametrize("degrees", [45.0, 90.0, -150.0])
@pytest.mark.parametrize("slave", [2, 3])
def test_a_hub_may_turn_in_a_ring(degrees, slave):
    """Middles move along arcs: those of the ring's outer part, on chords, pass through the hub."""
    domain, facets = rings(COMM, (0.4, 1.0), (1.0, 1.8), (40, 36), (3, 3))
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    contact = dm.Contact(facets, slave=slave, master=5 - slave)
    problem = create_problem(V, [contact])
    X, R = problem.X, rotation((0.0, 0.0, 1.0), np.radians(degrees))[:2, :2]
    moves = problem.bodies.label == problem.bodies.radius.argmax()
    u = problem.u.x.array[: 2 * problem.n].reshape(-1, 2)
    for shift, passes in ((0.0, False), (4.0, True)):
        u[:] = np.where(moves[:, None], X @ R.T + [shift, 0.0], X) - X
        problem.u.x.scatter_forward()
        assert bool(describe_passing(problem)) == passes


@pytest.mark.mpi
@pytest.mark.parametrize("partition", ["graph", "bodies", "empty"])
def test_what_passes_is_counted_over_the_ranks(partition):
    """A block through a block: the middle behind each facet of its bottom, whoever owns it."""
    case = TwoBodies(
        n_lower=(6, 3), n_upper=(5, 4), heights=(0.5, 0.75), gap=0.1, partition=partition
    )
    case.tags = skins(case.mesh, case.cells, case.facets, keep=())
    problem = case.problem()
    assert not describe_passing(problem)
    slave, master = problem.system.middles[0]
    case.raise_upper(0.0, -2.0)
    found = passing.find_passed(slave, master, fem.Function(case.V), case.u)
    # 6 facets of the top and of the bottom, 3 of each flank have the middle in the way
    assert found.surface is master.surface and found.count == 18
    assert min(abs(found.depth - depth) for depth in (0.25, 0.5)) < 1e-12
    assert "at 18 facets" in describe_passing(problem)


@pytest.mark.mpi
@pytest.mark.parametrize("cell", ["tetrahedron", "hexahedron"])
def test_boxes_in_space(cell):
    """Obliquely through each other, the sides alone; and the same way back."""
    turn = rotation((1.0, 2.0, 3.0), 0.7)
    case = TwoBodies(
        cell, n_lower=(3, 3, 2), n_upper=(2, 3, 2), turn=turn, heights=(0.5, 0.75), gap=0.05
    )
    problem = case.problem(bcs=[])
    for way, passes in (((0.1, 0.2, -1.8), True), ((0.1, 0.2, 1.8), False), ((3, 0, 0), False)):
        case.raise_upper(*(turn @ way))
        assert bool(describe_passing(problem)) == passes


# -- tools -----------------------------------------------------------------------------------------


def on_ball(d, n, radius=0.2):
    """Return a problem of the box [0, 1]^(d-1) x [0, .5] above a ball, and the ball."""
    high = [1.0] * (d - 1) + [0.5]
    case = Box(("triangle", "tetrahedron")[d - 2], [n] * (d - 1) + [2], high=high)
    below = np.array([0.5] * (d - 1) + [-0.3])
    shape = dm.shapes.Cylinder(below, radius) if d == 2 else dm.shapes.Sphere(below, radius)
    ball = dm.Obstacle(case.facets, slave=BASE, shape=shape)
    return case.problem([ball], bcs=()), ball


@pytest.mark.mpi
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("n", [8, 2])
def test_a_tool_and_a_body_that_pass(d, n):
    """Middles of the body in the tool, or the tool's centre where facets are larger than it."""
    problem, ball = on_ball(d, n)
    up, start = np.eye(d)[-1], ball.position.value.copy()
    said = "side has passed through the tool" if n == 8 else "tool has passed through the side"

    def moved(body, tool):
        problem.u.interpolate(lambda x: np.broadcast_to(body[:, None], (d, x.shape[1])))
        ball.position.value[:] = start + tool
        return describe_passing(problem)

    for body, tool in ((-2.0, 0.0), (0.0, 2.0), (-1.0, 1.0), (-0.5, 0.0)):
        assert said in moved(body * up, tool * up)
    if n == 8 and d == 2:  # whose middles, 1/16 and 3/16 beside that of the disc, go through it
        assert "at 4 facets" in moved(-2.0 * up, 0.0 * up)
    aside = np.eye(d)[0]
    for body, tool in ((2.0 * up, 0.0 * up), (40.0 * aside, 0.0 * up), (-40.0 * up, -40.0 * up)):
        assert not moved(body, tool)
    assert not moved(-2.0 * up + 2.0 * aside, 1.5 * aside - 2.0 * up)


def blade(d):
    """Return a blade .02 thick, below the box of `on_ball`, and its end, about which it turns."""
    low, high, end = [-1.0, -1.0, -0.31], [1.8, 2.0, -0.29], [-1.0, -1.0, -0.3]
    if d == 3:
        return dm.shapes.Triangles(box(low, high), point=end)
    sides = np.vstack([np.eye(2), -np.eye(2)])
    ends = [high[::2], high[::2], low[::2], low[::2]]
    planes = [dm.shapes.Plane(p, n) for p, n in zip(ends, sides, strict=True)]
    return dm.shapes.Intersection(*planes)


@pytest.mark.mpi
@pytest.mark.parametrize("d", [2, 3])
def test_a_blade_that_turns_through_a_body(d):
    """By half a turn and more, at whose end nothing tells which way it went."""
    problem, ball = on_ball(d, 4)
    end = np.array([-1.0, -0.3]) if d == 2 else np.array([-1.0, -1.0, -0.3])
    tool = dm.Obstacle(ball.facet_tags, slave=BASE, shape=blade(d), reference=end)
    problem = create_problem(problem.u, [tool])
    about = np.array([0.0, 0.0, 1.0]) if d == 2 else np.array([0.0, -1.0, 0.0])

    def passes(degrees, body=0.0):
        R = rotation(about, np.radians(body))[:d, :d]
        problem.u.interpolate(lambda x: (R - np.eye(d)) @ (x[:d] - end[:, None]))
        tool.rotation.value = np.radians(degrees) * (1.0 if d == 2 else about)
        return "passed through the tool" in describe_passing(problem)

    assert all(passes(degrees) for degrees in (60.0, 180.0, 200.0, 360.0, 1000.0, -360.0, -1085.0))
    assert not any(passes(degrees) for degrees in (-60.0, -180.0, -250.0))
    # against a body that turns, too
    assert not passes(-170.0, 30.0)
    assert passes(180.0, -20.0)
    assert not passes(40.0, 40.0)
    # far away, and from where it is turned already
    tool.position.value[-1] -= 9.0
    passes(400.0)
    tool.restore(tool.state(True))
    assert not passes(800.0)


def test_rotations_go_on_beyond_half_a_turn():
    """As those of tools that loads turn, in steps about an axis that wobbles by round-off."""
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    rotation = np.zeros(3)
    for _ in range(20):
        rotation = tool_poses.after(rotation, 0.5 * axis)
    assert np.abs(rotation - 10.0 * axis).max() < 1e-13
    before, now = (tool_poses.Pose(np.zeros(3), r, np.zeros(3)) for r in (2.9 * axis, rotation))
    assert np.abs(tool_poses.turn_between(before, now) - 7.1 * axis).max() < 1e-13
    other = np.array([0.3, 0.0, 0.0])  # about another axis: less than half a turn
    now = tool_poses.Pose(np.zeros(3), tool_poses.after(2.9 * axis, other), np.zeros(3))
    assert np.abs(tool_poses.turn_between(before, now) - other).max() < 1e-13


@pytest.mark.mpi
def test_a_step_that_ends_beyond_a_tool_is_refused():
    problem, ball = on_ball(2, 8)
    clamped = create_problem(problem.u, [ball], [held(problem.V, ball.facet_tags, TOP)])
    ball.position.value[1] = 1.5
    with pytest.raises(dm.NewtonNotConverged, match="the side has passed through the tool"):
        dm.newton(clamped)
    assert not problem.u.x.array.any()


@pytest.mark.mpi
def test_what_lies_in_a_tool_already_has_not_passed():
    """As the middle of a flattened body, half of its first height behind a side, in another die."""
    problem, _ = on_ball(2, 8, radius=0.6)
    problem.committed.displacement[1::2] = -0.5
    problem.u.interpolate(lambda x: np.stack([0 * x[0] + 0.25, 0 * x[0] - 0.5]))
    assert not describe_passing(problem)
    problem.committed.displacement[1::2] = 0.0
    assert "passed through" in describe_passing(problem)


@pytest.mark.mpi
def test_a_tool_without_a_distance_at_its_point():
    """An oval by its level over the norm of the gradient, which is 0 in the middle."""
    problem, _ = on_ball(2, 8)
    x = ufl.SpatialCoordinate(problem.V.mesh)
    level = (x[0] - 0.5) ** 2 / 0.09 + (x[1] + 0.3) ** 2 / 0.04 - 1.0
    slope = ufl.sqrt(ufl.dot(ufl.grad(level), ufl.grad(level)))
    oval = dm.Obstacle(
        problem.interfaces[0].facet_tags,
        slave=BASE,
        shape=dm.shapes.SignedDistance(level / slope, (0.5, -0.3)),
    )
    problem = create_problem(problem.u, [oval])
    for down, passes in ((0.05, False), (2.0, True)):
        problem.u.x.array[1::2] = -down
        assert ("passed through" in describe_passing(problem)) == passes

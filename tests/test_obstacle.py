# SPDX-License-Identifier: MIT
"""Contact with a rigid analytic tool: patches, Hertz, a meshed body, motion, state, bad input."""

import re
from dataclasses import replace

from mpi4py import MPI

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import dolfinx_mortar as dm
import ufl
from dolfinx import fem, mesh
from dolfinx_mortar.interfaces import obstacle as obstacle_module
from dolfinx_mortar.interfaces.tool import after
from tests.cases.ball import STEEL as STEEL_3D
from tests.cases.ball import create_mesh, create_problem
from tests.cases.pressed_blocks import PressedBlocks, rejected
from tests.cases.tool import DEPTH, ELASTIC, NU, TOP, Block, E, R, fit
from tests.cases.triangles import ball

COMM = MPI.COMM_WORLD
pytestmark = pytest.mark.mpi
STIFFNESS = E / (1 - NU**2)
BAR = dm.Elastic(1000.0, 0.0)
DISC, BALL = dm.shapes.Cylinder([0.0, R], R), dm.shapes.Sphere([0.0, R], R)


@pytest.mark.parametrize("geometry", ["updated", "reference"])
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("angle", [0.0, 0.4])
def test_uniform_pressure_in_the_plane(angle, degree, geometry):
    """To round-off, under an inclined plane too; force and moment are those of the pressure."""
    depth = 0.02
    case = PressedBlocks(angle=angle, jitter=0.2) if degree == 1 else Patch(degree, angle)
    turned = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    x = case.V.tabulate_dof_coordinates()[:, :2] @ turned
    lowest = COMM.allreduce(x[:, 1].min(initial=np.inf), op=MPI.MIN)
    start, normal = turned @ [0.25, lowest], turned @ [0.0, 1.0]
    tool = dm.Obstacle(case.facets, slave=1, shape=dm.shapes.Plane(start, normal))
    tie = dm.Tie(case.facets, slave=3, master=4)
    case.top.value[:] = 0.0
    problem = case.problem([tool, tie], bcs=[case.bc(2, case.top)], law=BAR, geometry=geometry)
    tool.position.value[:] = start + depth * normal
    report = dm.newton(problem)
    p = 1000.0 * depth / 2.0
    on = tool.active.x.array > 0.0
    assert tool.pressure.x.array[on] == pytest.approx(p, rel=1e-9)
    width = np.ptp(COMM.allgather([x[:, 0].min(initial=9.0), x[:, 0].max(initial=-9.0)]))
    assert width > 0.0 and tool.force @ turned == pytest.approx([0.0, p], abs=1e-9)
    assert tool.tool_force == pytest.approx(-tool.force, abs=1e-12)
    middle = turned @ [0.5, lowest]  # where the resultant acts
    arm = middle - tool.position.value
    moment = arm[0] * tool.tool_force[1] - arm[1] * tool.tool_force[0]
    assert tool.tool_moment == pytest.approx([0.0, 0.0, moment], abs=1e-9)
    assert dm.reaction(problem, 2, facet_tags=case.facets).force == pytest.approx(
        tool.tool_force, abs=1e-8
    )
    certificate = report.certificate
    assert max(certificate.gap, certificate.sign, certificate.complementarity) < 1e-12
    assert certificate.force_balance < 1e-10 and not report.notes


class Patch(PressedBlocks):
    """The same two blocks with displacements of second order."""

    def __init__(self, degree, angle):
        """Create them."""
        super().__init__(angle=angle, jitter=0.2)
        self.V = fem.functionspace(self.mesh, ("Lagrange", degree, (2,)))
        self.u = fem.Function(self.V)


def box(cell, degree, turned):
    """Return mesh, tags (1 below, 2 on top) and displacement of a turned box with uneven cells."""
    domain = mesh.create_box(COMM, [[0.0] * 3, [1.0] * 3], [2, 2, 1], getattr(mesh.CellType, cell))
    facets, values = [], []
    for tag, z in ((1, 0.0), (2, 1.0)):
        found = mesh.locate_entities_boundary(domain, 2, lambda x, z=z: np.isclose(x[2], z))
        facets.append(found)
        values.append(np.full(len(found), tag, dtype=np.int32))
    order = np.argsort(np.concatenate(facets))
    tags = mesh.meshtags(domain, 2, np.concatenate(facets)[order], np.concatenate(values)[order])
    x = domain.geometry.x
    x[:, 0] = x[:, 0] ** 1.3 + 0.1 * x[:, 0] * x[:, 1] * (1.0 - x[:, 0])
    x[:] = x @ turned.T
    V = fem.functionspace(domain, ("Lagrange", degree, (3,)))
    return tags, fem.Function(V)


@pytest.mark.parametrize(
    ("cell", "degree"),
    [("tetrahedron", 1), ("hexahedron", 1)]
    + [pytest.param(cell, 2, marks=pytest.mark.slow) for cell in ("tetrahedron", "hexahedron")],
)
def test_uniform_pressure_in_space(cell, degree):
    """Facets of all types, six-node triangles with their dependent nodes as well."""
    turned = np.linalg.qr(np.random.default_rng(4).standard_normal((3, 3)))[0]
    turned *= np.linalg.det(turned)
    tags, u = box(cell, degree, turned)
    V, normal = u.function_space, turned[:, 2]
    tool = dm.Obstacle(tags, slave=1, shape=dm.shapes.Plane(np.zeros(3), normal))
    top = fem.locate_dofs_topological(V, 2, tags.find(2))
    problem = dm.ContactProblem(
        dm.Solid(u, BAR), [tool], bcs=[fem.dirichletbc(np.zeros(3), top, V)]
    )
    tool.position.value[:] = 0.01 * normal
    dm.newton(problem, rtol=1e-10)
    found = tool.gather(u)
    assert found["pressure"] == pytest.approx(10.0, rel=1e-8)
    area = float(COMM.allreduce(0.0)) + 1.0
    assert tool.force == pytest.approx(10.0 * area * normal, abs=1e-8)


def hertz(case, shape, kinematics="plane_strain", **options):
    """Press a rigid disc or ball by DEPTH; return tool, report and what Hertz finds at its force.

    Johnson (1985), Contact Mechanics, eqs. 4.45 and 4.22 to 4.24, with 1/E* = (1 - nu^2)/E.
    """
    tool = case.tool(shape)
    problem = case.problem([tool], kinematics=kinematics, **options)
    tool.position.value[:] = tool.position.value - DEPTH * case.unit * case.turned[:, 1]
    report = dm.newton(problem)
    force = -float(tool.force @ case.turned[:, 1])
    if kinematics == "plane_strain":
        load = 2 * force / case.unit  # of both halves
        a = np.sqrt(4 * load * R / (np.pi * STIFFNESS))
        return tool, report, (a, 2 * load / (np.pi * a))
    load = force / case.unit**2
    a = (3 * load * R / (4 * STIFFNESS)) ** (1 / 3)
    return tool, report, (a, 3 * load / (2 * np.pi * a**2))


@pytest.mark.parametrize("geometry", ["updated", "reference"])
@pytest.mark.parametrize(
    ("shape", "kinematics", "least"), [(DISC, "plane_strain", 1.2), (BALL, "axisymmetric", 2.0)]
)
def test_hertz(shape, kinematics, least, geometry):
    """Half width and peak pressure of a line and a point contact, to 2 %, nine nodes or more."""
    case = Block(n=40, fine=0.6)
    tool, report, (a, peak) = hertz(case, shape, kinematics, geometry=geometry)
    half_width, pressure = fit(tool, case.u) if COMM.size == 1 else (a, peak)
    assert half_width == pytest.approx(a, rel=0.02)
    assert pressure == pytest.approx(peak, rel=0.015)
    # of a ball, no moment about its centre: all normals pass through it
    assert np.abs(tool.tool_moment).max() < 1e-9
    assert report.newton_iterations <= 4 and -tool.force[1] > least / 2


def test_units_and_rotation():
    """The same problem turned, and in another unit of length."""
    forces = []
    for angle, unit in ((0.0, 1.0), (0.7, 1.0), (0.7, 1e-3)):
        case = Block(n=12, fine=0.6, angle=angle, unit=unit)
        case.bcs = lambda case=case: clamped(case)
        shape = dm.shapes.Cylinder(unit * (case.turned @ [3.0, R]), unit * R)
        tool, *_ = hertz(case, shape)
        forces.append(tool.force @ case.turned / unit)
        assert np.abs(tool.tool_moment).max() < 1e-9 * unit**2
    assert forces[1] == pytest.approx(forces[0], rel=1e-9, abs=1e-9)
    assert forces[2] == pytest.approx(forces[0], rel=1e-9, abs=1e-9)


def clamped(case):
    """Clamp the base, leave the axis free."""
    base = fem.locate_dofs_topological(case.V, 1, case.facets.find(1))
    return [fem.dirichletbc(np.zeros(2), base, case.V)]


def test_as_a_meshed_body_a_million_times_stiffer():
    """A soft block that bulges under its load, on a stiff one, and on the plane of its top."""
    found = []
    for rigid in (False, True):
        case = PressedBlocks(jitter=0.2, n_upper=(7, 3), x_upper=(0.2, 0.8))
        solid = dm.Solid(case.u, {1: dm.Elastic(1e6 * E, NU), 2: ELASTIC}, case.cells)
        plane = dm.shapes.Plane([0.0, 0.0], [0.0, 1.0])
        kind = dm.Obstacle if rigid else dm.Contact
        with_what = {"shape": plane} if rigid else {"master": 3}
        contact = kind(case.facets, slave=4, friction=0.1, **with_what)
        case.top.value[:] = 0.0, -0.03
        problem = dm.ContactProblem(solid, [contact], bcs=case.bcs(), geometry="reference")
        dm.newton(problem, rtol=1e-9)
        found.append(contact)
    meshed, rigid = found
    assert rigid.force == pytest.approx(meshed.force, rel=1e-5, abs=1e-5 * meshed.force[1])
    pressure = meshed.pressure.x.array
    assert np.ptp(pressure[meshed.active.x.array > 0.0]) > 0.05 * pressure.max() or COMM.size > 1
    assert rigid.pressure.x.array == pytest.approx(pressure, rel=1e-4, abs=1e-5)
    traction = meshed.traction.x.array
    assert rigid.traction.x.array == pytest.approx(traction, rel=1e-4, abs=1e-5)


@pytest.mark.serial
@pytest.mark.slow
@pytest.mark.parametrize(("degree", "h"), [(2, 0.1), (1, 0.05)])
def test_as_a_meshed_disc_a_million_times_stiffer(degree, h):
    """A curved one: the force to 1e-4; with parabolic facets, which are nearly round, the peak too.

    Of first order the meshed disc is a polygon, and so is the tool: a round one has 6e-4 more.
    """
    tagged = dm.meshing.hertz(COMM, kind="graded", h=h, half=True)
    facets, found = tagged.facet_tags, []
    V = fem.functionspace(tagged.mesh, ("Lagrange", degree, (2,)))

    def dofs(W, name):
        return fem.locate_dofs_topological(W, 1, facets.find(facets.names[name]))

    shape = dm.shapes.Cylinder([0.0, R], R)
    if degree == 1:
        arc = V.tabulate_dof_coordinates()[dofs(V, "arc"), :2]
        arc = arc[np.argsort(arc[:, 0])]
        shape = dm.shapes.Polyline([*(arc[:0:-1] * [-1, 1]), *arc], closed=False, crease=0.0)
    for contact in (
        dm.Contact(facets, slave="top", master="arc"),
        dm.Obstacle(facets, slave="top", shape=shape),
    ):
        if isinstance(contact, dm.Obstacle):
            contact.position.value[1] -= 0.05
        laws = {"block": ELASTIC, "disc": dm.Elastic(1e6 * E, NU)}
        values = ("bottom", np.zeros(2)), ("flat", np.array([0.0, -0.05]))
        bcs = [fem.dirichletbc(value, dofs(V, name), V) for name, value in values]
        bcs.append(fem.dirichletbc(0.0, dofs(V.sub(0), "axis"), V.sub(0)))
        solid = dm.Solid(fem.Function(V), laws, tagged.cell_tags)
        dm.newton(dm.ContactProblem(solid, [contact], bcs=bcs), rtol=1e-9)
        found.append((contact.force[1], contact.pressure.x.array.max()))
    assert found[1][0] == pytest.approx(found[0][0], rel=1e-4)
    assert degree == 1 or found[1][1] == pytest.approx(found[0][1], rel=1e-4)


@pytest.mark.serial
@pytest.mark.slow
def test_hertz_in_space():
    """Radius and peak of a ball with four facets across the radius; of its STL file the same."""
    meshed, _ = create_problem(h=0.15, depth=0.0)
    tags, centre, forces = create_mesh(0.15, "hexahedron").facet_tags, (0.0, 0.0, 8.0), []
    shapes = dm.shapes.Sphere(centre, 8.0), dm.shapes.Triangles(ball(4, 8.0, centre))
    for shape in shapes:
        meshed.solid.u.x.array[:] = 0.0
        tool = dm.Obstacle(tags, slave="top", shape=shape)
        problem = dm.ContactProblem(meshed.solid, [tool], bcs=meshed.bcs)
        tool.position.value[2] -= 0.05
        assert dm.newton(problem).newton_iterations <= 4
        forces.append(4.0 * abs(tool.force[2]))
    found = tool.gather(problem.u)
    on = found["active"] > 0.0
    r = np.hypot(*found["x"][on, :2].T)
    peak, radius = dm.analytic.fit_pressure(r, found["pressure"][on])
    exact = dm.analytic.hertz_point(forces[0], 8.0, STEEL_3D.E, STEEL_3D.nu, 1e9 * E, 0.0)
    assert radius == pytest.approx(exact.contact_radius, rel=0.04)
    assert peak == pytest.approx(exact.peak_pressure, rel=0.03)
    assert forces[1] == pytest.approx(forces[0], rel=1e-4)


@pytest.mark.serial
@pytest.mark.slow
def test_a_plane_is_a_rigid_block_without_pairs():
    """A disc on both: the same force, and nothing is searched, clipped and sent for the plane."""
    tagged = dm.meshing.hertz(COMM, kind="graded", h=0.05, half=True)
    V = fem.functionspace(tagged.mesh, ("Lagrange", 1, (2,)))
    facets, forces, paired = tagged.facet_tags, [], []
    plane = dm.shapes.Plane([0.0, 0.0], [0.0, 1.0])
    for contact in (
        dm.Contact(facets, slave="arc", master="top"),
        dm.Obstacle(facets, slave="arc", shape=plane),
    ):
        u = fem.Function(V)
        laws = {"block": dm.Elastic(1e6 * E, NU), "disc": ELASTIC}
        values = ("bottom", np.zeros(2)), ("flat", np.array([0.0, -0.05]))
        bcs = [
            fem.dirichletbc(
                value, fem.locate_dofs_topological(V, 1, facets.find(facets.names[name])), V
            )
            for name, value in values
        ]
        axis = fem.locate_dofs_topological(V.sub(0), 1, facets.find(facets.names["axis"]))
        bcs.append(fem.dirichletbc(0.0, axis, V.sub(0)))
        problem = dm.ContactProblem(dm.Solid(u, laws, tagged.cell_tags), [contact], bcs=bcs)
        dm.newton(problem)
        (link,) = problem.system.links
        paired.append(link.pairing is not None)
        forces.append(-contact.force[1])
    assert forces[1] == pytest.approx(forces[0], rel=1e-3)  # whose normals are those of the disc
    assert paired == [True, False]


STEEL = dm.VonMises(E, NU, 0.3, 10.0)


def press(case, problem, tool, levels, **options):
    """Press by a ramp, lift and press again; return the forces."""
    down = tool.reference - DEPTH * np.array([0.0, 3.0])
    ramp = {tool.position: [(0.0, tool.reference), (1.0, down), (2.0, tool.reference), (3.0, down)]}
    return [tool.force.copy() for _ in dm.load_steps(problem, levels, ramp=ramp, **options)]


def start(**options):
    """Return a block, a tool and a problem."""
    case = Block(n=12, fine=0.6)
    tool = case.tool(DISC, **options)
    return case, tool, case.problem([tool], law=STEEL)


def test_a_walk_goes_on_from_a_checkpoint(tmp_path):
    """A plastic one with friction, loaded by a ramp, to the last digits."""
    path = COMM.bcast(tmp_path / "state.h5")
    levels = [0.5, 1.0, 2.0, 3.0]
    case, tool, problem = start(friction=0.3)
    whole = press(case, problem, tool, levels)
    assert np.abs(whole[2]).max() < 1e-9 < np.abs(whole[1]).max()  # lifted
    assert np.abs(tool.slip.x.array).max() >= 0.0
    case, tool, problem = start(friction=0.3)
    first = press(case, problem, tool, levels[:2])
    problem.save(path)
    moment = tool.tool_moment
    case, tool, problem = start(friction=0.3)
    problem.restore(path)
    assert tool.tool_moment == pytest.approx(moment, rel=1e-12, abs=1e-14)
    assert tool.tool.began.position == pytest.approx(tool.reference - [0.0, 3.0 * DEPTH])
    rest = press(case, problem, tool, levels[2:])
    assert np.array([*first, *rest]) == pytest.approx(np.array(whole), rel=1e-9, abs=1e-11)
    with rejected("surface='smooth'", "a checkpoint of another problem"):
        start(friction=0.3, surface="smooth")[2].restore(path)


@pytest.mark.serial
@pytest.mark.slow
def test_a_step_that_fails_is_cut():
    """The tool is where a level has it, not where the step that failed had it."""
    _, tool, problem = start()
    assert problem.constants()  # a ramp knows that the tool reads its Constants
    step = press_once(problem, tool, depth=10 * DEPTH, apart=0.05, max_it=6)[-1]
    assert step.report.converged and step.report.cuts > 0
    notes = [note for part in step.parts for note in part.notes]
    assert not any("overlap" in note or "ramp" in note for note in notes)
    _, other, whole = start()
    press_once(whole, other, depth=10 * DEPTH, apart=0.05)
    assert tool.force == pytest.approx(other.force, rel=0.06)


def press_once(problem, tool, depth=3 * DEPTH, apart=0.0, **options):
    """Press in one step, from so far above."""
    up, down = (tool.reference + np.array([0.0, way]) for way in (apart, -depth))
    tool.position.value[:] = up
    ramp = {tool.position: [(0.0, up), (1.0, down)]}
    return [*dm.load_steps(problem, [1.0], ramp=ramp, progress=False, **options)]


def test_it_is_written_and_summed_up(tmp_path):
    """Like any interface."""
    path = COMM.bcast(tmp_path / "steps.xdmf")
    _, tool, problem = start(friction=0.3)
    with dm.Writer(path, problem) as writer:
        for step in press_once(problem, tool):
            writer.write(step.time)
    assert path.exists()
    fields = problem.output_fields()
    closed = tool.active.x.array > 0.0
    assert fields["pressure"].x.array[closed] == pytest.approx(tool.pressure.x.array[closed])
    audit = str(problem.audit())
    assert "Obstacle(slave=3, friction=0.3, shape=Cylinder)" in audit


def test_two_tools_share_a_side(monkeypatch):
    """Each node belongs to the tool that it faces, wherever the other one is."""
    case = Block(n=24, fine=3.0)
    shapes = [dm.shapes.Cylinder([x, 1.0], 1.0) for x in (2.0, 6.5)]
    alone = []
    for shape in shapes:
        case.u.x.array[:] = 0.0
        tool = case.tool(shape)
        problem = case.problem([tool])
        tool.position.value[1] -= DEPTH
        dm.newton(problem)
        alone.append(-tool.force[1])
    case.u.x.array[:] = 0.0
    tools = [case.tool(shape) for shape in shapes]
    problem = case.problem(tools)
    for tool in tools:
        tool.position.value[1] -= DEPTH
    dm.newton(problem)
    both = [-tool.force[1] for tool in tools]
    assert both == pytest.approx(alone, rel=0.2) and min(both) > 0.0
    monkeypatch.setattr(obstacle_module, "FACETS", 1e3)  # the first one takes all
    case.u.x.array[:] = 0.0
    tools = [case.tool(shape) for shape in shapes]
    problem = case.problem(tools)
    for tool in tools:
        tool.position.value[1] -= DEPTH
    dm.newton(problem)
    assert tools[1].force == pytest.approx(np.zeros(2), abs=1e-12)


@pytest.mark.serial
def test_a_tip_between_nodes_is_noted():
    """Sharper than the facets: how deep, and where; not where there are enough of them."""
    for fine, radius, depth, noted in ((8.0, 0.02, 0.15, True), (0.5, 0.5, 0.01, False)):
        case = Block(n=16, fine=fine)
        tool = case.tool(dm.shapes.Wedge([0.27, 0.0], 30.0, [0.0, 1.0], radius))
        problem = case.problem([tool])
        tool.position.value[1] -= depth
        notes = dm.newton(problem).notes
        assert any("deep in each other" in note for note in notes) == noted


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("share", [0.02, 0.3])
def test_a_ball_smaller_than_a_facet_is_noted(d, share):
    """It sinks in beside all points of integration, without any force."""
    tagged, h = on_grid(d), 0.25
    centre = np.array([0.5 + 0.37 * h] * (d - 1) + [0.0])
    ball = (dm.shapes.Cylinder if d == 2 else dm.shapes.Sphere)(centre, share * h)
    tags, u = tagged
    tool = dm.Obstacle(tags, slave=2, shape=ball)
    base = fem.locate_dofs_topological(u.function_space, d - 1, tags.find(1))
    held = [fem.dirichletbc(np.zeros(d), base, u.function_space)]
    problem = dm.ContactProblem(dm.Solid(u, ELASTIC), [tool], bcs=held)
    tool.position.value[d - 1] = (share - 0.02) * h  # nearly in touch
    assert not any("deep in" in note for note in dm.newton(problem).notes)
    tool.position.value[d - 1] = (share - 0.3) * h
    assert any("deep in" in note for note in dm.newton(problem).notes)


def on_grid(d):
    """Return tags and u of a box [0, 1]^(d-1) x [-1, 0] of four cells each way."""
    make = mesh.create_rectangle if d == 2 else mesh.create_box
    domain = make(COMM, [[0.0] * (d - 1) + [-1.0], [1.0] * (d - 1) + [0.0]], [4] * d)
    facets, values = [], []
    for tag, y in ((1, -1.0), (2, 0.0)):
        found = mesh.locate_entities_boundary(domain, d - 1, lambda x, y=y: np.isclose(x[d - 1], y))
        facets.append(found)
        values.append(np.full(len(found), tag, dtype=np.int32))
    order = np.argsort(np.concatenate(facets))
    marks = np.concatenate(facets)[order], np.concatenate(values)[order]
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (d,))))
    return mesh.meshtags(domain, d - 1, *marks), u


# -- bad input -----------------------------------------------------------------------------------


def obstacle(**options):
    """Return a tool on a small block, which says what is wrong with it."""
    case = Block(n=2)
    given = {"slave": TOP, "shape": DISC} | options
    return case, dm.Obstacle(case.facets, **given)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"slave": "lid"}, ("lid",)),
        ({"slave": 2.5}, ("slave is 2.5",)),
        ({"shape": "ball"}, ("shape is 'ball'", "dolfinx_mortar.shapes")),
        ({"shape": dm.shapes.Sphere([0.0, 0.0, 1.0], 1.0)}, ("3 coordinates", "the mesh has 2")),
        ({"reference": [0.0, 0.0, 0.0]}, ("reference", "2 finite")),
        ({"reference": ("a", "b")}, ("reference", "2 finite")),
        ({"surface": "round"}, ("surface is 'round'", "'smooth' or 'facets'")),
        ({"friction": -0.1}, ("friction is -0.1",)),
        ({"friction": 0.1, "tresca": 1.0}, ("friction", "tresca")),
    ],
)
def test_what_is_no_obstacle(options, words):
    with rejected(*words):
        obstacle(**options)


@pytest.mark.parametrize(
    ("options", "problem", "words"),
    [
        ({"slave": 77}, {}, ("slave=77", "marks no facet")),
        ({"shape": BALL}, {}, ("shape: Sphere", "give a Cylinder")),
        ({}, {"kinematics": "axisymmetric"}, ("shape: Cylinder", "Sphere or a Torus")),
    ],
)
def test_what_no_problem_can_take(options, problem, words):
    case, tool = obstacle(**options)
    with rejected(*words):
        case.problem([tool], **problem)


def test_where_a_tool_cannot_be():
    """NaN, off the axis, and in the body from the start: how deep, and where."""
    case, tool = obstacle()
    problem = case.problem([tool])
    tool.position.value[1] = np.nan
    with rejected("position is [0.0, nan]", "finite"):
        dm.newton(problem)
    case, tool = obstacle(shape=BALL)
    problem = case.problem([tool], kinematics="axisymmetric")
    tool.position.value[0] = 0.1
    with rejected("position is [0.1, 8.0]", "along the axis only"):
        dm.newton(problem)
    case, tool = obstacle(shape=dm.shapes.Plane([0.0, 0.0], [0.0, -1.0]))
    assert not case.problem([tool]).audit().warnings
    case, tool = obstacle(shape=dm.shapes.Plane([0.0, 0.0], [0.0, 1.0]))
    warnings = case.problem([tool]).audit().warnings
    assert any("no facet of the side faces the tool" in warning for warning in warnings)
    tool.position.value[1] -= DEPTH
    (note,) = dm.newton(case.problem([tool])).notes  # without an audit
    assert "no slave node carries a multiplier" in note and "Plane" in note
    case, tool = obstacle(shape=dm.shapes.Plane([0.0, -20.0], [0.0, -1.0]))
    problem = case.problem([tool])
    with rejected("Obstacle", "20 deep", "reverse it"):
        problem.audit()
    case = Block(n=8)
    tool = case.tool(dm.shapes.Cylinder([0.0, 1.0], 5.0))
    warnings = case.problem([tool]).audit().warnings
    assert any("4 deep in the body around" in warning for warning in warnings)


@pytest.mark.parametrize("slope", [0.95, 1.05, 0.8, 2.0])
def test_what_is_no_distance(slope):
    """A level set that is none: how far off, where, and what to give instead."""
    shape = dm.shapes.SignedDistance(lambda x: -slope * (x[1] - 0.01), [0.0, 0.0], length=1.0)
    case, tool = obstacle(shape=shape)
    problem = case.problem([tool])
    if abs(slope - 1.0) < 0.1:
        assert dm.newton(problem).converged
        return
    with rejected("phi is no distance", f"abs(grad phi) is {slope:g}", "phi / abs(grad phi)"):
        dm.newton(problem)


def test_a_distance_in_ufl():
    """Hertz with a ball in UFL, about the axis: the numbers of the shape to 1e-12."""
    results = []
    for given in (False, True):
        case = Block(n=16)
        x = ufl.SpatialCoordinate(case.mesh)
        phi = ufl.sqrt(x[0] ** 2 + (x[1] - R) ** 2) - R
        tool = case.tool(dm.shapes.SignedDistance(phi, [0.0, R]) if given else BALL)
        problem = case.problem([tool], kinematics="axisymmetric")
        tool.position.value[1] -= DEPTH
        report = dm.newton(problem, rtol=1e-10)
        parts = tool.tool_force, tool.pressure.x.array, tool.gap.x.array, case.u.x.array
        results.append((report.newton_iterations, *(part.copy() for part in parts)))
    (count, *found), (other, *expected) = results
    assert count == other
    for one, of_shape in zip(found, expected, strict=True):
        assert one == pytest.approx(
            of_shape, rel=1e-12, abs=1e-12 * np.abs(of_shape).max(initial=0)
        )
    with rejected("phi is no distance", "abs(grad phi) is 16"):
        x = ufl.SpatialCoordinate(case.mesh)
        square = x[0] ** 2 + (x[1] - R) ** 2 - R**2
        tool = case.tool(dm.shapes.SignedDistance(square, [0.0, R]))
        dm.newton(case.problem([tool], kinematics="axisymmetric"))


def ring_on_a_shaft(cell, n, degree=2, uneven=0.0, surface=None):
    """Return pressure over Lame's at the bore of a quarter of a ring of straight cells, and notes.

    Angles of nodes at the bore are off by up to a share `uneven` of a facet.
    The shaft is thicker than the bore a = 1 by d, the ring is b = 2 outside, in plane strain:
    p = E d (b^2 - a^2) / ((1 + nu) a ((1 - 2 nu) a^2 + b^2)).
    """
    d, flat = 2e-3, cell in ("triangle", "quadrilateral")
    ends, counts = ([1.0, 1.0], [n // 2, n]) if flat else ([1.0, 1.0, 0.2], [n // 2, n, 1])
    make = mesh.create_rectangle if flat else mesh.create_box
    domain = make(COMM, [np.zeros(len(ends)), ends], counts, mesh.CellType[cell])
    fdim = len(ends) - 1
    bore, *planes = (
        mesh.locate_entities_boundary(domain, fdim, lambda x, i=i, v=v: np.isclose(x[i], v))
        for i, v in ((0, 0.0), (1, 0.0), (1, 1.0))
    )
    tags = mesh.meshtags(domain, fdim, np.sort(bore), np.ones(len(bore), dtype=np.int32))
    r, t = 1.0 + domain.geometry.x[:, 0], domain.geometry.x[:, 1].copy()
    off = np.random.default_rng(0).uniform(-uneven, uneven, n + 1) * [0.0, *np.ones(n - 1), 0.0]
    t = np.pi / 2 * (t + (2.0 - r) * off[np.rint(n * t).astype(int)] / n)
    domain.geometry.x[:, :2] = np.stack([r * np.cos(t), r * np.sin(t)], axis=1)
    V = fem.functionspace(domain, ("Lagrange", degree, (len(ends),)))
    dofs = [
        fem.locate_dofs_topological(V.sub(i), fdim, facets)
        for i, facets in zip((1, 0), planes, strict=True)
    ]
    if not flat:
        W = V.sub(2)
        every = fem.locate_dofs_geometrical((W, W.collapse()[0]), lambda x: x[0] > -1.0)
        dofs.append(every[0])
    zeros = zip((1, 0, 2), dofs, strict=False)
    bcs = [fem.dirichletbc(0.0, held, V.sub(i)) for i, held in zeros]
    axis = () if flat else ([0.0, 0.0, 1.0],)
    shaft = dm.shapes.Cylinder(np.zeros(len(ends)), 1.0 + d, *axis)
    tool, u = dm.Obstacle(tags, slave=1, shape=shaft, surface=surface), fem.Function(V)
    report = dm.newton(dm.ContactProblem(dm.Solid(u, ELASTIC), [tool], bcs=bcs), rtol=1e-8)
    found, exact = tool.gather(u), E * d * 3.0 / ((1.0 + NU) * (5.0 - 2.0 * NU))
    return found["pressure"][found["active"] > 0.0] / exact, report.notes


@pytest.mark.parametrize(
    ("cell", "n", "bar"),
    [
        *(("quadrilateral", 8, 0.04), ("triangle", 16, 0.02)),
        *(("hexahedron", 16, 0.02), ("tetrahedron", 16, 0.07)),
    ],
)
def test_straight_facets_stand_for_a_round_bore(cell, n, bar):
    """On the shaft in it; mid-side nodes are 2.4 (n = 8) and 0.6 d (n = 16) off the circle at X.

    By the facets alone some nodes are open, and others have a multiple of the pressure.
    """
    assert ring_on_a_shaft(cell, n)[0] == pytest.approx(1.0, abs=bar)


@pytest.mark.parametrize("cell", ["quadrilateral", "hexahedron"])
def test_facets_of_first_order_on_a_round_tool(cell):
    """As smooth surfaces; by the facets alone 1.40 times Lame's force, 1.54 if they are uneven."""
    for uneven in (0.0, 0.3):
        pressure, notes = ring_on_a_shaft(cell, 16, 1, uneven)
        assert pressure == pytest.approx(1.0, abs=0.01) and notes == []
    pressure, notes = ring_on_a_shaft(cell, 16, 1, 0.3, "facets")
    assert pressure.max() > 3.0 and "surface='smooth'" in notes[0].why


@pytest.mark.parametrize(
    ("cell", "n"), [("quadrilateral", 8), ("quadrilateral", 64), ("hexahedron", 16)]
)
def test_even_facets_on_a_round_tool(cell, n):
    """Lame's force is 2.6, 1.02 and 1.4 times too large, as a note says from 5 % on."""
    pressure, notes = ring_on_a_shaft(cell, n, 1, 0.0, "facets")
    wrong = 1.0 - 1.0 / pressure.mean()
    said = [re.search(r"up to (\d+) % of the contact forces", note) for note in notes]
    assert [int(found[1]) for found in said] == [round(100.0 * wrong)] * int(wrong > 0.05)


@pytest.mark.parametrize("x", [0.2, 0.75])
def test_facets_of_a_side_that_is_partly_round(x):
    """A disc stands off the facets of its trough; what dips into a flat part does not."""
    domain = mesh.create_rectangle(COMM, [[0.0, -1.0], [1.0, 0.0]], [32, 16])
    bottom, top = (
        mesh.locate_entities_boundary(domain, 1, lambda x, y=y: np.isclose(x[1], y))
        for y in (-1.0, 0.0)
    )
    tags = mesh.meshtags(domain, 1, np.sort(top), np.ones(len(top), dtype=np.int32))
    points = domain.geometry.x
    points[:, 1] += (points[:, 1] + 1.0) * np.maximum(0.0, points[:, 0] - 0.5) * (points[:, 0] - 1)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    held = fem.locate_dofs_topological(V, 1, bottom)
    low = max(0.0, x - 0.5) * (x - 1.0)
    disc = dm.shapes.Cylinder([x, low + 0.4], 0.4)
    tool, u = dm.Obstacle(tags, slave=1, shape=disc, surface="facets"), fem.Function(V)
    tool.position.value[1] -= 0.001
    solid, bcs = dm.Solid(u, ELASTIC), [fem.dirichletbc(np.zeros(2), held, V)]
    report = dm.newton(dm.ContactProblem(solid, [tool], bcs=bcs))
    assert any("facets of curved sides" in note for note in report.notes) == (x > 0.5)


@pytest.mark.parametrize("cell", ["quadrilateral", "hexahedron"])
def test_a_tool_that_fits_is_not_sharp(cell):
    """Chords of 4 uneven facets leave the circle by up to .08 of their length."""
    pressure, notes = ring_on_a_shaft(cell, 4, 1, 0.45)
    assert pressure == pytest.approx(1.0, abs=0.04) and notes == []


def test_a_flat_side_is_its_facets():
    """By default: what of a tool is between its nodes counts."""
    forces = []
    for surface in (None, "facets", "smooth"):
        case = Block(n=8, angle=0.3)
        centre = case.turned @ [0.0, R]
        tool = case.tool(dm.shapes.Cylinder(centre, R), surface=surface)
        tool.position.value[:] -= DEPTH * case.turned[:, 1]
        dm.newton(case.problem([tool]))
        forces.append(tool.tool_force)
    assert forces[0] == pytest.approx(forces[1], rel=1e-12)
    assert forces[0] != pytest.approx(forces[2], rel=1e-3)


def test_facets_of_second_order_may_be_what_is_meant():
    """The shaft is then met by some nodes alone."""
    assert ring_on_a_shaft("quadrilateral", 8, surface="facets")[0].max() > 1.5


def test_hertz_of_a_round_body_of_second_order():
    """A disc of straight cells on a plane; by its facets alone pressures are off by 17 %."""
    tagged = dm.meshing.hertz(COMM, kind="graded", h=0.1, half=True)
    facets = tagged.facet_tags
    V = fem.functionspace(tagged.mesh, ("Lagrange", 2, (2,)))
    values = [("bottom", np.zeros(2)), ("flat", np.array([0.0, -0.02]))]
    held = [(V, name, value) for name, value in values] + [(V.sub(0), "axis", 0.0)]
    bcs = []
    for W, name, value in held:
        dofs = fem.locate_dofs_topological(W, 1, facets.find(facets.names[name]))
        bcs.append(fem.dirichletbc(value, dofs, W))
    tool = dm.Obstacle(facets, slave="arc", shape=dm.shapes.Plane([0.0, 0.0], [0.0, 1.0]))
    u = fem.Function(V)
    dm.newton(dm.ContactProblem(dm.Solid(u, ELASTIC), [tool], bcs=bcs), rtol=1e-8)
    force, found = 2.0 * tool.force[1], tool.gather(u)
    a = np.sqrt(4.0 * force * R / (np.pi * STIFFNESS))
    peak, x = 2.0 * force / (np.pi * a), np.abs(found["x"][:, 0]) / a
    inside = x < 0.8
    expected = peak * np.sqrt(1.0 - x[inside] ** 2)
    assert found["pressure"][inside] == pytest.approx(expected, abs=0.015 * peak)


def test_rotations_keep_whole_turns():
    """A tool that loads turn on and on goes on, about any axis, past one turn and through two."""
    for axis in ([0.0, 0.0, 1.0], [0.6, 0.0, -0.8], [2 / 3, -1 / 3, 2 / 3]):
        turn, axis = np.zeros(3), np.array(axis)
        for step in (6.0, 1.0, 4 * np.pi - 7.0, 0.5, -0.5, -4 * np.pi - 1.0):
            expected = turn + step * axis
            turn = after(turn, step * axis)
            assert turn == pytest.approx(expected, abs=1e-7)
    # about another axis: the rotation is that of both, with the turns that are nearest
    turn = after(np.array([0.0, 0.0, 7.0]), np.array([1e-3, 0.0, 0.0]))
    both = Rotation.from_rotvec([1e-3, 0.0, 0.0]) * Rotation.from_rotvec([0.0, 0.0, 7.0])
    assert (Rotation.from_rotvec(turn) * both.inv()).magnitude() < 1e-12
    assert np.linalg.norm(turn) == pytest.approx(7.0, abs=1e-5)


def test_what_a_tool_does_is_undone_when_it_rolls_back():
    """Its way at points that slide on it, by which its work is told, is the opposite then."""
    case, rng = Block(n=4), np.random.default_rng(4)
    tool = case.tool(DISC)
    tool.take(None, case.V)
    before, after_ = rng.uniform(-1.0, 1.0, (2, 30, 2))
    tool.position.value[:], tool.rotation.value = (0.7, R), 0.8
    way = tool.tool.way(before, after_)
    carried = tool.tool.pose().to_space(tool.tool.began.to_tool(before))
    assert tool.tool.way(before, carried) == pytest.approx(carried - before, abs=1e-13)
    tool.restore(tool.state(True))
    tool.position.value[:], tool.rotation.value = (0.0, R), 0.0
    assert tool.tool.way(after_, before) == pytest.approx(-way, abs=1e-13)


class Half(dm.shapes.Shape):
    """The half space y > 0 of a user, with something else at points on the right."""

    point = np.zeros(2)

    def __init__(self, change):
        """Keep how a distance is changed, by the points where it is."""
        self.change = change

    def given(self):
        """Return nothing."""
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
    ("change", "kind", "told"),
    [
        (part("value", np.nan), ValueError, "Half: the value of its distance is NaN or inf"),
        (part("gradient", np.nan), ValueError, "Half: the gradient of its distance is NaN or inf"),
        (part("hessian", np.inf), ValueError, "Half: the hessian of its distance is NaN or inf"),
        (lambda found, _: None, ValueError, "Half.distance() is None: return a shapes.Distance"),
        (
            lambda found, _: replace(found, gradient=found.gradient[:, :1]),
            ValueError,
            "Half: the gradient of its distance is [[",
        ),
        (fails, (KeyError, RuntimeError), "no such point"),
    ],
)
def test_a_shape_of_a_user_that_fails_somewhere(change, kind, told):
    """Contact is not lost in silence, and no rank waits for one where it fails."""
    case = Block(n=8)
    tool = case.tool(Half(change))
    problem = case.problem([tool])
    tool.position.value[1] = -0.02
    with rejected(told, error=kind):
        dm.newton(problem)
    assert not case.u.x.array.any()

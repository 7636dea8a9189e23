# SPDX-License-Identifier: MIT
"""A node in the corner between two interfaces, which one of them gets: answers and notes."""

import numpy as np
import pytest

import basix.ufl
import dolfinx
import dolfinx_mortar as dm
import ufl
from dolfinx import fem, mesh
from dolfinx_mortar import compat
from tests.cases.meshes import BOTTOM as BOTTOM_TAG
from tests.cases.meshes import BOTTOM_OF_UPPER, TOP_OF_LOWER, UPPER, skins, two_blocks
from tests.cases.meshes import TOP as TOP_TAG
from tests.cases.meshes_3d import rotation, two_boxes
from tests.cases.pressed_blocks import COMM, failing, rejected

pytestmark = pytest.mark.mpi

ELASTIC = dm.Elastic(100.0, 0.3)
FLOOR, FOOT, TOP, BOTTOM, LEFT, RIGHT = range(1, 7)


def wedge(friction=None, tool=None):
    """Return a square that stands on its corner in a groove of two planes, and its loads.

    The groove may be one tool, for both sides.
    """
    domain = mesh.create_unit_square(COMM, 8, 8, mesh.CellType.quadrilateral)
    x, c = domain.geometry.x, np.sqrt(0.5)
    x[:, :2] = c * np.stack([x[:, 0] - x[:, 1], x[:, 0] + x[:, 1]], axis=1)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    found = [
        mesh.locate_entities_boundary(domain, 1, lambda x, s=s: np.isclose(x[1], s * x[0]))
        for s in (1, -1)
    ]
    second = 2 if tool is None else 1
    values = np.repeat(np.array([1, second], dtype=np.int32), [len(part) for part in found])
    facets = np.concatenate(found)
    order = np.argsort(facets)
    tags = mesh.meshtags(domain, 1, facets[order], values[order])
    planes = [dm.shapes.Plane((0.0, 0.0), (-s * c, c)) for s in (1, -1)]
    tools = [
        dm.Obstacle(tags, slave=k, shape=shape, friction=friction)
        for k, shape in enumerate(planes, start=1)
    ]
    if tool is not None:
        shape = dm.shapes.Union(*planes) if tool == "union" else tool
        tools = [dm.Obstacle(tags, slave=1, shape=shape, friction=friction)]
    load = fem.Constant(domain, np.zeros(2))
    loads = ufl.inner(load, ufl.TestFunction(V)) * ufl.dx
    return dm.ContactProblem(dm.Solid(fem.Function(V), ELASTIC), tools, loads=loads), tools, load


def test_a_body_in_a_groove_of_two_tools():
    """Statics without friction: normal to the planes, (W + H) / sqrt 2 and (W - H) / sqrt 2."""
    problem, tools, load = wedge()
    for h in (0.0, 0.3):
        load.value[:] = h, -2.0
        report = dm.newton(problem, rtol=1e-9)
        problem.commit()
        for tool, s in zip(tools, (1, -1), strict=True):
            assert np.allclose(tool.force, (1 + s * h / 2) * np.array([-s, 1.0]), atol=1e-6)
    (note,) = (note for note in report.notes if "removed" in note)
    assert "Union" in note
    assert "masters" not in note


def test_a_corner_in_the_corner_of_one_tool():
    """Says why it fails; rounded by half of a facet it has the forces of statics."""
    problem, (tool,), load = wedge(tool="union")
    load.value[:] = 0.0, -2.0
    words = "inner corners of a tool", "its own tag and Obstacle"
    with failing(problem, *words):
        dm.newton(problem)
    r, angles = 0.06, np.radians(np.linspace(-45.0, -135.0, 9))
    arc = np.stack([np.cos(angles), np.sin(angles) + 1.0], axis=1) * r
    high = 3.0 - r * (np.sqrt(2.0) - 1.0)  # of the flanks, 45 degrees, that touch the arc
    points = np.concatenate([[[3.0, high]], arc, [[-3.0, high]]])
    problem, (tool,), load = wedge(tool=dm.shapes.Polyline(points, closed=False))
    for h in (0.0, 0.3):
        load.value[:] = h, -2.0
        dm.newton(problem, rtol=1e-9)
        problem.commit()
    assert tool.force == pytest.approx([-0.3, 2.0], abs=1e-6)


def friction_of_a_drawn_corner(slave, tilt, whole=False, friction=0.3, push=0.01, **options):
    """Draw a block that stands on its corner over another one; return |Ft/Fn|."""
    ends = {"x_lower": (0.0, 2.0), "x_upper": (0.6, 1.2)}
    domain, cells, facets = two_blocks(COMM, (20, 10), (6, 10), cell="quadrilateral", **ends)
    upper = np.unique(compat.cell_nodes(domain)[cells.indices[cells.values == UPPER]])
    turn = np.array([[np.cos(tilt), -np.sin(tilt)], [np.sin(tilt), np.cos(tilt)]])
    x = domain.geometry.x
    x[upper, :2] = (x[upper, :2] - (0.6, 0.0)) @ turn.T + (0.6, 0.0)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    u, lid = fem.Function(V), fem.Constant(domain, (0.0, -push))
    held = [fem.locate_dofs_topological(V, 1, facets.find(tag)) for tag in (BOTTOM_TAG, TOP_TAG)]
    bcs = [fem.dirichletbc(np.zeros(2), held[0], V), fem.dirichletbc(lid, held[1], V)]
    (master,) = {BOTTOM_OF_UPPER, TOP_OF_LOWER} - {slave}
    tags = skins(domain, cells, facets) if whole else facets
    contact = dm.Contact(tags, slave=slave, master=master, friction=friction)
    problem = dm.ContactProblem(dm.Solid(u, dm.Elastic(1.0, 0.3)), [contact], bcs=bcs)
    for n in range(4 if friction else 1):
        lid.value[0] = 3 * n * push
        dm.newton(problem, **options)
        problem.commit()
    return abs(contact.force[0] / contact.force[1])


@pytest.mark.parametrize(
    ("slave", "tilt", "whole"),
    [(TOP_OF_LOWER, 0.3, False), (BOTTOM_OF_UPPER, 0.3, False), (BOTTOM_OF_UPPER, 0.2, True)],
)
def test_a_corner_drawn_over_a_face(slave, tilt, whole):
    """Friction is mu times the force normal to the face, whichever is the slave.

    Also where the side runs around the corner, of which the flank faces nothing. But for the angle
    by which friction inclines the face, which grows with the load: 1e-3 at ten times of it.
    """
    found = friction_of_a_drawn_corner(slave, tilt, whole, push=1e-3)
    assert found == pytest.approx(0.3, rel=0.001)


@pytest.mark.parametrize("whole", [False, True])
@pytest.mark.parametrize("degrees", [2.0, 8.0, 17.0])
@pytest.mark.parametrize("slave", [TOP_OF_LOWER, BOTTOM_OF_UPPER])
def test_a_corner_that_leans_on_a_face(slave, degrees, whole):
    """Without friction the force is normal to the face, at any angle and with either slave."""
    assert friction_of_a_drawn_corner(slave, np.radians(degrees), whole, friction=None) < 1e-3


def test_a_corner_drawn_over_facets_of_the_slave():
    """Where both flanks count, 17 and 73 degrees steep; larger steps may fail there."""
    drawn = TOP_OF_LOWER, 0.3, True
    assert friction_of_a_drawn_corner(*drawn) == pytest.approx(0.3, rel=0.01)
    with rejected("did not converge", error=dm.NewtonNotConverged):
        friction_of_a_drawn_corner(*drawn, push=0.05, max_it=15)


def force_under_a_step(cell, degree, shift, whole):
    """Press a body with a wide upper part, `whole` of whose lower side may be the master."""
    H, high = 0.6, 2.0  # of the step, and of the body
    line = np.array([-1.6, -1.3, -0.501, -0.5, 0.0, 0.5, 0.501, 1.3, 1.6]) + shift

    def stepped(x):
        upper, beside = x[:, -1] > 0.5, abs(x[:, 0] - shift) > 0.5005
        y = np.where(upper, x[:, -1] - 1.0, x[:, -1])
        return np.column_stack([x[:, :-1], np.where(upper & beside, H + y * (high - H) / high, y)])

    options = {"gap": 1.0, "heights": (1.0, high), "cell": cell, "transform": stepped}
    if cell in ("triangle", "quadrilateral"):
        domain, _, facets = two_blocks(
            COMM, (8, 3), (8, 4), x_lower=(-2.0, 2.0), splits_upper=line, **options
        )
    else:
        sides = {"lower": (-2.0, 2.0, 0.0, 0.5), "splits_upper": (line, np.array([0.0, 0.5]))}
        domain, _, facets = two_boxes(COMM, (8, 1, 2), (8, 1, 3), **sides, **options)
    d = domain.topology.dim
    under = facets.find(BOTTOM_OF_UPPER)
    away = under[mesh.compute_midpoints(domain, d - 1, under)[:, d - 1] > 1e-9]
    if not whole:
        left = ~np.isin(facets.indices, away)
        facets = mesh.meshtags(domain, d - 1, facets.indices[left], facets.values[left])
    V = fem.functionspace(domain, ("Lagrange", degree, (d,)))
    held = [fem.locate_dofs_topological(V, d - 1, facets.find(k)) for k in (BOTTOM_TAG, TOP_TAG)]
    moves = np.zeros(d), np.array([0.0, 0.0, -0.02])[-d:]
    bcs = [fem.dirichletbc(move, dofs, V) for move, dofs in zip(moves, held, strict=True)]
    contact = dm.Contact(facets, slave=TOP_OF_LOWER, master=BOTTOM_OF_UPPER)
    problem = dm.ContactProblem(dm.Solid(fem.Function(V), ELASTIC), [contact], bcs=bcs)
    dm.newton(problem, rtol=1e-9)
    return contact.force


@pytest.mark.parametrize(
    ("cell", "degree", "shift"),
    [
        ("quadrilateral", 1, 0.1),
        ("triangle", 2, 0.2),
        ("hexahedron", 1, 0.2),
        ("tetrahedron", 1, 0.1),
    ],
)
def test_what_stands_back_behind_a_step_does_not_count(cell, degree, shift):
    """Where slave facets lie across the step: their gap is that of the part that touches."""
    force = force_under_a_step(cell, degree, shift, whole=True)
    face = force_under_a_step(cell, degree, shift, whole=False)
    assert force == pytest.approx(face, abs=1e-7 * np.linalg.norm(face))


@pytest.mark.parametrize("axis", [(0, -1, 0), (1, -1, 0), None])
@pytest.mark.parametrize("slave", [BOTTOM_OF_UPPER, TOP_OF_LOWER])
def test_edges_and_corners_on_a_plate_in_space(axis, slave):
    """The force of a cube without friction is normal to the plate, whichever is the slave."""

    def turned(x):
        turn = rotation(axis or (0, 1, 0), 0.0 if axis is None else 0.2)
        return np.where(x[:, 2:] > 0.5, (x - [0.5, 0.5, 1.0]) @ turn.T + [0.5, 0.5, 0.0], x)

    high, low = (0.5, 1.0, 0.5, 1.0), (0.0, 1.5, 0.0, 1.5)
    domain, _, facets = two_boxes(
        COMM, (6, 6, 3), (2, 2, 2), lower=low, upper=high, heights=(1.0, 0.5), gap=1.0,
        cell="hexahedron", transform=turned,
    )  # fmt: skip
    V = fem.functionspace(domain, ("Lagrange", 1, (3,)))
    held = [fem.locate_dofs_topological(V, 2, facets.find(tag)) for tag in (BOTTOM_TAG, TOP_TAG)]
    moves = np.zeros(3), np.array([0.0, 0.0, -0.01])
    bcs = [fem.dirichletbc(move, dofs, V) for move, dofs in zip(moves, held, strict=True)]
    (master,) = {BOTTOM_OF_UPPER, TOP_OF_LOWER} - {slave}
    contact = dm.Contact(facets, slave=slave, master=master)
    solid = dm.Solid(fem.Function(V), dm.Elastic(1.0, 0.3))
    dm.newton(dm.ContactProblem(solid, [contact], bcs=bcs))
    *across, along = contact.force
    assert np.hypot(*across) < 1e-3 * abs(along)


def pressed(split, slave):
    """Return the problem of a block, perhaps of two halves that are tied, on a floor, and notes.

    Also displacements by coordinates, those of both halves on the cut.
    """
    width = np.linspace(0.0, 2.0, 9)
    halves = [width[:5], width[4:]] if split else [width]
    grids = [(np.linspace(-1.0, 3.0, 17), -1.0), *((x, 0.0) for x in halves)]
    points, cells = [], []
    for x, low in grids:
        y, n, start = np.linspace(low, low + 1, 5), len(x), sum(map(len, points))
        i, j = (a.ravel() for a in np.meshgrid(np.arange(n - 1), np.arange(4)))
        points.append(np.stack([np.tile(x, 5), np.repeat(y, n)], axis=1))
        cells.append(start + (j * n + i)[:, None] + np.array([0, 1, n, n + 1]))
    own = COMM.rank == 0
    domain = dolfinx.mesh.create_mesh(
        COMM,
        np.concatenate(cells)[: None if own else 0],
        x=np.concatenate(points)[: None if own else 0],
        e=basix.ufl.element("Lagrange", "quadrilateral", 1, shape=(2,)),
    )
    domain.topology.create_connectivity(1, 2)
    facets = mesh.exterior_facet_indices(domain.topology)
    cell_of = domain.topology.connectivity(1, 2)
    inside = cell_of.array[cell_of.offsets[facets]]
    cx, cy = (mesh.compute_midpoints(domain, 2, inside)[:, k] for k in range(2))
    fx, fy = (mesh.compute_midpoints(domain, 1, facets)[:, k] for k in range(2))
    flat, cut = np.isclose(fy, 0.0), np.isclose(fx, 1.0) & (cy > 0)
    marks = [(np.isclose(fy, -1.0), BOTTOM), (np.isclose(fy, 1.0), TOP)]
    marks += [(flat & (cy < 0), FLOOR), (flat & (cy > 0), FOOT)]
    marks += [(cut & (cx < 1), LEFT), (cut & (cx > 1), RIGHT)]
    values = np.zeros(len(facets), dtype=np.int32)
    for where, tag in marks:
        values[where] = tag
    tags = mesh.meshtags(domain, 1, facets[values > 0], values[values > 0])
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    push = fem.Constant(domain, np.zeros(2))
    bcs = [
        fem.dirichletbc(value, fem.locate_dofs_topological(V, 1, tags.find(tag)), V)
        for tag, value in ((BOTTOM, np.zeros(2)), (TOP, push))
    ]
    sides = {"slave": slave, "master": FOOT if slave == FLOOR else FLOOR}
    contact = dm.Contact(tags, **sides, friction=0.3)
    ties = [dm.Tie(tags, slave=LEFT, master=RIGHT)] if split else []
    problem = dm.ContactProblem(dm.Solid(fem.Function(V), ELASTIC), [*ties, contact], bcs=bcs)
    ramp = {push: [(0.0, (0.0, 0.0)), (1.0, (0.0, -0.02)), (2.0, (0.02, -0.02))]}
    notes = []
    for step in dm.load_steps(problem, [1.0, 2.0], ramp=ramp, rtol=1e-9, progress=False):
        notes += step.report.notes
    return contact, notes


def test_a_tie_that_ends_in_a_contact():
    """With the floor as slave two halves are as one; else the note says to make it the slave.

    But for the normals of the halves at the cut, of one facet each: 1e-6 of the forces.
    """
    whole, _ = pressed(split=False, slave=FLOOR)
    halves, notes = pressed(split=True, slave=FLOOR)
    assert np.allclose(halves.force, whole.force, rtol=1e-6)
    assert halves.dissipation == pytest.approx(whole.dissipation, rel=1e-5)
    assert not any("removed" in note for note in notes)
    _, notes = pressed(split=True, slave=FOOT)
    assert any("let the other side of Contact" in note for note in notes)
    assert not any("masters" in note for note in notes)


def beam(x0, y0, n=40, m=3):
    """Return nodes and quadrilaterals of a cantilever 2032 long and 63.5 thick."""
    x, y = np.linspace(x0, x0 + 2032.0, n + 1), np.linspace(y0 - 31.75, y0 + 31.75, m + 1)
    i, j = (a.ravel() for a in np.meshgrid(np.arange(n), np.arange(m)))
    points = np.stack([np.tile(x, m + 1), np.repeat(y, n + 1)], axis=1)
    return points, (j * (n + 1) + i)[:, None] + np.array([0, 1, n + 1, n + 2])


@pytest.mark.slow
@pytest.mark.parametrize(("top", "slave"), [(False, "up"), (True, "up"), (False, "low")])
def test_a_cantilever_slides_down_another_one(top, slave):
    """Its end comes flush and leaves on the other corner (Code_Aster, SSNV505: 267.2 and 309.9).

    The force is the slope of the energy, and no step differs from its neighbours, where the corner
    is at a slave node. Facets of the other side, which are longer than its end, have a mean gap.
    """
    (p, c), (q, d) = beam(0.0, 0.0), beam(914.4, 508.0)
    element = basix.ufl.element("Lagrange", "quadrilateral", 1, shape=(2,))
    own = slice(None if COMM.rank == 0 else 0)
    cells, points = np.concatenate([c, d + len(p)])[own], np.concatenate([p, q])[own]
    domain = dolfinx.mesh.create_mesh(COMM, cells, x=points, e=element)
    end = lambda x: np.isclose(x[0], 914.4) & (x[1] > 400.0)  # noqa: E731
    where = {
        "low clamp": lambda x: np.isclose(x[0], 0.0),
        "up clamp": lambda x: np.isclose(x[0], 2946.4),
        "low": lambda x: np.isclose(x[1], 31.75),
        "up": lambda x: np.isclose(x[1], 476.25) | end(x) | (top & np.isclose(x[1], 539.75)),
    }
    found = [mesh.locate_entities_boundary(domain, 1, on) for on in where.values()]
    values = np.repeat(np.arange(4, dtype=np.int32), [len(f) for f in found])
    facets, first = np.unique(np.concatenate(found), return_index=True)
    names = {name: k for k, name in enumerate(where)}
    tags = dm.Tags(mesh.meshtags(domain, 1, facets, values[first]), names)
    V, push = fem.functionspace(domain, ("Lagrange", 1, (2,))), fem.Constant(domain, 0.0)
    place = lambda x: np.isclose(x[0], 1625.6) & np.isclose(x[1], 539.75)  # noqa: E731
    at = fem.locate_dofs_geometrical((V.sub(1), V.sub(1).collapse()[0]), place)[0]
    bcs = [
        fem.dirichletbc(np.zeros(2), fem.locate_dofs_topological(V, 1, tags.find(name)), V)
        for name in ("low clamp", "up clamp")
    ]
    bcs.append(fem.dirichletbc(push, at, V.sub(1)))
    law = dm.NeoHooke(6894.8, 0.3333)
    solid = dm.Solid(fem.Function(V), law, strain="finite", energies=True)
    contact = dm.Contact(tags, slave=slave, master="low" if slave == "up" else "up")
    problem = dm.ContactProblem(solid, [contact], bcs=bcs)
    forces, stored, ramp = [], [], {push: [(0.0, 0.0), (1.0, -800.0)]}
    for _ in dm.load_steps(problem, np.arange(1, 51) / 50, ramp=ramp, progress=False):
        forces.append(-dm.reaction(problem, bcs[2]).force[1])
        stored.append(sum(energy.stored for energy in solid.energies().values()))
    error = 0.005 if slave == "up" else 0.03
    assert forces[39] == pytest.approx(267.2, rel=error)
    assert forces[49] == pytest.approx(309.9, rel=error)
    if slave == "low":
        return
    slopes = (np.array(stored[2:]) - stored[:-2]) / 32.0
    smooth = np.setdiff1d(np.arange(30, 48), [40, 41])  # the end comes flush at .86
    assert np.abs(np.array(forces)[smooth + 1] / slopes[smooth] - 1.0).max() < 0.01
    rises = np.diff(forces[30:42]) / forces[30:41]
    assert np.abs(rises[1:-1] - (rises[:-2] + rises[2:]) / 2).max() < 0.02


@pytest.mark.parametrize("slave", [TOP_OF_LOWER, BOTTOM_OF_UPPER])
def test_a_corner_between_the_nodes_of_a_face(slave):
    """It presses where it is as the slave; else at a node of the face, and the note says so."""
    corner = 0.63  # nodes of the face are .1 apart
    ends = {"x_lower": (0.0, 2.0), "x_upper": (corner, corner + 0.6)}
    domain, cells, facets = two_blocks(COMM, (20, 10), (6, 10), cell="quadrilateral", **ends)
    upper = np.unique(compat.cell_nodes(domain)[cells.indices[cells.values == UPPER]])
    x, place = domain.geometry.x, np.array([corner, 0.0])
    x[upper, :2] = (x[upper, :2] - place) @ np.array([[0.9, 0.3], [-0.3, 0.9]]) + place
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    values = (BOTTOM_TAG, np.zeros(2)), (TOP_TAG, np.array([0.0, -1e-3]))
    bcs = [
        fem.dirichletbc(value, fem.locate_dofs_topological(V, 1, facets.find(tag)), V)
        for tag, value in values
    ]
    (master,) = {BOTTOM_OF_UPPER, TOP_OF_LOWER} - {slave}
    contact = dm.Contact(facets, slave=slave, master=master)
    problem = dm.ContactProblem(dm.Solid(fem.Function(V), dm.Elastic(1.0, 0.3)), [contact], bcs=bcs)
    report = dm.newton(problem)
    support = dm.reaction(problem, bcs[0])
    at_node = slave == TOP_OF_LOWER
    at = 0.6 if at_node else corner
    assert support.moment / support.force[1] == pytest.approx(at, abs=2e-3)
    (note,) = (note for note in report.notes if "not resolved" in note)
    assert (f"; an edge or a corner of {master} presses" in note) == at_node

# SPDX-License-Identifier: MIT
"""A node in the corner between two interfaces, which one of them gets: answers and notes."""

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem, mesh
from dolfinx_mortar.common import compat
from dolfinx_mortar.meshing.two_bodies import distribute
from tests.cases.block_piles import ABOVE, BELOW, EAST, WEST, Blocks
from tests.cases.meshes import BOTTOM_OF_UPPER, TOP_OF_LOWER, UPPER, _block
from tests.cases.meshes_3d import rotation
from tests.cases.pressed_blocks import COMM, failing, rejected
from tests.cases.solid import rectangle, tag_facets
from tests.cases.two_bodies import TwoBodies, create_problem, held

pytestmark = pytest.mark.mpi

ELASTIC = dm.Elastic(100.0, 0.3)


def wedge(tool=None):
    """Return a square that stands on its corner in a groove of two planes, or of one tool."""
    domain = rectangle([(0.0, 0.0), (1.0, 1.0)], (8, 8))
    x, c = domain.geometry.x, np.sqrt(0.5)
    x[:, :2] = c * np.stack([x[:, 0] - x[:, 1], x[:, 0] + x[:, 1]], axis=1)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    sides = [lambda x: np.isclose(x[1], x[0]), lambda x: np.isclose(x[1], -x[0])]
    both = [lambda x: np.isclose(x[1], abs(x[0]))]
    tags = tag_facets(domain, *(sides if tool is None else both))
    planes = [dm.shapes.Plane((0.0, 0.0), (-s * c, c)) for s in (1, -1)]
    shapes = planes if tool is None else [tool(*planes)]
    tools = [dm.Obstacle(tags, slave=k, shape=shape) for k, shape in enumerate(shapes, start=1)]
    load = fem.Constant(domain, np.zeros(2))
    loads = ufl.inner(load, ufl.TestFunction(V)) * ufl.dx
    return create_problem(V, tools, law=ELASTIC, loads=loads), tools, load


def arc(*_):
    """Return a groove that is rounded by half of a facet, and has flanks of 45 degrees."""
    r, angles = 0.06, np.radians(np.linspace(-45.0, -135.0, 9))
    points = np.stack([np.cos(angles), np.sin(angles) + 1.0], axis=1) * r
    high = 3.0 - r * (np.sqrt(2.0) - 1.0)
    return dm.shapes.Polyline(np.concatenate([[[3.0, high]], points, [[-3.0, high]]]), closed=False)


@pytest.mark.parametrize("tool", [None, arc])
def test_a_body_in_a_groove(tool):
    """Statics without friction: normal to the planes, (W + H) / sqrt 2 and (W - H) / sqrt 2."""
    problem, tools, load = wedge(tool)
    for h in (0.0, 0.3):
        load.value[:] = h, -2.0
        report = dm.newton(problem, rtol=1e-9)
        problem.commit()
        assert sum(t.force for t in tools) == pytest.approx([-h, 2.0], abs=1e-6)
        for one, s in zip(tools, (1, -1), strict=False):
            if tool is None:
                assert np.allclose(one.force, (1 + s * h / 2) * np.array([-s, 1.0]), atol=1e-6)
    if tool is None:
        (note,) = (note for note in report.notes if "removed" in note)
        assert "Union" in note and "masters" not in note


def test_a_corner_in_the_corner_of_one_tool():
    problem, _, load = wedge(dm.shapes.Union)
    load.value[:] = 0.0, -2.0
    with failing(problem, "inner corners of a tool", "its own tag and Obstacle"):
        dm.newton(problem)


def on_a_corner(tilt, place=0.6, **options):
    """Return a block that stands on its corner, over another one with facets of .1."""
    ends = {"x_lower": (0.0, 2.0), "x_upper": (place, place + 0.6)}
    case = TwoBodies("quadrilateral", n_lower=(20, 10), n_upper=(6, 10), **ends, **options)
    upper = np.unique(compat.cell_nodes(case.mesh)[case.cells.indices[case.cells.values == UPPER]])
    x, turn = case.mesh.geometry.x, rotation((0, 0, 1), tilt)[:2, :2]
    x[upper, :2] = (x[upper, :2] - (place, 0.0)) @ turn.T + (place, 0.0)
    return case


def friction_of_a_drawn_corner(slave, tilt, whole=False, push=0.01, **options):
    """Draw a block that stands on its corner over another one; return |Ft/Fn|."""
    case = on_a_corner(tilt, whole=whole)
    contact = case.interface(slave=slave, friction=0.3)
    problem = case.problem([contact], law=dm.Elastic(1.0, 0.3))
    for n in range(4):
        case.top.value[:] = 3 * n * push, -push
        dm.newton(problem, **options)
        problem.commit()
    return abs(contact.force[0] / contact.force[1])


@pytest.mark.parametrize(
    ("slave", "tilt", "whole"),
    [(TOP_OF_LOWER, 0.3, False), (BOTTOM_OF_UPPER, 0.3, False), (BOTTOM_OF_UPPER, 0.2, True)],
)
def test_a_corner_drawn_over_a_face(slave, tilt, whole):
    """Friction is mu times the force normal to the face, whichever is the slave."""
    found = friction_of_a_drawn_corner(slave, tilt, whole, push=1e-3)
    assert found == pytest.approx(0.3, rel=0.001)


def test_a_corner_drawn_over_facets_of_the_slave():
    """Where both flanks count, 17 and 73 degrees steep; larger steps may fail there."""
    drawn = TOP_OF_LOWER, 0.3, True
    assert friction_of_a_drawn_corner(*drawn) == pytest.approx(0.3, rel=0.01)
    with rejected("did not converge", error=dm.NewtonNotConverged):
        friction_of_a_drawn_corner(*drawn, push=0.05, max_it=15)


@pytest.mark.parametrize("swap", [False, True])
def test_a_corner_between_the_nodes_of_a_face(swap):
    """It presses where it is as the slave; else at a node of the face, and the note says so."""
    case = on_a_corner(np.arctan(1 / 3), place=0.63)
    contact, bcs = case.interface(swap=swap), case.bcs(0.0, -1e-3)
    problem = case.problem([contact], bcs, law=dm.Elastic(1.0, 0.3))
    report = dm.newton(problem)
    support = dm.reaction(problem, bcs[0])
    at = 0.63 if swap else 0.6
    assert support.moment / support.force[1] == pytest.approx(at, abs=2e-3)
    (note,) = (note for note in report.notes if "not resolved" in note)
    said = f"; an edge or a corner of {contact.master} presses" in note
    assert said == (not swap)


def force_under_a_step(cell, degree, shift, whole):
    """Press a body with a wide upper part, `whole` of whose lower side may be the master."""
    H, high = 0.6, 2.0  # of the step, and of the body
    line = np.array([-1.6, -1.3, -0.501, -0.5, 0.0, 0.5, 0.501, 1.3, 1.6]) + shift

    def stepped(x):
        upper, beside = x[:, -1] > 0.5, abs(x[:, 0] - shift) > 0.5005
        y = np.where(upper, x[:, -1] - 1.0, x[:, -1])
        return np.column_stack([x[:, :-1], np.where(upper & beside, H + y * (high - H) / high, y)])

    options = {"gap": 1.0, "heights": (1.0, high), "transform": stepped}
    if cell in ("triangle", "quadrilateral"):
        options |= {"n_lower": (8, 3), "n_upper": (8, 4), "x_lower": (-2.0, 2.0)}
        options["splits_upper"] = line
    else:
        options |= {"n_lower": (8, 1, 2), "n_upper": (8, 1, 3), "lower": (-2.0, 2.0, 0.0, 0.5)}
        options["splits_upper"] = line, np.array([0.0, 0.5])
    case = TwoBodies(cell, degree, **options)
    under, d = case.facets.find(BOTTOM_OF_UPPER), case.d
    away = under[mesh.compute_midpoints(case.mesh, d - 1, under)[:, d - 1] > 1e-9]
    left = whole | ~np.isin(case.facets.indices, away)
    case.tags = mesh.meshtags(case.mesh, d - 1, case.facets.indices[left], case.facets.values[left])
    contact = case.interface()
    dm.newton(case.problem([contact], case.bcs(*[0.0] * (d - 1), -0.02), ELASTIC), rtol=1e-9)
    return contact.force


@pytest.mark.parametrize(
    ("cell", "degree", "shift"),
    [("triangle", 2, 0.2), ("hexahedron", 1, 0.2), ("tetrahedron", 1, 0.1)],
)
def test_what_stands_back_behind_a_step_does_not_count(cell, degree, shift):
    """Where slave facets lie across the step: their gap is that of the part that touches."""
    force, face = (force_under_a_step(cell, degree, shift, whole) for whole in (True, False))
    assert force == pytest.approx(face, abs=1e-7 * np.linalg.norm(face))


@pytest.mark.parametrize("axis", [(0, -1, 0), (1, -1, 0), None])
@pytest.mark.parametrize("swap", [False, True])
def test_edges_and_corners_on_a_plate_in_space(axis, swap):
    """The force of a cube without friction is normal to the plate, whichever is the slave."""

    def turned(x):
        turn = rotation(axis or (0, 1, 0), 0.0 if axis is None else 0.2)
        return np.where(x[:, 2:] > 0.5, (x - [0.5, 0.5, 1.0]) @ turn.T + [0.5, 0.5, 0.0], x)

    case = TwoBodies(
        "hexahedron", n_lower=(6, 6, 3), n_upper=(2, 2, 2), lower=(0.0, 1.5, 0.0, 1.5),
        upper=(0.5, 1.0, 0.5, 1.0), heights=(1.0, 0.5), gap=1.0, transform=turned,
    )  # fmt: skip
    contact = case.interface(swap=swap)
    dm.newton(case.problem([contact], case.bcs(0.0, 0.0, -0.01), dm.Elastic(1.0, 0.3)))
    *across, along = contact.force
    assert np.hypot(*across) < 1e-3 * abs(along)


def pressed(split, floor_is_slave):
    """Drag a block, perhaps of two halves that are tied, over a floor; return contact and notes."""
    upper = [(0, 1, 0, 1, 4, 4), (1, 2, 0, 1, 4, 4)] if split else [(0, 2, 0, 1, 8, 4)]
    b = Blocks([(-1, 3, -1, 0, 16, 4), *upper], cell="quadrilateral")
    same = {30 + BELOW: 20 + BELOW, 30 + ABOVE: 20 + ABOVE}  # sides of the right half
    values = np.array([same.get(v, v) for v in b.facets.values], dtype=np.int32)
    b.facets = mesh.meshtags(b.mesh, 1, b.facets.indices, values)
    push = fem.Constant(b.mesh, np.zeros(2))
    bcs = [b.fix(1, BELOW), b.fix(2, ABOVE, value=push)]
    slave, master = (10 + ABOVE, 20 + BELOW)[:: 1 if floor_is_slave else -1]
    contact = dm.Contact(b.facets, slave=slave, master=master, friction=0.3)
    ties = [b.join(dm.Tie, (2, EAST), (3, WEST))] if split else []
    problem = b.problem([*ties, contact], bcs, ELASTIC)
    ramp = {push: [(0.0, (0.0, 0.0)), (1.0, (0.0, -0.02)), (2.0, (0.02, -0.02))]}
    notes = []
    for step in dm.load_steps(problem, [1.0, 2.0], ramp=ramp, rtol=1e-9, progress=False):
        notes += step.report.notes
    return contact, notes


def test_a_tie_that_ends_in_a_contact():
    """With the floor as slave two halves are as one; else the note says to make it the slave."""
    whole, _ = pressed(split=False, floor_is_slave=True)
    halves, notes = pressed(split=True, floor_is_slave=True)
    assert np.allclose(halves.force, whole.force, rtol=1e-6)
    assert halves.dissipation == pytest.approx(whole.dissipation, rel=1e-5)
    assert not any("removed" in note for note in notes)
    _, notes = pressed(split=True, floor_is_slave=False)
    assert any("let the other side of Contact" in note for note in notes)
    assert not any("masters" in note for note in notes)


def beam(x, y):
    """Return nodes and quadrilaterals of a cantilever 2032 long and 63.5 thick."""
    lines, rows = np.linspace(0.0, 2032.0, 41), np.linspace(-31.75, 31.75, 4)
    return _block(x + lines, y + rows, "quadrilateral")


@pytest.mark.slow
@pytest.mark.parametrize(("top", "slave"), [(False, "up"), (True, "up"), (False, "low")])
def test_a_cantilever_slides_down_another_one(top, slave):
    """Its end comes flush and leaves on the other corner (Code_Aster, SSNV505: 267.2 and 309.9)."""
    bodies = beam(0.0, 0.0), beam(914.4, 508.0)
    domain, _ = distribute(COMM, lambda: bodies, "quadrilateral")
    end = lambda x: np.isclose(x[0], 914.4) & (x[1] > 400.0)  # noqa: E731
    where = {
        "low clamp": lambda x: np.isclose(x[0], 0.0),
        "up clamp": lambda x: np.isclose(x[0], 2946.4),
        "low": lambda x: np.isclose(x[1], 31.75),
        "up": lambda x: np.isclose(x[1], 476.25) | end(x) | (top & np.isclose(x[1], 539.75)),
    }
    names = {name: k for k, name in enumerate(where, 1)}
    tags = dm.Tags(tag_facets(domain, *where.values()), names)
    V, push = fem.functionspace(domain, ("Lagrange", 1, (2,))), fem.Constant(domain, 0.0)
    place = lambda x: np.isclose(x[0], 1625.6) & np.isclose(x[1], 539.75)  # noqa: E731
    at = fem.locate_dofs_geometrical((V.sub(1), V.sub(1).collapse()[0]), place)[0]
    bcs = [held(V, tags, 1), held(V, tags, 2), fem.dirichletbc(push, at, V.sub(1))]
    contact = dm.Contact(tags, slave=slave, master="low" if slave == "up" else "up")
    law = dm.NeoHooke(6894.8, 0.3333)
    problem = create_problem(V, [contact], bcs, law, strain="finite", energies=True)
    forces, stored, ramp = [], [], {push: [(0.0, 0.0), (1.0, -800.0)]}
    for _ in dm.load_steps(problem, np.arange(1, 51) / 50, ramp=ramp, progress=False):
        forces.append(-dm.reaction(problem, bcs[2]).force[1])
        stored.append(sum(energy.stored for energy in problem.solid.energies().values()))
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

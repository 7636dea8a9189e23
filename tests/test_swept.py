# SPDX-License-Identifier: MIT
"""Bodies that nothing couples and that pass through each other within one step: a note says so."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem, mesh
from dolfinx_mortar.geometry.sweep import find_entering, find_passing_edges
from dolfinx_mortar.geometry.turning import RigidMotion
from dolfinx_mortar.report.swept import _first, notes_on_swept
from dolfinx_mortar.report.uncoupled import Crossing
from tests.meshes import BOTTOM, BOTTOM_OF_UPPER, TOP, TOP_OF_LOWER, two_blocks
from tests.meshes_3d import rotation, two_boxes
from tests.test_crossings import sunk

COMM = MPI.COMM_WORLD
LAW = dm.Elastic(1000.0, 0.3)


def notes(report):
    """Return the notes on bodies that have moved through each other."""
    return [note for note in report.notes if "into or through each other" in note]


def faces(d):
    """Return a facet above another one with the normal e_d, three times as large."""
    lower = {2: [[1, 0], [-1, 0]], 3: [[1, 0, 0], [-0.5, 0.8, 0], [-0.5, -0.8, 0]]}[d]
    low = np.array(lower, dtype=float)
    return np.stack([low / 3 + 2 * np.eye(d)[-1], low])


@pytest.mark.parametrize("d", [2, 3])
def test_what_enters(d):
    """Through the face from outside; not beside it, along it, back out, nor when both move."""
    x, pairs = faces(d), np.array([[0, 1]])
    up, along = np.eye(d)[-1], np.eye(d)[0]
    rim = {2: -0.98 - 1 / 3, 3: -0.49 - 1 / 3}  # a vertex within 5 % of the edge of the lower one
    touching = x - np.stack([2 * up, 0 * up])[:, None]
    for start, way, enters in (
        (x, -9 * up, True),
        (touching, -9 * up, True),
        (x, -1.5 * up, False),
        (x - np.stack([4 * up, 0 * up])[:, None], 9 * up, False),
        (x + np.stack([3 * along, 0 * up])[:, None], -9 * up, False),
        (touching, 5 * along, False),
        (touching, 0.2 * along - 0.02 * up, False),
        (x + np.stack([rim[d] * along, 0 * up])[:, None], -9 * up, False),
    ):
        end = start + np.stack([way, 0 * up])[:, None]
        assert bool(len(find_entering(start, end, pairs, 0.05))) is enters
    both = x - 9 * up
    assert not len(find_entering(x, both, pairs, 0.05))


def test_edges_that_pass():
    """Across each other in any direction; not beside, nearly parallel, touching, or not as far."""
    x = np.array([[[-1.0, 0, 1], [1, 0.5, 1]], [[0.1, -1, 0], [0, 1, 0.2]]])
    pairs = np.array([[0, 1]])
    parallel = np.stack([x[0], x[0] + [0.0, 0.01, -1.0]])
    down = np.array([0.3, 0.2, -2.0])
    for start, way, passes in (
        (x, down, True),
        (x + np.array([[[0.0, 0, -2]], [[0, 0, 0]]]), -down, True),
        (x, 0.4 * down, False),
        (x + np.array([[[0.0, 0, -2]], [[0, 0, 0]]]), down, False),
        (x, down + 3.0 * np.eye(3)[0], False),
        (parallel, down, False),
    ):
        end = start + np.stack([way, 0 * way])[:, None]
        assert bool(len(find_passing_edges(start, end, pairs, 0.05))) is passes
        assert bool(len(find_passing_edges(start, end, pairs[:, ::-1], 0.05))) is passes
    assert not len(find_passing_edges(x, x + down, pairs, 0.05))


@pytest.mark.mpi
@pytest.mark.parametrize("partition", ["graph", "bodies", "empty"])
def test_bars_that_cross(partition):
    """Of one cell across each: no vertex and no middle of a facet of one meets the other."""
    bars, *_ = two_boxes(
        COMM,
        (1, 1, 1),
        (1, 1, 1),
        lower=(0.0, 5.0, 2.2, 2.8),
        upper=(2.2, 2.8, 0.0, 5.0),
        heights=(0.4, 0.4),
        gap=0.1,
        partition=partition,
    )
    V = fem.functionspace(bars, ("Lagrange", 1, (3,)))
    problem = dm.ContactProblem(dm.Solid(fem.Function(V), LAW), [])
    upper = V.tabulate_dof_coordinates()[:, 2] > 0.05
    for way, count in ((-1.5, 1), (-0.05, 0), (1.0, 0)):
        problem.u.x.array[2::3] = way * upper
        assert len(notes_on_swept(problem, Crossing())) == count


@pytest.mark.mpi
@pytest.mark.parametrize("partition", ["graph", "bodies", "empty"])
@pytest.mark.parametrize("way", [-3.5, -0.05, -0.3])
def test_a_block_through_a_block(partition, way):
    """Wholly through, not as far as the other one, and into it, which another note tells."""
    report = dm.newton(sunk(partition, way=way))
    found = notes(report)
    assert report.certificate.crossing == (pytest.approx(0.6) if way == -0.3 else 0.0)
    assert len(found) == (way == -3.5)
    if found:
        assert "give them a Contact" in found[0] and "smaller steps" in found[0]


@pytest.mark.mpi
def test_one_that_ends_inside():
    """A small block ends wholly within a large one: no boundaries cross there."""
    blocks, _, facets = two_blocks(COMM, gap=0.1, x_upper=(0.3, 0.7), heights=(1.0, 0.3))
    V = fem.functionspace(blocks, ("Lagrange", 1, (2,)))
    problem = dm.ContactProblem(dm.Solid(fem.Function(V), LAW), [], bcs=held(V, facets, -0.5))
    report = dm.newton(problem)
    assert report.certificate.crossing == 0.0 and len(notes(report)) == 1


def three_bodies(d, strain):
    """Return a problem of three cubes, with gaps between them as wide as they are."""
    n = [5, 1, 1][:d]
    ends = [np.zeros(d), np.array(n, dtype=float)]
    whole = (mesh.create_rectangle if d == 2 else mesh.create_box)(COMM, ends, n)
    cells = mesh.locate_entities(whole, d, lambda x: np.ones(x.shape[1], dtype=bool))
    middle = mesh.compute_midpoints(whole, d, cells)[:, 0]
    part = mesh.create_submesh(whole, d, cells[middle.astype(int) % 2 == 0])[0]
    V = fem.functionspace(part, ("Lagrange", 1, (d,)))
    return dm.ContactProblem(dm.Solid(fem.Function(V), LAW, strain=strain), [])


@pytest.mark.mpi
@pytest.mark.parametrize("strain", ["small", "finite"])
@pytest.mark.parametrize("d", [2, 3])
def test_ways_of_three_bodies(d, strain):
    """The first one goes through both others, through one, past it, or all turn as one body."""
    problem = three_bodies(d, strain)
    X = problem.V.tabulate_dof_coordinates()[:, :d]
    first = (X[:, 0] < 1.5)[:, None]
    across = np.eye(d)[1]

    def told(u):
        problem.u.x.array[:] = u.ravel()
        return notes_on_swept(problem, Crossing())

    (both,) = told(first * 6.0 * np.eye(d)[0])
    assert "(0.5, 0.5" in both and "(the first of 2 pairs of bodies)" in both
    (one,) = told(first * 3.0 * np.eye(d)[0])
    assert "pairs" not in one
    assert not told(first * (2.0 * np.eye(d)[0] + 4.0 * across))
    for angle in np.radians([30.0, 90.0]):
        turn = np.eye(d)
        turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        assert not told(X @ turn.T - X)


def cut_out(d, inside):
    """Return a problem of the cells of a box, .25 wide, whose middles (3, m) are inside."""
    ends, n = [np.array([-3.0, -3.0, 0.0][:d]), np.array([3.0, 3.0, 0.25][:d])], [24, 24, 1][:d]
    whole = (mesh.create_rectangle if d == 2 else mesh.create_box)(COMM, ends, n)
    cells = mesh.locate_entities(whole, d, lambda x: np.ones(x.shape[1], dtype=bool))
    part = cells[inside(mesh.compute_midpoints(whole, d, cells).T)]
    V = fem.functionspace(mesh.create_submesh(whole, d, part)[0], ("Lagrange", 1, (d,)))
    return dm.ContactProblem(dm.Solid(fem.Function(V), LAW, strain="finite"), [])


def turn(x, degrees, pole=(0.0, 0.0)):
    """Return points (n, d), turned in the plane of the first two axes."""
    arms = x[:, :2] - pole
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.column_stack([arms @ np.array([[c, s], [-s, c]]) + pole, x[:, 2:]])


@pytest.mark.mpi
@pytest.mark.parametrize("carried", [0.0, 50.0])
@pytest.mark.parametrize("d", [2, 3])
def test_corners_move_along_arcs(d, carried):
    """A bar turns by 90 degrees over a larger body: what lies beyond the chords is in its way."""

    def is_bar(x):
        return (np.abs(x[0]) < 2.001) & (np.abs(x[1]) < 0.501)

    def is_block(x):  # from 1.77 to 2.12 from the origin; the bar reaches to 2.06, chords to 1.46
        return (np.abs(x[0] - 1.375) < 0.126) & (np.abs(x[1] - 1.375) < 0.126)

    problem = cut_out(d, lambda x: is_bar(x) | is_block(x) | (x[1] < -2.25))
    X = problem.V.tabulate_dof_coordinates()
    bar, X = is_bar(X.T)[:, None], X[:, :d]
    for degrees, count in ((90.0, 1), (-90.0, 0), (20.0, 0)):
        x = turn(np.where(bar, turn(X, degrees), X), carried, (5.0, 1.0))
        problem.u.x.array[:] = (x - X).ravel()
        assert len(notes_on_swept(problem, Crossing())) == count


@pytest.mark.mpi
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("moved", ["ring", "pin"])
def test_a_ring_turns_around_a_pin(d, moved):
    """By 90 degrees: the chords of the ring's inner side meet the pin, the arcs do not.

    The pin is a chequerboard, and has more facets than the ring.
    """

    def is_pin(x):
        return np.hypot(x[0], x[1]) < 1.7

    def is_part(x):
        r, even = np.hypot(x[0], x[1]), np.floor(x[:2] / 0.25).sum(axis=0) % 2 == 0
        return ((r < 1.45) & even) | ((r > 1.95) & (r < 2.2))

    problem = cut_out(d, is_part)
    assert problem.bodies.count == 2
    X = problem.V.tabulate_dof_coordinates()
    turning, X = (is_pin(X.T) == (moved == "pin"))[:, None], X[:, :d]
    problem.u.x.array[:] = (np.where(turning, turn(X, 90.0), X) - X).ravel()
    assert not notes_on_swept(problem, Crossing())


@pytest.mark.mpi
@pytest.mark.parametrize("degrees", [30.0, 90.0])
def test_what_turns_on_a_face_does_not_enter(degrees):
    """Two boxes that touch: edges in the common plane turn through ends of upright ones."""
    boxes, *_ = two_boxes(COMM, (9, 9, 9), (10, 10, 10), heights=(1.0, 1.0))
    V = fem.functionspace(boxes, ("Lagrange", 1, (3,)))
    problem = dm.ContactProblem(dm.Solid(fem.Function(V), LAW, strain="finite"), [])
    X, upper = problem.X, problem.bodies.label == problem.bodies.centre[:, 2].argmax()
    x = np.where(upper[:, None], turn(X, degrees, (0.5, 0.5)), X)
    problem.u.x.array[: 3 * problem.n] = (x - X).ravel()
    problem.u.x.scatter_forward()
    assert not notes_on_swept(problem, Crossing())


@pytest.mark.mpi
def test_a_corner_that_enters_slowly():
    """A square turns over a facet: its corner is a twentieth of it deep for 27 degrees only."""
    side, gap = 4 / 3, 0.2
    squares, *_ = two_blocks(
        COMM, (1, 1), (1, 1), x_upper=(0.5 - side / 2, 0.5 + side / 2), heights=(1, side), gap=gap
    )
    V = fem.functionspace(squares, ("Lagrange", 1, (2,)))
    problem = dm.ContactProblem(dm.Solid(fem.Function(V), LAW, strain="finite"), [])
    X = V.tabulate_dof_coordinates()[:, :2]
    upper = (X[:, 1] > gap / 2)[:, None]
    for higher, count in ((0.0, 1), (0.1, 0)):
        raised = X + upper * np.array([0.0, higher])
        problem.committed.displacement[:] = (raised - X).ravel()[: 2 * problem.n]
        x = turn(raised, 90.0, (0.5, higher + gap + side / 2))
        problem.u.x.array[:] = (np.where(upper, x, X) - X).ravel()
        assert len(notes_on_swept(problem, Crossing())) == count


@pytest.mark.mpi
@pytest.mark.parametrize("make", [dm.Contact, dm.Tie])
def test_sides_are_left_to_their_interface(make):
    """The same motion, .2 into each other, with and without an interface between the faces."""
    for interfaces, count in (([], 1), ([make], 0)):
        problem = sunk(interfaces=interfaces)
        problem.u.interpolate(lambda x: np.stack([0 * x[0], -0.3 * (x[1] > 0.01)]))
        assert len(notes_on_swept(problem, Crossing())) == count


@pytest.mark.mpi
@pytest.mark.parametrize("order", [1, -1])
def test_overlaps_that_contacts_remove(order):
    """A thin block is moved out of a thick one, in which it lay wholly, and not by a contact."""
    blocks, _, facets = two_blocks(COMM, gap=-0.5, x_upper=(0.3, 0.7), heights=(1.0, 0.3))
    V = fem.functionspace(blocks, ("Lagrange", 1, (2,)))
    slave, master = (TOP_OF_LOWER, BOTTOM_OF_UPPER)[::order]
    bcs = held(V, facets, 0.6)
    for contacts, count in (([], 1), ([dm.Contact(facets, slave=slave, master=master)], 0)):
        problem = dm.ContactProblem(dm.Solid(fem.Function(V), LAW), contacts, bcs=bcs)
        assert len(notes(dm.newton(problem))) == count


def held(V, facets, way):
    """Return supports that hold the lower block and move the upper one."""
    bottom, top = (fem.locate_dofs_topological(V, 1, facets.find(tag)) for tag in (BOTTOM, TOP))
    down = fem.Constant(V.mesh, (0.0, way))
    return [fem.dirichletbc(np.zeros(2), bottom, V), fem.dirichletbc(down, top, V)]


def test_a_screw_is_made_in_equal_parts():
    """Three thirds of a motion that turns and shifts along its axis are the whole, with its way."""
    x, axis = np.array([[1.0, 0.0, 2.0], [0.0, -3.0, 1.0]]), np.array([1.0, 2.0, 2.0]) / 3.0
    whole = RigidMotion(rotation(axis, 2.0), np.array([0.3, 0.1, -0.7]))
    third, at = whole.part(1 / 3), [x]
    for _ in range(3):
        at.append(third.at(at[-1]))
    assert np.allclose(at[-1], whole.at(x), atol=1e-12)
    assert np.allclose(np.diff(np.array(at), axis=0) @ axis, whole.c @ axis / 3, atol=1e-12)


class Ranks:
    """A communicator on which this rank is one of several."""

    def __init__(self, *others):
        self.others = others

    def allgather(self, mine):
        return [self.others[0], mine, *self.others[1:]]


def test_the_first_place_is_that_of_all_ranks():
    """Of each pair the least place, whichever rank has it; of a rank without any, none."""
    bodies = np.array([[0, 1], [1, 2], [0, 1]])
    places = np.array([[2.0, 9.0], [1.0, 0.0], [2.0, 3.0]])
    before, after = (
        {(0, 1): [1.0, 5.0], (1, 2): [4.0, 0.0]},
        {(0, 1): [1.0, 6.0], (0, 2): [7.0, 7.0]},
    )
    found = _first(Ranks(before, {}, after), bodies, places)
    assert found == {(0, 1): [1.0, 5.0], (1, 2): [1.0, 0.0], (0, 2): [7.0, 7.0]}
    alone = _first(Ranks({}), bodies, places)
    assert alone == {(0, 1): [2.0, 3.0], (1, 2): [1.0, 0.0]}

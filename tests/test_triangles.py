# SPDX-License-Identifier: MIT
"""Tools of triangles: distances, orders of convergence, files, contact, and what is no surface."""

from mpi4py import MPI

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import dolfinx_mortar as dm
from dolfinx import fem, mesh
from dolfinx_mortar import shapes
from dolfinx_mortar.shapes.curved import EDGE, FACE, POINT, create_tree, find_nearest
from tests.cases.pressed_blocks import rejected
from tests.cases.triangles import ball, box, write_binary, write_text

COMM = MPI.COMM_WORLD
BALL = shapes.Sphere([0.1, 0.2, 0.3], 1.0)
ELASTIC = dm.Elastic(200.0, 0.3)


def around(n=1500):
    """Return points near the unit sphere around the centre of BALL."""
    rng = np.random.default_rng(0)
    x = rng.standard_normal((n, 3))
    return BALL.centre + x * (rng.uniform(0.8, 1.4, n) / np.linalg.norm(x, axis=1))[:, None]


def test_a_ball_converges():
    """The distance with order 4, its gradient with 3, its Hessian with 2, as smooth surfaces do.

    Those of flat triangles have 2, 1, and none.
    """
    x = around()
    exact = BALL.distance(x)
    errors = []
    for n in (2, 3, 4):
        found = shapes.Triangles(ball(n, centre=BALL.centre)).distance(x)
        bent = np.abs(found.hessian - exact.hessian).max(axis=(1, 2))
        errors.append(
            [
                np.abs(found.value - exact.value).max(),
                np.abs(found.gradient - exact.gradient).max(),
                np.median(bent),  # at edges two curvatures meet
            ]
        )
    orders = np.log2(np.array(errors)[:-1] / np.array(errors)[1:])
    assert (orders > [3.7, 2.6, 1.7]).all()
    flat = shapes.Triangles(ball(4, centre=BALL.centre), crease=0.0).distance(x)
    assert np.abs(flat.value - exact.value).max() > 1e3 * errors[-1][0]


coordinates = st.tuples(*3 * [st.floats(-1.6, 1.6)])


@settings(max_examples=60, deadline=None)
@given(st.lists(coordinates, min_size=1, max_size=20), st.booleans())
def test_a_box_is_a_box(points, reverse):
    """Sharp edges and corners, by the closed form of the distance from a box; and its socket."""
    x = np.array(points)
    shape = shapes.Triangles(box(low=(-1.0, -0.5, -1.0), high=(1.0, 0.5, 1.0)))
    q = np.abs(x) - [1.0, 0.5, 1.0]
    outside = np.linalg.norm(np.maximum(q, 0.0), axis=1)
    expected = outside + np.minimum(q.max(axis=1), 0.0)
    found = (shapes.Complement(shape) if reverse else shape).distance(x)
    sign = -1.0 if reverse else 1.0
    assert sign * found.value == pytest.approx(expected, abs=1e-12)
    assert np.linalg.norm(found.gradient, axis=1) == pytest.approx(np.ones(len(x)))


@pytest.mark.parametrize("kind", ["ball", "open", "box"])
def test_derivatives(kind):
    """Gradient and Hessian against central differences, where the nearest point stays in place."""
    points, triangles = (
        box(low=(-0.7, -0.6, -0.5), high=(0.9, 1.0, 1.1))
        if kind == "box"
        else (ball(1, centre=BALL.centre))
    )
    if kind == "open":
        triangles = triangles[points[triangles, 2].max(axis=1) < 1.0]
    shape = shapes.Triangles((points, triangles), rim=kind == "open", crease=45.0)
    x, h = around(400), 1e-5
    found = shape.distance(x)
    ways = h * np.eye(3)
    ends = [(shape.distance(x + way), shape.distance(x - way)) for way in ways]
    slope = np.stack([(a.value - b.value) / (2 * h) for a, b in ends], axis=-1)
    bend = np.stack([(a.gradient - b.gradient) / (2 * h) for a, b in ends], axis=-1)
    same = np.ones(len(x), dtype=bool)
    for end in (end for pair in ends for end in pair):
        same &= np.abs(end.gradient - found.gradient).max(axis=1) < 1e-3
    size = 1.0 + np.abs(found.hessian).max(axis=(1, 2)) ** 3
    assert same.mean() > 0.95
    assert (np.abs(slope - found.gradient).max(axis=1) < 1e-8 * size)[same].all()
    assert (np.abs(bend - found.hessian).max(axis=(1, 2)) < 1e-7 * size)[same].mean() > 0.99
    assert np.linalg.norm(found.gradient, axis=1) == pytest.approx(np.ones(len(x)))


def test_around_a_centre_of_curvature():
    """Of a parabolic cylinder z = x (2 - x) / 4, whose radius is 2 at its top, in one triangle.

    At the centre all points near the top are as far, to the last bit; beyond it edges are nearest.
    """
    corners = np.array([[[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0]]])
    a = np.array([[[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]])
    bends = np.stack([a, -a], axis=2)
    s, t = np.linspace(0.0, 1.0, 401)[:, None], np.linspace(0.0, 1.0, 401)[None]
    inside = s + t <= 1.0
    surface = np.stack([2.0 * s + 0.0 * t, 2.0 * t + 0.0 * s, s * (1.0 - s) + 0.0 * t], axis=2)
    depth = np.array([1.0, 1.9, 2.0, 2.1, 3.0, 5.0])
    x = np.array([1.0, 0.5, 0.25]) - depth[:, None] * [0.0, 0.0, 1.0]
    exact = np.linalg.norm(surface[inside][None] - x[:, None], axis=2).min(axis=1)
    _, where, at = find_nearest(x, corners, bends, *create_tree(corners, bends))
    for k, kind in enumerate(where):
        (a, b) = at[k]
        edge = kind - EDGE
        if kind >= EDGE:
            (a, b) = ((a, 0.0), (1.0 - a, a), (0.0, 1.0 - a))[edge]
        point = 2.0 * a, 2.0 * b, a * (1.0 - a)
        assert kind < POINT and np.linalg.norm(point - x[k]) == pytest.approx(exact[k], rel=1e-3)
    assert (where[:2] == FACE).all() and (where[4:] >= EDGE).all()


def test_files(tmp_path):
    """Binary and text, the corners of which are single numbers, and arrays; corners are merged."""
    points, triangles = ball(2)
    binary, text = tmp_path / "ball.stl", tmp_path / "ball.txt"
    write_binary(binary, points, triangles)
    write_text(text, points, triangles)
    x = around(50)
    exact = shapes.Triangles((points, triangles)).distance(x).value
    for path in (binary, str(text)):
        shape = shapes.Triangles(path)
        assert len(shape.triangulation.points) == len(points)
        assert shape.distance(x).value == pytest.approx(exact, abs=1e-6)
        assert repr(shape).startswith("Triangles('") and "320 triangles" in repr(shape)
    one, other = (shapes.Triangles(p) for p in (binary, text))
    assert one.given()["surface"] == other.given()["surface"]
    assert shape.point == pytest.approx(np.zeros(3), abs=1e-6)
    assert shapes.Triangles(binary, [0.0, 0.0, -1.0]).point.tolist() == [0.0, 0.0, -1.0]


# -- contact -------------------------------------------------------------------------------------


class Slab:
    """A clamped box below z = 0, whose top meets a tool."""

    def __init__(self, comm=COMM, n=(6, 6, 2), cell=mesh.CellType.hexahedron):
        """Create mesh, tags and space."""
        self.mesh = mesh.create_box(comm, [[-1.0, -1.0, -1.0], [1.0, 1.0, 0.0]], n, cell)
        top = mesh.locate_entities_boundary(self.mesh, 2, lambda x: np.isclose(x[2], 0.0))
        self.facets = mesh.meshtags(self.mesh, 2, np.sort(top), np.full(len(top), 1, np.int32))
        self.mesh.geometry.x[:, 0] += 0.1 * self.mesh.geometry.x[:, 1]
        self.V = fem.functionspace(self.mesh, ("Lagrange", 1, (3,)))
        self.u = fem.Function(self.V)

    def press(self, shape, depth, clamped=True, **options):
        """Press a tool into it; return it and the report."""
        tool = dm.Obstacle(self.facets, slave=1, shape=shape)
        base = fem.locate_dofs_geometrical(self.V, lambda x: np.isclose(x[2], -1.0))
        bcs = [fem.dirichletbc(np.zeros(3), base, self.V)]
        law = ELASTIC if clamped else dm.Elastic(200.0, 0.0)
        problem = dm.ContactProblem(dm.Solid(self.u, law), [tool], bcs=bcs, **options)
        tool.position.value[2] -= depth
        return tool, dm.newton(problem, rtol=1e-10)


@pytest.mark.mpi
def test_a_flat_file_is_a_plane():
    """Uniform pressure below the lower face of a box, to round-off, in a mesh with other lines."""
    case = Slab(n=(3, 2, 2))
    shape = shapes.Triangles(box(low=(-1.7, -1.3, 0.0), high=(1.9, 1.6, 0.5)))
    tool, _ = case.press(shape, 0.05, clamped=False)
    found = tool.gather(case.u)
    assert found["pressure"] == pytest.approx(200.0 * 0.05, rel=1e-9)
    assert tool.tool_force == pytest.approx([0.0, 0.0, 40.0], abs=1e-7)


@pytest.mark.mpi
def test_on_any_ranks():
    """The same force as on one rank, to 1e-10."""
    shape = shapes.Triangles(ball(2, 2.0, (0.1, 0.2, 2.0)))
    forces = [Slab(comm, n=(4, 4, 2)).press(shape, 0.1)[0].force for comm in (COMM, MPI.COMM_SELF)]
    assert forces[0] == pytest.approx(forces[1], rel=1e-10, abs=1e-10)


@pytest.mark.serial
def test_forces_converge_to_those_of_a_sphere():
    """With order 4 in the size of the triangles and as many iterations; flat ones are far worse."""
    centre = (0.1, 0.2, 2.0)
    tool, report = Slab().press(shapes.Sphere(centre, 2.0), 0.1)
    exact, errors = tool.force, []
    for crease, n in ((45.0, 1), (45.0, 3), (0.0, 3)):
        tool, found = Slab().press(shapes.Triangles(ball(n, 2.0, centre), crease=crease), 0.1)
        errors.append(np.linalg.norm(tool.force - exact) / np.linalg.norm(exact))
        if crease:
            assert found.newton_iterations <= report.newton_iterations + 1
    coarse, fine, flat = errors
    assert fine < coarse / 2.0 ** (2 * 3.5)
    assert fine < 1e-4 and flat > 1e2 * fine


# -- bad input -----------------------------------------------------------------------------------


def turned():
    points, triangles = ball(2)
    triangles[[3, 50, 51]] = triangles[[3, 50, 51], ::-1]
    return points, triangles


def degenerate():
    points, triangles = box()
    return np.vstack([points, points[:1]]), np.vstack([triangles, [0, 1, 8]])


def fin():
    points, triangles = box()
    return np.vstack([points, [[5.0, 5.0, 5.0]]]), np.vstack([triangles, [*triangles[0, :2], 8]])


POINTS, FACES = box()
WRONG = [
    (lambda: (POINTS, FACES[2:]), {}, ("4 triangles at a hole among 10", "around (", "rim=True")),
    (turned, {}, ("3 triangles that are turned", "around (", "counterclockwise")),
    (degenerate, {}, ("1 triangles without area", "(-1, -1, 0.3333)")),
    (fin, {}, ("three or more", "3 triangles with")),
    (lambda: (POINTS, FACES[:, ::-1]), {}, ("inside out", "Complement")),
    (lambda: 3, {}, ("surface is 3", "path of an STL")),
    (lambda: (POINTS[:, :2], FACES), {}, ("points is an array of shape (8, 2)",)),
    (lambda: (POINTS, [["a"]]), {}, ("triangles is [['a']]",)),
    (lambda: (POINTS, FACES + 1), {}, ("numbers of points, 0 to 7",)),
    (lambda: (POINTS * np.nan, FACES), {}, ("points", "nan at [0, 0]")),
    (box, {"rim": "x"}, ("rim is 'x'", "True or False")),
    (box, {"crease": 120.0}, ("crease is 120.0", ">= 0 and <= 90")),
    (box, {"point": [0.0, 0.0]}, ("point is [0.0, 0.0]", "3 finite")),
]


@pytest.mark.parametrize(("surface", "options", "words"), WRONG)
def test_what_is_no_surface(surface, options, words):
    with rejected(*words):
        shapes.Triangles(surface(), **options)


@pytest.mark.parametrize("content", [b"", b"solid but nothing", b"\0" * 90, b"PK" * 200])
def test_what_is_no_file(tmp_path, content):
    path = tmp_path / "tool.stl"
    with rejected("tool.stl", "cannot be read"):
        shapes.Triangles(path).distance(np.zeros((1, 3)))
    path.write_bytes(content)
    with rejected("tool.stl", "no STL file", f"{len(content)} bytes"):
        shapes.Triangles(path).distance(np.zeros((1, 3)))


@pytest.mark.parametrize(
    ("value", "end", "words"),
    [
        ("0.0", "", ("ends after 2 triangles", "cut off")),
        ("nan", "endsolid\n", ("1 of 2 triangles", "not finite, first number 2")),
    ],
)
def test_damaged_text(tmp_path, value, end, words):
    """Which a surface with rim=True would not show."""
    path = tmp_path / "tool.stl"
    corners = "vertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\n"
    path.write_text(f"solid\n{corners}{corners[:-2]}{value}\n{end}")
    with rejected("tool.stl", *words):
        shapes.Triangles(path, rim=True).distance(np.zeros((1, 3)))


@pytest.mark.mpi
@pytest.mark.parametrize("lacking", ["one", "all"])
def test_a_file_that_ranks_lack(tmp_path, lacking):
    """No rank leaves the others when it reads; all raise when a problem is made."""
    file = COMM.bcast(tmp_path) / "box.stl"
    if COMM.rank == 0 and lacking == "one":
        write_binary(file, *box())
    COMM.barrier()
    if COMM.rank == COMM.size - 1:
        file = file.with_name("none.stl")
    words = ("which cannot be read",)
    if COMM.size > 1 and lacking == "one":
        words = "shape.surface differs between the ranks", "not read, ", "give all ranks"
    with rejected(*words):
        Slab().press(shapes.Triangles(file), 0.1)


def test_in_space_only():
    assert "mesh of 2" in shapes.Triangles(box()).misfit(2, True)

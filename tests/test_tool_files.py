# SPDX-License-Identifier: MIT
"""Rigid tools in files: on their surfaces, where they are at every time, also after a restart."""

import sys

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem, mesh
from dolfinx_mortar.shapes.zero_level import find_zero_level
from tests.cases.tool import TOP, Block
from tests.cases.triangles import ball

meshio = pytest.importorskip("meshio")
h5py = pytest.importorskip("h5py")

COMM = MPI.COMM_WORLD
pytestmark = pytest.mark.mpi
TIMES = [0.25, 0.5, 1.0]
PROFILE = [(5.0, 0.1), (6.5, 0.0), (8.0, 0.9), (8.0, 1.5), (5.0, 1.5)]


@pytest.fixture
def folder(tmp_path):
    """Return a folder that all ranks see."""
    return COMM.bcast(tmp_path)


def in_plane(degree=1, **options):
    """Return tools of two kinds beside a block that turn and move, their ways, and the problem."""
    case = Block(n=4, degree=degree)
    disc = case.tool(dm.shapes.Cylinder([2.0, 1.0], 1.0))
    bar = case.tool(dm.shapes.Polyline(PROFILE))
    problem = case.problem([disc, bar], **options)
    way = {disc.position: [(0.0, [2.0, 1.0]), (1.0, [2.5, 0.9])]}
    way |= {bar.rotation: [(0.0, 0.0), (1.0, -0.02)], disc.rotation: [(0.0, 0.0), (1.0, 0.5)]}
    return problem, [disc, bar], way


def of_revolution():
    """Return a die beside the axis and a ball on it."""
    case = Block(n=4)
    ring = case.tool(dm.shapes.Torus([0.0, 0.5], 4.0, 0.5))
    tip = case.tool(dm.shapes.Sphere([0.0, 1.0], 1.0))
    problem = case.problem([ring, tip], kinematics="axisymmetric")
    return problem, [ring, tip], {tip.position: [(0.0, [0.0, 1.0]), (1.0, [0.0, 0.95])]}


def in_space():
    """Return a torus that tumbles over a box, and a ball of triangles."""
    domain = mesh.create_box(COMM, [[-1.0, -1.0, -0.5], [1.0, 1.0, 0.0]], [3, 3, 1])
    top = mesh.locate_entities_boundary(domain, 2, lambda x: np.isclose(x[2], 0.0))
    facets = mesh.meshtags(domain, 2, np.sort(top), np.full(len(top), TOP, np.int32))
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (3,))))
    V = u.function_space
    base = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[2], -0.5))
    shapes = [
        dm.shapes.Torus([0.5, 0.0, 0.3], 0.4, 0.2, [0.0, 0.1, 1.0]),
        dm.shapes.Triangles(ball(2, 0.5, (-0.5, 0.0, 0.5)), crease=45.0),
    ]
    tools = [dm.Obstacle(facets, slave=TOP, shape=shape) for shape in shapes]
    solid = dm.Solid(u, dm.Elastic(200.0, 0.3))
    problem = dm.ContactProblem(solid, tools, bcs=[fem.dirichletbc(np.zeros(3), base, V)])
    return problem, tools, {tools[0].rotation: [(0.0, np.zeros(3)), (1.0, [0.1, 0.0, 0.4])]}


def walk(folder, made, stop=None, every=1):
    """Write tools step by step; return where they were at each time."""
    problem, tools, way = made
    found = {}
    with dm.Writer(folder / "out.xdmf", problem, resume=True) as out:
        options = {"checkpoint": folder / "run.h5", "every": every, "progress": False}
        steps = dm.load_steps(problem, TIMES, ramp=way, **options)
        for step in steps:
            out.write(step.time)
            found[step.time] = [tool.tool.pose() for tool in tools]
            if step.number == stop:
                sys.exit()
    COMM.barrier()
    return found


def read(file):
    """Return by times: points, cells, and the number of the tool of each cell."""
    found = {}
    with meshio.xdmf.TimeSeriesReader(file) as reader:
        reader.read_points_cells()
        for k, grid in enumerate(reader.collection):
            time, _, of_cells = reader.read_data(k)
            assert time not in found
            read_item = reader._read_data_item
            points, cells = (read_item(grid.find(n)[0]) for n in ("Geometry", "Topology"))
            found[time] = points, cells, of_cells["tool"][0]
    COMM.barrier()
    return found


def results(folder):
    """Return the times of the results."""
    with meshio.xdmf.TimeSeriesReader(folder / "out.xdmf") as reader:
        reader.read_points_cells()
        times = [reader.read_data(k)[0] for k in range(reader.num_steps)]
    COMM.barrier()
    return times


def check(found, poses, tools):
    """Compare a file with where the tools were: points lie on them, cells are as fine as asked."""
    for time, (points, cells, of) in found.items():
        if time not in poses:
            continue
        assert sorted(set(of)) == [0, 1]
        for k, (tool, pose) in enumerate(zip(tools, poses[time], strict=True)):
            mine = points[np.unique(cells[of == k])][:, : len(tool.reference)]
            assert len(mine) > 10
            assert np.abs(pose.distance(tool.shape, mine).value).max() < 1e-12
            middles = points[cells[of == k]].mean(axis=1)[:, : len(tool.reference)]
            assert np.abs(pose.distance(tool.shape, middles).value).max() < 0.05


@pytest.mark.parametrize("made", [in_plane, of_revolution, in_space])
def test_tools_are_where_they_were(folder, made):
    problem = made()
    poses = walk(folder, problem)
    found = read(folder / "out.tools.xdmf")
    assert list(found) == results(folder) == TIMES
    check(found, poses, problem[1])
    first, last = found[TIMES[0]][0], found[TIMES[-1]][0]
    assert np.abs(first - last).max() > 0.01
    if made is of_revolution:
        assert min(points[:, 0].min() for points, _, _ in found.values()) >= -1e-12


@pytest.mark.parametrize(("stop", "every"), [(2, 1), (1, 2)])
def test_after_a_restart(folder, stop, every):
    """It goes on where the results do, also where the checkpoint knows less than the files."""
    with pytest.raises(SystemExit):
        walk(folder, in_plane(), stop, every)
    COMM.barrier()
    made = in_plane()
    poses = walk(folder, made)
    found = read(folder / "out.tools.xdmf")
    assert list(found) == results(folder) == TIMES
    check(found, poses, made[1])


def test_a_side_that_leaves_the_box(folder):
    """A plane is drawn around the side; when the tool has gone far, it is cut anew."""
    case = Block(n=4)
    plane = case.tool(dm.shapes.Plane([0.0, 0.1], [0.0, -1.0]))
    problem = case.problem([plane])
    with dm.Writer(folder / "out.xdmf", problem) as out:
        for t in range(3):
            plane.position.value[0] = 15.0 * t
            out.write(t)
    found = read(folder / "out.tools.xdmf")
    for points, _, _ in found.values():
        assert points[:, 0].min() <= 0.0 and points[:, 0].max() >= 10.0
        assert points[:, 1] == pytest.approx(np.full(len(points), 0.1))
    files = [item.stat().st_size for item in folder.glob("*.tools.h5")]
    COMM.barrier()
    assert len(files) == 1


def test_a_failed_step_may_be_written_again(folder, monkeypatch):
    """Tools are there once, also where the results could not be written after them."""
    case = Block(n=4)
    plane = case.tool(dm.shapes.Plane([0.0, 0.1], [0.0, -1.0]))
    problem = case.problem([plane])

    def fail(steps):
        raise OSError("no")

    with dm.Writer(folder / "out.xdmf", problem) as out:
        with monkeypatch.context() as patch, pytest.raises(OSError, match="no"):
            patch.setattr(out._file, "replace", fail)
            out.write(1.0)
        out.write(1.0)
        plane.position.value[1] = 0.2
        out.write(2.0)
    heights = {
        t: points[:, 1].mean() for t, (points, *_) in read(folder / "out.tools.xdmf").items()
    }
    assert heights == pytest.approx({1.0: 0.1, 2.0: 0.2})


def test_without_tools_there_is_no_file(folder):
    case = Block(n=2)
    with dm.Writer(folder / "out.xdmf", case.problem([])) as out:
        out.write(0.0)
    COMM.barrier()
    assert not list(folder.glob("*tools*"))


@pytest.mark.serial
@pytest.mark.parametrize(
    ("shape", "measure"),
    [
        (dm.shapes.Cylinder([0.2, 0.1], 0.5), np.pi),
        (dm.shapes.Sphere([0.2, 0.1, 0.0], 0.5), np.pi),
        (dm.shapes.Sphere([0.2, 0.1, 0.0], 0.003), np.pi * 0.006**2),
        (dm.shapes.Plane([0.0, 0.0], [0.0, 1.0]), 2.0),
        (dm.shapes.Plane([5.0, 0.0, 5.0], [0.0, 0.0, 1.0]), 0.0),
    ],
)
def test_the_whole_surface_is_found(shape, measure):
    """Lengths and areas in a box from -1 to 1, of lines and triangles that meet at points."""
    d = len(shape.point)
    x, cells = find_zero_level(shape, -np.ones(d), np.ones(d))
    edges = np.pad(np.diff(x[cells], axis=1), ((0, 0), (0, 0), (0, 3 - d)))
    cross = np.cross(edges[:, 0], edges[:, -1])
    sizes = np.linalg.norm(edges[:, 0], axis=1) if d == 2 else np.linalg.norm(cross, axis=1) / 2
    assert sizes.sum() == pytest.approx(measure, rel=2e-3)
    if (
        0.0 < measure != 2.0
    ):  # closed: as many points as lines, or 2 more than half of the triangles
        assert len(x) == (len(cells) if d == 2 else len(cells) / 2 + 2)

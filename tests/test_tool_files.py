# SPDX-License-Identifier: MIT
"""Rigid tools in files and pictures: on their surfaces, where they are, also after a restart."""

import sys

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx_mortar.shapes.zero_level import find_zero_level
from tests.cases.triangles import ball
from tests.tool_case import Block, Box

meshio = pytest.importorskip("meshio")
pytest.importorskip("h5py")
pyplot = pytest.importorskip("matplotlib.pyplot")

COMM = MPI.COMM_WORLD
pytestmark = pytest.mark.mpi
TIMES = [0.25, 0.5, 1.0]
PROFILE = [(5.0, 0.1), (6.5, 0.0), (8.0, 0.9), (8.0, 1.5), (5.0, 1.5)]
PLANE = dm.shapes.Plane([0.0, 0.1], [0.0, -1.0])


def in_plane():
    """Return tools of two kinds beside a block that turn and move, their ways, and the problem."""
    case = Block(n=4)
    disc, bar = (
        case.tool(dm.shapes.Cylinder([2.0, 1.0], 1.0)),
        case.tool(dm.shapes.Polyline(PROFILE)),
    )
    way = {disc.position: [(0.0, [2.0, 1.0]), (1.0, [2.5, 0.9])]}
    way |= {bar.rotation: [(0.0, 0.0), (1.0, -0.02)], disc.rotation: [(0.0, 0.0), (1.0, 0.5)]}
    return case.problem([disc, bar]), [disc, bar], way


def of_revolution():
    """Return a die beside the axis and a ball on it."""
    case = Block(n=4)
    tools = [
        case.tool(dm.shapes.Torus([0.0, 0.5], 4.0, 0.5)),
        case.tool(dm.shapes.Sphere([0.0, 1.0], 1.0)),
    ]
    way = {tools[1].position: [(0.0, [0.0, 1.0]), (1.0, [0.0, 0.95])]}
    return case.problem(tools, kinematics="axisymmetric"), tools, way


def in_space():
    """Return a torus that tumbles over a box, and a ball of triangles."""
    case = Box("tetrahedron", (3, 3, 1), (-1.0, -1.0, -0.5), (1.0, 1.0, 0.0))
    tools = [
        case.tool(dm.shapes.Torus([0.5, 0.0, 0.3], 0.4, 0.2, [0.0, 0.1, 1.0])),
        case.tool(dm.shapes.Triangles(ball(2, 0.5, (-0.5, 0.0, 0.5)), crease=45.0)),
    ]
    return (
        case.problem(tools),
        tools,
        {tools[0].rotation: [(0.0, np.zeros(3)), (1.0, [0.1, 0, 0.4])]},
    )


def walk(folder, made, stop=None, every=1):
    """Write tools step by step; return where they were at each time."""
    problem, tools, way = made
    found = {}
    with dm.Writer(folder / "out.xdmf", problem, resume=True) as out:
        options = {"checkpoint": folder / "run.h5", "every": every, "progress": False}
        for step in dm.load_steps(problem, TIMES, ramp=way, **options):
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
            item = reader._read_data_item
            points, cells = (item(grid.find(n)[0]) for n in ("Geometry", "Topology"))
            found[time] = points, cells, of_cells.get("tool", [None])[0]
    COMM.barrier()
    return found


def check(folder, poses, tools):
    """Points lie on the tools where they were, cells are as fine as asked; return the file."""
    found = read(folder / "out.tools.xdmf")
    with meshio.xdmf.TimeSeriesReader(folder / "out.xdmf") as reader:
        reader.read_points_cells()
        times = [reader.read_data(k)[0] for k in range(reader.num_steps)]
    COMM.barrier()
    assert list(found) == times == TIMES
    for time in poses:
        points, cells, of = found[time]
        assert sorted(set(of)) == [0, 1]
        for k, (tool, pose) in enumerate(zip(tools, poses[time], strict=True)):
            d = len(tool.reference)
            mine = points[np.unique(cells[of == k])][:, :d]
            assert len(mine) > 4
            assert np.abs(pose.distance(tool.shape, mine).value).max() < 1e-12
            middles = points[cells[of == k]].mean(axis=1)[:, :d]
            assert np.abs(pose.distance(tool.shape, middles).value).max() < 0.05
    return found


@pytest.mark.parametrize("create", [in_plane, of_revolution, in_space])
def test_tools_are_where_they_were(folder, create):
    made = create()
    found = check(folder, walk(folder, made), made[1])
    first, last = found[TIMES[0]][0], found[TIMES[-1]][0]
    assert np.abs(first - last).max() > 0.01
    if create is of_revolution:
        assert min(points[:, 0].min() for points, _, _ in found.values()) >= -1e-12


def test_after_a_restart(folder):
    """It goes on where the results do, also where the checkpoint knows less than the files."""
    with pytest.raises(SystemExit):
        walk(folder, in_plane(), stop=1, every=2)
    COMM.barrier()
    made = in_plane()
    check(folder, walk(folder, made), made[1])


def test_a_side_that_leaves_the_box(folder):
    """A plane is drawn around the side; when the tool has gone far, it is cut anew."""
    case = Block(n=4)
    plane = case.tool(PLANE)
    with dm.Writer(folder / "out.xdmf", case.problem([plane])) as out:
        for t in range(3):
            plane.position.value[0] = 15.0 * t
            out.write(t)
    for points, _, _ in read(folder / "out.tools.xdmf").values():
        assert points[:, 0].min() <= 0.0 and points[:, 0].max() >= 10.0
        assert points[:, 1] == pytest.approx(np.full(len(points), 0.1))
    count = len(list(folder.glob("*.tools.h5")))
    COMM.barrier()
    assert count == 1


@pytest.mark.serial
@pytest.mark.parametrize(
    ("shape", "measure"),
    [
        (dm.shapes.Cylinder([0.2, 0.1], 0.5), np.pi),
        (dm.shapes.Sphere([0.2, 0.1, 0.0], 0.5), np.pi),
        (dm.shapes.Sphere([0.2, 0.1, 0.0], 0.003), np.pi * 0.006**2),
        (dm.shapes.Plane([0.0, 0.0], [0.0, 1.0]), 2.0),
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
    if measure != 2.0:  # closed: Euler's number of points
        assert len(x) == (len(cells) if d == 2 else len(cells) / 2 + 2)


# -- pictures


def test_picture_in_the_plane():
    """The line phi = 0 is the moved circle, behind the body; none where motions are enlarged."""
    case = Block(n=4)
    tool = case.tool(dm.shapes.Cylinder([1.0, 2.0], 2.0))
    problem = case.problem([tool])
    tool.position.value[:] = 2.0, 1.5
    axes = dm.plotting.field(problem, "von_mises")
    if COMM.rank == 0:
        body, inside, line = axes.collections
        x = np.concatenate([path.vertices for path in line.get_paths()])
        away = np.linalg.norm(x - [2.0, 1.5], axis=1)
        assert len(x) > 100 and away == pytest.approx(np.full(len(x), 2.0), abs=1e-3)
        assert x[:, 1].min() == pytest.approx(-0.5, abs=1e-3) and inside.zorder < body.zorder
    for what, options in ((problem, {"scale": 2.0}), (problem.solid, {})):  # which knows no tools
        axes = dm.plotting.field(what, "von_mises", **options)
        assert COMM.rank > 0 or len(axes.collections) == 1
    pyplot.close("all")


@pytest.mark.serial
@pytest.mark.parametrize("kind", [dm.shapes.Sphere, dm.shapes.Triangles])
def test_picture_in_space(kind, tmp_path):
    """Surfaces of grids and of triangles, cut off at the box around the body; none out of it."""
    pytest.importorskip("pyvista")
    case, file = Box("hexahedron", (2, 2, 1), (-1.0, -1.0, -1.0), (1.0, 1.0, 0.0)), "tool.png"
    centre = np.array((0.2, 0.1, 0.4))
    shape = kind(ball(3, 0.4, centre)) if kind is dm.shapes.Triangles else kind(centre, 0.4)
    tools = [case.tool(one) for one in (shape, dm.shapes.Plane((0, 0, 50.0), (0, 0, -1.0)))]
    plotter = dm.plotting.field(case.problem(tools), "displacement", file=tmp_path / file)
    actors = [actor for actor in plotter.actors.values() if hasattr(actor, "prop")]
    (drawn,) = (actor.mapper.dataset for actor in actors if actor.prop.opacity == 0.35)
    assert (tmp_path / file).stat().st_size > 0
    r = np.linalg.norm(drawn.points - centre, axis=1)
    assert r == pytest.approx(np.full(len(r), 0.4), abs=5e-3)
    assert drawn.points[:, 2].max() == pytest.approx(0.3, abs=5e-3)
    plotter.close()

# SPDX-License-Identifier: MIT
"""Rigid tools in pictures: where they are now, and only where displacements are not enlarged."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from tests.cases.tool import Block
from tests.cases.triangles import ball
from tests.test_triangles import Slab

FIRST = MPI.COMM_WORLD.rank == 0
pyplot = pytest.importorskip("matplotlib.pyplot")


@pytest.mark.mpi
def test_in_the_plane():
    """The line phi = 0 is the moved circle, and the body is seen in front of the tool."""
    case = Block(n=4)
    tool = case.tool(dm.shapes.Cylinder([1.0, 2.0], 2.0))
    problem = case.problem([tool])
    tool.position.value[:] = 2.0, 1.5
    axes = dm.plotting.field(problem, "von_mises")
    if FIRST:
        body, inside, line = axes.collections
        x = np.concatenate([path.vertices for path in line.get_paths()])
        assert len(x) > 100 and np.linalg.norm(x - [2.0, 1.5], axis=1) == pytest.approx(
            np.full(len(x), 2.0), abs=1e-3
        )
        assert x[:, 1].min() == pytest.approx(-0.5, abs=1e-3) and inside.zorder < body.zorder
        pyplot.close("all")
    axes = dm.plotting.field(problem, "von_mises", scale=2.0)
    if FIRST:
        assert len(axes.collections) == 1
        pyplot.close("all")
    axes = dm.plotting.field(problem.solid, "von_mises")  # knows no tools
    assert axes is None or len(axes.collections) == 1
    pyplot.close("all")


@pytest.mark.serial
def test_in_space(tmp_path):
    """Surfaces of grids and of triangles, cut off at the box around the body."""
    pytest.importorskip("pyvista")
    case = Slab(n=(2, 2, 1))
    centre = (0.2, 0.1, 0.4)
    shapes = dm.shapes.Sphere(centre, 0.4), dm.shapes.Triangles(ball(3, 0.4, centre))
    for shape in (*shapes, dm.shapes.Plane((0.0, 0.0, 50.0), (0.0, 0.0, -1.0))):
        tool = dm.Obstacle(case.facets, slave=1, shape=shape)
        problem = dm.ContactProblem(dm.Solid(case.u, dm.Elastic(200.0, 0.3)), [tool])
        file = tmp_path / "tool.png"
        plotter = dm.plotting.field(problem, "displacement", file=file)
        actors = [actor for actor in plotter.actors.values() if hasattr(actor, "prop")]
        drawn = [actor for actor in actors if actor.prop.opacity == 0.35]
        assert file.stat().st_size > 0
        if not shape.point[2] < 1.0:
            assert not drawn  # out of the picture
            continue
        (mesh,) = (actor.mapper.dataset for actor in drawn)
        r = np.linalg.norm(mesh.points - np.array(centre), axis=1)
        assert r == pytest.approx(np.full(len(r), 0.4), abs=5e-3)
        top = 0.1 * np.linalg.norm([2.2, 2.0, 1.0])
        assert mesh.points[:, 2].max() == pytest.approx(top, abs=5e-3)
        plotter.close()

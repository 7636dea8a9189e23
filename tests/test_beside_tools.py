# SPDX-License-Identifier: MIT
"""Bodies that fold onto a rigid tool beside the side that may meet it."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem, mesh

SENTENCE = "deep in the tool, "


def notes_of_pressing(side, *, half=0.5, depth=0.4, friction=1.0):
    """Return the notes when the upper face of a rubber block 1 high is pressed down by a plane."""
    block = mesh.create_rectangle(
        MPI.COMM_WORLD,
        [(-half, 0.0), (half, 1.0)],
        (round(16 * half), 12),
        mesh.CellType.quadrilateral,
    )
    facets = mesh.locate_entities_boundary(block, 1, side)
    tags = mesh.meshtags(block, 1, np.sort(facets), np.ones(len(facets), dtype=np.int32))
    V = fem.functionspace(block, ("Lagrange", 1, (2,)))
    rubber = dm.NeoHooke(E=1.0, nu=0.45)
    solid = dm.Solid(fem.Function(V), rubber, strain="finite", volumetric="reduced")
    low = mesh.locate_entities_boundary(block, 1, lambda x: np.isclose(x[1], 0.0))
    foot = fem.dirichletbc(np.zeros(2), fem.locate_dofs_topological(V, 1, low), V)
    flat = dm.shapes.Plane((0.0, 1.0), (0.0, -1.0))
    tool = dm.Obstacle(tags, slave=1, shape=flat, friction=friction)
    problem = dm.ContactProblem(solid, [tool], bcs=[foot])
    ramp = {tool.position: [(0.0, (0.0, 1.0)), (1.0, (0.0, 1.0 - depth))]}
    for step in dm.load_steps(problem, np.linspace(0, 1, 5)[1:], ramp=ramp, progress=False):
        last = step
    return [note for note in last.report.notes if SENTENCE in note]


@pytest.mark.mpi
def test_a_face_that_folds_onto_the_tool_is_noted():
    (note,) = notes_of_pressing(lambda x: np.isclose(x[1], 1.0))
    assert "beside slave=1: add the facets" in note


@pytest.mark.mpi
def test_a_whole_skin_meets_the_tool_where_it_folds():
    skin = lambda x: np.isclose(x[1], 1.0) | (np.isclose(abs(x[0]), 0.5) & (x[1] > 0.4))  # noqa: E731
    assert not notes_of_pressing(skin)


@pytest.mark.mpi
def test_the_rest_of_a_flat_face_is_not():
    """A plane stands for a flat punch as wide as the side; the face around it lies higher."""
    under = lambda x: np.isclose(x[1], 1.0) & (abs(x[0]) < 0.26)  # noqa: E731
    assert not notes_of_pressing(under, half=1.0, depth=0.1)

# SPDX-License-Identifier: MIT
"""The direction of a preload: warned of where it is shear, and none around a shank."""

import logging

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from dolfinx_mortar.steps import preload as preload_module
from tests.glued_bar import NU, Bar, E
from tests.meshes import BOTTOM, BOTTOM_OF_UPPER, TOP, TOP_OF_LOWER, two_blocks
from tests.tightened_bar import loaded, outwards

COMM = MPI.COMM_WORLD


def told(case, problem, direction, caplog):
    """Return what is said of a direction, on rank 0."""
    caplog.clear()
    with caplog.at_level(logging.WARNING, logger="dolfinx_mortar.steps.preload"):
        n = preload_module._check(problem, case.tie, 1.0, direction)
        problem.audit()
        preload_module._check_axis(problem, case.tie, n)
    lines = [r.getMessage() for r in caplog.records if r.name.endswith("preload")]
    return COMM.bcast(lines)


@pytest.mark.mpi
@pytest.mark.parametrize("slave", ["upper", "lower"])
def test_a_direction_along_the_cut(slave, caplog):
    """Warned of, with its cosine; what is said goes with an angle, not with a mesh."""
    case, problem = loaded(slave=slave)
    (line,) = told(case, problem, [1.0, 0.0], caplog)
    assert (
        "direction is [1.0, 0.0]" in line
        and "[0, " in line
        and "is 0: " in line
        and "axis of the bolt" in line
    )
    for angle, warned in ((0.0, 0), (60.0, 0), (66.0, 1), (-60.0, 0), (-66.0, 1), (110.0, 1)):
        a = np.radians(angle)
        n = np.cos(a) * outwards(case) + np.sin(a) * np.array([1.0, 0.0])
        assert len(told(case, problem, n, caplog)) == warned, angle


def test_a_cut_that_is_inclined(caplog):
    """Its normal counts, and the axis of the bolt may lean to it."""
    case = Bar("quadrilateral", angle=np.radians(55.0))
    problem = case.problem([case.hold(BOTTOM), case.hold(TOP)])
    assert not told(case, problem, [0.0, -1.0], caplog)
    assert len(told(case, problem, [1.0, 1.4], caplog)) == 1


def test_a_side_around_a_shank_has_no_direction(caplog):
    """Its normals point everywhere: what their mean points to is chance."""
    case = Bar("quadrilateral")
    mesh, _, facets = two_blocks(
        COMM,
        (24, 2),
        (24, 2),
        cell="quadrilateral",
        transform=lambda x: np.column_stack(
            [(2.0 + x[:, 1]) * f(1.96 * np.pi * x[:, 0]) for f in (np.cos, np.sin)]
        ),
    )
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    case.tie = dm.Tie(facets, slave=BOTTOM_OF_UPPER, master=TOP_OF_LOWER)
    dofs = [fem.locate_dofs_topological(V, 1, facets.find(tag)) for tag in (BOTTOM, TOP)]
    bcs = [fem.dirichletbc(np.zeros(2), np.concatenate(dofs), V)]
    solid = dm.Solid(fem.Function(V), dm.Elastic(E, NU))
    problem = dm.ContactProblem(solid, [case.tie], bcs=bcs)
    for x in (1.0, -1.0):
        assert not told(case, problem, [x, 0.0], caplog)

# SPDX-License-Identifier: MIT
"""Which elements lock in plastic flow: the plate of the reference, to its full load in one step.

The limit of the work is extrapolated (Aitken) from three meshes of first-order triangles up to 9922
unknowns, 88.79, and of second-order ones up to 39042, 88.71. The former are those of the published
code to 1e-9 (test_law_reference); it has no converged values.
"""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from tests.cases import plate
from tests.test_law_reference import LAW, TRACTION, create_driver

LIMIT = 88.71  # N mm per mm


def error(element, degree, volumetric, level):
    """Return unknowns and the relative error of the work of the full load."""
    domain = plate.create_plate(MPI.COMM_WORLD, element, level)
    V = fem.functionspace(domain, ("Lagrange", degree, (2,)))
    solid = dm.Solid(fem.Function(V), LAW, volumetric=volumetric)
    create_driver(solid)(1.0)
    load = plate.assemble_load(plate.top_traction(V, TRACTION), V)
    return 2 * V.dofmap.index_map.size_global, 1.0 - load.dot(solid.u.x.petsc_vec) / LIMIT


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("element", "degree", "volumetric", "allowed"),
    [
        ("P1", 1, "full", 0.037),
        ("Q1", 1, "full", 0.02),
        pytest.param("Q1", 1, "reduced", 0.006, marks=pytest.mark.slow),
        ("P1", 2, "full", 0.006),
        pytest.param("Q1", 2, "full", 0.006, marks=pytest.mark.slow),
    ],
    ids=["P1", "Q1", "Q1 reduced", "P2", "Q2"],
)
def test_error_at_equal_unknowns(element, degree, volumetric, allowed):
    """All are too stiff; those that do not lock have a sixth of the error of triangles."""
    level = 3 - degree
    unknowns, found = error(element, degree, volumetric, level)
    assert unknowns == 2562
    assert 0.85 * allowed < found < allowed


@pytest.mark.slow
def test_triangles_of_either_degree_have_one_limit():
    values = {
        degree: [LIMIT * (1 - error("P1", degree, "full", level)[1]) for level in levels]
        for degree, levels in ((1, (1, 2, 3)), (2, (0, 1, 2)))
    }
    for a, b, c in values.values():
        limit = c - (c - b) ** 2 / (c - 2 * b + a)
        assert limit == pytest.approx(LIMIT, rel=2e-3)
    assert np.diff(values[1]).min() > 0.0 and np.diff(values[2]).min() > 0.0

# SPDX-License-Identifier: MIT
"""Rubber that hardly changes its volume: forces of the literature, and what Newton's method needs.

The cylinder of Sussman and Bathe: read off their graph 250 and 1400 N/mm at an approach of 100 and
200 mm; twelve variants of another program (Ansys VM201, VM211) lie between .966 and 1.066 of it.
"""

from dataclasses import replace
from functools import cache

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import mesh
from dolfinx_mortar.materials.law_check import law_at_point
from dolfinx_mortar.materials.protocol import create_law
from tests.cases.rubber_cylinder import RUBBER, create_cylinder
from tests.cases.solid import (
    create_displacement,
    create_domain,
    hold,
    plane,
    rollers,
    stand,
    total,
)
from tests.choice import quick

HALFWAY, WHOLE = (241.0, 267.0), (1350.0, 1435.0)
CELLS = ["quadrilateral", "triangle", "hexahedron", "tetrahedron"]
SECOND = [{"degree": 2}]


def squeeze(cylinder, steps):
    forces, iterations = [], []
    for k in range(1, steps + 1):
        report = cylinder.approach(200.0 * k / steps, max_it=80)
        forces.append(cylinder.force)
        iterations.append(report.newton_iterations)
    return np.array(forces), np.array(iterations)


@pytest.mark.mpi
def test_the_rubber_cylinder():
    """The forces of the literature; whole steps, no shift, on a coarse mesh in big steps."""
    cylinder = create_cylinder()
    forces, iterations = squeeze(cylinder, 4)
    assert HALFWAY[0] < forces[1] < HALFWAY[1]
    assert WHOLE[0] < forces[3] < WHOLE[1]
    assert iterations.max() <= 12


@pytest.mark.slow
@pytest.mark.parametrize("cells", [{}, *SECOND], ids=str)
def test_no_locking_and_no_dependence_on_the_bulk_modulus(cells):
    """K a hundred times: forces within 1 % (no locking), iterations nearly the same.

    With u alone as unknown they are 14 to 26 a step, and the fifth fails.
    """
    laws = (replace(RUBBER, K=f * RUBBER.K) for f in (1, 100))
    found = [squeeze(create_cylinder(law=law, **cells), 10) for law in laws]
    (forces, iterations), (stiff, more) = found
    np.testing.assert_allclose(stiff, forces, rtol=0.01)
    assert iterations.mean() < 8 and more.mean() < 8
    assert (more <= iterations + 3).all()


@pytest.mark.parametrize("cell", quick(CELLS, "quadrilateral"))
def test_cells_of_second_order_bear_volumes_that_stay(cell):
    """Their functions reproduce what they hold: uniform J gives p = U'(J) and no other energy."""
    solid = second_order(cell)
    u, d = solid.u, solid.V.mesh.geometry.dim
    F = np.eye(3)
    F[:d, :d] += 0.1 * np.random.default_rng(3).normal(size=(d, d))
    u.interpolate(lambda x: (F - np.eye(3))[:d, :d] @ x[:d])
    solid.evaluate()
    point = law_at_point(RUBBER, create_law("law", RUBBER))(F, {})
    energy = point.energy[0] * total(solid.fields.weights)
    assert total(solid.energy()) == pytest.approx(energy, rel=1e-10)
    stress = point.stress[0] @ F.T / np.linalg.det(F)
    place = [0, 1, 2, 0, 1, 0][: 2 * d], [0, 1, 2, 1, 2, 2][: 2 * d]
    found = solid.fields.values("stress")
    expected = np.broadcast_to(stress[place], found.shape)
    np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-8 * np.abs(stress).max())


@pytest.mark.parametrize(
    ("degree", "volumetric", "K", "height", "told"),
    [
        (2, "reduced", 1e3, 0.7, []),
        (2, "reduced", 1e3, 0.58, [True]),
        pytest.param(1, "reduced", 1e3, 0.58, [], marks=pytest.mark.slow),
        (2, "full", 2.0, 0.5, [False]),  # where the continuum has lost its stability, too
    ],
)
def test_cells_that_lose_their_stability_first_are_named(degree, volumetric, K, height, told):
    """A square between smooth plates; a continuum holds to .54, "reduced" of degree 2 to .62."""
    domain = mesh.create_unit_square(MPI.COMM_SELF, 2, 2, mesh.CellType.quadrilateral)

    def pressed(V):
        return [*rollers(V), hold(V, plane(1, 1.0), 1, height - 1)]

    law = dm.MooneyRivlin(1 / 3, 1 / 6, K)  # the shear modulus is 1
    how = {"strain": "finite", "volumetric": volumetric, "degree": degree}
    problem = stand(domain, law, pressed, **how)
    dm.newton(problem)
    last = [note for note in problem.diagnose() if "indefinite" in note][-1:]
    assert ["cells of degree 2" in note for note in last] == told
    u = problem.u.x.array
    u += 0.02 * np.random.default_rng(1).standard_normal(u.size)
    with pytest.raises(dm.NewtonNotConverged):  # an error says the same
        dm.newton(problem, max_it=2)
    assert ["cells of degree 2" in problem.diagnose()[-1]] * len(told) == told


@cache
def second_order(cell):
    domain = create_domain(cell, 2)
    return dm.Solid(create_displacement(domain, 2), RUBBER, strain="finite", volumetric="reduced")

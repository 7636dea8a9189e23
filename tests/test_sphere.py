# SPDX-License-Identifier: MIT
"""Hertz' point contact: half ball R = 8 mm pressed 0.05 mm into the block 30 x 30 x 10 mm.

The force of this finite model, which is not Hertz' half space, has no closed form; its limit comes
from an independent axisymmetric solver of second order with elements down to 0.008 mm. Radius and
pressure are Hertz' at the force found.
"""

import numpy as np
import pytest

import dolfinx_mortar as dm
from tests.cases.ball import STEEL, create_problem

DEPTH, RADIUS = 0.05, 8.0
# N, by geometry and slave side. That of a ball on frozen surfaces depends on the normals there:
# 5024 along those of the ball, by that solver; along those of both sides by second order of this.
LIMITS = {
    ("reference", "block"): 5036.0,
    ("reference", "ball"): 5042.6,
    ("updated", "block"): 5035.5,
    ("updated", "ball"): 5035.5,
}


def solve(h, slave="block", **options):
    """Return the force of the whole ball, and radius and peak of the pressure, fitted."""
    options = {"cell": "hexahedron", "depth": DEPTH} | options
    problem, contact = create_problem(h=h, slave=slave, **options)
    report = dm.newton(problem)
    assert report.certificate.equilibrium < 1e-6
    found = contact.gather(problem.u)
    on = found["active"] > 0
    x = found["X" if problem.geometry == "reference" else "x"][on]
    peak, radius = dm.analytic.fit_pressure(np.hypot(x[:, 0], x[:, 1]), found["pressure"][on])
    return 4.0 * abs(contact.force[2]), radius, peak


def hertz(force):
    """Return contact radius and peak pressure of point contact at a force."""
    found = dm.analytic.hertz_point(force, RADIUS, STEEL.E, STEEL.nu, STEEL.E, STEEL.nu)
    return found.contact_radius, found.peak_pressure


@pytest.mark.slow
def test_convergence_to_hertz():
    """With facets, 8 across the radius; smooth surfaces are nearer on every mesh."""
    h = np.array([0.25, 0.125, 0.0625])
    found = [solve(size, surface="facets") for size in h]
    F = np.array([force for force, _, _ in found])
    order = np.log2((F[0] - F[1]) / (F[1] - F[2]))
    limit = F[2] + (F[2] - F[1]) / 3.0
    force, radius, peak = found[-1]
    contact_radius, peak_pressure = hertz(force)
    assert contact_radius > 8.0 * h[-1]
    assert 1.7 < order < 2.4
    assert force == pytest.approx(limit, rel=0.01)
    assert limit == pytest.approx(LIMITS["reference", "block"], rel=1e-3)
    assert radius == pytest.approx(contact_radius, rel=0.02)
    assert peak == pytest.approx(peak_pressure, rel=0.03)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("h", "cell", "degree", "geometry", "slave", "accuracy"),
    [
        (0.125, "hexahedron", 1, "reference", "ball", 5e-3),  # five facets across the radius
        (0.125, "hexahedron", 1, "updated", "block", 5e-3),
        (0.25, "tetrahedron", 2, "reference", "block", 3e-3),  # two to three
        (0.25, "hexahedron", 2, "reference", "ball", 3e-3),
    ],
)
def test_force_radius_and_peak(h, cell, degree, geometry, slave, accuracy):
    force, radius, peak = solve(h, slave, cell=cell, degree=degree, geometry=geometry)
    assert force == pytest.approx(LIMITS[geometry, slave], rel=accuracy)
    assert (radius, peak) == pytest.approx(hertz(force), rel=0.015)


@pytest.mark.parametrize("cell", ["tetrahedron", "hexahedron"])
def test_coarse_contact_is_near_hertz(cell):
    """Two to three facets across the contact radius: pressure and radius to a tenth."""
    force, radius, peak = solve(0.25, cell=cell)
    assert (radius, peak) == pytest.approx(hertz(force), rel=0.1)

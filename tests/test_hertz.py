# SPDX-License-Identifier: MIT
"""Elastic line contact: force, half-width and peak pressure of the half disc on the block.

Source of the numbers: two independent small-strain finite element codes that agree to the digits
given, and Hertz's formulas for the first yield (Johnson, Contact Mechanics, section 4.2).
"""

from functools import cache

import numpy as np
import pytest

import dolfinx_mortar as dm
from tests.cases.hertz import ELASTIC, PLASTIC, create_case, create_mesh
from tests.cases.user_laws import SaintVenantKirchhoff
from tests.choice import crosswise

DEPTH = 0.05  # mm
# geometry: force [N/mm], fitted half-width [mm], fitted peak pressure [MPa]
REFERENCE = {
    "reference": (2425.4, 0.4674, 3305.4),
    "updated": (2425.5, 0.4629, 3331.5),
}
TOLERANCE = (2e-3, 1e-2, 5e-3)
STEEL = (206_900.0, 0.29)


def solve(h, slave, geometry, depth=DEPTH, rtol=1e-6, law=ELASTIC, cell="triangle", **options):
    """Press a disc on a block; return the case and the report."""
    mesh = create_mesh("graded", h, cell=cell)
    case = create_case(mesh, law, slave=slave, geometry=geometry, **options)
    case.press(depth)
    return case, dm.newton(case.problem, rtol=rtol)


@pytest.mark.parametrize(
    ("geometry", "slave"), crosswise(["reference", "updated"], ["block", "disc"])
)
def test_force_half_width_and_peak_pressure(geometry, slave):
    """Both geometries and both slave sides reach the reference on elements of 0.05 mm."""
    case, report = solve(0.05, slave, geometry)
    found = np.array([case.force, *case.fit()])
    expected = np.array(REFERENCE[geometry])
    assert (np.abs(found - expected) < TOLERANCE * expected).all()
    # the answer obeys Hertz's own relation between force and pressure, up to the finite block
    hertz = dm.analytic.hertz_line(case.force, 8.0, *STEEL, *STEEL)
    assert case.fit() == pytest.approx((hertz.half_width, hertz.peak_pressure), rel=0.015)
    assert abs(case.contact.force[0]) < 1e-4 * case.force
    # linear material: one linearisation if the geometry is frozen, and perhaps its confirmation
    assert report.newton_iterations <= 2 or geometry == "updated"


def oscillation(case):
    """Return how far pressures leave the curve through two nodes on either side, over the peak."""
    nodes = case.contact.gather(case.problem.u)
    order = np.argsort(nodes["X"][:, 0])
    x, p = nodes["X"][order, 0], nodes["pressure"][order]
    half_width, peak = case.fit()
    off = []
    for i in np.flatnonzero(np.abs(x) < 0.5 * half_width):
        beside = [i - 2, i - 1, i + 1, i + 2]
        curve = np.polyfit(x[beside] - x[i], p[beside], 3)
        off.append(abs(p[i] - curve[-1]) / peak)
    return max(off)


SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    ("geometry", "slave", "cell", "law", "depth", "force", "peak"),
    [
        ("updated", "disc", "triangle", ELASTIC, DEPTH, 2425.5, 3331.5),
        pytest.param(
            "updated", "block", "quadrilateral", ELASTIC, DEPTH, 2425.5, 3331.5, marks=SLOW
        ),
        # plastic flow, where first order is 0.4 % too stiff
        pytest.param("updated", "disc", "quadrilateral", PLASTIC, 0.2, 4487.8, 1913.0, marks=SLOW),
    ],
)
def test_second_order(geometry, slave, cell, law, depth, force, peak):
    """Elements of 0.1 mm reach force and peak, and corners and middles have one pressure."""
    case, _ = solve(0.1, slave, geometry, depth, law=law, cell=cell, degree=2)
    assert case.force == pytest.approx(force, rel=1.5e-3 if law is ELASTIC else 2e-3)
    assert case.fit()[1] == pytest.approx(peak, rel=5e-3)
    assert oscillation(case) < 0.01


@pytest.mark.slow
def test_observed_order_of_the_force():
    """The force converges with nearly second order of the element size."""
    sizes = (0.15, 0.075, 0.0375)
    forces = np.array([solve(h, "block", "reference")[0].force for h in sizes])
    errors = forces - REFERENCE["reference"][0]
    assert np.all(errors > 0)
    assert np.all(np.log2(errors[:-1] / errors[1:]) > 1.5)


# -- finite strain
# CalculiX 2.20, linear and with large deformations (NLGEOM), gives 1.0 and 1.7 % less for the disc
# at depths of 0.05 and 0.1 mm, 2.2 % less for the ball at 0.05 mm (1.94 % here, on elements half as
# large 1.99 %). Its law is Hooke's between Green's strain and the second Piola-Kirchhoff stress: in
# uniform compression by e softer than Hooke's by 3/2 e, one of logarithmic strains stiffer by that.


@cache
def forces(kinematics, law, strain):
    """Return the force at both depths, of half the disc or of the whole ball."""
    block = (36.0, 10.0) if kinematics == "axisymmetric" else (30.0, 10.0)
    mesh, found = create_mesh("graded", 0.1, half=True, block=block), []
    case = create_case(mesh, law, degree=2, strain=strain, kinematics=kinematics)
    for depth in (0.05, 0.1):
        case.press(depth)
        assert dm.newton(case.problem, rtol=1e-7).newton_iterations <= 6
        case.problem.commit()
        found.append(case.force)
    return np.array(found)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kinematics", "expected", "digits"),
    [("plane_strain", [-0.010, -0.017], 5e-4), ("axisymmetric", [-0.022], 3e-3)],
)
def test_what_finite_strain_changes(kinematics, expected, digits):
    """As in another program; the law decides more than the measure of strain."""
    small = forces(kinematics, dm.Elastic(*STEEL), "small")
    soft, between, stiff = (
        forces(kinematics, law, "finite") / small - 1.0
        for law in (SaintVenantKirchhoff(*STEEL), dm.NeoHooke(*STEEL), dm.Elastic(*STEEL))
    )
    assert soft[: len(expected)] == pytest.approx(expected, abs=digits)
    assert (soft < between).all() and (between < stiff).all()
    assert (stiff - soft)[1] > 1.3 * (stiff - soft)[0]

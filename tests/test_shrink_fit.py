# SPDX-License-Identifier: MIT
"""The closed solutions of a shrink fit against equilibrium and numerical integration."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from demos.shrink_fit.lame import shrink_fit
from tests.cases.rings import Lame

RADII, LENGTH, MU = (10.0, 20.0, 35.0), 25.0, 0.2
BODIES = (200e3, 0.3, 100e3, 0.33)


def cylinder(E, nu, inner, outer, inside, outside, axial, r):
    """Return the radial displacement of a thick cylinder under pressures and axial stress."""
    lame = Lame(E, nu, inner, outer, inside, outside)
    radial, hoop = lame.mean - lame.swing / r**2, lame.mean + lame.swing / r**2
    return r / E * (hoop - nu * (radial + axial))


def misfit(pressure, shaft, hub):
    """Return by how much the radii differ, from pressure and axial stresses of both."""
    a, c, b = RADII
    E1, nu1, E2, nu2 = BODIES
    grown = cylinder(E2, nu2, c, b, pressure, 0.0, hub, c)
    return grown - cylinder(E1, nu1, a, c, 0.0, pressure, shaft, c)


def test_the_radii_agree():
    fit = shrink_fit(0.02, RADII, *BODIES)
    assert misfit(fit.pressure, 0.0, 0.0) == pytest.approx(0.02, rel=1e-12)
    assert fit.sliding_force(MU, LENGTH) == pytest.approx(
        MU * fit.pressure * 2 * np.pi * RADII[1] * LENGTH, rel=1e-14
    )


def test_the_pull_is_that_of_slices():
    """Integrate the axial stress; the pressure of each slice from the radii of both."""
    fit = shrink_fit(0.02, RADII, *BODIES)
    a, c, b = RADII
    A, B = np.pi * (c**2 - a**2), np.pi * (b**2 - c**2)

    def pulled(force):
        def slope(z, stress):
            hub = (force - A * stress[0]) / B
            p = brentq(lambda p: misfit(p, stress[0], hub) - 0.02, 0.0, 1e3, xtol=1e-12)
            return [2 * np.pi * c * MU * p / A]

        return A * solve_ivp(slope, (0.0, LENGTH), [0.0], rtol=1e-9, atol=1e-9).y[0, -1]

    found = fit.pull_force(MU, LENGTH)
    assert pulled(found) == pytest.approx(found, rel=1e-7)
    assert 0.99 < found / fit.sliding_force(MU, LENGTH) < 0.999


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"interference": 0.0}, "interference"),
        ({"E1": -1.0}, "E1"),
        ({"nu2": 0.5}, "nu2"),
        ({"radii": (1.0, 2.0)}, "radii"),
        ({"radii": (1.0, 3.0, 2.0)}, "radii"),
    ],
)
def test_bad_numbers_are_named(change, name):
    names = ("interference", "radii", "E1", "nu1", "E2", "nu2")
    given = dict(zip(names, (0.02, RADII, *BODIES), strict=True)) | change
    with pytest.raises(ValueError, match=f"^{name} is "):
        shrink_fit(**given)


@pytest.mark.parametrize(("friction", "length"), [(0.0, 1.0), (0.2, np.nan)])
def test_bad_pulls_are_named(friction, length):
    fit = shrink_fit(0.02, RADII, *BODIES)
    for function in (fit.sliding_force, fit.pull_force):
        with pytest.raises(ValueError, match=r"^(friction|length) is "):
            function(friction, length)

# SPDX-License-Identifier: MIT
"""Fits for the flattening of spheres, against values that were computed elsewhere."""

import numpy as np
import pytest

from demos.indentation import flattening
from dolfinx_mortar import analytic

pytestmark = pytest.mark.serial

AT = flattening.first_yield_sphere(1000.0, 1.0, 200e3, 0.3)
SOFT = flattening.first_yield_sphere(400.0, 1.0, 200e3, 0.3)
# w/w_c: P/P_c of Jackson and Green for S = 1000 and 400, of Kogut and Etsion, a/R for S = 1000;
# from two public implementations of the first and one of the second, which agree with the papers
TABLE = {
    1.0: (1.000, 1.000, 1.000, 0.01154),
    1.9: (2.619, 2.619, 2.571, 0.01591),
    5.0: (10.134, 10.134, 10.206, 0.02783),
    10.0: (25.881, 25.885, 25.652, 0.04153),
    20.0: (64.141, 64.226, 61.564, 0.06198),
    50.0: (200.96, 202.88, 195.85, 0.10524),
    100.0: (451.72, 465.01, 470.03, 0.15706),
}


@pytest.mark.parametrize(("s", "expected"), TABLE.items())
def test_table(s, expected):
    found = flattening.jackson_green(s * AT.interference, AT)
    assert found.force / AT.force == pytest.approx(expected[0], rel=1e-4, abs=5e-4)
    soft = flattening.jackson_green(s * SOFT.interference, SOFT)
    assert soft.force / SOFT.force == pytest.approx(expected[1], rel=1e-4, abs=5e-4)
    other = flattening.kogut_etsion(s * AT.interference, AT)
    assert other.force / AT.force == pytest.approx(expected[2], rel=1e-4, abs=5e-4)
    assert found.contact_radius == pytest.approx(expected[3], rel=1e-3)
    assert other.contact_radius == pytest.approx(found.contact_radius, rel=0.05)


def test_first_yield_is_hertz_at_the_pressure_C_S():
    hertz = analytic.hertz_point(AT.force, 1.0, 200e3, 0.3, np.inf, 0.3)
    assert hertz.peak_pressure == pytest.approx(AT.C * 1000.0, rel=1e-12)
    assert hertz.contact_radius == pytest.approx(AT.contact_radius, rel=1e-12)
    assert hertz.approach == pytest.approx(AT.interference, rel=1e-12)


def test_beyond_its_range_a_fit_says_nothing():
    found = flattening.kogut_etsion(111.0 * AT.interference, AT)
    assert np.isnan(found.force) and np.isnan(found.contact_radius)

# SPDX-License-Identifier: MIT
"""Drucker and Prager's cone: rate equations, the nearest stress, its apex, Mohr and Coulomb."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import dolfinx_mortar as dm
from tests.cases.material_point import MaterialPoint
from tests.cases.rate_equations import IDENTITY, Rates, deviator

LAW = dm.DruckerPrager(E=1000.0, nu=0.25, Y=1.0, beta=0.6)
POINT = MaterialPoint(LAW)
RATES = Rates(LAW.E, LAW.nu, lambda k: LAW.Y, beta=LAW.beta)
MU = LAW.E / (2 * (1 + LAW.nu))


def walk(path, steps):
    """Return the plastic strain after so many steps on each leg of a path."""
    POINT.reset()
    for start, end in itertools.pairwise(path):
        for t in np.linspace(0, 1, steps + 1)[1:]:
            POINT.stress(start + t * (end - start))
            POINT.commit()
    return POINT.commit()


def symmetric(rng):
    tensor = rng.standard_normal((3, 3))
    return (tensor + tensor.T) / 2


@pytest.mark.parametrize("volume", [-0.2, 0.0, 0.1])
def test_proportional_path_is_the_rate_solution(volume):
    """Shear with compression, dilation and back, in two steps a leg."""
    shear = np.array([[0, 1.0, 0], [1.0, 0.0, 0], [0, 0, 0]])
    path = [s * (shear + volume * abs(s) * IDENTITY) for s in (0.0, 2e-3, -3e-3)]
    expected = RATES.integrate(path)[:9].reshape(3, 3)
    assert np.linalg.norm(expected) > 1e-3 and np.trace(expected) > 1e-4
    assert np.abs(walk(path, 2) - expected).max() < 1e-9 * np.linalg.norm(expected)


def test_non_proportional_path_converges_to_the_rate_solution(rng):
    """Order one in the steps, and extrapolated the rate solution; under pressure, off the apex."""
    legs = [np.zeros((3, 3))] + [3e-3 * deviator(symmetric(rng)) - 2e-4 * IDENTITY for _ in "abc"]
    path = [sum(legs[: i + 1], np.zeros((3, 3))) for i in range(len(legs))]
    expected = RATES.integrate(path)[:9].reshape(3, 3)
    assert np.linalg.norm(expected) > 1e-3
    results = [walk(path, n) for n in (40, 80, 160)]
    errors = [np.linalg.norm(r - expected) for r in results]
    assert 1.7 < errors[0] / errors[1] < 2.3 and 1.7 < errors[1] / errors[2] < 2.3
    first = [2 * b - a for a, b in itertools.pairwise(results)]
    last = (4 * first[1] - first[0]) / 3
    assert np.linalg.norm(last - expected) < 2e-5 * np.linalg.norm(expected)


@settings(max_examples=80)
@given(st.integers(0, 2**32 - 1), st.floats(-4.0, -1.0), st.floats(-1.0, 1.0))
def test_the_stress_is_the_nearest_one(seed, power, volume):
    """Normality without any formula of the return: sigma is allowed, and no allowed one is nearer.

    (tau - sigma) : C^-1 (trial - sigma) <= 0 for all allowed tau; it is enough to try the apex, the
    cone's lines and sigma's own.
    """
    rng = np.random.default_rng(seed)
    strain = 10.0**power * (deviator(symmetric(rng)) + volume * IDENTITY)
    POINT.reset()
    stress = POINT.stress(strain)
    size, mean = np.linalg.norm(deviator(stress)), np.trace(stress) / 3
    assert size + LAW.beta * mean <= LAW.Y * (1 + 1e-9)
    plastic = POINT.commit()
    hooke = RATES.elastic(strain - plastic)
    assert np.abs(stress - hooke).max() < 1e-9 * max(LAW.Y, np.abs(stress).max())
    scale = np.linalg.norm(plastic) * max(LAW.Y, np.linalg.norm(stress))
    for _ in range(20):
        p = LAW.Y / LAW.beta - abs(rng.standard_normal()) * 10.0 ** rng.uniform(-3, 2)
        s = deviator(symmetric(rng))
        allowed = p * IDENTITY + (LAW.Y - LAW.beta * p) * s / np.linalg.norm(s)
        assert np.sum((allowed - stress) * plastic) <= 1e-9 * scale
    assert np.sum((LAW.Y / LAW.beta * IDENTITY - stress) * plastic) <= 1e-9 * scale
    POINT.stress(strain)
    assert np.array_equal(POINT.commit(), plastic)


def test_apex():
    """Pulled on all sides the stress is that of the apex, whatever the strain; and so next time."""
    POINT.reset()
    wanted = LAW.Y / LAW.beta * IDENTITY
    for size in (1e-2, 3e-2):
        strain = size * (IDENTITY + 0.1 * np.diag([1.0, 0.5, -1.5]))
        assert np.abs(POINT.stress(strain) - wanted).max() < 1e-12
        POINT.commit()
    relief = strain - 1e-4 * IDENTITY
    expected = wanted - RATES.elastic(1e-4 * IDENTITY)
    assert np.abs(POINT.stress(relief) - expected).max() < 1e-10


def test_check_reaches_cone_and_apex():
    """Differences of energy and stress, with strains large enough for either."""
    for law in (LAW, dm.DruckerPrager(1000.0, 0.25, 1.0, 2.0)):
        report = dm.materials.check(law, size=0.05)
        assert report.changed > 10 and report.energy_error < 1e-7
        assert report.tangent_error < 1e-7 and report.skew < 1e-10


def test_tangent_at_the_apex_vanishes():
    POINT.reset()
    strain = 1e-2 * IDENTITY
    POINT.stress(strain)
    K = POINT.solid.create_matrix()
    POINT.solid.assemble_tangent(K)
    assert K.norm() == 0.0


@pytest.mark.parametrize("angle", [5.0, 30.0, 60.0])
def test_mohr_and_coulomb_are_met(angle):
    """Stresses of collapse by Mohr's circle, s1 - s3 = 2 c cos - (s1 + s3) sin, are on the cone."""
    c, phi = 3.0, math.radians(angle)

    def excess(law, stress):
        return np.linalg.norm(deviator(stress)) + law.beta * np.trace(stress) / 3 - law.Y

    def cone(match):
        return dm.DruckerPrager.from_mohr_coulomb(1000.0, 0.25, c, angle, match)

    for lateral in (-1.0, -20.0):  # pressure of the cell, tension positive
        # compression: s1 = s2 = lateral > s3
        axial = (lateral * (1 + math.sin(phi)) - 2 * c * math.cos(phi)) / (1 - math.sin(phi))
        assert abs(excess(cone("compression"), np.diag([axial, lateral, lateral]))) < 1e-9
        # extension: s1 > s2 = s3 = lateral
        axial = (lateral * (1 - math.sin(phi)) + 2 * c * math.cos(phi)) / (1 + math.sin(phi))
        assert abs(excess(cone("extension"), np.diag([axial, lateral, lateral]))) < 1e-9
    # plane strain: no plastic strain along z fixes s_zz; radius and centre then follow Mohr
    law = cone("plane strain")
    centre = -5.0
    radius = c * math.cos(phi) - centre * math.sin(phi)

    def worst(zz):
        return excess(law, np.diag([centre + radius, centre - radius, zz]))

    zz = np.linspace(centre - 3 * radius, centre + 3 * radius, 20001)
    values = [worst(z) for z in zz]
    assert abs(min(values)) < 1e-5 * radius  # dF/ds_zz = 0 is dep_zz = 0


def test_wrong_arguments():
    good = {"E": 1.0, "nu": 0.3, "Y": 1.0, "beta": 0.5}
    for name, value in [("E", 0.0), ("nu", 0.5), ("Y", 0.0), ("beta", 0.0), ("beta", math.nan)]:
        with pytest.raises(ValueError, match=f"DruckerPrager: {name} is "):
            dm.DruckerPrager(**(good | {name: value}))
    make = dm.DruckerPrager.from_mohr_coulomb
    for angle, match, message in [
        (90.0, "extension", "friction_angle is 90.0: give"),
        (30.0, "outer", "match is 'outer'; choose one of 'compression', 'extension', 'plane str"),
    ]:
        with pytest.raises(ValueError, match=message):
            make(1000.0, 0.25, 1.0, angle, match)

# SPDX-License-Identifier: MIT
"""The laws at a material point: closed formulas, uniaxial tests, invariances, flow rule."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

import basix.ufl
import ufl
from dolfinx_mortar.materials import Elastic, VonMises
from dolfinx_mortar.materials.response import without_variables
from tests.cases.material_point import MaterialPoint
from ufl.algorithms import strip_variables
from ufl.algorithms.analysis import extract_type
from ufl.classes import Variable

POINTS = basix.ufl.element("Lagrange", "triangle", 1, shape=(2,))
STEEL = VonMises(E=206_900.0, nu=0.29, Y=450 * math.sqrt(2 / 3), a=10_000.0)
POINT = MaterialPoint(STEEL)
PLANE = MaterialPoint(STEEL, 2)
MU = STEEL.E / (2 * (1 + STEEL.nu))
LAMBDA = STEEL.E * STEEL.nu / ((1 + STEEL.nu) * (1 - 2 * STEEL.nu))
IDENTITY = np.eye(3)

seeds = st.integers(0, 2**32 - 1)
magnitudes = st.floats(-12.0, 0.5).map(lambda power: 10.0**power)  # of strains


def deviator(tensor: np.ndarray) -> np.ndarray:
    """Return the trace-free part."""
    return tensor - np.trace(tensor) / 3 * IDENTITY


def symmetric(rng: np.random.Generator) -> np.ndarray:
    """Return a random symmetric tensor of entries about one."""
    tensor = rng.standard_normal((3, 3))
    return (tensor + tensor.T) / 2


def radial_return(law: VonMises, strain: np.ndarray, ep: np.ndarray) -> tuple:
    """Return stress and new plastic strain by the classical algorithm."""
    mu = law.E / (2 * (1 + law.nu))
    bulk = law.E / (3 * (1 - 2 * law.nu))
    trial = 2 * mu * (deviator(strain) - ep)
    shifted = trial - law.a * ep
    size = np.linalg.norm(shifted)
    multiplier = max(size - law.Y, 0.0) / (2 * mu + law.a)
    flow = multiplier * shifted / size if size > 0 else 0 * shifted
    return bulk * np.trace(strain) * IDENTITY + trial - 2 * mu * flow, ep + flow


@settings(max_examples=60)
@given(seeds, magnitudes, magnitudes)
def test_stress_from_energy_is_radial_return(seed: int, size: float, plastic: float) -> None:
    """The derivative of the potential is the stress of the radial return, at any strain."""
    rng = np.random.default_rng(seed)
    strain, ep = size * symmetric(rng), plastic * deviator(symmetric(rng))
    POINT.set_plastic_strain(ep)
    expected, new = radial_return(STEEL, strain, ep)
    scale = STEEL.E * (size + plastic) + STEEL.Y * 1e-9
    assert np.abs(POINT.stress(strain) - expected).max() < 1e-12 * scale + 2e-10 * STEEL.Y
    assert np.abs(POINT.commit() - new).max() < 1e-12 * (size + plastic) + 2e-10 * STEEL.Y / MU


def test_virgin_point_without_strain() -> None:
    """Nothing is undefined where the shifted stress is zero, for any units."""
    for units in (1e-9, 1.0, 1e9):
        law = VonMises(STEEL.E * units, STEEL.nu, STEEL.Y * units, STEEL.a * units)
        point = MaterialPoint(law)
        assert np.all(point.stress(np.zeros((3, 3))) == 0.0)
        assert np.all(point.commit() == 0.0)
        K = point.solid.create_matrix()
        point.solid.assemble_tangent(K)
        assert np.isfinite(K.norm())


@settings(max_examples=30)
@given(seeds)
def test_flow_rule_on_a_random_path(seed: int) -> None:
    """Each step satisfies the implicit flow rule, checked without any trial state.

    s - a ep = Y dep / |dep| where the plastic strain has changed, |s - a ep| <= Y where not.
    """
    rng = np.random.default_rng(seed)
    POINT.reset()
    strain, before, flowed = np.zeros((3, 3)), np.zeros((3, 3)), 0
    for _ in range(8):
        strain = strain + 3e-3 * symmetric(rng)
        stress = POINT.stress(strain)
        ep = POINT.commit()
        shifted, increment = deviator(stress) - STEEL.a * ep, ep - before
        assert abs(np.trace(ep)) < 1e-16
        # Hooke's law for what is not plastic.
        hooke = LAMBDA * np.trace(strain) * IDENTITY + 2 * MU * (strain - ep)
        assert np.abs(stress - hooke).max() < 1e-9 * STEEL.Y
        if (size := np.linalg.norm(increment)) > 0:
            assert np.abs(shifted - STEEL.Y * increment / size).max() < 1e-9 * STEEL.Y
            flowed += 1
        else:
            assert np.linalg.norm(shifted) < STEEL.Y * (1 + 1e-9)
        # A second commit at the same strain finds the point on the surface and changes nothing.
        assert np.array_equal(POINT.commit(), ep)
        before = ep
    assert flowed > 0


def rate_equations(path: list[np.ndarray]) -> np.ndarray:
    """Integrate the rate form of the law along straight strain paths; return the plastic strain.

    dep = n (n : 2 mu deps) / (2 mu + a) where |s - a ep| = Y and n : deps > 0. The elastic part of
    each leg ends at the root of a quadratic equation.
    """
    ep = np.zeros((3, 3))
    for start, end in itertools.pairwise(path):
        rate = deviator(end - start)

        def shifted(t: float, ep: np.ndarray, e0: np.ndarray = start, e1: np.ndarray = end):
            return 2 * MU * deviator(e0 + t * (e1 - e0)) - (2 * MU + STEEL.a) * ep

        xi, speed = shifted(0.0, ep), 2 * MU * rate
        a, b = np.sum(speed**2), np.sum(xi * speed)
        c = np.sum(xi**2) - STEEL.Y**2
        onset = (-b + math.sqrt(max(b**2 - a * c, 0.0))) / a
        if onset >= 1.0:
            continue

        def flow(t: float, y: np.ndarray, shifted=shifted, rate=rate) -> np.ndarray:
            n = shifted(t, y.reshape(3, 3))
            n /= np.linalg.norm(n)
            return (n * max(np.sum(n * rate), 0.0) * 2 * MU / (2 * MU + STEEL.a)).ravel()

        span = (max(onset, 0.0), 1.0)
        ep = solve_ivp(flow, span, ep.ravel(), "DOP853", rtol=1e-12, atol=1e-16).y[:, -1]
        ep = ep.reshape(3, 3)
    return ep


def law_along(path: list[np.ndarray], steps: int) -> np.ndarray:
    """Return the law's plastic strain after so many steps on each leg of the path."""
    POINT.reset()
    for start, end in itertools.pairwise(path):
        for t in np.linspace(0, 1, steps + 1)[1:]:
            POINT.stress(start + t * (end - start))
            POINT.commit()
    return POINT.commit()


@pytest.mark.parametrize(
    "direction",
    [np.diag([1.0, -0.5, -0.5]), np.array([[0, 1.0, 0], [1.0, 0, 0], [0, 0, 0]])],
    ids=["axial", "shear"],
)
def test_proportional_path_is_the_rate_solution(direction: np.ndarray) -> None:
    """On a straight deviatoric path with reversal, few steps give the rate solution exactly."""
    path = [s * direction for s in (0.0, 0.01, -0.008, 0.004)]
    expected = rate_equations(path)
    assert np.linalg.norm(expected) > 1e-4
    assert np.abs(law_along(path, 3) - expected).max() < 1e-9 * np.linalg.norm(expected)


def test_non_proportional_path_converges_to_the_rate_solution(rng: np.random.Generator) -> None:
    """With smaller steps the implicit law approaches the rate solution at order one."""
    legs = [np.zeros((3, 3))] + [4e-3 * symmetric(rng) for _ in range(3)]
    path = [sum(legs[: i + 1], np.zeros((3, 3))) for i in range(len(legs))]
    expected = rate_equations(path)
    results = [law_along(path, n) for n in (40, 80, 160)]
    errors = [np.linalg.norm(r - expected) for r in results]
    # Extrapolated to zero step size, twice: 1/n and 1/n^2 are removed.
    first = [2 * b - a for a, b in itertools.pairwise(results)]
    second = (4 * first[1] - first[0]) / 3
    size = np.linalg.norm(expected)
    assert 1.7 < errors[0] / errors[1] < 2.3 and 1.7 < errors[1] / errors[2] < 2.3
    assert np.linalg.norm(second - expected) < 1e-5 * size


def tension(stress: float, plastic: float) -> np.ndarray:
    """Return the strain of a bar at a uniaxial stress and an axial plastic strain."""
    elastic = stress / STEEL.E * np.diag([1.0, -STEEL.nu, -STEEL.nu])
    return elastic + plastic * np.diag([1.0, -0.5, -0.5])


def test_uniaxial_curve() -> None:
    """A bar yields at 450 with the plastic modulus 1.5 a, and has an elastic range of 2 x 450."""
    H = 1.5 * STEEL.a
    POINT.reset()
    assert np.allclose(POINT.stress(tension(449.999, 0.0)), np.diag([449.999, 0, 0]), atol=1e-9)
    assert not POINT.commit().any()
    # Two cycles: (stress, axial plastic strain) at the turning points and just inside the range.
    plastic = 150.0 / H
    reverse = plastic - 100.0 / H  # to 600 - 900 - 100 = -400
    for stress, p in [
        (600.0, plastic),
        (-299.999, plastic),
        (-400.0, reverse),
        (499.999, reverse),
        (600.0, plastic),
        (0.0, plastic),
        (599.999, plastic),
        (750.0, 300.0 / H),
    ]:
        assert np.allclose(POINT.stress(tension(stress, p)), np.diag([stress, 0, 0]), atol=1e-7)
        assert np.isclose(POINT.commit()[0, 0], p, rtol=1e-9)


def test_from_uniaxial_and_constants() -> None:
    """A tension test's numbers give the Frobenius constants and their tangent modulus."""
    law = VonMises.from_uniaxial(206_900.0, 0.29, 450.0, 15_000.0)
    for name in ("E", "nu", "Y", "a"):
        assert math.isclose(getattr(law, name), getattr(STEEL, name), rel_tol=1e-15)
    assert abs(STEEL.E * 15_000.0 / (STEEL.E + 15_000.0) - 13_986.0) < 0.1


@pytest.mark.parametrize("units", [1e-6, 1e6])
def test_units_of_stress(units: float, rng: np.random.Generator) -> None:
    """Other units of stress scale the stresses and leave the plastic strains alone."""
    scaled = MaterialPoint(VonMises(STEEL.E * units, STEEL.nu, STEEL.Y * units, STEEL.a * units))
    POINT.reset()
    for _ in range(3):
        strain = 5e-3 * symmetric(rng)
        stress = POINT.stress(strain)
        assert np.allclose(scaled.stress(strain), units * stress, rtol=1e-12, atol=1e-9 * units)
        assert np.allclose(scaled.commit(), POINT.commit(), rtol=1e-12, atol=1e-15)
    assert POINT.commit().any()


def test_rotation(rng: np.random.Generator) -> None:
    """A rotated strain path gives the rotated stresses."""
    Q, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    rotated = MaterialPoint(STEEL)
    POINT.reset()
    for _ in range(4):
        strain = 5e-3 * symmetric(rng)
        expected = Q @ POINT.stress(strain) @ Q.T
        assert np.abs(rotated.stress(Q @ strain @ Q.T) - expected).max() < 1e-10 * STEEL.Y
        plastic = Q @ POINT.commit() @ Q.T
        assert np.abs(rotated.commit() - plastic).max() < 1e-15
    assert plastic.any()


def test_plane_strain_is_a_held_slab(rng: np.random.Generator) -> None:
    """The plane law is the spatial one with no strain out of the plane."""
    POINT.reset()
    PLANE.reset()
    for _ in range(6):
        strain = np.zeros((3, 3))
        strain[:2, :2] = 8e-3 * symmetric(rng)[:2, :2]
        expected = POINT.stress(strain)
        assert np.abs(PLANE.stress(strain) - expected).max() < 1e-12 * np.abs(expected).max()
        plastic = POINT.commit()
        assert np.abs(PLANE.commit() - plastic).max() < 1e-12 * np.abs(plastic).max()
    assert abs(plastic[2, 2]) > 1e-4


def test_elastic_is_hooke(rng: np.random.Generator) -> None:
    """The elastic law is Hooke's, which von Mises follows below yield."""
    point, strain = MaterialPoint(Elastic(STEEL.E, STEEL.nu)), 1e-4 * symmetric(rng)
    expected = LAMBDA * np.trace(strain) * IDENTITY + 2 * MU * strain
    POINT.reset()
    assert np.abs(point.stress(strain) - expected).max() < 1e-12 * np.abs(expected).max()
    assert np.abs(POINT.stress(strain) - expected).max() < 1e-12 * np.abs(expected).max()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("E", 0.0),
        ("E", -1.0),
        ("E", math.nan),
        ("E", math.inf),
        ("nu", 0.5),
        ("nu", -1.0),
        ("nu", math.nan),
        ("Y", 0.0),
        ("Y", math.nan),
        ("a", -1e-300),
        ("a", math.inf),
    ],
)
def test_wrong_parameters(name: str, value: float) -> None:
    """A parameter out of its range is named."""
    good = {"E": 1.0, "nu": 0.3, "Y": 1.0, "a": 0.0}
    VonMises(**good)
    with pytest.raises(ValueError, match=f"VonMises: {name} is "):
        VonMises(**(good | {name: value}))
    if name in ("E", "nu"):
        with pytest.raises(ValueError, match=f"Elastic: {name} is "):
            Elastic(**({"E": 1.0, "nu": 0.3} | {name: value}))


def test_variables_leave_an_expression() -> None:
    """As by UFL's visitor, the reference; of what occurs 2^60 times, each part once."""
    x = ufl.variable(ufl.as_ufl(2.0) + ufl.SpatialCoordinate(ufl.Mesh(POINTS))[0])
    expression = ufl.sin(x) * x + ufl.conditional(ufl.gt(x, 1.0), x**2, ufl.variable(3.0 * x))
    assert without_variables(expression) == strip_variables(expression)
    for _ in range(60):
        expression = expression * expression
    assert not extract_type(without_variables(expression), Variable)

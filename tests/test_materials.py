# SPDX-License-Identifier: MIT
"""The laws at a material point: closed forms, rate equations, flow rule, parameters."""

import itertools
import math
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from dolfinx_mortar.common.kernels import compile_kernel, constants, tabulate
from dolfinx_mortar.materials.law_check import law_at_point
from dolfinx_mortar.materials.plasticity import increment
from dolfinx_mortar.materials.protocol import create_law
from tests.cases.material_point import MaterialPoint
from tests.cases.pressed_blocks import rejected
from tests.cases.rate_equations import IDENTITY, Rates, deviator
from tests.cases.solid import create_displacement, create_domain
from tests.cases.user_laws import Arrays

E, NU, Y = 206_900.0, 0.29, 450 * math.sqrt(2 / 3)
STEEL, CONE = dm.VonMises(E, NU, Y, 10_000.0), dm.DruckerPrager(1000.0, 0.25, 1.0, 0.6)
LAWS = {
    "kinematic": STEEL,
    "isotropic": dm.VonMises(E, NU, Y, 0.0, 10_000.0),
    "mixed": dm.VonMises(E, NU, Y, 10_000.0, 5_000.0),
    "voce": dm.VonMisesVoce(E, NU, Y, 0.0, 0.0, 200.0, 50.0),
    "voce, mixed": dm.VonMisesVoce(E, NU, Y, 10_000.0, 3_000.0, 200.0, 50.0),
    "cone": CONE,
}
POINT, AT_CONE = MaterialPoint(STEEL), MaterialPoint(CONE)
POINTS = {"kinematic": POINT, "cone": AT_CONE}

seeds = st.integers(0, 2**32 - 1)
positive = st.floats(-3.0, 3.0).map(lambda power: 10.0**power)


def point(name, law=None):
    found = POINTS.setdefault(name, MaterialPoint(law or LAWS.get(name)))
    found.reset()
    return found


def set_parameters(p, *values):
    p.solid.regions[0].function.x.array.reshape(-1, len(values))[:] = values


def rates(law):
    H, Q, b, a, beta = (getattr(law, name, 0.0) for name in ("H", "Q", "b", "a", "beta"))

    def radius(k):
        return law.Y + H * k + Q * (1 - math.exp(-b * k))

    return Rates(law.E, law.nu, radius, lambda k: H + Q * b * math.exp(-b * k), a, beta)


def hardened(p):
    return p.solid.fields.values("accumulated_plastic_strain")[0, 0]


def walk(p, path, steps):
    """Return the plastic strain after so many steps on each leg of a path."""
    p.reset()
    for start, end in itertools.pairwise(path):
        for t in np.linspace(0, 1, steps + 1)[1:]:
            p.stress(start + t * (end - start))
            p.commit()
    return p.commit()


def symmetric(rng):
    tensor = rng.standard_normal((3, 3))
    return (tensor + tensor.T) / 2


@pytest.mark.parametrize("units", [1e-9, 1.0, 1e9])
def test_units_of_stress(units, rng):
    """A virgin point without strain is defined, and flow is the same."""
    p = MaterialPoint(dm.VonMises(E * units, NU, Y * units, STEEL.a * units))
    assert not p.stress(np.zeros((3, 3))).any() and not p.commit().any()
    POINT.reset()
    for _ in range(3):
        strain = 5e-3 * symmetric(rng)
        expected = units * POINT.stress(strain)
        assert np.allclose(p.stress(strain), expected, rtol=1e-12, atol=1e-9 * units)
        assert np.allclose(p.commit(), POINT.commit(), rtol=1e-12, atol=1e-15)
    assert POINT.commit().any()


@pytest.mark.parametrize("name", LAWS)
def test_non_proportional_path_converges_to_the_rate_solution(name, rng):
    """Order one in the steps, and extrapolated twice the rate solution; off the apex."""
    legs = [np.zeros((3, 3))] + [4e-3 * symmetric(rng) for _ in range(3)]
    if name == "cone":
        legs[1:] = [0.75 * deviator(leg) - 2e-4 * IDENTITY for leg in legs[1:]]
    path = [sum(legs[: i + 1], np.zeros((3, 3))) for i in range(len(legs))]
    expected = rates(LAWS[name]).integrate(path)[:9].reshape(3, 3)
    results = [walk(point(name), path, n) for n in (40, 80, 160)]
    errors = [np.linalg.norm(r - expected) for r in results]
    assert 1.7 < errors[0] / errors[1] < 2.3 and 1.7 < errors[1] / errors[2] < 2.3
    first = [2 * b - a for a, b in itertools.pairwise(results)]
    last = (4 * first[1] - first[0]) / 3
    assert np.linalg.norm(last - expected) < 2e-5 * np.linalg.norm(expected) > 1e-9


@settings(max_examples=40)
@given(
    st.fixed_dictionaries({"a": positive, "H": positive, "Q": positive, "b": positive}),
    st.floats(0.05, 3.0),
    seeds,
)
def test_any_hardening_satisfies_the_flow_rule(parts, size, seed):
    """|s - a ep| = R(k) where k has grown, below elsewhere; the state rests after a commit.

    Moduli from 1e-3 to 1e3 times the yield radius 1; nothing is compiled for other parameters.
    """
    p = point("any", dm.VonMisesVoce(1000.0, 0.3, 1.0, 1.0, 1.0, 1.0, 1.0))
    law = dm.VonMisesVoce(1000.0, 0.3, 1.0, **parts)
    set_parameters(p, law.E, law.nu, law.Y, law.a, law.H, law.Q, law.b)
    rng, rate = np.random.default_rng(seed), rates(law)
    strain, before, k_before, flowed = np.zeros((3, 3)), np.zeros((3, 3)), 0.0, 0
    for _ in range(5):
        strain = strain + 5e-3 * size * symmetric(rng)
        stress = p.stress(strain)
        k, ep = hardened(p), p.commit()
        assert np.abs(stress - rate.elastic(strain - ep)).max() < 1e-10 * rate.radius(k)
        shifted, growth = deviator(stress) - law.a * ep, k - k_before
        if growth > 0.0:
            n = shifted / np.linalg.norm(shifted)
            assert np.abs(shifted - rate.radius(k) * n).max() < 1e-10 * rate.radius(k)
            assert np.abs(ep - before - growth * n).max() < 1e-8 * growth
            flowed += 1
        else:
            assert np.linalg.norm(shifted) <= rate.radius(k) * (1 + 1e-9)
        p.stress(strain)
        assert np.array_equal(p.commit(), ep) and hardened(p) == k
        before, k_before = ep, k
    assert flowed or size < 1.0


def pull(p, stress, plastic):
    """Compare a bar at a uniaxial stress and axial plastic strain."""
    strain = stress / E * np.diag([1.0, -NU, -NU]) + plastic * np.diag([1.0, -0.5, -0.5])
    assert np.allclose(p.stress(strain), np.diag([stress, 0, 0]), atol=1e-7)
    assert np.isclose(p.commit()[0, 0], plastic, rtol=1e-9)


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
def test_uniaxial_cycle(share):
    """A bar hardens with the modulus given and yields early after reversal, as the share says."""
    law = dm.VonMises.from_uniaxial(E, NU, 450.0, 15_000.0, isotropic=share)
    p = point(f"share {share > 0}", law)
    set_parameters(p, law.E, law.nu, law.Y, law.a, law.H)
    first, back = 300.0 / 15_000.0, 750.0 - 2 * (450.0 + share * 300.0)  # where it yields again
    for stress, plastic in ((449.999, 0.0), (750.0, first), (back + 0.001, first)):
        pull(p, stress, plastic)
    pull(p, back - 60.0, first - 60.0 / 15_000.0)


def test_uniaxial_saturation():
    """S(p) = s0 + m p + S (1 - exp(-r p)) in a bar."""
    p = MaterialPoint(
        dm.VonMisesVoce.from_uniaxial(E, NU, 450.0, saturation=200.0, rate=30.0, modulus=1000.0)
    )
    for plastic in (1e-4, 5e-3, 0.03, 0.2):
        pull(p, 450.0 + 1000.0 * plastic + 200.0 * (1 - math.exp(-30.0 * plastic)), plastic)


def test_increment_of_voce():
    """M g + R (1 - exp(-b g)) = e for M = b = 1, up to the round-off of its addends."""
    (x, y), at = constants(2), np.array([*itertools.product([1e-9, 0.1, 30.0], [1e-99, 0.1, 1e6])])
    kernel = compile_kernel(ufl.as_vector(increment(x, y, 1, 1, ufl.ln(y))))
    (g, slope), (e, R) = tabulate(kernel, at).T, at.T
    assert (np.abs(g - R * np.expm1(-g) - e) <= 1e-14 * (e + R)).all()
    np.testing.assert_allclose(slope, 1 / (1 + R * np.exp(-g)), rtol=1e-9)


def test_without_isotropic_hardening_there_is_no_k():
    """H = 0 has only the plastic strain; a Constant H has k."""
    H = fem.Constant(create_domain("triangle", 1), 0.0)
    assert list(dm.VonMises(E, NU, Y, 1.0, 0).state) == ["plastic_strain"]
    assert len(dm.VonMises(E, NU, Y, 1.0, H).state) == 2


@settings(max_examples=80)
@given(seeds, st.floats(-4.0, -1.0), st.floats(-1.0, 1.0))
def test_the_stress_is_the_nearest_one(seed, power, volume):
    """(tau - sigma) : dep <= 0 for all allowed tau: normality without any formula of the return."""
    rng, limit = np.random.default_rng(seed), CONE.Y / CONE.beta
    strain = 10.0**power * (deviator(symmetric(rng)) + volume * IDENTITY)
    AT_CONE.reset()
    stress = AT_CONE.stress(strain)
    assert rates(CONE).excess(strain, np.append(AT_CONE.commit().ravel(), 0.0)) <= 1e-9 * CONE.Y
    plastic = AT_CONE.commit()
    hooke = rates(CONE).elastic(strain - plastic)
    assert np.abs(stress - hooke).max() < 1e-9 * max(CONE.Y, np.abs(stress).max())
    scale = np.linalg.norm(plastic) * max(CONE.Y, np.linalg.norm(stress))
    for _ in range(20):
        p = limit - abs(rng.standard_normal()) * 10.0 ** rng.uniform(-3, 2)
        s = deviator(symmetric(rng))
        allowed = p * IDENTITY + (CONE.Y - CONE.beta * p) * s / np.linalg.norm(s)
        assert np.sum((allowed - stress) * plastic) <= 1e-9 * scale
    assert np.sum((limit * IDENTITY - stress) * plastic) <= 1e-9 * scale


def test_apex():
    """Pulled on all sides the stress is that of the apex, whatever the strain; and so next time."""
    AT_CONE.reset()
    wanted = CONE.Y / CONE.beta * IDENTITY
    for size in (1e-2, 3e-2):
        strain = size * (IDENTITY + 0.1 * np.diag([1.0, 0.5, -1.5]))
        assert np.abs(AT_CONE.stress(strain) - wanted).max() < 1e-12
        K = AT_CONE.solid.create_matrix()
        AT_CONE.solid.assemble_tangent(K)
        assert K.norm() == 0.0
        AT_CONE.commit()
    relief = AT_CONE.stress(strain - 1e-4 * IDENTITY)
    assert np.abs(relief - wanted + rates(CONE).elastic(1e-4 * IDENTITY)).max() < 1e-10


@pytest.mark.parametrize("angle", [5.0, 30.0, 60.0])
def test_mohr_and_coulomb_are_met(angle):
    """Stresses of collapse by Mohr's circle, s1 - s3 = 2 c cos - (s1 + s3) sin, are on the cone."""
    c, phi = 3.0, math.radians(angle)

    def excess(match, *stress):
        law, s = dm.DruckerPrager.from_mohr_coulomb(1000.0, 0.25, c, angle, match), np.diag(stress)
        return np.linalg.norm(deviator(s)) + law.beta * np.trace(s) / 3 - law.Y

    for lateral in (-1.0, -20.0):  # pressure of the cell, tension positive
        for match, sign in (("compression", 1), ("extension", -1)):
            axial = lateral * (1 + sign * math.sin(phi)) - 2 * sign * c * math.cos(phi)
            axial /= 1 - sign * math.sin(phi)
            assert abs(excess(match, axial, lateral, lateral)) < 1e-9
    # plane strain: no plastic strain along z fixes s_zz; radius and centre then follow Mohr
    radius = c * math.cos(phi) + 5.0 * math.sin(phi)
    zz = np.linspace(-5.0 - 3 * radius, -5.0 + 3 * radius, 20001)
    values = [excess("plane strain", radius - 5.0, -radius - 5.0, z) for z in zz]
    assert abs(min(values)) < 1e-5 * radius  # dF/ds_zz = 0 is dep_zz = 0


WOOD = {
    **{"E1": 12_000.0, "E2": 900.0, "E3": 500.0},
    **{"nu12": 0.4, "nu13": 0.45, "nu23": 0.6, "G12": 700.0, "G13": 650.0, "G23": 60.0},
}
IN_WOOD = MaterialPoint(dm.Orthotropic(**WOOD))


@settings(max_examples=40)
@given(seeds)
def test_stress_undoes_the_compliance_in_any_axes(seed):
    """The strain of Hooke's compliance gives back its stress, turned with the material."""
    rng, w = np.random.default_rng(seed), SimpleNamespace(**WOOD)
    angles = rng.uniform(-4, 4, 3)
    set_parameters(IN_WOOD, *WOOD.values(), *angles)
    R = Rotation.from_euler("ZYX", angles).as_matrix()  # yaw, then about new axes
    stress = 2 * symmetric(rng)
    a, b, c = np.diag(stress)
    strain = stress / 2 / np.array([[1, w.G12, w.G13], [w.G12, 1, w.G23], [w.G13, w.G23, 1]])
    strain[np.diag_indices(3)] = [
        (a - w.nu12 * b - w.nu13 * c) / w.E1,
        -w.nu12 / w.E1 * a + b / w.E2 - w.nu23 / w.E2 * c,
        -w.nu13 / w.E1 * a - w.nu23 / w.E2 * b + c / w.E3,
    ]
    found = IN_WOOD.stress(R @ strain @ R.T)
    assert np.abs(found - R @ stress @ R.T).max() < 1e-10


NEO_HOOKE, MOONEY = dm.NeoHooke(200.0, 0.3), dm.MooneyRivlin(0.293, 0.177, 14.0)
OGDEN = dm.Ogden(mu=(0.63, 0.0012, -0.01), alpha=(1.3, 5.0, -2.0), K=10.0)


@cache
def compiled(law):
    return law_at_point(law, create_law("law", law))


@pytest.mark.parametrize("l3", [0.6, 0.9, 1.7])
def test_stresses_in_closed_form(l3):
    """P_a = d psi / d lambda_a of the energies in principal stretches."""
    a = np.array([1.7, 0.9, l3])
    J, mean = a.prod(), (a**2).mean()
    mu, lam = 200 / 2.6, 60 / (1.3 * 0.4)
    volume = (J - 1) * J / a
    second = (a**2).sum() * a**2 - a**4  # lambda_a dI2/d lambda_a / 2, without J
    I2 = ((a**2).sum() ** 2 - (a**4).sum()) / 2
    mooney = 2 * 0.293 * J ** (-2 / 3) * (a**2 - mean) / a
    mooney += 2 * 0.177 * J ** (-4 / 3) * (second - 2 * I2 / 3) / a + 14.0 * volume
    ogden = 10.0 * volume
    for m, alpha in zip(OGDEN.mu, OGDEN.alpha, strict=True):
        power = (a / np.cbrt(J)) ** alpha
        ogden = ogden + m * (power - power.mean()) / a
    neo = mu * (a - 1 / a) + lam * np.log(J) / a
    for law, wanted in ((NEO_HOOKE, neo), (MOONEY, mooney), (OGDEN, ogden)):
        found = compiled(law)(np.diag(a), {}).stress[0]
        np.testing.assert_allclose(found, np.diag(wanted), atol=1e-12 * abs(wanted).max())


def test_arrays_are_not_called_inside_out():
    """A law of F has no value where det F < 0; of no points it has none."""
    u = create_displacement(create_domain("triangle"))
    solid = dm.Solid(u, Arrays(200.0, 0.3), strain="finite")
    u.interpolate(lambda x: np.stack([-2.0 * x[0], 0.0 * x[1]]))
    with rejected("Arrays", "is not called where det F is not positive", "-1"):
        solid.evaluate()
    p = SimpleNamespace(mu=(np.zeros(0),), alpha=(np.zeros(0),), K=np.zeros(0))
    P, A, _ = dm.Ogden.update(np.zeros((0, 3, 3)), {}, p)
    assert P.shape == (0, 3, 3) and A.shape == (0, 3, 3, 3, 3)


VOCE = dm.VonMisesVoce(1.0, 0.3, 1.0, 0.0, 0.0, 0.0, 1.0)
TIMBER = dm.Orthotropic(**WOOD)
WRONG = [
    *((VOCE, {n: 0.0}, f"VonMisesVoce: {n} is ") for n in ("E", "Y", "b")),
    *((VOCE, {n: -1e-300}, f"VonMisesVoce: {n} is ") for n in "aHQ"),
    (VOCE, {"Y": math.nan}, "VonMisesVoce: Y is "),
    (STEEL, {"nu": 0.5}, "VonMises: nu is "),
    (STEEL, {"H": -1.0}, "VonMises: H is "),
    *((dm.Elastic(1.0, 0.3), {n: v}, f"Elastic: {n} is ") for n, v in (("E", -1.0), ("nu", 0.5))),
    *((CONE, {n: 0.0}, f"DruckerPrager: {n} is ") for n in ("E", "Y", "beta")),
    (NEO_HOOKE, {"nu": 0.5}, "NeoHooke: nu"),
    (MOONEY, {"C01": -0.4}, "MooneyRivlin: C10 + C01 > 0"),
    (OGDEN, {"mu": (1.0,)}, "Ogden: one length"),
    (OGDEN, {"mu": (1.0,), "alpha": (-2.0,)}, "Ogden: mu * alpha > 0"),
    (TIMBER, {"E1": 0.0}, "Orthotropic: E1 is 0.0: give a finite number"),
    (TIMBER, {"nu12": 3.7}, "Orthotropic: nu12^2 < E1 / E2 does not hold for E1 = 12000.0"),
    (TIMBER, {"nu13": -5.0}, "Orthotropic: nu13^2 < E1 / E3 does not hold"),
    (TIMBER, {"nu23": 1.4}, "Orthotropic: nu23^2 < E2 / E3 does not hold"),
    (TIMBER, {"nu12": 2.6, "nu23": 0.9}, "Orthotropic: 2 nu12 nu23 nu13 E3 / E1 < 1 does not"),
]


@pytest.mark.parametrize(("law", "change", "said"), WRONG)
def test_wrong_parameters(law, change, said):
    name, _, words = said.partition(": ")
    with rejected(name, words):
        replace(law, **change)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: dm.VonMises.from_uniaxial(1.0, 0.3, 1.0, 0.1, isotropic=1.5), "isotropic is 1.5"),
        (
            lambda: dm.VonMisesVoce.from_uniaxial(E, NU, 9.0, saturation=2.0, rate=0.0),
            "rate is 0.0",
        ),
        (
            lambda: dm.DruckerPrager.from_mohr_coulomb(1.0, 0.2, 1.0, 90.0, "extension"),
            "friction_angle is 90.0: give",
        ),
        (
            lambda: dm.DruckerPrager.from_mohr_coulomb(1.0, 0.2, 1.0, 30.0, "outer"),
            "match is 'outer': choose 'compression', 'extension' or 'plane str",
        ),
    ],
)
def test_wrong_arguments_of_constructors(make, said):
    with rejected(said):
        make()

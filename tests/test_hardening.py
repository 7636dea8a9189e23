# SPDX-License-Identifier: MIT
"""Isotropic, mixed and saturating hardening against rate equations, bars and differences."""

import dataclasses
import itertools
import math

from mpi4py import MPI

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import wrightomega

import dolfinx_mortar as dm
import ufl
from dolfinx import fem, mesh
from dolfinx_mortar.kernels import compile_vectors, constants
from dolfinx_mortar.materials.law_check import law_at_point
from dolfinx_mortar.materials.protocol import create_law
from dolfinx_mortar.materials.von_mises import VonMises, VonMisesVoce, increment, wright_omega
from tests.cases.material_point import MaterialPoint
from tests.cases.rate_equations import Rates, deviator
from tests.choice import quick

E, NU, Y = 206_900.0, 0.29, 450 * math.sqrt(2 / 3)
LAWS = {
    "isotropic": VonMises(E, NU, Y, 0.0, 10_000.0),
    "mixed": VonMises(E, NU, Y, 10_000.0, 5_000.0),
    "voce": VonMisesVoce(E, NU, Y, 0.0, 0.0, 200.0, 50.0),
    "voce, mixed": VonMisesVoce(E, NU, Y, 10_000.0, 3_000.0, 200.0, 50.0),
}
_POINTS: dict[str, MaterialPoint] = {}


def point(name: str, law: object = None) -> MaterialPoint:
    """Return a virgin point of a law, made once."""
    if name not in _POINTS:
        _POINTS[name] = MaterialPoint(law or LAWS[name])
    _POINTS[name].reset()
    return _POINTS[name]


def rates(law: VonMises | VonMisesVoce) -> Rates:
    """Return the rate equations of a law."""
    Q, b = getattr(law, "Q", 0.0), getattr(law, "b", 1.0)

    def radius(k: float) -> float:
        return law.Y + law.H * k + Q * (1 - math.exp(-b * k))

    return Rates(law.E, law.nu, radius, lambda k: law.H + Q * b * math.exp(-b * k), law.a)


def committed(p: MaterialPoint) -> np.ndarray:
    """Return plastic strain and k, (10,), of the last commit."""
    k = p.solid.fields.values("accumulated_plastic_strain")[0, 0]
    return np.append(p.commit().ravel(), k)


def walk(p: MaterialPoint, path: list[np.ndarray], steps: int) -> np.ndarray:
    """Return plastic strain and k, (10,), after so many steps on each leg of a path."""
    p.reset()
    for start, end in itertools.pairwise(path):
        for t in np.linspace(0, 1, steps + 1)[1:]:
            p.stress(start + t * (end - start))
            p.commit()
    return committed(p)


def symmetric(rng: np.random.Generator) -> np.ndarray:
    """Return a random symmetric tensor of entries about one."""
    tensor = rng.standard_normal((3, 3))
    return (tensor + tensor.T) / 2


@pytest.mark.parametrize("name", quick(LAWS, list(LAWS)[-1]))
def test_proportional_path_is_the_rate_solution(name):
    """Cycles of axial strain in 2 steps a leg: what the rate equations give."""
    path = [s * np.diag([1.0, -0.5, -0.5]) for s in (0.0, 0.01, -0.012, 0.015, -0.02)]
    expected = rates(LAWS[name]).integrate(path)
    assert expected[9] > 0.05
    found = walk(point(name), path, 2)
    assert np.abs(found - expected).max() < 1e-9 * np.abs(expected).max()


@pytest.mark.parametrize("name", LAWS)
def test_non_proportional_path_converges_to_the_rate_solution(name, rng):
    """Order one in the steps, and extrapolated the rate solution."""
    legs = [np.zeros((3, 3))] + [4e-3 * symmetric(rng) for _ in range(3)]
    path = [sum(legs[: i + 1], np.zeros((3, 3))) for i in range(len(legs))]
    expected = rates(LAWS[name]).integrate(path)
    results = [walk(point(name), path, n) for n in (40, 80, 160)]
    errors = [np.linalg.norm(r - expected) for r in results]
    assert 1.7 < errors[0] / errors[1] < 2.3 and 1.7 < errors[1] / errors[2] < 2.3
    first = [2 * b - a for a, b in itertools.pairwise(results)]
    last = (4 * first[1] - first[0]) / 3
    assert np.linalg.norm(last - expected) < 2e-5 * np.linalg.norm(expected)


@pytest.mark.parametrize("name", quick(LAWS, list(LAWS)[-1]))
def test_check_accepts_the_law(name):
    """Stress, tangent, energy and state fit each other at random strains."""
    report = dm.materials.check(LAWS[name])
    assert report.changed > 10
    assert report.energy_error < 1e-8 and report.tangent_error < 1e-8
    assert report.state_error < 1e-12 and report.skew < 1e-12


@pytest.mark.parametrize("plane_stress", [False, True])
@pytest.mark.parametrize("name", ["kinematic", *LAWS])
def test_tangent_is_the_derivative_of_the_stress(name, plane_stress, rng):
    """What a law states equals what UFL derives, elastic, flowing and beside the yield surface."""
    material = LAWS.get(name) or VonMises(E, NU, Y, 10_000.0)
    law = create_law("law", material, plane_stress=plane_stress)
    assert law.tangent is not None
    stated, derived = (
        law_at_point(material, of) for of in (law, dataclasses.replace(law, tangent=None))
    )
    k, mu = 3e-3, E / (2 * (1 + NU))
    radius = Y + material.H * k
    radius += getattr(material, "Q", 0.0) * (1 - math.exp(-getattr(material, "b", 0.0) * k))
    for size in (0.0, 0.5, 1 - 1e-6, 1 + 1e-6, 1.2, 30.0):
        direction, ep = symmetric(rng), 2e-3 * symmetric(rng)
        ep -= np.trace(ep) / 3 * np.eye(3)
        center = (2 * mu + material.a) * ep / (2 * mu)
        away = deviator(symmetric(rng))
        strain = center + size * radius / (2 * mu) * away / np.linalg.norm(away)
        state = {"plastic_strain": ep, "accumulated_plastic_strain": k}
        state = {name: state[name] for name in law.state}
        a, b = (np.tensordot(of(strain, state).tangent, direction) for of in (stated, derived))
        assert np.abs(a - b).max() < 1e-12 * np.abs(b).max()


positive = st.floats(-3.0, 3.0).map(lambda power: 10.0**power)


@settings(max_examples=40)
@given(
    st.fixed_dictionaries({"a": positive, "H": positive, "Q": positive, "b": positive}),
    st.floats(0.05, 3.0),
    st.integers(0, 2**32 - 1),
)
def test_any_hardening_satisfies_the_flow_rule(parts, size, seed):
    """|s - a ep| = R(k) where k has grown, below elsewhere; the state rests after a commit.

    Moduli from 1e-3 to 1e3 times the yield radius 1, E = 1000: the parameters of one region are
    exchanged, nothing is compiled.
    """
    p = point("any", VonMisesVoce(1000.0, 0.3, 1.0, 1.0, 1.0, 1.0, 1.0))
    law = VonMisesVoce(1000.0, 0.3, 1.0, **parts)
    table = p.solid.regions[0].parameters.function.x.array.reshape(-1, 7)
    table[:] = [law.E, law.nu, law.Y, law.a, law.H, law.Q, law.b]
    rng, rate = np.random.default_rng(seed), rates(law)
    strain, before, flowed = np.zeros((3, 3)), np.zeros(10), 0
    for _ in range(5):
        strain = strain + 5e-3 * size * symmetric(rng)
        stress = p.stress(strain)
        now = committed(p)
        ep, k = now[:9].reshape(3, 3), now[9]
        assert np.abs(stress - rate.elastic(strain - ep)).max() < 1e-10 * rate.radius(k)
        shifted = deviator(stress) - law.a * ep
        if k > before[9]:
            increment = ep - before[:9].reshape(3, 3)
            assert np.linalg.norm(increment) == pytest.approx(k - before[9], rel=1e-8)
            n = shifted / np.linalg.norm(shifted)
            assert np.abs(shifted - rate.radius(k) * n).max() < 1e-10 * rate.radius(k)
            assert np.abs(increment - (k - before[9]) * n).max() < 1e-8 * (k - before[9])
            flowed += 1
        else:
            assert np.linalg.norm(shifted) <= rate.radius(k) * (1 + 1e-9)
        p.stress(strain)
        assert np.array_equal(committed(p), now)
        before = now
    assert flowed or size < 1.0


def test_the_local_equation_is_solved_to_round_off():
    """|s| = R(k) relative to what R can still grow, from first yield to deep saturation."""
    law = VonMisesVoce(1000.0, 0.3, 1.0, 0.0, 0.0, 100.0, 30.0)
    p, rate, shear = (
        point("steep", law),
        rates(law),
        np.array([[0, 1.0, 0], [1.0, 0, 0], [0, 0, 0]]),
    )
    errors = []
    for size in np.geomspace(1.1e-3, 0.3, 400):
        p.reset()
        stress = p.stress(size * shear)
        k = committed(p)[9]
        errors.append(abs(np.linalg.norm(stress) - rate.radius(k)))
    assert max(errors) < 5e-15 * law.Q


def everywhere(*powers: float) -> np.ndarray:
    """Return numbers of all sizes between powers of ten, denser about one."""
    return np.unique([*np.geomspace(*(10.0**p for p in powers), 121), *np.geomspace(1e-8, 1e8, 97)])


def test_one_step_of_halley_gives_omega_anywhere():
    """To 4e-5 of what SciPy has, for every exponent of a double, and at the ends of each piece."""
    y = constants(1)
    (omega,) = compile_vectors([ufl.as_vector([wright_omega(y[0])])])
    sizes = everywhere(-300, 308)
    ends = [s for e in (-15.0, -0.5, 1.0, 4.0) for s in (e, np.nextafter(e, -np.inf))]
    for at in (*sizes, *-sizes, *np.linspace(-40.0, 40.0, 4001), *ends):
        assert omega(np.array([at]))[0] == pytest.approx(wrightomega(at).real, rel=4e-5)


def test_the_increment_is_exact_for_any_numbers():
    """G + q (1 - exp(-G)) = X to round-off, q and X from 1e-300 to 1e300; and dG / dX."""
    c = constants(2)
    parts = increment(c[0], c[1], 1.0, 1.0, ufl.ln(c[1]))
    (solve,) = compile_vectors([ufl.as_vector(list(parts))])
    for q in everywhere(-300, 300):
        for X in everywhere(-300, 300):
            G, slope = solve(np.array([X, q]))
            assert abs(G - q * np.expm1(-G) - X) < 1e-15 * (X + q)
            assert slope == pytest.approx(1 / (1 + q * np.exp(-G)), rel=1e-10)


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
def test_uniaxial_cycle(share):
    """A bar hardens with the modulus given and yields early after reversal, as the share says."""
    law = VonMises.from_uniaxial(E, NU, 450.0, 15_000.0, isotropic=share)
    p = point(f"share {share > 0}", law)
    table = p.solid.regions[0].parameters.function.x.array.reshape(-1, 5)
    table[:] = [law.E, law.nu, law.Y, law.a, law.H]

    def bar(stress: float, plastic: float) -> None:
        strain = stress / E * np.diag([1.0, -NU, -NU]) + plastic * np.diag([1.0, -0.5, -0.5])
        assert np.allclose(p.stress(strain), np.diag([stress, 0, 0]), atol=1e-7)
        assert np.isclose(p.commit()[0, 0], plastic, rtol=1e-9)

    first = 300.0 / 15_000.0
    bar(449.999, 0.0)
    bar(750.0, first)
    back = 750.0 - 2 * (450.0 + share * 300.0)  # where it yields again
    bar(back + 0.001, first)
    bar(back - 60.0, first - 60.0 / 15_000.0)


def test_uniaxial_saturation():
    """S(p) = s0 + m p + S (1 - exp(-r p)) in a bar."""
    law = VonMisesVoce.from_uniaxial(E, NU, 450.0, saturation=200.0, rate=30.0, modulus=1000.0)
    p = MaterialPoint(law)
    for plastic in (1e-4, 5e-3, 0.03, 0.2):
        stress = 450.0 + 1000.0 * plastic + 200.0 * (1 - math.exp(-30.0 * plastic))
        strain = stress / E * np.diag([1.0, -NU, -NU]) + plastic * np.diag([1.0, -0.5, -0.5])
        assert np.allclose(p.stress(strain), np.diag([stress, 0, 0]), atol=1e-7)
        assert np.isclose(p.commit()[0, 0], plastic, rtol=1e-9)
    with pytest.raises(ValueError, match=r"rate is 0.0: give"):
        VonMisesVoce.from_uniaxial(E, NU, 450.0, saturation=200.0, rate=0.0)
    with pytest.raises(ValueError, match="got satturation; it takes saturation="):
        VonMisesVoce.from_uniaxial(E, NU, 450.0, satturation=200.0)


def test_without_isotropic_hardening_there_is_no_k():
    """H = 0 has only the plastic strain; a number or a Constant H has k."""
    for H in (0, 0.0):
        assert list(VonMises(E, NU, Y, 10_000.0, H).state) == ["plastic_strain"]
    H = fem.Constant(mesh.create_unit_interval(MPI.COMM_SELF, 1), 0.0)
    for law in (LAWS["mixed"], VonMises(E, NU, Y, 10_000.0, H)):
        assert list(law.state) == ["plastic_strain", "accumulated_plastic_strain"]


def test_saturation_of_nothing_is_mixed_hardening(rng):
    """Q = 0: the laws agree to round-off."""
    mixed = LAWS["mixed"]
    other = MaterialPoint(VonMisesVoce(E, NU, Y, mixed.a, mixed.H, 0.0, 50.0))
    p = point("mixed")
    for _ in range(5):
        strain = 6e-3 * symmetric(rng)
        assert np.abs(other.stress(strain) - p.stress(strain)).max() < 1e-11 * Y
        assert np.abs(other.commit() - p.commit()).max() < 1e-14
    assert p.commit().any()


@pytest.mark.parametrize(
    ("name", "value"),
    [("H", -1.0), ("H", math.nan), ("Q", -1.0), ("b", 0.0), ("b", math.inf), ("a", -1.0)],
)
def test_wrong_parameters(name, value):
    good = {"E": 1.0, "nu": 0.3, "Y": 1.0, "a": 0.0, "H": 0.0, "Q": 0.0, "b": 1.0}
    VonMisesVoce(**good)
    with pytest.raises(ValueError, match=f"VonMisesVoce: {name} is "):
        VonMisesVoce(**(good | {name: value}))
    if name == "H":
        with pytest.raises(ValueError, match="VonMises: H is "):
            VonMises(1.0, 0.3, 1.0, 0.0, value)
    with pytest.raises(ValueError, match=r"isotropic is 1.5: give"):
        VonMises.from_uniaxial(1.0, 0.3, 1.0, 0.1, isotropic=1.5)

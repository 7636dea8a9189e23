# SPDX-License-Identifier: MIT
"""Laws of a small strain at finite strain, at points: potential, tangent, invariance, solutions."""

import dataclasses
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx_mortar.materials import logarithms
from dolfinx_mortar.materials.logarithmic import LogarithmicLaw
from dolfinx_mortar.materials.protocol import create_law
from tests.cases.pointwise_laws import Compiled, OneSided
from tests.cases.user_laws import Cubic
from tests.choice import quick

E, NU, SIGMA_Y = 200e3, 0.3, 200.0
Y = np.sqrt(2 / 3) * SIGMA_Y
IDENTITY = np.eye(3)
# Weights of central differences of the sixth order.
SIXTH = {1: 3 / 4, 2: -3 / 20, 3: 1 / 60}


@dataclass(frozen=True)
class Bare(dm.Material):
    """A user's law without parameters."""

    state: ClassVar = {}
    linear: ClassVar = True

    @staticmethod
    def elastic_stress(strain, p):
        return 100.0 * strain

    @staticmethod
    def energy(strain, state, p):
        return 50.0 * ufl.inner(strain, strain)


@dataclass(frozen=True)
class Turning(OneSided):
    """A user's law of arrays that says that it is isotropic."""

    isotropic: ClassVar = True


MIXED = dm.VonMises(E, NU, Y, 500.0, 1000.0)
PERFECT = dm.VonMises(E, NU, Y, 0.0)
HARDENING = dm.VonMises(E, NU, Y, 0.0, 1000.0)
WOOD = dm.Orthotropic(200e3, 100e3, 50e3, 0.3, 0.2, 0.1, 40e3, 50e3, 30e3, 0.3, 0.4, 0.5)
LAWS = {
    "elastic": dm.Elastic(E, NU),
    "hardening": HARDENING,
    "voce": dm.VonMisesVoce(E, NU, Y, 0.0, 1000.0, 80.0, 20.0),
    "voce mixed": dm.VonMisesVoce(E, NU, Y, 500.0, 1000.0, 80.0, 20.0),
    "cone": dm.DruckerPrager(E, NU, Y, 0.4),
    "mixed": MIXED,
    "wood": WOOD,
    "user": Cubic(E, 1e5),
    "bare": Bare(),
    "arrays": Compiled(E, NU, Y, 500.0),
    "one-sided arrays": OneSided(E, NU, Y, 500.0),
    "turning arrays": Turning(E, NU, Y, 0.0),
}
EACH = quick(LAWS, *(name for name in LAWS if name != "voce mixed"))  # which compiles for 4 s
MULTIPLICATIVE = {"elastic", "hardening", "voce", "cone", "turning arrays"}


COMPILED: dict[Any, LogarithmicLaw] = {}


def compiled(material: Any, dimension: int = 3) -> LogarithmicLaw:
    """Return a law as function of F, compiled once for all parameters, which are arguments."""
    law = create_law("law", material)
    key = type(material), law.isotropic, *law.state, dimension
    if key not in COMPILED:
        names = [field.name for field in dataclasses.fields(material)]
        COMPILED[key] = LogarithmicLaw(law, names, dimension=dimension)
    return COMPILED[key]


def respond(material: Any, F: np.ndarray, state: Any = None, dimension: int = 3) -> Any:
    """Return what a law gives at F (q, 3, 3), from the virgin state if none is given."""
    law, q = compiled(material, dimension), len(F)
    fields = dataclasses.fields(material)
    p = {field.name: np.full(q, getattr(material, field.name)) for field in fields}
    if state is None:
        state = {name: np.zeros((q, *shape)) for name, shape in law.law.state.items()}
    return law.values(F, state, SimpleNamespace(**p))


def rotations(rng: np.random.Generator, q: int) -> np.ndarray:
    """Return random rotations (q, 3, 3)."""
    Q = np.linalg.qr(rng.standard_normal((q, 3, 3)))[0]
    return Q * np.sign(np.linalg.det(Q))[:, None, None]


def stretched(gap: float | None, J: float, seed: int = 1, q: int = 4) -> np.ndarray:
    """Return random F (q, 3, 3) with det F = J, and stretches that differ by a gap, or by 2."""
    rng = np.random.default_rng(seed)
    ratios = np.array([1.5, 1 / 1.5, 1.0] if gap is None else [1.0, 1 + gap, 1 + 0.3 * gap])
    ratios *= (J / ratios.prod()) ** (1 / 3)
    diagonal = np.array([np.diag(rng.permutation(ratios)) for _ in range(q)])
    return rotations(rng, q) @ diagonal @ rotations(rng, q)


def flowed(material: Any, q: int = 4) -> Any:
    """Return internal variables after a random stretch."""
    return respond(material, stretched(0.2, 1.0, seed=2, q=q)).state


def differences(material: Any, F: np.ndarray, state: Any, h: float) -> tuple[Any, Any]:
    """Return d psi / dF and dP / dF by differences."""
    P, A = np.zeros_like(F), np.zeros((*F.shape, 3, 3))
    for i, j in np.ndindex(3, 3):
        for n, weight in SIXTH.items():
            for sign in (1, -1):
                moved = F.copy()
                moved[:, i, j] += sign * n * h
                found = respond(material, moved, state)
                A[..., i, j] += sign * weight * found.stress / h
                if found.energy is not None:
                    P[:, i, j] += sign * weight * found.energy / h
    return P, A


@pytest.mark.parametrize("gap", [0.0, 1e-12, 1e-7, 1e-3, 0.1, None])
@pytest.mark.parametrize("name", EACH)
def test_stress_and_tangent_are_derivatives(name, gap):
    """In elastic and plastic flow, from a state that has flowed, with coincident stretches, too."""
    material = LAWS[name]
    F = np.concatenate([stretched(gap, J) for J in (0.3, 1.0, 3.0)])
    state = flowed(material, len(F))
    found = respond(material, F, state)
    P, A = differences(material, F, state, 3e-4)
    scale = np.abs(found.tangent).max()
    assert compiled(material).multiplicative == (name in MULTIPLICATIVE)
    assert np.abs(found.tangent - A).max() < 2e-9 * scale
    if compiled(material).has_energy:
        assert np.abs(found.stress - P).max() < 1e-10 * scale


@pytest.mark.parametrize("name", EACH)
def test_a_turn_of_the_body_turns_the_stress(name):
    material, rng = LAWS[name], np.random.default_rng(5)
    F, state = stretched(None, 1.2), flowed(LAWS[name])
    Q = rotations(rng, len(F))
    before, after = respond(material, F, state), respond(material, Q @ F, state)
    size = np.abs(before.stress).max()
    assert np.abs(after.stress - Q @ before.stress).max() < 1e-11 * size
    for name_, value in before.state.items():
        assert np.abs(after.state[name_] - value).max() < 1e-14
    if before.energy is not None:
        assert after.energy == pytest.approx(before.energy, rel=1e-13)


@pytest.mark.parametrize("name", sorted(MULTIPLICATIVE))
def test_isotropic_laws_do_not_see_turned_fibres(name):
    """F Q from a virgin state: the same energy and Cauchy stress."""
    material = LAWS[name]
    F, Q = stretched(None, 1.2), rotations(np.random.default_rng(6), 4)
    before, after = respond(material, F), respond(material, F @ Q)
    size = np.abs(before.stress).max()
    assert np.abs(after.stress @ Q.transpose(0, 2, 1) - before.stress).max() < 1e-11 * size


@pytest.mark.slow
@pytest.mark.parametrize("name", LAWS)
def test_small_strains_give_the_law_itself(name):
    """P(I + t H) / t -> the small-strain stress, the error being of first order in t."""
    material = LAWS[name]
    H, errors = np.random.default_rng(7).standard_normal((3, 3, 3)), []
    elastic = dataclasses.replace(material, Y=1e9) if hasattr(material, "Y") else material
    tangent = respond(elastic, np.tile(IDENTITY, (3, 1, 1))).tangent
    wanted = np.einsum("qijkl,qkl->qij", tangent, (H + H.transpose(0, 2, 1)) / 2)
    for t in (1e-4, 1e-5):
        P = respond(elastic, IDENTITY + t * H).stress / t
        errors.append(np.abs(P - wanted).max() / np.abs(wanted).max())
    assert 8 < errors[0] / errors[1] < 12


def test_tiny_strains_keep_their_digits():
    """H far below the round-off of 1 + H: the law gets H."""
    law = compiled(LAWS["elastic"])
    H = 1e-12 * np.random.default_rng(8).standard_normal((2, 3, 3))
    P, A, psi = np.empty((2, 9)), np.empty((2, 45)), np.empty(2)
    start = law.start(2, {}, {"E": np.full(2, E), "nu": np.full(2, NU)})
    law.respond(start, H, P, A, psi)
    e = (H + H.transpose(0, 2, 1)) / 2
    mu, lam = E / (2 * (1 + NU)), E * NU / ((1 + NU) * (1 - 2 * NU))
    wanted = 2 * mu * e + lam * np.trace(e, axis1=1, axis2=2)[:, None, None] * IDENTITY
    assert np.abs(P.reshape(2, 3, 3) - wanted).max() < 1e-11 * np.abs(wanted).max()


@pytest.mark.parametrize("name", quick(["hardening", "mixed", "wood"], "hardening"))
def test_the_plane_is_a_section_of_space(name):
    material = dataclasses.replace(WOOD, pitch=0.0, roll=0.0) if name == "wood" else LAWS[name]
    F = np.tile(IDENTITY, (4, 1, 1))
    F[:, :2, :2] += 0.3 * np.random.default_rng(9).standard_normal((4, 2, 2))
    F[:, 2, 2] = [1.0, 1.1, 0.9, 1.0]
    one, other = respond(material, F), respond(material, F, dimension=2)
    assert np.abs(one.stress - other.stress).max() < 1e-12 * np.abs(one.stress).max()
    inside = np.zeros((3, 3), dtype=bool)
    inside[:2, :2] = inside[2, 2] = True
    part = one.tangent * inside[:, :, None, None] * inside
    assert np.abs(part - other.tangent).max() < 1e-12 * np.abs(one.tangent).max()


@pytest.mark.parametrize("name", ["hardening", "mixed"])
def test_where_the_body_is_turned_inside_out_the_energy_is_infinite(name):
    found = respond(LAWS[name], np.array([np.diag([1.0, 1.0, -0.1]), IDENTITY]))
    assert found.energy[0] == np.inf and np.isfinite(found.energy[1])
    assert found.undefined.tolist() == [True, False]


def sheared(material: Any, end: float, step: float) -> dict[float, float]:
    """Return Kirchhoff's shear stress in simple shear at multiples of a half, by gamma."""
    state, found = None, {}
    for i in range(1, round(end / step) + 1):
        F = IDENTITY + i * step * np.array([[[0.0, 1, 0], [0, 0, 0], [0, 0, 0]]])
        response = respond(material, F, state)
        state = response.state
        tau = response.stress[0] @ F[0].T
        found[round(i * step, 9)] = tau[0, 1]
    return found


def test_perfect_plasticity_keeps_its_stress_in_shear():
    """sigma_y / sqrt(3) to gamma = 10; volume and spin do not matter."""
    tau = sheared(PERFECT, 10.0, 0.05)
    late = [value for gamma, value in tau.items() if gamma > 0.5]
    assert np.abs(np.array(late) / (SIGMA_Y / np.sqrt(3)) - 1).max() < 1e-3


def test_hardening_in_shear():
    """Figures of another program: 447, 779, 1774 at gamma = 1, 2, 5 with H = 1000 (uniaxial)."""
    law = dm.VonMises.from_uniaxial(E, NU, SIGMA_Y, 1000.0, isotropic=1.0)
    tau = sheared(law, 5.0, 0.01)
    assert [tau[g] for g in (1.0, 2.0, 5.0)] == pytest.approx([447, 779, 1774], abs=0.6)


def test_additive_plasticity_softens_in_shear():
    """Figures of another program, and the share that `stress_lost` tells."""
    law = dm.VonMises(E, NU, Y, 1e-12)  # a back stress too small to matter
    tau = sheared(law, 5.0, 0.01)
    assert [tau[g] for g in (0.5, 1.0, 2.0, 5.0)] == pytest.approx([115.2, 112.4, 96, 50], abs=0.5)


@pytest.mark.parametrize("stretch", [1.0, 1.1])
def test_lost_stress_is_told(stretch):
    """Whatever pressure is added by a change of volume."""
    law, state = dm.VonMises(E, NU, Y, 1e-12), None
    for gamma in np.arange(0.02, 1.01, 0.02):
        F = stretch * (IDENTITY + gamma * np.array([[[0.0, 1, 0], [0, 0, 0], [0, 0, 0]]]))
        p = {field.name: np.full(1, getattr(law, field.name)) for field in dataclasses.fields(law)}
        state = {"plastic_strain": np.zeros((1, 3, 3))} if state is None else state
        start = compiled(law).start(1, state, p)
        lost = compiled(law).stress_lost(start, F - IDENTITY)[0]
        found = respond(law, F, state)
        tau = found.stress[0] @ F[0].T
        deviator = tau - np.trace(tau) / 3 * IDENTITY
        state = found.state
        if gamma > 0.1:  # it flows, so that the law's own stress has the norm Y
            assert lost == pytest.approx(1 - np.linalg.norm(deviator) / Y, abs=1e-12)
    assert lost == pytest.approx(0.0200, abs=5e-4)


@dataclass
class Bar:
    """A bar along x whose sides are free; Q turns it with all that it has in it."""

    law: Any
    width: float = 1.0
    length: float = 1.0
    state: Any = None
    Q: Any = dataclasses.field(default_factory=lambda: IDENTITY)

    def stretch(self, length: float, poisson: float = 0.5) -> float:
        """Return Kirchhoff's stress along the bar; the ratio of the strains is a first guess."""
        self.width *= (length / self.length) ** -poisson
        self.length = length
        for _ in range(20):
            found = respond(self.law, (self.Q @ self.F)[None], self.state)
            stress = self.Q.T @ found.stress[0]
            slope = np.einsum("ji,jikl,kl->i", self.Q, found.tangent[0, :, :], self.Q * [0, 1, 1])
            self.width -= stress[1, 1] / slope[1]
            if abs(stress[1, 1]) < 1e-11:  # of 200 and more
                break
        self.state = found.state
        return stress[0, 0] * length

    @property
    def F(self) -> np.ndarray:
        return np.diag([self.length, self.width, self.width])


H_BAR, SATURATED, RATE = 900.0, 150.0, 12.0
HALVES = np.sqrt(2 / 3) * np.array([SATURATED, RATE])
BARS = {
    "isotropic": dm.VonMises.from_uniaxial(E, NU, SIGMA_Y, H_BAR, isotropic=1.0),
    "mixed": dm.VonMises.from_uniaxial(E, NU, SIGMA_Y, H_BAR, isotropic=0.5),
    "kinematic": dm.VonMises.from_uniaxial(E, NU, SIGMA_Y, H_BAR),
    "voce": dm.VonMisesVoce(E, NU, Y, 0.0, 2 / 3 * H_BAR, *HALVES),
}


@pytest.mark.parametrize("name", BARS)
def test_a_stretched_bar(name):
    """To lambda = 2 in 20 steps: tau = sigma_y(p), p = ln lambda - tau / E."""
    bar, saturated = Bar(BARS[name]), SATURATED * (name == "voce")
    for stretch in np.linspace(1.05, 2.0, 20):
        tau = bar.stretch(stretch)
        p = np.log(stretch) - tau / E
        assert tau == pytest.approx(
            SIGMA_Y + H_BAR * p + saturated * (1 - np.exp(-RATE * p)), rel=1e-12
        )
    # the plastic strain is the logarithmic one: ln 2 without its elastic part
    assert bar.state["plastic_strain"][0, 0, 0] == pytest.approx(p, rel=1e-12)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_bar_that_dilates_in_flow(sign):
    """Drucker and Prager's: tau stays, ln J grows by beta of the distortion; to 2 and to 1/2."""
    beta, bar = 0.4, Bar(LAWS["cone"])
    tau = sign * Y / (np.sqrt(2 / 3) + sign * beta / 3)
    axial, side = sign * 2 / np.sqrt(6) + beta / 3, -sign / np.sqrt(6) + beta / 3  # dep / |dep'|
    for log_stretch in sign * np.log(2.0) * np.linspace(0.05, 1.0, 20):
        found = bar.stretch(np.exp(log_stretch), -side / axial)
        assert found == pytest.approx(tau, rel=1e-11)
        log_J = tau / E * (1 - 2 * NU) + beta * (log_stretch - tau / E) / axial
        assert np.log(np.linalg.det(bar.F)) == pytest.approx(log_J, rel=1e-11)


def test_plane_stress_out_of_the_apex():
    """There all moduli are those of the stress: the first step would end at a stretch of zero."""
    cone, plastic = LAWS["cone"], np.zeros((1, 3, 3))
    plastic[0] = np.diag([0.00103059, -0.00358583, 0.00498685])
    p = {f.name: np.full(1, getattr(cone, f.name)) for f in dataclasses.fields(cone)}
    H = np.diag([0.01, 0.01, 0.0])[None].copy()
    law = compiled(cone, 2)
    law.find_normal(law.start(1, {"plastic_strain": plastic}, p), H)
    assert -0.009 < H[0, 2, 2] < -0.008
    found = respond(cone, IDENTITY + H, {"plastic_strain": plastic}, dimension=2)
    assert abs(found.stress[0, 2, 2]) < 1e-6 * found.stress[0, 0, 0]


@pytest.mark.parametrize("name", ["isotropic", "mixed", "kinematic"])
def test_a_stretched_bar_that_is_turned_and_shortened(name):
    """By 90 degrees: the back stress turns along, and yields where a bar that stays does."""
    bar = Bar(BARS[name])
    for stretch in np.linspace(1.02, 1.3, 15):
        first = bar.stretch(stretch)
    bar.Q = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    assert bar.stretch(1.3) == pytest.approx(first, rel=1e-11)
    p, share = np.log(1.3) - first / E, {"isotropic": 1.0, "mixed": 0.5, "kinematic": 0.0}[name]
    lowest = (1 - 2 * share) * H_BAR * p - SIGMA_Y  # back stress less the radius
    for stretch in np.linspace(1.299, 1.2, 20):
        elastic = first + E * np.log(stretch / 1.3)
        flow = max(lowest - elastic, 0.0) / (E + H_BAR)
        assert bar.stretch(stretch) == pytest.approx(elastic + E * flow, rel=1e-9, abs=1e-9 * Y)


def test_flow_keeps_volume_and_what_does_not_flow_keeps_its_state():
    state = None
    for seed in range(30):
        F = stretched(None, 1.0, seed=seed)
        state = respond(HARDENING, F, state).state
    plastic = state["plastic_strain"]
    assert np.abs(plastic).max() > 0.3
    assert np.abs(np.trace(plastic, axis1=1, axis2=2)).max() < 1e-13
    # unloaded as far as the yield surface allows, nothing changes to the last bit
    again = respond(dataclasses.replace(HARDENING, Y=1e9), F, state).state
    assert np.array_equal(again["plastic_strain"], plastic)


def test_the_state_is_half_the_logarithm_of_the_plastic_metric():
    """C_p^-1 = F^-1 b_e F^-T with b_e = exp(2 eps_e), eps_e the elastic strain of tau."""
    F = stretched(None, 1.0)
    found = respond(HARDENING, F)
    tau = found.stress @ F.transpose(0, 2, 1)
    mu, K = E / (2 * (1 + NU)), E / (3 * (1 - 2 * NU))
    mean = np.trace(tau, axis1=1, axis2=2)[:, None, None] / 3 * IDENTITY
    elastic = (tau - mean) / (2 * mu) + mean / (3 * K)
    inverse = np.linalg.inv(F)
    Cp = inverse @ exponential(2 * elastic) @ inverse.transpose(0, 2, 1)
    assert np.abs(exponential(-2 * found.state["plastic_strain"]) - Cp).max() < 1e-12


def exponential(A: np.ndarray) -> np.ndarray:
    """Return exp of symmetric tensors (q, 3, 3)."""
    values, vectors = np.linalg.eigh(A)
    return np.einsum("qia,qa,qja->qij", vectors, np.exp(values), vectors)


def test_divided_differences():
    """Against differences in long double, on both sides of the ends of the series."""
    rng = np.random.default_rng(11)
    for size in (1e-3, 0.05, 0.1, 0.3, 2.0):
        x, y, z = x_, y_, z_ = np.sort(rng.uniform(0, size, 3)) + rng.uniform(-0.5, 2)
        if min(y - x, z - y) < size / 20:
            continue
        a, b, c = (1 + np.longdouble(v) for v in (x_, y_, z_))

        def f(p: Any, q: Any) -> Any:
            return (np.log(p) - np.log(q)) / (2 * (p - q))

        logs = [np.log1p(v) / 2 for v in (x, y, z)]
        xy = logarithms.first_difference(x, y, logs[0], logs[1])
        yz = logarithms.first_difference(y, z, logs[1], logs[2])
        zx = logarithms.first_difference(z, x, logs[2], logs[0])
        assert xy == pytest.approx(float(f(a, b)), rel=1e-13)
        second = logarithms.second_difference(x, y, z, xy, yz, zx)
        assert second == pytest.approx(float((f(a, b) - f(b, c)) / (a - c)), rel=2e-12)
        xxy, xyy = logarithms.confluent_differences(x, y, xy)
        assert xxy == pytest.approx(float((1 / (2 * a) - f(a, b)) / (a - b)), rel=2e-12)
        assert xyy == pytest.approx(float((f(a, b) - 1 / (2 * b)) / (a - b)), rel=2e-12)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["hardening", "mixed", "arrays"])
def test_laws_are_checked_at_finite_strain(name):
    report = dm.materials.check(LAWS[name], strain="finite")
    assert report.tangent_error < 1e-7 and report.objectivity_error < 1e-11


@pytest.mark.slow
def test_isotropy_is_checked():
    """What a law declares is compared; a false declaration is an error with both values."""

    @dataclass(frozen=True)
    class Fibres(Cubic):
        isotropic: ClassVar = True

    assert dm.materials.check(HARDENING).isotropy_error < 1e-9
    assert np.isnan(dm.materials.check(MIXED).isotropy_error)
    with pytest.raises(ValueError, match="isotropic is True, but of the turned elastic strain"):
        dm.materials.check(Fibres(E, 1e7))
    with pytest.raises(ValueError, match="isotropic is True, but of the turned elastic strain"):
        dm.materials.check(Turning(E, NU, Y, 5000.0))  # a back stress


def test_an_isotropic_law_remembers_no_other_tensor():
    @dataclass(frozen=True)
    class Wrong(Cubic):
        isotropic: ClassVar = True
        state: ClassVar = {"back": (3, 3)}

        @staticmethod
        def updated_state(strain, state, p):
            return state

    with pytest.raises(ValueError, match="isotropic is True, but state has the tensor 'back'"):
        create_law("law", Wrong(E, 1.0))

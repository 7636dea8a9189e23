# SPDX-License-Identifier: MIT
"""Laws of a small strain at finite strain: potential, tangent, invariance, solutions."""

import dataclasses
import re
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pytest
from scipy.linalg import expm

import dolfinx_mortar as dm
from dolfinx import fem
from dolfinx_mortar.materials.logarithmic import LogarithmicLaw
from dolfinx_mortar.materials.protocol import create_law
from tests.cases.material_point import MaterialPoint
from tests.cases.pointwise_laws import OneSided
from tests.cases.solid import create_displacement, create_domain, create_tags, hold
from tests.cases.two_bodies import create_problem

E, NU, SIGMA_Y = 200e3, 0.3, 200.0
Y = np.sqrt(2 / 3) * SIGMA_Y
IDENTITY = np.eye(3)


@dataclass(frozen=True)
class Turning(OneSided):
    """A user's law of arrays that says that it is isotropic."""

    isotropic: ClassVar = True


MIXED = dm.VonMises(E, NU, Y, 500.0, 1000.0)
PERFECT = dm.VonMises(E, NU, Y, 0.0)
HARDENING = dm.VonMises(E, NU, Y, 0.0, 1000.0)
WOOD = dm.Orthotropic(200e3, 100e3, 50e3, 0.3, 0.2, 0.1, 40e3, 50e3, 30e3, 0.3, 0.4, 0.5)
LAWS = {
    "hardening": HARDENING,
    "voce": dm.VonMisesVoce(E, NU, Y, 0.0, 1000.0, 80.0, 20.0),
    "cone": dm.DruckerPrager(E, NU, Y, 0.4),
    "mixed": MIXED,
    "wood": WOOD,
    "one-sided arrays": OneSided(E, NU, Y, 500.0),
    "turning arrays": Turning(E, NU, Y, 0.0),
}
MULTIPLICATIVE = {"hardening", "voce", "cone", "turning arrays"}

COMPILED = {}


def compiled(material, dimension=3):
    """Return a law as function of F, compiled once for all parameters, which are arguments."""
    law = create_law("law", material)
    key = type(material), law.isotropic, *law.state, dimension
    if key not in COMPILED:
        names = [field.name for field in dataclasses.fields(material)]
        COMPILED[key] = LogarithmicLaw(law, names, dimension=dimension)
    return COMPILED[key]


def given(material, q, state, dimension=3):
    """Return a compiled law, state and parameters of q points, virgin if no state is given."""
    law, fields = compiled(material, dimension), dataclasses.fields(material)
    if state is None:
        state = {name: np.zeros((q, *shape)) for name, shape in law.law.state.items()}
    return law, state, {field.name: np.full(q, getattr(material, field.name)) for field in fields}


def respond(material, F, state=None, dimension=3):
    law, state, p = given(material, len(F), state, dimension)
    return law.values(F, state, p)


def start(material, q, state=None, dimension=3):
    law, state, p = given(material, q, state, dimension)
    return law, law.start(q, state, p)


def rotations(rng, q):
    Q = np.linalg.qr(rng.standard_normal((q, 3, 3)))[0]
    return Q * np.sign(np.linalg.det(Q))[:, None, None]


def stretched(gap, J, seed=1, q=4):
    """Return random F (q, 3, 3) with det F = J, and stretches that differ by a gap, or by 2."""
    rng = np.random.default_rng(seed)
    ratios = np.array([1.5, 1 / 1.5, 1.0] if gap is None else [1.0, 1 + gap, 1 + 0.3 * gap])
    ratios *= (J / ratios.prod()) ** (1 / 3)
    diagonal = np.array([np.diag(rng.permutation(ratios)) for _ in range(q)])
    return rotations(rng, q) @ diagonal @ rotations(rng, q)


def flowed(material, q=4):
    return respond(material, stretched(0.2, 1.0, seed=2, q=q)).state


def differences(material, F, state, h):
    """Return d psi / dF and dP / dF by differences of sixth order."""
    P, A = np.zeros_like(F), np.zeros((*F.shape, 3, 3))
    for i, j in np.ndindex(3, 3):
        for n, weight in {1: 3 / 4, 2: -3 / 20, 3: 1 / 60}.items():
            for sign in (1, -1):
                moved = F.copy()
                moved[:, i, j] += sign * n * h
                found = respond(material, moved, state)
                A[..., i, j] += sign * weight * found.stress / h
                if found.energy is not None:
                    P[:, i, j] += sign * weight * found.energy / h
    return P, A


@pytest.mark.parametrize("gap", [0.0, 1e-7, 1e-3, 0.1, None])
@pytest.mark.parametrize("name", LAWS)
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


@pytest.mark.parametrize("name", LAWS)
def test_turns_of_the_body_and_of_its_fibres(name):
    """Q F: the turned stress and the same state; F Q, if isotropic and virgin: Cauchy's stress."""
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
    if name in MULTIPLICATIVE:
        before, after = respond(material, F), respond(material, F @ Q)
        assert np.abs(after.stress @ Q.swapaxes(1, 2) - before.stress).max() < 1e-11 * size


@pytest.mark.parametrize("name", ["hardening", "wood"])
def test_tiny_strains_keep_their_digits(name):
    """H far below the round-off of 1 + H: the stress is that of the small strain."""
    law, p = start(LAWS[name], 2)
    H = 1e-12 * np.random.default_rng(8).standard_normal((2, 3, 3))
    P, _, _ = law.response(p, H)
    point = MaterialPoint(LAWS[name])
    wanted = np.array([point.stress(1e6 * (h + h.T) / 2) for h in H]) / 1e6
    assert np.abs(P.reshape(2, 3, 3) - wanted).max() < 1e-11 * np.abs(wanted).max()


def test_where_the_body_is_turned_inside_out_the_energy_is_infinite():
    found = respond(MIXED, np.array([np.diag([1.0, 1.0, -0.1]), IDENTITY]))
    assert found.energy[0] == np.inf and np.isfinite(found.energy[1])
    assert found.undefined.tolist() == [True, False]


def sheared(material, end, step):
    """Return Kirchhoff's shear stress in simple shear at multiples of a half, by gamma."""
    state, found = None, {}
    for i in range(1, round(end / step) + 1):
        F = IDENTITY + i * step * np.array([[[0.0, 1, 0], [0, 0, 0], [0, 0, 0]]])
        response = respond(material, F, state)
        state = response.state
        tau = response.stress[0] @ F[0].T
        found[round(i * step, 9)] = tau[0, 1]
    return found


@pytest.mark.parametrize(
    ("law", "figures", "tolerance"),
    [
        (
            dm.VonMises.from_uniaxial(E, NU, SIGMA_Y, 1000.0, isotropic=1.0),
            {1.0: 447, 2.0: 779, 5.0: 1774},
            0.6,
        ),
        # a back stress too small to matter
        (dm.VonMises(E, NU, Y, 1e-12), {0.5: 115.2, 1.0: 112.4, 2.0: 96, 5.0: 50}, 0.5),
        # sigma_y / sqrt(3): volume and spin do not matter
        (PERFECT, dict.fromkeys((0.5, 1.0, 5.0), SIGMA_Y / np.sqrt(3)), 0.1),
    ],
    ids=["hardening", "additive", "perfect"],
)
def test_simple_shear(law, figures, tolerance):
    """Numbers of another program, and those of perfect plasticity."""
    tau = sheared(law, 5.0, 0.01)
    assert {g: tau[g] for g in figures} == pytest.approx(figures, abs=tolerance)


@dataclass
class Bar:
    """A bar along x whose sides are free; Q turns it with all that it has in it."""

    law: Any
    width: float = 1.0
    length: float = 1.0
    state: Any = None
    Q: Any = dataclasses.field(default_factory=lambda: IDENTITY)

    def stretch(self, length, poisson=0.5):
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
    def F(self):
        return np.diag([self.length, self.width, self.width])


H_BAR, SATURATED, RATE = 900.0, 150.0, 12.0
HALVES = np.sqrt(2 / 3) * np.array([SATURATED, RATE])
BARS = {
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
    H, state = np.diag([0.01, 0.01, 0.0])[None].copy(), {"plastic_strain": plastic}
    law, begun = start(cone, 1, state, dimension=2)
    law.find_normal(begun, H)
    assert -0.009 < H[0, 2, 2] < -0.008
    found = respond(cone, IDENTITY + H, state, dimension=2)
    assert abs(found.stress[0, 2, 2]) < 1e-6 * found.stress[0, 0, 0]


def test_a_stretched_bar_that_is_turned_and_shortened():
    """By 90 degrees: the back stress turns along, and yields where a bar that stays does."""
    bar = Bar(BARS["mixed"])
    for stretch in np.linspace(1.02, 1.3, 15):
        first = bar.stretch(stretch)
    bar.Q = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    assert bar.stretch(1.3) == pytest.approx(first, rel=1e-11)
    lowest = -SIGMA_Y  # half of the hardening moves the range, half of it widens it
    for stretch in np.linspace(1.299, 1.2, 20):
        elastic = first + E * np.log(stretch / 1.3)
        flow = max(lowest - elastic, 0.0) / (E + H_BAR)
        assert bar.stretch(stretch) == pytest.approx(elastic + E * flow, rel=1e-9, abs=1e-9 * Y)


def test_the_state_is_half_the_logarithm_of_the_plastic_metric():
    """C_p^-1 = F^-1 b_e F^-T with b_e = exp(2 eps_e), eps_e the elastic strain of tau."""
    F = stretched(None, 1.0)
    found = respond(HARDENING, F)
    tau = found.stress @ F.transpose(0, 2, 1)
    mu, K = E / (2 * (1 + NU)), E / (3 * (1 - 2 * NU))
    mean = np.trace(tau, axis1=1, axis2=2)[:, None, None] / 3 * IDENTITY
    elastic = (tau - mean) / (2 * mu) + mean / (3 * K)
    inverse = np.linalg.inv(F)
    Cp = inverse @ expm(2 * elastic) @ inverse.transpose(0, 2, 1)
    assert np.abs(expm(-2 * found.state["plastic_strain"]) - Cp).max() < 1e-12


def test_lost_stress_is_noted():
    """Sheared by 1.2, a kinematic law says what it loses; an isotropic one loses nothing."""
    for law, noted in ((dm.VonMises(E, NU, Y, 1.0), True), (PERFECT, False)):
        u = create_displacement(create_domain("quadrilateral", 2))
        step = fem.Function(u.function_space)
        bcs = [hold(u.function_space, lambda x: np.full(x.shape[1], True), value=step)]

        def on_time(t, step=step):
            step.interpolate(lambda x: np.stack([1.2 * t * x[1], 0 * x[0]]))

        problem = create_problem(u, (), bcs, law, strain="finite")
        *_, last = dm.load_steps(problem, np.linspace(0.05, 1, 20), on_time=on_time)
        told = re.findall(r"logarithmic strain space.* up to (\d+) %", str(last.report.notes))
        assert len(told) == noted
        lost = 100.0 * (1.0 - problem.solid.max("von_mises") / SIGMA_Y)
        assert lost == pytest.approx(float(told[0]) if noted else 0.0, abs=0.6)
        tau = problem.solid.max("stress_xy")
        assert tau == pytest.approx(SIGMA_Y / np.sqrt(3), rel=0.06 if noted else 1e-3)


def test_one_class_may_run_in_both_forms():
    """Of a kinematic and an isotropic law of one class each cell has the answer of its own."""
    domain = create_domain("quadrilateral", 3)
    tags, found = create_tags(domain, lambda x: np.where(x[:, 0] < 0.5, 1, 2)), []
    for laws in ({1: MIXED, 2: HARDENING}, {1: MIXED, 2: MIXED}, {1: HARDENING, 2: HARDENING}):
        solid = dm.Solid(create_displacement(domain), laws, tags, strain="finite")
        solid.u.interpolate(lambda x: np.stack([2.0 * x[1], 0 * x[0]]))
        solid.evaluate()
        found.append(solid.fields.values("stress_xy"))
    both, one, other = found
    left = tags.values[: len(both)] == 1
    assert np.array_equal(both[left], one[left]) and np.array_equal(both[~left], other[~left])
    assert not np.allclose(one, other, rtol=1e-2)

# SPDX-License-Identifier: MIT
"""`materials.check` compares a law with finite differences and says where they differ."""

import re
from dataclasses import dataclass, make_dataclass, replace
from typing import ClassVar

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from tests.cases.pointwise_laws import Compiled, OneSided, Radial, nan_last, spoilt
from tests.cases.pressed_blocks import rejected
from tests.cases.solid import create_domain
from tests.cases.user_laws import Arrays, Cubic, OfHooke, Slack, Unturned
from tests.test_user_laws import Isotropic, variant

E, NU, Y, A = 1000.0, 0.3, 1.0, 100.0
KINEMATIC, MIXED = dm.VonMises(E, NU, Y, A), dm.VonMises(E, NU, Y, A, 50.0)
VOCE, CONE = dm.VonMisesVoce(E, NU, Y, A, 30.0, 1.0, 50.0), dm.DruckerPrager(E, 0.25, Y, 0.6)
TIMBER = dm.Orthotropic(11e3, 600.0, 900.0, 0.4, 0.3, 0.3, 700.0, 800.0, 70.0, yaw=0.4)
METAL = dm.VonMises(1e11, 0.49, 1e6, 1e3)  # how small the yield strain is must not matter
PLANE, FINITE = {"plane_stress": True}, {"strain": "finite"}


def von_mises_stress(strain, state, p):
    ep = dm.VonMises.updated_state(strain, state, p)["plastic_strain"]
    return dm.Elastic.elastic_stress(strain - ep, p)


def von_mises(**changes):
    """Return a von Mises law with parts replaced."""
    names = ("linear", "elastic_stress", "updated_state", "energy")
    methods = {name: getattr(dm.VonMises, name) for name in names}
    methods |= {"state": {"plastic_strain": (3, 3)}} | changes
    methods = {name: part for name, part in methods.items() if part is not None}
    parts = {name: staticmethod(p) if callable(p) else p for name, p in methods.items()}
    fields = [(name, float) for name in ("E", "nu", "Y", "a")]
    law = make_dataclass("Slip", fields, namespace=parts, frozen=True)
    return law(E, NU, Y, A)


def cancelling(strain, state, p):
    """Return an energy with few digits at small strains, which is no fault of the law."""
    d = ufl.dev(strain)
    return p.E * (ufl.tr(strain) ** 2 + 9e-6 * (ufl.sqrt(1 + ufl.inner(d, d) / 9e-6) - 1))


ACCEPTED = [
    *((law, {}, 1e-9) for law in (dm.NeoHooke(200.0, 0.3), Arrays(200.0, 0.3))),
    (dm.MooneyRivlin(0.293, 0.177, 14.0), {}, 1e-9),
    (dm.Ogden((0.63, 0.0012, -0.01), (1.3, 5.0, -2.0), 10.0), {}, 1e-9),
    *((law, {}, 1e-8) for law in (KINEMATIC, MIXED, VOCE, TIMBER, Isotropic(E, NU, Y, A))),
    *((law(E, NU, Y, A), {}, 1e-8) for law in (Radial, Compiled, OneSided)),
    (von_mises(stress=von_mises_stress), {}, 1e-8),
    (von_mises(energy=cancelling, state={}, updated_state=None), {}, 1e-5),
    *((law, {"size": 0.05}, 1e-7) for law in (CONE, replace(CONE, beta=2.0))),
    *((law, PLANE, 1e-8) for law in (KINEMATIC, MIXED, VOCE, CONE, TIMBER)),
    *((law, PLANE, 1e-8) for law in (Radial(E, NU, Y, A), Isotropic(E, NU, Y, A))),
    *((law, FINITE, 1e-7) for law in (METAL, replace(METAL, nu=0.3), replace(METAL, a=0.0))),
]


@pytest.mark.parametrize(("law", "options", "tolerance"), ACCEPTED, ids=str)
def test_check_accepts_what_fits(law, options, tolerance):
    report = dm.materials.check(law, **options)
    assert np.isnan(report.energy_error) == (not hasattr(law, "energy"))
    assert not report.energy_error > tolerance and report.tangent_error < tolerance
    assert not report.objectivity_error > 1e-11 and report.skew < 1e-9
    assert not report.state_error > 1e-12 and not report.isotropy_error > 1e-9
    assert report.changed > 10 or not getattr(law, "state", {})
    assert report.samples >= (55 if law.E == METAL.E else 24) if hasattr(law, "E") else True
    assert f"{type(law).__name__}: consistent at" in str(report)
    assert ("of the energy" in str(report)) == hasattr(law, "energy")


class Slips:
    """Mistakes that the shapes do not show, by the method that has them."""

    @staticmethod
    def energy(strain, state, p):
        return 1.001 * dm.VonMises.energy(strain, state, p)

    @staticmethod
    def slow(strain, state, p):
        ep = state["plastic_strain"]
        new = dm.VonMises.updated_state(strain, state, p)["plastic_strain"]
        return {"plastic_strain": ep + 0.9 * (new - ep)}

    @staticmethod
    def skew(strain, state, p):
        C = dm.Elastic.elastic_stress(strain, p)
        return C + ufl.as_tensor([[0, 0.1 * C[0, 1], 0], [0, 0, 0], [0, 0, 0]])

    @staticmethod
    def start(strain, state, p):
        return von_mises_stress(strain, state, p) + 0.01 * p.E * ufl.Identity(3)

    @staticmethod
    def root(strain, state, p):
        return ufl.sqrt(0.01 - ufl.inner(strain, strain) * 2) * strain


class Strained(Unturned):
    """Without -2 ln J: it pulls together."""

    @staticmethod
    def energy(F, state, p):
        return p.E / 2 * ufl.inner(F, F) + p.E / 2 * (ufl.det(F) - 1) ** 2


class Undefined(Unturned):
    """Of volumes above .35 only."""

    @staticmethod
    def energy(F, state, p):
        part = ufl.sqrt(ufl.det(F) - 0.35)
        return p.E / 2 * (ufl.inner(F, F) - 2 * ufl.ln(ufl.det(F))) + 1e-9 * p.E * (part**3 - part)


@dataclass(frozen=True)
class Noisy(Arrays):
    """No difference tells anything about its tangent."""

    energy: ClassVar = None

    @staticmethod
    def update(F, state, p):
        P, tangent, new = Arrays.update(F, state, p)
        noise = 1e-3 * np.sin(1e9 * (np.linalg.det(F) - 1))
        return (1 + noise[:, None, None]) * P, tangent, new


@dataclass(frozen=True)
class OffInFlow(dm.VonMises):
    """By 1e-5 of the shear modulus, a fiftieth of the largest one."""

    @staticmethod
    def tangent(strain, state, p, direction):
        change = dm.VonMises.tangent(strain, state, p, direction)
        return change + 1e-5 * (dm.Elastic.elastic_stress(direction, p) - change)


@dataclass(frozen=True)
class OffAfterFlow(Radial):
    @staticmethod
    def update(strain, state, p):
        stress, tangent, new = Radial.update(strain, state, p)
        size = np.linalg.norm(state["plastic_strain"], axis=(1, 2))
        return stress, tangent * (1 + 2e-3 * size[:, None, None, None, None]), new


@dataclass(frozen=True)
class Short(Radial):
    @staticmethod
    def update(strain, state, p):
        return strain


@dataclass(frozen=True)
class Fibres(Cubic):
    isotropic: ClassVar = True


class Misspelt(OfHooke):
    ranges: ClassVar = {"Emodulus": (0.0, 1.0, False)}
    energy = staticmethod(dm.Elastic.energy)


DIFFERS = von_mises(stress=von_mises_stress, energy=Slips.energy)
REFUSED = [
    (Unturned(1.0), {}, ("Unturned", "a rotation", "write psi in C = F^T F")),
    (Strained(3.0), {}, ("Strained", "stress at F = I", "[[3.", "initial_stress=True")),
    (
        Undefined(1.0),
        {"initial_stress": True},
        ("Undefined gives NaN or infinity", "J = 0.3", "J > 0"),
    ),
    (Noisy(200.0, 0.3), {}, ("Noisy: differences ", " disagree ", "of 30")),
    (OffInFlow(1e11, 0.49, 1e6, 1e3), FINITE, ("OffInFlow: dP/dF",)),
    (OffAfterFlow(E, NU, Y, A), FINITE, ("OffAfterFlow: dP/dF", ", plastic_strain = [")),
    (DIFFERS, {}, ("Slip", "the stress times D is ", ", but ")),
    (von_mises(updated_state=Slips.slow), {}, ("Slip", "after a commit at the same strain it is")),
    (von_mises(stress=Slips.skew), {}, ("Slip", "mirrored it is")),
    (von_mises(linear=True), {}, ("linear is True, but the tangent ", "at zero strain it is")),
    (von_mises(stress=Slips.root, energy=None), {}, ("gives NaN or infinity at strain",)),
    (von_mises(stress=Slips.start, energy=None), {}, ("the stress at zero strain is ", ", not 0")),
    (spoilt(tangent=lambda t: 1.01 * t), {}, ("Spoilt: the tangent along D ", " differences of")),
    (spoilt(plastic_strain=lambda e: 0.9 * e), {}, ("after a commit at the same strain it is",)),
    (spoilt(stress=nan_last), {}, ("gives NaN or infinity at strain",)),
    (Short(E, NU, Y, A), {}, ("Short.update returns ndarray; it must return stress, ",)),
    (Fibres(E, 1e7), {}, ("isotropic is True, but of the turned elastic strain",)),
    (Misspelt(E, NU), {}, ("ranges: a name is 'Emodulus': choose 'E' or 'nu'",)),
    (Slack(1e3), PLANE, ("plane stress",)),
    (dm.NeoHooke(1.0, 0.3), PLANE, ("plane_stress", "in space")),
    *((KINEMATIC, {"size": bad}, ("size is ", ": give ")) for bad in (0, "x")),
    *((KINEMATIC, {"seed": bad}, ("seed is ", ": give ")) for bad in (-1, [])),
]


@pytest.mark.parametrize(("law", "options", "words"), REFUSED)
def test_check_finds_what_does_not_fit(law, options, words):
    with rejected(*words):
        dm.materials.check(law, **options)


def test_check_says_where_the_values_differ():
    """Component, both values and the strain allow the user to repeat it by hand."""
    with pytest.raises(ValueError, match="the stress times D") as caught:
        dm.materials.check(DIFFERS)
    given, wanted = map(float, re.findall(r"is (\S+), but .* give (\S+),", str(caught.value))[0])
    assert wanted / given == pytest.approx(1.001, rel=1e-6)


def test_check_wants_numbers():
    """A Constant has one; a stress at the start has to be meant."""
    modulus = fem.Function(fem.functionspace(create_domain("triangle"), ("DG", 0)))
    dm.materials.check(dm.VonMises(fem.Constant(modulus.function_space.mesh, E), NU, Y, A))
    with rejected("VonMises: E = ", " depends on place", "dataclasses.replace"):
        dm.materials.check(dm.VonMises(modulus, NU, Y, A))
    assert dm.materials.check(Strained(3.0), initial_stress=True).energy_error < 1e-9


@pytest.mark.slow
def test_a_potential_that_is_not_convex_is_reported():
    """Along d at |d|^2 = s: E (2 - 6 s / 0.01^2); the largest modulus is 6 E, of the volume."""

    def energy(strain, state, p):
        d = ufl.dev(strain)
        size = ufl.inner(d, d)
        return p.E * (ufl.tr(strain) ** 2 + size - 0.5 * size**2 / 0.01**2)

    law = von_mises(energy=energy, state={}, updated_state=None)
    report = dm.materials.check(law, size=0.01)
    assert -4 / 6 < report.lowest < -0.1 and "not convex" in str(report)
    sound = dm.materials.check(law, size=0.002)
    assert sound.lowest > 0.0 and "convex" not in str(sound)
    perfect = dm.materials.check(replace(KINEMATIC, a=0.0))
    assert abs(perfect.lowest) < 1e-12 and "convex" not in str(perfect)


def test_an_unsymmetric_tangent_is_reported():
    def stress(strain, state, p):
        C = dm.Elastic.elastic_stress(strain, p)
        return C + 0.1 * p.E * strain[1, 1] * ufl.as_tensor([[1, 0, 0], [0, 0, 0], [0, 0, 0]])

    report = dm.materials.check(variant(stress=stress), rate_independent=False)
    assert report.skew > 1e-3 and "not symmetric" in str(report)

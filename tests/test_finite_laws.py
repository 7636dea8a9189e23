# SPDX-License-Identifier: MIT
"""Laws of the deformation gradient: closed forms, differences at large F, rotations."""

from dataclasses import dataclass
from functools import cache
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx_mortar.kernels import compile_vectors, constants
from dolfinx_mortar.materials.law_check import law_at_point
from dolfinx_mortar.materials.protocol import create_law
from dolfinx_mortar.materials.response import respond
from dolfinx_mortar.materials.tensor import GRADIENT
from dolfinx_mortar.solid import forms
from dolfinx_mortar.solid.forms import moduli_first
from tests.cases.pressed_blocks import rejected
from tests.cases.solid import create_displacement, create_domain
from tests.cases.user_laws import Unturned

NEO_HOOKE = dm.NeoHooke(200.0, 0.3)
MOONEY = dm.MooneyRivlin(0.293, 0.177, 14.0)
OGDEN = dm.Ogden(mu=(0.63, 0.0012, -0.01), alpha=(1.3, 5.0, -2.0), K=10.0)


@dataclass(frozen=True)
class Arrays(dm.materials.PointwiseLaw):
    """The neo-Hookean law by arrays; a user's."""

    E: float
    nu: float
    strain: ClassVar[str] = "finite"
    elastic_stress = staticmethod(dm.Elastic.elastic_stress)

    @staticmethod
    def moduli(p):
        return p.E / 2 / (1 + p.nu), p.E * p.nu / (1 + p.nu) / (1 - 2 * p.nu)

    @staticmethod
    def energy(F, state, p):
        (mu, lam), log_J = Arrays.moduli(p), np.log(np.linalg.det(F))
        return mu / 2 * (np.einsum("qij,qij->q", F, F) - 3 - 2 * log_J) + lam / 2 * log_J**2

    @staticmethod
    def update(F, state, p):
        mu, lam = (m[:, None, None] for m in Arrays.moduli(p))
        G, log_J = np.linalg.inv(F).transpose(0, 2, 1), np.log(np.linalg.det(F))[:, None, None]
        swap = (mu - lam * log_J)[..., None, None] * np.einsum("qil,qkj->qijkl", G, G)
        tangent = mu[..., None, None] * np.einsum("ik,jl->ijkl", np.eye(3), np.eye(3)) + swap
        tangent = tangent + lam[..., None, None] * np.einsum("qij,qkl->qijkl", G, G)
        return mu * (F - G) + lam * log_J * G, tangent, {}


@pytest.mark.parametrize("law", [NEO_HOOKE, MOONEY, OGDEN, Arrays(200.0, 0.3)], ids=repr)
def test_a_law_fits_its_energy_at_any_stretch(law):
    """Stretches from .3 to 3 and J from .3 to 3, pairs of them equal: differences to 1e-9."""
    found = dm.materials.check(law)
    assert found.energy_error < 1e-9 and found.tangent_error < 1e-9
    assert found.objectivity_error < 1e-12 and found.skew < 1e-12


def test_an_energy_that_sees_rotations_is_refused():
    with rejected("Unturned", "a rotation", "write psi in C = F^T F"):
        dm.materials.check(Unturned(1.0))


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


def test_a_stress_without_strain_is_refused_unless_meant():
    with rejected("Strained", "stress at F = I", "[[3.", "initial_stress=True"):
        dm.materials.check(Strained(3.0))
    found = dm.materials.check(Strained(3.0), initial_stress=True)
    assert found.energy_error < 1e-9


def test_an_energy_that_is_not_defined_in_small_volumes_is_refused():
    with rejected("Undefined gives NaN or infinity", "J = 0.3", "J > 0"):
        dm.materials.check(Undefined(1.0), initial_stress=True)


@dataclass(frozen=True)
class Off(Arrays):
    """With a tangent that is wrong by 1 percent."""

    @staticmethod
    def update(F, state, p):
        P, tangent, new = Arrays.update(F, state, p)
        return P, 1.01 * tangent, new


def test_a_wrong_tangent_is_found():
    with rejected("Off", "dP/dF"):
        dm.materials.check(Off(200.0, 0.3))


@cache
def compiled(law):
    """Return a law as function of F and its state, compiled once."""
    return law_at_point(law, create_law("law", law))


def stress_of(law, stretches):
    """Return P (3,) of principal stretches, as the law gives it, and the largest of the rest."""
    P = compiled(law)(np.diag(stretches), {}).stress
    return np.diag(P), np.abs(P - np.diag(np.diag(P))).max()


@pytest.mark.parametrize("l3", [0.6, 0.9, 1.7])
def test_stresses_in_closed_form(l3):
    """P_a = d psi / d lambda_a of the energies in principal stretches."""
    a = np.array([1.7, 0.9, l3])
    J, mean = a.prod(), (a**2).mean()
    mu, lam = 200 / 2.6, 60 / (1.3 * 0.4)
    neo = mu * (a - 1 / a) + lam * np.log(J) / a
    volume = (J - 1) * J / a
    second = (a**2).sum() * a**2 - a**4  # lambda_a dI2/d lambda_a / 2, without J
    I2 = ((a**2).sum() ** 2 - (a**4).sum()) / 2
    mooney = 2 * 0.293 * J ** (-2 / 3) * (a**2 - mean) / a
    mooney += 2 * 0.177 * J ** (-4 / 3) * (second - 2 * I2 / 3) / a + 14.0 * volume
    ogden = 10.0 * volume
    for m, alpha in zip(OGDEN.mu, OGDEN.alpha, strict=True):
        power = (a / np.cbrt(J)) ** alpha
        ogden = ogden + m * (power - power.mean()) / a
    for law, wanted in ((NEO_HOOKE, neo), (MOONEY, mooney), (OGDEN, ogden)):
        found, rest = stress_of(law, a)
        np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=1e-12 * abs(wanted).max())
        assert rest < 1e-13 * abs(wanted).max()


def test_one_law_by_another():
    """Ogden's with alpha = 2 and -2 is Mooney and Rivlin's, with mu = 2 C10 and -2 C01."""
    ogden = dm.Ogden(mu=(2 * 0.293, -2 * 0.177), alpha=(2.0, -2.0), K=14.0)
    F = np.eye(3) + 0.4 * np.random.default_rng(3).uniform(-1, 1, (3, 3))
    one, two = compiled(ogden)(F, {}), compiled(MOONEY)(F, {})
    assert np.allclose(one.stress, two.stress, rtol=1e-12)
    assert np.allclose(one.tangent, two.tangent, rtol=0, atol=1e-12 * abs(two.tangent).max())
    assert np.isclose(one.energy, two.energy, rtol=1e-12)


def test_arrays_are_not_called_inside_out():
    """A law of F has no value where det F < 0; ln det F would be NaN, and some laws say nothing."""
    u = create_displacement(create_domain("triangle"))
    solid = dm.Solid(u, Arrays(200.0, 0.3), strain="finite")
    u.interpolate(lambda x: np.stack([-2.0 * x[0], 0.0 * x[1]]))
    with rejected("Arrays", "is not called where det F is not positive", "-1"):
        solid.evaluate()


def test_parameters_that_make_no_rubber():
    with rejected("Ogden", "one length"):
        dm.Ogden(mu=(1.0,), alpha=(2.0, 3.0), K=1.0)
    with rejected("Ogden", "mu * alpha > 0"):
        dm.Ogden(mu=(1.0,), alpha=(-2.0,), K=1.0)
    with rejected("MooneyRivlin", "C10 + C01 > 0"):
        dm.MooneyRivlin(0.1, -0.2, 1.0)
    with rejected("NeoHooke", "nu"):
        dm.NeoHooke(1.0, 0.5)


def test_points_without_a_body():
    """Laws of arrays take no points, as ranks may have none."""
    p = SimpleNamespace(mu=(np.zeros(0),), alpha=(np.zeros(0),), K=np.zeros(0))
    P, A, _ = dm.Ogden.update(np.zeros((0, 3, 3)), {}, p)
    assert P.shape == (0, 3, 3) and A.shape == (0, 3, 3, 3, 3)


@pytest.mark.parametrize("d", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_moduli_times_a_direction_are_the_change_of_the_stress(d, rng):
    """dP/dF formed once at a point, from the upper triangle of its entries."""
    entries, count = GRADIENT[d], len(GRADIENT[d])
    numbers = constants(2 * count)

    def tensor(first: int) -> ufl.core.expr.Expr:
        rows = [[ufl.as_ufl(0.0)] * 3 for _ in range(3)]
        for k, (i, j) in enumerate(entries):
            rows[i][j] = numbers[first + k]
        return ufl.as_tensor(rows)

    p = SimpleNamespace(**vars(MOONEY))
    response = respond(create_law("law", MOONEY), tensor(0), {}, p)
    changes = [r.change(tensor(count)) for r in (response, moduli_first(response, entries))]
    kernels = compile_vectors([ufl.as_vector([c[e] for e in entries]) for c in changes])
    F = np.array([float(i == j) for i, j in entries]) + 0.2 * rng.standard_normal(count)
    direction = rng.standard_normal(count)
    one, other = (kernel(np.append(F, direction)) for kernel in kernels)
    assert np.abs(one).max() > 0.0 and np.abs(one - other).max() < 1e-13 * np.abs(one).max()


def test_moduli_come_first_of_laws_whose_energy_is_all_they_state(monkeypatch):
    """Their dP/dF is symmetric by itself; of a stated stress it may not be."""
    seen: list[int] = []

    def noted(response, entries):
        seen.append(len(entries))
        return moduli_first(response, entries)

    monkeypatch.setattr(forms, "moduli_first", noted)
    u = create_displacement(create_domain("triangle"))
    dm.Solid(u, MOONEY, strain="finite")
    assert seen == [len(GRADIENT[2])]
    for law in (OGDEN, NEO_HOOKE, dm.VonMises(200.0, 0.3, 1.0, 1.0)):
        dm.Solid(u, law, strain="finite")
    assert seen == [len(GRADIENT[2])]

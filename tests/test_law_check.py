# SPDX-License-Identifier: MIT
"""`materials.check` compares a user's law with finite differences and says where they differ."""

import re
from dataclasses import dataclass, make_dataclass, replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import dolfinx_mortar as dm
import ufl
from tests.cases.pointwise_laws import Radial
from tests.test_finite_laws import Arrays
from tests.test_user_laws import Isotropic, variant


def test_check_accepts_what_fits():
    """Of the laws here, the errors are those of finite differences."""
    report = dm.materials.check(Isotropic(1000.0, 0.3, 1.0, 100.0))
    assert report.changed > 10 and np.isnan(report.energy_error)
    assert report.tangent_error < 1e-8 and report.state_error < 1e-12 and report.skew < 1e-12
    assert "Isotropic: consistent at 4" in str(report)
    report = dm.materials.check(dm.VonMises(1000.0, 0.3, 1.0, 100.0))
    assert report.changed > 10 and report.energy_error < 1e-8
    assert "of the energy" in str(report)
    both = dm.materials.check(von_mises(stress=von_mises_stress))
    assert both.energy_error < 1e-8 and both.tangent_error < 1e-8


def test_check_survives_an_energy_that_cancels():
    """sqrt(1 + x) - 1 has few digits at small strains: no fault of the law."""

    def energy(strain, state, p):
        d = ufl.dev(strain)
        bend = ufl.sqrt(1 + ufl.inner(d, d) / 9e-6) - 1
        return p.E * (ufl.tr(strain) ** 2 + 9e-6 * bend)

    report = dm.materials.check(von_mises(energy=energy, state={}, updated_state=None))
    assert report.energy_error < 1e-5 and report.changed == 0


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


def von_mises(**changes):
    """Return a von Mises law with parts replaced."""
    names = ("linear", "elastic_stress", "updated_state", "energy")
    methods = {name: getattr(dm.VonMises, name) for name in names}
    methods |= {"state": {"plastic_strain": (3, 3)}} | changes
    methods = {name: part for name, part in methods.items() if part is not None}
    parts = {name: staticmethod(p) if callable(p) else p for name, p in methods.items()}
    fields = [(name, float) for name in ("E", "nu", "Y", "a")]
    law = make_dataclass("Slip", fields, namespace=parts, frozen=True)
    return law(1000.0, 0.3, 1.0, 100.0)


def von_mises_stress(strain, state, p):
    """Return the stress of the law in closed form."""
    ep = dm.VonMises.updated_state(strain, state, p)["plastic_strain"]
    return dm.Elastic.elastic_stress(strain - ep, p)


@pytest.mark.parametrize(
    "bad", [None, 0, -1, np.nan, "x", pytest.param(10**400, id="huge"), 1j, []]
)
def test_arguments_of_a_check(bad):
    for name in ("size", "seed"):
        if (name, bad) not in (("seed", 0), ("seed", 10**400)):
            with pytest.raises(ValueError, match=f"{name} is .*: give "):
                dm.materials.check(dm.Elastic(1000.0, 0.3), **{name: bad})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"stress": von_mises_stress, "energy": Slips.energy}, "the stress times D is .*, but "),
        ({"updated_state": Slips.slow}, "after a commit at the same strain it is"),
        ({"stress": Slips.skew}, "mirrored it is"),
        ({"linear": True}, "linear is True, but the tangent .*at zero strain it is"),
        ({"stress": Slips.root, "energy": None}, "gives NaN or infinity at strain"),
        ({"stress": Slips.start, "energy": None}, "the stress at zero strain is .*, not 0"),
    ],
)
def test_check_finds_what_does_not_fit(changes, message):
    with pytest.raises(ValueError, match=f"Slip.*{message}"):
        dm.materials.check(von_mises(**changes))


def test_check_says_where_the_values_differ():
    """Component, both values and the strain allow the user to repeat it by hand."""
    with pytest.raises(ValueError, match="the stress times D") as caught:
        dm.materials.check(von_mises(stress=von_mises_stress, energy=Slips.energy))
    given, wanted = map(float, re.findall(r"is (\S+), but .* give (\S+),", str(caught.value))[0])
    assert wanted / given == pytest.approx(1.001, rel=1e-6)


@pytest.mark.slow
def test_a_potential_that_is_not_convex_is_reported():
    """Softening: the energy bends down beyond a strain; by how much is known."""

    def energy(strain, state, p):
        d = ufl.dev(strain)
        size = ufl.inner(d, d)
        return p.E * (ufl.tr(strain) ** 2 + size - 0.5 * size**2 / 0.01**2)

    law = von_mises(energy=energy, state={}, updated_state=None)
    report = dm.materials.check(law, size=0.01)
    # along d at |d|^2 = s: E (2 - 6 s / 0.01^2), and the largest modulus is 6 E, of the volume
    assert -4 / 6 < report.lowest < -0.1 and "not convex" in str(report)
    report = dm.materials.check(law, size=0.002)
    assert report.lowest > 0.0 and "convex" not in str(report)
    for sound in (dm.VonMises(1000.0, 0.3, 1.0, 100.0), dm.Elastic(1000.0, 0.3)):
        assert dm.materials.check(sound).lowest > 0.0
    perfect = dm.materials.check(dm.VonMises(1000.0, 0.3, 1.0, 0.0))
    assert abs(perfect.lowest) < 1e-12 and "convex" not in str(perfect)


def test_an_unsymmetric_tangent_is_reported():
    def stress(strain, state, p):
        C = dm.Elastic.elastic_stress(strain, p)
        return C + 0.1 * p.E * strain[1, 1] * ufl.as_tensor([[1, 0, 0], [0, 0, 0], [0, 0, 0]])

    report = dm.materials.check(variant(stress=stress), rate_independent=False)
    assert report.skew > 1e-3 and "not symmetric" in str(report)


# A metal; how small the yield strain is must not matter to differences.
METAL = dm.VonMises(1e11, 0.49, 1e6, 1e3)


@pytest.mark.parametrize("nu", [0.3, METAL.nu])
def test_a_small_yield_strain_is_no_fault(nu):
    """Differences that go across a yield surface 1.5e-5 away said that the tangent was wrong."""
    found = dm.materials.check(replace(METAL, nu=nu), strain="finite")
    assert found.tangent_error < 1e-7 and found.energy_error < 1e-7
    assert found.samples >= 55  # of 59; without the shortest length it is refused, or 51


@pytest.mark.parametrize("where", ["everywhere", "in flow"])
def test_a_wrong_tangent_of_a_small_yield_strain_is_found(where):
    """By 1e-5 of the shear modulus, a fiftieth of the largest one."""

    @dataclass(frozen=True)
    class Off(dm.VonMises):
        @staticmethod
        def tangent(strain, state, p, direction):
            change = dm.VonMises.tangent(strain, state, p, direction)
            elastic = dm.Elastic.elastic_stress(direction, p)
            return change + 1e-5 * (change if where == "everywhere" else elastic - change)

    with pytest.raises(ValueError, match="Off: dP/dF"):
        dm.materials.check(Off(1e11, 0.49, 1e6, 1e3), strain="finite")


def test_a_tangent_that_is_wrong_after_flow_is_found():
    """It is right from the virgin state; from a plastic strain of .5 it is wrong by .1 %."""

    @dataclass(frozen=True)
    class Off(Radial):
        @staticmethod
        def update(strain, state, p):
            stress, tangent, new = Radial.update(strain, state, p)
            size = np.linalg.norm(state["plastic_strain"], axis=(1, 2))
            return stress, tangent * (1 + 2e-3 * size[:, None, None, None, None]), new

    with pytest.raises(ValueError, match=r"Off: dP/dF.*, plastic_strain = \[.*[1-9]"):
        dm.materials.check(Off(1000.0, 0.3, 1.0, 100.0), strain="finite")


def test_a_stress_with_noise_is_refused():
    """No difference tells anything about its tangent."""

    @dataclass(frozen=True)
    class Noisy(Arrays):
        @staticmethod
        def update(F, state, p):
            P, tangent, new = Arrays.update(F, state, p)
            noise = 1e-3 * np.sin(1e9 * (np.linalg.det(F) - 1))
            return (1 + noise[:, None, None]) * P, tangent, new

        energy = None

    with pytest.raises(ValueError, match=r"Noisy: differences .* disagree .* at .* of 30"):
        dm.materials.check(Noisy(200.0, 0.3))


@pytest.mark.slow
@settings(max_examples=8, deadline=None)
@given(
    kind=st.sampled_from(["kinematic", "isotropic", "voce", "cone"]),
    log_ratio=st.floats(1.5, 6.0),
    nu=st.sampled_from([0.0, 0.3, 0.49, 0.4999]),
    seed=st.integers(0, 10**6),
)
@example(kind="kinematic", log_ratio=6.0, nu=0.4999, seed=1)
def test_yield_strains_of_any_size(kind, log_ratio, nu, seed):
    """E / Y from 30 to 1e6; hardly a sample is on a kink, and left out."""
    E = 10.0**log_ratio
    law = {
        "kinematic": lambda: dm.VonMises(E, nu, 1.0, 1e-3 * E),
        "isotropic": lambda: dm.VonMises(E, nu, 1.0, 0.0, 1e-3 * E),
        "voce": lambda: dm.VonMisesVoce(E, nu, 1.0, 0.0, 1e-3 * E, 0.5, 20.0),
        "cone": lambda: dm.DruckerPrager(E, nu, 1.0, 0.4),
    }[kind]()
    assert dm.materials.check(law, strain="finite", seed=seed).samples > 26
    assert dm.materials.check(law, seed=seed).tangent_error < 1e-5

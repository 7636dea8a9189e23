# SPDX-License-Identifier: MIT
"""Every number of laws, solids and closed solutions, halved and doubled: the answer stays the same.

And by an absurd factor it changes, or something breaks: the comparison sees the number.
"""

import functools
import importlib
import re
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import mesh
from dolfinx_mortar import analytic
from dolfinx_mortar.common.kernels import compile_kernel, constants, tabulate
from dolfinx_mortar.materials import law_check
from dolfinx_mortar.materials.law_check import law_at_point
from dolfinx_mortar.materials.plasticity import wright_omega
from dolfinx_mortar.materials.protocol import create_law
from dolfinx_mortar.materials.response import values_at_points
from dolfinx_mortar.solid.kinematics import axisymmetric, on_axis
from tests.cases.pointwise_laws import UNIT, Radial
from tests.test_law_check import Slips, von_mises, von_mises_stress
from tests.test_numbers_of_steps import numbers_in
from tests.test_user_laws import Isotropic

PACKAGE = Path(dm.__file__).parent
# Number -> absurd factors, each of which must show.
NUMBERS = {
    "materials.plasticity": {"YIELD_TOLERANCE": (1e-10, 1e9)},
    "materials.law_check": {
        **{"PATHS": (0,), "RTOL": (1e-10, 1e5)},
        **{"LENGTHS": (1e-8, 1e9), "SIZES": (1e-6,)},
    },
    "analytic": {"EDGE": (1e-6, 11.0)},
}
# Of another module: the same.
SHARED = {
    "analytic": {"HALF_OF_DIGITS": (1e8,)},  # without it polyfit warns
    # a smaller one costs an iteration
    "materials.response": {"HALF_OF_DIGITS": (1e7,), "LIMIT": (0.02,)},
    "materials.plasticity": {"EPS": (0.0, 1e14), "SERIES_BELOW": (0.01, 100.0)},
    "solid.kinematics": {"ROUND_OFF": (0.0, 2e13)},
}
TABLES = {"COMPONENTS", "INDEX", "TURNS", "UNTAGGED"}  # how tensors are stored, and a mark
TABLES |= {"NORMAL", "_POSITIVE"}  # the tensor of a strain out of the plane, a range
TABLES |= {"DEPTHS", "RADII"}  # ranges
TABLES |= {"HIGHEST_RULE", "ROUND"}  # what is refused, in test_errors and test_analytic
TABLES |= {"ANYWHERE", "_CORNERS", "GRADIENT"}  # a point and a cell, how gradients are stored
TABLES |= {"FINITE_RTOL", "STRETCHES", "VOLUMES", "WEIGHTS"}  # in test_law_check
# In their own tests: test_law_check, test_logarithmic_laws.
OTHERS = {"materials.logarithmic", "materials.logarithms"}
STEEL = dm.VonMises(E=206_900.0, nu=0.29, Y=450 * np.sqrt(2 / 3), a=10_000.0)
pytestmark = pytest.mark.serial


def test_no_number_is_left_out():
    for file in [
        PACKAGE / "analytic.py",
        *PACKAGE.glob("materials/*.py"),
        *PACKAGE.glob("solid/*.py"),
    ]:
        module = ".".join(file.relative_to(PACKAGE).with_suffix("").parts)
        if module not in OTHERS:
            assert set(numbers_in(file)) - TABLES == set(NUMBERS.get(module, ())), module


def observe_law():
    """Return a path beyond yield: what the law gives, and whether it gives it again."""
    law, rng = law_at_point(STEEL, create_law("law", STEEL)), np.random.default_rng(3)
    strain, state, numbers = np.zeros((3, 3)), {"plastic_strain": np.zeros((1, 3, 3))}, []
    for size in np.repeat([0.0, 1e-4, 1e-3, 3e-3, 1e-2], [1, 4, 20, 20, 20]):
        step, direction = rng.standard_normal((2, 3, 3))
        strain = strain + size * (step + step.T) / 2
        point = law(strain, state)
        state = point.state
        again = law(strain, state).state["plastic_strain"]
        change = np.tensordot(point.tangent[0], direction) / STEEL.E
        flows = float((again != state["plastic_strain"]).any())
        energy = point.energy[0] * STEEL.E / STEEL.Y**2
        tensors = point.stress[0] / STEEL.Y, change, state["plastic_strain"][0]
        numbers += [*np.ravel(tensors), energy, flows]
    assert np.any(state["plastic_strain"])
    return numbers


@dataclass(frozen=True)
class Grown(dm.materials.PointwiseLaw):
    """Springs of stiffness 0.1 and 0.2 about a committed growth, whose sums are not exact."""

    state: ClassVar = {"growth": (3, 3)}

    @staticmethod
    def elastic_stress(strain, p):
        return 0.3 * strain

    @staticmethod
    def update(strain, state, p):
        stress = 0.1 * strain + 0.2 * strain - 0.3 * state["growth"]
        return stress, np.broadcast_to(0.3 * UNIT, (len(strain), 3, 3, 3, 3)), state


def observe_plane_stress():
    """Return stresses in the plane, elastic and plastic, and of strains that leave no stress."""
    law, q, rng = Radial(1000.0, 0.3, 1.0, 50.0), 60, np.random.default_rng(5)
    strain = 6e-4 * rng.standard_normal((q, 3, 3))
    strain += np.swapaxes(strain, 1, 2)
    p = {name: np.full(q, getattr(law, name)) for name in ("E", "nu", "Y", "a")}
    kind, state = create_law("law", law, plane_stress=True), {"plastic_strain": 0.0 * strain}
    found = values_at_points(kind, strain, state, p)
    assert 10 < found.state["plastic_strain"].any(axis=(1, 2)).sum() < q - 10
    kind, state = create_law("law", Grown(), plane_stress=True), {"growth": strain}
    free = values_at_points(kind, strain, state, {})
    assert 0.0 < np.abs(free.stress).max() < 1e-18
    parts = found.stress, found.state["plastic_strain"], found.tangent / 1000.0, free.stress
    return [value for part in parts for value in part.ravel()]


def observe_omega():
    """Return omega, relative to its series, where a double of exp(y) is one and where it is not."""
    y = constants(1)
    kernel = compile_kernel(ufl.as_vector([wright_omega(y[0])]))
    below, at = [-1e3, -700.0, -80.0, -20.0, -9.0], [-2.0, -0.6, 0.0, 1.0, 30.0]
    omega = tabulate(kernel, np.array([below + at]).T)[:, 0]
    return [*omega[:5] / np.exp(np.maximum(below, -700.0)), *omega[5:]]


@functools.cache
def compiled(law, kind, strain):
    """Return a compiled law, kept: the numbers of the check are not in the code."""
    return law_at_point(law, kind, strain)


@functools.cache
def laws():
    """Return laws that fit, then such that do not."""
    wrong = (
        {"stress": von_mises_stress, "energy": Slips.energy},
        {"updated_state": Slips.slow},
        {"stress": Slips.skew},
        {"linear": True},
    )
    good = (dm.VonMises(1000.0, 0.3, 1.0, 100.0), Isotropic(1000.0, 0.3, 1.0, 100.0))
    return (*good, *(von_mises(**changes) for changes in wrong))


def observe_check():
    """Return for each law whether it is said to fit, or what is said not to."""
    verdicts = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(law_check, "law_at_point", compiled)
        for law in laws():
            try:
                verdicts.append("not symmetric" in str(dm.materials.check(law)))
            except ValueError as error:
                verdicts.append(re.search("differences|mirrored|commit|zero|$", str(error)).group())
    return verdicts


def observe_fit():
    """Return fits: without the edge, to two distances that differ by round-off, and to two."""
    x = np.linspace(-0.49, 0.49, 29)
    p = 10 * np.sqrt(1 - (x / 0.5) ** 2)
    p[[0, -1]] *= 2
    cases = [(x, p), ([0.3, 0.1 * 3], [2.0, 1.0]), ([0.3, 0.6], [2.0, 1.0])]
    return [number for case in cases for number in analytic.fit_pressure(*case)]


def observe_axis():
    """Return which nodes lie on the axis: of some r is round-off, of some a thousandth."""
    domain = mesh.create_unit_square(MPI.COMM_SELF, 2, 6)
    r = domain.geometry.x[:, 0]
    r[r == 0.0] = [0.0, 1e-17, -1e-17, 1e-16, -1e-16, 1e-3, 2e-3]
    return [float(on) for on in on_axis(axisymmetric, domain, domain.geometry.x)]


OBSERVE = {
    "solid.kinematics": observe_axis,
    "materials.plasticity": lambda: [*observe_omega(), *observe_law()],
    "materials.law_check": observe_check,
    "materials.response": observe_plane_stress,
    "analytic": observe_fit,
}


@functools.cache
def usual(module):
    return OBSERVE[module]()


def same(module, name, factor):
    """Tell whether a user would see the same with the number times a factor."""
    expected, where = usual(module), importlib.import_module(f"dolfinx_mortar.{module}")
    value = getattr(where, name)
    scaled = tuple(factor * v for v in value) if isinstance(value, tuple) else factor * value
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(where, name, round(scaled) if isinstance(value, int) else scaled)
        try:
            found = OBSERVE[module]()
        except ValueError:
            return False
    if module == "materials.law_check":
        return found == expected
    return bool(np.allclose(found, expected, rtol=1e-9, atol=1e-12, equal_nan=True))


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.5, 2.0])
@pytest.mark.parametrize(
    ("module", "name"),
    [(module, name) for of in (NUMBERS, SHARED) for module, names in of.items() for name in names],
)
def test_half_and_double(module, name, factor):
    assert same(module, name, factor)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("module", "name", "factor"),
    [
        (m, name, f)
        for of in (NUMBERS, SHARED)
        for m, names in of.items()
        for name, absurd in names.items()
        for f in absurd
    ],
)
def test_an_absurd_factor_shows(module, name, factor):
    assert not same(module, name, factor)

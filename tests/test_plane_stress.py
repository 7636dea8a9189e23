# SPDX-License-Identifier: MIT
"""Plane stress: the spatial law with the strain out of the plane that leaves no stress there."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from material_point import MaterialPoint
from scipy.optimize import brentq

import dolfinx_mortar as dm
from tests.pressed_blocks import PressedBlocks, rejected
from tests.solid_case import create_displacement, create_domain

E, NU, Y = 206_900.0, 0.29, 367.0
LAWS = {
    "perfect": dm.VonMises(E, NU, Y, 0.0),
    "kinematic": dm.VonMises(E, NU, Y, 10_000.0),
    "mixed": dm.VonMises(E, NU, Y, 10_000.0, 5_000.0),
}
_POINTS: dict[tuple[str, int], MaterialPoint] = {}


def point(name: str, d: int) -> MaterialPoint:
    """Return a virgin point of a law, in plane stress (d = 2) or in space."""
    if (name, d) not in _POINTS:
        kinematics = "plane_stress" if d == 2 else None
        _POINTS[name, d] = MaterialPoint(LAWS[name], d, kinematics)
    _POINTS[name, d].reset()
    return _POINTS[name, d]


def in_plane(rng: np.random.Generator) -> np.ndarray:
    """Return a random symmetric tensor with zeros out of the plane."""
    tensor = np.zeros((3, 3))
    tensor[:2, :2] = rng.standard_normal((2, 2))
    return (tensor + tensor.T) / 2


def free(space: MaterialPoint, strain: np.ndarray) -> np.ndarray:
    """Return the strain with the component out of the plane that leaves no stress there."""

    def stress(zz: float) -> float:
        return space.stress(strain + np.diag([0.0, 0.0, zz]))[2, 2]

    width = 3 * np.abs(strain).max() + 0.1
    return strain + np.diag([0.0, 0.0, brentq(stress, -width, width, xtol=1e-16, rtol=1e-15)])


def compare(flat: MaterialPoint, space: MaterialPoint, path: list, scale: float) -> int:
    """Walk a path with both and return in how many steps the plastic strain has changed."""
    before, flowed = np.zeros((3, 3)), 0
    for strain in path:
        found = flat.stress(strain)
        expected = space.stress(free(space, strain))
        assert (found[2] == 0.0).all() and (found[:, 2] == 0.0).all()
        assert np.abs(found - expected).max() < 1e-9 * scale
        now = flat.commit()
        assert np.abs(now - space.commit()).max() < 1e-9 * np.abs(strain).max()
        assert abs(np.trace(now)) < 1e-15 * (1 + np.abs(now).max())
        flowed += not np.array_equal(now, before)
        flat.stress(strain)
        assert np.array_equal(flat.commit(), now)
        before = now
    return flowed


@pytest.mark.parametrize("name", LAWS)
def test_plane_stress_is_the_spatial_law_without_stress_out_of_the_plane(name, rng):
    """On a random path with commits, against a root of the spatial law's sigma_zz."""
    path = np.cumsum([5e-3 * in_plane(rng) for _ in range(8)], axis=0)
    flat, space = point(name, 2), point(name, 3)
    assert compare(flat, space, list(path), Y) > 5
    if name == "mixed":
        k = [p.solid.fields.values("accumulated_plastic_strain")[0, 0] for p in (flat, space)]
        assert k[0] == pytest.approx(k[1], rel=1e-9) and k[0] > 1e-2


@settings(max_examples=30)
@given(
    st.floats(-0.45, 0.495),
    st.tuples(st.floats(-4, 2), st.floats(-4, 2)),
    st.floats(0.3, 100.0),
    st.integers(0, 2**32 - 1),
)
def test_any_parameters(nu, powers, size, seed):
    """Poisson's ratios, hardening from none to stiffer than the body, strains far beyond yield."""
    E, Y = 1000.0, 1.0
    values = [E, nu, Y, *(E * 10.0**power for power in powers)]
    flat, space = point("mixed", 2), point("mixed", 3)
    for p in (flat, space):
        p.solid.regions[0].parameters.function.x.array.reshape(-1, 5)[:] = values
    try:
        path = np.cumsum([size * Y / E * in_plane(np.random.default_rng(seed)) for _ in "abc"], 0)
        compare(flat, space, list(path), Y + (values[3] + values[4]) * np.abs(path).max())
    finally:
        mixed = LAWS["mixed"]
        for p in (flat, space):
            table = p.solid.regions[0].parameters.function.x.array.reshape(-1, 5)
            table[:] = [mixed.E, mixed.nu, mixed.Y, mixed.a, mixed.H]


@pytest.mark.parametrize("law", [dm.Elastic(1000.0, 0.3), *LAWS.values()], ids=["elastic", *LAWS])
def test_check_accepts_the_laws(law):
    report = dm.materials.check(law, plane_stress=True)
    assert report.energy_error < 1e-8 and report.tangent_error < 1e-8
    assert report.skew < 1e-12 and report.state_error < 1e-12
    assert report.changed > 10 or type(law) is dm.Elastic


def test_a_bar_is_as_stiff_as_its_modulus():
    """Stretched with free sides, elastic: sigma = E eps, to round-off."""
    p = MaterialPoint(dm.Elastic(1000.0, 0.3), 2, "plane_stress")
    stress = p.stress(np.diag([1e-3, -3e-4, 0.0]))
    assert np.allclose(stress, np.diag([1.0, 0.0, 0.0]), atol=1e-15)


@pytest.mark.mpi
def test_a_heated_plate():
    """Free it has no stress, held E alpha dT / (1 - nu), and nothing out of the plane."""
    solid = dm.Solid(
        create_displacement(create_domain("triangle")),
        dm.Elastic(1000.0, 0.3),
        kinematics="plane_stress",
        eigenstrain=1e-3,
    )
    solid.evaluate()
    held = -1000.0 * 1e-3 / 0.7
    assert solid.fields.values("stress_xx") == pytest.approx(held, rel=1e-12)
    assert solid.fields.values("stress_yy") == pytest.approx(held, rel=1e-12)
    assert (solid.fields.values("stress_zz") == 0.0).all()
    solid.u.interpolate(lambda x: 1e-3 * x[:2])
    solid.evaluate()
    assert solid.max("von_mises") < 1e-12


@pytest.mark.mpi
def test_wrong_combinations_are_refused():
    flat, space = (create_displacement(create_domain(c)) for c in ("triangle", "tetrahedron"))
    with rejected("plane_stress", "for meshes in 2D"):
        dm.Solid(space, dm.Elastic(1.0, 0.3), kinematics="plane_stress")
    for law in (
        dm.VonMisesVoce(1.0, 0.3, 1.0, 0.0, 0.0, 1.0, 1.0),
        dm.DruckerPrager(1.0, 0.3, 1.0, 1.0),
    ):
        with rejected(type(law).__name__, "does not know plane stress; Elastic, VonMises do"):
            dm.Solid(flat, law, kinematics="plane_stress")
        with rejected("does not know plane stress"):
            dm.materials.check(law, plane_stress=True)


@pytest.mark.mpi
@pytest.mark.parametrize("name", LAWS)
def test_pressed_plates(name):
    """Contact of plates that flow converges, without stress out of the plane."""
    case = PressedBlocks()
    law = LAWS[name]
    solid = dm.Solid(case.u, law, kinematics="plane_stress")
    case.top.value[1] = -0.01
    problem = dm.ContactProblem(solid, [case.contact()], bcs=case.bcs())
    report = dm.newton(problem)
    assert report.converged and solid.max("plastic_strain_norm") > 1e-4
    assert solid.max("stress_zz") == 0.0
    stiff = dm.Solid(case.u, law)
    stiff.evaluate()
    assert stiff.max("stress_zz") != 0.0

# SPDX-License-Identifier: MIT
"""Plane stress: the spatial law with the strain out of the plane that leaves no stress there."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.optimize import brentq

import dolfinx_mortar as dm
from dolfinx_mortar.materials import response
from dolfinx_mortar.materials.protocol import create_law
from tests.cases.material_point import MaterialPoint
from tests.cases.pointwise_laws import Radial
from tests.cases.pressed_blocks import rejected
from tests.cases.solid import create_displacement, create_domain
from tests.cases.user_laws import Slack
from tests.choice import quick

E, NU, Y = 206_900.0, 0.29, 367.0
HARDENING = {
    "perfect": dm.VonMises(E, NU, Y, 0.0),
    "kinematic": dm.VonMises(E, NU, Y, 10_000.0),
    "mixed": dm.VonMises(E, NU, Y, 10_000.0, 5_000.0),
}
# A law by its energy, with a stated tangent, in arrays, and with an apex.
LAWS = HARDENING | {
    "stated": dm.VonMisesVoce(E, NU, Y, 10_000.0, 500.0, 200.0, 20.0),
    "arrays": Radial(E, NU, Y, 10_000.0),
    "cone": dm.DruckerPrager(E, NU, Y, 0.3),
}


@dataclass(frozen=True)
class Other(dm.VonMises):
    """A law with an energy of its own, for which the tangent that it inherits is not right."""

    energy = staticmethod(dm.VonMises.energy)


LAWS |= {"other": Other(E, NU, Y, 10_000.0, 5_000.0)}
_POINTS = {}


def point(name, d):
    if (name, d) not in _POINTS:
        kinematics = "plane_stress" if d == 2 else None
        _POINTS[name, d] = MaterialPoint(LAWS[name], d, kinematics)
    _POINTS[name, d].reset()
    return _POINTS[name, d]


def in_plane(rng):
    """Return a random symmetric tensor with zeros out of the plane."""
    tensor = np.zeros((3, 3))
    tensor[:2, :2] = rng.standard_normal((2, 2))
    return (tensor + tensor.T) / 2


def free(space, strain):
    """Return the strain with the component out of the plane that leaves no stress there."""

    def stress(zz):
        return space.stress(strain + np.diag([0.0, 0.0, zz]))[2, 2]

    width = 3 * np.abs(strain).max() + 0.1
    return strain + np.diag([0.0, 0.0, brentq(stress, -width, width, xtol=1e-16, rtol=1e-15)])


def compare(flat, space, path, scale):
    """Walk a path with both and return in how many steps the plastic strain has changed."""
    before, flowed = np.zeros((3, 3)), 0
    for strain in path:
        found = flat.stress(strain)
        expected = space.stress(free(space, strain))
        assert (found[2] == 0.0).all() and (found[:, 2] == 0.0).all()
        assert np.abs(found - expected).max() < 1e-9 * scale
        now = flat.commit()
        assert np.abs(now - space.commit()).max() < 1e-9 * np.abs(strain).max()
        flowed += not np.array_equal(now, before)
        flat.stress(strain)
        assert np.array_equal(flat.commit(), now)
        before = now
    return flowed


@pytest.mark.parametrize("name", quick(LAWS, "perfect", "mixed", "other", "cone", "arrays"))
def test_plane_stress_is_the_spatial_law_without_stress_out_of_the_plane(name, rng):
    """On a random path with commits, against a root of the spatial law's sigma_zz."""
    path = np.cumsum([5e-3 * in_plane(rng) for _ in range(8)], axis=0)
    flat, space = point(name, 2), point(name, 3)
    assert compare(flat, space, list(path), Y) > 5
    if name in HARDENING:
        plastic = flat.commit()
        assert abs(np.trace(plastic)) < 1e-15 * (1 + np.abs(plastic).max())
    material = create_law("law", LAWS[name])
    assert (material.tangent is not None) == (name in (*HARDENING, "stated"))
    if name == "mixed":
        k = [p.solid.fields.values("accumulated_plastic_strain")[0, 0] for p in (flat, space)]
        assert k[0] == pytest.approx(k[1], rel=1e-9) and k[0] > 1e-2


TIMBER = dm.Orthotropic(11e3, 600.0, 900.0, 0.4, 0.3, 0.3, 700.0, 800.0, 70.0, yaw=0.4)


def test_linear_laws_are_condensed_in_the_compiled_code(rng):
    """The same compliance in the plane, no unknown at points, and a constant tangent."""
    flat, space = MaterialPoint(TIMBER, 2, "plane_stress"), MaterialPoint(TIMBER)
    strain = 1e-3 * in_plane(rng)
    expected = space.stress(free(space, strain))
    assert np.abs(flat.stress(strain) - expected).max() < 1e-12 * np.abs(expected).max()
    assert flat.solid.linear


@pytest.mark.parametrize("nu", [-1 + 1e-9, -0.9, -0.5, 0.0, 0.49, 0.5 - 1e-7])
@pytest.mark.parametrize("size", [0.9, 3.0, 1e4])
def test_the_whole_range_of_ratios(nu, size, rng):
    """No stress out of the plane, the residual being checked: flow and yield surface say so."""
    flat = point("mixed", 2)
    table = flat.solid.regions[0].function.x.array.reshape(-1, 5)
    values = table[0].copy()
    table[:] = [1000.0, nu, 1.0, 0.0, 50.0]
    try:
        strain = size / 1000.0 * in_plane(rng)
        stress, ep = flat.stress(strain), flat.commit()
        k = flat.solid.fields.values("accumulated_plastic_strain")[0, 0]
        elastic = ((1 + nu) * stress - nu * np.trace(stress) * np.eye(3)) / 1000.0
        found = (elastic + ep)[:2, :2]  # by Hooke's law of a stress in the plane
        ratio = (1 + nu) / (1 - 2 * nu)  # 3 K / 2 mu
        condition = max(ratio, 1 / ratio)
        error = np.abs(found - strain[:2, :2]).max()
        assert error < (1e-12 + 1e-14 * condition) * np.abs(strain).max()
        deviator = stress - np.trace(stress) / 3 * np.eye(3)
        radius = 1.0 + 50.0 * k
        assert np.linalg.norm(deviator) <= radius * (1 + 1e-9 + 1e-14 * condition)
        assert k == 0.0 or np.linalg.norm(deviator) == pytest.approx(
            radius, rel=1e-9 + 1e-14 * condition
        )
    finally:
        table[:] = values


@pytest.mark.mpi
def test_a_law_that_always_pulls_is_an_error_on_all_ranks():
    """No strain out of the plane leaves no stress: that is noticed, not a number."""
    u = create_displacement(create_domain("triangle"))
    solid = dm.Solid(u, Slack(1e3), kinematics="plane_stress")
    after = f"after {response.LIMIT} iter"
    for ask in (solid.evaluate, solid.element_force_norm):
        with rejected("Slack", "no strain out of the plane was found", after):
            ask()

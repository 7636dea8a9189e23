# SPDX-License-Identifier: MIT
"""Orthotropic elasticity: tension tests along its axes, turned axes, and what has no energy."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import dolfinx_mortar as dm
from dolfinx import default_scalar_type, fem
from tests.cases.material_point import MaterialPoint
from tests.cases.solid import create_displacement, create_domain, total

WOOD = {
    **{"E1": 12_000.0, "E2": 900.0, "E3": 500.0},
    **{"nu12": 0.4, "nu13": 0.45, "nu23": 0.6, "G12": 700.0, "G13": 650.0, "G23": 60.0},
}
POINT = MaterialPoint(dm.Orthotropic(**WOOD))
NAMES = [*WOOD, "yaw", "pitch", "roll"]


def compliance(stress, w):
    """Return the strain of a stress in the axes of the material."""
    a, b, c = np.diag(stress)
    strain = np.diag(
        [
            (a - w["nu12"] * b - w["nu13"] * c) / w["E1"],
            -w["nu12"] / w["E1"] * a + b / w["E2"] - w["nu23"] / w["E2"] * c,
            -w["nu13"] / w["E1"] * a - w["nu23"] / w["E2"] * b + c / w["E3"],
        ]
    )
    for i, j, name in ((0, 1, "G12"), (0, 2, "G13"), (1, 2, "G23")):
        strain[i, j] = strain[j, i] = stress[i, j] / (2 * w[name])
    return strain


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1))
def test_stress_undoes_the_compliance_in_any_axes(seed):
    """The strain of Hooke's compliance gives back its stress, turned with the material."""
    rng = np.random.default_rng(seed)
    angles = rng.uniform(-4, 4, 3)
    values = {**WOOD, **dict(zip(NAMES[9:], angles, strict=True))}
    POINT.solid.regions[0].parameters.function.x.array.reshape(-1, 12)[:] = list(values.values())
    R = Rotation.from_euler("ZYX", angles).as_matrix()  # yaw, then about new axes
    stress = rng.standard_normal((3, 3))
    stress = stress + stress.T
    found = POINT.stress(R @ compliance(stress, WOOD) @ R.T)
    assert np.abs(found - R @ stress @ R.T).max() < 1e-10


def test_isotropic_numbers_give_hooke(rng):
    E, nu = 1000.0, 0.3
    G = E / (2 * (1 + nu))
    law = dm.Orthotropic(E, E, E, nu, nu, nu, G, G, G, 0.3, 0.2, 0.1)
    point, hooke = MaterialPoint(law), MaterialPoint(dm.Elastic(E, nu))
    strain = rng.standard_normal((3, 3))
    strain = strain + strain.T
    assert np.abs(point.stress(strain) - hooke.stress(strain)).max() < 1e-9
    report = dm.materials.check(law)
    assert report.tangent_error < 1e-8 and report.energy_error < 1e-8 and report.skew < 1e-12


@pytest.mark.mpi
def test_fibres_that_turn_from_place_to_place():
    """Stretched along the fibres everywhere a ring is stiff: the angle is an expression of x."""
    domain = create_domain("triangle", 12)
    law = dm.Orthotropic(**WOOD, yaw=fem.Constant(domain, default_scalar_type(0.0)))
    solid = dm.Solid(create_displacement(domain), law)
    solid.u.interpolate(lambda x: np.stack([1e-3 * x[0], 0 * x[0]]))
    along = total(solid.energy())
    law.yaw.value = math.pi / 2
    across = total(solid.energy())
    law.yaw.value = math.pi
    assert total(solid.energy()) == pytest.approx(along, rel=1e-12)
    assert solid.points.follows and along > 10 * across


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"E1": 0.0}, "E1 is 0.0: give a finite number"),
        ({"G23": -1.0}, "G23 is -1.0: give a finite number"),
        ({"nu12": math.inf}, "nu12 is inf: give"),
        ({"nu12": 3.7}, r"nu12\^2 < E1 / E2 does not hold for E1 = 12000.0, .*nu12 = 3.7"),
        ({"nu13": -5.0}, r"nu13\^2 < E1 / E3 does not hold"),
        ({"nu23": 1.4}, r"nu23\^2 < E2 / E3 does not hold"),
        ({"nu12": 2.6, "nu23": 0.9}, r"2 nu12 nu23 nu13 E3 / E1 < 1 does not hold"),
    ],
)
def test_moduli_without_a_positive_energy_are_refused(change, message):
    with pytest.raises(ValueError, match=f"Orthotropic: .*{message}"):
        dm.Orthotropic(**(WOOD | change))


@pytest.mark.mpi
def test_in_one_cell_of_a_function():
    domain = create_domain("triangle")
    nu = fem.Function(fem.functionspace(domain, ("DG", 0)))
    nu.x.array[:] = 0.4
    if domain.comm.rank == domain.comm.size - 1:
        nu.x.array[0] = 3.7
    with pytest.raises(ValueError, match=r"nu12\^2 < E1 / E2 does not hold in 1 cells.*is 3.7"):
        dm.Solid(create_displacement(domain), dm.Orthotropic(**(WOOD | {"nu12": nu})))

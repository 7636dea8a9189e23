# SPDX-License-Identifier: MIT
"""Each law in contact: Newton's method converges, quadratically at the end, in and out of yield."""

from petsc4py import PETSc

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from tests.cases.meshes import LOWER, UPPER
from tests.cases.pointwise_laws import Compiled
from tests.cases.pressed_blocks import PressedBlocks
from tests.cases.solid import (
    create_displacement,
    create_domain,
    create_tags,
    residual,
    set_wave,
)
from tests.choice import quick

E, NU = 1000.0, 0.3
G = E / (2 * (1 + NU))
LAWS = {
    "mixed": dm.VonMises(E, NU, 1.0, 20.0, 50.0),
    "voce": dm.VonMisesVoce(E, NU, 1.0, 20.0, 10.0, 1.0, 100.0),
    "drucker-prager": dm.DruckerPrager(E, NU, 3.0, 0.3),
    "orthotropic": dm.Orthotropic(E, 2 * E, E, 0.2, 0.3, 0.2, G, G, G, yaw=0.4),
}


@pytest.mark.mpi
@pytest.mark.parametrize("name", quick(LAWS, "drucker-prager"))
def test_pressed_blocks(name):
    """The law in one block, elastic in the other: pressed in three steps, and let go."""
    case = PressedBlocks()
    law = LAWS[name]
    solid = dm.Solid(case.u, {LOWER: law, UPPER: dm.Elastic(E, NU)}, case.cells)
    problem = dm.ContactProblem(solid, [case.contact()], bcs=case.bcs(), geometry="reference")
    forces = []
    for depth in (0.004, 0.008, 0.012, 0.008):
        case.top.value[1] = -depth
        report = dm.newton(problem, rtol=1e-10)
        problem.commit()
        assert report.converged and report.newton_iterations <= 12
        forces.append(abs(problem.contacts[0].force[1]))
    assert forces[0] < forces[1] < forces[2] > forces[3] > 0.0
    if name != "orthotropic":
        assert solid.max("plastic_strain_norm") > 1e-4


@pytest.mark.parametrize("volumetric", ["full", pytest.param("reduced", marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", quick(LAWS, "drucker-prager"))
@pytest.mark.parametrize(
    "cell", ["quadrilateral", pytest.param("hexahedron", marks=pytest.mark.slow)]
)
def test_tangent_by_differences(name, cell, volumetric):
    """K w against differences of F, after a plastic step, also with one dilatation per cell."""
    if volumetric == "reduced" and not getattr(type(LAWS[name]), "splits", False):
        with pytest.raises(ValueError, match="does not declare splits"):
            dm.Solid(create_displacement(create_domain(cell, 3)), LAWS[name], volumetric="reduced")
        return
    solid = dm.Solid(create_displacement(create_domain(cell, 3)), LAWS[name], volumetric=volumetric)
    set_wave(solid.u, 4e-3)
    solid.evaluate()
    solid.commit()
    set_wave(solid.u, 4e-3, 0.8)
    K = solid.create_matrix()
    solid.assemble_tangent(K)
    u, w = solid.u.x.array.copy(), fem.Function(solid.u.function_space)
    w.x.array[:] = np.random.default_rng(1).standard_normal(len(u))
    w.x.scatter_forward()
    x, y = K.createVecs()
    x.array[:] = w.x.array[: x.local_size]
    K.mult(x, y)
    forces = []
    for sign in (1, -1):
        solid.u.x.array[:] = u + sign * 1e-8 * w.x.array
        forces.append(residual(solid))
    scale = y.norm(PETSc.NormType.INFINITY)
    y.array[:] -= (forces[0] - forces[1]) / 2e-8
    assert y.norm(PETSc.NormType.INFINITY) < 1e-5 * scale


def test_plane_stress_has_no_volume_to_reduce():
    u = create_displacement(create_domain("quadrilateral"))
    for law in (dm.Elastic(E, NU), LAWS["mixed"], dm.VonMises(E, NU, 1.0, 0.0)):
        with pytest.raises(ValueError, match="not for 'plane stress': choose 'full'"):
            dm.Solid(u, law, kinematics="plane_stress", volumetric="reduced")


@pytest.mark.mpi
@pytest.mark.slow
@pytest.mark.parametrize("degree", [1, 2])
def test_all_laws_in_one_solid(degree):
    """Forces are the sum over the stripes, each with its law beside the same soft neighbours."""
    domain = create_domain("triangle", 10 // degree)
    laws = [*LAWS.values(), dm.Elastic(E, NU), Compiled(E, NU, 1.0, 20.0)]
    tags = create_tags(domain, lambda x: (len(laws) * x[:, 0] * 0.999).astype(int))
    soft = dm.Elastic(E / 10, NU)
    numbers = range(len(laws))
    mixtures = [dict(enumerate(laws)), dict.fromkeys(numbers, soft)]
    mixtures += [dict.fromkeys(numbers, soft) | {i: law} for i, law in enumerate(laws)]
    forces = []
    V = fem.functionspace(domain, ("Lagrange", degree, (2,)))
    for mixture in mixtures:
        solid = dm.Solid(fem.Function(V), mixture, tags)
        set_wave(solid.u, 4e-3)
        solid.evaluate()
        solid.commit()
        set_wave(solid.u, 4e-3, 0.8)
        forces.append(residual(solid))
    together, neighbours, *alone = forces
    expected = sum(alone) - (len(laws) - 1) * neighbours
    assert np.abs(together - expected).max(initial=0.0) < 1e-12
    assert len(dm.Solid(create_displacement(domain), mixtures[0], tags).regions) == len(laws)

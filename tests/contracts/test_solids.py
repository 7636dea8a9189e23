# SPDX-License-Identifier: MIT
"""What every law passes in a solid: derivatives, whatever strain, cells and kinematics."""

import dataclasses

import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from dolfinx_mortar.solid.kinematics import plane_strain
from tests.cases.meshes import LOWER, UPPER
from tests.cases.pointwise_laws import Compiled
from tests.cases.pressed_blocks import PressedBlocks
from tests.cases.solid import (
    create_displacement,
    create_domain,
    create_tags,
    errors_of_derivatives,
    largest,
    residual,
    wave,
)
from tests.cases.user_laws import Forces, green_lagrange
from tests.choice import quick

pytestmark = pytest.mark.mpi
E, NU, Y = 1000.0, 0.3, 5.0
RUBBER, HARD = dm.NeoHooke(E, NU), dm.MooneyRivlin(10.0, 5.0, 1e3)
OGDEN = dm.Ogden(mu=(0.63, 0.0012, -0.01), alpha=(1.3, 5.0, -2.0), K=10.0)
KINEMATIC, HARDENING = dm.VonMises(E, NU, Y, 50.0), dm.VonMises(E, NU, Y, 0.0, 50.0)
MIXED = dm.VonMises(E, NU, Y, 20.0, 50.0)
VOCE = dm.VonMisesVoce(E, NU, Y, 20.0, 10.0, 1.0, 100.0)
CONE, NUMBERS = dm.DruckerPrager(E, NU, Y, 0.3), Compiled(E, NU, Y, 50.0)
WOOD = dm.Orthotropic(1e3, 500.0, 400.0, 0.3, 0.2, 0.1, 200.0, 150.0, 100.0, yaw=0.4)
GREEN = dataclasses.replace(plane_strain, name="finite", measure=green_lagrange)
PLATE, RING, MEAN = (
    {"kinematics": "plane_stress"},
    {"kinematics": "axisymmetric"},
    {"volumetric": "reduced"},
)
SWELLING = 0.1, ufl.as_tensor([[0.2, 0.05, 0], [0.05, -0.1, 0], [0, 0, 0.1]])

SMALL = [
    (KINEMATIC, "hexahedron", 1, {}),
    (MIXED, "triangle", 1, {}),
    (VOCE, "tetrahedron", 1, {}),
    (CONE, "quadrilateral", 1, {}),
    (WOOD, "triangle", 2, {}),
    (NUMBERS, "quadrilateral", 1, RING),
    (KINEMATIC, "quadrilateral", 1, RING | MEAN),
    (VOCE, "hexahedron", 1, MEAN),
    (NUMBERS, "quadrilateral", 1, MEAN),
    (MIXED, "quadrilateral", 1, PLATE),
    *((law, "triangle", 1, {"kinematics": GREEN}) for law in (dm.Elastic(E, NU), VOCE, NUMBERS)),
]
FINITE = [
    (RUBBER, "triangle", 1, {}),
    (HARD, "triangle", 1, {}),
    (OGDEN, "hexahedron", 1, {}),
    (RUBBER, "quadrilateral", 1, RING | MEAN),
    (HARD, "hexahedron", 1, MEAN),
    (HARD, "quadrilateral", 2, MEAN),
    (HARD, "quadrilateral", 2, RING | MEAN),
    (HARD, "hexahedron", 2, MEAN),
    (HARDENING, "quadrilateral", 1, {}),
    (HARDENING, "quadrilateral", 1, MEAN),
    (MIXED, "hexahedron", 1, {}),
    (NUMBERS, "triangle", 1, RING),
    (Forces(E), "quadrilateral", 1, {}),
    *((law, "quadrilateral", 1, PLATE) for law in (RUBBER, OGDEN, HARDENING, KINEMATIC, WOOD)),
]
CASES = [("small", *c) for c in SMALL] + [("finite", *c) for c in FINITE]
QUICK = [CASES[i] for i in (1, 3, 5, 6, 12, 14, 18, 21, 28)]


@pytest.mark.parametrize(("strain", "law", "cell", "degree", "options"), quick(CASES, *QUICK))
def test_forces_and_tangent_are_derivatives(strain, law, cell, degree, options):
    """From a state that has flowed, of bent cells of two bodies, with an eigenstrain."""
    domain = create_domain(cell, 2)
    domain.geometry.x[:, 0] *= 1.0 + 0.1 * domain.geometry.x[:, 1]
    u, x = create_displacement(domain, degree), ufl.SpatialCoordinate(domain)
    v, d, size = fem.Function(u.function_space), domain.geometry.dim, 4e-3
    if strain == "small":
        options = options | {"eigenstrain": 1e-3 * x[1]}
        tags = create_tags(domain, lambda x: 1 + (x[:, 0] > 0.5))
        solid = dm.Solid(u, {1: law, 2: dm.Elastic(2 * E, 0.4)}, tags, **options)
    else:
        options = options | {"eigenstrain": SWELLING[law in (RUBBER, MIXED, HARD)] * (1 + x[1])}
        solid, size = dm.Solid(u, law, strain="finite", **options), 0.06

    def move(f, size, phase):
        ring = options.get("kinematics") == "axisymmetric"
        f.interpolate(lambda x: wave(size, phase)(x)[:d] * (x[0] if ring else 1.0))

    move(u, size, 0.0)
    solid.evaluate()
    solid.commit()
    move(u, size, 0.8)
    move(v, 1.0, 0.3)
    if options.get("kinematics") == "plane_stress":
        solid.evaluate()
        assert largest(solid.fields.values("stress_zz")) < 1e-9 * solid.max("stress_norm")
    K = solid.create_matrix()
    solid.assemble_tangent(K)
    h = 1e-7 if strain == "small" else 1e-6
    found = errors_of_derivatives(u, solid.energy, lambda: residual(solid), K, v, h)
    assert found[0] < 1e-7 and found[1] < 1e-8
    assert (solid.energy() is None) == (law in (NUMBERS, Forces(E)))
    assert solid.linear == (law is WOOD and strain == "small")
    assert K.isSymmetric(1e-12 * K.norm())


LAWS = {"mixed": MIXED, "voce": VOCE, "cone": CONE, "wood": WOOD, "numbers": NUMBERS}


@pytest.mark.parametrize("name", quick(LAWS, "cone", "numbers"))
def test_in_contact(name):
    """The law in one block, elastic in the other: pressed in three steps, and let go."""
    case, law, forces = PressedBlocks(), LAWS[name], []
    solid = dm.Solid(case.u, {LOWER: law, UPPER: dm.Elastic(E, NU)}, case.cells)
    problem = case.problem(law=solid, geometry="reference")
    for depth in (0.02, 0.04, 0.06, 0.05):
        case.top.value[1] = -depth
        report = dm.newton(problem, rtol=1e-10)
        problem.commit()
        assert report.converged and report.newton_iterations <= 12
        forces.append(abs(problem.contacts[0].force[1]))
    assert forces[0] < forces[1] < forces[2] > forces[3] > 0.0
    assert name == "wood" or solid.max("plastic_strain_norm") > 1e-4

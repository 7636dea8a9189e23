# SPDX-License-Identifier: MIT
"""What bodies store and dissipate: closed forms, the balance with the work of supports, state."""

from dataclasses import dataclass
from itertools import pairwise

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from tests.cases.pressed_blocks import PressedBlocks, rejected
from tests.cases.solid import (
    COMM,
    create_displacement,
    create_domain,
    hold,
    plane,
    rectangle,
    set_wave,
    stand,
    total,
)
from tests.cases.user_laws import Forces
from tests.choice import quick

pytestmark = pytest.mark.mpi
E, NU, Y = 1000.0, 0.3, 5.0
MIXED = dm.VonMises(E, NU, Y, 100.0, 60.0)
ISOTROPIC = dm.VonMises(E, NU, Y, 0.0, 60.0)
SATURATING = dm.VonMisesVoce(E, NU, Y, 20.0, 10.0, 3.0, 40.0)
SOIL = dm.DruckerPrager(E, NU, Y, 0.2)


def spent(solid):
    found = solid.energies().values()
    return np.array([sum(e.stored for e in found), sum(e.dissipated for e in found)])


@dataclass
class Push:
    """A rectangle whose top moves; the work of its supports by the trapezoidal rule."""

    problem: dm.ContactProblem
    top: fem.Constant

    def walk(self, path):
        """Return the work along displacements (2,) of the top."""
        work, before, force = 0.0, self.top.value.copy(), np.zeros(2)
        for place in path:
            self.top.value[:] = place
            dm.newton(self.problem, rtol=1e-9)
            self.problem.commit()
            now = dm.reaction(self.problem, self.problem.bcs[1]).force
            work += (force + now) @ (place - before) / 2
            before, force = np.array(place), now
        return work


def push(law, strain, **options):
    domain = rectangle([(0.5, 0.0), (1.5, 1.0)], (3, 3))
    top = fem.Constant(domain, np.zeros(2))

    def ends(V):
        return [hold(V, plane(1)), hold(V, plane(1, 1.0), value=top)]

    return Push(stand(domain, law, ends, strain=strain, energies=True, **options), top)


def loop(size, n):
    """Return a closed path in n steps a side, the way there and back on different routes."""
    corners = size * np.array([(0.0, 0.0), (1.0, -0.4), (-0.5, -0.5), (0.0, 0.0)])
    t = np.arange(1, n + 1)[:, None] / n
    return np.vstack([a + t * (b - a) for a, b in pairwise(corners)])


CASES = [
    ("small", MIXED, {}, 0.04),
    ("finite", MIXED, {}, 0.2),
    ("finite", ISOTROPIC, {"volumetric": "reduced"}, 0.2),
    ("small", SATURATING, {"kinematics": "axisymmetric"}, 0.04),
    ("small", MIXED, {"kinematics": "plane_stress"}, 0.04),
    ("small", SOIL, {}, 0.04),
]


@pytest.mark.parametrize(
    ("strain", "law", "options", "size"),
    [CASES[0], *(pytest.param(*case, marks=pytest.mark.slow) for case in CASES[1:])],
)
def test_work_is_stored_or_dissipated(strain, law, options, size):
    """In a slow loop, to the error of the trapezoidal rule, which falls with the steps."""
    errors = []
    for n in (8, 16, 32):
        case = push(law, strain, **options)
        work = case.walk(loop(size, n))
        stored, dissipated = spent(case.problem.solid)
        assert stored > 0.0 < dissipated
        errors.append(abs(stored + dissipated - work) / dissipated)
    assert errors[-1] < 3e-3
    assert errors[2] < 0.1 * errors[0]  # of second order: 1/16


@pytest.mark.parametrize("strain", quick(["small", "finite"], "small"))
def test_elastic_bodies_store_all_of_it(strain):
    """Stored energy is the potential to the last bits; what is dissipated is exactly zero."""
    law = dm.Elastic(E, NU) if strain == "small" else dm.NeoHooke(E, NU)
    case = push(law, strain, volumetric="reduced")
    case.walk(loop(0.1, 2)[:3])
    solid = case.problem.solid
    energy = COMM.allreduce(np.sum(solid.energy()))
    stored, dissipated = spent(solid)
    assert stored == pytest.approx(energy, rel=1e-9)
    assert dissipated == 0.0 and solid.max("dissipated_energy") == 0.0


@pytest.mark.parametrize("strain", quick(["small", "finite"], "finite"))
def test_densities_of_von_mises(strain):
    """Y times the plastic path is dissipated; elastic energy and that of hardening are stored.

    The path is that of the law: at finite strain, whatever form it takes.
    """
    u = create_displacement(create_domain("triangle"))
    solid = dm.Solid(u, MIXED, strain=strain, energies=True)
    for size in (0.02, 0.05, -0.03):
        set_wave(u, size)
        solid.evaluate()
        solid.commit()
    values, p = solid.fields.values, MIXED
    path = values("accumulated_plastic_strain")
    assert COMM.allreduce(float(path.max(initial=0.0)), op=MPI.MAX) > 0.01
    np.testing.assert_allclose(values("dissipated_energy"), Y * path, rtol=1e-9, atol=1e-12 * Y)
    hardening = p.a / 2 * values("plastic_strain_norm") ** 2 + p.H / 2 * path**2
    elastic = values("stored_energy") - hardening
    if strain == "small":
        stress = values("stress")
        tensor = stress[..., [0, 1, 2, 3, 3]]
        square, trace = (tensor**2).sum(axis=-1), stress[..., :3].sum(axis=-1)
        complementary = ((1 + NU) * square - NU * trace**2) / (2 * E)
        np.testing.assert_allclose(elastic, complementary, rtol=1e-9, atol=1e-12 * Y)
    weights = solid.fields.weights
    assert spent(solid)[1] == pytest.approx(total(Y * path * weights), rel=1e-9)


def create_blocks():
    case = PressedBlocks()
    laws, tags = {"lower": MIXED, "upper": dm.Elastic(E, NU)}, {"lower": 1, "upper": 2}
    solid = dm.Solid(case.u, laws, dm.Tags(case.cells, tags), energies=True)
    return case, case.problem(law=solid)


def step(case, problem, down):
    case.top.value[1] = -down
    dm.newton(problem)
    problem.commit()
    return problem.solid.energies()


def test_bodies_by_name_and_in_checkpoints(folder):
    """Each body has its own; a restored run goes on with what was dissipated before."""
    path = folder / "state.h5"
    blocks, again = create_blocks(), create_blocks()
    first = step(*blocks, 0.03)
    assert set(first) == {"lower", "upper"}
    assert first["lower"].dissipated > 0.0 == first["upper"].dissipated < first["upper"].stored
    blocks[1].save(path)
    again[1].restore(path)
    expected, found = step(*blocks, 0.06), step(*again, 0.06)
    for name, energies in expected.items():
        assert found[name].stored == pytest.approx(energies.stored, rel=1e-9)
        assert found[name].dissipated == pytest.approx(energies.dissipated, rel=1e-9)
    assert found["lower"].dissipated > first["lower"].dissipated


def test_what_has_no_energies():
    u = create_displacement(create_domain("triangle", 2))
    with rejected("energies", "Solid(.., energies=True)"):
        dm.Solid(u, MIXED).energies()
    with rejected("energies", "Forces", "potential"):
        dm.Solid(u, Forces(E), energies=True)
    with rejected("energies is 1", "True or False"):
        dm.Solid(u, MIXED, energies=1)

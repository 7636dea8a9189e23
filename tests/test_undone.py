# SPDX-License-Identifier: MIT
"""Steps that fail because of laws and parameters: messages, and fields after the failure."""

from dataclasses import dataclass
from typing import ClassVar

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import default_scalar_type, fem
from dolfinx_mortar.steps import newton as newton_module
from tests import friction_case
from tests.pressed_blocks import PressedBlocks
from tests.user_laws import Softening

pytestmark = pytest.mark.mpi
COMM = MPI.COMM_WORLD


@pytest.mark.parametrize("law", [Softening(1000.0), dm.Elastic(1000.0, 0.3)])
def test_a_step_that_fails_says_how_laws_of_ones_own_are_judged(law):
    case = PressedBlocks()
    case.top.value[1] = -0.3
    options = {} if isinstance(law, Softening) else {"max_it": 1}
    with pytest.raises(dm.NewtonNotConverged) as caught:
        dm.newton(case.problem(law=law), **options)
    told = (
        "Softening: dolfinx_mortar.materials.check tells whether the potential of a law is convex"
    )
    assert (told in str(caught.value)) == isinstance(law, Softening)


def test_a_step_that_fails_shows_what_was_before():
    """Results are those with the parameters before, and the next try takes the new ones."""
    case = PressedBlocks()
    E, a = (fem.Constant(case.mesh, default_scalar_type(v)) for v in (1000.0, 10.0))
    problem = case.problem(law=dm.VonMises(E, 0.3, 2.0, a))
    solid = problem.solid
    dm.newton(problem)
    problem.commit()
    before, back = solid.stress.x.array.copy(), solid.max("back_stress_norm")
    E.value, a.value = 4000.0, 40.0
    with pytest.raises(dm.NewtonNotConverged):
        dm.newton(problem, max_it=1, rtol=1e-12)
    assert np.array_equal(solid.stress.x.array, before)
    assert solid.max("back_stress_norm") == back > 0.0
    assert dm.newton(problem).converged
    difference = np.abs(solid.stress.x.array - before).max(initial=0.0)
    assert COMM.allreduce(difference, op=MPI.MAX) > 0.1
    assert solid.max("back_stress_norm") > 2.0 * back


@dataclass(frozen=True)
class Creeping(dm.Material):
    """Hooke's law whose elastic strain turns into a viscous one, by a half in every step."""

    E: float
    nu: float
    state: ClassVar = {"viscous_strain": (3, 3)}
    linear: ClassVar = False
    elastic_stress = staticmethod(dm.Elastic.elastic_stress)

    @staticmethod
    def stress(strain, state, p):
        return dm.Elastic.elastic_stress(0.5 * (strain - state["viscous_strain"]), p)

    @staticmethod
    def updated_state(strain, state, p):
        return {"viscous_strain": 0.5 * (strain + state["viscous_strain"])}


def test_a_step_that_fails_lets_nothing_flow_on():
    """To evaluate a creeping body once more, from its committed state, would be another step."""
    case = PressedBlocks()
    problem = case.problem(law=Creeping(1000.0, 0.3))
    solid = problem.solid
    dm.newton(problem)
    problem.commit()
    before, viscous = solid.stress.x.array.copy(), solid.max("viscous_strain_norm")
    with pytest.raises(dm.NewtonNotConverged):
        dm.newton(problem, max_it=1, rtol=1e-12)
    assert np.array_equal(solid.stress.x.array, before)
    problem.commit()
    assert solid.max("viscous_strain_norm") == viscous > 0.0


@pytest.mark.parametrize("volumetric", [pytest.param("full", marks=pytest.mark.slow), "reduced"])
def test_a_first_step_that_fails_shows_nothing(volumetric):
    """Not even the stress that an eigenstrain will make."""
    case = PressedBlocks(cell="quadrilateral")
    law, contact = dm.VonMises(1000.0, 0.3, 5.0, 10.0), case.contact()
    solid = dm.Solid(case.u, law, eigenstrain=1e-2, volumetric=volumetric)
    problem = dm.ContactProblem(solid, [contact], bcs=case.bcs())
    with pytest.raises(dm.NewtonNotConverged):
        dm.newton(problem, max_it=1, rtol=1e-12)
    assert not solid.stress.x.array.any() and solid.max("plastic_strain_norm") == 0.0


@pytest.mark.parametrize(
    ("error", "where"),
    [
        (KeyboardInterrupt, "create_certificate"),
        (ValueError, "create_certificate"),
        (KeyboardInterrupt, "support_forces"),
    ],
)
def test_a_step_that_is_stopped_when_its_results_are_set(monkeypatch, error, where):
    """Forces, pressures, slips and dissipation are those of the displacement: of the step before.

    Were the slips left, a commit would count them.
    """
    case = friction_case.create(friction=0.3)
    problem, contact = case.problem, case.contact
    case.solve(0.005, -0.01)

    def shown():
        fields = [contact.pressure, contact.gap, contact.active, contact.traction]
        fields += [contact.step_slip, contact.slip, contact.status]
        numbers = [contact.force, contact.moment, contact.master_force, contact.dissipation]
        committed = problem.committed
        state = [committed.slid, committed.dissipated, committed.active, committed.sliding]
        return [f.x.array.copy() for f in fields] + [np.array(n) for n in [*numbers, *state]]

    def unchanged():  # gaps are not-a-number where a node faces nobody
        return all(
            np.array_equal(*pair, equal_nan=True) for pair in zip(before, shown(), strict=True)
        )

    before = shown()

    def stop(*_):
        assert contact.dissipation > 2.0 * before[10]  # the results are those of the step
        raise error("no certificate")

    with monkeypatch.context() as patch:
        patch.setattr(newton_module, where, stop)
        case.push(0.02, -0.011)
        with pytest.raises(error, match="no certificate"):
            dm.newton(problem)
    assert unchanged()
    problem.commit()
    assert unchanged()


def test_a_step_that_was_taken_back_is_never_committed():
    """Its displacement reset, not even a second commit takes over its slips and contacts."""
    case = friction_case.create(friction=0.3)
    problem, committed = case.problem, case.problem.committed
    case.solve(0.005, -0.01)
    before, u = committed.slid.copy(), problem.u.x.array.copy()
    case.push(0.02, -0.011)
    dm.newton(problem)
    problem.u.x.array[:] = u
    for _ in range(2):
        problem.commit()
        assert np.array_equal(committed.slid, before)

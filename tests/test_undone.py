# SPDX-License-Identifier: MIT
"""Steps that fail because of laws and parameters: messages, and fields after the failure."""

from dataclasses import dataclass
from typing import ClassVar

from mpi4py import MPI

import numpy as np
import pytest
from numpy.testing import assert_allclose

import dolfinx_mortar as dm
from dolfinx import fem
from dolfinx_mortar.qp import interior_point
from dolfinx_mortar.qp.condensed import Dense
from dolfinx_mortar.qp.operator import Operator
from dolfinx_mortar.steps import walk
from dolfinx_mortar.steps.energy_ledger import EnergyLedger
from tests import tool_case
from tests.cases.pressed_blocks import Bare, PressedBlocks
from tests.cases.states import state_of
from tests.cases.user_laws import Softening

pytestmark = pytest.mark.mpi
COMM = MPI.COMM_WORLD


def test_a_step_that_fails_says_how_laws_of_ones_own_are_judged():
    case = PressedBlocks()
    case.top.value[1] = -0.3
    problem = case.problem(law=Softening(1000.0))
    with pytest.raises(dm.NewtonNotConverged):
        dm.newton(problem)
    told = "Softening: dolfinx_mortar.materials.check tells whether the potential of a law is"
    assert told in problem.diagnose()[-1]


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


def test_a_first_step_that_fails_shows_nothing():
    """Not even the stress that an eigenstrain will make."""
    case = PressedBlocks(cell="quadrilateral")
    law, contact = dm.VonMises(1000.0, 0.3, 5.0, 10.0), case.contact()
    solid = dm.Solid(case.u, law, eigenstrain=1e-2, volumetric="reduced")
    problem = case.problem([contact], law=solid)
    with pytest.raises(dm.NewtonNotConverged):
        dm.newton(problem, max_it=1, rtol=1e-12)
    assert not solid.stress.x.array.any() and solid.max("plastic_strain_norm") == 0.0


# -- steps that are stopped while they are committed ---------------------------------------------


class Counter(Bare):
    """Adds nothing, and counts its commits; may fail when it is asked the next time."""

    linear, fails = True, ""  # in which method

    def energy(self):
        return 0.0

    def add_forces(self, F):
        if self.fails == "add_forces" and COMM.rank == COMM.size - 1:
            raise OSError("no licence")

    def commit(self):
        self.state["count"].x.array[:] += 1.0
        if self.fails == "commit":
            raise OSError("no licence")


METAL = dm.VonMises(200.0, 0.3, 0.5, 10.0)


class Stopped:
    """A metal block, which may move in time, and a plane that slides over it."""

    times = (0.02, 0.04, 0.06, 0.08)

    def __init__(self, law=METAL, *, in_time=True, friction=0.2):
        block = tool_case.Block(n=4)
        solid = dm.Solid(block.u, law)
        self.counter = Counter(state={"count": fem.Function(block.V)})
        self.inertia = dm.Inertia(solid, 1e-3, velocity=(0.0, -0.5))
        terms = [self.counter, self.inertia][: 1 + in_time]
        self.tool = block.tool(dm.shapes.Plane([0.0, 0.02], [0.0, -1.0]), friction=friction)
        self.problem = block.problem([self.tool], solid, terms=terms)

    def run(self, count):
        times, at_time = self.times[:count], self.at_time
        return list(dm.time_steps(self.problem, times, on_time=at_time, progress=False))

    def at_time(self, time):
        self.tool.position.value[:] = 0.2 * time, 0.02 - 0.3 * time

    def __eq__(self, other):
        return state_of(self.problem)[:-1] == state_of(other.problem)[:-1]  # but for the walk


def in_ledger(case, patch):
    """Stop after the impulse."""
    stop_in(patch, EnergyLedger, "_in_bodies")


def in_history(case, patch):
    """Stop when all is committed."""
    stop_in(patch, walk, "reactions")


def stop_in(patch, owner, name):
    def stop(*_):
        raise KeyboardInterrupt

    patch.setattr(owner, name, stop)


def in_commit(case, patch):
    """Stop when bodies have been committed, and a part of the terms."""
    case.counter.fails = "commit"


def in_forces(case, patch):
    """Stop when the ledger asks for the loads at the end of the step, on the last rank alone."""
    commit = EnergyLedger.commit

    def fail(ledger, *given):
        case.counter.fails = "add_forces"
        return commit(ledger, *given)

    patch.setattr(EnergyLedger, "commit", fail)


@pytest.mark.parametrize(
    ("stop", "done"),
    [(in_ledger, 0), (in_history, 2), (in_commit, 0), (in_forces, 2)],
)
def test_a_step_in_time_that_is_stopped_when_it_is_committed(monkeypatch, stop, done):
    """The state is that before, bit by bit, and going on is as if nothing had been."""
    case, same, whole = Stopped(), Stopped(), Stopped()
    for each in (case, same):
        each.run(done) if done else each.at_time(0.0)
    with monkeypatch.context() as patch:
        stop(case, patch)
        with pytest.raises((KeyboardInterrupt, OSError)):
            case.run(done + 1)
    case.counter.fails = ""
    assert case == same
    case.run(4)
    whole.run(4)
    assert case == whole and whole.tool.force[1] < 0.0


def test_a_step_in_time_is_tried_again_from_the_last_commit(tmp_path):
    """As in statics; what is committed has the level of the step, where the next one begins."""
    case, other = Stopped(tool_case.ELASTIC), Stopped(tool_case.ELASTIC)
    for each, times in ((case, [0.02]), (other, [0.02, 0.04, 0.07])):
        each.tool.position.value[1] = 1.0
        list(dm.time_steps(each.problem, times, rtol=1e-12, progress=False))
    for level in (0.04, 0.05, 0.07):
        for _ in range(2):
            dm.newton(case.problem, level=level, rtol=1e-12)
        if level != 0.05:  # never committed
            case.problem.commit()
            assert case.problem.committed.level == level
    pairs = (case.problem.u, other.problem.u), (case.inertia.velocity, other.inertia.velocity)
    for one, same in pairs:
        assert_allclose(one.x.array, same.x.array, rtol=0.0, atol=1e-10 * same.x.petsc_vec.max()[1])
    dm.newton(case.problem, level=0.1)
    with pytest.raises(ValueError, match="is not committed"):
        case.problem.save(tmp_path / "half.h5")


CALLED_BY_PETSC = {
    "active-set": [(Dense, "mult"), (Operator, "mult")],
    "interior-point": [(interior_point, "check")],
}


@pytest.mark.parametrize(
    ("backend", "error"),
    [("active-set", KeyboardInterrupt), ("interior-point", MemoryError)],
)
def test_what_is_stopped_while_petsc_calls_back(monkeypatch, backend, error):
    """Ctrl-C is raised as such, a lack of memory is told, and the next step is as without."""
    friction = 0.2 if backend == "active-set" else None
    case, same = (Stopped(in_time=False, friction=friction) for _ in range(2))
    raised = []

    def stopped(method):
        def call(*args):
            if not raised:
                raised.append(error())
                raise raised[0]
            return method(*args)

        return call

    for each in (case, same):
        each.tool.position.value[:] = 0.02, -0.05
    with monkeypatch.context() as patch:
        for owner, name in CALLED_BY_PETSC[backend]:
            patch.setattr(owner, name, stopped(getattr(owner, name)))
        told = "" if error is KeyboardInterrupt else "MemoryError"
        with pytest.raises((KeyboardInterrupt, dm.NewtonNotConverged), match=told) as caught:
            dm.newton(case.problem, qp=backend)
    assert isinstance(caught.value, KeyboardInterrupt) == (error is KeyboardInterrupt)
    assert raised and case == same
    for each in (case, same):
        dm.newton(each.problem, qp=backend)
    assert case == same

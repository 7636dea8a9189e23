# SPDX-License-Identifier: MIT
"""Audits, output and other calls between steps change no result, to the last bit, on any ranks.

A plate is glued on a block, and a plastic block is pressed and pushed along it: four load steps
with updated geometry, the third of them in parts. Each test walks so and does something besides.
"""

from dataclasses import dataclass
from functools import cache

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from tests.cases.block_piles import ABOVE, BELOW, COMM, Blocks
from tests.cases.states import state_of

pytestmark = pytest.mark.mpi
LAW = dm.VonMises(E=1000.0, nu=0.3, Y=8.0, a=50.0)
BLOCK_AND_PLATE = [(-0.5, 1.8, 0.0, 1.0, 6, 2), (-0.5, 1.8, 1.0, 1.3, 9, 1)]
PATH = [(0.0, -0.02), (0.05, -0.02), (0.4, -0.06), (0.3, -0.055)]  # press, push, slide far, back
# On several ranks MUMPS adds up in the order in which messages come, on more than two SuperLU_DIST,
# too. There each rank factorises the whole matrix, which is a preconditioner for any later step.
DETERMINISTIC = {
    1: None,
    2: {"pc_type": "lu", "pc_factor_mat_solver_type": "superlu_dist"},
}.get(COMM.size, {"pc_type": "redundant"})
START = -0.1, 0.05  # of the pushed block
IN_PARTS = 2  # the step that is made in parts, where one part fails on the way
FAR, ASIDE = (3.0, -0.5), (0.15, -0.03)  # where no step leads, and a try


@dataclass
class Pile:
    """The problem, and how it is loaded."""

    problem: dm.ContactProblem
    contact: dm.Contact
    tie: dm.Tie
    supports: list[fem.DirichletBC]
    top: fem.Constant
    report: dm.StepReport | None = None  # of the last step
    edits: bool = False  # spoil what is shown before a commit

    def push(self, x, y):
        """Prescribe where the top goes."""
        self.top.value[:] = np.array([x, y]) - START

    def step(self, number):
        """Make a load step of the path, and commit it."""
        if not self.problem.linear.direct:
            self.problem.linear.forget()
        if number != IN_PARTS:
            self.push(*PATH[number])
            self.report = dm.newton(self.problem, rtol=1e-9)
            shown = [(f, f.x.array.copy()) for f in self.contact.nodal.values() if self.edits]
            for f, _ in shown:
                f.x.array[:] = 7.0
            self.problem.commit()
            for f, values in shown:
                f.x.array[:] = values
            return
        start, end = map(np.array, (PATH[number - 1], PATH[number]))
        options = {"on_time": lambda t: self.push(*(start + t * (end - start))), "max_it": 5}
        (step,) = dm.load_steps(self.problem, [1.0], start=0.0, rtol=1e-9, **options)
        self.report = step.report
        assert self.report.cuts > 0


def create():
    """Return a problem of its own."""
    x, y = START
    b = Blocks([*BLOCK_AND_PLATE, (x, 1.0 + x, 1.3 + y, 2.0 + y, 4, 2)])
    contact = dm.Contact(b.facets, slave=20 + ABOVE, master=30 + BELOW, friction=0.3)
    tie = b.join(dm.Tie, (2, BELOW), (1, ABOVE))
    top = fem.Constant(b.mesh, np.zeros(2))
    supports = [b.fix(1, BELOW), b.fix(3, ABOVE, value=top)]
    problem = b.problem([tie, contact], supports, LAW, petsc_options=DETERMINISTIC)
    return Pile(problem, contact, tie, supports, top)


def walk(look=None):
    """Walk along the path; look at the pile before each step and after the last one."""
    pile = create()
    for number in range(len(PATH)):
        if look is not None:
            pile = look(pile, number) or pile
        pile.step(number)
    if look is not None:
        pile = look(pile, len(PATH)) or pile
    return pile


@cache
def expected():
    """Return what the walk ends with if nothing else is done."""
    return state_of(walk().problem)


def check(look):
    """Compare the end of a walk with a look with that of the plain one."""
    assert COMM.allreduce(state_of(walk(look).problem) == expected(), op=MPI.LAND)


def test_the_path_is_worth_it():
    """Bodies flow, nodes slip, and the surfaces move on by facets."""
    pile = walk()
    assert pile.problem.solid.max("plastic_strain_norm") > 1e-4
    assert pile.contact.dissipation > 1e-3
    status = pile.contact.gather(pile.problem.u)["status"]
    assert {0.0, 1.0, 2.0} >= set(status) and (status == 2.0).any()
    way = float(COMM.allreduce(pile.contact.slip.x.array.max(initial=0.0), op=MPI.MAX))
    assert way > 0.25  # of facets that are as long


def test_an_audit():
    check(lambda pile, number: print(pile.problem.audit()) if number == 3 else None)


def test_what_is_read():
    """Fields, results, reactions, reports and their certificates."""

    def look(pile, number):
        pile.problem.output_fields()
        if number > 0:
            pile.contact.gather(pile.problem.u)
            pile.tie.gather(pile.problem.u)
            dm.reaction(pile.problem, pile.supports[0])
            dm.reaction(pile.problem, pile.supports)
            print(pile.report, pile.report.certificate)
            assert repr(pile.report) and pile.report.as_dict()

    check(look)


@pytest.mark.parametrize("max_it", [1, pytest.param(50, marks=pytest.mark.slow)])
def test_a_step_that_fails(max_it):
    """At its first iteration, or where nothing leads."""

    def look(pile, number):
        before = pile.top.value.copy()
        pile.push(*FAR)
        with pytest.raises(dm.NewtonNotConverged):
            dm.newton(pile.problem, max_it=max_it)
        pile.top.value[:] = before

    check(look)


def test_a_step_that_is_taken_back():
    """With other options, and to somewhere else; what it shows stays until the next step."""

    def look(pile, number):
        if number == len(PATH):
            return
        before, u = pile.top.value.copy(), pile.problem.u.x.array.copy()
        pile.push(*ASIDE)
        dm.newton(pile.problem, rtol=1e-3)
        pile.top.value[:], pile.problem.u.x.array[:] = before, u

    check(look)


def test_a_checkpoint_that_is_restored(folder):
    """Into another problem."""
    file = folder / "state.h5"

    def look(pile, number):
        pile.problem.save(file)
        other = create()
        other.top.value[:] = pile.top.value
        other.problem.restore(file)
        return other

    check(look)


def test_results_that_are_edited():
    """What is shown is no state: not even between a step and its commit."""

    def look(pile, number):
        pile.edits = number < len(PATH)

    check(look)

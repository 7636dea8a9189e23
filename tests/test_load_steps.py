# SPDX-License-Identifier: MIT
"""Walks through load levels: cuts, starts, overlaps in parts, limit loads."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import default_scalar_type, fem
from dolfinx_mortar.common.step_report import StepReport
from dolfinx_mortar.steps import walk as walking
from dolfinx_mortar.steps.newton import solve_step
from tests.cases.block_piles import ABOVE, BELOW, PILE, WEST, Blocks
from tests.cases.hertz import paper
from tests.cases.pressed_blocks import failing, rejected

COMM = MPI.COMM_WORLD


def on_top(case, depth=0.05):
    """Return the function that sets the level of the load."""

    def on_time(t):
        case.press(depth * t)

    return on_time


def test_cuts_can_be_forbidden_and_are_told():
    case = paper()
    with rejected("from 0 to 4", "0 of 0 cuts", error=dm.NewtonNotConverged):
        list(dm.load_steps(case.problem, [4.0], on_time=on_top(case), max_it=5, cuts="none"))
    (step,) = dm.load_steps(case.problem, [4.0], on_time=on_top(case), max_it=5)
    assert step.report.cuts > 0 and len(step.parts) > 1
    assert any("cut" in note for note in step.report.notes)
    assert f"in {len(step.parts)} parts" in str(step)
    assert step.report.as_dict()["cuts"] == step.report.cuts


def generator(t):
    yield t


async def coroutine(t):
    return t


@pytest.mark.parametrize("on_time", [generator, coroutine, lambda t: generator(t)])
def test_what_has_set_nothing(on_time):
    """A function with `yield` only makes a generator: its loads would stay as they were."""
    case = Blocks(PILE[:1])
    problem = case.problem([], [case.fix(0, WEST)])
    with rejected("on_time(1) returns a ", "has set nothing", "plain function"):
        list(dm.load_steps(problem, [1.0], on_time=on_time))


def test_a_step_of_no_length_is_not_halved():
    # of smooth surfaces the weighted gap of what touches in a point is an overlap of some 1e-6
    case, seen = paper(surface="facets"), []

    def on_time(t):
        seen.append(t)
        case.press(0.3)  # whatever the level

    with rejected("from 0 to 0", error=dm.NewtonNotConverged):
        list(dm.load_steps(case.problem, [0.0], on_time=on_time, max_it=1))
    assert seen == [0.0]


@pytest.mark.mpi
def test_an_error_of_the_users_function_reaches_all_ranks():
    case = paper()

    def on_time(t):
        if COMM.rank == COMM.size - 1:
            raise KeyError("no such level")

    error = KeyError if COMM.rank == COMM.size - 1 else RuntimeError
    with pytest.raises(error, match="no such level"):
        list(dm.load_steps(case.problem, [1.0], on_time=on_time))


def test_a_limit_load_is_named():
    """A bar in tension without hardening carries its yield stress and no more."""
    b = Blocks(PILE[:1])
    law = dm.VonMises.from_uniaxial(1000.0, 0.3, 10.0, 0.0)
    pull = fem.Constant(b.mesh, default_scalar_type((0.0, 0.0)))
    ds = ufl.Measure("ds", b.mesh, subdomain_data=b.facets)
    bcs = [b.fix(1, BELOW, component=1), b.fix(1, WEST, component=0)]
    loads = ufl.inner(pull, ufl.TestFunction(b.V)) * ds(10 + ABOVE)
    problem = b.problem([], bcs, law=law, loads=loads)

    def on_time(t):
        pull.value[1] = 10.0 * t  # plane strain: the limit is 10 times 2 / sqrt(3)

    reached = []
    with failing(problem, "limit load", "100 % of the volume flows") as caught:
        for step in dm.load_steps(problem, [1.0, 2.0], on_time=on_time):
            reached.append(step.time)
    assert reached == [1.0] and "moves away" not in problem.diagnose()[-1]
    level = problem.committed.level
    assert 1.0 < level < 2 / np.sqrt(3) and f"converged is {level:g}" in caught.value.message
    # what is kept is what is said: the state of that level
    assert f"stay committed: displacement, state and results are those at level {level:g};" in (
        caught.value.message
    )
    assert problem.solid.max("stress_yy") == pytest.approx(10.0 * level, rel=1e-6)


def test_a_step_that_leaves_nothing_says_so():
    """And what stays of an overlap that is taken out in parts: the level alone does not tell."""
    case = paper(gap=-0.2)
    u = case.problem.u.x.array
    with rejected("failed from 0 to 0", error=dm.NewtonNotConverged) as caught:
        list(dm.load_steps(case.problem, [0.0], max_it=3, cuts="none"))
    told = caught.value.message
    assert "The displacement and the committed state are as before the step;" in told
    assert not u.any() and not case.problem.committed.begun


def test_what_stays_of_an_overlap_is_told(monkeypatch):
    """Parts that have converged stay, at the same level: it says how deep sides still overlap."""
    case = paper(gap=-0.2)

    def solve(problem, *, overlap, **options):
        if overlap < 0.09:
            raise dm.NewtonNotConverged("too deep", StepReport())
        return solve_step(problem, overlap=overlap, **options)

    monkeypatch.setattr(walking, "solve_step", solve)
    with rejected("too deep", error=dm.NewtonNotConverged) as caught:
        list(dm.load_steps(case.problem, [0.0]))
    assert "stay committed" in caught.value.message and case.problem.committed.begun
    left = float(caught.value.message.partition("still overlap by ")[2].partition(";")[0])
    assert 0.09 <= left < 0.2
    overlap = walking.find_overlap(case.problem, 1e-6)
    assert overlap == pytest.approx(left, rel=0.05)


@pytest.mark.mpi
def test_two_walks_at_a_time():
    """The one that began first does not go on from where the other one has led."""
    case = paper()
    first = dm.load_steps(case.problem, [1.0], on_time=on_top(case))
    next(first)
    second = dm.load_steps(case.problem, [0.5], on_time=on_top(case))
    next(second)
    u = case.problem.u.x.array.copy()
    with rejected("problem: another load_steps has begun", "make a problem for each"):
        next(first)
    assert np.array_equal(case.problem.u.x.array, u)
    assert next(second, None) is None  # it is done
    (step,) = dm.load_steps(case.problem, [0.6], on_time=on_top(case))
    assert step.number == 1 and case.problem.committed.level == 0.6

    def on_time(t):
        next(dm.load_steps(case.problem, [0.7], on_time=on_top(case)))

    with rejected("another load_steps has begun"):
        next(dm.load_steps(case.problem, [0.8], on_time=on_time))

# SPDX-License-Identifier: MIT
"""Steps that cannot be solved, and walks: cuts, starts, overlaps in parts, limit loads."""

import copy
import json
from dataclasses import dataclass
from typing import ClassVar

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import default_scalar_type, fem
from dolfinx_mortar.common.step_report import StepReport
from dolfinx_mortar.steps import newton as newton_module
from dolfinx_mortar.steps import walk as walking
from dolfinx_mortar.steps.newton import solve_step
from tests.cases.block_piles import ABOVE, BELOW, PILE, WEST, Blocks
from tests.cases.hertz import paper
from tests.cases.meshes import BOTTOM, TOP
from tests.cases.pressed_blocks import PressedBlocks, failing, rejected
from tests.cases.states import state_of

COMM = MPI.COMM_WORLD


@pytest.fixture
def case():
    return PressedBlocks()


# -- bodies that nothing holds


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("supports", "words"),
    [
        ([], ("translation x", "translation y", "rotation about z")),
        ([TOP], ("translation x of the body around [0.5, -0.5]",)),
        ([BOTTOM], ("translation x of the body around [0.5, 0.5]",)),
    ],
)
def test_floating_bodies_with_contact(case, supports, words):
    """A contact holds neither of the two against sliding."""
    with rejected("bcs", "nothing holds", *words, "Prescribe"):
        dm.newton(case.problem(bcs=[case.bc(tag) for tag in supports]))


@pytest.mark.mpi
def test_body_pulled_off_its_contact(case):
    """Held by contact and pulled away: no minimum, and no answer of 1e11 either."""
    bcs = [case.bc(BOTTOM), case.roller(TOP, 0)]
    problem = case.problem(bcs=bcs, loads=case.pull((0.0, 1.0)))
    words = ("contact alone holds the body around [0.5, 0.5]", "moves away", "rolls")
    with failing(problem, *words):
        dm.newton(problem)
    assert "friction carries" not in problem.diagnose()[-1]
    assert not case.u.x.array.any()


# -- solvers that fail


@pytest.mark.parametrize(
    ("nonsense", "qp"),
    [(np.nan, "active-set"), (1e11, "interior-point"), (0.0, "active-set")],
)
def test_linear_solver_that_returns_nonsense(case, monkeypatch, nonsense, qp):
    problem = case.problem()

    with monkeypatch.context() as patch:
        patch.setattr(dm.qp.LinearSolver, "_iterate", lambda *_: _[-1] + nonsense)
        patch.setattr(dm.qp.LinearSolver, "apply", lambda self, r, x: x.set(nonsense))
        with rejected("linear solver", error=dm.NewtonNotConverged):
            dm.newton(problem, qp=qp)
    assert not case.u.x.array.any()
    assert dm.newton(problem, qp=qp).converged


# -- Newton that does not converge


def plastic(case, **options):
    """Return the blocks with a soft law: pressing needs several iterations."""
    return case.problem(law=dm.VonMises(1000.0, 0.3, 1.0, 100.0), **options)


@pytest.mark.mpi
def test_too_few_iterations(case):
    """The exception has the report; nothing else has changed."""
    problem = plastic(case)
    dm.newton(problem)
    problem.commit()
    before = state_of(problem)
    case.top.value[:] = (0.0, -0.05)
    with rejected("max_it=1", "smaller", error=dm.NewtonNotConverged) as caught:
        dm.newton(problem, max_it=1)
    report = caught.value.report
    assert not report.converged and report.newton_iterations == 1
    assert "NOT converged" in str(report)
    assert str(report) in str(caught.value)  # as it is at the end, not when it was raised
    assert report.seconds["total"] > 0 and "cholesky" in report.linear_solver
    json.dumps(report.as_dict())
    assert state_of(problem) == before


@pytest.mark.mpi
def test_stop_by_the_user(case, monkeypatch):
    """An interrupt inside a step leaves all as it was, also what a commit would take."""
    problem = plastic(case)

    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(newton_module, "create_certificate", interrupt)
    with pytest.raises(KeyboardInterrupt):
        dm.newton(problem)
    problem.commit()
    solid = problem.solid
    assert not case.u.x.array.any() and not solid.state["plastic_strain"].x.array.any()
    assert not solid.stress.x.array.any() and not problem.committed.active.any()


# -- where there is next to nothing to solve


@pytest.mark.parametrize("qp", ["active-set", "interior-point"])
@pytest.mark.parametrize("gap", [0.0, 1e-17, -1e-15, -1e-11, 0.3])
def test_rest(gap, qp):
    """No load: gaps and overlaps of round-off size are solved or ignored, and raise nothing."""
    case = PressedBlocks(gap=gap, n_lower=(5, 3), n_upper=(4, 3))
    case.top.value[:] = 0.0
    report = dm.newton(case.problem(), qp=qp, max_it=4)
    assert report.converged
    assert np.abs(case.u.x.array).max(initial=0.0) <= max(-gap, 1e-15)


# -- what is diagnosed


@pytest.mark.mpi
def test_notes_and_failures_are_explained(case):
    """Of the last step alone; copies of a report, and its text, keep what was seen."""
    case.top.value[:] = (0.0, -0.2)
    problem = plastic(case)
    assert problem.diagnose() == []
    report = copy.deepcopy(dm.newton(problem))
    (note,) = (note for note in report.notes if "small strain" in note)
    assert f"{note}. {note.why}" in problem.diagnose() and "strain='finite'" not in str(report)
    with rejected("problem.diagnose() says more", error=dm.NewtonNotConverged) as caught:
        dm.newton(problem, max_it=1, rtol=1e-14)
    (told,) = problem.diagnose()
    assert told.startswith("Newton did not converge") and told.split(". ")[0] in str(caught.value)


@pytest.mark.parametrize("solvable", [0.99, 0.3])
def test_no_part_is_shorter_than_the_cuts_allow(case, monkeypatch, solvable):
    """A load that cannot go on is approached by parts of 1/8 at the least, in whatever order."""
    problem, tried = plastic(case), []

    def limited(problem, **options):
        fails = tried[-1] > solvable
        return solve_step(problem, **(options | {"max_it": 1, "rtol": 1e-12} if fails else options))

    def on_time(t):
        tried.append(t)
        case.top.value[1] = -0.05 * t

    monkeypatch.setattr(walking, "solve_step", limited)
    with rejected("3 of 3 cuts", error=dm.NewtonNotConverged):
        list(dm.load_steps(problem, [1.0], on_time=on_time, max_cuts=3))
    assert set(tried) <= {k / 8 for k in range(1, 9)}
    assert problem.committed.level == int(8 * solvable) / 8


@dataclass(frozen=True)
class Brittle:
    """A law that says nothing beyond a strain of 0.1."""

    E: float
    nu: float
    state: ClassVar = {}
    linear: ClassVar = False
    elastic_stress = staticmethod(dm.Elastic.elastic_stress)

    @staticmethod
    def stress(strain, state, p):
        left = ufl.sqrt(1.0 - 100.0 * ufl.inner(strain, strain))
        return left * dm.Elastic.elastic_stress(strain, p)


def test_a_law_that_becomes_no_number_is_approached(case):
    """NaN in the forces is a step that was too long: it is halved, and what fits is committed."""
    problem = case.problem(law=Brittle(1000.0, 0.0))
    ramp = {case.top: [(0.0, (0.0, 0.0)), (1.0, (0.0, -1.0))]}
    with rejected("cannot be used", "last level that converged", error=dm.NewtonNotConverged):
        list(dm.load_steps(problem, [0.05, 0.5], ramp=ramp, max_cuts=4))
    assert problem.committed.level >= 0.05 + 0.45 / 16
    assert np.isfinite(case.u.x.array).all() and np.isfinite(problem.solid.stress.x.array).all()


# -- walks


def test_cuts_can_be_forbidden_and_are_told():
    case = paper()
    with rejected("from 0 to 4", "0 of 0 cuts", error=dm.NewtonNotConverged):
        list(
            dm.load_steps(
                case.problem, [4.0], on_time=lambda t: case.press(0.05 * t), max_it=5, cuts="none"
            )
        )
    (step,) = dm.load_steps(case.problem, [4.0], on_time=lambda t: case.press(0.05 * t), max_it=5)
    assert step.report.cuts > 0 and len(step.parts) > 1
    assert any("cut" in note for note in step.report.notes)
    assert f"in {len(step.parts)} parts" in str(step)
    assert step.report.as_dict()["cuts"] == step.report.cuts


def generator(t):
    yield t


@pytest.mark.parametrize("on_time", [generator, lambda t: generator(t)])
def test_what_has_set_nothing(on_time):
    """A function with `yield` only makes a generator: its loads would stay as they were."""
    case = Blocks(PILE[:1])
    problem = case.problem([], [case.fix(0, WEST)])
    with rejected("on_time(1) returns a ", "has set nothing", "plain function"):
        list(dm.load_steps(problem, [1.0], on_time=on_time))


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
    """Of no length, it is not halved."""
    # of smooth surfaces the weighted gap of what touches in a point is an overlap of some 1e-6
    case, seen = paper(surface="facets"), []
    u = case.problem.u.x.array

    def on_time(t):
        seen.append(t)
        case.press(0.3)  # whatever the level

    with rejected("failed from 0 to 0", error=dm.NewtonNotConverged) as caught:
        list(dm.load_steps(case.problem, [0.0], on_time=on_time, max_it=1))
    told = caught.value.message
    assert seen == [0.0]
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
    first = dm.load_steps(case.problem, [1.0], on_time=lambda t: case.press(0.05 * t))
    next(first)
    second = dm.load_steps(case.problem, [0.5], on_time=lambda t: case.press(0.05 * t))
    next(second)
    u = case.problem.u.x.array.copy()
    with rejected("problem: another load_steps has begun", "make a problem for each"):
        next(first)
    assert np.array_equal(case.problem.u.x.array, u)
    assert next(second, None) is None  # it is done
    (step,) = dm.load_steps(case.problem, [0.6], on_time=lambda t: case.press(0.05 * t))
    assert step.number == 1 and case.problem.committed.level == 0.6

    def on_time(t):
        next(dm.load_steps(case.problem, [0.7], on_time=lambda t: case.press(0.05 * t)))

    with rejected("another load_steps has begun"):
        next(dm.load_steps(case.problem, [0.8], on_time=on_time))

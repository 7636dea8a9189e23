# SPDX-License-Identifier: MIT
"""Steps that cannot be solved: unconstrained bodies, unsuitable solvers, too few iterations."""

import copy
import json
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx_mortar.steps import newton as newton_module
from dolfinx_mortar.steps import walk as stepping
from tests.cases.meshes import BOTTOM, TOP
from tests.cases.pressed_blocks import PressedBlocks, failing, rejected
from tests.cases.states import state_of


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
    """The exception has the report; nothing else has changed; smaller steps go on from there."""
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
    for level in np.linspace(0.01, 0.05, 5)[1:]:
        case.top.value[:] = (0.0, -level)
        assert dm.newton(problem).converged
        problem.commit()


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


# -- load steps


def press(case, depth=0.05):
    """Return the function that sets the level of the load."""

    def on_time(t):
        case.top.value[:] = (0.0, -depth * t)

    return on_time


@pytest.mark.parametrize("solvable", [0.99, 0.3])
def test_no_part_is_shorter_than_the_cuts_allow(case, monkeypatch, solvable):
    """A load that cannot go on is approached by parts of 1/8 at the least, in whatever order."""
    problem, tried = plastic(case), []
    solve = stepping.solve_step

    def limited(problem, **options):
        fails = tried[-1] > solvable
        return solve(problem, **(options | {"max_it": 1, "rtol": 1e-12} if fails else options))

    def on_time(t):
        tried.append(t)
        press(case)(t)

    monkeypatch.setattr(stepping, "solve_step", limited)
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
    with rejected("cannot be used", "last level that converged", error=dm.NewtonNotConverged):
        list(dm.load_steps(problem, [0.05, 0.5], on_time=press(case, depth=1.0), max_cuts=4))
    assert problem.committed.level >= 0.05 + 0.45 / 16
    assert np.isfinite(case.u.x.array).all() and np.isfinite(problem.solid.stress.x.array).all()


def test_steps_that_cannot_be_cut_further(case):
    """After `max_cuts` the exception comes out, with what was committed before in place."""
    problem, tried = plastic(case), []
    first = next(dm.load_steps(problem, [0.1, 1.0], on_time=press(case)))
    assert first.report.converged
    after = case.u.x.array.copy()

    def counting(t):
        tried.append(t)
        press(case)(t)

    words = ("step 1 to time 1 ", "from 0.1 to 0.325", "2 of 2 cuts", "max_it=1")
    with rejected(*words, error=dm.NewtonNotConverged):
        list(dm.load_steps(problem, [1.0], on_time=counting, start=0.1, max_it=1, max_cuts=2))
    assert tried == pytest.approx([1.0, 0.55, 0.325])
    assert np.array_equal(case.u.x.array, after)


# -- what the backends say, and what the terminal shows

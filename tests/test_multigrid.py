# SPDX-License-Identifier: MIT
"""Contact in 3D by conjugate gradients and multigrid: the basis, the answer, the failures."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx_mortar.qp import MULTIGRID
from tests.cases.ball import create_problem
from tests.sweep.problems import create

COMM = MPI.COMM_WORLD


@pytest.fixture(scope="module")
def solved():
    """A solved problem, with the default solver."""
    problem, contact = create_problem()
    return problem, contact, dm.newton(problem)


@pytest.mark.parametrize("slave", ["block", "ball"])
def test_iterative_and_direct_solvers_agree(slave):
    forces, u = [], []
    for options in ({}, {"pc_type": "cholesky"}):
        problem, contact = create_problem(slave=slave, petsc_options=options)
        dm.newton(problem)
        forces.append(contact.force)
        u.append(problem.u.x.array.copy())
    assert np.allclose(forces[0], forces[1], rtol=0, atol=1e-7 * np.abs(forces[1]).max())
    size = COMM.allreduce(np.abs(u[1]).max(), op=MPI.MAX)
    assert np.allclose(u[0], u[1], rtol=0, atol=1e-8 * size)


# -- where multigrid fails -------------------------------------------------------------------------


@pytest.fixture
def powerless(monkeypatch):
    """Iterations end after the first one."""
    monkeypatch.setitem(MULTIGRID, "ksp_max_it", 1)


def ramped(**options):
    """The ball in two levels: the problem, the contact, and the levels' arguments."""
    problem, contact = create_problem(depth=0.0, **options)
    flat = problem.bcs[1].g.value
    return problem, contact, {"on_time": lambda level: np.copyto(flat[2:], -0.2 * level)}


@pytest.mark.usefixtures("powerless")
def test_the_remedy_is_named_where_multigrid_is_chosen(solved):
    problem, _ = create_problem(petsc_options={"pc_type": "gamg"})
    with pytest.raises(dm.NewtonNotConverged, match="choose a factorisation") as caught:
        dm.newton(problem)
    assert "gamg" in caught.value.report.linear_solver and not problem.linear.direct
    assert np.abs(problem.u.x.array).max(initial=0.0) == 0.0
    remedy = {"pc_type": "cholesky"}
    assert f"petsc_options={remedy}" in caught.value.message
    problem, contact = create_problem(petsc_options=remedy)
    assert "mumps" in dm.newton(problem).linear_solver
    assert contact.force == pytest.approx(solved[1].force, rel=1e-6, abs=1e-5)


def test_what_multigrid_cannot_solve_is_factorised(solved, monkeypatch, caplog):
    """The rest of the step, which says so, and the next ones."""
    problem, contact, levels = ramped()
    tried, solve = [], dm.qp.solve

    def watched(qp, backend, linear, **options):
        tried.append("direct" if linear.direct else "iterative")
        return solve(qp, backend, linear, **options)

    with monkeypatch.context() as patch:
        patch.setattr(dm.qp, "solve", watched)
        patch.setitem(MULTIGRID, "ksp_max_it", 1)
        steps = list(dm.load_steps(problem, [0.5, 1.0], **levels))
    assert tried.count("iterative") == 1 and tried[0] == "iterative"  # not once for each step
    assert all("mumps" in step.report.linear_solver for step in steps)
    assert [step.report.cuts for step in steps] == [0, 0]
    first, second = (step.report.notes for step in steps)
    (note,) = (note for note in first if "factorised" in note)
    assert note.startswith("cg + gamg gave no solution")
    assert not any("factorised" in note for note in second)
    assert COMM.rank > 0 or note in caplog.text
    assert contact.force == pytest.approx(solved[1].force, rel=1e-6, abs=1e-5)


@pytest.mark.parametrize("options", [{"ksp_max_it": 1}, {}])
@pytest.mark.usefixtures("powerless")
def test_what_is_not_factorised(options, monkeypatch):
    """What the user has chosen, and a large matrix."""
    if not options:
        monkeypatch.setattr("dolfinx_mortar.qp.linear.MOST_FACTORISED", 100)
    problem, _, levels = ramped(petsc_options=options)
    with pytest.raises(dm.NewtonNotConverged, match="choose a factorisation") as caught:
        list(dm.load_steps(problem, [1.0], max_cuts=0, **levels))
    assert "gamg" in caught.value.report.linear_solver


@pytest.mark.slow
def test_a_step_that_stalls_asks_for_more_accurate_programs():
    """A soft block that flows: forces that a QP misses move it, otherwise 50 times and more."""
    case = create("friction", 51, "smooth")
    steps = dm.load_steps(case.problem, case.levels[:1], on_time=case.on_time, cuts="none")
    assert next(steps).report.newton_iterations < 50


# -- one set-up for a step -------------------------------------------------------------------------


def test_number_of_iterations():
    """One set-up serves a step: 25 to 27 iterations on 1, 2 and 3 ranks."""
    problem, _ = create_problem(cell="tetrahedron", h=0.2, geometry="updated")
    report = dm.newton(problem)
    assert report.factorisations == 1
    assert sum(i.linear_iterations for i in report.iterations) <= 29


def test_the_set_up_survives_load_steps_and_searches():
    """Five small steps; no unknowns are renumbered, so that nothing has to be set up for them."""
    problem, _ = create_problem(h=0.25, geometry="updated")
    steps = list(dm.load_steps(problem, np.linspace(0.2, 1.0, 5)))
    assert sum(step.report.factorisations for step in steps) <= 2
    assert problem.linear.counts.symbolic == 1

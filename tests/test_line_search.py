# SPDX-License-Identifier: MIT
"""The length of a Newton step: what the merit needs, and where round-off decides."""

from dataclasses import replace

from mpi4py import MPI

import pytest

import dolfinx_mortar as dm
from dolfinx_mortar.common.arrays import EPS
from dolfinx_mortar.problem.linearisation import (
    find_balance,
    linearise,
    to_displacement,
)
from dolfinx_mortar.steps import line_search
from dolfinx_mortar.steps.newton import solve_step
from dolfinx_mortar.steps.subproblem import Solution
from dolfinx_mortar.terms.sum import Terms
from tests.cases.block_piles import ABOVE, BELOW, PILE, Blocks
from tests.cases.hertz import ELASTIC, PLASTIC, paper
from tests.cases.pressed_blocks import rejected
from tests.sweep.problems import create

COMM = MPI.COMM_WORLD


def test_a_step_too_long_is_halved():
    """One step far into plasticity overshoots, and the energies tell."""
    case = paper(slave="disc", geometry="reference")
    case.press(0.8)
    lengths = [i.step_length for i in dm.newton(case.problem).iterations]
    assert set(lengths) == {1.0, 0.5}


def test_energy_is_free_to_rise_where_supports_strain():
    """A pulled bar: the first step is whole, and searched it would find nothing below zero."""
    b = Blocks(PILE[:1])
    pull = b.fix(1, ABOVE, component=1, value=2e-2)
    report = dm.newton(b.problem([], [b.fix(1, BELOW), pull], law=PLASTIC))
    assert report.iterations[0].step_length == 1.0


def overlapping():
    """Return a case at equilibrium with half of its overlap left, and supports at rest."""
    case = paper(ELASTIC, gap=-0.1, geometry="reference")
    solve_step(case.problem, qp="active-set", rtol=1e-9, max_it=20, overlap=0.05)
    return case


def test_the_merit_needs_its_penalty(monkeypatch):
    """To close a violated gap the energy must rise; without the penalty no step is accepted."""
    case = overlapping()
    half = case.force
    assert dm.newton(case.problem).converged and case.force > 2.0 * half > 0.0
    case = overlapping()
    monkeypatch.setattr(line_search.Path, "excess", lambda self, t: 0.0)
    with rejected("line search", error=dm.NewtonNotConverged):
        dm.newton(case.problem)


@pytest.mark.serial
def test_the_slope_is_that_of_the_merit():
    """Energy and penalty, at the start, against the difference of their values over the step."""
    problem = overlapping().problem
    data = problem.begin_step()
    lin = linearise(problem, find_balance(problem, data))
    solved = dm.qp.solve(lin.qp, linear=problem.linear, rtol=1e-12)
    du = to_displacement(problem.system.transformation, solved.x)
    multiplier = float(solved.z.max()[1] / lin.balance.bounds.weight.min())
    path = line_search.create_path(problem, Solution(lin, solved), du, multiplier)

    def merit(t):
        problem.move(path.start + t * path.du)
        return problem.terms.energy().value + path.excess(t)

    first = line_search.find_slope(problem, lin, path)
    assert first == pytest.approx(merit(1.0) - merit(0.0) - 0.5 * du.dot(problem.K * du), rel=1e-6)
    assert first < 0.0 < -lin.balance.r.dot(du)  # the penalty alone makes it fall


def test_a_step_at_round_off_is_not_refused(monkeypatch):
    """Asked for more than the round-off of energies allows, a step ends; by values it fails."""
    known = []

    def rounded(terms, *along):
        energy = find_energy(terms, *along)
        if known and abs(energy.value - known[-1]) < 64.0 * EPS * energy.terms:
            energy = replace(energy, value=known[-1] + EPS * energy.terms)
        known.append(energy.value)
        return energy

    def walk():
        case = create("hertz", 0)
        options = {"on_time": case.on_time, "rtol": 1e-12, "cuts": "none"}
        (step,) = dm.load_steps(case.problem, case.levels[:1], **options)
        return step.report.iterations

    find_energy = Terms.energy
    monkeypatch.setattr(Terms, "energy", rounded)
    assert all(i.step_length == 1.0 for i in walk()[-3:])
    path = line_search.create_path
    monkeypatch.setattr(line_search, "EPS", 0.0)
    monkeypatch.setattr(line_search, "create_path", lambda *a: replace(path(*a), noise=0.0))
    with rejected("line search", error=dm.NewtonNotConverged):
        walk()

# SPDX-License-Identifier: MIT
"""Newton's method: its end without contact, at round-off, with moving geometry; step lengths."""

from dataclasses import replace

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import default_scalar_type, fem
from dolfinx_mortar.common.arrays import EPS
from dolfinx_mortar.problem.contacts import Contacts, Scales, measure
from dolfinx_mortar.problem.linearisation import find_balance, linearise, to_displacement
from dolfinx_mortar.steps import line_search
from dolfinx_mortar.steps.newton import solve_step
from dolfinx_mortar.steps.subproblem import Solution
from dolfinx_mortar.terms.sum import Terms
from tests.cases.ball import create_problem
from tests.cases.block_piles import ABOVE, BELOW, PILE, Blocks
from tests.cases.hertz import ELASTIC, PLASTIC, create_case, paper
from tests.cases.pressed_blocks import PressedBlocks, rejected
from tests.sweep.problems import create

COMM = MPI.COMM_WORLD


# -- steps with nothing to solve -------------------------------------------------------------------


@pytest.mark.mpi
@pytest.mark.parametrize(("geometry", "law"), [("reference", ELASTIC), ("updated", PLASTIC)])
def test_approach_and_separation_in_the_plane(geometry, law):
    """Through a gap, into contact and back: every step without contact ends at once."""
    case = paper(law, gap=0.06, geometry=geometry)
    found = []
    for depth in (0.02, 0.04, 0.1, 0.02, -0.3, -0.3):
        report = case.move(0.0, depth)
        found.append((case.force, report.newton_iterations))
    forces, iterations = zip(*found, strict=True)
    assert forces[2] > 0.0 and all(abs(forces[k]) < 1e-9 for k in (0, 1, 3, 4, 5))
    assert max(iterations[k] for k in (0, 1, 4, 5)) <= 2
    if law is ELASTIC:  # the block keeps no dent: what was pressed comes back in one solve
        assert iterations[3] <= 2


@pytest.mark.mpi
@pytest.mark.parametrize("geometry", ["updated", "reference"])
def test_rigid_travel_ends_at_once(geometry):
    """A block travels in many small steps without stress; what is left is round-off of K u."""
    pile = [(0.0, 3.0, 0.0, 0.5, 30, 5), (0.5, 1.5, 1.5, 2.0, 13, 6)]
    b = Blocks(pile, cell="quadrilateral")  # no round-off in triangles
    down = fem.Constant(b.mesh, default_scalar_type(0.0))
    contact = b.join(dm.Contact, (2, BELOW), (1, ABOVE))
    bcs = [b.fix(1, BELOW), b.fix(2, ABOVE, component=0), b.fix(2, ABOVE, 1, down)]
    problem = b.problem([contact], bcs, geometry=geometry)
    for t in np.linspace(0.0, 0.9, 21)[1:]:
        down.value = -t
        report = dm.newton(problem)
        assert report.newton_iterations <= 2
        # nothing acts, so forces are measured against K u
        assert report.certificate.equilibrium < 1e-15 and report.certificate.complementarity == 0.0
        problem.commit()
    own = b.u.x.array.reshape(-1, 2)[b.V.tabulate_dof_coordinates()[:, 1] > 1.0]
    assert np.abs(own - [0.0, -0.9]).max(initial=0.0) < 1e-12


# -- the end of a step -----------------------------------------------------------------------------


def judged(problem, contacts, data, lin, *, support=0.0):
    """Return the residuals of the present state where rtol is 1e-6; supports may ask for more."""
    balance, length = find_balance(problem, data), problem.system.facet_length
    balance = replace(balance, equal=replace(balance.equal, upper=balance.equal.upper + support))
    return measure(problem.u, balance, contacts, lin.diagonal, Scales(length), 1.0, 1e-6)


@pytest.mark.mpi
def test_what_is_out_of_balance_is_seen():
    """Solved to round-off; then forces, a multiplier, a gap or a support are spoilt by a little."""
    case = paper(ELASTIC, geometry="reference")
    case.press(0.05)
    problem = case.problem
    dm.newton(problem, rtol=1e-12)
    data = problem.begin_step()
    lin = linearise(problem, find_balance(problem, data))
    nodes = problem.system.links[0].nodes
    multipliers = np.zeros(problem.n)
    multipliers[nodes] = case.contact.multiplier
    right = Contacts(problem.committed.active, multipliers)
    exact = problem.u.x.array.copy()
    assert judged(problem, right, data, lin).forces < 1e-7

    assert judged(problem, right, data, lin, support=1e-4).excess > 100.0  # forces are exact
    weaker = Contacts(right.active, 0.999 * multipliers)
    assert judged(problem, weaker, data, lin).excess > 100.0
    free = np.flatnonzero(~problem.fixed[: problem.n].any(axis=1))[:1]
    problem.u.x.array[2 * free + 1] += 1e-4
    problem.u.x.scatter_forward()
    assert judged(problem, right, data, lin).excess > 100.0
    problem.u.x.array[:] = exact
    # all of the disc moves down with its supports: its forces stay, the gaps do not
    case.press(0.051)
    data = problem.begin_step()
    moved = judged(problem, right, data, lin)
    assert moved.forces < 1e-7 and moved.contact > 1e-4


@pytest.mark.mpi
@pytest.mark.parametrize("kind", [dm.Contact, dm.Tie])
def test_a_start_displacement_of_the_users(kind):
    """Sides that are apart at the start of a step are brought together, whatever u was set to."""
    solutions = []
    for start in (0.0, 0.02):
        case = PressedBlocks(n_lower=(5, 3), n_upper=(4, 3))
        interface = kind(case.facets, slave=3, master=4)
        problem = case.problem([interface])
        upper = fem.locate_dofs_topological(case.V, 2, case.cells.find(2))  # with those at y = 0
        case.u.x.array.reshape(-1, 2)[upper] += start
        dm.newton(problem, rtol=1e-11)
        solutions.append((case.u.x.array.copy(), interface.force.copy()))
    (u, force), (other, same) = solutions
    assert np.abs(u - other).max(initial=0.0) < 1e-10
    assert force == pytest.approx(same, rel=1e-8, abs=1e-9)


# -- moving geometry -------------------------------------------------------------------------------


@pytest.mark.parametrize("slave", ["block", "disc"])
def test_a_drag_beyond_the_search_margin(slave):
    """Dragged by 2 mm over many facets: the force of new pairings in 1 to 40 steps, 2453 N/mm."""
    case = create_case(dm.meshing.hertz(COMM, kind="graded", h=0.2), ELASTIC, slave=slave)
    case.move(0.0, 0.05)
    case.move(2.0, 0.05)
    assert case.force == pytest.approx(2453.0, rel=5e-3)
    assert abs(case.contact.force[0]) < 0.02 * case.force
    assert case.problem.system.searches > 1


def test_frozen_geometry_that_slides_is_noted():
    """Beyond a facet the pairing of the start is another problem; within one it is fine."""
    case = paper(ELASTIC, geometry="reference")
    for x, noted in ((0.1, False), (1.5, True)):
        report = case.move(x, 0.05)
        assert any("has slid" in note for note in report.notes) == noted


# -- a potential of the displacement ---------------------------------------------------------------


def test_ball_against_block_in_few_iterations():
    """What the residual end needs in 3D: elastic 1 and 4, plastic 6 and 7."""
    for law, geometry, most in (
        (ELASTIC, "reference", 1),
        (ELASTIC, "updated", 4),
        (PLASTIC, "reference", 6),
        (PLASTIC, "updated", 7),
    ):
        problem, _ = create_problem(depth=0.05, law=law, geometry=geometry)
        assert dm.newton(problem).newton_iterations <= most


# -- the length of a step --------------------------------------------------------------------------


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

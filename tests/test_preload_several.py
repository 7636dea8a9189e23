# SPDX-License-Identifier: MIT
"""Several bolts: all forces hold together, in few steps, and a failure leaves all as it was."""

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx_mortar.steps import tightening
from dolfinx_mortar.steps.report import StepReport
from tests.block_piles import ABOVE, BELOW, COMM, Blocks
from tests.pressed_blocks import rejected

E = 1000.0
SOUGHT = 1e-6


class Flange:
    """Bolts (unit sections, length 2) beside gaskets (width 1, height 2) under a stiff yoke.

    From left to right gasket, bolt, gasket, bolt, .., gasket; all without Poisson's ratio, so that
    they are springs: E / 2 of a bolt, the gasket's E / 2 of a gasket.
    """

    def __init__(self, count, *, gasket=E, law=None):
        """Create the parts and the problem."""
        boxes, contacts, cuts = [], [], []
        columns = 2 * count + 1
        for k in range(columns):
            if k % 2:
                cuts.append(len(boxes) + 1)
                boxes += [(k, k + 1, 0, 1, 1, 1), (k, k + 1, 1, 2, 1, 1)]
            else:
                contacts.append(len(boxes) + 1)
                boxes.append((k, k + 1, 0, 2, 1, 1))
        boxes.append((0, columns, 2, 3, 2 * columns, 1))
        yoke = len(boxes)
        b = Blocks(boxes, cell="quadrilateral")
        laws = {k: law or dm.Elastic(E, 0.0) for k in range(1, yoke)}
        laws |= {k: dm.Elastic(gasket, 0.0) for k in contacts}
        laws[yoke] = dm.Elastic(1e4 * E, 0.0)
        self.bolts = [
            dm.Tie(b.facets, slave=10 * (k + 1) + BELOW, master=10 * k + ABOVE) for k in cuts
        ]
        heads = [
            dm.Tie(b.facets, slave=10 * (k + 1) + ABOVE, master=10 * yoke + BELOW) for k in cuts
        ]
        gaskets = [
            dm.Contact(b.facets, slave=10 * k + ABOVE, master=10 * yoke + BELOW) for k in contacts
        ]
        feet = [b.fix(k, BELOW) for k in (*contacts, *cuts)]
        bcs = [*feet, b.fix(yoke, ABOVE, component=0)]
        solid = dm.Solid(b.u, laws, b.cells)
        self.problem = dm.ContactProblem(solid, [*self.bolts, *heads, *gaskets], bcs=bcs)

    def tensions(self):
        """Return the forces of the bolts."""
        return [-bolt.force[1] for bolt in self.bolts]


def shown(problem, ties):
    """Return what a failure must leave as it was."""
    found = [problem.u.x.array.copy(), problem.solid.stress.x.array.copy()]
    return [*found, *(tie.tightening.copy() for tie in ties), *(tie.force.copy() for tie in ties)]


@pytest.mark.mpi
@pytest.mark.parametrize("gasket", [E, 0.05 * E])
def test_all_forces_hold_together(gasket):
    """On a soft gasket each bolt lets go of the others: passes alone would take hundreds."""
    flange, forces = Flange(3, gasket=gasket), [3.0, 5.0, 4.0]
    wanted = dict(zip(flange.bolts, forces, strict=True))
    found = dm.preload(flange.problem, wanted, direction=[0.0, -1.0])
    assert flange.tensions() == pytest.approx(forces, rel=2 * SOUGHT)
    assert [found[bolt].force for bolt in flange.bolts] == pytest.approx(forces, rel=2 * SOUGHT)
    first = found[flange.bolts[0]]
    assert first.report.converged and first.iterations == len(first.reports) <= 18
    assert all((found[bolt].jump == bolt.tightening).all() for bolt in flange.bolts)
    if gasket == E:
        again = dm.preload(flange.problem, wanted, direction=dict.fromkeys(wanted, (0, -2)))
        assert again[flange.bolts[0]].iterations == 1  # they are there already
    dm.newton(flange.problem, rtol=1e-9)  # and stay
    assert flange.tensions() == pytest.approx(forces, rel=10 * SOUGHT)


def test_bolts_that_yield():
    """What was tried leaves no trace: as one step with the jumps that were found."""
    law = dm.VonMises(E, 0.0, 5.0, 50.0)
    flange, forces = Flange(2, law=law), [7.0, 6.5]
    found = dm.preload(
        flange.problem, dict(zip(flange.bolts, forces, strict=True)), direction=[0.0, -1.0]
    )
    assert flange.tensions() == pytest.approx(forces, rel=2 * SOUGHT)
    flown = flange.problem.solid.state["plastic_strain"].x.array.copy()
    other = Flange(2, law=law)
    for bolt, old in zip(other.bolts, flange.bolts, strict=True):
        bolt.tightening = found[old].jump
    dm.newton(other.problem, rtol=1e-9)
    other.problem.commit()
    now = other.problem.solid.state["plastic_strain"].x.array
    largest = np.abs(flown).max(initial=0.0)
    assert largest > 1e-4 and np.abs(flown - now).max(initial=0.0) < 1e-5 * largest


@pytest.mark.mpi
def test_a_failure_leaves_all_as_it_was(monkeypatch):
    flange = Flange(2)
    dm.preload(flange.problem, dict.fromkeys(flange.bolts, 1.0), direction=[0.0, -1.0])
    before = shown(flange.problem, flange.bolts)
    solve, most = tightening.solve_step, 4.0 / E

    def refuse(problem, **options):
        if -flange.bolts[1].tightening[1] > most:
            raise dm.NewtonNotConverged("too far", StepReport())
        return solve(problem, **options)

    monkeypatch.setattr(tightening, "solve_step", refuse)
    wanted = dict(zip(flange.bolts, (2.0, 9.0), strict=True))
    with rejected("force 9", "too far", error=dm.PreloadNotReached):
        dm.preload(flange.problem, wanted, direction=[0.0, -1.0])
    assert all(map(np.array_equal, before, shown(flange.problem, flange.bolts)))


@pytest.mark.parametrize("bad", ["refused", "worse"])
def test_a_step_for_all_that_is_no_use_is_taken_back(bad, monkeypatch):
    """It fails, or makes it worse: the bolts are brought to their forces one by one."""
    flange, forces = Flange(2), [3.0, 5.0]
    solve, solve_step, tried = np.linalg.lstsq, tightening.solve_step, []

    def refuse(problem, **options):
        tried.append(max(-bolt.tightening[1] for bolt in flange.bolts))
        if tried[-1] > 0.1:
            raise dm.NewtonNotConverged("no", StepReport())
        return solve_step(problem, **options)

    factor = -2.0 if bad == "worse" else 1e4
    monkeypatch.setattr(np.linalg, "lstsq", lambda A, b: (factor * solve(A, b)[0],))
    monkeypatch.setattr(tightening, "solve_step", refuse)
    monkeypatch.setattr(tightening, "farthest", lambda problem: 1e9)
    dm.preload(flange.problem, dict(zip(flange.bolts, forces, strict=True)), direction=[0.0, -1.0])
    assert flange.tensions() == pytest.approx(forces, rel=2 * SOUGHT)
    assert (max(tried) > 0.1) == (bad == "refused")


def test_lines_tell_how_far_it_has_come(capfd):
    flange = Flange(2)
    wanted = dict.fromkeys(flange.bolts, 3.0)
    dm.preload(flange.problem, wanted, direction=[0.0, -1.0], progress=True)
    told = [line for line in capfd.readouterr().err.splitlines() if line.startswith("preload")]
    assert len(told) >= 3 and told[-1].endswith("forces 3 3 of 3 3")
    dm.preload(flange.problem, wanted, direction=[0.0, -1.0], progress=False)
    assert "preload" not in capfd.readouterr().err


@pytest.mark.mpi
def test_arguments_that_are_none():
    flange, other = Flange(2), Flange(1)
    problem, (left, right) = flange.problem, flange.bolts
    down = [0.0, -1.0]
    for words, wanted, options in (
        (("tie is an empty",), {}, {"direction": down}),
        (("force is [0.0, -1.0]", "direction=..."), {left: 1.0}, {"force": down}),
        (("direction is None", "2 finite components"), {left: 1.0}, {}),
        (("direction has", "one for all"), {left: 1.0, right: 1.0}, {"direction": {left: down}}),
        (("tie is ", "problem.ties"), {left: 1.0, other.bolts[0]: 1.0}, {"direction": down}),
        (("force is 'x'", "finite number"), {left: 1.0, right: "x"}, {"direction": down}),
        (("into the slave side",), {left: 1.0, right: 1.0}, {"direction": [0.0, 1.0]}),
        (("progress is 3",), {left: 1.0}, {"direction": down, "progress": 3}),
    ):
        with rejected(*words):
            dm.preload(problem, wanted, **options)
    with rejected("found in max_it=2 steps for each bolt", error=dm.PreloadNotReached):
        dm.preload(problem, {left: 3.0, right: 4.0}, direction=down, max_it=2)
    if COMM.size > 1:
        with rejected("tie[0]", "differs between the ranks"):
            dm.preload(problem, {(left, right)[COMM.rank > 0]: 1.0}, direction=down)
    unhashable = [left]
    with rejected("tie is [", "problem.ties"):
        dm.preload(problem, unhashable, 1.0, down)

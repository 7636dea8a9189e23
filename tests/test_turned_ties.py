# SPDX-License-Identifier: MIT
"""Ties of bodies with large rotations: notes on jumps and distances that do not rotate.

A body under forces that turn with it carries the same stress in each direction: whatever a tie
changes under a rotation is its error.
"""

import re

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from tests.meshes import BOTTOM, BOTTOM_OF_UPPER, TOP, TOP_OF_LOWER, two_blocks
from tests.pressed_blocks import COMM

pytestmark = pytest.mark.mpi

RUBBER = dm.NeoHooke(E=10.0, nu=0.3)
KEPT, APART, UNCOUPLED = "has kept its direction", "apart at X", "lie in each other"


def rotation(angle):
    """Return the matrix that turns by an angle."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


class Turned:
    """Two blocks that are tied; those of their ends that are held turn about the origin."""

    def __init__(self, *, held=(BOTTOM, TOP), strain="finite", law=RUBBER, tie=None, **options):
        """Create the problem; the other options are those of `two_blocks`."""
        self.mesh, cells, tags = two_blocks(COMM, cell="quadrilateral", **options)
        V = fem.functionspace(self.mesh, ("Lagrange", 1, (2,)))
        self.solid = dm.Solid(fem.Function(V), law, cells, strain=strain)
        self.ends = fem.Function(V)
        dofs = [fem.locate_dofs_topological(V, 1, tags.find(tag)) for tag in held]
        self.tie = dm.Tie(tags, slave=BOTTOM_OF_UPPER, master=TOP_OF_LOWER, **(tie or {}))
        bcs = [fem.dirichletbc(self.ends, d) for d in dofs]
        self.problem = dm.ContactProblem(self.solid, [self.tie], bcs=bcs)

    def turn(self, angle):
        """Prescribe the ends at a rotation from X."""
        self.ends.interpolate(lambda x: (rotation(angle) - np.eye(2)) @ x[:2])

    def walk(self, degrees, also=lambda angle: None):
        """Turn in steps; return their reports."""

        def on_time(angle):
            self.turn(angle)
            also(angle)

        levels = np.radians(degrees)
        walk = dm.load_steps(self.problem, levels, on_time=on_time, progress=False)
        return [step.report for step in walk]

    def along(self, angle):
        """Return the force of the bolt along its axis, which has turned."""
        return float(self.tie.force @ rotation(angle) @ [0.0, -1.0])


def told(report, word):
    """Return how many notes have a word."""
    return sum(word in note for note in report.notes)


def test_a_bolt_whose_jump_does_not_turn_loses_force_and_is_told():
    case = Turned()
    dm.preload(case.problem, case.tie, 0.3, direction=[0.0, -1.0])
    slight, far = case.walk([1.0, 60.0])
    assert case.along(np.pi / 3) < 0.2
    assert [told(report, KEPT) for report in (slight, far)] == [0, 1]
    (note,) = (note for note in far.notes if KEPT in note)
    (degrees,) = re.findall(r"turned by (\d+) degrees", note)
    assert abs(int(degrees) - 60) <= 2  # the middle of the bar is a little behind
    assert "tie.tightening" in note


def test_a_bolt_whose_jump_is_turned_keeps_its_force_without_a_note():
    case = Turned()
    dm.preload(case.problem, case.tie, 0.3, direction=[0.0, -1.0])
    start = case.tie.tightening.copy()

    def turn_bolt(angle):
        case.tie.tightening = rotation(angle) @ start

    for report in case.walk([10.0, 60.0], turn_bolt):
        assert not told(report, KEPT)
    assert case.along(np.pi / 3) == pytest.approx(0.3, rel=1e-6)


def test_a_bolt_that_is_tightened_after_a_turn_counts_from_there():
    case = Turned()
    case.walk([60.0])
    axis = rotation(np.pi / 3) @ [0.0, -1.0]
    tight = dm.preload(case.problem, case.tie, 0.3, direction=axis)
    assert not told(tight.report, KEPT)
    assert told(case.walk([90.0])[-1], KEPT)


def test_since_when_a_jump_has_its_direction_is_state(tmp_path):
    """It is saved, and what is not committed does not change it."""
    case, again = Turned(), Turned()
    case.walk([60.0])
    dm.preload(case.problem, case.tie, 0.3, direction=rotation(np.pi / 3) @ [0.0, -1.0])
    path = COMM.bcast(tmp_path) / "tight.h5"
    case.problem.save(path)
    tight, u = case.tie.tightening, case.solid.u.x.array.copy()
    case.tie.tightening = rotation(np.pi / 9) @ tight
    case.turn(np.radians(80.0))
    dm.newton(case.problem)  # and no commit
    case.tie.tightening, case.solid.u.x.array[:] = tight, u
    again.problem.restore(path)
    for one in (case, again):
        (note,) = (note for note in one.walk([90.0])[-1].notes if KEPT in note)
        (degrees,) = re.findall(r"turned by (\d+) degrees", note)
        assert abs(int(degrees) - 30) <= 1


def test_small_strain_has_its_own_notes():
    case = Turned(strain="small", law=dm.Elastic(10.0, 0.3))
    dm.preload(case.problem, case.tie, 0.3, direction=[0.0, -1.0])
    assert not told(case.walk([10.0])[-1], KEPT)


@pytest.mark.parametrize(
    ("surface", "left_out"), [("smooth", 1 - np.cos(np.pi / 3)), ("facets", 2 * np.sin(np.pi / 6))]
)
def test_sides_that_are_apart_do_not_turn_that_far(surface, left_out):
    case = Turned(held=[BOTTOM], gap=0.1, tie={"surface": surface})
    slight, far = case.walk([1.0, 60.0])
    x = case.solid.V.tabulate_dof_coordinates()[:, :2]
    error = case.solid.u.x.array.reshape(-1, 2) - x @ (rotation(np.pi / 3).T - np.eye(2))
    lengths = np.linalg.norm(error, axis=1)
    largest = COMM.allreduce(lengths.max(initial=0.0), op=MPI.MAX)
    assert largest == pytest.approx(0.1 * left_out, rel=1e-6)
    assert [told(report, APART) for report in (slight, far)] == [0, 1]
    (note,) = (note for note in far.notes if APART in note)
    assert f"up to {0.1 * left_out:.3g}" in note


def test_sides_that_fit_turn_as_far_as_they_like():
    case = Turned(held=[BOTTOM])
    (report,) = case.walk([90.0])
    assert not report.notes


@pytest.mark.parametrize("strain", ["small", "finite"])
def test_a_tight_bolt_does_not_lie_in_itself(strain):
    case = Turned(strain=strain, law=RUBBER if strain == "finite" else dm.Elastic(10.0, 0.3))
    tight = dm.preload(case.problem, case.tie, 0.3, direction=[0.0, -1.0])
    assert tight.jump[1] < -0.05  # a sixth of the upper facets
    assert not told(tight.report, UNCOUPLED)
    assert tight.report.certificate.crossing < 0.01


def test_a_rigid_side_that_turns_is_no_tie():
    """All of it moves with the plate: nothing to tell."""
    case = Turned(held=[BOTTOM])
    plate = dm.RigidSide(case.tie.facet_tags, TOP, reference=(0.5, 1.0))
    problem = dm.ContactProblem(case.solid, [case.tie, plate], bcs=case.problem.bcs)
    case.turn(np.pi / 6)
    plate.rotation.value = np.pi / 6
    plate.position.value[:] = rotation(np.pi / 6) @ [0.5, 1.0]
    report = dm.newton(problem)
    assert not told(report, KEPT)
    assert not told(report, APART)

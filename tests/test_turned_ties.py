# SPDX-License-Identifier: MIT
"""Ties of bodies with large rotations: jumps and distances do not rotate.

A body under forces that turn with it carries the same stress in each direction: whatever a tie
changes under a rotation is its error.
"""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from tests.cases.meshes import BOTTOM, TOP
from tests.cases.meshes_3d import rotation as space_rotation
from tests.cases.pressed_blocks import COMM
from tests.cases.tightened_bar import tighten
from tests.cases.two_bodies import TwoBodies

pytestmark = pytest.mark.mpi

RUBBER = dm.NeoHooke(E=10.0, nu=0.3)


def rotation(angle):
    return space_rotation((0, 0, 1), angle)[:2, :2]


class Turned:
    """Two blocks that are tied; those of their ends that are held turn about the origin."""

    def __init__(self, *, held=(BOTTOM, TOP), strain="finite", law=RUBBER, tie=None, **options):
        """Create the problem; the other options are those of `two_blocks`."""
        case = TwoBodies("quadrilateral", **options)
        self.ends, self.tie = fem.Function(case.V), case.interface(dm.Tie, swap=True, **(tie or {}))
        bcs = [case.held(tag, self.ends) for tag in held]
        self.problem = case.problem([self.tie], bcs, law, strain=strain)

    def walk(self, degrees, also=lambda angle: None):
        """Turn in steps; return their reports."""

        def on_time(angle):
            self.ends.interpolate(lambda x: (rotation(angle) - np.eye(2)) @ x[:2])
            also(angle)

        levels = np.radians(degrees)
        walk = dm.load_steps(self.problem, levels, on_time=on_time, progress=False)
        return [step.report for step in walk]


@pytest.mark.parametrize("turned", [False, True])
def test_a_bolt_keeps_its_force_if_its_jump_is_turned(turned):
    case = Turned()
    tighten(case.problem, {case.tie: 0.3}, [0.0, -1.0])
    start = case.tie.tightening.copy()

    def turn_bolt(angle):
        if turned:
            case.tie.tightening = rotation(angle) @ start

    case.walk([10.0, 60.0], turn_bolt)
    found = float(case.tie.force @ rotation(np.pi / 3) @ [0.0, -1.0])
    assert found == pytest.approx(0.3, rel=1e-6) if turned else found < 0.2


@pytest.mark.parametrize(
    ("surface", "left_out"), [("smooth", 1 - np.cos(np.pi / 3)), ("facets", 2 * np.sin(np.pi / 6))]
)
def test_sides_that_are_apart_do_not_turn_that_far(surface, left_out):
    case = Turned(held=[BOTTOM], gap=0.1, tie={"surface": surface})
    case.walk([60.0])
    u = case.problem.u
    x = u.function_space.tabulate_dof_coordinates()[:, :2]
    error = u.x.array.reshape(-1, 2) - x @ (rotation(np.pi / 3).T - np.eye(2))
    lengths = np.linalg.norm(error, axis=1)
    largest = COMM.allreduce(lengths.max(initial=0.0), op=MPI.MAX)
    assert largest == pytest.approx(0.1 * left_out, rel=1e-6)


def test_sides_that_fit_turn_as_far_as_they_like():
    case = Turned(held=[BOTTOM])
    (report,) = case.walk([90.0])
    assert not report.notes


@pytest.mark.parametrize("strain", ["small", "finite"])
def test_a_tight_bolt_does_not_lie_in_itself(strain):
    case = Turned(strain=strain, law=RUBBER if strain == "finite" else dm.Elastic(10.0, 0.3))
    tight = tighten(case.problem, {case.tie: 0.3}, [0.0, -1.0])
    assert case.tie.tightening[1] < -0.05  # a sixth of the upper facets
    assert tight.certificate.crossing < 0.01

# SPDX-License-Identifier: MIT
"""Bolts in steps: the diagram of a bolted joint, directions, failures."""

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx_mortar.interfaces import pretension
from tests.cases.bolted_joint import Joint
from tests.cases.glued_bar import COMM, CONFINED, NU, Bar, E
from tests.cases.meshes import BOTTOM, LEFT, TOP
from tests.cases.pressed_blocks import failing
from tests.cases.tightened_bar import Watched, clamped, loaded, outwards, tighten

SOUGHT = 1e-6  # relative accuracy of the force
F0 = 6.0


def tension(case):
    """Return the force of the tie along the direction out of the slave side."""
    return float(case.tie.force @ outwards(case))


# -- a bolted joint


@pytest.mark.mpi
@pytest.mark.parametrize("slave", ["upper", "lower"])
def test_the_diagram_of_a_bolted_joint(slave):
    """The bolt's force grows by a third of the pull until the plates part, then by all of it."""
    joint = Joint(slave=slave)
    tighten(joint.problem, {joint.bolt: F0}, joint.direction, rtol=1e-8)
    stretch = joint.direction[1] * F0 / E * (2 + 1)
    assert joint.bolt.tightening[1] == pytest.approx(stretch, rel=1e-4)
    assert joint.tension() == pytest.approx(F0, rel=1e-8)
    assert joint.clamping() == pytest.approx(F0, rel=3e-8)
    for pull in (3.0, 8.9, 9.1, 12.0, 0.0):
        joint.pull.value = pull
        dm.newton(joint.problem, rtol=1e-11)
        joint.problem.commit()
        assert joint.tension() == pytest.approx(max(F0 + pull / 3, pull), rel=1e-4)
        assert joint.clamping() == pytest.approx(max(F0 - 2 * pull / 3, 0.0), rel=1e-3, abs=1e-8)
        assert abs(joint.tension() - joint.clamping() - pull) < 1e-8 * F0
        closed = joint.problem.committed.active.any()
        assert COMM.allreduce(int(closed)) > 0 if pull < 1.5 * F0 else not closed


# -- what cannot be


def test_plastic_collapse():
    """A strip in plane strain carries sqrt(2) Y, the limit."""
    Y = 2.0
    case = Bar("quadrilateral", law=dm.VonMises(E, NU, Y, 0.0))
    problem = case.problem([case.hold(BOTTOM, 1), case.hold(TOP, 1), case.hold(LEFT, 0)])
    limit = np.sqrt(2.0) * Y
    tighten(problem, {case.tie: 0.5 * limit}, outwards(case))
    watched = Watched(case, problem)
    with failing(problem, "limit load", "hardening", "as before"):
        tighten(problem, {case.tie: 1.1 * limit}, outwards(case))
    assert watched.unchanged()
    tighten(problem, {case.tie: 0.98 * limit}, outwards(case))
    assert tension(case) == pytest.approx(0.98 * limit, rel=SOUGHT)


@pytest.mark.mpi
def test_a_force_of_another_unit():
    """An elastic bar does not flow, its force is too large."""
    case, problem = loaded()
    watched = Watched(case, problem)
    with failing(problem, "pretension", "check units", "as before"):
        tighten(problem, {case.tie: -1e9}, outwards(case))
    assert watched.unchanged()


# -- directions


def warned(case, problem, direction):
    """Return what the audit says of a direction."""
    case.tie.pretension, case.tie.direction = 1.0, direction
    return [line for line in problem.audit().warnings if "direction is" in line]


@pytest.mark.mpi
def test_a_direction_along_the_cut():
    """Warned of, with its cosine; what is said goes with an angle, not with a mesh."""
    case, problem = loaded(slave="lower")
    (line,) = warned(case, problem, [1.0, 0.0])
    assert "direction is [1.0, 0.0]" in line and "is 0: " in line and "axis of the bolt" in line
    for angle, count in ((60.0, 0), (-66.0, 1)):
        a = np.radians(angle)
        n = np.cos(a) * outwards(case) + np.sin(a) * np.array([1.0, 0.0])
        assert len(warned(case, problem, n)) == count, angle


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.5, 2.0])
@pytest.mark.parametrize("name", ["AROUND", "ALONG"])
def test_no_number_changes_an_answer(name, factor, monkeypatch):
    monkeypatch.setattr(pretension, name, factor * getattr(pretension, name))
    case, problem = clamped()
    case.tie.jump = [0.0, -1e-3]
    for force in (30.0, 5.0):
        tighten(problem, {case.tie: force}, outwards(case))
        assert case.tie.tightening[1] == pytest.approx(1e-3 - 2 * force / CONFINED, rel=1e-5)

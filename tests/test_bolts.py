# SPDX-License-Identifier: MIT
"""Bolts: the overlap for a force, signs, the diagram of a bolted joint, directions."""

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from dolfinx_mortar.interfaces import pretension
from dolfinx_mortar.problem import step_data
from tests.cases.bolted_joint import Joint
from tests.cases.glued_bar import CELLS, COMM, CONFINED, NU, Bar, E, largest
from tests.cases.meshes import BOTTOM, LEFT, TOP
from tests.cases.pressed_blocks import failing, rejected
from tests.cases.tightened_bar import Watched, clamped, loaded, outwards, tighten

SOUGHT = 1e-6  # relative accuracy of the force


# -- the jump for a force


def tension(case):
    """Return the force of the tie along the direction out of the slave side."""
    return float(case.tie.force @ outwards(case))


@pytest.mark.parametrize("slave", ["upper", "lower"])
@pytest.mark.parametrize(("cell", "force"), [*((c, 30.0) for c in CELLS), (CELLS[1], -30.0)])
def test_an_elastic_bar_between_walls(cell, force, slave):
    """F = E_c s / L on a unit section, in one iteration; positive is tension, either slave."""
    case, problem = clamped(cell, slave=slave)
    report = tighten(problem, {case.tie: force}, 7.0 * outwards(case))
    s = 2.0 * force / CONFINED
    assert np.allclose(case.tie.tightening, s * outwards(case), rtol=2 * SOUGHT, atol=1e-12)
    assert tension(case) == pytest.approx(force, rel=SOUGHT)
    assert report.newton_iterations == 1 and case.tie.jump is None
    upper = case.tie.force if slave == "upper" else case.tie.master_force
    assert upper[case.d - 1] == pytest.approx(-force, rel=SOUGHT)  # tension pulls it down
    assert np.allclose(case.tie.gather(case.u)["pressure"], -force, rtol=1e-5)


def test_loads_of_the_moment_count_and_the_jump_is_held():
    """The force is reached with the load; when it goes, the bar keeps its jump."""
    case, _ = clamped()
    load = fem.Constant(case.mesh, 12.0)
    v, ds = ufl.TestFunction(case.V), ufl.Measure("ds", case.mesh, subdomain_data=case.facets)
    bcs = [*case.rollers(), case.hold(BOTTOM, 1)]
    spring = 0.5 * CONFINED * case.u[1] ** 2 * ds(TOP)
    problem = case.problem(bcs, loads=load * v[1] * ds(TOP), potential=spring)
    tighten(problem, {case.tie: 30.0}, outwards(case))
    # bar and spring in series carry (load share 2/3 of 12) + s C / 3
    s = (30.0 - 12.0 * (1 / 2) / (1 / 2 + 1)) / (CONFINED / 3)
    assert case.tie.tightening[1] == pytest.approx(-s, rel=1e-5)
    load.value = 0.0
    dm.newton(problem)
    assert case.tie.force[1] == pytest.approx(-s * CONFINED / 3, rel=1e-5)


def test_it_is_added_to_the_jump_and_tightened_again_from_where_it_is():
    case, problem = clamped()
    case.tie.jump = [0.0, -1e-3]
    for force in (30.0, 50.0, 0.0):
        tighten(problem, {case.tie: force}, outwards(case))
        assert case.tie.tightening[1] == pytest.approx(1e-3 - 2 * force / CONFINED, rel=1e-4)
    assert abs(tension(case)) < 50.0 * SOUGHT
    before = case.tie.tightening
    assert tighten(problem, {case.tie: 0.0}, outwards(case)).newton_iterations == 1
    assert case.tie.tightening[1] == pytest.approx(before[1], rel=1e-9)  # it was there already


def test_what_a_tightening_before_has_moved_across_stays():
    """Sheared first, then pulled: the second direction adds to the first one's jump."""
    case, problem = loaded()
    tighten(problem, {case.tie: 3.0}, [1.0, 0.0])
    across = case.tie.tightening[0]
    tighten(problem, {case.tie: 30.0}, outwards(case))
    assert abs(across) > 1e-4 and case.tie.tightening[0] == across
    assert tension(case) == pytest.approx(30.0, rel=SOUGHT)
    assert case.tie.force[0] == pytest.approx(3.0, rel=0.05)


def test_half_a_bolt_has_half_the_force():
    """A bar on its plane of symmetry: the resultant is that of what is modelled."""
    whole, problem = clamped()
    tighten(problem, {whole.tie: 30.0}, outwards(whole))
    half, problem = clamped(x_lower=(0.0, 0.5), x_upper=(0.0, 0.5))
    tighten(problem, {half.tie: 15.0}, outwards(half))
    assert half.tie.tightening[1] == pytest.approx(whole.tie.tightening[1], rel=1e-5)


@pytest.mark.mpi
def test_a_bar_beyond_yield_is_tightened_as_by_one_step():
    """K eps + sqrt(2/3) Y = F; the plastic strain is that of a step with the jump."""
    Y, force = 2.0, 12.0
    case, problem = clamped(law=dm.VonMises(E, NU, Y, 0.0))
    report = tighten(problem, {case.tie: force}, outwards(case))
    jump = case.tie.tightening
    bulk = E / (3 * (1 - 2 * NU))
    assert jump[1] == pytest.approx(-2.0 * (force - np.sqrt(2 / 3) * Y) / bulk, rel=1e-5)
    assert 1 < report.newton_iterations <= 4
    flown = case.solid.state["plastic_strain"].x.array.copy()  # committed
    again, problem = clamped(law=dm.VonMises(E, NU, Y, 0.0))
    again.tie.jump = jump
    dm.newton(problem, rtol=1e-8)
    problem.commit()
    assert largest(flown) > 1e-3
    assert largest(flown - again.solid.state["plastic_strain"].x.array) < 1e-8 * largest(flown)
    # unloading by half of the elastic range: the plastic strain stays
    shear = E / (2 * (1 + NU))
    less = np.abs(jump[1]) - Y * np.sqrt(2 / 3) / (2 / 3 * shear) / 2
    again.tie.jump = [0.0, -less]
    dm.newton(problem)
    drop = CONFINED * (np.abs(jump[1]) - less) / 2
    assert again.tie.force[1] == pytest.approx(-(force - drop), rel=1e-5)


# -- a bolted joint


@pytest.mark.mpi
@pytest.mark.parametrize("slave", ["upper", "lower"])
def test_the_diagram_of_a_bolted_joint(slave):
    """The bolt's force grows by a third of the pull until the plates part, then by all of it."""
    joint, F0 = Joint(slave=slave), 6.0
    tighten(joint.problem, {joint.bolt: F0}, joint.direction, rtol=1e-8)
    assert joint.bolt.tightening[1] == pytest.approx(
        joint.direction[1] * F0 / E * (2 + 1), rel=1e-4
    )
    assert joint.tension() == pytest.approx(F0, rel=1e-8)
    assert joint.clamping() == pytest.approx(F0, rel=3e-8)
    for pull in (3.0, 8.0, 8.9, 9.1, 12.0, 4.0, 0.0):
        joint.pull.value = pull
        dm.newton(joint.problem, rtol=1e-11)
        joint.problem.commit()
        assert joint.tension() == pytest.approx(max(F0 + pull / 3, pull), rel=1e-4)
        assert joint.clamping() == pytest.approx(max(F0 - 2 * pull / 3, 0.0), rel=1e-3, abs=1e-8)
        assert abs(joint.tension() - joint.clamping() - pull) < 1e-8 * F0
        closed = joint.problem.committed.active.any()
        assert COMM.allreduce(int(closed)) > 0 if pull < 1.5 * F0 else not closed


def test_a_gap_under_the_yoke_closes_first():
    """Until then only the yoke's weight, here a push, is carried, by the bolt alone."""
    joint, F0, gap = Joint(gap=0.01), 6.0, 0.01
    joint.pull.value = -1.0
    tighten(joint.problem, {joint.bolt: F0}, joint.direction)
    # the bolt shrinks by the gap and what the plates yield, and is stretched by F0
    plates = (F0 + 1.0) * (2.0 - gap) / (2 * E)
    assert -joint.bolt.tightening[1] == pytest.approx(gap + plates + F0 / (E / 2), rel=1e-4)
    assert joint.clamping() == pytest.approx(F0 + 1.0, rel=1e-6)


def test_bolts_are_found_in_load_steps_too():
    """A pretension, then a walk: the level and the history are those of the walk alone."""
    joint, F0 = Joint(), 6.0
    tighten(joint.problem, {joint.bolt: F0}, joint.direction)
    assert joint.problem.committed.level == 0.0 and not joint.problem.history
    found = []
    for _ in dm.load_steps(
        joint.problem, [3.0, 6.0], on_time=lambda t: joint.pull.value.fill(t), progress=False
    ):
        found.append(joint.tension())
    assert np.allclose(found, [F0 + 1.0, F0 + 2.0], rtol=1e-4)


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
def test_a_step_that_leads_too_far_is_undone(monkeypatch):
    """The next step starts from the contacts that were closed before: none, the plates gape."""
    joint = Joint(gap=0.01)
    problem = joint.problem
    joint.pull.value = -1.0
    dm.newton(problem, rtol=1e-11)
    problem.commit()
    before = [joint.u.x.array.copy(), joint.bolt.force, joint.bolt.tightening]
    monkeypatch.setattr(step_data, "diagonal", lambda V: 0.011)  # the gap closes before
    words = ("the pretension of", "an overlap of 0.02897", "check units", "as before")
    with rejected(*words, error=dm.NewtonNotConverged):
        tighten(problem, {joint.bolt: 6.0}, joint.direction)
    assert not problem.committed.active.any() and joint.clamping() == 0.0
    after = [joint.u.x.array, joint.bolt.force, joint.bolt.tightening]
    assert all(map(np.array_equal, before, after))
    dm.newton(problem, rtol=1e-11)  # and the tie holds its jump again
    assert np.allclose(joint.u.x.array, before[0], rtol=0.0, atol=1e-9)


@pytest.mark.mpi
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_force_of_another_unit(sign):
    """An elastic bar does not flow, its force is too large."""
    case, problem = loaded()
    watched = Watched(case, problem)
    with failing(problem, "pretension", "check units", "as before"):
        tighten(problem, {case.tie: sign * 1e9}, outwards(case))
    assert watched.unchanged()


@pytest.mark.parametrize("length", [1e300, 1e-320])
def test_a_direction_of_any_length(length):
    """Also where its square is none."""
    case, problem = loaded()
    tighten(problem, {case.tie: 1.0}, length * outwards(case))
    assert tension(case) == pytest.approx(1.0, rel=SOUGHT)


# -- directions


def warned(case, problem, direction):
    """Return what the audit says of a direction."""
    case.tie.pretension, case.tie.direction = 1.0, direction
    return [line for line in problem.audit().warnings if "direction is" in line]


@pytest.mark.mpi
@pytest.mark.parametrize("slave", ["upper", "lower"])
def test_a_direction_along_the_cut(slave):
    """Warned of, with its cosine; what is said goes with an angle, not with a mesh."""
    case, problem = loaded(slave=slave)
    (line,) = warned(case, problem, [1.0, 0.0])
    assert "direction is [1.0, 0.0]" in line and "is 0: " in line and "axis of the bolt" in line
    for angle, count in ((0.0, 0), (60.0, 0), (66.0, 1), (-60.0, 0), (-66.0, 1)):
        a = np.radians(angle)
        n = np.cos(a) * outwards(case) + np.sin(a) * np.array([1.0, 0.0])
        assert len(warned(case, problem, n)) == count, angle


def test_a_cut_that_is_inclined():
    """Its normal counts, and the axis of the bolt may lean to it."""
    case = Bar("quadrilateral", angle=np.radians(55.0))
    problem = case.problem([case.hold(BOTTOM), case.hold(TOP)])
    assert not warned(case, problem, [0.0, -1.0])
    assert len(warned(case, problem, [1.0, 1.4])) == 1


# -- numbers


def ends():
    """Return what pretensions of an elastic bar find, and what is said where nothing resists."""
    case, problem = clamped()
    found = []
    for force in (30.0, 5.0):
        tighten(problem, {case.tie: force}, outwards(case))
        found.append(case.tie.tightening)
    loose = Bar("quadrilateral")
    problem = loose.problem([loose.hold(BOTTOM)])
    dm.newton(problem)
    problem.commit()
    with pytest.raises(dm.NewtonNotConverged) as caught:
        tighten(problem, {loose.tie: 30.0}, outwards(loose))
    return np.concatenate(found), str(caught.value).partition(":")[0]


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.5, 2.0])
@pytest.mark.parametrize("name", ["AROUND", "ALONG"])
def test_no_number_changes_an_answer(name, factor, monkeypatch):
    jumps, said = ends()
    monkeypatch.setattr(pretension, name, factor * getattr(pretension, name))
    found, words = ends()
    assert np.allclose(found, jumps, rtol=2 * SOUGHT, atol=1e-12) and words == said

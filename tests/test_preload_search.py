# SPDX-License-Identifier: MIT
"""The search of a preload: steps that fail, how far and how near it goes, and its direction."""

import logging

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from dolfinx_mortar.steps import preload as preload_module
from dolfinx_mortar.steps import tightening
from dolfinx_mortar.steps.report import StepReport
from tests.bolted_joint import Joint
from tests.glued_bar import NU, Bar, E, largest
from tests.meshes import BOTTOM, BOTTOM_OF_UPPER, TOP, TOP_OF_LOWER, two_blocks
from tests.pressed_blocks import rejected
from tests.tightened_bar import Watched, loaded, outwards, refuse_beyond, scripted

COMM = MPI.COMM_WORLD
SOUGHT = 1e-6  # relative accuracy of the force, the default


def create_search(problem, case, force):
    """Return a search that has not begun."""
    steps = tightening.Steps(problem, SOUGHT, {})
    return tightening.Search(problem, case.tie, outwards(case), force, SOUGHT, steps)


def test_tries_that_go_too_far_are_halved(monkeypatch):
    """Before the gap is closed nothing tells how far to go; what fails is not tried again."""
    joint, F0 = Joint(gap=0.01), 6.0
    joint.pull.value = -1.0
    most = 0.03
    tried = refuse_beyond(monkeypatch, joint.bolt, most)
    found = dm.preload(joint.problem, joint.bolt, F0, joint.direction)
    assert found.force == pytest.approx(F0, rel=SOUGHT) and largest(found.jump) < most
    beyond = [s for s in tried if s > most]
    assert beyond and np.all(np.diff(beyond) < 0.0)


def test_what_was_refused_bounds_the_search(monkeypatch):
    """Nothing resists until shortly before steps fail: half the way there, and no farther."""
    force_of = lambda s: 100.0 * max(s - 0.09, 0.0)  # noqa: E731
    case, problem = scripted(monkeypatch, force_of, refused=0.1)
    found = dm.preload(problem, case.tie, 0.5, outwards(case))
    assert -found.jump[1] == pytest.approx(0.095, rel=1e-6) and found.iterations < 15


@pytest.mark.parametrize("bend", [0.3, 3.0])
def test_bent_curves_take_few_tries(monkeypatch, bend):
    """Where the force bends up or down, both ends of the bracket move."""
    case, problem = scripted(monkeypatch, lambda s: 30.0 * np.sign(s) * (abs(s) / 0.05) ** bend)
    found = dm.preload(problem, case.tie, 30.0, outwards(case))
    assert -found.jump[1] == pytest.approx(0.05, rel=1e-5) and found.iterations < 16


def test_steps_that_do_not_converge(monkeypatch):
    """The cause is that of Newton, and calls with rising forces are the remedy."""
    case, problem = loaded()
    watched = Watched(case, problem)
    tried = refuse_beyond(monkeypatch, case.tie, 1e-3)
    with rejected("does not converge (too far)", "tighten in parts", error=dm.PreloadNotReached):
        dm.preload(problem, case.tie, 30.0, outwards(case))
    assert watched.unchanged() and len(tried) < 20


@pytest.mark.parametrize("share", [0.9, 0.97, 0.99, 0.999])
def test_a_force_shortly_before_steps_fail_is_found(monkeypatch, share):
    """Nearer to the end than halving goes, where secants lead there."""
    case, problem = scripted(monkeypatch, lambda s: 30.0 * np.tanh(s / 0.05), refused=0.1)
    force = 30.0 * np.tanh(share * 2.0)
    found = dm.preload(problem, case.tie, force, outwards(case))
    assert -found.jump[1] == pytest.approx(0.1 * share, rel=1e-4)


@pytest.mark.parametrize("refused", [0.1, 0.11, 0.12, 0.13, 0.14, 0.16, 0.18, 0.2])
def test_halving_ends_near_what_is_refused(monkeypatch, refused):
    """A force that flattens out and is not reached: its last digits are not worth the steps."""
    case, problem = scripted(monkeypatch, lambda s: 30.0 * np.tanh(s / 0.05), refused=refused)
    solve, tried = tightening.Search.solve, []
    monkeypatch.setattr(
        tightening.Search, "solve", lambda search, s: tried.append(s) or solve(search, s)
    )
    words = ("does not converge (too far)", "nearest was 2")
    with rejected(*words, error=dm.PreloadNotReached) as caught:
        dm.preload(problem, case.tie, 40.0, outwards(case))
    good, end = (max(s for s in tried if s <= refused), min(s for s in tried if s > refused))
    assert caught.value.tries[-1][0] == good
    # neither secants nor halving go much nearer
    assert 0.2 * tightening.NEAR < 1.0 - good / end <= tightening.NEAR


def test_near_the_end_secants_count(monkeypatch):
    """A force that is expected before what is refused is sought there, however near."""
    case, problem = scripted(monkeypatch, lambda s: 1000.0 * s, refused=0.0995)
    search = create_search(problem, case, 99.0)
    search.refused = {s: dm.NewtonNotConverged(f"at {s}", StepReport()) for s in (0.1, 0.2)}
    assert search.propose(0.09, -8.8, 0.098, -0.8, 1e4, 1.0) == pytest.approx(0.0988, rel=1e-12)
    with rejected("to a jump of 0.1 does not converge (at 0.1)", error=dm.PreloadNotReached):
        search.propose(0.09, -17.0, 0.098, -9.0, 1e4, 1.0)
    # refused itself, half the way is tried
    assert search.measure(0.0998, 0.098) == pytest.approx((0.0989, -0.1), rel=1e-9)


def test_the_nearest_of_what_is_refused_counts(monkeypatch):
    """A bolt that is let go, from a tightening before: nearest is not what is nearest to zero."""
    case, problem = scripted(monkeypatch, lambda s: 10.0 * s)
    case.tie.tightening = outwards(case)
    search = create_search(problem, case, -2.0)
    search.refused = {s: dm.NewtonNotConverged(f"at {s}", StepReport()) for s in (-0.1, 0.3)}
    assert search.propose(0.6, 8.0, 0.5, 7.0, 10.0, 9.0) == pytest.approx(0.4, rel=1e-12)


@pytest.mark.mpi
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_no_try_is_farther_than_a_share_of_the_model(sign):
    """Not the first one either; an elastic bar does not flow, its force is too large."""
    case, problem = loaded()
    watched = Watched(case, problem)
    words = ("is too little", "10% of the model's diagonal", "check units")
    with rejected(*words, error=dm.PreloadNotReached) as caught:
        dm.preload(problem, case.tie, sign * 1e9, outwards(case))
    assert "hardening" not in str(caught.value)
    farthest = tightening.FARTHEST * np.sqrt(1.0 + 2.0**2)
    jumps = [s for s, _ in caught.value.tries]
    assert len(jumps) == 2 and sign * jumps[-1] == pytest.approx(farthest, rel=1e-12)
    assert watched.unchanged()


# -- the direction


def told(case, problem, direction, caplog):
    """Return what is said of a direction, on rank 0."""
    caplog.clear()
    with caplog.at_level(logging.WARNING, logger="dolfinx_mortar.steps.preload"):
        preload_module._check(problem, case.tie, 1.0, direction)
    lines = [r.getMessage() for r in caplog.records if r.name.endswith("preload")]
    return COMM.bcast(lines)


@pytest.mark.mpi
@pytest.mark.parametrize("slave", ["upper", "lower"])
def test_a_direction_along_the_cut(slave, caplog):
    """Warned of, with its cosine; what is said goes with an angle, not with a mesh."""
    case, problem = loaded(slave=slave)
    (line,) = told(case, problem, [1.0, 0.0], caplog)
    assert (
        "direction is [1.0, 0.0]" in line
        and "[0, " in line
        and "is 0: " in line
        and "axis of the bolt" in line
    )
    for angle, warned in ((0.0, 0), (60.0, 0), (66.0, 1), (-60.0, 0), (-66.0, 1), (110.0, 1)):
        a = np.radians(angle)
        n = np.cos(a) * outwards(case) + np.sin(a) * np.array([1.0, 0.0])
        assert len(told(case, problem, n, caplog)) == warned, angle


def test_a_cut_that_is_inclined(caplog):
    """Its normal counts, and the axis of the bolt may lean to it."""
    case = Bar("quadrilateral", angle=np.radians(55.0))
    problem = case.problem([case.hold(BOTTOM), case.hold(TOP)])
    assert not told(case, problem, [0.0, -1.0], caplog)
    assert len(told(case, problem, [1.0, 1.4], caplog)) == 1


def test_a_side_around_a_shank_has_no_direction(caplog):
    """Its normals point everywhere: what their mean points to is chance."""
    case = Bar("quadrilateral")
    mesh, _, facets = two_blocks(
        COMM,
        (24, 2),
        (24, 2),
        cell="quadrilateral",
        transform=lambda x: np.column_stack(
            [(2.0 + x[:, 1]) * f(1.96 * np.pi * x[:, 0]) for f in (np.cos, np.sin)]
        ),
    )
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    case.tie = dm.Tie(facets, slave=BOTTOM_OF_UPPER, master=TOP_OF_LOWER)
    dofs = [fem.locate_dofs_topological(V, 1, facets.find(tag)) for tag in (BOTTOM, TOP)]
    bcs = [fem.dirichletbc(np.zeros(2), np.concatenate(dofs), V)]
    solid = dm.Solid(fem.Function(V), dm.Elastic(E, NU))
    problem = dm.ContactProblem(solid, [case.tie], bcs=bcs)
    for x in (1.0, -1.0):
        assert not told(case, problem, [x, 0.0], caplog)

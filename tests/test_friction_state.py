# SPDX-License-Identifier: MIT
"""Slips are state: they survive a checkpoint, other ranks, a failed step and a new pairing."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from tests.cases.friction import create
from tests.choice import crosswise

COMM = MPI.COMM_WORLD
SAME = 1e-10
PATH = [(0.0, -0.02), (0.01, -0.02), (0.03, -0.02), (0.015, -0.02)]  # press, push, slide, back


def walk(case, path):
    for x, y in path:
        case.push(x, *([0.0] if case.problem.d == 3 else []), y)
        dm.newton(case.problem, rtol=1e-12)
        case.problem.commit()


def numbers(case):
    """Return what friction has left, on every rank, and the forces."""
    shown = case.contact.gather(case.problem.u)
    order = np.lexsort(np.round(shown["X"], 9).T)  # of partitions that differ by round-off
    found = {name: shown[name][order] for name in ("traction", "step_slip", "slip", "status", "x")}
    return found | {"force": case.contact.force, "energy": np.array([case.contact.dissipation])}


def agree(found, expected):
    for name, values in expected.items():
        scale = 0.03 if "slip" in name else np.abs(values).max()  # that of the motion
        assert np.abs(found[name] - values).max() <= SAME * scale, name


@pytest.fixture
def folder(tmp_path):
    return COMM.bcast(tmp_path)


@pytest.mark.parametrize(
    ("cell", "geometry"), crosswise(["triangle", "hexahedron"], ["reference", "updated"])
)
def test_slips_come_back(folder, cell, geometry):
    """On another partition; the next step counts from the committed displacement."""
    options = {"friction": 0.3, "geometry": geometry}
    case, fresh = (
        create(cell, mesh_options={"partition": kind}, **options) for kind in ("graph", "stripes")
    )
    walk(case, PATH[:3])
    assert (numbers(case)["status"] == 2.0).any() and case.contact.dissipation > 0.0
    case.problem.save(folder / "slips.h5")
    fresh.problem.restore(folder / "slips.h5")
    agree(numbers(fresh), numbers(case))
    for one in (case, fresh):
        walk(one, PATH[3:])
    agree(numbers(fresh), numbers(case))


def test_a_state_before_the_first_step_takes_slips_away(folder):
    """What had slipped and been dissipated since is gone, and counts no more."""
    case = create(friction=0.3)
    case.problem.save(folder / "begin.h5")
    walk(case, PATH)
    expected = numbers(case)
    case.problem.restore(folder / "begin.h5")
    assert case.contact.dissipation == 0.0 and not case.contact.slip.x.array.any()
    walk(case, PATH)
    agree(numbers(case), expected)


def test_a_failed_step_leaves_no_slip():
    case, other = (create(friction=0.3, geometry="updated") for _ in range(2))
    for one in (case, other):
        walk(one, PATH[:2])
    case.push(0.03, -0.02)
    with pytest.raises(dm.NewtonNotConverged):
        dm.newton(case.problem, max_it=1, rtol=1e-12)
    for one in (case, other):
        walk(one, PATH[2:])
    agree(numbers(case), numbers(other))


@pytest.mark.mpi
def test_a_try_that_is_not_committed_leaves_no_trace():
    """The partners along which slips are measured are those of the last commit, not of the try."""
    case, other = (create(friction=0.3, geometry="updated") for _ in range(2))
    for one in (case, other):
        walk(one, PATH[:1])
    case.push(0.4, -0.03)
    dm.newton(case.problem)
    for one in (case, other):
        walk(one, PATH[1:3])
    agree(numbers(case), numbers(other))


@pytest.mark.mpi
@pytest.mark.parametrize("first", ["audited", "failed", "tried", "restored"])
def test_a_first_step_is_the_same_whatever_came_before_it(first, folder):
    """Its partners are those where the supports move the bodies, as before it none may face."""
    case, other = (create(friction=0.3, geometry="updated") for _ in range(2))
    if first == "audited":
        case.problem.audit()
    elif first == "failed":
        case.push(0.1, -0.02)
        with pytest.raises(dm.NewtonNotConverged):
            dm.newton(case.problem, max_it=1, rtol=1e-12)
    elif first == "tried":
        case.push(0.4, -0.03)
        dm.newton(case.problem)
    else:
        walk(case, PATH[:1])
        other.problem.save(folder / "begin.h5")
        case.problem.restore(folder / "begin.h5")
    for one in (case, other):
        walk(one, [(0.1, -0.02)])
    agree(numbers(case), numbers(other))


def test_results_of_a_try_are_put_back():
    """Nothing of it may be committed."""
    case = create(friction=0.3)
    walk(case, PATH[:2])
    u, kept, before = case.problem.u.x.array.copy(), case.contact.keep(), numbers(case)
    case.push(0.03, -0.02)
    dm.newton(case.problem)
    assert np.abs(numbers(case)["slip"] - before["slip"]).max() > 1e-3
    case.problem.u.x.array[:] = u
    case.contact.put_back(kept)
    for _ in range(2):
        agree(numbers(case), before)
        case.problem.commit()


@pytest.mark.parametrize("geometry", ["updated"])
def test_sliding_over_many_facets(geometry):
    """Pushed by four facets of the master: every node has slipped as far as the top has moved."""
    case = create(friction=0.3, slave="upper", geometry=geometry)
    walk(case, [(0.0, -0.02), *((0.05 + 0.1 * k, -0.02) for k in range(5))])
    before = case.contact.slip.x.array.copy()
    searches = case.problem.system.searches
    walk(case, [(0.55, -0.02)])
    nodes = case.contact.gather(case.problem.u)
    assert case.problem.system.searches >= searches
    assert (nodes["status"] == 2.0).all()
    on = case.contact.status.x.array > 0.0
    moved = case.contact.slip.x.array[on] - before[on]
    assert moved == pytest.approx(0.1, rel=1e-2)
    assert nodes["slip"].min() > 0.5


def test_what_is_shown_before_and_of_sides_without_friction():
    case = create(friction=0.3)
    assert not case.contact.slip.x.array.any() and case.contact.dissipation == 0.0
    smooth = create()
    walk(smooth, PATH[:1])
    with pytest.raises(AttributeError, match="has no friction"):
        _ = smooth.contact.slip
    assert "slip" not in smooth.problem.output_fields()
    walk(case, PATH[:3])
    fields = case.problem.output_fields()
    assert np.array_equal(fields["traction"].x.array, case.contact.traction.x.array)
    assert set(np.unique(fields["status"].x.array)) <= {0.0, 1.0, 2.0}
    certificate = case.problem.history or dm.newton(case.problem).certificate
    assert certificate.friction_cone <= 1e-9 and certificate.friction_gain <= 1e-12

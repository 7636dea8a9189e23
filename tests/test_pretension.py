# SPDX-License-Identifier: MIT
"""Ties with a given resultant: as with the jump that is found, a bolted joint, what cannot be."""

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from dolfinx_mortar import qp
from dolfinx_mortar.common.arrays import EPS
from dolfinx_mortar.interfaces import tie as module
from dolfinx_mortar.problem import checks
from dolfinx_mortar.steps.driven_tools import find_drives
from tests.cases.block_piles import ABOVE, BELOW, BRIDGE, COMM, Blocks
from tests.cases.bolted_joint import Joint
from tests.cases.glued_bar import CELLS, CONFINED, NU, Bar, E, largest
from tests.cases.meshes import BOTTOM, TOP
from tests.cases.pressed_blocks import failing, rejected
from tests.cases.solid import create_displacement, hold
from tests.cases.tightened_bar import Watched, clamped, loaded, outwards, tighten
from tests.cases.two_bodies import create_problem
from tests.test_results import cracked

TIGHT = {"rtol": 1e-11}
F0 = 6.0
STEEL = dm.VonMises(E, NU, 2.0, 10.0)


# -- the same as with the jump: problem, ties, what else is found


def joint_with_a_gap():
    """The contact of the yoke and the overlap are unknowns of one QP."""
    joint, F, gap = Joint(gap=0.01), 6.0, 0.01
    joint.pull.value = -1.0

    def check(report):
        """The bolt shrinks by the gap and what the plates yield, and is stretched."""
        plates = (F + 1.0) * (2.0 - gap) / (2 * E)
        assert -joint.bolt.tightening[1] == pytest.approx(gap + plates + F / (E / 2), rel=1e-4)
        assert joint.clamping() == pytest.approx(F + 1.0, rel=1e-6)

    return joint.problem, [joint.bolt], check


def pressed_by_a_screw(geometry):
    """Halves of a column are pushed apart on a rough base, of which nodes stick and slip."""
    boxes = [(-1.0, 2.0, 0.0, 1.0, 9, 3), (0.0, 1.0, 1.0, 2.0, 7, 4), (0.0, 1.0, 2.0, 3.0, 4, 3)]
    b = Blocks(boxes, cell="quadrilateral")
    base = dm.Contact(b.facets, slave=20 + BELOW, master=10 + ABOVE, friction=0.3)
    cut = b.join(dm.Tie, (3, BELOW), (2, ABOVE))
    bcs = [b.fix(1, BELOW), b.fix(3, ABOVE)]

    def check(report):
        found = {float(s) for own in COMM.allgather(base.status.x.array) for s in own}
        assert {1.0, 2.0} <= found and base.force[1] > 29.0
        assert report.certificate.friction_cone < 1e-8

    return b.problem([base, cut], bcs, geometry=geometry), [cut], check


def cut_tube():
    """Of rings forces are those all around."""
    b = Blocks([(1.0, 1.5, 0.0, 1.0, 2, 3), (1.0, 1.5, 1.0, 2.0, 3, 2)], cell="quadrilateral")
    tie = b.join(dm.Tie, (2, BELOW), (1, ABOVE))

    def check(report):
        stretch = -2.0 * 100.0 / (E * np.pi * (1.5**2 - 1.0))
        assert np.allclose(tie.tightening, [0.0, stretch], rtol=1e-8, atol=1e-12)

    bcs = [b.fix(1, BELOW, 1), b.fix(2, ABOVE, 1)]
    problem = b.problem([tie], bcs, dm.Elastic(E, 0.0), kinematics="axisymmetric")
    return problem, [tie], check


def bridge(order, *, claimed=False):
    """The slaves of one tie are masters of the other, or both have the same slave nodes."""
    b = Blocks(BRIDGE)
    second = ((1, ABOVE), (3, BELOW)) if claimed else ((3, BELOW), (1, ABOVE))
    ties = [b.join(dm.Tie, (1, ABOVE), (2, BELOW)), b.join(dm.Tie, *second)]
    problem = b.problem(
        [ties[k] for k in order], [b.fix(1, BELOW), b.fix(2, ABOVE), b.fix(3, ABOVE)]
    )

    def check(report):
        if claimed:  # the cut is pulled by the nodes it keeps
            assert COMM.allreduce(int(problem.system.link(ties[1]).banned.sum())) > 0
        else:  # T is a product of two factors
            assert problem.system.transformation.chained

    return problem, ties[1:] if claimed else ties, check


def second_order(cell):
    """Middles of six-node triangles refer to their ends: T has one more factor."""
    case, problem = clamped(cell, degree=2)

    def check(report):
        assert case.tie.tightening[2] == pytest.approx(-60.0 / CONFINED, rel=1e-6)
        assert (len(problem.system.transformation.factors) == 2) == (cell == "tetrahedron")

    return problem, [case.tie], check


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("create", "forces", "tol", "options"),
    [
        (joint_with_a_gap, [6.0], 1e-6, {"rtol": 1e-8}),
        (lambda: pressed_by_a_screw("reference"), [-30.0], 1e-8, {}),
        (lambda: pressed_by_a_screw("updated"), [-30.0], 1e-8, {}),
        (cut_tube, [100.0], 1e-8, {}),
        (lambda: bridge((0, 1)), [3.0, 5.0], 1e-8, {}),
        (lambda: bridge((0, 1), claimed=True), [5.0], 1e-8, {}),
        (lambda: second_order("tetrahedron"), [30.0], 1e-7, {}),
    ],
)
def test_as_with_the_jumps_that_are_found(create, forces, tol, options):
    problem, ties, check = create()
    for tie, force in zip(ties, forces, strict=True):
        tie.pretension = force
    report = dm.newton(problem, **TIGHT | options)
    assert report.certificate.loads < 10 * tol
    check(report)
    for tie, force in zip(ties, forces, strict=True):
        n = tie.driven().axis
        assert tie.force @ n == pytest.approx(force, rel=tol)
        # along n, but for the round-off of d products, their sum and the length of n
        across = tie.tightening - (tie.tightening @ n) * n
        assert np.abs(across).max() <= 8 * EPS * np.abs(tie.tightening).max()
    other, held, _ = create()
    for tie, known in zip(held, ties, strict=True):
        tie.tightening = known.tightening
    dm.newton(other, **TIGHT | options)
    u, v = problem.u.x.array, other.u.x.array
    assert largest(u - v) < tol * largest(v)
    for tie, known in zip(held, ties, strict=True):
        assert np.abs(tie.force - known.force).max() < tol * np.abs(known.force).max()
        p, gap = tie.pressure.x.array, tie.gap.x.array
        assert largest(p - known.pressure.x.array) < 10 * tol * largest(p)
        assert np.allclose(gap, known.gap.x.array, rtol=0.0, atol=1e-12, equal_nan=True)
    for each in (problem, other):
        each.commit()
    for name, state in problem.solid.state.items():
        again = other.solid.state[name].x.array
        assert largest(state.x.array - again) <= 10 * tol * largest(again)


# -- a bar between walls


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("cell", "force", "slave"),
    zip(CELLS, (30.0, -30.0, 30.0, 30.0), ("upper", "lower", "lower", "upper"), strict=True),
)
def test_what_a_node_takes_of_the_overlap(cell, force, slave):
    """F = E_c s / L on a unit section; positive is tension, along the mean normal of the slave."""
    case, problem = clamped(cell, slave=slave)
    case.tie.pretension = force
    report = dm.newton(problem, **TIGHT)
    assert report.newton_iterations == 1
    s = outwards(case) * 2.0 * force / CONFINED
    assert np.allclose(case.tie.tightening, s, rtol=1e-8, atol=1e-12)
    upper = case.tie.force if slave == "upper" else case.tie.master_force
    assert upper[case.d - 1] == pytest.approx(-force, rel=1e-8)  # tension pulls it down
    assert np.allclose(case.tie.gather(case.u)["pressure"], -force, rtol=1e-5)
    drives, link, moved = find_drives(problem), problem.system.link(case.tie), problem.vector()
    moved.array.reshape(-1, problem.d)[link.nodes] = case.tie.driven().axis
    e = drives.motions.reshape(-1, problem.d)[link.nodes]
    assert np.abs(e - link.relative(moved) * link.constrained).max(initial=0.0) < 1e-12


@pytest.mark.parametrize("law", [dm.Elastic(E, NU), STEEL])
def test_a_force_is_taken_off(law):
    """Where bodies have flown, stresses stay and the sum of the forces is 0."""
    case, problem = clamped(law=law)
    for force in (12.0, 0.0):
        case.tie.pretension = force
        report = dm.newton(problem, rtol=1e-9)
        problem.commit()
    assert report.newton_iterations <= 3
    assert np.abs(case.tie.force).max() < 1e-7


def test_the_certificate_tells_by_how_much_the_force_is_missed():
    case, problem = clamped(law=STEEL)
    case.tie.pretension = 12.0
    report = dm.newton(problem, rtol=0.3)
    missed = abs(-case.tie.force[1] - 12.0) / 12.0
    assert 1e-9 < missed < 0.3
    assert report.certificate.loads == pytest.approx(missed, rel=1e-6)


# -- what cannot be


@pytest.mark.parametrize("backend", sorted(set(qp.available()) - {"active-set"}))
def test_other_backends(backend):
    """They have bounds only, and say so before anything is done."""
    problem, (bolt,), _ = joint_with_a_gap()
    bolt.pretension = 6.0
    with rejected(f"qp is {backend!r}", "'active-set'"):
        dm.newton(problem, qp=backend)
    assert not problem.u.x.array.any()


@pytest.mark.mpi
def test_nothing_resists():
    """Told at the first step; later, when the tie is released, by the step that fails."""
    case = Bar("quadrilateral")
    case.tie.pretension = 30.0
    problem = case.problem([case.hold(BOTTOM)])
    with rejected("nothing holds the bodies", "tie with a pretension", "both ends"):
        dm.newton(problem)
    case.tie.pretension = None
    dm.newton(problem)
    problem.commit()
    case.tie.pretension = 30.0
    with rejected("nothing resists", "hold both ends", error=dm.NewtonNotConverged):
        dm.newton(problem)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("pretension", [1.0], ("finite number or a scalar Constant", "None to hold")),
        ("direction", [0.0, 0.0], ("2 finite components",)),
    ],
)
def test_values_that_are_none(name, value, words):
    case, _ = clamped()
    with rejected(f"{name} is ", *words):
        setattr(case.tie, name, value)


def test_constants_that_are_none():
    case, problem = clamped()
    with rejected("pretension is ", "scalar Constant"):
        case.tie.pretension = fem.Constant(case.mesh, np.zeros(2))
    force = fem.Constant(case.mesh, np.nan)
    case.tie.pretension = force
    with rejected("pretension of Tie", "is nan", "finite number"):
        dm.newton(problem)
    force.value = 3.0
    dm.newton(problem)
    assert case.tie.force[1] == pytest.approx(-3.0, rel=1e-6)


@pytest.mark.mpi
def test_directions_that_do_not_fit(monkeypatch):
    case, problem = loaded()
    case.tie.pretension, case.tie.direction = 3.0, -outwards(case)
    with rejected("direction is ", "into the slave side", "turn it round"):
        dm.newton(problem)
    case.tie.direction = None
    monkeypatch.setattr(module, "AROUND", 2.0)  # as if the cut went around a shank
    with rejected("direction is None", "all around", "axis of the bolt"):
        dm.newton(problem)


@pytest.mark.mpi
def test_no_node_carries_it():
    """Dirichlet data hold all slave nodes along the direction."""
    case = Bar("quadrilateral")
    case.tie.pretension, case.tie.direction = 3.0, outwards(case)
    held = case.hold(case.tie.slave, 1)
    problem = case.problem([case.hold(BOTTOM), held, case.hold(TOP, 0)])
    with rejected("pretension: no slave node", "carries a multiplier", "Dirichlet data"):
        dm.newton(problem)


def test_sides_with_common_nodes():
    """Those of a crack, which meet at its tip: not cut apart, and a tightening is a jump."""

    def solve(**options):
        mesh, tags = cracked()
        tie = dm.Tie(tags, slave=20, master=11)
        for name, value in options.items():
            setattr(tie, name, value)
        u = create_displacement(mesh)
        bcs = [hold(u.function_space, lambda x: np.isclose(x[1], x[1].min()))]
        dm.newton(create_problem(u, [tie], bcs, dm.Elastic(E, NU)), **TIGHT)
        return u.x.array

    with rejected("pretension: both sides", "1 nodes in common", "cut the bolt"):
        solve(pretension=1.0, direction=[0.0, 1.0])
    jump, tightened = (solve(**{name: np.array([0.0, 0.01])}) for name in ("jump", "tightening"))
    assert largest(jump) > 1e-3 and largest(tightened - jump) < 1e-13


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
def test_an_overlap_larger_than_the_model(monkeypatch):
    joint = Joint(gap=0.01)
    monkeypatch.setattr(checks, "diagonal", lambda V: 0.011)
    with rejected("an overlap of", "check units", "as before", error=dm.NewtonNotConverged):
        tighten(joint.problem, {joint.bolt: 6.0}, joint.direction)
    assert not joint.u.x.array.any() and not joint.bolt.tightening.any()


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
    monkeypatch.setattr(module, name, factor * getattr(module, name))
    case, problem = clamped()
    case.tie.jump = [0.0, -1e-3]
    for force in (30.0, 5.0):
        tighten(problem, {case.tie: force}, outwards(case))
        assert case.tie.tightening[1] == pytest.approx(1e-3 - 2 * force / CONFINED, rel=1e-5)

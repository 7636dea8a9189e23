# SPDX-License-Identifier: MIT
"""Ties with a given resultant: one more unknown of Newton's method, in all kinds of steps."""

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from dolfinx_mortar import qp
from dolfinx_mortar.arrays import EPS
from dolfinx_mortar.interfaces import pretension as module
from dolfinx_mortar.newton_method.contacts import Residuals, go_on
from dolfinx_mortar.newton_method.driven_tools import find_drives, miss
from dolfinx_mortar.newton_method.linearisation import find_balance
from tests.cases.block_piles import (
    ABOVE,
    BELOW,
    BRIDGE,
    COMM,
    Blocks,
)
from tests.cases.bolted_joint import Joint
from tests.cases.glued_bar import CELLS, CONFINED, NU, Bar, E, largest
from tests.cases.meshes import BOTTOM, TOP
from tests.cases.pressed_blocks import rejected
from tests.cases.tightened_bar import clamped, loaded, outwards, tighten
from tests.test_results import cracked

TIGHT = {"rtol": 1e-11}


def check_against_jumps(create, forces, *, tol=1e-8, **options):
    """Solve with pretensions, and another problem with the jumps that were found.

    Args:
        create: returns a problem and the ties that are pulled.
        forces: of these ties.
        tol: of displacements and forces, relative.
        options: of `newton`.

    Returns:
        The first problem and its ties, the report, and the second problem.
    """
    problem, ties = create()
    for tie, force in zip(ties, forces, strict=True):
        tie.pretension = force
    report = dm.newton(problem, **TIGHT | options)
    axes = [tie.driven().axis for tie in ties]
    for tie, force, n in zip(ties, forces, axes, strict=True):
        assert tie.force @ n == pytest.approx(force, rel=tol)
        # along n, but for the round-off of d products, their sum and the length of n
        across = tie.tightening - (tie.tightening @ n) * n
        assert np.abs(across).max() <= 8 * EPS * np.abs(tie.tightening).max()
    other, held = create()
    for tie, known in zip(held, ties, strict=True):
        tie.tightening = known.tightening
    dm.newton(other, **TIGHT | options)
    u, v = problem.u.x.array, other.u.x.array
    assert largest(u - v) < tol * largest(v)
    for tie, known in zip(held, ties, strict=True):
        assert np.abs(tie.force - known.force).max() < tol * np.abs(known.force).max()
        assert largest(tie.pressure.x.array - known.pressure.x.array) < 10 * tol * largest(
            tie.pressure.x.array
        )
        assert np.allclose(tie.gap.x.array, known.gap.x.array, rtol=0.0, atol=1e-12, equal_nan=True)
    return problem, ties, report, other


def pressed_by_a_screw(geometry, friction):
    """Return a column with a cut, whose halves are pushed apart on a rough base, and the cut."""
    boxes = [(-1.0, 2.0, 0.0, 1.0, 9, 3), (0.0, 1.0, 1.0, 2.0, 7, 4), (0.0, 1.0, 2.0, 3.0, 4, 3)]
    b = Blocks(boxes, cell="quadrilateral")
    base = dm.Contact(b.facets, slave=20 + BELOW, master=10 + ABOVE, friction=friction)
    cut = b.join(dm.Tie, (3, BELOW), (2, ABOVE))
    bcs = [b.fix(1, BELOW), b.fix(3, ABOVE)]
    return b.problem([base, cut], bcs, geometry=geometry), [cut]


# -- the same as with the jump


def joint_with_a_gap():
    """Return a bolted joint whose yoke closes, and its bolt."""
    joint = Joint(gap=0.01)
    joint.pull.value = -1.0
    return joint.problem, [joint.bolt]


@pytest.mark.mpi
def test_a_gap_that_closes():
    """The contact and the overlap are unknowns of one QP."""
    _, _, report, _ = check_against_jumps(joint_with_a_gap, [6.0], tol=1e-6, rtol=1e-8)
    assert report.certificate.loads < 1e-8


@pytest.mark.parametrize("backend", sorted(set(qp.available()) - {"active-set"}))
def test_other_backends(backend):
    """They have bounds only, and say so before anything is done."""
    problem, (bolt,) = joint_with_a_gap()
    bolt.pretension = 6.0
    with rejected(f"qp is {backend!r}", "'active-set'"):
        dm.newton(problem, qp=backend)
    assert not problem.u.x.array.any()


@pytest.mark.mpi
@pytest.mark.parametrize("geometry", ["reference", "updated"])
def test_with_friction(geometry):
    """Sticking and slipping nodes see the overlap in the same QP."""
    problem, _, report, _ = check_against_jumps(lambda: pressed_by_a_screw(geometry, 0.3), [-30.0])
    status = [contact.status.x.array for contact in problem.contacts]
    assert {1.0, 2.0} <= {float(s) for own in COMM.allgather(status) for a in own for s in a}
    assert problem.contacts[0].force[1] > 29.0
    assert report.certificate.friction_cone < 1e-8


def test_bodies_that_flow():
    """The plastic strain is that of one step, whatever the iterates were."""
    law = dm.VonMises(E, NU, 2.0, 10.0)
    problem, _, report, other = check_against_jumps(
        lambda: (lambda case, p: (p, [case.tie]))(*clamped(law=law)), [12.0]
    )
    flown, again = (p.solid.state["plastic_strain"].x.array for p in (problem, other))
    assert report.newton_iterations > 1
    assert np.array_equal(flown, again)  # nothing is committed
    for p in (problem, other):
        p.commit()
    flown, again = (p.solid.state["plastic_strain"].x.array for p in (problem, other))
    assert largest(flown) > 1e-3 and largest(flown - again) < 1e-8 * largest(flown)


def test_rings():
    """A tube around the axis is cut: forces are those all around."""
    boxes = [(1.0, 1.5, 0.0, 1.0, 2, 3), (1.0, 1.5, 1.0, 2.0, 3, 2)]

    def create():
        b = Blocks(boxes, cell="quadrilateral")
        tie = b.join(dm.Tie, (2, BELOW), (1, ABOVE))
        solid = dm.Solid(b.u, dm.Elastic(E, 0.0), b.cells, kinematics="axisymmetric")
        bcs = [b.fix(1, BELOW, 1), b.fix(2, ABOVE, 1)]
        return dm.ContactProblem(solid, [tie], bcs=bcs), [tie]

    _, (tie,), _, _ = check_against_jumps(create, [100.0])
    area = np.pi * (1.5**2 - 1.0)
    assert np.allclose(tie.tightening, [0.0, -2.0 * 100.0 / (E * area)], rtol=1e-8, atol=1e-12)


@pytest.mark.mpi
@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_a_chain(order):
    """The slaves of one tie are masters of the other: T is a product of two factors."""

    def create():
        b = Blocks(BRIDGE)
        ties = [b.join(dm.Tie, (1, ABOVE), (2, BELOW)), b.join(dm.Tie, (3, BELOW), (1, ABOVE))]
        bcs = [b.fix(1, BELOW), b.fix(2, ABOVE), b.fix(3, ABOVE)]
        ties = [ties[k] for k in order]
        return b.problem(ties, bcs), ties

    problem, _, _, _ = check_against_jumps(create, [3.0, 5.0])
    assert problem.system.transformation.chained


@pytest.mark.mpi
def test_a_bolt_whose_nodes_another_interface_claims():
    """A slave node of two interfaces belongs to one: the cut is pulled by the nodes it keeps."""

    def create():
        b = Blocks(BRIDGE)
        first, second = (
            b.join(dm.Tie, (1, ABOVE), (2, BELOW)),
            b.join(dm.Tie, (1, ABOVE), (3, BELOW)),
        )
        return b.problem([first, second], [b.fix(1, BELOW), b.fix(2, ABOVE), b.fix(3, ABOVE)]), [
            second
        ]

    problem, (tie,), _, _ = check_against_jumps(create, [5.0])
    assert problem.comm.allreduce(int(problem.system.link(tie).banned.sum())) > 0


@pytest.mark.parametrize("cell", ["tetrahedron", "hexahedron"])
def test_second_order_in_space(cell):
    """Middles of six-node triangles refer to their ends: T has one more factor."""

    def create():
        case, problem = clamped(cell, degree=2)
        return problem, [case.tie]

    problem, (tie,), _, _ = check_against_jumps(create, [30.0], tol=1e-7)
    assert tie.tightening[2] == pytest.approx(-60.0 / CONFINED, rel=1e-6)
    assert (len(problem.system.transformation.factors) == 2) == (cell == "tetrahedron")


def test_an_inclined_cut_on_a_plane_of_symmetry():
    """Directions with Dirichlet data take no part; the rest of n carries the force."""

    def create():
        case = Bar("quadrilateral", angle=np.radians(30.0))
        case.tie.direction = [0.2, -1.0]
        return case.problem([*case.rollers(), case.hold(BOTTOM), case.hold(TOP)]), [case.tie]

    problem, _, _, _ = check_against_jumps(create, [10.0])
    drives = find_drives(problem)
    assert not drives.motions[:, problem.supports.owned.ravel()].any()


# -- the algebra


@pytest.mark.mpi
@pytest.mark.parametrize("cell", CELLS)
def test_what_a_node_takes_of_the_overlap(cell):
    """It is the relative motion of the sides where all of the slave side moves along n."""
    case, problem = clamped(cell)
    case.tie.pretension = 30.0
    dm.newton(problem)
    drives, link, moved = find_drives(problem), problem.system.link(case.tie), problem.vector()
    moved.array.reshape(-1, problem.d)[link.nodes] = case.tie.driven().axis
    e = drives.motions.reshape(-1, problem.d)[link.nodes]
    assert np.abs(e - link.relative(moved) * link.constrained).max(initial=0.0) < 1e-12


@pytest.mark.mpi
def test_what_is_out_of_balance_is_seen():
    """Forces, and the certificate, which is relative to the pretension and not to larger loads."""
    case, problem = clamped()
    case.tie.pretension = 30.0
    report = dm.newton(problem, **TIGHT)
    assert report.certificate.loads < 1e-11
    case.tie.pretension = 33.0
    balance = find_balance(problem, problem.begin_step())
    contacts = go_on((np.zeros(problem.n, bool), None), None, 0.0)
    found = miss(problem, balance, contacts, Residuals(0.0, 0.0, 0.0, limit=1.0), rtol=0.01)
    assert found.loads == pytest.approx(3.0 / 33.0, rel=1e-9)
    assert found.excess == pytest.approx(100.0 * 3.0 / 33.0, rel=1e-9)


def test_the_size_of_a_pretension_is_its_own():
    """Not that of the forces on a rigid side, whose motions have one size, over their arms."""
    case = Bar("quadrilateral")
    plate = dm.RigidSide(case.facets, TOP, reference=[0.0, 2.0], load={"x": 0.0, "y": 1e6})
    case.tie.pretension = 3.0
    solid = dm.Solid(case.u, dm.Elastic(E, NU))
    problem = dm.ContactProblem(solid, [case.tie, plate], bcs=[case.hold(BOTTOM)])
    problem.begin_step()
    _, size = find_drives(problem).missing(np.zeros(problem.d * problem.n))
    assert size.tolist() == [3.0, 1e6, 1e6]


@pytest.mark.parametrize("law", [dm.Elastic(E, NU), dm.VonMises(E, NU, 2.0, 10.0)])
def test_a_force_is_taken_off(law):
    """Where bodies have flown, stresses stay and the sum of the forces is 0."""
    case, problem = clamped(law=law)
    for force in (12.0, 0.0):
        case.tie.pretension = force
        report = dm.newton(problem, rtol=1e-9)
        problem.commit()
    assert report.newton_iterations <= 3
    assert np.abs(case.tie.force).max() < 1e-7


def test_a_small_force_beside_large_loads():
    """It is met as exactly as a large one, at the same tolerance."""
    case, _ = clamped(law=dm.VonMises(E, NU, 2.0, 10.0))
    v, ds = ufl.TestFunction(case.V), ufl.Measure("ds", case.mesh, subdomain_data=case.facets)
    last = [case.hold(BOTTOM, 1), case.hold(TOP, 1)]
    loads = fem.Constant(case.mesh, 1e8) * v[1] * ds(BOTTOM)  # the support takes it
    problem = case.problem([*case.rollers(), *last], loads=loads)
    case.tie.pretension = 12.0
    report = dm.newton(problem, rtol=1e-6)
    assert report.newton_iterations > 1
    assert case.tie.force[1] == pytest.approx(-12.0, rel=1e-6)


def test_the_certificate_tells_by_how_much_the_force_is_missed():
    case, problem = clamped(law=dm.VonMises(E, NU, 2.0, 10.0))
    case.tie.pretension = 12.0
    report = dm.newton(problem, rtol=0.3)
    missed = abs(-case.tie.force[1] - 12.0) / 12.0
    assert 1e-9 < missed < 0.3
    assert report.certificate.loads == pytest.approx(missed, rel=1e-6)


# -- walks


@pytest.mark.mpi
@pytest.mark.parametrize("geometry", ["reference", "updated"])
def test_a_walk_under_a_force_and_then_with_the_jump(geometry):
    """The force is a Constant of the walk; set to None it is the jump that is held."""
    joint, F0 = Joint(), 6.0
    force = fem.Constant(joint.mesh, 0.0)
    joint.bolt.pretension = force

    def set_force(t):
        force.value = F0 * t
        joint.pull.value = 0.1 * t

    for step in dm.load_steps(joint.problem, [0.5, 1.0], on_time=set_force, progress=False):
        assert joint.tension() == pytest.approx(F0 * step.time, rel=1e-6)
    jump = joint.bolt.tightening.copy()
    joint.bolt.pretension = None
    joint.pull.value = 3.1
    dm.newton(joint.problem, rtol=1e-9)
    assert joint.tension() == pytest.approx(F0 + 1.0, rel=1e-4)
    assert np.array_equal(joint.bolt.tightening, jump)
    other = Joint()
    other.pull.value = 0.1
    tighten(other.problem, {other.bolt: F0}, other.direction, rtol=1e-10)
    assert np.allclose(jump, other.bolt.tightening, rtol=1e-5, atol=1e-12)


def test_a_step_that_fails_leaves_the_tightening():
    case, problem = clamped(law=dm.VonMises(E, NU, 2.0, 10.0))
    case.tie.pretension = 1.0
    dm.newton(problem)
    problem.commit()
    before = case.tie.tightening.copy(), case.u.x.array.copy()
    case.tie.pretension = 12.0
    with pytest.raises(dm.NewtonNotConverged):
        dm.newton(problem, max_it=1)
    assert np.array_equal(case.tie.tightening, before[0])
    assert np.array_equal(case.u.x.array, before[1])


def test_it_is_added_to_a_jump_that_changes():
    """The jump of the user and the overlap add up: the force stays, and the overlap takes it."""
    case, problem = clamped()
    case.tie.pretension = 30.0
    for jump in (None, [0.0, -1e-3], [0.0, 2e-3]):
        case.tie.jump = jump
        dm.newton(problem, **TIGHT)
        given = 0.0 if jump is None else jump[1]
        assert case.tie.tightening[1] + given == pytest.approx(-60.0 / CONFINED, rel=1e-9)
        assert case.tie.force[1] == pytest.approx(-30.0, rel=1e-10)
        assert np.allclose(case.tie.gather(case.u)["gap"], 60.0 / -CONFINED, rtol=1e-9)


@pytest.mark.mpi
def test_a_checkpoint_under_a_pretension(tmp_path):
    """A run that goes on holds the jump, or goes on under the force."""
    file = COMM.bcast(tmp_path) / "pulled.h5"
    case, problem = clamped()
    case.tie.pretension = 30.0
    dm.newton(problem, **TIGHT)
    problem.commit()
    problem.save(file)
    held, other = clamped()
    other.restore(file)
    assert np.array_equal(held.tie.tightening, case.tie.tightening)
    dm.newton(other, **TIGHT)
    assert held.tie.force[1] == pytest.approx(-30.0, rel=1e-9)
    held.tie.pretension = 50.0
    dm.newton(other, **TIGHT)
    assert held.tie.tightening[1] == pytest.approx(-100.0 / CONFINED, rel=1e-9)


# -- what cannot be


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


@pytest.mark.parametrize("force", ["much", [1.0], True, np.nan, np.inf, 1j])
def test_a_force_that_is_none(force):
    case, _ = clamped()
    with rejected("pretension is ", "finite number or a scalar Constant", "None to hold"):
        case.tie.pretension = force
    with rejected("pretension is "):
        dm.Tie(case.facets, slave=case.tie.slave, master=case.tie.master, pretension=force)


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


@pytest.mark.parametrize("direction", [1.0, [0.0, 0.0], [1.0, 0.0, 0.0], [0.0, np.nan], "down"])
def test_a_direction_that_is_none(direction):
    case, _ = clamped()
    with rejected("direction is ", "2 finite components"):
        case.tie.direction = direction


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
    """Those of a crack, which meet at its tip, are not cut apart."""
    mesh, tags = cracked()
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    bottom = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[1], x[1].min()))
    bc = fem.dirichletbc(np.zeros(2), bottom, V)
    tie = dm.Tie(tags, slave=20, master=11, pretension=1.0, direction=[0.0, 1.0])
    solid = dm.Solid(fem.Function(V), dm.Elastic(E, NU))
    problem = dm.ContactProblem(solid, [tie], bcs=[bc])
    with rejected("pretension: both sides", "1 nodes in common", "cut the bolt"):
        dm.newton(problem)


def test_a_tightening_is_a_jump_also_where_sides_have_common_nodes():
    """At the tip of a crack they cannot be apart."""
    found = []
    for name in ("jump", "tightening"):
        mesh, tags = cracked()
        V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
        bottom = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[1], x[1].min()))
        tie = dm.Tie(tags, slave=20, master=11)
        setattr(tie, name, np.array([0.0, 0.01]))
        solid = dm.Solid(fem.Function(V), dm.Elastic(E, NU))
        bcs = [fem.dirichletbc(np.zeros(2), bottom, V)]
        dm.newton(dm.ContactProblem(solid, [tie], bcs=bcs), rtol=1e-11)
        found.append(solid.u.x.array)
    assert largest(found[0]) > 1e-3
    assert largest(found[1] - found[0]) < 1e-13


@pytest.mark.mpi
@pytest.mark.skipif(COMM.size == 1, reason="needs ranks that differ")
def test_ranks_that_differ():
    case, problem = clamped()
    case.tie.pretension = 30.0 + COMM.rank
    with rejected("interfaces[0].pretension", "differs between the ranks"):
        dm.newton(problem)
    case.tie.pretension = 30.0
    case.tie.direction = [0.1 * COMM.rank, -1.0]
    with rejected("interfaces[0].direction", "differs between the ranks"):
        dm.newton(problem)


@pytest.mark.parametrize("cell", CELLS)
def test_the_mean_normal_is_the_default(cell):
    case, problem = clamped(cell)
    case.tie.pretension = 30.0
    dm.newton(problem, **TIGHT)
    assert np.allclose(case.tie.tightening, outwards(case) * 60.0 / CONFINED, rtol=1e-8, atol=1e-12)

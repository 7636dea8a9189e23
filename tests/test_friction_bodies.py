# SPDX-License-Identifier: MIT
"""Many bodies: friction, contact and ties in one stack, and a body that friction alone holds."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from tests.cases.block_piles import ABOVE, BELOW, COMM, EAST, WEST, Blocks
from tests.cases.pressed_blocks import failing

EXACT = 1e-10
STACK = [
    (0.0, 1.0, float(k), k + 1.0, n, m) for k, (n, m) in enumerate(((4, 2), (5, 2), (3, 3), (6, 2)))
]
FLAT = [(a, b, c / 5, d / 5, n, 1) for a, b, c, d, n, _ in STACK]  # which do not tip
WIDE = [(-0.5, 1.5, -1.0, 0.0, 8, 2), (0.0, 1.0, 0.0, 1.0, 5, 2), (-0.5, 1.5, 1.0, 2.0, 7, 2)]


def largest(array):
    """Return the largest absolute value of all ranks."""
    return float(COMM.allreduce(float(np.abs(array).max(initial=0.0)), op=MPI.MAX))


class Stack:
    """Blocks on each other, pressed and pushed by the uppermost; the lowest one is held."""

    def __init__(self, kinds, *, boxes=STACK, swap=(), geometry="reference", cell="triangle"):
        """Join block k to the one above by kinds[k], a function of facet tags, slave and master."""
        self.blocks = b = Blocks(boxes, cell=cell)
        self.interfaces = []
        for k, kind in enumerate(kinds, start=1):
            sides = {"slave": 10 * k + ABOVE, "master": 10 * (k + 1) + BELOW}
            if k in swap:
                sides = {"slave": sides["master"], "master": sides["slave"]}
            self.interfaces.append(kind(b.facets, **sides, surface="facets"))
        self.top = fem.Constant(b.mesh, np.zeros(2))
        self.bcs = [b.fix(1, BELOW), b.fix(len(boxes), ABOVE, value=self.top)]
        self.problem = b.problem(self.interfaces, self.bcs, geometry=geometry)

    def solve(self, x, y, rtol=1e-12):
        """Prescribe the displacement of the top, solve and commit."""
        self.top.value[:] = x, y
        report = dm.newton(self.problem, rtol=rtol)
        self.problem.commit()
        return report

    def upward(self, k):
        """Return the force that block k exerts on the one above, k from 1."""
        interface = self.interfaces[k - 1]
        lower = interface.slave == 10 * k + ABOVE
        return interface.master_force if lower else interface.force

    def status(self, k):
        """Return the status of the closed nodes of an interface."""
        nodes = self.interfaces[k - 1].gather(self.problem.u)
        return nodes["status"][nodes["pressure"] > 0.0]


def rubbing(mu):
    """Return contact with friction as a kind."""
    return lambda tags, **options: dm.Contact(tags, friction=mu, **options)


@pytest.mark.parametrize("swap", [(), (1, 2, 3), (2,)])
def test_a_stack_that_sticks_is_tied(swap):
    """Three interfaces with much friction do as three ties, nodes being slaves and masters."""
    stuck = Stack([rubbing(30.0)] * 3, swap=swap)
    tied = Stack([dm.Tie] * 3, swap=swap)
    for each in (stuck, tied):
        each.solve(0.001, -0.04)
    assert all((stuck.status(k) == 1.0).all() for k in (1, 2, 3))
    u, v = (each.problem.u.x.array for each in (stuck, tied))
    assert largest(u - v) < EXACT * largest(v)
    for k in (1, 2, 3):
        assert stuck.upward(k) == pytest.approx(tied.upward(k), rel=1e-9)


@pytest.mark.parametrize("swap", [(), (1, 3), (2,)])
def test_friction_contact_and_a_tie_in_one_stack(swap):
    """Each passes on what it may: the tie all, friction up to mu N, contact only pressure.

    Block 2 is tied to 1; block 3 slides on it; block 4 is pushed over 3 without friction, which
    friction below holds.
    """
    stack = Stack([dm.Tie, rubbing(0.3), dm.Contact], swap=swap)
    stack.solve(0.0, -0.04)
    stack.solve(0.02, -0.04)
    forces = np.array([stack.upward(k) for k in (1, 2, 3)])
    assert forces[:, 1] == pytest.approx(forces[0, 1], rel=1e-9)
    assert largest(forces[:, 0]) < 1e-9 * forces[0, 1]  # the uppermost side is plain and smooth
    with pytest.raises(AttributeError, match="friction="):
        stack.interfaces[2].status  # noqa: B018
    assert largest(stack.status(2) - 1.0) <= 1.0


@pytest.mark.parametrize("weak", [1, 2, 3])
@pytest.mark.parametrize("swap", [(), (1, 2, 3)])
def test_the_weakest_interface_slides(weak, swap):
    """Of three coefficients the smallest is the limit of all that is passed on."""
    mu = [0.9, 0.9, 0.9]
    mu[weak - 1] = 0.2
    stack = Stack([rubbing(m) for m in mu], boxes=FLAT, swap=swap, cell="quadrilateral")
    stack.solve(0.0, -0.01)
    stack.solve(0.05, -0.01)
    forces = np.array([stack.upward(k) for k in (1, 2, 3)])
    ratios = -forces[:, 0] / forces[:, 1]
    assert np.abs(ratios) == pytest.approx(0.2, rel=1e-9)
    for k in (1, 2, 3):
        assert (stack.status(k) == 2.0).all() == (k == weak)


# -- a body that friction alone holds


class Squeezed:
    """A block between two long ones, pulled aside by a traction on one of its sides."""

    def __init__(self, pull, mu, *, slave="outer", geometry="reference"):
        """Describe the problem; the long blocks are pressed together by 0.05."""
        self.blocks = b = Blocks(WIDE)
        pairs = [((1, ABOVE), (2, BELOW)), ((3, BELOW), (2, ABOVE))]
        pairs = [p if slave == "outer" else p[::-1] for p in pairs]
        friction = {} if mu is None else {"friction": mu}
        self.contacts = [
            dm.Contact(b.facets, slave=10 * s + a, master=10 * m + c, surface="facets", **friction)
            for (s, a), (m, c) in pairs
        ]
        self.top = fem.Constant(b.mesh, np.zeros(2))
        self.top.value[1] = -0.05
        bcs = [b.fix(1, BELOW), b.fix(3, ABOVE, value=self.top)]
        loads = b.traction(2, EAST, (pull, 0.0))
        self.problem = b.problem(self.contacts, bcs, loads=loads, geometry=geometry)

    def carried(self):
        """Return the sum of the forces on the block in the middle."""
        inner = 10 * 2
        return sum(
            c.force if inner < c.slave < inner + 10 else c.master_force for c in self.contacts
        )


@pytest.mark.parametrize("slave", ["outer", "inner"])
@pytest.mark.parametrize("geometry", ["reference", "updated"])
def test_friction_alone_holds_a_body(slave, geometry):
    """Squeezed and pulled gently: it stays, both sides carry the pull, and the audit is content."""
    case = Squeezed(1.0, 0.4, slave=slave, geometry=geometry)
    assert case.problem.audit().held_by_contact
    dm.newton(case.problem, rtol=1e-11)
    assert case.carried()[0] == pytest.approx(-1.0, rel=1e-6)
    for contact in case.contacts:
        status = contact.gather(case.problem.u)["status"]
        assert (status == 1.0).any()


@pytest.mark.parametrize("slave", ["outer", "inner"])
def test_pulled_out(slave):
    """Above 2 mu N there is no equilibrium, below there is; N falls as the block is pulled."""
    gentle = Squeezed(0.5, 0.4, slave=slave)
    dm.newton(gentle.problem, rtol=1e-11)
    normal = abs(gentle.contacts[0].force[1])
    hold = Squeezed(0.7 * 2 * 0.4 * normal, 0.4, slave=slave)
    dm.newton(hold.problem, rtol=1e-10)
    assert hold.carried()[0] == pytest.approx(-0.7 * 0.8 * normal, rel=1e-6)
    away = Squeezed(1.1 * 2 * 0.4 * normal, 0.4, slave=slave)
    with failing(away.problem, "The loads may exceed what friction carries"):
        dm.newton(away.problem)
    assert largest(away.problem.u.x.array) == 0.0


def test_without_friction_nothing_holds_it():
    """The audit refuses it, and names the motion."""
    for mu in (None, 0.0):
        case = Squeezed(1.0, mu)
        with pytest.raises(ValueError, match="nothing holds the bodies"):
            case.problem.audit()


# -- prescribed nodes


@pytest.mark.mpi
@pytest.mark.parametrize("swap", [False, True])
def test_prescribed_nodes_have_their_friction(swap):
    """A block pushed by its side face, whose corner slides as prescribed: T = mu N for any slave.

    It sticks like a spring, and keeps its friction where nothing moves.
    """
    b = Blocks(WIDE[:2], cell="quadrilateral")
    sides = (10 + ABOVE, 20 + BELOW)[:: 1 if swap else -1]
    contact = dm.Contact(b.facets, slave=sides[0], master=sides[1], friction=0.3)
    way = fem.Constant(b.mesh, 0.0)
    bcs = [b.fix(1, BELOW), b.fix(2, ABOVE, 1, -0.01), b.fix(2, EAST, 0, way)]
    problem = b.problem([contact], bcs, geometry="reference")
    forces = []
    for way.value in (0.0, 0.005, 0.03, 0.0305, 0.0305, 0.06, 0.03):
        report = dm.newton(problem, rtol=1e-10)
        problem.commit()
        forces.append(contact.force if swap else contact.master_force)
        assert report.certificate.force_balance < 1e-14
        supports = sum(dm.reaction(problem, bc).force for bc in bcs[1:])
        assert supports == pytest.approx(forces[-1], abs=1e-8)
    begun, slides, goes_on, rests, more, back = np.array(forces)[1:]
    assert 0.0 < begun[0] < 0.29 * abs(begun[1])
    for force in (slides, goes_on, rests, more):
        assert force[0] == pytest.approx(0.3 * abs(force[1]), rel=1e-8)
    assert back[0] == pytest.approx(-0.3 * abs(back[1]), rel=1e-8)
    assert rests == pytest.approx(goes_on, rel=1e-8)


@pytest.mark.parametrize("swap", [False, True])
def test_nodes_on_a_plane_of_symmetry_have_no_friction(swap):
    """What is prescribed on both sides alike does not slide; what moves by 2e-3 of a facet does."""
    b = Blocks([(-1.0, 0.0, 0.0, 1.0, 5, 2), (-1.0, 0.0, 1.0, 2.0, 4, 2)], cell="quadrilateral")
    sides = (10 + ABOVE, 20 + BELOW)[:: -1 if swap else 1]
    contact = dm.Contact(b.facets, slave=sides[0], master=sides[1], friction=0.3)
    aside = fem.Constant(b.mesh, 0.0)
    held = [b.fix(1, BELOW), b.fix(1, EAST, 0), b.fix(2, EAST, 0, aside)]
    problem = b.problem([contact], [*held, b.fix(2, ABOVE, 1, -0.01)])
    for aside.value in (0.0, 2e-3 / 4):
        dm.newton(problem)
        problem.commit()
        found = contact.gather(problem.u)
        at = found["X"][:, 0] > -1e-9
        share = np.abs(found["traction"][at, 0] / found["pressure"][at] / 0.3)
        low, high = (0.01, 0.1) if aside.value else (0.0, 1e-4)
        assert (low <= share).all() and (share <= high).all()


@pytest.mark.parametrize("height", [0.0, 0.123, -1e3])
@pytest.mark.parametrize(("gap", "friction"), [(0.0, 0.3), (-1e-3, 0.3), (0.0, None)])
def test_where_nothing_acts_nothing_happens(height, gap, friction):
    """Contact alone holds the upper block at level 0, where round-off must not open it.

    That of coordinates is larger than any force; an overlap goes by a motion without strain.
    """
    y = height + 2.0
    b = Blocks([(0.0, 4.0, height, y, 8, 4), (0.0, 3.0, y + gap, y + 2.0, 7, 5)])
    sides = {"slave": 20 + BELOW, "master": 10 + ABOVE}
    contact, t = dm.Contact(b.facets, **sides, friction=friction), fem.Constant(b.mesh, 0.0)
    loads = t * b.traction(2, ABOVE, (0.0, -1.0))
    problem = b.problem([contact], [b.fix(1, BELOW), b.fix(2, WEST, 0)], loads=loads)
    for step in dm.load_steps(problem, [0, 0, 1], ramp={t: [(0, 0.0), (1, 1.0)]}, progress=False):
        assert abs(contact.force[1] - 3.0 * step.time) < 1e-6 * max(step.time, 1e-3)
        assert step.report.cuts == 0 and not any("handed" in n for n in step.report.notes)
        assert step.time > 0.0 or largest(b.u.x.array) < 1e-12 * (1.0 + abs(height)) - gap

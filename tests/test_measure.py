# SPDX-License-Identifier: MIT
"""The results of `measure` and the certificate against independently computed numbers."""

from dataclasses import replace

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx_mortar.algebra.parallel import maximum, norm
from dolfinx_mortar.problem.checks import StepData
from dolfinx_mortar.problem.contacts import (
    Contacts,
    Scales,
    gap_round_off,
    measure,
)
from dolfinx_mortar.problem.linearisation import find_balance, linearise
from dolfinx_mortar.report.certificate import StepEnd, create_certificate, set_results
from tests.cases.friction import create as create_pushed
from tests.cases.hertz import ELASTIC, create_case
from tests.cases.meshes import BOTTOM, TOP
from tests.cases.pressed_blocks import PressedBlocks
from tests.cases.solid import rollers
from tests.tool_case import TOP as END
from tests.tool_case import Box

COMM = MPI.COMM_WORLD
RTOL, MU = 1e-6, 0.2


class Judged:
    """A solved problem, and what is said of it with other contacts."""

    def __init__(self, problem, report, limits=()):
        """Take the balance and the diagonal of K^ of the present state."""
        asked = np.zeros((problem.n, problem.d))
        values = problem.supports.values(), asked, 0.0
        self.problem, self.report = problem, report
        self.balance = find_balance(problem, StepData(*values, limits=limits, partners=[None]))
        self.diagonal = linearise(problem, self.balance).diagonal
        self.length = problem.system.facet_length
        (self.link,) = problem.system.links
        multipliers, tangential = np.zeros(problem.n), np.zeros((problem.n, problem.d))
        multipliers[self.link.nodes] = self.link.interface.multiplier
        if self.balance.limits is not None:
            traction = self.link.interface.traction.x.array.reshape(-1, problem.d)
            tangential[:] = -traction[: problem.n]
            shown = self.link.interface  # until results of other contacts are set
            self.slips = shown.status.x.array[: problem.n] > 1.5
            self.step_slip = shown.step_slip.x.array.reshape(-1, problem.d)[: problem.n].copy()
        active = problem.committed.active.copy()
        self.contacts = Contacts(active, multipliers, tangential, np.zeros_like(tangential))

    def measure(self, contacts, first=0.0):
        """Return the residuals, of a step with that size of the forces of the first QP."""
        scales = Scales(self.length, first=first)
        u, rest = self.problem.u, (self.diagonal, scales, 1.0, RTOL)
        return measure(u, self.balance, contacts, *rest)

    def certify(self, contacts):
        """Return the certificate."""
        _, balances = set_results(self.problem, self.balance, contacts)
        found = contacts, self.measure(contacts), self.diagonal
        return create_certificate(
            StepEnd(self.problem, self.report, self.balance, *found), balances
        )


@pytest.fixture(scope="module")
def wedge():
    """Return a disc pressed on a block, with frozen surfaces: some nodes are closed, some open."""
    made = dm.meshing.hertz(COMM, kind="paper")
    case = create_case(made, ELASTIC, geometry="reference")
    case.press(0.05)
    judged = Judged(case.problem, dm.newton(case.problem, rtol=1e-10))
    judged.disc = made.cell_tags.find("disc")
    return judged


@pytest.fixture(scope="module")
def pushed():
    """Return a block that is pressed, and then pushed so far that some of its nodes slip."""
    case = create_pushed(friction=MU)
    case.solve(0.0, -0.02)
    case.push(0.008, -0.02)
    report = dm.newton(case.problem, rtol=1e-12)
    return Judged(case.problem, report, [case.contact.law.values(case.contact)])


@pytest.mark.mpi
@pytest.mark.parametrize("height", [0.05, 0.5])
def test_an_open_gap_of_an_active_node(wedge, height):
    """No force spans it and none pulls it: the gap itself, in facets, is what is left."""
    right = wedge.measure(wedge.contacts)
    assert right.excess <= 1.0
    gap = wedge.balance.bounds.upper
    far = (gap > 0.0) & (gap < height)
    active = wedge.contacts.active.copy()
    active[wedge.balance.nodes[far]] = True
    found = wedge.measure(replace(wedge.contacts, active=active))
    widest = maximum(COMM, gap[far].max(initial=0.0))[0]
    assert widest > 0.5 * height
    assert found.excess == pytest.approx(widest / wedge.length / RTOL, rel=1e-9)
    assert found.contact == pytest.approx(right.contact, abs=1e-12)
    assert found.forces == pytest.approx(right.forces, abs=1e-12)


@pytest.mark.mpi
def test_the_first_forces_are_no_scale_of_those_that_act(wedge):
    """A stiff body that is turned by its supports, and presses softly: 5e4 in the sweep."""
    more = replace(wedge.contacts, multipliers=(1.0 + 1e-4) * wedge.contacts.multipliers)
    plain = wedge.measure(more)
    assert plain.excess > 10.0
    acting, share = plain.limit / RTOL, 1e-3 * RTOL
    assert wedge.measure(more, first=0.9 * acting / share) == plain
    assert wedge.measure(more, first=1.1 * acting / share).limit == pytest.approx(1.1 * acting)


@pytest.mark.mpi
@pytest.mark.parametrize("begun", [0.0, 1e3])
def test_what_acted_at_the_start_is_no_scale_where_nothing_acts(begun):
    """What the last step has left, and round-off of gaps at the end: that is in balance."""
    blocks = PressedBlocks()
    problem = blocks.problem(bcs=[blocks.bc(BOTTOM), blocks.bc(TOP)])
    balance = find_balance(problem, problem.begin_step())
    diagonal = linearise(problem, balance).diagonal
    stiffness = diagonal.array_r[balance.bounds.dofs]
    most = norm(COMM, gap_round_off(problem.u) * stiffness)
    reaction = most * stiffness / norm(COMM, stiffness)
    for share in (0.5, 2.0):
        z = np.zeros(problem.n)
        z[balance.nodes] = share * reaction / balance.bounds.weight
        scales = Scales(problem.system.facet_length, begun=begun * most)
        found = measure(problem.u, balance, Contacts(z > 0.0, z), diagonal, scales, 0.0, RTOL)
        assert (found.excess <= 1.0) == (share < 1.0)


@pytest.mark.mpi
def test_a_gap_that_is_negative(wedge):
    """The certificate says how deep, in facets: as much as the disc goes down on a flat slave."""
    deep, u = 1e-3, wedge.problem.u
    assert wedge.certify(wedge.contacts).gap < 1e-9
    before = u.x.array.copy()
    disc = np.unique(wedge.problem.V.dofmap.list[wedge.disc])
    u.x.array[1::2][disc] -= deep
    u.x.scatter_forward()
    moved = Judged(wedge.problem, wedge.report).certify(wedge.contacts)
    u.x.array[:] = before
    assert moved.gap == pytest.approx(deep / wedge.length, rel=1e-6)
    # p g of the most pressed node, over the largest pressure and a facet
    assert moved.complementarity == pytest.approx(deep / wedge.length, rel=1e-6)


@pytest.mark.mpi
@pytest.mark.parametrize("share", [0.9, 0.5])
def test_friction_that_is_missing(pushed, share):
    """Where it slips with a part of mu p, the rest is missing: as force, as law, and as work."""
    right = pushed.measure(pushed.contacts)
    assert right.excess <= 1.0
    slips = pushed.slips
    assert COMM.allreduce(int(slips.sum())) >= 2
    tangential = pushed.contacts.tangential.copy()
    tangential[slips] *= share
    contacts = replace(pushed.contacts, tangential=tangential)
    found, scale = pushed.measure(contacts), right.limit / RTOL
    D = np.zeros(pushed.problem.n)
    D[pushed.link.nodes] = pushed.link.coupling.weight[:, 0]
    pressing = D * pushed.contacts.multipliers
    missing = (1.0 - share) * MU * norm(COMM, pressing[slips])
    assert found.limit == pytest.approx(right.limit, rel=1e-3)  # element forces are larger
    assert found.contact * scale == pytest.approx(missing, rel=1e-3)
    assert found.forces * scale == pytest.approx(missing, rel=1e-3)
    assert found.excess == pytest.approx(missing / right.limit, rel=1e-3)
    said = pushed.certify(contacts)
    assert said.friction_work == pytest.approx(1.0 - share, rel=1e-3)
    assert said.friction_cone == 0.0 and said.friction_gain == 0.0


@pytest.mark.mpi
def test_friction_that_drives(pushed):
    """Turned round it gives twice the work that it should take; half as much again is too much."""
    tangential = pushed.contacts.tangential
    said = pushed.certify(replace(pushed.contacts, tangential=-tangential))
    assert said.friction_work == pytest.approx(2.0, rel=1e-3)
    work = np.zeros(pushed.problem.n)
    D = pushed.link.coupling.weight[:, 0]
    work[pushed.link.nodes] = D * (tangential * pushed.step_slip).sum(axis=1)[pushed.link.nodes]
    largest = maximum(COMM, work.max(initial=0.0))[0]
    whole = COMM.allreduce(float(work.sum()))
    assert said.friction_gain == pytest.approx(largest / whole, rel=1e-3)
    said = pushed.certify(replace(pushed.contacts, tangential=1.5 * tangential))
    assert said.friction_cone == pytest.approx(0.5, rel=1e-6)


@pytest.mark.serial
@pytest.mark.parametrize("excess", [1e-3, 0.1])
def test_equilibrium_of_one_cell(excess):
    """A square stretched too far by a share e: of the loads that are left, |f| = e F / sqrt(2)."""
    square = Box("quadrilateral", (1, 1), comm=MPI.COMM_SELF)
    ds = ufl.Measure("ds", square.mesh, subdomain_data=square.facets)(END)
    loads = 7.0 * ufl.TestFunction(square.V)[1] * ds
    problem = square.problem((), ELASTIC, bcs=rollers(square.V), loads=loads)
    u = problem.u
    report = dm.newton(problem, rtol=1e-12)
    u.x.array[:] *= 1.0 + excess
    data = StepData(problem.supports.values(), np.zeros((4, 2)), 0.0)
    balance = find_balance(problem, data)
    contacts = Contacts(np.zeros(4, dtype=bool), np.zeros(4))
    rest = linearise(problem, balance).diagonal, Scales(1.0), 1.0, RTOL
    residual = measure(u, balance, contacts, *rest)
    end = StepEnd(problem, report, balance, contacts, residual, rest[0])
    said = create_certificate(end, (0.0, 0.0)).equilibrium
    assert said == pytest.approx(excess / (np.sqrt(2.0) * (1.0 + excess)), rel=1e-9)

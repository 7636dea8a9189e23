# SPDX-License-Identifier: MIT
"""Impacts: a rod on a wall, a block that bounces, bodies that collide, friction that brakes."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem, mesh
from dolfinx_mortar.steps import energy_ledger, subproblem
from tests.cases.meshes import LOWER, UPPER
from tests.cases.meshes_3d import BOTTOM_OF_UPPER, TOP_OF_LOWER, two_boxes
from tests.cases.moving_bodies import Blocks, Rod, meeting
from tests.cases.solid import create_displacement, hold, plane
from tests.choice import quick

COMM = MPI.COMM_WORLD
pytestmark = pytest.mark.mpi


def steps(problem, times, **options):
    return dm.time_steps(problem, times, **{"progress": False, "rtol": 1e-10} | options)


@pytest.mark.slow
def test_a_rod_on_a_wall():
    """Times to one step, the force to 1 %, the velocity after it to .5 %, the energy to 1e-6."""
    rod = Rod(50)
    dt = 0.5 * rod.h / rod.wave
    times, forces, defects = dt * np.arange(1, int(1.6e-4 / dt)), [], []
    for step in steps(rod.problem, times):
        forces.append(rod.contact.force[1])
        defects.append(abs(step.report.ledger.defect))
    touching = times[np.array(forces) > 0.0]
    assert abs(touching[0] - rod.touches) <= dt
    assert abs(touching[-1] + dt - rod.leaves) <= dt
    plateau = (times > 6e-5) & (times < 1.35e-4)
    held = np.array(forces)[plateau]
    assert held.mean() == pytest.approx(rod.force, rel=1e-3)
    assert np.abs(held / rod.force - 1.0).max() < 0.01  # no chatter
    assert rod.inertia.momentum()[1] / rod.mass == pytest.approx(rod.velocity, rel=5e-3)
    assert max(defects) < 1e-11


@pytest.mark.nightly
@pytest.mark.slow
def test_a_block_that_bounces_a_thousand_times():
    """A stiff block falls, and its energy does not drift."""
    g, height, count = 10.0, 0.02, 1000
    sizes = {"law": dm.Elastic(1e5, 0.3), "gravity": g, "gap": height, "guided": True}
    case, defects, before, impacts = Blocks((2, 2), (3, 4), **sizes), [], -1.0, 0
    times = np.sqrt(2.0 * height / g) / 6.0 * np.arange(1, 25 * count)
    for step in steps(case.problem, times):
        ledger, now = step.report.ledger, case.inertia.momentum()[1]
        defects.append(ledger.defect * ledger.largest / (g * height))
        impacts += before < 0.0 < now
        before = now
        if impacts == count:
            break
    assert impacts == count and np.ptp(defects[12:]) < 1e-6


def colliding():
    """Return two free blocks, of which the upper one falls on the lower one aslant."""
    options = {"x_upper": (0.35, 1.2), "gap": 0.05, "jitter": 0.4, "clamped": False}
    velocity = {LOWER: (0.0, 0.2), UPPER: (0.3, -1.0)}
    return Blocks((5, 4), (6, 5), velocity=velocity, geometry="reference", **options)


@pytest.mark.parametrize(
    "scheme", quick(["energy-conserving", "generalised-alpha"], "energy-conserving")
)
def test_two_free_bodies_collide(scheme):
    """Momentum and its moment stay, about X, of which the linear theory keeps it."""
    case = colliding()
    inertia = case.inertia
    momentum, moment = inertia.momentum(), inertia.moment_of_momentum()
    energy, touched = inertia.kinetic_energy(), 0
    size = np.abs(momentum).max()
    for step in steps(case.problem, 4e-3 * np.arange(1, 60), scheme=scheme, rtol=1e-12):
        touched += bool(case.contact.force[1] > 0.0)
        assert np.abs(inertia.momentum() - momentum).max() < 1e-10 * size
        assert np.abs(inertia.moment_of_momentum() - moment).max() < 1e-10 * size
        ledger = step.report.ledger
        if scheme == "energy-conserving":
            assert abs(ledger.defect) < 1e-10
        assert ledger.kinetic + ledger.stored < energy * (1.0 + 1e-10)
    assert touched > 5 and case.contact.force[1] == 0.0
    assert inertia.momentum() == pytest.approx(momentum)


def rolled(parts):
    """Return the error of the moment of momentum of a block on its corner, steps 5e-3 / parts."""
    plane, velocity = dm.shapes.Plane([0.0, -0.01], [0.0, 1.0]), (0.2, -1.0)
    problem, floor, inertia = meeting(
        (1.0, 0.5),
        (4, 3),
        plane,
        side=lambda x: x[0] > -1.0,
        angle=0.4,
        velocity=velocity,
        strain="finite",
        friction=0.3,
    )
    dt, touched, before, largest, errors = 5e-3 / parts, 0, 0.0, 0.0, []
    moment = inertia.moment_of_momentum([0.0, -0.01])[0]
    size = abs(moment)
    for _ in steps(problem, dt * np.arange(1, 40 * parts + 1)):
        now = -floor.tool_moment[2]
        moment += 0.5 * dt * (before + now)
        before, touched, largest = now, touched + bool(now), max(largest, abs(now))
        found = inertia.moment_of_momentum([0.0, -0.01])[0]
        errors.append(abs(found - moment) / size)
    assert touched > 5 and largest > 0.2 * size
    return max(errors)


def test_the_moment_of_momentum_is_of_second_order_at_finite_strain():
    """That of the forces of a tool, by the trapezoidal rule."""
    found = rolled(1)
    assert found < 2.1e-4
    assert rolled(2) < found / 3.0


@pytest.mark.slow
@pytest.mark.parametrize(("cell", "friction"), [("hexahedron", 0.3), ("tetrahedron", None)])
def test_two_boxes_collide_in_space(cell, friction):
    """By multigrid, of two densities; the moment has the error of the steps."""
    boxes = {"gap": 0.02, "upper": (0.2, 1.2, 0.1, 1.1), "cell": cell}
    domain, cells, facets = two_boxes(COMM, (3, 3, 5), (4, 4, 5), **boxes)
    law = dm.NeoHooke(1000.0, 0.3)
    solid = dm.Solid(create_displacement(domain), law, strain="finite")
    velocity = {LOWER: (0.0, 0.0, 0.1), UPPER: (0.2, 0.1, -1.0)}
    inertia = dm.Inertia(solid, {LOWER: 1.0, UPPER: 2.0}, cells, velocity=velocity)
    contact = dm.Contact(facets, slave=BOTTOM_OF_UPPER, master=TOP_OF_LOWER, friction=friction)
    problem = dm.ContactProblem(solid, [contact], terms=[inertia])
    momentum, moment, touched, taken = inertia.momentum(), inertia.moment_of_momentum(), 0, [0.0]
    for step in steps(problem, 8e-3 * np.arange(1, 6), rtol=1e-12):
        touched += bool(contact.force[2] > 0.0)
        assert inertia.momentum() == pytest.approx(momentum, abs=1e-10)
        assert inertia.moment_of_momentum() == pytest.approx(moment, abs=1e-4)
        taken.append(step.report.ledger.friction)
    assert touched == 3 and "gamg" in step.report.linear_solver
    assert (np.diff(taken) >= 0.0).all() and bool(taken[-1] > 0.0) == bool(friction)


def test_on_a_mesh_without_structure():
    """Moved masses couple nodes that share no cell: the matrix has room for them."""
    domain, _, facets = dm.meshing.hertz(COMM)
    solid = dm.Solid(create_displacement(domain), dm.Elastic(200e3, 0.3))
    inertia = dm.Inertia(solid, 7.85e-9, velocity=lambda x: np.stack([0 * x[0], -1e3 * (x[1] > 0)]))
    contact = dm.Contact(facets, slave="top", master="arc")
    bcs = [hold(solid.V, facets.find("bottom"))]
    problem = dm.ContactProblem(solid, [contact], bcs=bcs, terms=[inertia])
    assert COMM.allreduce(len(inertia.couplings)) > 0
    *_, step = steps(problem, 2e-6 * np.arange(1, 4), rtol=1e-8)
    assert contact.force[1] != 0.0
    assert abs(step.report.ledger.defect) < 1e-8


def test_a_step_that_would_pass_through_is_cut():
    """A plate that would be on the other side of a thin wall after the step."""
    case = Blocks(
        (2, 2), (3, 4), heights=(0.2, 0.4), gap=0.1, velocity={UPPER: (0.0, -20.0), LOWER: (0, 0)}
    )
    (step,) = steps(case.problem, [0.05])
    up = case.problem.X[:, 1] > 0.05
    y = (case.problem.X + case.problem.owned_u.reshape(-1, 2))[up, 1]
    assert y.min(initial=1.0) > -1e-6
    assert case.inertia.momentum()[1] > 0.0
    assert abs(step.report.ledger.defect) < 1e-9


def meet_a_tool(speed, tool_speed, angle=0.0):
    """Return the mean velocity of a block along a direction, after a tool that moves in it."""
    c, s = np.cos(angle), np.sin(angle)
    along = np.array([c, s])
    start = 1.0002 * along
    problem, wall, inertia = meeting(
        (1.0, 0.25),
        (6, 2),
        dm.shapes.Plane(start, -along),
        side=plane(0, 1.0),
        angle=angle,
        velocity=speed * along,
        law=dm.Elastic(1.0, 0.0),
    )
    times = np.linspace(0.0, 3.0, 41)[1:]
    ramp = {wall.position: [(0.0, start), (3.0, start + 3.0 * tool_speed * along)]}
    *_, step = steps(problem, times, ramp=ramp)
    assert abs(step.report.ledger.defect) < 1e-4  # of the first steps, as their energies are small
    return inertia.momentum() @ along / 0.25, step.report.ledger


def test_a_tool_that_moves_does_work(v=1e-3, angle=0.5):
    """The same as for who moves with it, where the tool is at rest and the block bounces."""
    still, _ = meet_a_tool(1e-3, 0.0)
    assert still == pytest.approx(-1e-3, rel=0.05)  # the rest vibrates
    found, ledger = meet_a_tool(1e-3 + v, v, angle)
    assert found - v == pytest.approx(still, rel=1e-6)
    assert ledger.supports == pytest.approx(0.25 * v * (found - 1e-3 - v), rel=1e-6)


def test_a_belt_takes_a_block_along():
    """Friction gives what it does not dissipate: half of the work of the belt."""
    mu, g, v, time = 0.3, 10.0, 0.4, 0.12
    tool, law = dm.shapes.Plane([0.0, 0.0], [0.0, 1.0]), dm.Elastic(1e5, 0.0)
    more = {"damping": 2e-3, "loads": -g, "friction": mu}
    problem, belt, inertia = meeting((1.0, 0.5), (4, 2), tool, law=law, **more)
    ramp = {belt.position: [(0.0, (0.0, 0.0)), (time, (v * time, 0.0))]}
    *_, step = steps(problem, np.linspace(0.0, time, 31)[1:], ramp=ramp)
    reached, mass = mu * g * time, 0.5
    assert inertia.momentum()[0] / mass == pytest.approx(reached, rel=1e-3)
    ledger = step.report.ledger
    assert abs(ledger.defect) < 1e-8
    assert ledger.supports == pytest.approx(mass * reached * v, rel=5e-3)
    kinetic = 0.5 * mass * reached**2
    assert ledger.friction == pytest.approx(ledger.supports - kinetic, rel=0.02)


class Pushed:
    """A free block, and a tool above it that a force of 10 drives from the start."""

    def __init__(self, gap=0.0, shape=None):
        shape = shape or dm.shapes.Plane([0.5, 1.0 + gap], [0.0, -1.0])
        self.force, top = fem.Constant(mesh.create_unit_square(COMM, 1, 1), -10.0), plane(1, 1.0)
        more = {"law": dm.Elastic(1000.0, 0.0), "load": {"y": self.force}}
        self.problem, self.tool, self.inertia = meeting((1.0, 1.0), (4, 6), shape, side=top, **more)


@pytest.mark.parametrize("gap", [0.0, 0.02])
def test_the_load_of_a_tool_that_jumps(gap):
    """A tool has no mass: it hands on its load at once, and follows the block."""
    case, dt, before, momentum = Pushed(gap), 5e-3, -10.0, 0.0

    def load(time):
        case.force.value = -10.0 if time < 2.5 * dt else -40.0

    for step in steps(case.problem, dt * np.arange(1, 8), on_time=load):
        now = float(case.force.value)
        momentum += 0.5 * dt * (before + now)
        before = now
        assert case.tool.tool_force == pytest.approx([0.0, -now], abs=1e-8)
        assert case.inertia.momentum()[1] == pytest.approx(momentum, rel=1e-8)
        assert abs(step.report.ledger.defect) < 1e-10


def test_a_tool_without_mass_does_not_cross_a_gap():
    with pytest.raises(
        dm.NewtonNotConverged, match="touch the body at the start: tools have no mass"
    ):
        list(steps(Pushed(gap=0.05).problem, [5e-3], cuts="none"))


def test_impulses_are_the_change_of_momentum():
    """With the weight's; forces over time are 1.95 and 8.0 where contact has given 1.09 and 4.6."""
    case = Blocks(
        *((2, 2), (3, 4)),
        law=dm.Elastic(1e5, 0.3),
        friction=0.3,
        velocity={UPPER: (1.0, -1.0), LOWER: (0.0, 0.0)},
        gravity=10.0,
        gap=0.02,
    )
    before, times = case.inertia.momentum(), np.sqrt(0.004) / 6.0 * np.arange(1, 36)
    forces = []
    for step in steps(case.problem, times):
        forces.append(case.contact.force)
        (found,) = step.report.ledger.impulses
    given = case.inertia.momentum() - before + (0.0, 10.0 * times[-1])
    assert found == pytest.approx(given, rel=1e-9)
    assert (np.abs(np.trapezoid(forces, times, axis=0)) > 1.5 * np.abs(given)).all()


@pytest.mark.parametrize(("layers", "thin"), quick([(2, True), (3, False)], (2, True)))
def test_thin_bodies_make_energy_and_a_note_says_why(layers, thin):
    """Two layers of cells keep the mass of contact nodes, with which no step is short enough."""
    case = Blocks(
        (1, 1), (4, layers), gap=0.01, guided=True, velocity={UPPER: (0, -1), LOWER: (0, 0)}
    )
    wave = np.sqrt(1000.0)
    *_, step = steps(case.problem, 0.5 / layers / wave * np.arange(1, 60 * layers // 2))
    assert (abs(step.report.ledger.defect) > 0.01) == thin
    assert ("three layers" in " ".join(case.problem.diagnose())) == thin
    # contact has made more energy in a step than its impulse could take
    notes = [n for one in case.problem.history for n in one.report.notes if "in this step" in n]
    assert bool(notes) == thin
    assert all("given to the bodies" in n and "too small along the motion" in n.why for n in notes)


def test_an_impulse_without_a_response_is_noted(monkeypatch):
    """Then the energy that contact takes stays away, which the note says in per cent."""
    case = Blocks((2, 2), (3, 4), gap=0.01, guided=True, velocity={UPPER: (0, -1), LOWER: (0, 0)})

    def respond(problem, forces, *rest):
        return subproblem.respond(problem, np.nan * forces, *rest)

    monkeypatch.setattr(energy_ledger, "respond", respond)
    for step in steps(case.problem, 4e-3 * np.arange(1, 9)):
        if notes := [n for n in step.report.notes if "no response" in getattr(n, "why", "")]:
            break
    ledger, (note,) = step.report.ledger, notes
    assert "without giving it back" in note
    lost = -ledger.contact / ledger.largest
    assert f"{100 * lost:.2g} % of the energy" in note
    assert ledger.defect == pytest.approx(-lost, rel=1e-6) and lost > 1e-4


def test_what_contact_owes_waits_until_it_matters(monkeypatch):
    """It gives 1.4e-5 of the energy in one step and 5e-4 in the next: one impulse takes both."""
    case = colliding()
    tried, gains, owed, before = [], 0, 0, 0.0

    def respond(*args):
        tried.append(1)
        return subproblem.respond(*args)

    monkeypatch.setattr(energy_ledger, "respond", respond)
    for step in steps(case.problem, 4e-3 * np.arange(1, 60), rtol=1e-4):
        ledger = step.report.ledger
        gains += abs(ledger.contact - before) > 1e-6 * ledger.largest
        before = ledger.contact
        assert ledger.defect == pytest.approx(ledger.owed / ledger.largest, abs=1e-7)
        assert abs(ledger.owed) < 1e-4 * ledger.largest
        owed += abs(ledger.owed) > 1e-5 * ledger.largest
    assert gains == 4 and len(tried) == 3 and owed == 1
    assert abs(ledger.defect) < 1e-7

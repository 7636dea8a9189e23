# SPDX-License-Identifier: MIT
"""Inertia, damping and steps of time, against closed forms of vibrations and flights."""

from dataclasses import asdict

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from dolfinx_mortar.steps.walk import Run
from dolfinx_mortar.terms import mass
from tests.cases.meshes import BOTTOM_OF_UPPER, LOWER, TOP, TOP_OF_LOWER, UPPER
from tests.cases.moving_bodies import Bar, Blocks
from tests.cases.pressed_blocks import PressedBlocks, rejected
from tests.cases.solid import COMM, create_displacement, hold, largest, plane, rectangle
from tests.choice import quick

pytestmark = pytest.mark.mpi


DAMPED = {"scheme": "generalised-alpha"}


def walk(problem, times, **options):
    """Make all steps, each to round-off; return the last one."""
    return list(dm.time_steps(problem, times, **{"progress": False, "rtol": 1e-11} | options))[-1]


def sums(left, right):
    return COMM.allreduce(left.T @ right, op=MPI.SUM)


@pytest.mark.parametrize("options", [{}, {"spectral_radius": 0.5} | DAMPED])
def test_a_vibration_is_of_second_order(options):
    """At the end of 3/8 of a period, where cos(w t) is -.707; frequency of linear elements."""
    errors = []
    for count in (15, 30):
        bar = Bar()
        end = 2.0 * np.pi / bar.frequency * 0.375
        walk(bar.problem(), end / count * np.arange(1, count + 1), **options)
        errors.append(abs(bar.tip() - np.cos(0.75 * np.pi)))
    assert 1.9 < np.log2(errors[0] / errors[1]) < 2.1
    assert errors[1] < 0.02


def test_the_trapezoidal_rule_has_its_known_period():
    """tan(w' dt / 2) = w dt / 2 (Hughes, The Finite Element Method, 9.1), and keeps the energy."""
    bar = Bar()
    dt = 0.3 / bar.frequency
    step = walk(bar.problem(), dt * np.arange(1, 41))
    slower = 2.0 / dt * np.arctan(bar.frequency * dt / 2.0)
    assert bar.tip() == pytest.approx(np.cos(40 * slower * dt), abs=1e-9)
    assert abs(step.report.ledger.defect) < 1e-10
    # 1/2 int E (u')^2 of the mode, of linear elements
    stored = 0.5 * 0.1 * 8 * sum((1e-3 * np.diff(np.sin(np.pi / 2 * np.linspace(0, 1, 9)))) ** 2)
    assert step.report.ledger.initial == pytest.approx(stored, rel=1e-9)


@pytest.mark.parametrize("radius", [0.0, 0.5])
def test_the_spectral_radius_is_what_is_left_of_high_frequencies(radius):
    """For dt without end all three roots of the amplification are -r (Chung and Hulbert 1993).

    x_n = (A + B n + C n^2) (-r)^n, so that x_(n+3) + 3 r x_(n+2) + 3 r^2 x_(n+1) + r^3 x_n = 0.
    """
    bar, found = Bar(n=2), []
    options = {"spectral_radius": radius, "progress": False, "rtol": 1e-11} | DAMPED
    for _ in dm.time_steps(bar.problem(), 1e5 * np.arange(1, 9), **options):
        found.append(bar.tip())
    x = np.array(found)
    rest = x[3:] + 3.0 * radius * x[2:-1] + 3.0 * radius**2 * x[1:-2] + radius**3 * x[:-3]
    assert np.abs(rest).max() < 1e-7


def test_rayleigh_damping_of_a_mode(mass=0.1, stiffness=0.04):
    """U = e^(-z t) (cos(w' t) + z/w' sin(w' t)), z = (a + b w^2)/2, w'^2 = w^2 - z^2."""
    errors = []
    for count in (40, 80):
        bar = Bar()
        damping = dm.Damping(bar.inertia, mass=mass, stiffness=stiffness)
        w = bar.frequency
        z = 0.5 * (mass + stiffness * w**2)
        t, damped = 5.0, np.sqrt(w**2 - z**2)
        step = walk(bar.problem(damping), t / count * np.arange(1, count + 1))
        exact = np.exp(-z * t) * (np.cos(damped * t) + z / damped * np.sin(damped * t))
        errors.append(abs(bar.tip() - exact))
    assert 1.8 < np.log2(errors[0] / errors[1]) < 2.2
    ledger = step.report.ledger
    assert abs(ledger.defect) < 1e-9
    assert 0.2 < ledger.damping / ledger.initial < 0.9


def test_a_free_body_falls_on_a_parabola():
    """Nothing holds it, which is no error, and its centre moves as a point does."""
    case = Blocks(clamped=False, gravity=9.81, gap=5.0, velocity={UPPER: (1.0, 2.0)})
    times = 0.05 * np.arange(1, 9)
    step, t = walk(case.problem, times), times[-1]
    u = case.problem.owned_u.reshape(-1, 2)
    centre = COMM.allreduce(case.inertia.mass.times(u).sum(axis=0))
    assert centre == pytest.approx([t, 2.0 * t - 0.5 * 9.81 * t**2])
    assert case.inertia.momentum() == pytest.approx([1.0, 2.0 - 9.81 * t])
    ledger = step.report.ledger
    # weight of nodes without mass hangs on the layer behind them, which it strains at the start
    assert abs(ledger.defect) < 1e-12
    assert ledger.loads == pytest.approx(-9.81 * (2.0 * t - 0.5 * 9.81 * t**2), abs=0.01)
    assert step.report.newton_iterations == 1
    assert not step.report.notes


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
def test_the_mass_off_the_contact_nodes(cell):
    """Each body keeps mass, centre and moments of inertia; the matrix stays semidefinite."""
    case = Blocks((4, 5), (5, 6), cell=cell, jitter=0.4, heights=(1.0, 1.5), density={1: 2.0, 2: 3})
    inertia = case.inertia
    M, plain = inertia.mass, inertia.plain
    near = np.abs(case.problem.X[:, 1]) < 1e-9
    assert np.array_equal(M.massless, near)
    for body in (case.problem.bodies.label == 0, case.problem.bodies.label == 1):
        p = np.column_stack([np.ones(len(M.X)), M.X]) * body[:, None]
        assert sums(p, M.times(p)) == pytest.approx(sums(p, plain.times(p)), rel=1e-11)
    x = np.random.default_rng(COMM.rank).normal(size=(len(M.X), 2))
    assert np.abs(M.times(x)[near]).max(initial=0.0) == 0.0
    assert sums(x, M.times(x)).trace() > 0.0
    one = np.ones((len(M.X), 1))
    assert sums(one, M.times(one))[0, 0] == pytest.approx(2.0 * 1.0 + 3.0 * 1.5)


@pytest.mark.serial
def test_a_body_of_one_layer_keeps_its_mass(monkeypatch):
    """All mass on the far side would be that of another body."""
    case = Blocks((1, 1), (3, 3))
    M, X, body = case.inertia.mass, case.problem.X, case.problem.bodies.label
    lower = body == body[np.argmin(X[:, 1])]
    assert not M.massless[lower].any() and M.massless[(np.abs(X[:, 1]) < 1e-9) & ~lower].all()
    # of three layers of inner nodes the middle one would have no mass without a least factor
    assert M.matrix.getDiagonal().array_r[~M.massless].min() > 1e-3
    monkeypatch.setattr(mass, "LEAST_FACTOR", -1.0)
    M = Blocks((1, 1), (3, 3)).inertia.mass
    assert M.matrix.getDiagonal().array_r[~M.massless].min() < 1e-9


@pytest.mark.parametrize("options", quick([{}, DAMPED], DAMPED))
def test_a_checkpoint_holds_the_motion(folder, options):
    """A run that stops while the bodies touch goes on with the same numbers."""
    times = 0.01 * np.arange(1, 11)
    found = []
    for stops in ((10,), (5, 10)):
        for stop in stops:
            case = Blocks(gap=0.02, velocity={UPPER: (0.0, -1.0)})
            file = folder / f"{len(stops)}.h5"
            last = walk(case.problem, times[:stop], checkpoint=file, **options)
        found.append((last.report.ledger, case.inertia.velocity.x.array.copy()))
    (one, v), (other, w) = found
    for name, value in asdict(one).items():
        np.testing.assert_allclose(getattr(other, name), value, rtol=1e-9, atol=1e-12)
    assert w == pytest.approx(v, rel=1e-9, abs=1e-10)
    assert "energy: " in str(last.report) and "kinetic " in str(last.report)
    assert not list(dm.time_steps(case.problem, times, progress=False, **options))  # all are made
    assert one.kinetic != one.initial and dm.summarise(last)["ledger"] == asdict(other)


def test_a_checkpoint_knows_the_mass_and_the_scheme(folder):
    """What would change the answer in silence is refused, with both."""
    times, moving = [0.01, 0.02], {"velocity": {UPPER: (0.0, -1.0)}}
    file, case = folder / "half.h5", Blocks(damping=1e-3, **moving)
    walk(case.problem, times[:1], checkpoint=file, **DAMPED)
    other = Blocks(damping=1e-3, density={LOWER: 1.0, UPPER: 2.0}, **moving)
    with rejected("density is {'1': 1.0, '2': 2.0}, in the che"):
        other.problem.restore(file)
    for damping, options, said in (
        (1e-3, {}, "scheme is 'energy-conserving', in the checkpoint"),
        (1e-3, DAMPED | {"spectral_radius": 0.5}, "spectral_radius is 0.5, in the checkpoint"),
        (0.0, DAMPED, "Damping(mass, stiffness) is [], in the checkpoint"),
    ):
        other = Blocks(damping=damping, **moving)
        with rejected(said):
            walk(other.problem, times, checkpoint=file, **options)
        other.problem.restore(file)
        with rejected(said.split(",")[0], "the run that these times continue"):
            walk(other.problem, times, **options)
        if options:
            walk(other.problem, times[1:], **options)  # a walk of its own


def test_the_work_of_a_support_that_moves():
    """A bar whose end is driven: the support's work is what the bar has."""
    ends = lambda x: np.isclose(x[0], 0.0)  # noqa: E731
    bar = Bar(n=32, velocity=lambda x: np.stack([0.02 * ends(x), 0.0 * x[0]]))
    bar.u.x.array[:] = 0.0
    push = fem.Constant(bar.mesh, 0.0)
    bar.bcs[1] = hold(bar.V, ends, 0, push)
    times = 0.02 * np.arange(1, 26)
    step = walk(bar.problem(), times, ramp={push: [(0.0, 0.0), (0.5, 0.01)]})
    assert not any("velocity" in n for n in step.report.notes)
    ledger = step.report.ledger
    gained = ledger.kinetic + ledger.stored - ledger.initial
    assert ledger.supports == pytest.approx(gained, rel=1e-9)
    # sqrt(E rho) v^2 A t: the wave, its front as sharp as a cell, has come to the middle
    assert ledger.supports == pytest.approx(0.02**2 * 0.1 * 0.5, rel=0.04)


def test_a_body_that_rests_stays_at_rest():
    """Statics without inertia, then motion, with the contact forces that carry its weight."""
    case = Blocks(gravity=9.81, guided=True)
    contact = dm.Contact(case.facets, slave=BOTTOM_OF_UPPER, master=TOP_OF_LOWER)
    still = dm.ContactProblem(case.solid, [contact], bcs=case.bcs, loads=case.loads)
    assert dm.newton(still, rtol=1e-11).converged
    rest = case.u.x.array.copy()
    walk(case.problem, [0.01, 0.02, 0.03])
    assert np.abs(case.u.x.array - rest).max() <= 1e-9 * np.abs(rest).max()
    assert case.contact.force[1] == pytest.approx(9.81)


@pytest.mark.parametrize(("damping", "least"), [(0.0, 1e-12), (2e-3, 5e-6)])
def test_a_load_put_on_at_rest_leaves_no_defect(damping, least):
    """Viscous forces on nodes without mass begin from nothing, which costs 1e-6 once."""
    case = Blocks(gravity=9.81, guided=True, damping=damping)
    for step in dm.time_steps(case.problem, 0.01 * np.arange(1, 11), progress=False, rtol=1e-11):
        assert abs(step.report.ledger.defect) < least
    assert step.report.ledger.largest > 0.01 and not step.report.notes


def test_a_start_without_equilibrium_is_noted(monkeypatch):
    """Of the nodes without mass, which nothing can settle; the motion begins all the same."""
    solve = Run.to

    def fails(self, level):
        if level.time < 0.01:
            raise dm.NewtonNotConverged("no equilibrium", None)
        return solve(self, level)

    monkeypatch.setattr(Run, "to", fails)
    case = Blocks(gravity=9.81, guided=True)
    first, second = dm.time_steps(case.problem, [0.01, 0.02], progress=False)
    said = "no equilibrium with the loads of the start (no equilibrium)"
    assert said in "".join(first.report.notes) and said not in "".join(second.report.notes)


@pytest.mark.parametrize("by", ["position", "load"])
def test_the_ledger_counts_what_rigid_sides_do(by):
    """A plate lifts a free block: by a way, or by a force, whose impulse it then has."""
    case = PressedBlocks(n_lower=(3, 3), n_upper=(1, 1), gap=1.0)
    force = fem.Constant(case.mesh, 1.0)
    free = {} if by == "position" else {"load": {"y": force}}
    plate = dm.RigidSide(case.facets, TOP_OF_LOWER, reference=(0.5, 1.0), **free)
    other = [case.bc(BOTTOM_OF_UPPER), case.bc(TOP, (0.0, 0.0))]
    inertia = dm.Inertia(solid := dm.Solid(case.u, dm.Elastic(100.0, 0.3)), 1.0)
    problem = dm.ContactProblem(solid, [plate], bcs=other, terms=[inertia])
    ramps = {
        "position": {plate.position: [(0.0, (0.5, 1.0)), (0.5, (0.5, 1.05))]},
    }
    ledger = walk(problem, 0.02 * np.arange(1, 26), ramp=ramps.get(by)).report.ledger
    assert ledger.supports > 1e-3
    assert abs(ledger.defect) < 1e-9
    if by != "position":
        assert inertia.momentum()[1] == pytest.approx(0.5, rel=1e-9)


def test_the_first_acceleration_is_that_of_the_loads_at_the_start():
    """A force that grows from zero with time: after a step of 1 the velocity is (0 + 1) / 2."""
    bar = Bar()
    bar.u.x.array[:] = 0.0
    force = fem.Constant(bar.mesh, 0.0)
    load = force * ufl.TestFunction(bar.V)[0] * ufl.dx
    problem = dm.ContactProblem(bar.solid, bcs=bar.bcs[:1], loads=load, terms=[bar.inertia])

    def grow(time):
        force.value = time

    walk(problem, [1.0], on_time=grow)
    assert np.allclose(bar.inertia.values("velocity"), [0.5, 0.0], atol=1e-9)


def test_an_initial_velocity_at_a_support_is_taken_away():
    """The motion is that of the velocity that fits the support, and a note says so."""
    found = []
    for clamp in (1.0, 0.0):

        def velocity(x, s=clamp):
            return np.stack([np.where(x[0] > 0.01, 1e-3, 1e-3 * s), s * 0.01 * x[1]])

        bar = Bar(velocity=velocity)
        bar.u.x.array[:] = 0.0
        steps = dm.time_steps(bar.problem(), [0.02, 0.04], progress=False, rtol=1e-11)
        notes = [[n for n in step.report.notes if "velocity" in n] for step in steps]
        # two at the clamp, and along it those of the upper edge, where v_y is not 0
        assert all("up to 0.001 at 10 nodes" in n and "set to 0" in n for n in notes[0])
        assert [len(n) for n in notes] == [clamp, 0]
        found.append(bar.u.x.array.copy())
    assert np.allclose(*found, rtol=0.0, atol=1e-14) and largest(found[0]) > 0.0


def test_forces_that_are_no_numbers_have_no_acceleration(bar):
    """Of a term of the user's, on one rank: all of them raise."""

    class Broken(dm.Term):
        def add_forces(self, F):
            if COMM.rank == COMM.size - 1:
                F.array_w[:] = np.nan

        def add_tangent(self, K):
            pass

    problem = bar.problem(Broken())
    words = "Inertia", "initial acceleration along x", "nan", "finite forces"
    with rejected(*words, error=RuntimeError):
        next(dm.time_steps(problem, [0.1]))


@pytest.fixture(scope="module")
def bar():
    return Bar()


def test_corners_between_contact_sides(monkeypatch):
    """A node all of whose neighbours are on contact sides takes part in the motion further in."""
    case, counts = Blocks((1, 1), (8, 8)), []
    X, inertia = case.problem.X, dm.Inertia(case.solid, 1.0)
    near = np.abs(X - [0.0, 1.0]).max(axis=1) < 0.13  # the corner and its neighbours
    for rings in (mass.RINGS, 1):
        monkeypatch.setattr(mass, "RINGS", rings)
        inertia.meet(near | (X[:, 1] > 0.99), case.problem.bodies.label)
        counts.append(COMM.allreduce(int(inertia.mass.massless.sum())))
    assert counts[1] < counts[0]


def inertia(**options):
    return lambda bar: dm.Inertia(bar.solid, **{"density": 1.0} | options)


def of_blocks(density, tagged=True):
    def make(bar):
        case = Blocks()
        dm.Inertia(case.solid, density, case.cells if tagged else None)

    return make


def first(times=(0.1,), **options):
    return lambda bar: next(dm.time_steps(bar.problem(), times, **options))


def with_scalar_velocity(bar):
    velocity = fem.Function(fem.functionspace(bar.mesh, ("Lagrange", 1)))
    dm.Inertia(bar.solid, 1.0, velocity=velocity)


NEO_HOOKE = dm.NeoHooke(1.0, 0.3)
REFUSED = [
    (inertia(density=0.0), ("density", "Inertia")),
    (of_blocks({LOWER: 1.0}, False), ("density is a dictionary", "give an entry, and cell_tags")),
    (of_blocks({LOWER: 1.0}), ("density has no entry for", f"tags {UPPER}")),
    (of_blocks({LOWER: 1.0, UPPER: 1.0, 7: 1.0}), ("density", "7", "no cell")),
    (with_scalar_velocity, ("velocity", "solid.V")),
    (inertia(velocity=(0.0, np.inf)), ("velocity", "2 finite numbers")),
    (inertia(velocity=lambda x: None), ("velocity(x) is", "for points x")),
    (lambda bar: dm.newton(bar.problem()), ("Inertia", "time_steps", "level=")),
    (lambda bar: next(dm.load_steps(bar.problem(), [0.1])), ("Inertia", "dm.time_steps")),
    (first([0.0, 0.1]), ("times", "increase")),
    (first([1e-300]), ("times", "too short a step")),
    (first(scheme="newmark"), ("scheme", "energy-conserving", "generalised-alpha")),
    (first(spectral_radius=0.8), ("spectral_radius", "energy-conserving")),
    (
        lambda bar: next(dm.time_steps(dm.ContactProblem(bar.solid, bcs=bar.bcs), [0.1])),
        ("problem", "Inertia", "terms="),
    ),
    (lambda bar: dm.Damping(bar.solid, mass=1.0), ("Damping", "inertia")),
    (lambda bar: dm.Damping(bar.inertia, mass=-1.0), ("Damping", "mass", "-1")),
    (
        lambda bar: dm.Damping(
            dm.Inertia(dm.Solid(bar.u, NEO_HOOKE, strain="finite"), 1.0), stiffness=0.1
        ),
        ("stiffness", "finite"),
    ),
]


@pytest.mark.parametrize(("call", "words"), REFUSED)
def test_what_is_refused(bar, call, words):
    """The displacement is as before."""
    before = bar.u.x.array.copy()
    with rejected(*words):
        call(bar)
    assert np.array_equal(bar.u.x.array, before)


def test_the_mass_is_that_of_the_problem_made_last():
    """Where nodes have no mass depends on the contacts: a problem without any has it everywhere."""
    case = Blocks(velocity=(0.0, -1.0))
    dm.ContactProblem(case.solid, terms=[case.inertia])
    with rejected("in a problem that was made later", "other contacts", "make an Inertia for each"):
        next(dm.time_steps(case.problem, [0.1]))


def test_a_large_defect_is_noted():
    """Damped by a small spectral radius, high frequencies lose their energy."""
    bar = Bar()
    step = walk(bar.problem(), [2.0, 4.0], spectral_radius=0.0, **DAMPED)
    assert step.report.ledger.defect < -0.01
    (note,) = (n for n in step.report.notes if "of the energy" in n)
    assert "lost" in note and "spectral_radius" in note.why


def test_inertia_of_rings():
    """A ring of the radius 1 to 2 and height 1 weighs 3 pi; its momentum is along the axis."""
    domain = rectangle([(1.0, 0.0), (2.0, 1.0)], (4, 4), "triangle")
    solid = dm.Solid(create_displacement(domain), dm.Elastic(1.0, 0.3), kinematics="axisymmetric")
    inertia = dm.Inertia(solid, fem.Constant(domain, 2.0), velocity=lambda x: 0.0 * x[:2] + 3.0)
    assert inertia.kinetic_energy() == pytest.approx(0.5 * 6.0 * np.pi * 18.0)
    assert inertia.momentum()[1] == pytest.approx(18.0 * np.pi)


E, RHO, LENGTH, HEIGHT = 100.0, 1.0, 1.0, 0.1
PERIOD = 4 * LENGTH / np.sqrt(E / RHO)


class HeatedBar:
    """A bar held at its left end, whose temperature and modulus are Constants."""

    def __init__(self, *, nu=0.0, bends=False):
        """Create the problem; heat stretches it along x, in proportion to y if it bends."""
        domain = rectangle([(0, 0), (LENGTH, HEIGHT)], (20, 2))
        u = create_displacement(domain)
        self.heat, self.E = fem.Constant(domain, 0.0), fem.Constant(domain, E)
        along = ufl.as_matrix([[1, 0, 0], [0, 0, 0], [0, 0, 0]])
        strain = self.heat * (ufl.SpatialCoordinate(domain)[1] if bends else 1.0) * along
        law = dm.Elastic(E=self.E, nu=nu)
        solid, bcs = dm.Solid(u, law, eigenstrain=strain), [hold(u.function_space, plane(0))]
        self.problem = dm.ContactProblem(solid, bcs=bcs, terms=[dm.Inertia(solid, RHO)])

    def walk(self, times, ramp, **options):
        """Return where the end is, and the ledger, of each step."""
        end = self.problem.u.x.array[::2]
        steps = dm.time_steps(self.problem, times, ramp=ramp, progress=False, **options)
        return [(max(COMM.allgather(end.max(initial=-np.inf))), s.report.ledger) for s in steps]


def test_a_bar_that_is_heated_at_once():
    """Its end swings between 0 and 2 a L, and E a^2 / 2 per volume are there from then on.

    Less what a wave at c from the end relieves while it is heated over s, c s / (3 L) of it, which
    is the integral of E a / s times its stress, E a (t - x / c) / s.
    """
    a, bar = 1e-3, HeatedBar()
    times = PERIOD * np.arange(1, 161) / 80
    found = bar.walk(times, {bar.heat: [(0.0, 0.0), (times[0], a), (times[-1], a)]})
    tips, ledgers = zip(*found, strict=True)
    assert np.mean(tips) == pytest.approx(a * LENGTH, rel=0.01)
    assert max(tips) == pytest.approx(2 * a * LENGTH, rel=0.03)
    given = E * a**2 / 2 * (LENGTH - np.sqrt(E / RHO) * times[0] / 3) * HEIGHT
    assert ledgers[-1].loads == pytest.approx(given, rel=0.01)
    assert max(abs(ledger.defect) for ledger in ledgers) < 1e-12


def test_the_ledger_of_a_bar_that_is_heated_and_softens_goes_on_after_a_restart(folder):
    times, found = PERIOD * np.arange(1, 21) / 40, []
    for count in (20, 7, 20):
        bar, file = HeatedBar(nu=0.3, bends=True), {"checkpoint": folder / "heated.h5"}
        heat = [(0.0, 0.0), (PERIOD / 4, 1e-2), (PERIOD, 0.0)]
        ramp = {bar.heat: heat, bar.E: [(0.0, E), (PERIOD, E / 2)]}
        found.append(bar.walk(times[:count], ramp, **(file if found else {})))
    whole, _, rest = found
    last = whole[-1][1]
    assert len(rest) == 13 and abs(last.defect) < 1e-6 and last.loads > 0.1 * last.largest
    assert rest[-1][1].loads == pytest.approx(last.loads, rel=1e-7)
    assert abs(rest[-1][1].defect) < 1e-6

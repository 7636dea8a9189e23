# SPDX-License-Identifier: MIT
"""Laws of time: bolts that relax, creep under a load, slow motion, cut steps."""

import numpy as np
import pytest
from scipy.optimize import brentq

import dolfinx_mortar as dm
import ufl
from dolfinx import default_scalar_type, fem
from dolfinx_mortar.materials import Norton, Viscoelastic
from tests.cases.glued_bar import NU, Bar, E
from tests.cases.meshes import BOTTOM, LEFT, TOP
from tests.cases.meshes_3d import BACK
from tests.cases.mortar import largest
from tests.cases.pressed_blocks import rejected
from tests.cases.tightened_bar import tighten

A, N, FORCE = 1e-5, 4.0, 10.0  # of stresses about 10
TIMES = [0.5, 1.0, 2.0, 4.0]


def bolt(law):
    """Return a bar of two tied blocks, free to contract, its dt, and its problem."""
    case = Bar("hexahedron")
    dt = fem.Constant(case.mesh, default_scalar_type(0.0))
    case.solid = dm.Solid(case.u, law(dt), case.cells)
    held = [case.hold(BOTTOM, 2), case.hold(TOP, 2), case.hold(LEFT, 0), case.hold(BACK, 1)]
    return case, dt, case.problem(held)


@pytest.mark.mpi
def test_a_bolt_relaxes():
    """Norton's law under a constant strain: the rule of Euler at each step, exactly."""
    case, dt, problem = bolt(lambda dt: Norton(E, NU, A, N, dt))
    tighten(problem, {case.tie: FORCE}, [0.0, 0.0, -case.sign])
    stress, before = case.solid.max("von_mises"), 0.0
    area = FORCE / stress
    for step in dm.load_steps(problem, TIMES, start=0.0, dt=dt, rtol=1e-10):
        c = E * A * (step.time - before)
        stress = brentq(lambda s, c=c, last=stress: s + c * s**N - last, 0.0, stress, xtol=1e-15)
        before = step.time
        assert abs(case.tie.force[2]) / area == pytest.approx(stress, rel=1e-8)
        assert case.solid.max("von_mises") == pytest.approx(stress, rel=1e-8)


def test_relaxation_is_of_first_order_in_time():
    """Against s = (s_0^(1-n) + (n - 1) E A t)^(1/(1-n)), the solution of s' = -E A s^n."""
    errors = []
    for steps in (8, 16):
        case, dt, problem = bolt(lambda dt: Norton(E, NU, A, N, dt))
        tighten(problem, {case.tie: FORCE}, [0.0, 0.0, -case.sign])
        first = case.solid.max("von_mises")
        exact = (first ** (1 - N) + (N - 1) * E * A * 1.0) ** (1 / (1 - N))
        times = np.linspace(0.0, 1.0, steps + 1)[1:]
        *_, last = dm.load_steps(problem, times, start=0.0, dt=dt, rtol=1e-10)
        assert last.time == 1.0
        errors.append(case.solid.max("von_mises") - exact)
    assert errors[1] / errors[0] == pytest.approx(0.5, abs=0.06)


@pytest.mark.mpi
def test_a_standard_linear_solid():
    """The uniaxial stress at constant strain falls by the relaxation of the shear modulus."""
    g, tau = 0.6, 2.0
    case, dt, problem = bolt(lambda dt: Viscoelastic(E, NU, g, tau, dt))
    tighten(problem, {case.tie: FORCE}, [0.0, 0.0, -case.sign])
    first, mu, K = case.solid.max("von_mises"), E / 2 / (1 + NU), E / 3 / (1 - 2 * NU)
    strain, viscous, before, last = first / E, np.zeros(2), 0.0, 0.0
    for step in dm.load_steps(problem, TIMES, start=0.0, dt=dt, rtol=1e-10):
        k = (step.time - before) / (tau + step.time - before)

        def stress(e, k=k, old=viscous):
            """Viscous strain, and the stress along and across with the strain e across."""
            dev = np.array([2.0, -1.0]) / 3 * (strain - e)
            v = old + k * (dev - old)
            return v, K * (strain + 2 * e) + 2 * mu * (dev - g * v)

        e = brentq(lambda e, stress=stress: stress(e)[1][1], -strain, strain, xtol=1e-18)
        viscous, (last, _) = stress(e)
        before = step.time
        assert case.solid.max("von_mises") == pytest.approx(last, rel=1e-8)
    assert last < 0.75 * first


def hang(law, load):
    """Return a bar of two tied blocks under a traction, its dt, its problem, and its strain."""
    case, dt, _ = bolt(law)
    held = [case.hold(BOTTOM, 2), case.hold(LEFT, 0), case.hold(BACK, 1)]
    ds = ufl.Measure("ds", case.mesh, subdomain_data=case.facets)(TOP)
    problem = case.problem(held, loads=load * ufl.TestFunction(case.V)[2] * ds)
    return case, dt, problem, lambda: largest(case.u.x.array.reshape(-1, 3)[:, 2]) / 2.0


@pytest.mark.mpi
def test_norton_creeps_under_a_load():
    """The strain s / E + A s^n t, exactly, in any steps."""
    s = 10.0
    case, dt, problem, strain = hang(lambda dt: Norton(E, NU, A, N, dt), s)
    dm.newton(problem, rtol=1e-10)
    problem.commit()
    for step in dm.load_steps(problem, TIMES, start=0.0, dt=dt, rtol=1e-10):
        assert strain() == pytest.approx(s / E + A * s**N * step.time, rel=1e-9)
        assert case.solid.max("von_mises") == pytest.approx(s, rel=1e-9)


def test_a_standard_linear_solid_creeps_under_a_load():
    """The strain s / 9K + s / 3mu (1 + g / (1 - g) (1 - exp(-(1 - g) t / tau))), of first order."""
    s, g, tau, end = 10.0, 0.6, 2.0, 4.0
    mu, K = E / 2 / (1 + NU), E / 3 / (1 - 2 * NU)
    slow = g / (1 - g) * (1 - np.exp(-(1 - g) * end / tau))
    errors = []
    for steps in (8, 16):
        _, dt, problem, strain = hang(lambda dt: Viscoelastic(E, NU, g, tau, dt), s)
        dm.newton(problem, rtol=1e-10)
        problem.commit()
        assert strain() == pytest.approx(s / E, rel=1e-9)
        times = np.linspace(0.0, end, steps + 1)[1:]
        list(dm.load_steps(problem, times, start=0.0, dt=dt, rtol=1e-10))
        errors.append(strain() - s / 9 / K - s / 3 / mu * (1 + slow))
    assert errors[1] / errors[0] == pytest.approx(0.5, abs=0.03)
    assert abs(errors[1]) < 0.02 * s / E


def stretched(law, density=None):
    """Return a bar whose upper end is moved by a Constant, its dt, the Constant, its problem."""
    case, dt, _ = bolt(law)
    way = fem.Constant(case.mesh, default_scalar_type(0.0))
    held = [case.hold(BOTTOM, 2), case.hold(TOP, 2, way), case.hold(LEFT, 0), case.hold(BACK, 1)]
    terms = [] if density is None else [dm.Inertia(case.solid, density)]
    return case, dt, way, case.problem(held, terms=terms)


@pytest.mark.mpi
@pytest.mark.parametrize(
    "law",
    [lambda dt: Norton(E, NU, A, N, dt), lambda dt: Viscoelastic(E, NU, 0.6, 2.0, dt)],
)
def test_slow_motion_is_that_of_load_steps(law):
    """Waves cross the bar in 2e-3 of the first step; the inertia is some 1e-6 of the stiffness."""
    found = []
    for density in (None, 1e-3):
        case, dt, way, problem = stretched(law, density)
        given = {"ramp": {way: [(0.0, 0.0), (1.0, 0.02), (4.0, 0.02)]}, "dt": dt, "rtol": 1e-9}
        if density is None:
            steps = dm.load_steps(problem, TIMES, start=0.0, **given)
        else:
            damped = {"scheme": "generalised-alpha", "spectral_radius": 0.0}
            steps = dm.time_steps(problem, TIMES, start=0.0, **damped, **given)
        found.append([case.solid.max("von_mises") for _ in steps])
    assert found[1] == pytest.approx(found[0], rel=1e-5)
    assert found[0][-1] < 0.9 * max(found[0])


@pytest.mark.parametrize("in_time", [False, True])
def test_parts_of_steps_have_their_own_length(in_time):
    law = lambda dt: Norton(E, NU, A, N, dt)  # noqa: E731
    _, dt, way, problem = stretched(law, 1e-3 if in_time else None)
    seen, solve = [], problem.solid.evaluate

    def fails_once(*args, **options):
        seen.append(float(dt.value))
        if len(seen) == 1:
            raise dm.NewtonNotConverged("for the test", dm.StepReport())
        return solve(*args, **options)

    problem.solid.evaluate = fails_once
    steps = dm.time_steps if in_time else dm.load_steps
    *_, last = steps(problem, [1.0], ramp={way: [(0.0, 0.0), (1.0, 0.02)]}, start=0.0, dt=dt)
    assert last.time == 1.0 and seen[0] == 1.0 and set(seen[1:]) == {0.5}


def test_a_step_length_that_no_law_reads():
    """The law would keep the length that its own Constant has."""
    case, dt, problem = bolt(lambda dt: Norton(E, NU, A, N, dt))
    other = fem.Constant(case.mesh, default_scalar_type(0.0))
    for given, told in ((dt, False), (other, True)):
        *_, last = dm.load_steps(problem, [1.0], start=0.0, dt=given)
        notes = [note for note in last.report.notes if note.startswith("dt is for a Constant")]
        assert bool(notes) == told


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda dt: Norton(E, NU, -1.0, N, dt), ("A", "-1.0")),
        (lambda dt: Norton(E, NU, A, 0.5, dt), ("n", "0.5")),
        (lambda dt: Viscoelastic(E, NU, 1.5, 1.0, dt), ("g", "1.5")),
        (lambda dt: Viscoelastic(E, NU, 0.5, 0.0, dt), ("tau", "0.0")),
    ],
)
def test_wrong_parameters(call, words):
    with rejected(*words):
        call(0.1)

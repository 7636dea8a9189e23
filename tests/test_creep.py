# SPDX-License-Identifier: MIT
"""Laws of time: a bolt that relaxes, creep under a load, a standard linear solid, cut steps."""

import numpy as np
import pytest
from scipy.optimize import brentq

import dolfinx_mortar as dm
from dolfinx import default_scalar_type, fem
from dolfinx_mortar.materials import Norton, Viscoelastic
from tests.cases.glued_bar import NU, Bar, E
from tests.cases.meshes import BOTTOM, LEFT, TOP
from tests.cases.meshes_3d import BACK
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


def test_parts_of_steps_have_their_own_length():
    case, dt, problem = bolt(lambda dt: Norton(E, NU, A, N, dt))
    tighten(problem, {case.tie: FORCE}, [0.0, 0.0, -case.sign])
    seen, solve = [], problem.solid.evaluate

    def fails_once(*args, **options):
        seen.append(float(dt.value))
        if len(seen) == 1:
            raise dm.NewtonNotConverged("for the test", dm.StepReport())
        return solve(*args, **options)

    problem.solid.evaluate = fails_once
    *_, last = dm.load_steps(problem, [1.0], start=0.0, dt=dt)
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

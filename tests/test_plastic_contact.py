# SPDX-License-Identifier: MIT
"""Elasto-plastic line contact: forces, pressures, strains, Newton's rate, separation, failures.

Source of the numbers: two independent small-strain finite element codes that agree to the digits
given (half disc of radius 8 on a block, displacement 0.2 in one step and in ten), with facets.
"""

from dataclasses import replace

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from tests.cases.hertz import PLASTIC, create_case, create_mesh

ONE_STEP = {"force": 4485.5, "peak": 1913.0, "strain": 0.03848}
TEN_STEPS = {"force": 4619.0, "peak": 1698.0, "strain": 0.0381}
TOLERANCE = {"force": 5e-3, "peak": 2e-2, "strain": 3e-2}


@pytest.mark.parametrize(
    ("count", "expected"), [(1, ONE_STEP), pytest.param(10, TEN_STEPS, marks=pytest.mark.slow)]
)
def test_force_pressure_and_strain(count, expected):
    """The loading path matters; with updated geometry the choice of the slave does not."""
    found = []
    for slave in ("block", "disc"):
        case = create_case(create_mesh("graded", 0.05), slave=slave, surface="facets")
        times = np.linspace(0, 0.2, count + 1)[1:]
        for step in dm.load_steps(case.problem, times, on_time=case.press, progress=False):
            report = step.report
            assert len(step.parts) == 1 and report.newton_iterations <= 13
            assert report.factorisations <= 1.2 * report.newton_iterations
        peak = float(case.contact.gather(case.problem.u)["pressure"].max())
        strain = case.problem.solid.max("plastic_strain_norm")
        found.append({"force": case.force, "peak": peak, "strain": strain})
        for name, value in expected.items():
            assert abs(found[-1][name] / value - 1) < TOLERANCE[name], (name, found[-1])
    one, other = found
    assert abs(one["force"] / other["force"] - 1) < 2e-4
    assert count > 1 or abs(one["peak"] / other["peak"] - 1) < 2e-3


def test_quadratic_tail():
    """With frozen geometry, small increments are squared from one iteration to the next."""
    case = create_case(create_mesh("paper", 0.05), geometry="reference")
    case.press(0.2)
    report = dm.newton(case.problem, rtol=1e-12)
    history = np.array(report.residual_history)
    tail = history[(history < 2e-2) & (history > 1e-13)]
    assert len(tail) >= 3
    # the constant is that of the kinked law; order 1.6 leaves room for points that start to yield
    assert np.all(tail[1:] < 20 * tail[:-1] ** 1.6)
    assert history[-1] < 1e-11


def test_units():
    """Units of length and stress change no dimensionless result and no iteration count."""
    results = []
    for scale, modulus in ((1.0, 1.0), (1e6, 1e-6)):
        mesh = dm.meshing.hertz(MPI.COMM_WORLD, kind="paper")
        mesh.mesh.geometry.x[:] *= scale
        steel = replace(
            PLASTIC, E=PLASTIC.E * modulus, Y=PLASTIC.Y * modulus, a=PLASTIC.a * modulus
        )
        case = create_case(mesh, steel)
        case.press(0.2 * scale)
        report = dm.newton(case.problem)
        case.problem.commit()
        pressure = case.contact.gather(case.problem.u)["pressure"] / modulus
        strain = case.problem.solid.max("plastic_strain_norm")
        results.append((case.force / (scale * modulus), strain, pressure, report.newton_iterations))
    (force, strain, pressure, count), scaled = results
    assert scaled[:2] == pytest.approx((force, strain), rel=1e-8)
    assert np.abs(scaled[2] - pressure).max() < 1e-7 * pressure.max()
    assert abs(scaled[3] - count) <= 1


def test_tolerances_down_to_round_off():
    """Rtol 1e-12 stops at round-off, also for separated bodies; unloading leaves a dent."""
    case, forces = create_case(create_mesh("paper", 0.05)), []
    for depth in (0.1, 0.2, 0.0, -0.05, 0.0, 0.2):
        case.press(depth)
        assert dm.newton(case.problem, rtol=1e-12).converged
        case.problem.commit()
        forces.append(case.force)
        assert (case.force > 0) == (depth > 0)
        if depth < 0:
            nodes = case.contact.gather(case.problem.u)
            sink = (nodes["X"] - nodes["x"])[:, 1]
            assert sink.max() > 0.01 and nodes["gap"][np.argmax(sink)] > 0.06
    assert forces[-1] == pytest.approx(forces[1], rel=0.02)  # kinematic hardening

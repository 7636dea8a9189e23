# SPDX-License-Identifier: MIT
"""Rubber that hardly changes its volume: forces of the literature, and what Newton's method needs.

The cylinder of Sussman and Bathe: read off their graph 250 and 1400 N/mm at an approach of 100 and
200 mm; twelve variants of another program (Ansys VM201, VM211) lie between .966 and 1.066 of it.
"""

from dataclasses import replace

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from dolfinx_mortar.solid.mean_volume import VolumeStep
from tests.rubber_cylinder import RUBBER, create_cylinder
from tests.solid_case import create_displacement, create_domain, set_wave, total

HALFWAY, WHOLE = (241.0, 267.0), (1350.0, 1435.0)


def squeeze(cylinder, steps=10, way=200.0):
    """Return forces and Newton iterations of steps to an approach."""
    forces, iterations = [], []
    for k in range(1, steps + 1):
        report = cylinder.approach(way * k / steps, max_it=80)
        forces.append(cylinder.force)
        iterations.append(report.newton_iterations)
    print(np.round(forces, 1), iterations)
    return np.array(forces), np.array(iterations)


@pytest.mark.mpi
def test_the_rubber_cylinder():
    """The forces of the literature; whole steps, no shift, on a coarse mesh in big steps."""
    cylinder = create_cylinder()
    forces, iterations = squeeze(cylinder, 4)
    assert HALFWAY[0] < forces[1] < HALFWAY[1]
    assert WHOLE[0] < forces[3] < WHOLE[1]
    assert iterations.max() <= 12


@pytest.mark.slow
def test_no_locking_and_no_dependence_on_the_bulk_modulus():
    """K a hundred times: forces within 1 % (no locking), iterations nearly the same.

    With u alone as unknown they are 14 to 26 a step, and the fifth fails.
    """
    found = [squeeze(create_cylinder(law=replace(RUBBER, K=f * RUBBER.K)), 10) for f in (1, 100)]
    (forces, iterations), (stiff, more) = found
    np.testing.assert_allclose(stiff, forces, rtol=0.01)
    assert iterations.mean() < 8 and more.mean() < 8
    assert (more <= iterations + 3).all()


@pytest.mark.slow
def test_sizes_and_sides_agree():
    """At both approaches within 1 %: half the size, either slave."""
    cases = [{}, {"h": 10.0}, {"h": 10.0, "slave": "top"}]
    ends = np.array([squeeze(create_cylinder(**case))[0][[4, 9]] for case in cases])
    assert ((ends > (HALFWAY[0], WHOLE[0])) & (ends < (HALFWAY[1], WHOLE[1]))).all()
    np.testing.assert_allclose(ends, np.broadcast_to(ends[0], ends.shape), rtol=0.01)


def test_the_energy_along_a_step():
    """Equal to U(j) to the second order of what is missed, with its derivative at the start."""
    rng = np.random.default_rng(1)
    ratio, change = 1 + 0.1 * rng.normal(size=5), rng.normal(size=5)
    K = 7.0
    step = VolumeStep(ratio, change, K / 2 * (ratio - 1) ** 2, K * (ratio - 1), np.full(5, K))
    missed = 0.01 * rng.normal(size=5)
    at = ratio + 0.3 * change + missed
    below = K / 2 * (at - 1) ** 2 - step.energy_at(0.3, at)
    np.testing.assert_allclose(below, K / 2 * missed**2, rtol=1e-9, atol=1e-14)
    np.testing.assert_allclose(step.pressure_at(0.3), K * (at - missed - 1), rtol=1e-12)


@pytest.mark.parametrize("law", [dm.NeoHooke(1000.0, 0.49), RUBBER], ids=repr)
def test_the_tangent_with_pressures_of_their_own(law):
    """With those of u it is the consistent one; others change it linearly, and leave no trace."""
    u = create_displacement(create_domain("quadrilateral"))
    solid = dm.Solid(u, law, strain="finite", volumetric="reduced")
    du = fem.Function(u.function_space)
    set_wave(u, 0.05)
    set_wave(du, 0.01, 0.4)
    step = solid.volume_step(du)
    K = [solid.create_matrix() for _ in range(4)]
    for matrix, pressure in zip(
        K, (None, step.pressure, step.pressure_at(1.0), step.pressure_at(2.0)), strict=True
    ):
        matrix.zeroEntries()
        solid.add_tangent(matrix, pressure)
    first = K[0].copy()
    K[0].axpy(-1.0, K[1])
    assert K[0].norm() < 1e-12 * K[1].norm()
    K[2].axpy(-1.0, K[1])  # linear in the pressure
    K[3].axpy(-1.0, K[1])
    assert K[2].norm() > 1e-4 * K[1].norm()
    K[3].axpy(-2.0, K[2])
    assert K[3].norm() < 1e-11 * K[1].norm()
    again = solid.create_matrix()
    solid.assemble_tangent(again)
    again.axpy(-1.0, first)
    assert again.norm() < 1e-14 * first.norm()  # ranks add what they send in any order
    # the change of volumes is that of u
    before = total(step.ratio)
    u.x.array[:] += 1e-6 * du.x.array
    after = total(solid.volume_step(du).ratio)
    assert (after - before) / 1e-6 == pytest.approx(total(step.change), rel=1e-4)

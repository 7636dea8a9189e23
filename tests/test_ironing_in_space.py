# SPDX-License-Identifier: MIT
"""Ironing in space: a cylinder and a ball dragged over a block by 1.5 diameters in 20 steps."""

import numpy as np
import pytest

import dolfinx_mortar as dm
from benchmarks.ironing_3d import DRAGS, PRESSES, create

pytestmark = [pytest.mark.slow, pytest.mark.serial]


@pytest.mark.parametrize(("tool", "friction"), [("cylinder", 0.0), ("ball", 0.3)])
def test_dragged_by_one_and_a_half_diameters(tool, friction):
    """No step is cut, each takes five iterations; the drag is mu V, V the same all the way."""
    case = create(tool, 1, friction=friction)
    steps, forces = [], []
    for step in dm.load_steps(case.problem, case.times, on_time=case.move):
        steps.append(step)
        forces.append(np.abs(case.contact.force))
    assert len(steps) == PRESSES + DRAGS
    assert all(len(step.parts) == 1 for step in steps)
    assert np.mean([step.report.newton_iterations for step in steps]) < 5.5
    solves = [iteration for step in steps for iteration in step.report.iterations]
    assert np.mean([iteration.linear_iterations for iteration in solves]) < 20
    H, _, V = np.array(forces)[PRESSES + 5 : -5].T  # away from the ends of the block
    assert np.ptp(V) < 0.03 * V.mean()
    assert np.abs(H - friction * V).max() < 0.02 * V.mean()

# SPDX-License-Identifier: MIT
"""The exact tangent of contact with a rigid tool: Newton's rate."""

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx_mortar.steps import newton as newton_module
from dolfinx_mortar.steps.subproblem import Subproblem
from tests.tool_case import Block

pytestmark = pytest.mark.serial


def tail(monkeypatch, case, tool, exact, **options):
    """Return the excesses of a step's iterations, with or without the exact tangent."""
    problem = case.problem([tool], **options)
    excesses = []
    measure = newton_module.measure

    def recorded(*arguments):
        excesses.append(measure(*arguments))
        return excesses[-1]

    monkeypatch.setattr(newton_module, "measure", recorded)
    allowed = property(lambda self: exact)
    monkeypatch.setattr(Subproblem, "may_be_exact", allowed)
    down = np.zeros(len(tool.reference))
    down[-1] = -1.5
    ramp = {tool.position: [(0.0, tool.reference), (1.0, tool.reference + down)]}
    steps = dm.load_steps(problem, [0.5, 1.0], ramp=ramp, rtol=1e-10, progress=False)
    reports = [step.report for step in steps]
    return sum(r.newton_iterations for r in reports), reports[-1], [e.forces for e in excesses]


@pytest.mark.parametrize("friction", [None, pytest.param(0.3, marks=pytest.mark.slow)])
def test_newton_is_quadratic(friction, monkeypatch):
    """A small disc pressed deep into rubber: each exact iteration squares the residual."""
    counts = []
    for exact in (True, False):
        case = Block(n=16, fine=4.0)
        tool = case.tool(dm.shapes.Cylinder([0.0, 2.0], 2.0), friction=friction)
        options = {"law": dm.NeoHooke(1.0, 0.3), "strain": "finite"}
        count, report, forces = tail(monkeypatch, case, tool, exact, **options)
        counts.append(count)
        if exact:
            assert any(iteration.exact_tangent for iteration in report.iterations)
            r = np.array(forces[-4:])  # 0.7 to 1.2 times the square, down to a tenth of rtol
            assert (r[1:] < np.maximum(2.0 * r[:-1] ** 2, 1e-11)).all()
    assert counts[0] < counts[1]

# SPDX-License-Identifier: MIT
"""Fallbacks of a QP with friction: given limits, and updates of the worst nodes only."""

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx_mortar.algebra.parallel import any_rank
from dolfinx_mortar.qp import active_set
from dolfinx_mortar.qp.held import HeldProblem, Outcome
from tests.cases.friction import create

PATH = [(0.0, -0.02), (0.006, -0.02), (0.03, -0.02)]


def walk(cell, path=PATH, **options):
    """Return the contact, and how friction was linearised in each step."""
    case, said = create(cell, friction=0.3, **options), []
    for x, y in path:
        case.push(x, *([0.0] if case.problem.d == 3 else []), y)
        said.append(dm.newton(case.problem, rtol=1e-11).friction)
        case.problem.commit()
    return case, said


def agree(case, other, accuracy):
    shown, expected = (c.contact.gather(c.problem.u) for c in (case, other))
    for name in ("pressure", "traction", "slip", "x"):
        scale = np.abs(expected[name]).max()
        assert np.abs(shown[name] - expected[name]).max() <= accuracy * scale, name
    assert np.array_equal(shown["status"], expected["status"])


@pytest.mark.parametrize("cell", ["triangle", "hexahedron"])
def test_given_limits_again_and_again(cell, monkeypatch):
    """Where the exact linearisation goes in circles: the same answer, and the report says so."""
    expected, said = walk(cell)
    assert said == ["exact linearisation"] * 3
    update = active_set._update

    def go_in_circles(problem, start, level):
        if any_rank(problem.qp.comm, problem.qp.friction.coefficient.any())[0]:
            first = problem.hold(start, level)  # what it has seen until then
            return Outcome(first.predicted, 1, "it came back")
        return update(problem, start, level)

    monkeypatch.setattr(active_set, "_update", go_in_circles)
    case, said = walk(cell)
    assert said == ["given limits"] * 3
    agree(case, expected, 1e-7)


@pytest.mark.parametrize("cell", ["triangle", "hexahedron"])
def test_the_worst_nodes_alone(cell, monkeypatch):
    """More solves, the same answer."""
    expected, _ = walk(cell)
    hold = HeldProblem.hold
    monkeypatch.setattr(
        HeldProblem, "hold", lambda self, state, level, worst: hold(self, state, level, worst=True)
    )
    case, said = walk(cell)
    assert said == ["exact linearisation"] * 3
    agree(case, expected, 1e-7)

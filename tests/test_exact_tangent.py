# SPDX-License-Identifier: MIT
"""The exact tangent of moving geometry in 2D: its rate, and when it is used."""

import numpy as np
import pytest

import dolfinx_mortar as dm
import dolfinx_mortar.steps.newton as newton_module
from dolfinx_mortar.steps.subproblem import Subproblem
from tests.cases.finite_sliding import indentation, walk
from tests.cases.hertz import ELASTIC, create_case, create_mesh
from tests.choice import quick


def rolled(**options):
    """Return a disc that is pressed down by 1 and then rolled by 2, and the last report."""
    case = create_case(create_mesh("graded", 0.3), ELASTIC, **options)
    for x, y in ((0.0, -1.0), (2.0, -1.0)):
        case.top.value[:] = (x, y)
        report = dm.newton(case.problem, rtol=1e-10)
        case.problem.commit()
    return case, report


def residuals(report):
    """Return the residuals of the iterations with the exact tangent, and the one before."""
    worst = [max(i.force_residual, i.contact_residual) for i in report.iterations]
    first = next(k for k, i in enumerate(report.iterations) if i.exact_tangent)
    assert all(i.exact_tangent for i in report.iterations[first:])
    return worst[first - 1 :]


@pytest.mark.parametrize("degree", quick([1, 2], 1))
def test_newton_is_quadratic_at_the_end_and_the_answer_the_same(degree, monkeypatch):
    """Ratios of residuals fall with the residuals; the fixed point, longer, ends there, too."""
    case, report = rolled(degree=degree)
    r = residuals(report)
    assert len(r) >= 3
    ratios = np.array(r[1:]) / r[:-1]
    assert ratios[0] < 0.1
    assert ratios[1] < 0.1 * ratios[0]
    force = case.contact.force
    monkeypatch.setattr(Subproblem, "may_be_exact", False)
    case, slow = rolled(degree=degree)
    assert not any(i.exact_tangent for i in slow.iterations)
    assert slow.newton_iterations >= report.newton_iterations + 3
    assert np.abs(case.contact.force - force).max() < 1e-8 * np.abs(force).max()


def test_a_tangent_without_solution_gives_way_to_the_fixed_point(monkeypatch):
    """Where its QP fails, the step ends with the same answer without it, and a note says so."""
    expected = rolled()[0].contact.force
    solve = newton_module.backends.solve

    def fail(qp, *args, **options):
        if not qp.definite:
            raise newton_module.backends.QPNotSolved("no solution")
        return solve(qp, *args, **options)

    monkeypatch.setattr(newton_module.backends, "solve", fail)
    case, report = rolled()
    assert not any(i.exact_tangent for i in report.iterations)
    assert any("without the exact tangent (no solution)" in note for note in report.notes)
    assert np.abs(case.contact.force - expected).max() < 1e-8 * np.abs(expected).max()


@pytest.mark.parametrize("to", [(0.15, -0.2), (0.12, -0.3)])
def test_newton_is_quadratic_with_friction(to):
    """Sliding, and sticking while it is pressed on: residuals are squared, down to round-off."""
    case = indentation(n=((24, 5), (16, 2)), radius=1.0, length=6.0, height=2.0, friction=0.3)
    walk(case, lambda t: (0.1 * max(t - 1.0, 0.0), -0.2 * min(t, 1.0)), [0.5, 1.0, 1.5, 2.0])
    case.held.value[:] = to
    r = np.array(residuals(dm.newton(case.problem, rtol=1e-11)))
    assert len(r) >= 4
    assert (r[0] > 0.03) == (to == (0.12, -0.3))  # from there on, at finite strain
    r = r[r < 0.03]
    assert len(r) >= 3
    assert (r[1:] < np.maximum(2.0 * r[:-1] ** 2, 1e-12)).all()  # .13 to 1.02 times the square

# SPDX-License-Identifier: MIT
"""The exact tangent of moving geometry: its rate, and when it is used."""

import numpy as np
import pytest

import dolfinx_mortar as dm
import dolfinx_mortar.steps.newton as newton_module
from dolfinx import fem
from dolfinx_mortar.steps.subproblem import Subproblem
from tests.cases.ball import STEEL
from tests.cases.ball import create_mesh as create_ball
from tests.cases.finite_sliding import indentation, walk
from tests.cases.hertz import ELASTIC, create_case, create_mesh
from tests.cases.two_bodies import create_problem, held
from tests.tool_case import Block


def rolled(degree=1):
    """Press a disc down by 1 and then roll it by 2; return the contact and the last report."""
    case = create_case(create_mesh("graded", 0.3), ELASTIC, degree=degree)
    _, report = (case.move(x, 1.0, rtol=1e-10) for x in (0.0, 2.0))
    return case.contact, report


def slid(slave=3, surface="facets", options=None):
    """Press half of a ball into half of a block, and move it along the plane of symmetry."""
    m = create_ball(0.5, "hexahedron")
    V = fem.functionspace(m.mesh, ("Lagrange", 1, (3,)))
    motion = [fem.Constant(m.mesh, value) for value in (0.0, 0.0, -0.2)]
    places = [(1, i, 0.0) for i in range(3)] + [(2, i, motion[i]) for i in range(3)]
    bcs = [held(V, m.facet_tags, tag, value, i) for tag, i, value in [*places, (5, 0, 0.0)]]
    contact = dm.Contact(m.facet_tags, slave=slave, master=7 - slave, surface=surface)
    problem = create_problem(V, [contact], bcs, STEEL, petsc_options=options)
    for motion[1].value in (0.0, 0.6):
        report = dm.newton(problem, rtol=1e-10)
        problem.commit()
    return contact, report


def residuals(report, before):
    """Return the residuals of the iterations with the exact tangent, and some before."""
    worst = [max(i.force_residual, i.contact_residual) for i in report.iterations]
    first = next(k for k, i in enumerate(report.iterations) if i.exact_tangent)
    assert all(i.exact_tangent for i in report.iterations[first:])
    return np.array(worst[first - before :])


CHOLESKY = {"options": {"pc_type": "cholesky"}}


@pytest.mark.parametrize(
    ("run", "options", "saved"),
    [
        (rolled, {}, 3),
        pytest.param(rolled, {"degree": 2}, 3, marks=pytest.mark.slow),
        (slid, CHOLESKY, 5),
        (slid, CHOLESKY | {"slave": 4, "surface": "smooth"}, 5),
    ],
)
def test_newton_is_fast_at_the_end_and_the_answer_the_same(run, options, saved, monkeypatch):
    """Quadratic in the plane; what turns normals in space and is left out gives .002 to .006."""
    contact, report = run(**options)
    r = residuals(report, before=2)
    ratios = r[1:] / r[:-1]
    if run is rolled:
        assert ratios[1] < 0.1 and ratios[2] < 0.1 * ratios[1]
    else:
        assert ratios[1] < 0.1 * ratios[0] and ratios[2:].max() < 0.02
    monkeypatch.setattr(Subproblem, "may_be_exact", False)
    other, slow = run(**options)
    assert not any(i.exact_tangent for i in slow.iterations)
    assert slow.newton_iterations >= report.newton_iterations + saved
    assert np.abs(other.force - contact.force).max() < 1e-8 * np.abs(contact.force).max()


def test_a_tangent_without_solution_gives_way_to_the_fixed_point(monkeypatch):
    """Where its QP fails, the step ends with the same answer without it, and a note says so."""
    expected = rolled()[0].force
    solve = newton_module.backends.solve

    def fail(qp, *args, **options):
        if not qp.definite:
            raise newton_module.backends.QPNotSolved("no solution")
        return solve(qp, *args, **options)

    monkeypatch.setattr(newton_module.backends, "solve", fail)
    contact, report = rolled()
    assert not any(i.exact_tangent for i in report.iterations)
    assert any("without the exact tangent (no solution)" in note for note in report.notes)
    assert np.abs(contact.force - expected).max() < 1e-8 * np.abs(expected).max()


@pytest.mark.mpi
def test_multigrid_of_the_symmetric_matrix_serves(monkeypatch):
    """GMRES takes at most 15 iterations more than conjugate gradients; the answer is the same."""
    contact, report = slid()
    monkeypatch.setattr(Subproblem, "may_be_exact", False)
    other, slow = slid()
    assert report.linear_solver == slow.linear_solver == "cg + gamg"
    exact = [i for i in report.iterations if i.exact_tangent]
    assert exact and len(slow.iterations) >= len(report.iterations) + 4
    most = max(i.linear_iterations for i in slow.iterations)
    assert max(i.linear_iterations for i in exact) <= most + 15
    assert report.factorisations <= slow.factorisations
    assert np.abs(contact.force - other.force).max() < 1e-8 * np.abs(other.force).max()


def pushed(to):
    """Press a half ring into rubber with friction and push it; return the report of a last step."""
    case = indentation(n=((24, 5), (16, 2)), radius=1.0, length=6.0, height=2.0, friction=0.3)
    walk(case, lambda t: (0.1 * max(t - 1.0, 0.0), -0.2 * min(t, 1.0)), [0.5, 1.0, 1.5, 2.0])
    case.held.value[:] = to
    return dm.newton(case.problem, rtol=1e-11)


def by_a_tool(friction):
    """Press a small disc deep into rubber."""
    case = Block(n=16, fine=4.0)
    tool = case.tool(dm.shapes.Cylinder([0.0, 2.0], 2.0), friction=friction)
    problem = case.problem([tool], dm.NeoHooke(1.0, 0.3), strain="finite")
    for tool.position.value[1] in (1.25, 0.5):
        report = dm.newton(problem, rtol=1e-10)
        problem.commit()
    return report


@pytest.mark.parametrize(
    ("run", "argument"),
    [
        (pushed, (0.15, -0.2)),
        (pushed, (0.12, -0.3)),
        (by_a_tool, None),
        pytest.param(by_a_tool, 0.3, marks=pytest.mark.slow),
    ],
)
def test_newton_is_quadratic(run, argument):
    """Sliding, sticking while it is pressed on, a tool: residuals are squared, to round-off."""
    r = residuals(run(argument), before=1)
    assert (r[0] > 0.03) == (argument != (0.15, -0.2))  # from there on, at finite strain
    r = r[r < 0.03]
    assert len(r) >= 3
    floor = 1e-12 if run is pushed else 1e-11
    assert (r[1:] < np.maximum(2.0 * r[:-1] ** 2, floor)).all()  # .13 to 1.02 times the square

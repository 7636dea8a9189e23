# SPDX-License-Identifier: MIT
"""The exact tangent of moving geometry in 2D: its derivatives, its rate, and when it is used."""

from dataclasses import replace
from types import SimpleNamespace

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest

import dolfinx_mortar as dm
import dolfinx_mortar.steps.newton as newton_module
from dolfinx import fem
from dolfinx_mortar.algebra import congruence, triplets
from dolfinx_mortar.interfaces.constraints import Constraints
from dolfinx_mortar.mortar import edges, integrals
from dolfinx_mortar.mortar.integrals import (
    find_segments,
)
from dolfinx_mortar.newton_method.linearisation import Corrections, Linearisation
from dolfinx_mortar.newton_method.residuals import Residuals
from dolfinx_mortar.newton_method.watch import DIGIT, MOST_RISES, Watch
from dolfinx_mortar.qp import BoundQP
from tests import meshes, on_edges
from tests.choice import quick
from tests.finite_sliding import indentation, walk
from tests.hertz_case import ELASTIC, create_case, create_mesh
from tests.meshes import BOTTOM_OF_UPPER, TOP_OF_LOWER
from tests.rough_sides import RoughSides

COMM, COMM_WORLD = MPI.COMM_SELF, MPI.COMM_WORLD
TURN = np.array([[0.0, -1.0], [1.0, 0.0]])


class Rough(RoughSides):
    """Two rough, bent sides that cover each other in part, with random tractions."""

    def __init__(self, degree, *, smooth, rings, shared, seed):
        """Create them; the degree is that of the displacement."""
        rng = np.random.default_rng(seed)
        mesh, _, facets = meshes.two_blocks(
            COMM, n_lower=(7, 1), n_upper=(4, 1), x_lower=(0.5, 1.5), x_upper=(1.0, 2.0)
        )
        V = fem.functionspace(mesh, ("Lagrange", degree, (2,)))
        u, X = fem.Function(V), V.tabulate_dof_coordinates()
        u.x.array[:] = 0.03 * rng.standard_normal(u.x.array.size)
        u.x.array[1::2] -= 0.2 * (X[:, 0] - 1.3) ** 2
        weight = (lambda x: 2 * np.pi * x[..., 0]) if rings else None
        sagittas = (0.05, 0.1) if smooth else None
        super().__init__(u, facets, TURN, rng, sagittas=sagittas, weight=weight, shared=shared)


@pytest.mark.parametrize("shared", [False, True])
@pytest.mark.parametrize("rings", [False, True])
@pytest.mark.parametrize(("degree", "smooth"), [(1, False), (1, True), (2, False)])
def test_derivatives_are_those_of_forces_and_gaps(degree, smooth, rings, shared, monkeypatch):
    """Of random tractions on sides that cover each other in part; to 1e-9 of the largest entry."""
    monkeypatch.setattr(edges, "SUNK", 2.0)
    on_edges.count_all_parts(monkeypatch)
    # Seeds whose partly open facet of degree 2 is covered by 5 % and less amplify round-off: the
    # functions of all its nodes need a matrix whose condition is the covered part to the power -4.
    rough = Rough(degree, smooth=smooth, rings=rings, shared=shared, seed=38 if degree == 2 else 3)
    assert 0 < rough.keep.sum() < len(rough.keep)
    closed = rough.sharing(find_segments(rough.pairing, rough.u)[0]).closed
    assert ((closed > 0.0) & (closed < 1.0)).any() != shared
    for found, expected in zip(rough.derivatives(), rough.differences(), strict=True):
        assert np.abs(found - expected).max() < 1e-9 * np.abs(expected).max()


@pytest.mark.parametrize("degree", [1, 2])
def test_derivatives_of_weights_that_fall_with_the_gap(degree, monkeypatch):
    """Of what stands back, at given levels."""
    levels = lambda slave, least, sums, size: np.tile([-0.1, 1.0], (len(size), 1))  # noqa: E731
    monkeypatch.setattr(integrals, "_reaches", levels)
    rough = Rough(degree, smooth=False, rings=False, shared=True, seed=5)
    assert find_segments(rough.pairing, rough.u)[0].reach is not None
    for found, expected in zip(rough.derivatives(), rough.differences(), strict=True):
        assert np.abs(found - expected).max() < 1e-9 * np.abs(expected).max()


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
    monkeypatch.setattr(newton_module._Step, "may_be_exact", False)
    case, slow = rolled(degree=degree)
    assert not any(i.exact_tangent for i in slow.iterations)
    assert slow.newton_iterations >= report.newton_iterations + 3
    assert np.abs(case.contact.force - force).max() < 1e-8 * np.abs(force).max()


def test_what_lumped_rows_neglect_is_corrected(monkeypatch):
    """Each further solution of a QP changes its bounds by less than a tenth of the one before."""
    changes, correct = [], newton_module.Corrections.apply

    def noted(self, lin, solved):
        changes.append(correct(self, lin, solved))
        return changes[-1]

    monkeypatch.setattr(newton_module.Corrections, "apply", noted)
    rolled()
    first, second = (left for _, left in changes[:2])
    assert 0.0 < second < 0.1 * first
    changes.clear()
    case = indentation(n=((24, 5), (16, 2)), radius=1.0, length=6.0, height=2.0, friction=0.3)
    walk(case, lambda t: (0.0, -t), [0.1])
    first, second = (left for _, left in changes[:2])
    assert 0.0 < second < 0.01 * first  # with the rows of T 0.08


def test_corrections_of_a_node_that_opens_and_closes_in_turns_lie_between():
    """The true closing grows five times as fast as the unknown of the lumped row, by 2.5 ahead.

    Free, at x = 0.5, it is 3.0, beyond the gap of 2.5: the node is closed, at x = 0.4, v = 2.1.
    With v = 0 the QP leaves it open and v becomes 2.5, with that it closes it and v becomes 0.5,
    with which it is open again, and v would be 2.5.
    """
    A = PETSc.Mat().createDense((1, 1), array=np.ones(1), comm=COMM)
    A.assemble()
    b, lower, upper = (PETSc.Vec().createWithArray([x], comm=COMM) for x in (0.5, -1e30, 2.5))
    x, dofs = PETSc.Vec().createWithArray(np.zeros(1), comm=COMM), np.zeros(1, dtype=np.int32)
    bounds = Constraints(dofs, np.array([-np.inf]), np.array([2.5]), np.ones(1))
    geometry = SimpleNamespace(trial=None, closing=lambda du: 3.0 + 5.0 * (du.array_r - 0.5))
    balance = SimpleNamespace(bounds=bounds, limits=None)
    lin = Linearisation(BoundQP(A, b, lower, upper, dofs), balance, A.getDiagonal(), geometry)
    corrections = Corrections()
    for closed in (False, True, False):
        x.array[:] = min(0.5, lin.qp.upper.array_r[0])
        assert (x.array_r[0] < 0.5) == closed
        solved = SimpleNamespace(x=x, active=np.array([closed], dtype=np.int8))
        lin, _ = corrections.apply(lin, solved)
    assert 0.5 < 2.5 - lin.qp.upper.array_r[0] < 2.4


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


@pytest.fixture(scope="module")
def dragged():
    """A half ring with friction, pressed on a block and dragged, in the course of a step."""
    case = indentation(n=((24, 5), (16, 2)), radius=1.0, length=6.0, height=2.0, friction=0.3)
    walk(case, lambda t: (0.1 * max(t - 1.0, 0.0), -0.2 * min(t, 1.0)), [0.5, 1.0, 1.5])
    case.held.value[:] = 0.1, -0.2
    return case.problem, case.problem.begin_step()


def test_rows_of_gaps_and_slips_are_their_derivatives(dragged, monkeypatch):
    """The trial rows of T_g, with what lumping leaves to the bounds; differences agree to 1e-8."""
    on_edges.count_all_parts(monkeypatch)
    problem, data = dragged
    rng, u = np.random.default_rng(5), problem.owned_u
    u += 1e-3 * rng.standard_normal(u.shape)  # far from balance, so that all terms count
    start, du = u.copy(), rng.standard_normal(u.shape)

    def at(step):
        u[:] = start + step * du
        problem.u.x.scatter_forward()
        problem.follow_geometry()
        (link,) = problem.system.unilateral
        since = problem.vector(u - problem.committed.displacement)
        slip = data.partners[0].slip(link, since)[:, 1]
        gaps = link.coupling.weight[:, 0] * link.gaps(problem.positions())
        return link, since, gaps, slip

    at(0.0)
    with on_edges.linear_normals(problem):
        (_, _, *above), (_, _, *below) = at(1e-6), at(-1e-6)
    link, since, *_ = at(0.0)
    given = np.zeros(problem.n), np.zeros((problem.n, 2)), (since, data.partners)
    closing = problem.system.linearise_geometry(problem.u, *given).closing(problem.vector(du))
    near = link.near & link.coupling.kept[:, 0] & data.partners[0].known
    found = closing.reshape(-1, 2)[link.nodes[near]]
    for column, sign, over, a, b in zip(
        found.T, (-1.0, 1.0), (link.coupling.weight[near, 0], 1.0), above, below, strict=True
    ):
        expected = sign * (a - b)[near] / 2e-6 / over
        largest = problem.comm.allreduce(np.abs(expected).max(initial=0.0), op=MPI.MAX)
        assert np.abs(column - expected).max(initial=0.0) < 1e-8 * largest
    assert problem.comm.allreduce(int(near.sum())) > 5


PRESSED = {
    "corners of the slave": ((6, 4), (4, 4), BOTTOM_OF_UPPER, TOP_OF_LOWER, 0.0, 0.0),
    "edge on edge": ((6, 4), (5, 4), BOTTOM_OF_UPPER, TOP_OF_LOWER, 0.4, 0.0),
    "edge on edge, swapped": ((6, 4), (5, 4), TOP_OF_LOWER, BOTTOM_OF_UPPER, 0.4, 0.0),
    "open": ((6, 4), (5, 4), BOTTOM_OF_UPPER, TOP_OF_LOWER, 0.735, 0.005),
    "open, swapped": ((6, 4), (5, 4), TOP_OF_LOWER, BOTTOM_OF_UPPER, 0.735, 0.005),
    "open, second order": ((6, 4), (5, 4), TOP_OF_LOWER, BOTTOM_OF_UPPER, 0.745, 0.003),
}


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("name", "degree"),
    [
        *((name, 1) for name in PRESSED if "second" not in name),
        *quick([(name, 2) for name in PRESSED if name not in ("open", "open, swapped")]),
    ],
)
def test_derivatives_at_edges_are_those_of_forces_gaps_and_slips(name, degree):
    """With the normals of edges, and what open facets share out; to 1e-8 of the largest entry."""
    n_lower, n_upper, slave, master, right, up = PRESSED[name]
    x_upper = (0.23 + right, 0.77 + right)
    mesh = meshes.two_blocks(COMM_WORLD, n_lower=n_lower, n_upper=n_upper, x_upper=x_upper)
    problem, data = on_edges.begin(*mesh, degree, slave, master)
    on_edges.raise_upper(problem, up)
    tangent = on_edges.Tangent(problem, data)
    assert tangent.on_edges > 0
    assert not up or tangent.open_in_part() > 0
    assert max(tangent.errors) < 1e-8


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


def test_nothing_is_allocated_anew_within_a_step_nor_in_the_next(monkeypatch):
    """Patterns and the symbolic factorisations of both tangents are made once a search."""
    case = indentation(n=((24, 5), (16, 2)), radius=1.0, length=6.0, height=2.0)
    made = []
    for kind in (triplets.Triplets, congruence.ProductOfBases, congruence.Congruence):
        init = kind.__init__

        def noted(self, *args, init=init, **options):
            made.append(type(self).__name__)
            init(self, *args, **options)

        monkeypatch.setattr(kind, "__init__", noted)

    def counted(*push):
        made.clear()
        before = case.problem.linear.counts.symbolic
        case.held.value[:] = push
        report = dm.newton(case.problem, rtol=1e-10)
        case.problem.commit()
        assert sum(i.exact_tangent for i in report.iterations) > 1
        return case.problem.linear.counts.symbolic - before

    assert counted(0.0, -0.1) == 2
    assert made.count("ProductOfBases") == made.count("Congruence") == 1
    assert counted(0.01, -0.1) == 0
    assert made == []


def test_when_the_exact_tangent_pays():
    """Slow fixed points, where the geometry is out of balance and not the laws; until it fails."""
    slow = Watch(True).turning(100.0).turning(50.0)
    assert slow.is_slow(True, 50.0, 1000.0)
    assert not slow.is_slow(True, 50.0, 20.0)  # too few iterations are left
    assert slow.is_slow(False, 50.0, 20.0)
    assert not slow.is_slow(False, 1000.0, 1000.0)  # the law is out of balance
    assert not Watch(True).turning(100.0).is_slow(True, 100.0, 100.0)  # no rate yet
    assert slow.after_exact(1.0, 100.0).is_slow(True, 1.0, 1.0)
    assert slow.after_exact(90.0, 100.0).barred == DIGIT * 100.0
    jumped = slow.after_exact(90.0, 100.0, other_nodes=True)
    assert jumped.exact and jumped.barred == np.inf
    held = replace(slow, held=True, change=1.0, forces=1.0, barred=0.5)
    thawed = held.thawed().after(2.0, 2.0)  # the first change since then is no rise
    assert (thawed.held, thawed.rises, thawed.barred) == (False, 0, 0.5)
    for other_nodes in (False, True):
        lost = replace(slow, rises=MOST_RISES).after_exact(90.0, 100.0, other_nodes=other_nodes)
        assert (lost.failed, lost.rises) == (1, MOST_RISES)


@pytest.mark.parametrize(
    ("forces", "shifted", "itself", "exact"),
    [
        (0.1, 0, False, True),
        (0.1, 2, False, False),
        (0.1, 0, True, False),
        (0.01, 2, True, True),
        (0.5, 0, False, False),
    ],
)
def test_from_where_on_the_exact_tangent_serves_at_finite_strain(forces, shifted, itself, exact):
    """Nearer where the last tangent was indefinite, and where a surface meets itself."""
    link = SimpleNamespace(interface=SimpleNamespace(meets_itself=itself))
    system, solid = SimpleNamespace(unilateral=[link]), SimpleNamespace(strain="finite")
    problem = SimpleNamespace(solid=solid, system=system)
    step = SimpleNamespace(problem=problem, may_be_exact=True, shifted=shifted)
    step.missed = lambda last: newton_module._Step.missed(step, last)
    step.stalls = lambda residuals: False
    found = Residuals(forces, contact=0.0, excess=1e6, limit=1.0)
    assert newton_module._Step.is_exact(step, Watch(True), [found]) == exact


@pytest.mark.parametrize(
    ("gaps", "held", "forces", "strain", "stalls"),
    [
        ([9.0, 8.0, 9.0, 9.0, 9.0, 9.0], [], 1.0, "finite", True),
        ([9.0, 8.0, 9.0, 9.0, 9.0, 9.0], [], 1.0, "small", False),
        ([9.0, 8.0, 9.0, 9.0, 9.0, 9.0], [], 9.1, "finite", False),
        ([9.0, 8.0, 9.0, 9.0, 9.0, 7.0], [], 1.0, "finite", False),
        ([9.0, 8.0, 9.0, 1e-9, 9.0, 9.0], [2, 3], 1.0, "finite", True),
        ([9.0, 1e-9, 8.0, 9.0, 9.0, 9.0], [1], 1.0, "finite", False),
        ([9.0, 8.0, 4.0, 2.0, 1.0, 1e-9], [1, 2, 3, 4, 5], 0.0, "finite", False),
    ],
)
def test_where_updates_of_the_geometry_lead_nowhere(gaps, held, forces, strain, stalls):
    """Four iterations after the lowest residual, that of gaps; two of them update the geometry."""
    step = SimpleNamespace(problem=SimpleNamespace(solid=SimpleNamespace(strain=strain)))
    step.missed = lambda last: newton_module._Step.missed(step, last)
    made = [SimpleNamespace(geometry_held=k in held) for k in range(len(gaps))]
    step.report = SimpleNamespace(iterations=made)
    found = [Residuals(forces, contact=one, excess=1e6, limit=1.0) for one in gaps]
    assert newton_module._Step.stalls(step, found) == stalls


@pytest.mark.parametrize("strain", ["small", "finite"])
def test_nodes_that_get_or_lose_multipliers_are_seen_at_finite_strain(dragged, strain):
    """Of any node of a side; at small strain the fixed point goes on there."""
    problem, _ = dragged
    solid = SimpleNamespace(strain=strain)
    parts = SimpleNamespace(solid=solid, system=problem.system, comm=problem.comm)
    step = SimpleNamespace(problem=parts, carrying=lambda: [link.coupling.kept for link in links])
    links = problem.system.unilateral
    before = [kept.copy() for kept in newton_module._Step.carrying(step)]
    assert not newton_module._Step.differ(step, before)
    before[0][0] = ~before[0][0]
    assert newton_module._Step.differ(step, before) == (strain == "finite")

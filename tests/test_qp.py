# SPDX-License-Identifier: MIT
"""Bound-constrained QPs: signs, the check, all backends against it, updates, condensation."""

from dataclasses import replace

from mpi4py import MPI
from petsc4py import PETSc

import hypothesis
import hypothesis.strategies as st
import numpy as np
import pytest
import scipy.sparse as sp
from programs import (
    CYCLING,
    CYCLING_FORCE,
    active_everywhere,
    from_arrays,
    gathered,
    membrane,
    sets,
)
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import lsq_linear

from dolfinx_mortar.algebra.congruence import CongruentOperator
from dolfinx_mortar.qp import (
    LinearSolver,
    QPNotSolved,
    QPSolution,
    active_set,
    available,
    check,
    solve,
    solver,
)
from dolfinx_mortar.qp.condensed import Condensed, Dense
from dolfinx_mortar.qp.held import LOOSE, TIGHT, Found, HeldProblem, State, update
from dolfinx_mortar.qp.linear import LinearSolveFailed
from dolfinx_mortar.qp.preconditioner import set_apart

COMM = MPI.COMM_WORLD
INF = np.inf


@pytest.fixture(params=["active-set", "interior-point"])
def backend(request):
    return str(request.param)


def test_every_file_is_a_backend():
    assert available() == ["active-set", "interior-point"]


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("b", "lower", "upper", "x", "z", "active"),
    [
        (4.0, -INF, 1.0, 1.0, 2.0, 1),
        (-4.0, -1.0, INF, -1.0, -2.0, -1),
        (4.0, -INF, 3.0, 2.0, 0.0, 0),
        (0.0, -INF, -1.0, -1.0, 2.0, 1),
    ],
)
def test_signs_with_one_unknown(backend, b, lower, upper, x, z, active):
    bounds = np.array([lower]), np.array([upper])
    solution = solve(from_arrays(np.array([[2.0]]), np.array([b]), *bounds, COMM), backend)
    assert gathered(solution.x) == pytest.approx([x], rel=1e-9)
    assert gathered(solution.z) == pytest.approx([z], rel=1e-9, abs=1e-9)
    assert active_everywhere(solution) == [active]


@hypothesis.given(seed=st.integers(0, 10**6), size=st.integers(2, 9))
@hypothesis.settings(
    max_examples=20,
    suppress_health_check=[hypothesis.HealthCheck.function_scoped_fixture],
)
def test_random_problems_against_scipy(backend, seed, size):
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((size, size))
    A, b = root @ root.T + 0.1 * np.eye(size), rng.standard_normal(size)
    lower, upper = -rng.exponential(0.5, size), rng.exponential(0.5, size)
    lower[rng.random(size) < 0.5], upper[rng.random(size) < 0.5] = -INF, INF
    solution = solve(from_arrays(A, b, lower, upper, COMM), backend)
    L = cholesky(A, lower=True)
    rhs = solve_triangular(L, b, lower=True)
    expected = lsq_linear(L.T, rhs, (lower, upper), method="bvls", tol=1e-14).x
    np.testing.assert_allclose(gathered(solution.x), expected, atol=1e-8 * np.abs(expected).max())


def test_check_sees_each_violation():
    qp = membrane(8)
    solution = solve(qp, rtol=1e-13)
    assert solution.kkt.worst < 1e-12
    first, last = qp.b.getOwnershipRange()

    def spoilt(row, change):
        x = solution.x.copy()
        values = x.array  # on all ranks: PETSc keeps norms of vectors that are not written to
        if first <= row < last:
            values[row - first] += change
        return x

    middle, corner, size = 8 * 7 + 3, 8 * 8 - 1, abs(float(qp.upper.min()[1]))
    assert check(qp, spoilt(20, 1e-3 * size)).stationarity > 1e-4
    assert check(qp, spoilt(middle, 1e-3 * size)).feasibility > 5e-4
    assert check(qp, spoilt(middle, -1e-3 * size)).complementarity > 5e-4
    assert check(qp, spoilt(corner, 1e-3 * size)).stationarity > 1e-4
    # held on the wrong side: a reaction that pulls
    pulled = replace(qp, upper=qp.upper.copy(), b=qp.b.copy())
    x = qp.b.duplicate()
    x.set(0.0)
    pulled.upper.array[qp.bounded] = -1.0
    x.array[qp.bounded] = 1.0
    assert check(pulled, x).sign > 0.1


def test_check_rejects_a_solution_that_is_not_one(monkeypatch):
    def wrong(qp, linear, *, start, rtol, guess):
        x = qp.b.duplicate()
        x.set(0.0)
        return QPSolution(x, x, start, check(qp, x), 0, 0, 0, "wrong")

    monkeypatch.setattr(active_set, "solve", wrong)
    with pytest.raises(QPNotSolved, match="fails the check") as caught:
        solve(membrane(6))
    assert caught.value.solution is not None and caught.value.solution.kkt.feasibility > 0.1


@pytest.mark.mpi
@pytest.mark.parametrize("error", solver.FAILURES)
def test_a_backend_that_fails_has_not_solved(monkeypatch, error):
    """Whatever stops it; the caller may try a smaller step."""

    def failing(*_, **__):
        raise error(55 if error is PETSc.Error else "no luck")

    monkeypatch.setattr(active_set, "solve", failing)
    with pytest.raises(QPNotSolved, match="'active-set' stopped") as caught:
        solve(membrane(6))
    assert isinstance(caught.value.__cause__, error) and caught.value.solution is None


@pytest.mark.parametrize("guess", [0, 1])
def test_weakly_active_unknowns_may_be_on_either_side(backend, guess):
    """The bound goes exactly through the free solution: reaction and distance both vanish."""
    A, b = np.diag([2.0, 4.0, 8.0]) + 1.0, np.array([1.0, 2.0, 3.0])
    free = np.linalg.solve(A, b)
    upper = np.array([free[0], INF, free[2]])
    qp = from_arrays(A, b, np.full(3, -INF), upper, COMM)
    start = np.full(qp.bounded.size, guess, dtype=np.int8)
    solution = solve(qp, backend, start_active=start)
    np.testing.assert_allclose(gathered(solution.x), free, rtol=1e-10)


@pytest.mark.mpi
def test_a_body_held_by_its_bounds_alone(backend):
    solution = solve(membrane(12, held=False, force=1.0), backend)
    reactions = gathered(solution.z)
    assert reactions.sum() == pytest.approx(12.0, rel=1e-9)  # carries the whole load
    assert reactions.min() > -1e-9


def test_a_body_held_by_nothing_is_an_error():
    with pytest.raises(QPNotSolved, match=r"moves away|nothing holds a body"):
        solve(membrane(6, held=False, force=-1.0))
    qp = membrane(8, held=False, force=1.0)
    qp.upper.set(PETSc.INFINITY)
    with pytest.raises(QPNotSolved, match="nothing holds a body"):
        solve(replace(qp, bounded=np.zeros(0, dtype=np.int32)))


@pytest.mark.parametrize(("stiffness", "length"), [(1e-6, 1e6), (1e6, 1e6)])
def test_units_do_not_matter(backend, stiffness, length):
    plain = solve(membrane(10), backend)
    other = solve(membrane(10, stiffness=stiffness, length=length), backend)
    assert active_everywhere(other) == active_everywhere(plain)
    assert abs(other.updates - plain.updates) <= 1
    assert abs(other.linear_iterations - plain.linear_iterations) <= 1
    expected, found = gathered(plain.z), gathered(other.z) / (stiffness * length)
    np.testing.assert_allclose(found, expected, atol=1e-8 * np.abs(expected).max())


def test_forces_whose_squares_underflow_are_none():
    """In a step before its loads they are the round-off of zero; no norm knows them."""
    b, upper = np.array([1e-170, 0.0]), np.array([1.0, 2.0])
    qp = from_arrays(np.eye(2), b, np.full(2, -INF), upper, COMM)
    x = qp.b.duplicate()
    x.set(0.0)
    kkt = check(qp, x)
    assert kkt.complementarity == 0.0 and kkt.satisfied(1e-12)


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"lower": 7.0}, "lower > upper"),
        ({"b": np.nan}, "used: b"),
        ({"upper": np.nan}, "NaN"),
        ({"lower": PETSc.INFINITY, "upper": PETSc.INFINITY}, "wrong sign"),
        ({}, "used: bounded"),
    ],
)
def test_data_without_a_solution(values, message):
    """The fault is on the last rank only; all ranks must learn of it."""
    qp = membrane(6)
    if COMM.rank == COMM.size - 1:
        for name, value in values.items():
            getattr(qp, name).array[int(qp.bounded[0])] = value
    if not values:
        qp = replace(qp, bounded=np.zeros(0, dtype=np.int32))
    with pytest.raises(ValueError, match=message):
        solve(qp)


def test_bounds_that_are_far_are_not_reached(monkeypatch):
    """Of TAO's solution: held at its bound, the first unknown keeps the second in place."""

    def as_found(qp, *_, guess, **options):
        none = np.zeros(qp.bounded.size, dtype=np.int8)
        return QPSolution(guess, guess, none, check(qp, guess), 0, 0, 0, "")

    monkeypatch.setattr(active_set, "solve", as_found)
    A = np.array([[1.00001, -1.0], [-1.0, 1.00001]])
    b = np.array([-1.0, 0.0])
    qp = from_arrays(A, b, np.full(2, -INF), np.array([0.0, INF]), COMM)
    found = gathered(solve(qp, "interior-point", rtol=1e-6).x)
    np.testing.assert_allclose(found, np.linalg.solve(A, b), rtol=1e-4)


# -- updates of the active set


@pytest.fixture
def updates_only(monkeypatch):
    """Switch the condensation off, as for very many bounded unknowns."""
    monkeypatch.setattr(solver, "set_apart", lambda *_: None)


def test_a_cycle_of_loose_solves_tightens_them():
    levels = []

    def hold(active, level):
        levels.append(level)
        other = active if level >= TIGHT else 1 - active
        return Found(other, int((other != active).sum()), satisfied=level >= TIGHT)

    outcome = update(hold, sets(0, 1), MPI.COMM_SELF, level=LOOSE)
    assert outcome.reason == "" and levels[-1] == TIGHT and len(levels) < 10


@pytest.mark.mpi
def test_the_descent_ends_where_updates_of_a_dense_problem_cycle():
    """From any set; nothing is handed over."""
    for first in np.ndindex(2, 2, 2):
        qp = from_arrays(CYCLING, CYCLING_FORCE, np.full(3, -INF), np.zeros(3), COMM)
        own = np.array(first, dtype=np.int8)[np.arange(3)[slice(*qp.A.getOwnershipRange())]]
        solution = solve(qp, start_active=own)
        assert solution.note == "" and solution.kkt.worst < 1e-10


@pytest.mark.mpi
def test_the_large_problem_leaves_a_cycle_after_each_set_once(updates_only, monkeypatch):
    qp = from_arrays(CYCLING, CYCLING_FORCE, np.full(3, -INF), np.zeros(3), COMM)
    sets_held = []
    hold = HeldProblem.hold
    monkeypatch.setattr(
        HeldProblem, "hold", lambda self, *a, **k: (sets_held.append(a[1]), hold(self, *a, **k))[1]
    )
    assert solve(qp).note == ""
    assert sets_held.count(TIGHT) <= 9 + 2  # and first solves of the descent


@pytest.mark.mpi
def test_a_small_step_under_large_forces():
    """What is weak to the force on a stiff unknown is not to the length of the step."""
    A, b = np.diag([1e12, 1.0]), np.array([1e6, 2e-6])
    qp = from_arrays(A, b, np.full(2, -INF), np.array([INF, 1e-6]), COMM)
    linear = LinearSolver(COMM, prefix="small_step_")
    linear.set_matrix(qp.A)
    problem = HeldProblem(qp, linear, qp.b.duplicate(), 1e-4)
    first = State.create(qp, np.zeros(qp.bounded.size, dtype=np.int8))
    outcome = update(problem.hold, first, COMM)
    assert outcome.reason == "" and np.concatenate(COMM.allgather(outcome.state.active)) == [1]
    assert check(qp, problem.x).satisfied(1e-4)


# -- condensed to the bounded unknowns by MUMPS's Schur complement


@pytest.mark.mpi
def test_a_solution_depends_on_the_program_alone():
    """Not on other programs that the linear solver has seen before: to the last bit on one rank."""
    qp, other = membrane(16), membrane(16, force=3.0)
    linear = LinearSolver(COMM, prefix="alone_")
    expected = solve(qp, linear=linear)
    solve(other, linear=linear)
    found = solve(qp, linear=linear)
    x, round_off = gathered(expected.x), 0.0 if COMM.size == 1 else 1e-13
    assert np.abs(gathered(found.x) - x).max() <= round_off * np.abs(x).max()
    assert found.linear_iterations == expected.linear_iterations


def assert_condensed(found, A, b, own):
    """S and g of the unknowns with bounds, and x of all for any values of these."""
    qp, rest = found.about(), np.setdiff1d(np.arange(len(A)), own)
    inner = np.linalg.solve(A[np.ix_(rest, rest)], np.c_[A[np.ix_(rest, own)], b[rest]])
    S, g = A[np.ix_(own, own)] - A[np.ix_(own, rest)] @ inner[:, :-1], b[own].copy()
    g -= A[np.ix_(own, rest)] @ inner[:, -1]
    np.testing.assert_allclose(found.dense.S, S, atol=1e-11 * np.abs(S).max())
    np.testing.assert_allclose(qp.b.array_r, g, atol=1e-11 * np.abs(g).max())
    given = np.arange(float(len(own)))
    for start in None, found.expand(given):  # of which round-off is left
        found.about(start)
        x = found.expand(given)
        np.testing.assert_allclose(x[own], given)
        expected = inner[:, -1] - inner[:, :-1] @ given
        np.testing.assert_allclose(x[rest], expected, atol=1e-11 * np.abs(expected).max())


@pytest.mark.mpi
@pytest.mark.parametrize("held_by", [0.0, 1.0], ids=["by contact alone", "by supports"])
def test_one_factorisation_serves_all_products(held_by):
    """Of (I + C)^T K (I + C), for any C on the same unknowns, some of which are decoupled."""
    line = sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(20, 20)).toarray()
    line[0, 0] = line[-1, -1] = 1.0 + held_by
    program = from_arrays(line, *np.zeros((3, 20)), MPI.COMM_SELF)
    product, linear = CongruentOperator(program.A), LinearSolver(MPI.COMM_SELF, prefix="product_")
    rng, rows, columns = np.random.default_rng(3), [3, 4, 5], [4, 12, 13]
    apart, b = np.union1d(rows, columns).astype(np.int32), program.b
    b.array[:] = rng.normal(size=20)
    bounds = [([3, 5], [4, 9], 1), ([3], [4, 9], 1)]
    for own, out, factorised in [*bounds, ([5], [4, 9], 1), ([5], [4, 9, 15], 2)]:
        C, change = PETSc.Mat().createAIJ((20, 20), nnz=3, comm=MPI.COMM_SELF), np.zeros((20, 20))
        change[np.ix_(rows, columns)] = 0.3 * rng.normal(size=(3, 3))
        C.setValues(rows, columns, change[np.ix_(rows, columns)])
        C.assemble()
        product.follow(C, np.array(out, dtype=np.int32))
        A = (np.eye(20) + change).T @ line @ (np.eye(20) + change)
        A[out], A[:, out] = 0.0, 0.0
        A[out, out] = product.scale
        qp = replace(
            program, A=product.matrix, product=product, bounded=np.array(own, dtype=np.int32)
        )
        linear.set_matrix(qp.A, apart=apart, product=product)
        assert_condensed(Condensed(qp, linear, 0.0), A, b.array_r, qp.bounded)
        assert linear.counts.factorisations == factorised


def test_too_many_bounds_are_not_left_for_last():
    """Their complement is dense: at most twice the entries of the matrix itself."""
    qp = membrane(12, comm=MPI.COMM_SELF)
    options = LinearSolver(MPI.COMM_SELF, prefix="many_").options
    few = int(np.sqrt(2 * qp.A.getInfo()["nz_used"]))
    unknowns = np.arange(few + 1, dtype=np.int32)
    assert set_apart(replace(qp, bounded=unknowns[:few]), options) is not None
    assert set_apart(replace(qp, bounded=unknowns), options) is None


def test_a_body_that_contact_alone_holds_has_a_singular_complement(rng):
    """Round-off leaves a pivot that may be positive; the answer would be any number."""
    for _ in range(20):
        weights = np.triu(rng.random((6, 6)), 1)
        weights += weights.T
        laplacian = np.diag(weights.sum(axis=1)) - weights
        dense = Dense(laplacian, np.diag(laplacian))
        b = dense.matrix.createVecRight()
        b.array[:] = rng.random(6)
        with pytest.raises(LinearSolveFailed):
            dense.solve(b, b.duplicate(), np.zeros(0, dtype=np.int32), atol=0.0)

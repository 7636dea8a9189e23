# SPDX-License-Identifier: MIT
"""Bound-constrained QPs: signs, the check, all backends against it, reuse, awkward cases."""

from dataclasses import replace
from importlib import import_module
from pkgutil import walk_packages
from types import ModuleType

from mpi4py import MPI
from petsc4py import PETSc

import hypothesis
import hypothesis.strategies as st
import numpy as np
import pytest
from programs import from_arrays, gathered, membrane
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import lsq_linear

from dolfinx_mortar import qp as qp_floor
from dolfinx_mortar.qp import (
    LinearSolver,
    QPNotSolved,
    QPSolution,
    available,
    check,
    condensed,
    dense,
    solve,
    solver,
    tao,
    updates,
)
from dolfinx_mortar.qp.backends import active_set
from dolfinx_mortar.qp.bounded import Bounded
from dolfinx_mortar.qp.condensed import SchurModel, half_laplacian, on_root
from dolfinx_mortar.qp.dense import solve_dense
from dolfinx_mortar.qp.held import HeldProblem
from dolfinx_mortar.qp.renewal import REFACTOR_AFTER
from dolfinx_mortar.qp.updates import LOOSE, TIGHT, Found, Outcome, came_back, update

COMM = MPI.COMM_WORLD
INF = np.inf

# three unknowns: from six of the eight active sets the updates never end
CYCLING = np.array([[9.0, -13, 7], [-13, 22, -7], [7, -7, 9]])
CYCLING_FORCE = np.array([-1.0, 2, 0])


@pytest.fixture(params=["active-set", "interior-point", "tron"])
def backend(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def updates_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """Switch the condensation off, as for very many bounded unknowns."""
    monkeypatch.setattr(condensed, "is_worthwhile", lambda *_: False)


def active_everywhere(solution: QPSolution) -> list[int]:
    return [int(a) for part in COMM.allgather(solution.active) for a in part]


def test_every_file_is_a_backend() -> None:
    assert available() == ["active-set", "interior-point", "tron"]


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("b", "lower", "upper", "x", "z", "active"),
    [
        (4.0, -INF, 1.0, 1.0, 2.0, 1),
        (-4.0, -1.0, INF, -1.0, -2.0, -1),
        (4.0, -INF, 3.0, 2.0, 0.0, 0),
        (4.0, -1.0, 1.0, 1.0, 2.0, 1),
        (0.0, -INF, -1.0, -1.0, 2.0, 1),
    ],
)
def test_signs_with_one_unknown(
    backend: str, b: float, lower: float, upper: float, x: float, z: float, active: int
) -> None:
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
def test_random_problems_against_scipy(backend: str, seed: int, size: int) -> None:
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


@pytest.mark.mpi
def test_backends_agree(backend: str) -> None:
    qp = membrane()
    reference, other = solve(qp, rtol=1e-12), solve(qp, backend, rtol=1e-12)
    scale = np.abs(gathered(reference.z)).max()
    assert 3 < np.abs(active_everywhere(reference)).sum() < 20
    assert active_everywhere(other) == active_everywhere(reference)
    np.testing.assert_allclose(gathered(other.z), gathered(reference.z), atol=1e-10 * scale)


def test_check_sees_each_violation() -> None:
    qp = membrane(8)
    solution = solve(qp, rtol=1e-13)
    assert solution.kkt.worst < 1e-12
    first, last = qp.b.getOwnershipRange()

    def spoilt(row: int, change: float) -> PETSc.Vec:
        x = solution.x.copy()
        if first <= row < last:
            x.array[row - first] += change
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


def test_check_rejects_a_solution_that_is_not_one(monkeypatch: pytest.MonkeyPatch) -> None:
    def wrong(qp, linear, *, start, rtol):  # type: ignore[no-untyped-def]
        x = qp.b.duplicate()
        x.set(0.0)
        return QPSolution(x, x, start, check(qp, x), 0, 0, 0, "wrong")

    monkeypatch.setattr(active_set, "solve", wrong)
    with pytest.raises(QPNotSolved, match="fails the check") as caught:
        solve(membrane(6))
    assert caught.value.solution is not None and caught.value.solution.kkt.feasibility > 0.1


@pytest.mark.mpi
@pytest.mark.parametrize("error", solver.FAILURES)
def test_a_backend_that_fails_has_not_solved(
    monkeypatch: pytest.MonkeyPatch, error: type[Exception]
) -> None:
    """Whatever stops it; the caller may try a smaller step."""

    def failing(*_: object, **__: object) -> None:
        raise error(55 if error is PETSc.Error else "no luck")

    monkeypatch.setattr(active_set, "solve", failing)
    with pytest.raises(QPNotSolved, match="'active-set' stopped") as caught:
        solve(membrane(6))
    assert isinstance(caught.value.__cause__, error) and caught.value.solution is None


def test_a_programming_error_is_none_of_the_backend(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(active_set, "solve", lambda *_, **__: [][0])
    with pytest.raises(IndexError):
        solve(membrane(6))


@pytest.mark.mpi
def test_all_ranks_raise_what_the_first_one_raises() -> None:
    with pytest.raises(np.linalg.LinAlgError, match="Singular"):
        on_root(COMM, lambda: np.linalg.inv(np.zeros((2, 2))))
    assert on_root(COMM, lambda: 3) == (3 if COMM.rank == 0 else None)


@pytest.mark.mpi
@pytest.mark.parametrize("name", ["half_laplacian", "solve_dense"])
def test_a_model_that_breaks_down_is_only_a_lost_guess(
    monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    qp = membrane(16)
    expected = gathered(solve(qp).x)
    if COMM.rank == 0:
        monkeypatch.setattr(condensed, name, lambda *_: np.linalg.inv(np.zeros((2, 2))))
    np.testing.assert_allclose(gathered(solve(qp).x), expected, atol=1e-9)


@pytest.mark.mpi
def test_what_was_learnt_is_dropped_where_round_off_has_spoilt_it() -> None:
    """An indefinite matrix of an earlier model is no start of the next one."""
    qp, linear = membrane(16), LinearSolver(COMM, prefix="spoilt_")
    first = solve(qp, linear=linear)
    model = linear.memory["schur"][1]
    if COMM.rank == 0:
        model.forget()
        model.base[0, 0] = -1.0
    second = solve(qp, linear=linear)
    np.testing.assert_allclose(gathered(second.x), gathered(first.x), atol=1e-9)
    if COMM.rank == 0:
        assert np.linalg.eigvalsh(linear.memory["schur"][1].matrix())[0] > 0.0
    assert second.linear_iterations <= first.linear_iterations


@pytest.mark.parametrize("guess", [0, 1])
def test_weakly_active_unknowns_may_be_on_either_side(backend: str, guess: int) -> None:
    """The bound goes exactly through the free solution: reaction and distance both vanish."""
    A, b = np.diag([2.0, 4.0, 8.0]) + 1.0, np.array([1.0, 2.0, 3.0])
    free = np.linalg.solve(A, b)
    upper = np.array([free[0], INF, free[2]])
    qp = from_arrays(A, b, np.full(3, -INF), upper, COMM)
    start = np.full(qp.bounded.size, guess, dtype=np.int8)
    solution = solve(qp, backend, start_active=start)
    np.testing.assert_allclose(gathered(solution.x), free, rtol=1e-10)


@pytest.mark.mpi
def test_a_cycle_is_handed_to_the_interior_point(updates_only: None) -> None:
    qp = from_arrays(CYCLING, CYCLING_FORCE, np.full(3, -INF), np.zeros(3), COMM)
    solution = solve(qp)
    assert "interior point" in solution.note and "came back" in solution.note
    assert solution.kkt.satisfied(1e-10)


def sets(*values: int) -> np.ndarray:
    return np.array(values, dtype=np.int8)


def follow(*, settles_at: int, level: int) -> tuple[Outcome, list[int]]:
    """Update between two sets that change places below a level; return the levels of the solves."""
    levels = []

    def hold(active: np.ndarray, level: int) -> Found:
        levels.append(level)
        other = active if level >= settles_at else 1 - active
        return Found(other, int((other != active).sum()), satisfied=level >= TIGHT)

    return update(hold, sets(0, 1), MPI.COMM_SELF, level=level), levels


def test_a_cycle_of_tight_solves_ends_at_once() -> None:
    outcome, levels = follow(settles_at=99, level=TIGHT)
    assert "came back" in outcome.reason and len(levels) == 3


def test_a_cycle_of_loose_solves_tightens_them() -> None:
    outcome, levels = follow(settles_at=TIGHT, level=LOOSE)
    assert outcome.reason == "" and levels[-1] == TIGHT and len(levels) < 10


def test_what_loose_solves_have_seen_is_no_cycle_of_tight_ones() -> None:
    """They go by turns through two sets, of which one is right."""

    def hold(active: np.ndarray, level: int) -> Found:
        new = sets(1, 0) if level >= TIGHT else 1 - active
        return Found(new, int((new != active).sum()), satisfied=level >= TIGHT)

    outcome = update(hold, sets(0, 1), MPI.COMM_SELF, level=LOOSE)
    assert outcome.reason == "" and outcome.active.tolist() == [1, 0]


def test_a_set_that_stays_is_solved_tightly_before_it_is_taken() -> None:
    outcome, levels = follow(settles_at=LOOSE, level=LOOSE)
    assert outcome.reason == "" and outcome.updates == 1 and levels == [LOOSE, 1, TIGHT]


@pytest.mark.mpi
def test_sets_that_never_come_back_end_at_the_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(updates, "LIMIT", 7)
    calls = iter(range(100))

    def hold(active: np.ndarray, level: int) -> Found:
        return Found(np.full(2, next(calls), dtype=np.int8), 2, satisfied=True)

    assert "after 7 solves" in update(hold, sets(0, 0), COMM).reason
    assert next(calls) == 7


@pytest.mark.mpi
def test_a_set_has_come_back_when_it_is_the_same_on_all_ranks() -> None:
    seen: set[int] = set()
    last = COMM.rank == COMM.size - 1
    assert not came_back(sets(0, 1), seen, COMM)
    assert not came_back(sets(1, 1) if last else sets(0, 1), seen, COMM)
    assert came_back(sets(0, 1), seen, COMM)


def test_the_dense_problem_leaves_a_cycle_after_each_set_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Three unknowns at or off one bound: eight sets; then the bounded least squares."""
    solves = []
    hold = dense._with_active
    monkeypatch.setattr(dense, "_with_active", lambda *a: (solves.append(1), hold(*a))[1])
    for first in np.ndindex(2, 2, 2):
        solves.clear()
        lower, upper = np.full(3, -INF), np.zeros(3)
        d, _ = solve_dense(CYCLING, CYCLING_FORCE, lower, upper, sets(*first))
        z = CYCLING_FORCE - CYCLING @ d
        assert len(solves) <= 9 and d.max() <= 1e-12 and z.min() >= -1e-12
        assert abs(z @ d) <= 1e-12


@pytest.mark.mpi
def test_the_large_problem_leaves_a_cycle_after_each_set_once(
    updates_only: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    qp = from_arrays(CYCLING, CYCLING_FORCE, np.full(3, -INF), np.zeros(3), COMM)
    sets_held = []
    hold = HeldProblem.hold
    monkeypatch.setattr(
        HeldProblem, "hold", lambda self, *a: (sets_held.append(a[1]), hold(self, *a))[1]
    )
    assert "came back" in solve(qp).note
    assert sets_held.count(TIGHT) <= 9 + 2  # and the last solve of the interior point


def test_what_is_weakly_active() -> None:
    """Reaction and distance, as forces, are together below the accuracy: either side is right."""
    one = np.ones(4)
    x, z = one - [0.0, 0.1, 0.0, 0.02], np.array([0.1, 0.0, 0.02, 0.02])
    candidate = Bounded(x, z, -INF * one, one, 2.0 * one)
    on, off = sets(1, 1, 1, 1), sets(0, 0, 0, 0)
    for before, after in ((on, off), (off, on)):
        assert candidate.strong(before, after, 0.05).tolist() == [True, True, False, True]
    assert not candidate.strong(on, on, 0.05).any()
    assert candidate.strong(on, off, 0.0).all()
    never = replace(candidate, upper=INF * one)  # the reaction alone counts where no bound is
    assert never.strong(sets(0, 0, 0, 0), sets(-1, -1, -1, -1), 0.05).tolist() == [
        *(True, False, False, False)
    ]


def test_weakly_active_unknowns_end_the_updates(updates_only: None) -> None:
    """Round-off puts such unknowns on either side by turns; that is no change."""
    rng = np.random.default_rng(3)
    for _ in range(20):
        root = rng.standard_normal((6, 6))
        A, free = root @ root.T + np.eye(6), rng.standard_normal(6)
        solution = solve(from_arrays(A, A @ free, np.full(6, -INF), free, COMM))
        assert solution.note == "" and solution.updates == 1


@pytest.mark.mpi
@pytest.mark.parametrize("level", [LOOSE, 1, TIGHT])
def test_loose_solves_are_accurate_to_a_share_of_the_reactions(level: int) -> None:
    """Those that come out, not those of a guess, which are 40 times as large."""
    qp, rtol = membrane(24), 1e-8
    linear = LinearSolver(COMM, prefix="share_", options={"pc_type": "jacobi"})
    linear.attach(qp.A)
    x = qp.b.duplicate()
    x.set(0.0)
    x.array[:] = 3.0 * np.cos(5.0 * np.arange(*x.getOwnershipRange()))
    problem = HeldProblem(qp, linear, x, rtol)
    problem.hold(np.ones(qp.bounded.size, dtype=np.int8), level)
    z = gathered(problem.z)
    own = COMM.allgather(qp.bounded + qp.b.getOwnershipRange()[0])
    held = np.concatenate(own)
    reactions = np.linalg.norm(z[held])
    z[held] = 0.0
    assert np.linalg.norm(z) <= rtol ** (2.0 ** (level - TIGHT)) * reactions


@pytest.mark.mpi
def test_a_small_step_under_large_forces() -> None:
    """What is weak to the force on a stiff unknown is not to the length of the step."""
    A, b = np.diag([1e12, 1.0]), np.array([1e6, 2e-6])
    qp = from_arrays(A, b, np.full(2, -INF), np.array([INF, 1e-6]), COMM)
    linear = LinearSolver(COMM, prefix="small_step_")
    linear.attach(qp.A)
    problem = HeldProblem(qp, linear, qp.b.duplicate(), 1e-4)
    outcome = update(problem.hold, np.zeros(qp.bounded.size, dtype=np.int8), COMM)
    solution = problem.solution(outcome, "")
    assert outcome.reason == "" and active_everywhere(solution) == [1]
    assert solution.kkt.satisfied(1e-4)


@pytest.mark.mpi
def test_a_step_that_would_raise_the_energy_ends_at_its_minimum() -> None:
    qp, linear = membrane(12, force=1.0), LinearSolver(COMM, prefix="minimum_")
    linear.attach(qp.A)
    own = qp.bounded
    everywhere = condensed.Everywhere(COMM, own, np.array(COMM.allgather(own.size)))
    linear.factorise(own)
    x = qp.b.duplicate()
    x.set(0.0)
    reduced = condensed._Reduced(qp, linear, everywhere, x)
    w = np.zeros(12)
    rho = reduced.force(w)
    near = w + 0.01 * rho
    w, rho = reduced.move(w, near, rho, None)
    assert w is near  # a whole step that lowers the energy
    far = w + 100.0 * rho
    reached, after = reduced.move(w, far, rho, None)
    assert abs(after @ (far - w)) < 1e-9 * abs(rho @ (far - w))
    np.testing.assert_allclose(gathered(x)[-12:], reached, atol=1e-12 * np.abs(reached).max())


@pytest.mark.mpi
def test_pairs_that_make_a_model_indefinite_are_dropped() -> None:
    """I - V (V'V)^-1 V' + W W' with W = 0 has no stiffness along V."""
    model = SchurModel(np.eye(2), np.array([[2.0], [0.0]]), np.zeros((2, 1)))
    problem = (np.array([3.0, 1.0]), np.full(2, -INF), np.array([2.0, 9.0]), sets(0, 0))
    qp = membrane(4)
    d, active = condensed._solve_model(qp, model if COMM.rank == 0 else None, problem)
    assert d.tolist() == [2.0, 1.0] and active.tolist() == [1, 0]
    assert model.V.shape[1] == (0 if COMM.rank == 0 else 1)


@pytest.mark.parametrize("backend", ["interior-point", "tron"])
def test_far_bounds_are_moved_where_they_are_reached(
    monkeypatch: pytest.MonkeyPatch, backend: str
) -> None:
    """Held at its bound, the first unknown keeps the second in place; free, both go far."""
    monkeypatch.setattr(
        tao,
        "_polish",
        lambda qp, linear, x, rtol: QPSolution(
            x, x, np.zeros(qp.bounded.size, dtype=np.int8), check(qp, x), 0, 0, 0, ""
        ),
    )
    soft = 1e-5
    A = np.array([[1.0 + soft, -1.0], [-1.0, 1.0 + soft]])
    b = np.array([-1.0, 0.0])
    qp = from_arrays(A, b, np.full(2, -INF), np.array([0.0, INF]), COMM)
    found = gathered(solve(qp, backend, rtol=1e-6).x)
    np.testing.assert_allclose(found, np.linalg.solve(A, b), rtol=1e-4)


def test_the_condensed_problem_does_not_cycle() -> None:
    qp = from_arrays(CYCLING, CYCLING_FORCE, np.full(3, -INF), np.zeros(3), COMM)
    assert solve(qp).note == ""


def test_updates_alone_find_the_same_solution(monkeypatch: pytest.MonkeyPatch) -> None:
    qp = membrane()
    reference = solve(qp, rtol=1e-12)
    monkeypatch.setattr(condensed, "is_worthwhile", lambda *_: False)
    other = solve(qp, rtol=1e-12)
    assert other.updates > 1 and reference.updates == 1
    scale = np.abs(gathered(reference.z)).max()
    np.testing.assert_allclose(gathered(other.z), gathered(reference.z), atol=1e-10 * scale)


@pytest.mark.mpi
def test_a_body_held_by_its_bounds_alone(backend: str) -> None:
    solution = solve(membrane(12, held=False, force=1.0), backend)
    reactions = gathered(solution.z)
    assert reactions.sum() == pytest.approx(12.0, rel=1e-9)  # carries the whole load
    assert reactions.min() > -1e-9


def test_a_body_pulled_away_is_an_error() -> None:
    with pytest.raises(QPNotSolved, match=r"float away|held by nothing"):
        solve(membrane(6, held=False, force=-1.0))


def test_a_body_held_by_nothing_is_an_error() -> None:
    qp = membrane(8, held=False, force=1.0)
    qp.upper.set(PETSc.INFINITY)
    with pytest.raises(QPNotSolved, match="held by nothing"):
        solve(replace(qp, bounded=np.zeros(0, dtype=np.int32)))


@pytest.mark.parametrize("stiffness", [1e-6, 1e6])
@pytest.mark.parametrize("length", [1e-6, 1e6])
def test_units_do_not_matter(backend: str, stiffness: float, length: float) -> None:
    plain = solve(membrane(10), backend)
    other = solve(membrane(10, stiffness=stiffness, length=length), backend)
    assert active_everywhere(other) == active_everywhere(plain)
    assert abs(other.updates - plain.updates) <= 1
    assert abs(other.linear_iterations - plain.linear_iterations) <= 1
    expected, found = gathered(plain.z), gathered(other.z) / (stiffness * length)
    np.testing.assert_allclose(found, expected, atol=1e-8 * np.abs(expected).max())


@pytest.mark.mpi
def test_all_updates_cost_two_factorisations() -> None:
    linear = LinearSolver(COMM, prefix="one_")
    qp = membrane(48)
    solution = solve(qp, linear=linear)
    assert solution.factorisations <= 2
    assert solution.linear_iterations <= 12


def test_a_neighbouring_active_set_costs_at_most_one_factorisation() -> None:
    linear = LinearSolver(COMM, prefix="neighbour_")
    qp = membrane(32)
    start = solve(qp, linear=linear).active
    first = solve(qp, linear=linear, start_active=start)  # nothing changes
    qp.upper.array[qp.bounded] -= 0.03
    second = solve(qp, linear=linear, start_active=first.active)
    assert active_everywhere(second) != active_everywhere(first)
    assert second.factorisations <= 1
    cold = solve(qp)
    costs = [q.linear_iterations + REFACTOR_AFTER * q.factorisations for q in (second, cold)]
    assert costs[0] < costs[1]


@pytest.mark.mpi
def test_ranks_agree_with_one() -> None:
    own = solve(membrane(16, comm=MPI.COMM_SELF), rtol=1e-14)
    shared = solve(membrane(16), rtol=1e-14)
    for name in ("x", "z"):
        expected = getattr(own, name).array_r
        found = gathered(getattr(shared, name))
        np.testing.assert_allclose(found, expected, atol=1e-12 * np.abs(expected).max())


def test_no_bounds_and_no_forces() -> None:
    qp = membrane(8)
    qp.upper.set(PETSc.INFINITY)
    qp = replace(qp, bounded=np.zeros(0, dtype=np.int32))
    assert solve(qp).x.norm() == 0.0
    qp.b.set(1.0)
    assert solve(qp).kkt.stationarity < 1e-10


@pytest.mark.mpi
@pytest.mark.parametrize("name", ["lower", "b", "nan bound", "sign of infinity", "bounded"])
def test_data_without_a_solution(name: str) -> None:
    """The fault is on the last rank only; all ranks must learn of it."""
    qp = membrane(6)
    if name == "bounded":
        qp = replace(qp, bounded=np.zeros(0, dtype=np.int32))
    elif COMM.rank == COMM.size - 1:
        row = int(qp.bounded[0])
        if name == "lower":
            qp.lower.array[row] = 7.0
        elif name == "b":
            qp.b.array[row] = np.nan
        elif name == "nan bound":
            qp.upper.array[row] = np.nan
        else:
            qp.lower.array[row] = PETSc.INFINITY
            qp.upper.array[row] = PETSc.INFINITY
    message = {"lower": "lower > upper", "nan bound": "NaN", "sign of infinity": "wrong sign"}.get(
        name, f"The {name}"
    )
    with pytest.raises(ValueError, match=message):
        solve(qp)


def test_unknown_backend() -> None:
    with pytest.raises(ValueError, match=r"'simplex'.*'active-set'"):
        solve(membrane(4), "simplex")


def test_model_reproduces_what_it_has_seen(rng: np.random.Generator) -> None:
    S = np.cov(rng.standard_normal((6, 30)))
    empty = np.zeros((6, 0))
    model = SchurModel(np.eye(6), empty, empty)
    seen = rng.standard_normal((6, 4))
    for v in seen.T:
        model.learn(v, S @ v)
    M = model.matrix()
    np.testing.assert_allclose(M @ seen, S @ seen, rtol=1e-10)
    assert np.linalg.eigvalsh(M)[0] > 0.0
    model.learn(seen[:, 0], S @ seen[:, 0])  # nothing new
    assert model.V.shape == (6, 4)


def test_first_model_is_close_to_the_schur_complement_on_any_mesh() -> None:
    """The ratio of the two stays within a factor of six, two octaves of the mesh size apart."""
    for n in (12, 48):
        qp = membrane(n, comm=MPI.COMM_SELF)
        A = _dense(qp.A)
        B, rest = np.arange(n * (n - 1), n * n), np.arange(n * (n - 1))
        S = A[np.ix_(B, B)] - A[np.ix_(B, rest)] @ np.linalg.solve(
            A[np.ix_(rest, rest)], A[np.ix_(rest, B)]
        )
        M = half_laplacian(A[np.ix_(B, B)])
        L = cholesky(M, lower=True)
        ratio = np.linalg.eigvalsh(np.linalg.solve(L, np.linalg.solve(L, S).T))
        assert ratio[-1] / ratio[0] < 6.0


def _dense(A: PETSc.Mat) -> np.ndarray:
    indptr, columns, values = A.getValuesCSR()
    dense = np.zeros(A.size)
    dense[np.repeat(np.arange(A.size[0]), np.diff(indptr)), columns] = values
    return dense


# What the floor still has in numbers: all are costs, or units of round-off.
NUMBERS = ["BOX", "LIMIT", "MAX_ITERATIONS", "REFACTOR_AFTER", "ROUND_OFF", "SHARE"]
NUMBERS += ["SETUP_AFTER", "SINGULAR_LOSS"]


def modules() -> list[ModuleType]:
    found = walk_packages(qp_floor.__path__, f"{qp_floor.__name__}.")
    return [import_module(module.name) for module in found]


def test_the_numbers_are_all_known() -> None:
    """EPS and what is no length, rate or count aside."""
    names = {
        name
        for module in modules()
        for name, value in vars(module).items()
        if name.isupper() and isinstance(value, (int, float)) and name not in ("EPS", "T")
    }
    assert names - {"LOOSE", "TIGHT", "OUT_OF_MEMORY"} == set(NUMBERS)


@pytest.mark.parametrize("factor", [0.5, 2.0])
@pytest.mark.parametrize("name", NUMBERS)
def test_no_number_changes_an_answer(
    monkeypatch: pytest.MonkeyPatch, name: str, factor: float
) -> None:
    """Halved and doubled: for each backend, factorisation and multigrid, two tangents."""
    expected = [two_tangents(backend, pc) for backend, pc in CASES]
    for module in modules():
        if hasattr(module, name):
            value = getattr(module, name)
            monkeypatch.setattr(module, name, type(value)(factor * value))
    for (backend, pc), before in zip(CASES, expected, strict=True):
        scale = np.abs(before).max()
        np.testing.assert_allclose(two_tangents(backend, pc), before, atol=1e-8 * scale)


CASES = [(name, "cholesky") for name in ("active-set", "interior-point", "tron")]
CASES += [("active-set", "gamg")]


def two_tangents(backend: str, pc: str) -> np.ndarray:
    """Return the reactions of two neighbouring problems, from loose to tight."""
    qp = membrane(14)
    linear = LinearSolver(COMM, prefix="numbers_", options={"pc_type": pc})
    first = solve(qp, backend, linear, rtol=1e-4)
    diagonal = qp.A.getDiagonal()
    diagonal.array[::5] *= 1.05
    qp.A.setDiagonal(diagonal)
    return gathered(solve(qp, backend, linear, start_active=first.active, rtol=1e-11).z)

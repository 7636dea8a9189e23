# SPDX-License-Identifier: MIT
"""Updates of the active set: their end, cycles, accuracy on the way, weakly active unknowns."""

from dataclasses import replace

from mpi4py import MPI

import numpy as np
import pytest
from programs import (
    CYCLING,
    CYCLING_FORCE,
    from_arrays,
    gathered,
    membrane,
    sets,
)

from dolfinx_mortar.qp import LinearSolver, check, held, solve, solver
from dolfinx_mortar.qp.bound_qp import Bounded
from dolfinx_mortar.qp.held import (
    LOOSE,
    TIGHT,
    Found,
    HeldProblem,
    Outcome,
    State,
    came_back,
    update,
)

COMM = MPI.COMM_WORLD
INF = np.inf


@pytest.fixture
def updates_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """Switch the condensation off, as for very many bounded unknowns."""
    monkeypatch.setattr(solver, "set_apart", lambda *_: None)


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
    assert outcome.reason == "" and outcome.state.tolist() == [1, 0]


def test_a_set_that_stays_is_solved_tightly_before_it_is_taken() -> None:
    outcome, levels = follow(settles_at=LOOSE, level=LOOSE)
    assert outcome.reason == "" and outcome.updates == 1 and levels == [LOOSE, 1, TIGHT]


@pytest.mark.mpi
def test_sets_that_never_come_back_end_at_the_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(held, "LIMIT", 7)
    calls = iter(range(100))

    def hold(active: np.ndarray, level: int) -> Found:
        return Found(np.full(2, next(calls), dtype=np.int8), 2, satisfied=True)

    outcome = update(hold, sets(0, 0), COMM)
    assert "after 7 solves" in outcome.reason
    assert outcome.state.tolist() == [5, 5]  # held last; the next one is [6, 6]
    assert next(calls) == 7


@pytest.mark.mpi
def test_a_set_has_come_back_when_it_is_the_same_on_all_ranks() -> None:
    seen: set[int] = set()
    last = COMM.rank == COMM.size - 1
    assert not came_back(sets(0, 1), seen, COMM)
    assert not came_back(sets(1, 1) if last else sets(0, 1), seen, COMM)
    assert came_back(sets(0, 1), seen, COMM)


@pytest.mark.mpi
def test_the_descent_ends_where_updates_of_a_dense_problem_cycle() -> None:
    """From any set; nothing is handed over."""
    for first in np.ndindex(2, 2, 2):
        qp = from_arrays(CYCLING, CYCLING_FORCE, np.full(3, -INF), np.zeros(3), COMM)
        own = np.array(first, dtype=np.int8)[np.arange(3)[slice(*qp.A.getOwnershipRange())]]
        solution = solve(qp, start_active=own)
        assert solution.note == "" and solution.kkt.worst < 1e-10


@pytest.mark.mpi
def test_the_large_problem_leaves_a_cycle_after_each_set_once(
    updates_only: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    qp = from_arrays(CYCLING, CYCLING_FORCE, np.full(3, -INF), np.zeros(3), COMM)
    sets_held = []
    hold = HeldProblem.hold
    monkeypatch.setattr(
        HeldProblem, "hold", lambda self, *a, **k: (sets_held.append(a[1]), hold(self, *a, **k))[1]
    )
    assert solve(qp).note == ""
    assert sets_held.count(TIGHT) <= 9 + 2  # and first solves of the descent


def test_what_is_weakly_active() -> None:
    """Reaction and distance, as forces, are together below the accuracy: either side is right."""
    one = np.ones(4)
    x, z = one - [0.0, 0.1, 0.0, 0.02], np.array([0.1, 0.0, 0.02, 0.02])
    candidate = Bounded(x, z, -INF * one, one, 2.0 * one)
    on, off = sets(1, 1, 1, 1), sets(0, 0, 0, 0)
    for before, after in ((on, off), (off, on)):
        assert (candidate.strength(before, after) > 0.05).tolist() == [True, True, False, True]
    assert not (candidate.strength(on, on) > 0.05).any()
    assert (candidate.strength(on, off) > 0.0).all()
    never = replace(candidate, upper=INF * one)  # the reaction alone counts where no bound is
    assert (never.strength(sets(0, 0, 0, 0), sets(-1, -1, -1, -1)) > 0.05).tolist() == [
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
    linear.set_matrix(qp.A)
    x = qp.b.duplicate()
    x.set(0.0)
    x.array[:] = 3.0 * np.cos(5.0 * np.arange(*x.getOwnershipRange()))
    problem = HeldProblem(qp, linear, x, rtol)
    problem.hold(State.create(qp, np.ones(qp.bounded.size, dtype=np.int8)), level)
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
    linear.set_matrix(qp.A)
    problem = HeldProblem(qp, linear, qp.b.duplicate(), 1e-4)
    first = State.create(qp, np.zeros(qp.bounded.size, dtype=np.int8))
    outcome = update(problem.hold, first, COMM)
    assert outcome.reason == "" and np.concatenate(COMM.allgather(outcome.state.active)) == [1]
    assert check(qp, problem.x).satisfied(1e-4)


def test_updates_alone_find_the_same_solution(monkeypatch: pytest.MonkeyPatch) -> None:
    qp = membrane()
    reference = solve(qp, rtol=1e-12)
    monkeypatch.setattr(solver, "set_apart", lambda *_: None)
    other = solve(qp, rtol=1e-12)
    assert other.updates > 1
    scale = np.abs(gathered(reference.z)).max()
    np.testing.assert_allclose(gathered(other.z), gathered(reference.z), atol=1e-10 * scale)

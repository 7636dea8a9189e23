# SPDX-License-Identifier: MIT
"""Updates of the active set: their end, cycles, accuracy on the way, weakly active unknowns."""

from mpi4py import MPI

import numpy as np
import pytest
from programs import (
    CYCLING,
    CYCLING_FORCE,
    from_arrays,
    sets,
)

from dolfinx_mortar.qp import LinearSolver, check, held, solve, solver
from dolfinx_mortar.qp.held import (
    TIGHT,
    Found,
    HeldProblem,
    State,
    update,
)

COMM = MPI.COMM_WORLD
INF = np.inf


@pytest.fixture
def updates_only(monkeypatch):
    """Switch the condensation off, as for very many bounded unknowns."""
    monkeypatch.setattr(solver, "set_apart", lambda *_: None)


@pytest.mark.mpi
def test_sets_that_never_come_back_end_at_the_limit(monkeypatch):
    monkeypatch.setattr(held, "LIMIT", 7)
    calls = iter(range(100))

    def hold(active, level):
        return Found(np.full(2, next(calls), dtype=np.int8), 2, satisfied=True)

    outcome = update(hold, sets(0, 0), COMM)
    assert "after 7 solves" in outcome.reason
    assert outcome.state.tolist() == [5, 5]  # held last; the next one is [6, 6]
    assert next(calls) == 7


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

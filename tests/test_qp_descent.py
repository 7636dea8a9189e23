# SPDX-License-Identifier: MIT
"""Cycles of active sets with friction: a descent of the energy for given limits, in 2D."""

from dataclasses import replace

from mpi4py import MPI

import hypothesis
import hypothesis.strategies as st
import numpy as np
import pytest
from programs import from_arrays, gathered
from test_qp_friction import EXACT, INF, SELF, Problem, law_holds

from dolfinx_mortar.qp import BoundQP, Friction, LinearSolver, active_set, solve
from dolfinx_mortar.qp.descent import descend, most_solves
from dolfinx_mortar.qp.held import HeldProblem, State

FORCE = 0.01


class Belt(Problem):
    """Bars of EA = 1 around half a drum of radius 1, both ends pulled alike; drawn nodes.

    A hair's stiffness holds every node, so that the belt can go round where all of it slips.
    """

    def __init__(self, nodes, mu, hair=1e-6):
        """Assemble it; unknowns of a node are those towards the drum's centre and around it."""
        at = np.arange(nodes) + np.random.default_rng(0).uniform(-0.5, 0.5, nodes)
        angles = np.pi * at / (nodes - 1)
        outward = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        frames = np.stack([-outward, outward @ [[0.0, 1.0], [-1.0, 0.0]]], axis=1)
        self.A = hair * np.eye(2 * nodes)
        for i in range(nodes - 1):
            bar = outward[i + 1] - outward[i]
            length = np.linalg.norm(bar)
            g = np.concatenate([-frames[i] @ bar, frames[i + 1] @ bar]) / length
            self.A[2 * i : 2 * i + 4, 2 * i : 2 * i + 4] += np.outer(g, g) / length
        self.b = np.zeros(2 * nodes)
        self.b[[1, -1]] = -FORCE, FORCE
        self.normal = 2 * np.arange(nodes)
        self.tangential = self.normal[:, None] + 1
        self.gap, self.rest = np.zeros(nodes), np.zeros((nodes, 1))
        self.mu, self.cohesion = np.full(nodes, mu), np.zeros(nodes)

    def spread(self, comm: MPI.Comm) -> BoundQP:
        """Return it with whole nodes on each rank."""
        n = len(self.b)
        upper = np.full(n, INF)
        upper[self.normal] = 0.0
        qp = from_arrays(self.A, self.b, np.full(n, -INF), upper, comm)
        first, last = qp.A.getOwnershipRange()
        assert first % 2 == last % 2 == 0
        own = slice(first // 2, last // 2)
        position = np.arange(last // 2 - first // 2, dtype=np.int32)
        dofs = (2 * position[:, None] + 1).astype(np.int32)
        law = Friction(position, dofs, self.rest[own], self.mu[own], self.cohesion[own])
        return replace(qp, friction=law)


@pytest.mark.mpi
@pytest.mark.parametrize("mu", [0.1, 0.3])
def test_a_belt_on_a_drum(mu: float) -> None:
    """It slips from one node that sticks to both ends; its tension falls as the law says.

    Updates of sets wander, all at once or the worst alone: they did not settle in 100 solves each.
    """
    belt = Belt(96, mu)
    solution = solve(belt.spread(MPI.COMM_WORLD), rtol=1e-12)
    x, z = gathered(solution.x), gathered(solution.z)
    law_holds(belt, x, z)
    sides = np.sign(np.where(np.abs(x[belt.tangential[:, 0]]) > 1e-9, x[belt.tangential[:, 0]], 0))
    assert (np.diff(sides) >= 0.0).all() and np.abs(sides).sum() == 95
    assert solution.linearisation == active_set.GIVEN
    assert solution.linear_iterations < 400


def attached(qp: BoundQP, rtol: float) -> HeldProblem:
    """Return it with a linear solver, from x = 0."""
    linear = LinearSolver(SELF, prefix="descent_")
    linear.set_matrix(qp.A)
    x = qp.b.duplicate()
    x.set(0.0)
    return HeldProblem(qp, linear, x, rtol)


@hypothesis.given(
    seed=st.integers(0, 10**6), nodes=st.integers(1, 12), coupling=st.sampled_from([0.6, 10.0])
)
@hypothesis.settings(max_examples=60)
def test_a_descent_from_any_state(seed: int, nodes: int, coupling: float) -> None:
    """Open or closed, stuck or slipping to either side, limits without pressure or none."""
    rng = np.random.default_rng(seed)
    p = Problem(seed, nodes, 1, mu=0.0, cohesion=rng.uniform(), coupling=coupling)
    p.cohesion[rng.random(nodes) < 0.2] = 0.0
    problem = attached(p.qp(), 1e-12)
    active = rng.integers(0, 2, nodes).astype(np.int8)
    sides = rng.integers(-1, 2, (nodes, 1)).astype(np.float64)
    found = descend(problem, State.create(p.qp(), active, sides))
    assert not found.reason
    law_holds(p, problem.x.array_r, problem.z.array_r)
    np.testing.assert_allclose(problem.z.array_r, p.b - p.A @ problem.x.array_r, atol=EXACT)


def test_a_descent_is_given_up_after_its_most_solves(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bounds and nodes of all ranks, and one, four times: enough for a belt of any length."""
    p = Problem(3, 12, 1, mu=0.0, cohesion=0.5)
    assert most_solves(p.qp()) == 4 * 25
    start = State.create(p.qp(), np.zeros(12, dtype=np.int8))
    assert descend(attached(p.qp(), 1e-12), start).updates > 2
    monkeypatch.setattr("dolfinx_mortar.qp.descent.most_solves", lambda _: 2)
    outcome = descend(attached(p.qp(), 1e-12), start)
    assert outcome.reason == "friction still changed after 2 solves" and outcome.updates == 2

# SPDX-License-Identifier: MIT
"""Small QPs with friction by all conditions."""

from dataclasses import replace
from itertools import pairwise

from mpi4py import MPI

import hypothesis
import hypothesis.strategies as st
import numpy as np
import pytest
from programs import from_arrays

from dolfinx_mortar.qp import Friction, QPNotSolved, check, held, solve

SELF, INF = MPI.COMM_SELF, np.inf
EXACT = 1e-9


class Problem:
    """Random nodes of a normal and t tangential unknowns, with some that nothing limits."""

    def __init__(self, seed, nodes, t, *, mu=0.3, cohesion=0.0, coupling=0.6):
        rng = np.random.default_rng([seed, nodes, t])
        self.d, self.t, n = t + 1, t, nodes * (t + 1) + 2
        root = rng.standard_normal((n, 2 * n))
        full = root @ root.T / (2 * n)
        scale = np.exp(rng.uniform(-0.5, 0.5, n))
        self.A = np.eye(n) * scale + coupling * full
        self.b = 2.0 * rng.standard_normal(n)
        self.normal = np.arange(nodes) * self.d
        self.tangential = self.normal[:, None] + np.arange(1, self.d)
        self.gap = rng.uniform(-0.5, 0.5, nodes)
        self.rest = rng.uniform(-0.5, 0.5, (nodes, t))
        self.mu, self.cohesion = np.full(nodes, mu), np.full(nodes, cohesion)
        self.b[self.normal] += 1.5  # most are closed

    def qp(self, comm=SELF):
        """Return it for one rank."""
        n = len(self.b)
        lower, upper = np.full(n, -INF), np.full(n, INF)
        upper[self.normal] = self.gap
        position = np.arange(len(self.normal), dtype=np.int32)
        dofs = self.tangential.astype(np.int32)
        law = Friction(position, dofs, self.rest, self.mu, self.cohesion)
        return replace(from_arrays(self.A, self.b, lower, upper, comm), friction=law)

    def limit(self, z):
        """Return s."""
        return self.mu * np.maximum(z[self.normal], 0.0) + self.cohesion


def law_holds(p, x, z):
    """Check all conditions from the data."""
    force = np.linalg.norm(p.b) + np.linalg.norm(z)
    free = np.ones(len(p.b), dtype=bool)
    free[p.normal] = free[p.tangential] = False
    assert np.abs(z - (p.b - p.A @ x)).max() < EXACT * force
    assert np.abs(z[free]).max(initial=0.0) < EXACT * force
    opening, pressing = p.gap - x[p.normal], z[p.normal]
    assert opening.min() > -EXACT and pressing.min() > -EXACT * force
    assert np.abs(opening * pressing).max() < EXACT * force
    slip, zt, s = x[p.tangential] - p.rest, z[p.tangential], p.limit(z)
    size, way = np.linalg.norm(zt, axis=1), np.linalg.norm(slip, axis=1)
    assert (size - s).max() < EXACT * force
    assert np.abs((zt * slip).sum(axis=1) - s * way).max() < EXACT * force


@pytest.mark.parametrize(("t", "mu", "cohesion"), [(2, 0.3, 0.0), (2, 0.0, 0.4), (1, 0.2, 0.3)])
@hypothesis.given(seed=st.integers(0, 10**6), nodes=st.integers(1, 6))
@hypothesis.settings(max_examples=25)
def test_random_problems_satisfy_the_law(t, mu, cohesion, seed, nodes):
    """In space, and with limits without pressure, which act on open nodes as well."""
    p = Problem(seed, nodes, t, mu=mu, cohesion=cohesion)
    solution = solve(p.qp(), rtol=1e-12)
    law_holds(p, solution.x.array_r, solution.z.array_r)


def slipping(seed=3):
    """Return a problem in space, all of whose nodes are closed and slip."""
    p = Problem(seed, 3, 2)
    p.gap[:] = -2.0
    p.b[p.normal] += 4.0
    p.b[p.tangential] += 6.0
    solution = solve(p.qp(), rtol=1e-13)
    assert solution.active.tolist() == [1, 1, 1]
    assert solution.sliding is not None and solution.sliding.any(axis=1).all()
    return p, solution


def test_the_check_sees_a_law_that_is_broken():
    """Zero for the solution, not for another coefficient, a limit, a rest, or a slip aside."""
    p, solution = slipping()
    qp = p.qp()
    assert check(qp, solution.x).friction < 1e-13
    law = qp.friction
    assert law is not None
    for spoilt in (
        replace(law, coefficient=0.99 * law.coefficient),
        replace(law, coefficient=1.01 * law.coefficient),
        replace(law, cohesion=law.cohesion + 0.01),
        replace(law, rest=law.rest[:, ::-1] + 1.0),
    ):
        kkt = check(replace(qp, friction=spoilt), solution.x)
        assert 1e-4 < kkt.friction <= kkt.worst
        assert not kkt.satisfied(1e-6)
    x = solution.x.copy()
    x.array[p.tangential[0]] += (0.01, -0.01)
    assert check(qp, x).friction > 1e-4
    x = solution.x.copy()
    x.array[p.tangential[0]] = p.rest[0]  # what should slip is held
    assert check(qp, x).friction > 1e-2


def test_the_law_is_linearised_exactly(monkeypatch):
    """In space, where directions of slip turn: errors of the law fall quadratically."""
    errors = []
    measured = held.on_friction

    def record(*arguments):
        sliders = measured(*arguments)
        errors.append(float(np.linalg.norm(sliders.error())))
        return sliders

    monkeypatch.setattr(held, "on_friction", record)
    for seed in range(3, 9):
        p = slipping(seed)[0]
        errors.clear()
        solve(p.qp(), rtol=1e-13)
        falls = [e / errors[0] for e in errors if e > 1e-13 * errors[0]]
        assert 3 <= len(falls) <= 7
        orders = [np.log(b) / np.log(a) for a, b in pairwise(falls[1:])]
        assert falls[-1] < 1e-6 and orders[-1] > 1.6


@pytest.mark.parametrize(("force", "held"), [(0.099, True), (0.101, False)])
def test_what_friction_alone_holds(force, held):
    """Two nodes hold each other and nothing else does; in all they carry 0.2."""
    p = Problem(1, 2, 1, mu=0.1)
    p.A[:] = np.eye(6)
    p.A[np.ix_([1, 3], [1, 3])] = [[1.0, -1.0], [-1.0, 1.0]]
    p.b[:], p.gap[:], p.rest[:] = (1.0, 2 * force, 1.0, 0.0, 0.0, 0.0), 0.0, 0.0
    if held:
        solution = solve(p.qp())
        law_holds(p, solution.x.array_r, solution.z.array_r)
        assert solution.z.array_r[[1, 3]] == pytest.approx([0.1, 2 * force - 0.1])
        assert solution.x.array_r[[1, 3]] == pytest.approx([2 * force - 0.1, 0.0])
    else:
        with pytest.raises(QPNotSolved):
            solve(p.qp())

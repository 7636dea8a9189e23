# SPDX-License-Identifier: MIT
"""Small QPs with friction and scalars: all conditions, by a dense matrix and by the large one."""

from contextlib import suppress
from dataclasses import replace
from itertools import pairwise

from mpi4py import MPI

import numpy as np
import pytest
from programs import from_arrays

from dolfinx_mortar.qp import (
    Friction,
    LinearSolver,
    NoResistance,
    QPNotSolved,
    Scalars,
    check,
    held,
    solve,
    solver,
)

SELF, INF = MPI.COMM_SELF, np.inf
EXACT = 1e-9


class Problem:
    """Random nodes of a normal and t tangential unknowns, two that are free, and tools."""

    def __init__(
        self, seed, nodes=3, t=1, *, mu=0.3, cohesion=0.0, tools=0, sides=False, weak=False
    ):
        rng = np.random.default_rng([seed, nodes, t])
        self.d, n = t + 1, nodes * (t + 1) + 2
        root = rng.standard_normal((n, 2 * n))
        self.A = np.diag(np.exp(rng.uniform(-0.5, 0.5, n))) + 0.3 / n * root @ root.T
        if weak:
            self.A = root[:, 1:n] @ root[:, 1:n].T
        self.b = 2.0 * rng.standard_normal(n)
        self.normal = np.arange(nodes) * self.d
        self.tangential = self.normal[:, None] + np.arange(1, self.d)
        self.gap = rng.uniform(-0.5, 0.5, nodes)
        self.rest = rng.uniform(-0.5, 0.5, (nodes, t))
        self.mu, self.cohesion = np.full(nodes, mu), np.full(nodes, cohesion)
        self.b[self.normal] += 1.5  # most are closed
        self.E = np.zeros((tools, n))
        self.E[:, :-2] = rng.uniform(-0.3, 0.3, (tools, n - 2))
        for k in range(tools):  # a force +1 on a tool presses it on its nodes
            self.E[k, self.normal[k::tools]] -= 1.0
        self.F = rng.uniform(0.5, 2.0, tools)
        self.C = 0.2 * sides * rng.standard_normal((tools, n))
        self.Q = 5.0 * sides * np.eye(tools)

    def qp(self):
        """Return it for one rank."""
        n = len(self.b)
        lower, upper = np.full(n, -INF), np.full(n, INF)
        upper[self.normal] = self.gap
        position = np.arange(len(self.normal), dtype=np.int32)
        dofs = self.tangential.astype(np.int32)
        law = Friction(position, dofs, self.rest, self.mu, self.cohesion)
        slack = 1e-12 * (1.0 + np.abs(self.F))
        scalars = Scalars(self.E, self.F, self.C, self.C, self.Q, slack) if len(self.F) else None
        law = law if self.mu.any() or self.cohesion.any() else None
        qp = from_arrays(self.A, self.b, lower, upper, SELF)
        return replace(qp, friction=law, scalars=scalars)

    def holds(self, solution):
        """Check all conditions from the data."""
        x, q = solution.x.array_r, solution.travel
        q = np.zeros(0) if q is None else q
        z = self.b - self.A @ x - self.C.T @ q
        force = np.linalg.norm(self.b) + np.linalg.norm(z)
        free = np.ones(len(z), dtype=bool)
        free[self.normal] = free[self.tangential] = False
        assert np.abs(z[free]).max() < EXACT * force
        assert (
            np.abs(self.C @ x + self.Q @ q - self.E @ z - self.F).max(initial=0.0) < EXACT * force
        )
        moved, pressing, zt = x - q @ self.E, z[self.normal], z[self.tangential]
        opening = self.gap - moved[self.normal]
        assert opening.min() > -EXACT and pressing.min() > -EXACT * force
        assert np.abs(opening * pressing).max() < EXACT * force
        limit = self.mu * np.maximum(pressing, 0.0) + self.cohesion
        slip = moved[self.tangential] - self.rest
        size, way = np.linalg.norm(zt, axis=1), np.linalg.norm(slip, axis=1)
        assert (size - limit).max() < EXACT * force
        assert np.abs((zt * slip).sum(axis=1) - limit * way).max() < EXACT * force * (1 + way.max())


TOOL, TWO = {"tools": 1}, {"tools": 2}
CASES = [
    {"t": 2},
    {"t": 2, "mu": 0.0, "cohesion": 0.4},
    {"mu": 0.2, "cohesion": 0.3, "nodes": 6},
    {"mu": 0.0, "tools": 1},
    {"mu": 0.0, "tools": 2},
    {"t": 2, "tools": 1},
    {"nodes": 4, "tools": 2},
    {"sides": True, "tools": 1},
    {"weak": True, "tools": 1},
]


@pytest.mark.parametrize("how", CASES)
def test_all_conditions_hold(how, monkeypatch):
    """With MUMPS's Schur complement and without; what contact alone holds may have no solution."""
    solved, usual = 0, solver.set_apart
    for seed in range(16):
        p = Problem(seed, **how)
        for apart in (usual, lambda *_: None):
            monkeypatch.setattr(solver, "set_apart", apart)
            linear = LinearSolver(SELF, prefix="test_scalars_")
            with suppress(QPNotSolved, NoResistance):
                p.holds(solve(p.qp(), linear=linear, rtol=1e-12))
                solved += 1
    assert solved == 32 or (solved >= 8 and "weak" in how)


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
        p.holds(solution)
        assert solution.z.array_r[[1, 3]] == pytest.approx([0.1, 2 * force - 0.1])
        assert solution.x.array_r[[1, 3]] == pytest.approx([2 * force - 0.1, 0.0])
    else:
        with pytest.raises(QPNotSolved):
            solve(p.qp())


def test_what_nothing_resists():
    """A load that takes the tool off all nodes, and one on a tool that moves none."""
    p = Problem(1, tools=1)
    p.F = -p.F
    with pytest.raises(NoResistance):
        solve(p.qp())
    p.E[:] = 0.0
    with pytest.raises(NoResistance):
        solve(p.qp())
    with pytest.raises(ValueError, match="'interior-point', which is for bounds only"):
        solve(p.qp(), "interior-point")

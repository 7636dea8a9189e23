# SPDX-License-Identifier: MIT
"""QPs with friction and scalars: by a dense matrix, by the large one, and by all states in turn."""

from itertools import product

from petsc4py import PETSc

import numpy as np
import pytest

from dolfinx_mortar.qp import (
    BoundQP,
    Friction,
    LinearSolver,
    NoResistance,
    QPNotSolved,
    Scalars,
    solve,
    solver,
)

FREE, CLOSED, STUCK, LEFT, RIGHT = range(5)
SIGNS = {LEFT: -1.0, RIGHT: 1.0}


class Problem:
    """Random nodes with a bound on x_n and friction on x_t, free unknowns, tools on all nodes."""

    def __init__(self, seed, nodes=3, inner=4, tools=1, mu=0.3, sides=False, weak=False):
        rng = np.random.default_rng(seed)
        n = 2 * nodes + inner
        B = rng.standard_normal((n, n - (nodes > 0 and weak)))
        self.A, self.b = B @ B.T + (0.0 if weak else 0.1) * np.eye(n), rng.standard_normal(n)
        self.nodes, self.mu, self.m = nodes, mu, tools
        self.normal, self.tangential = np.arange(nodes), nodes + np.arange(nodes)
        self.gap, self.rest = rng.uniform(0.0, 0.5, nodes), 0.1 * rng.standard_normal(nodes)
        self.E = np.zeros((tools, n))
        self.E[:, : 2 * nodes] = rng.uniform(-0.3, 0.3, (tools, 2 * nodes))
        self.E[:, :nodes] -= 1.0  # a force +1 on a tool presses it on all nodes
        self.F = rng.uniform(0.5, 2.0, tools)
        self.C = 0.2 * rng.standard_normal((tools, n)) if sides else np.zeros((tools, n))
        self.Q = 5.0 * np.eye(tools) if sides else np.zeros((tools, tools))

    def qp(self):
        """Return it as the package has it."""
        n = len(self.b)
        A = PETSc.Mat().createAIJ((n, n), nnz=n, comm=PETSc.COMM_SELF)
        A.setValues(range(n), range(n), self.A)
        A.assemble()
        b, lower, upper = A.createVecRight(), A.createVecRight(), A.createVecRight()
        b.array[:] = self.b
        lower.set(PETSc.NINFINITY)
        upper.set(PETSc.INFINITY)
        upper.array[self.normal] = self.gap
        law = None
        if self.mu is not None:
            places = self.normal.astype(np.int32), self.tangential[:, None].astype(np.int32)
            mu = np.full(self.nodes, self.mu)
            law = Friction(*places, self.rest[:, None], mu, 0.0 * mu)
        scalars = Scalars(self.E, self.F, self.C, self.C, self.Q, 1e-12 * (1.0 + np.abs(self.F)))
        bounded = self.normal.astype(np.int32)
        return BoundQP(A, b, lower, upper, bounded, law, scalars=scalars if self.m else None)

    def states(self):
        """Return all solutions (x, q): each node open, or closed and sticking or slipping."""
        kinds = (FREE, CLOSED) if self.mu is None else (FREE, STUCK, LEFT, RIGHT)
        for state in product(kinds, repeat=self.nodes):
            found = self.solution(state)
            if found is not None:
                yield found

    def solution(self, state):
        """Return x and q of a state, if it is one of balance, contact and Coulomb's law."""
        n, Z = len(self.b), -np.hstack([self.A, self.C.T])  # z = b + Z (x, q)
        M = np.vstack([-Z, np.hstack([self.C, self.Q]) - self.E @ Z])
        r = np.concatenate([self.b, self.F + self.E @ self.b])
        for kind, i, t, gap, rest in self.nodes_in(state):
            if kind != FREE:
                M[i], r[i] = 0.0, gap
                M[i, i], M[i, n:] = 1.0, -self.E[:, i]
            if kind == STUCK:
                M[t], r[t] = 0.0, rest
                M[t, t], M[t, n:] = 1.0, -self.E[:, t]
            if kind in SIGNS:
                s = self.mu * SIGNS[kind]
                M[t], r[t] = -Z[t] + s * Z[i], self.b[t] - s * self.b[i]
        if np.linalg.cond(M) > 1e10:
            return None
        found = np.linalg.solve(M, r)
        x, q, z = found[:n], found[n:], self.b + Z @ found
        w = x - q @ self.E
        for kind, i, t, gap, rest in self.nodes_in(state):
            wrong = [w[i] - gap if kind == FREE else -z[i]]
            if kind == STUCK:
                wrong += [abs(z[t]) - self.mu * z[i]]
            if kind in SIGNS:
                wrong += [-SIGNS[kind] * (w[t] - rest)]
            if max(wrong) > 1e-9:
                return None
        return x, q

    def nodes_in(self, state):
        """Return kind, unknowns, gap and rest of each node."""
        return zip(state, self.normal, self.tangential, self.gap, self.rest, strict=True)


def both(qp, monkeypatch, **start):
    """Return the solutions with MUMPS's Schur complement, where there is one, and without."""
    found = []
    for apart in (solver.set_apart, lambda *_: None):
        with monkeypatch.context() as patch:
            patch.setattr(solver, "set_apart", apart)
            found.append(solve(qp, linear=LinearSolver(qp.comm, prefix="test_scalars_"), **start))
    return found


CASES = {  # with how many of 40 are solved at least, and how many at most are refused in words
    "bounds and a tool": ({"mu": None}, 40, 0),
    "bounds and two tools": ({"mu": None, "tools": 2}, 8, 0),
    "friction": ({"tools": 0}, 40, 0),
    "friction and a tool": ({}, 40, 0),
    "friction and two tools": ({"tools": 2}, 10, 1),
    "a side": ({"sides": True}, 40, 0),
    "held by contact alone": ({"weak": True}, 8, 1),
}


@pytest.mark.parametrize("case", CASES)
def test_both_ways_find_a_solution_of_all_states(case, monkeypatch):
    """Of 40 random problems, those that have one; Coulomb's may have none, or several."""
    how, least, most = CASES[case]
    solved, refused = 0, 0
    for seed in range(40):
        known = list((p := Problem(seed, **how)).states())
        try:
            ends = both(p.qp(), monkeypatch, rtol=1e-11) if known else []
        except (QPNotSolved, NoResistance):
            refused += 1
            continue
        for found in ends:
            q = np.zeros(0) if found.travel is None else found.travel
            off = [np.abs(found.x.array_r - x).max() + np.abs(q - y).sum() for x, y in known]
            assert min(off) < 1e-8 * (1.0 + np.abs(found.x.array_r).max())
        solved += bool(ends)
    assert solved >= least and refused <= most


def test_what_nothing_resists():
    """A load that takes the tool off all nodes, and one on a tool that moves none."""
    p = Problem(1)
    p.F = -p.F
    with pytest.raises(NoResistance):
        solve(p.qp())
    p.E[:] = 0.0
    with pytest.raises(NoResistance):
        solve(p.qp())
    with pytest.raises(ValueError, match="'interior-point', which is for bounds only"):
        solve(p.qp(), "interior-point")

# SPDX-License-Identifier: MIT
"""A belt on a drum, whose active sets cycle: limits of friction that are given, in 2D."""

from dataclasses import replace

from mpi4py import MPI

import numpy as np
import pytest
from programs import from_arrays, gathered
from test_qp_friction import INF, Problem, law_holds

from dolfinx_mortar.qp import Friction, active_set, solve

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

    def spread(self, comm):
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
def test_a_belt_on_a_drum(mu):
    """It slips from one node that sticks to both ends; its tension falls as the law says."""
    belt = Belt(96, mu)
    solution = solve(belt.spread(MPI.COMM_WORLD), rtol=1e-12)
    x, z = gathered(solution.x), gathered(solution.z)
    law_holds(belt, x, z)
    sides = np.sign(np.where(np.abs(x[belt.tangential[:, 0]]) > 1e-9, x[belt.tangential[:, 0]], 0))
    assert (np.diff(sides) >= 0.0).all() and np.abs(sides).sum() == 95
    assert solution.linearisation == active_set.GIVEN
    assert solution.linear_iterations < 4000

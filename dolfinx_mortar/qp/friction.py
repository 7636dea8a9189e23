# SPDX-License-Identifier: MIT
"""Coulomb's and Tresca's law at nodes of a QP: on arrays of these nodes alone.

At node j the reaction z = b - A x has the part z_n >= 0 of the bound on x_n and a tangential part
z_t, which resists the slip x_t - rest:

    |z_t| <= s,    z_t = s (x_t - rest) / |x_t - rest| where it slips,    s = mu z_n + cohesion,

with z_n = 0 where the bound is open. With q = z_t + c (x_t - rest), for any c > 0, this is
z_t = q min(1, s / |q|) (Alart and Curnier 1991): the rule from which the next state is read. In a
slipping state that equation is linearised. As (I - d d^T) q = 0 for d = q / |q|, what is left is

    z_t = s d + kappa (I - d d^T) (x_t - rest),    kappa = c s / (|q| - s),

s with the z_n of the solution (Hueber, Stadler and Wohlmuth 2008): exact, and unsymmetric where
mu > 0. In the solution kappa is s / |x_t - rest|, whatever c.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_mortar.arrays import Bools, Floats, Ints


@dataclass(frozen=True)
class Friction:
    """Limits of tangential reactions; in this rank's numbering.

    With t tangential directions, of which a node may have fewer.
    """

    normal: Ints  # (m,) position of the node's x_n in `BoundQP.bounded`
    tangential: Ints  # (m, t) unknowns, -1 where there is none
    rest: Floats  # (m, t) x_t at which nothing has slipped, 0 where there is none
    coefficient: Floats  # (m,) mu >= 0
    cohesion: Floats  # (m,) force >= 0, the limit without pressure

    @property
    def some(self) -> Bools:
        """Which directions (m, t) there are."""
        return np.asarray(self.tangential >= 0)

    def pick(self, values: Floats) -> Floats:
        """Return the tangential parts (m, t) of a vector."""
        if values.size == 0:  # of a rank that owns nothing
            return np.zeros(self.tangential.shape)
        return np.where(self.some, values[self.tangential], 0.0)

    def means(self, diagonal: Floats) -> Floats:
        """Return the mean (m,) of a diagonal over the directions of each node, 0 without any."""
        return np.asarray(self.pick(diagonal).sum(axis=1) / np.maximum(self.some.sum(axis=1), 1))

    def acts(self, closed: Bools) -> Bools:
        """Return at which nodes (m,) there is a limit, of those closed or not (m,)."""
        return np.asarray(closed | (self.cohesion > 0.0))

    def limit(self, pressing: Floats) -> Floats:
        """Return s (m,) for normal reactions (m,), which count where they press."""
        return np.asarray(self.coefficient * np.maximum(pressing, 0.0) + self.cohesion)

    @property
    def plane(self) -> bool:
        """Tell whether no node has more directions than one and its opposite."""
        return self.tangential.shape[1] == 1

    @property
    def across(self) -> Bools:
        """Which nodes (m,) may slip in more directions than one and its opposite."""
        return np.asarray(self.some.sum(axis=1) > 1)

    def select(self, mask: Bools) -> Friction:
        """Return some of the nodes."""
        return Friction(
            self.normal[mask],
            self.tangential[mask],
            self.rest[mask],
            self.coefficient[mask],
            self.cohesion[mask],
        )

    def put(self, values: Floats, parts: Floats) -> None:
        """Set the tangential parts of a vector."""
        values[self.tangential[self.some]] = parts[self.some]


@dataclass(frozen=True)
class Sliding:
    """The linear law of slipping nodes: z_t = (mu z_n + cohesion) d + kappa (I - d d^T) slip."""

    normal: Ints  # (m,) unknowns
    law: Friction  # of the slipping nodes
    direction: Floats  # (m, t) d
    stiffness: Floats  # (m,) kappa

    def reaction(self, x: Floats, z: Floats) -> Floats:
        """Return z_t (m, t) as the law has it."""
        limit = self.law.coefficient * z[self.normal] + self.law.cohesion
        return self._resist(limit, self.law.pick(x) - self.law.rest)

    def add(self, x: Floats, y: Floats) -> None:
        """Turn y = A x into its part of the derivative of the law's residual, for changes x."""
        limit = -self.law.coefficient * y[self.normal]
        self.law.put(y, self.law.pick(y) + self._resist(limit, self.law.pick(x)))

    def _resist(self, limit: Floats, slip: Floats) -> Floats:
        d = self.direction
        across = slip - d * (d * slip).sum(axis=1, keepdims=True)
        return np.asarray(limit[:, None] * d + self.stiffness[:, None] * across)


@dataclass(frozen=True)
class Sliders:
    """A candidate on the nodes with friction."""

    law: Friction
    slip: Floats  # (m, t) x_t - rest
    reaction: Floats  # (m, t) z_t
    limit: Floats  # (m,) s
    stiffness: Floats  # (m,) c, which makes a slip a force

    @property
    def trial(self) -> Floats:
        """Return q (m, t)."""
        return np.asarray(self.reaction + self.stiffness[:, None] * self.slip)

    def directions(self, before: Floats | None = None) -> tuple[Floats, Floats]:
        """Return d (m, t), zero where it sticks, and kappa (m,) of the state that comes next.

        A node that has slipped in a direction ``before`` (m, t) and would now slip back sticks at
        first: it slips against its friction, which most often means that it is held. If it took the
        opposite direction at once, rows of nodes would alternate without end.

        >>> nodes, rest = np.array([[0], [1]]), np.zeros((2, 1))
        >>> law = Friction(np.arange(2), nodes, rest, *np.ones((2, 2)))
        >>> stuck, slipping = np.array([0.5]), np.array([3.0])
        >>> z, one = np.array([stuck, slipping]), np.ones(2)
        >>> Sliders(law, np.zeros((2, 1)), z, one, one).directions()[0].tolist()
        [[0.0], [1.0]]
        """
        q = self.trial
        size = np.linalg.norm(q, axis=1)
        slips = size > self.limit
        if before is not None:
            slips &= (before * q).sum(axis=1) >= 0.0
        d = np.divide(q, size[:, None], out=np.zeros_like(q), where=slips[:, None])
        beyond = np.where(slips, size - self.limit, 1.0)
        kappa = np.where(slips, self.stiffness * self.limit / beyond, 0.0)
        return d, np.where(self.law.across, kappa, 0.0)

    def error(self) -> Floats:
        """Return z_t - q min(1, s / |q|) (m, t): forces, zero where the law holds."""
        q = self.trial
        size = np.linalg.norm(q, axis=1)
        share = np.divide(self.limit, size, out=np.ones_like(size), where=size > self.limit)
        return np.asarray(self.reaction - q * share[:, None])

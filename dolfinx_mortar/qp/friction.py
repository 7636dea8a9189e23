# SPDX-License-Identifier: MIT
"""Coulomb's and Tresca's law at the nodes of a QP.

At node j the reaction z = b - A x has a normal component z_n >= 0, of the bound on x_n, and
tangential components z_t, which resist the slip x_t - rest:

    |z_t| <= s,    z_t = s (x_t - rest) / |x_t - rest| where it slips,    s = mu z_n + cohesion,

with z_n = 0 where the bound is open. With q = z_t + c (x_t - rest), for any c > 0, this is z_t = q
min(1, s / |q|) (Alart and Curnier 1991), which gives the next state (stick, slip) of the active-set
method. With (I - d d^T) q = 0 for d = q / |q| its linearisation in a slipping state is

    z_t = s d + kappa (I - d d^T) (x_t - rest),    kappa = c s / (|q| - s),

where s contains the unknown z_n (Hueber, Stadler and Wohlmuth 2008): consistent, and unsymmetric
for mu > 0. In the solution kappa is s / |x_t - rest|, for any c.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from dolfinx_mortar.arrays import Bools, Floats, Ints


@dataclass(frozen=True)
class Friction:
    """Limits of tangential reactions at this rank's m nodes, with at most t tangential unknowns."""

    normal: Ints  # (m,) position of the node's x_n in `BoundQP.bounded`
    tangential: Ints  # (m, t) unknowns, -1 for none
    rest: Floats  # (m, t) x_t without slip, 0 for none
    coefficient: Floats  # (m,) mu >= 0
    cohesion: Floats  # (m,) force >= 0, the limit without pressure

    @property
    def some(self) -> Bools:
        """Entries (m, t) of `tangential` that are unknowns."""
        return np.asarray(self.tangential >= 0)

    def pick(self, values: Floats) -> Floats:
        """Tangential components (m, t) of a vector."""
        if values.size == 0:  # a rank without unknowns
            return np.zeros(self.tangential.shape)
        return np.where(self.some, values[self.tangential], 0.0)

    def means(self, diagonal: Floats) -> Floats:
        """Mean (m,) of a diagonal over the tangential unknowns of each node."""
        return np.asarray(self.pick(diagonal).sum(axis=1) / np.maximum(self.some.sum(axis=1), 1))

    def acts(self, closed: Bools) -> Bools:
        """Nodes (m,) that may carry tangential reactions, given the closed ones (m,)."""
        return np.asarray(closed | (self.cohesion > 0.0))

    def limit(self, pressing: Floats) -> Floats:
        """Return s (m,) for normal reactions (m,), negative ones counting as 0."""
        return np.asarray(self.coefficient * np.maximum(pressing, 0.0) + self.cohesion)

    @property
    def plane(self) -> bool:
        """Whether nodes have at most one tangential unknown."""
        return self.tangential.shape[1] == 1

    @property
    def across(self) -> Bools:
        """Nodes (m,) with more than one tangential unknown."""
        return np.asarray(self.some.sum(axis=1) > 1)

    def select(self, mask: Bools) -> Friction:
        """The law of some nodes."""
        return Friction(*(getattr(self, field.name)[mask] for field in fields(self)))

    def put(self, values: Floats, parts: Floats) -> None:
        """Set the tangential components of a vector."""
        values[self.tangential[self.some]] = parts[self.some]


@dataclass(frozen=True)
class Sliding:
    """Linearised law of slipping nodes, z_t = (mu z_n + cohesion) d + kappa (I - d d^T) slip."""

    normal: Ints  # (m,) unknowns
    law: Friction  # of the slipping nodes
    direction: Floats  # (m, t) d
    stiffness: Floats  # (m,) kappa

    def reaction(self, x: Floats, z: Floats) -> Floats:
        """z_t (m, t) of the law."""
        limit = self.law.coefficient * z[self.normal] + self.law.cohesion
        return self._resist(limit, self.law.pick(x) - self.law.rest)

    def add(self, x: Floats, y: Floats) -> None:
        """Add to y = A x the derivative of the law's residual in the direction x."""
        limit = -self.law.coefficient * y[self.normal]
        self.law.put(y, self.law.pick(y) + self._resist(limit, self.law.pick(x)))

    def _resist(self, limit: Floats, slip: Floats) -> Floats:
        d = self.direction
        across = slip - d * (d * slip).sum(axis=1, keepdims=True)
        return np.asarray(limit[:, None] * d + self.stiffness[:, None] * across)


def state_of(held: Ints, sliding: Sliding | None) -> bytes:
    """Bytes that distinguish the matrices of two states, never empty."""
    found = b"state" + held.tobytes()
    if sliding is not None:
        found += sliding.normal.tobytes() + sliding.direction.tobytes()
        found += sliding.stiffness.tobytes()
    return found


@dataclass(frozen=True)
class Sliders:
    """Primal-dual iterate on the nodes with friction."""

    law: Friction
    slip: Floats  # (m, t) x_t - rest
    reaction: Floats  # (m, t) z_t
    limit: Floats  # (m,) s
    stiffness: Floats  # (m,) c, which scales slips to forces

    @property
    def trial(self) -> Floats:
        """Return q (m, t)."""
        return np.asarray(self.reaction + self.stiffness[:, None] * self.slip)

    def directions(self, before: Floats | None = None) -> tuple[Floats, Floats]:
        """Return d (m, t), zero at sticking nodes, and kappa (m,) of the next state.

        A node that would reverse its direction ``before`` (m, t) sticks first, as mostly in the
        solution: neighbours that reverse at once could alternate for ever.

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
        """z_t - q min(1, s / |q|) (m, t), the residual of the law."""
        q = self.trial
        size = np.linalg.norm(q, axis=1)
        share = np.divide(self.limit, size, out=np.ones_like(size), where=size > self.limit)
        return np.asarray(self.reaction - q * share[:, None])

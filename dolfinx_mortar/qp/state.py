# SPDX-License-Identifier: MIT
"""What active-set updates hold: which bounds are active, and how nodes with friction slip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_mortar.arrays import Actives, Bools, Floats
from dolfinx_mortar.qp.bound_qp import BoundQP
from dolfinx_mortar.qp.friction import Friction


def nearest(qp: BoundQP) -> Actives:
    """Return every bounded unknown at the bound nearest to zero."""
    lower, upper = qp.bounds()
    return np.where(np.abs(upper) <= np.abs(lower), 1, -1).astype(np.int8)


@dataclass(frozen=True)
class State:
    """What is held, and how the rest slips."""

    active: Actives  # (k,) on `BoundQP.bounded`
    directions: Floats  # (m, t) of slip, zero where it sticks
    stiffness: Floats  # (m,) kappa, of slip across its direction

    @staticmethod
    def create(qp: BoundQP, active: Actives, sliding: Floats | None = None) -> State:
        """Return a state to begin with: of closed nodes all stick, or slip in given directions.

        Where it slips, it resists across its direction as the matrix does.
        """
        law = qp.friction
        if law is None:
            return State(active, np.zeros((0, 1)), np.zeros(0))
        d = np.zeros(law.rest.shape) if sliding is None else sliding
        diagonal = law.pick(qp.A.getDiagonal().array_r)
        return State(active, d, law.across * diagonal.max(axis=1, initial=0.0))

    @staticmethod
    def holding(qp: BoundQP) -> State:
        """Return a state that holds every body: all at their nearest bounds, and stuck."""
        return State.create(qp, nearest(qp))

    def tobytes(self) -> bytes:
        """Return what tells it from other states."""
        parts = self.active, self.directions, self.stiffness
        return b"".join(np.ascontiguousarray(part).tobytes() for part in parts)

    def slips(self, law: Friction) -> Bools:
        """Return which nodes (m,) slip, against some friction."""
        return np.asarray(law.acts(self.active[law.normal] > 0) & self.directions.any(axis=1))

    def sticks(self, law: Friction) -> Bools:
        """Return which tangential directions (m, t) are held."""
        acts = law.acts(self.active[law.normal] > 0)
        return np.asarray((acts & ~self.directions.any(axis=1))[:, None] & law.some)

    def towards(self, new: State, active: Bools, sides: Bools) -> State:
        """Return the new state where masks of bounds (k,) and of nodes (m,) say so, else this."""
        directions = np.where(sides[:, None], new.directions, self.directions)
        stiffness = np.where(sides, new.stiffness, self.stiffness)
        return State(np.where(active, new.active, self.active), directions, stiffness)

    def sliding(self, law: Friction) -> Floats:
        """Return the directions (m, t) of the nodes that slip, zero at others."""
        return np.where(self.slips(law)[:, None], self.directions, 0.0)

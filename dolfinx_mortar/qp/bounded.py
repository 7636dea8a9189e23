# SPDX-License-Identifier: MIT
"""The rule of the primal-dual active set: which bounds a candidate says are active, and how surely.

On arrays of bounded unknowns alone, so that large problems, small models and the check share it.
"""

from dataclasses import dataclass

import numpy as np

from dolfinx_mortar.arrays import Actives, Bools, Floats


@dataclass(frozen=True)
class Bounded:
    """A candidate on the bounded unknowns."""

    x: Floats  # (k,)
    z: Floats  # (k,) reaction b - A x
    lower: Floats  # (k,) -inf where there is none
    upper: Floats  # (k,) inf where there is none
    stiffness: Floats  # (k,) diag(A), which makes a distance a force

    def predicted(self) -> Actives:
        """Return the active set that the candidate says comes next.

        An unknown is at its upper bound if z + c (x - upper) > 0 and at its lower bound if
        z + c (x - lower) < 0, with c = diag(A), which makes both terms forces of one size.

        >>> one = np.ones(3)
        >>> Bounded(np.array([0.5, 1.0, 2.0]), 0 * one, -one, one, one).predicted().tolist()
        [0, 0, 1]
        """
        active = np.zeros(self.x.size, dtype=np.int8)
        active[self.z + self.stiffness * (self.x - self.upper) > 0.0] = 1
        active[self.z + self.stiffness * (self.x - self.lower) < 0.0] = -1
        return active

    def strong(self, active: Actives, new: Actives, atol: float) -> Bools:
        """Tell which unknowns differ between two sets by more than the accuracy of the forces.

        An unknown is weakly active if its reaction and its distance to the bound, times the
        stiffness, are together below that accuracy: then either side is right.
        """
        return np.asarray(self.strength(active, new) > atol)

    def strength(self, active: Actives, new: Actives) -> Floats:
        """Return the forces by which unknowns differ between two sets, 0 where they do not."""
        side = np.where((active > 0) | (new > 0), self.upper, self.lower)
        side = np.where(np.isfinite(side), side, self.x)
        strength = np.abs(self.z) + self.stiffness * np.abs(self.x - side)
        return np.asarray(np.where(active != new, strength, 0.0))

# SPDX-License-Identifier: MIT
"""The updated geometry as a fixed point: its change, and whether it is frozen for now."""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI

import numpy as np

from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.newton_method.contacts import Contacts
from dolfinx_mortar.newton_method.linearisation import Balance

# A fixed point whose change grows so often, with Newton converged in between, does not contract.
MOST_RISES = 2


@dataclass(frozen=True)
class Watch:
    """State of the fixed point: whether the geometry is frozen, and its last change."""

    moving: bool
    held: bool = False
    change: float = np.inf  # work of the contact forces in the last change of the gaps
    forces: float = np.inf  # residual of forces after it
    rises: int = 0  # successive changes that grew although Newton had converged between them

    def after(self, change: float, forces: float) -> Watch:
        """Return the state after an update: frozen unless its change or the residual decreases."""
        grows = change >= self.change and forces >= self.forces
        rises = self.rises + 1 if grows and self.held else 0
        return Watch(self.moving, held=grows, change=change, forces=forces, rises=rises)


def find_change(
    comm: MPI.Comm, balance: Balance, contacts: Contacts, predicted: Floats
) -> tuple[float, float]:
    """Return how far the gaps of closed contacts are from their prediction.

    The largest, and the work of the contact forces in all of them; collective.
    """
    nodes = balance.nodes
    off = np.abs(balance.bounds.upper - predicted[nodes])
    off[~contacts.active[nodes] | ~np.isfinite(off)] = 0.0
    largest = float(maximum(comm, off.max(initial=0.0))[0])
    work = comm.allreduce(float(np.abs(contacts.reactions(balance)) @ off), op=MPI.SUM)
    return largest, float(work)

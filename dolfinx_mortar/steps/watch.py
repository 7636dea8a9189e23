# SPDX-License-Identifier: MIT
"""Moving geometry as a fixed point that is watched: how much it changes, and whether it is held."""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI

import numpy as np

from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.steps.contacts import Contacts
from dolfinx_mortar.steps.linearisation import Balance

# A fixed point whose change grows so often, Newton converged in between, does not contract.
MOST_RISES = 2


@dataclass(frozen=True)
class Watch:
    """The geometry as a fixed point: whether it is held, and its last change."""

    moving: bool
    held: bool = False
    change: float = np.inf  # work of the contact forces in the last change of the gaps
    forces: float = np.inf  # residual of forces after it
    rises: int = 0  # successive changes that grew although Newton had converged between them

    def after(self, change: float, forces: float) -> Watch:
        """Return the watch after an update: held unless its change, or the residual, shrinks."""
        grows = change >= self.change and forces >= self.forces
        rises = self.rises + 1 if grows and self.held else 0
        return Watch(self.moving, held=grows, change=change, forces=forces, rises=rises)


def at_nodes(count: int, balance: Balance, values: Floats) -> Floats:
    """Return values (k,) of bounded unknowns at the owned nodes (count,), nan where is none."""
    nodal = np.full(count, np.nan)
    nodal[balance.nodes] = values
    return nodal


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

# SPDX-License-Identifier: MIT
"""Loop of the active-set methods: solve with an active set, update it, until it is unchanged.

The solve is an argument, see `held.HeldProblem`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from hashlib import blake2b
from typing import Generic, Protocol, TypeVar

from mpi4py import MPI

from dolfinx_mortar.arrays import LIMIT

# Levels of accuracy: the first sets follow from loose solves, the last one from a tight one.
LOOSE, TIGHT = 0, 2


class Set(Protocol):
    """An active set: an array, or a record that contains one."""

    def tobytes(self) -> bytes:
        """Return the same bytes for equal sets."""


S = TypeVar("S", bound=Set)


@dataclass(frozen=True)
class Found(Generic[S]):
    """Result of a solve with a given active set."""

    predicted: S  # the next set
    changes: int  # unknowns on all ranks that differ and are not weakly active
    satisfied: bool  # accurate enough for the last solve


@dataclass(frozen=True)
class Outcome(Generic[S]):
    """Result of the updates."""

    state: S  # the last set of a solve
    updates: int
    reason: str  # why the updates have not converged, "" if they have


def update(
    hold: Callable[[S, int], Found[S]], active: S, comm: MPI.Comm, *, level: int = TIGHT
) -> Outcome[S]:
    """Update the set until it is unchanged (collective).

    A set that occurs again is a cycle: inaccurate solves may cause it, so their accuracy is raised;
    with accurate ones it would never end.

    Args:
        hold: solves with a set, to the accuracy of a level.
        active: this rank's part of the first set.
        comm: communicator of the ranks that share the set.
        level: accuracy of the first solve.
    """
    seen: set[int] = set()
    updates, held = 1, active
    for _ in range(LIMIT):
        held = active
        found = hold(held, level)
        if found.changes == 0 and found.satisfied:
            return Outcome(held, updates, "")
        if found.changes == 0:
            level += 1
        elif came_back(found.predicted, seen, comm):
            if level >= TIGHT:
                return Outcome(held, updates, "the active set came back to an earlier one")
            level += 1
            seen.clear()
        updates += found.changes > 0
        active = found.predicted
    return Outcome(held, updates, f"the active set still changed after {LIMIT} solves")


def came_back(active: Set, seen: set[int], comm: MPI.Comm) -> bool:
    """Tell whether this set, of all ranks, is among those seen, and add it (collective)."""
    part = blake2b(active.tobytes(), digest_size=7, salt=str(comm.rank).encode())
    everywhere = comm.allreduce(int.from_bytes(part.digest()), op=MPI.SUM)
    known = everywhere in seen
    seen.add(everywhere)
    return known

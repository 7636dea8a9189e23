# SPDX-License-Identifier: MIT
"""The loop of all active-set methods: hold a set, solve, read off the next one, until it stays.

What it means to solve is an argument: the large problem (`held.HeldProblem`), or a small dense
model of it (`dense.solve_dense`).
"""

from collections.abc import Callable
from dataclasses import dataclass
from hashlib import blake2b
from typing import Generic, Protocol, TypeVar

from mpi4py import MPI

# Rounds of anything that ends by a rule of its own; no problem met so far needs half as many.
LIMIT = 100
# Levels of accuracy: early sets are read off loose solves, the last one off a tight one.
LOOSE, TIGHT = 0, 2


class Set(Protocol):
    """What is held: an array of the bounds, or more."""

    def tobytes(self) -> bytes:
        """Return what tells it from others."""


S = TypeVar("S", bound=Set)


@dataclass(frozen=True)
class Found(Generic[S]):
    """What a solve with a set held has found."""

    predicted: S  # the next set
    changes: int  # unknowns on all ranks that differ by more than weak activity
    satisfied: bool  # accurate enough to end with, if nothing changes
    hopeless: bool = False  # sets have come no nearer to a solution for long


@dataclass(frozen=True)
class Outcome(Generic[S]):
    """How the updates ended."""

    state: S  # the last set that was held
    updates: int
    reason: str  # why the set has not settled, or nothing


def update(
    hold: Callable[[S, int], Found[S]], active: S, comm: MPI.Comm, *, level: int = TIGHT
) -> Outcome[S]:
    """Update the set until it stays (collective).

    A set that comes back is a cycle. If the solves were loose it may be their fault, and they
    become tighter; if they were tight it would go on for ever.

    Args:
        hold: solves with a set held, to the accuracy of a level.
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
            level += 1  # look once more before the last solve
        elif came_back(found.predicted, seen, comm):
            if level >= TIGHT:
                return Outcome(held, updates, "the active set came back to an earlier one")
            level += 1
            seen.clear()
        elif found.hopeless:
            return Outcome(held, updates, "the active set wandered without coming nearer")
        updates += found.changes > 0
        active = found.predicted
    return Outcome(held, updates, f"the active set still changed after {LIMIT} solves")


def came_back(active: Set, seen: set[int], comm: MPI.Comm) -> bool:
    """Tell whether this set, over all ranks, was there before; one number travels."""
    part = blake2b(active.tobytes(), digest_size=7, salt=str(comm.rank).encode())
    everywhere = comm.allreduce(int.from_bytes(part.digest()), op=MPI.SUM)
    known = everywhere in seen
    seen.add(everywhere)
    return known

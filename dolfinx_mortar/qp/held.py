# SPDX-License-Identifier: MIT
"""The active-set method: solve with a set, update it, until it is unchanged.

With friction, tangential unknowns of sticking nodes are fixed, too, and slipping nodes have the
law's reaction.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.parallel import any_rank, maximum, norm
from dolfinx_mortar.common.arrays import LIMIT, ROUND_OFF, Actives, Bools, Floats, Ints
from dolfinx_mortar.qp.bound_qp import (
    BoundQP,
    Friction,
    Sliding,
    check,
    is_noise,
    on_bounded,
    on_friction,
    reaction,
)

LOOSE, TIGHT = 0, 2
# Tolerance relative to that of the check, whose scale may decrease meanwhile.
SHARE = 0.5


def nearest(qp: BoundQP) -> Actives:
    """Active set (k,) with every unknown at its bound nearest to zero."""
    lower, upper = qp.bounds
    return np.where(np.abs(upper) <= np.abs(lower), 1, -1).astype(np.int8)


@dataclass(frozen=True)
class State:
    """An active set, and the directions of slip."""

    active: Actives  # (k,) on `BoundQP.bounded`
    directions: Floats  # (m, t) of slip, zero at sticking nodes
    stiffness: Floats  # (m,) kappa of `qp.bound_qp`

    @staticmethod
    def create(
        qp: BoundQP,
        active: Actives,
        sliding: Floats | None = None,
        kappa: Floats | None = None,
    ) -> State:
        """Initial state, in which closed nodes stick unless directions (m, t) are given.

        kappa (m,) is at most the entries of |diag(A)|.
        """
        law = qp.friction
        if law is None:
            return State(active, np.zeros((0, 1)), np.zeros(0))
        d = np.zeros(law.rest.shape) if sliding is None else sliding
        diagonal = law.pick(qp.stiffness)
        most = law.across * diagonal.max(axis=1, initial=0.0)
        return State(active, d, most if kappa is None else np.minimum(kappa, most))

    def tobytes(self) -> bytes:
        """The same for equal states."""
        return b"".join(part.tobytes() for part in vars(self).values())

    def slips(self, law: Friction) -> Bools:
        """Nodes (m,) that slip with friction."""
        return law.acts(self.active[law.normal] > 0) & self.directions.any(axis=1)

    def sticks(self, law: Friction) -> Bools:
        """Tangential unknowns (m, t) that are fixed."""
        acts = law.acts(self.active[law.normal] > 0)
        return (acts & ~self.directions.any(axis=1))[:, None] & law.some

    def held(self, qp: BoundQP) -> Ints:
        """Fixed unknowns, ascending."""
        found, law = qp.bounded[self.active != 0], qp.friction
        if law is not None:
            found = np.concatenate([found, law.tangential[self.sticks(law)]])
        return np.sort(found)

    def towards(self, new: State, active: Bools, sides: Bools) -> State:
        """This state, with that of another at the bounds (k,) and nodes (m,) in the masks."""
        directions = np.where(sides[:, None], new.directions, self.directions)
        stiffness = np.where(sides, new.stiffness, self.stiffness)
        return State(np.where(active, new.active, self.active), directions, stiffness)


@dataclass(frozen=True)
class Found:
    """Result of a solve with a set."""

    predicted: Any  # the next set
    changes: int  # unknowns on all ranks that differ, without weakly active ones
    satisfied: bool  # accurate enough for the last solve


@dataclass(frozen=True)
class Outcome:
    """Result of the updates."""

    state: Any  # last set of a solve
    updates: int
    reason: str = ""  # why updates have not converged
    linearisation: str = "exact linearisation"  # of friction


def update(
    hold: Callable[[Any, int], Found], state: Any, comm: MPI.Comm, *, level: int = TIGHT
) -> Outcome:
    """Update the set until it is unchanged (collective).

    A repeated set is a cycle: the accuracy is raised, at last the updates end. `hold` solves with a
    set, to the accuracy of a level.
    """
    seen: set[int] = set()
    updates, held = 1, state
    for _ in range(LIMIT):
        held = state
        found = hold(held, level)
        if found.changes == 0 and found.satisfied:
            return Outcome(held, updates)
        if found.changes == 0:
            level += 1
        else:
            everywhere = comm.allreduce(hash((comm.rank, found.predicted.tobytes())))
            if everywhere in seen:
                if level >= TIGHT:
                    return Outcome(held, updates, "the active set came back to an earlier one")
                level += 1
                seen.clear()
            else:
                seen.add(everywhere)
        updates += found.changes > 0
        state = found.predicted
    return Outcome(held, updates, f"the active set still changed after {LIMIT} solves")


class Solver(Protocol):
    """Solver of linear systems with fixed unknowns; see `LinearSolver`."""

    exact: bool  # whether one solve is accurate to round-off

    def round_off(self, x: PETSc.Vec) -> float:
        """Round-off of A x; collective."""

    def solve(
        self,
        b: PETSc.Vec,
        x: PETSc.Vec,
        held: Ints,
        *,
        atol: float,
        z: PETSc.Vec | None = None,
        sliding: Sliding | None = None,
    ) -> PETSc.Vec:
        """Solve for free unknowns in place, return b - A x; collective."""


class HeldProblem:
    """The QP with a given active set, for `update`.

    The relative tolerance of level l is rtol^(2^(l - 2)), and rtol^2 where the check still fails.
    Loose levels refer to the reactions at the bounds, the tight one to all forces. x (n,) is the
    guess and the last solution, `most` the largest residual of the tight level.
    """

    def __init__(
        self, qp: BoundQP, linear: Solver, x: PETSc.Vec, rtol: float, most: float = np.inf
    ) -> None:
        self.qp, self.linear, self.x, self.rtol, self.most = qp, linear, x, rtol, most
        self.z = reaction(qp, x)
        self.guessed = self.z.norm()
        self.reactions: float | None = None  # at the bounds; unknown before the first solve
        self.best: State | None = None  # with the least error, a force
        self.error = np.inf
        self.level = LOOSE  # of the last solve

    def hold(self, state: State, level: int, worst: bool = False) -> Found:
        """Solve in a state, updating only the largest errors if `worst`; set x and z (collective).

        Raises:
            LinearSolveFailed: if the state leaves a body unconstrained.
        """
        if level > self.level:  # smaller errors become visible
            self.level, self.error = level, np.inf
        atol, law, comm = self.solve(state, level), self.qp.friction, self.qp.comm
        if is_noise(self.qp, self.x, self.z):
            return Found(state, 0, satisfied=True)
        found = on_bounded(self.qp, self.x, self.z)
        atol = max(atol, self.linear.round_off(self.x))
        new = State(found.predicted(), state.directions, state.stiffness)
        strength = found.strength(state.active, new.active)
        missing: Floats = np.zeros(0)
        changes = int((strength > atol).sum())
        if law is not None:
            sliders = on_friction(self.qp, self.x, self.z, found)
            missing = np.linalg.norm(sliders.error(), axis=1)
            changes += int((missing > atol).sum())
            new = State(new.active, *sliders.directions(state.directions))
            missing = np.where(state.slips(law) != new.slips(law), missing, 0.0)
        tops = maximum(comm, strength.max(initial=0.0), missing.max(initial=0.0))
        largest = float(tops.max())
        if largest < self.error:
            self.best, self.error = state, largest
        if worst:
            new = state.towards(new, strength >= largest, missing >= largest)
        changes = int(comm.allreduce(changes))
        satisfied = changes == 0 and level >= TIGHT
        if satisfied and not (self.linear.exact or self._accuracy(level) <= ROUND_OFF):
            satisfied = check(self.qp, self.x, self.z).satisfied(self.rtol)
        return Found(new, changes, satisfied)

    def solve(self, state: State, level: int) -> float:
        """Solve in a state; set x and z; return the tolerance (collective)."""
        qp, (lower, upper) = self.qp, self.qp.bounds
        on, bound = state.active != 0, np.where(state.active > 0, upper, lower)
        sliding = None
        soft: Bools = np.zeros(len(on), dtype=bool)
        if qp.give is not None:
            soft = on & (qp.give > 0.0)
            on = on & ~soft
        held, values = qp.bounded[on], bound[on]
        if (law := qp.friction) is not None:
            stuck = state.sticks(law)
            held = np.concatenate([held, law.tangential[stuck]])
            values = np.concatenate([values, law.rest[stuck]])
            slips = state.slips(law)
            if any_rank(qp.comm, slips.any())[0]:
                parts = law.select(slips)
                given = state.directions[slips], state.stiffness[slips]
                sliding = Sliding(qp.bounded[parts.normal], parts, *given)
        if any_rank(qp.comm, soft.any())[0]:
            assert qp.give is not None
            t = 2 if law is None else max(2, law.rest.shape[1])
            own = Sliding.yielding(qp.bounded[soft], bound[soft], qp.give[soft], t)
            sliding = own if sliding is None else sliding.joined(own)
        if any_rank(qp.comm, (self.x.array_r[held] != values).any())[0]:
            self.x.array[held] = values
            self.z = reaction(qp, self.x)
        held = np.sort(held)
        if self.reactions is None:
            self.reactions = max(self.guessed, self.z.norm())
        reached = asked = self._tolerance(level)
        for _ in range(LIMIT):  # with the reactions of the solution
            solved = self.linear.solve(
                qp.b, self.x, held, atol=SHARE * asked, z=self.z, sliding=sliding
            )
            self.z = solved.copy()
            self.reactions = norm(qp.comm, self.z.array_r[np.union1d(held, qp.bounded[soft])])
            reached, asked = asked, self._tolerance(level)
            if SHARE * reached <= asked or is_noise(qp, self.x, self.z):
                break
        return reached

    def _accuracy(self, level: int) -> float:
        return float(max(self.rtol ** (2.0 ** (level - TIGHT)), ROUND_OFF))

    def _tolerance(self, level: int) -> float:
        assert self.reactions is not None
        force = max(self.qp.b.norm(), self.reactions)
        if level >= TIGHT:
            return min(self._accuracy(level) * force, self.most)
        return max(self.rtol * force, self._accuracy(level) * self.reactions)

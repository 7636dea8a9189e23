# SPDX-License-Identifier: MIT
"""The large problem with a given active set: a linear system, solved as accurately as needed.

With friction, tangential unknowns of sticking nodes are fixed, too, and at slipping nodes the
reaction of the law takes the place of 0.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.parallel import any_rank, maximum, norm
from dolfinx_mortar.arrays import LIMIT, ROUND_OFF, Actives, Bools, Floats, Ints
from dolfinx_mortar.qp.bound_qp import (
    KKT,
    BoundQP,
    QPSolution,
    check,
    is_noise,
    on_bounded,
    on_friction,
    reaction,
)
from dolfinx_mortar.qp.friction import Friction, Sliding
from dolfinx_mortar.qp.linear import GoOn
from dolfinx_mortar.qp.updates import LOOSE, TIGHT, Found, Outcome

# Solves are this much more accurate than the check, whose scale may decrease meanwhile. Five plane
# problems with multigrid: the same forces, and with 1/8, 1/4, 1/2, 3/4, 1 conjugate gradients take
# 1.21, 1.10, 1, .93, .90 of the iterations; near 1 they would hardly gain the digit asked for next.
SHARE = 0.5


def nearest(qp: BoundQP) -> Actives:
    """Return the active set (k,) with every bounded unknown at its bound nearest to zero."""
    lower, upper = qp.bounds()
    return np.where(np.abs(upper) <= np.abs(lower), 1, -1).astype(np.int8)


@dataclass(frozen=True)
class State:
    """An active set, and the directions in which nodes with friction slip."""

    active: Actives  # (k,) on `BoundQP.bounded`
    directions: Floats  # (m, t) of slip, zero at sticking nodes
    stiffness: Floats  # (m,) kappa of `qp.friction`

    @staticmethod
    def create(
        qp: BoundQP,
        active: Actives,
        sliding: Floats | None = None,
        kappa: Floats | None = None,
    ) -> State:
        """Return an initial state, in which closed nodes stick unless directions (m, t) are given.

        Its kappa are those that are given (m,), but no larger than entries of |diag(A)|.
        """
        law = qp.friction
        if law is None:
            return State(active, np.zeros((0, 1)), np.zeros(0))
        d = np.zeros(law.rest.shape) if sliding is None else sliding
        diagonal = law.pick(qp.stiffness)
        most = law.across * diagonal.max(axis=1, initial=0.0)
        return State(active, d, most if kappa is None else np.minimum(kappa, most))

    @staticmethod
    def holding(qp: BoundQP) -> State:
        """Return the state that constrains most: all at their nearest bounds, and sticking."""
        return State.create(qp, nearest(qp))

    def tobytes(self) -> bytes:
        """Return the same bytes for equal states."""
        parts = self.active, self.directions, self.stiffness
        return b"".join(np.ascontiguousarray(part).tobytes() for part in parts)

    def slips(self, law: Friction) -> Bools:
        """Return which nodes (m,) slip against friction."""
        return np.asarray(law.acts(self.active[law.normal] > 0) & self.directions.any(axis=1))

    def sticks(self, law: Friction) -> Bools:
        """Return which tangential unknowns (m, t) are fixed."""
        acts = law.acts(self.active[law.normal] > 0)
        return np.asarray((acts & ~self.directions.any(axis=1))[:, None] & law.some)

    def held(self, qp: BoundQP) -> Ints:
        """Return the unknowns that are fixed, by active bounds and where nodes stick, ascending."""
        found, law = qp.bounded[self.active != 0], qp.friction
        if law is not None:
            found = np.concatenate([found, law.tangential[self.sticks(law)]])
        return np.sort(found)

    def towards(self, new: State, active: Bools, sides: Bools) -> State:
        """Return this state with that of bounds (k,) and nodes (m,) in the masks from another."""
        directions = np.where(sides[:, None], new.directions, self.directions)
        stiffness = np.where(sides, new.stiffness, self.stiffness)
        return State(np.where(active, new.active, self.active), directions, stiffness)


@dataclass(frozen=True)
class Best:
    """The state with the least error in the law of friction so far."""

    state: State
    error: float  # a force


class Solver(Protocol):
    """Solves linear systems with held unknowns; see `LinearSolver`."""

    @property
    def direct(self) -> bool:
        """Tell whether it factorises."""

    def round_off(self, x: PETSc.Vec) -> float:
        """Return the round-off of A x; collective."""

    def solve(
        self,
        b: PETSc.Vec,
        x: PETSc.Vec,
        held: Ints,
        *,
        atol: float,
        z: PETSc.Vec | None = None,
        sliding: Sliding | None = None,
        go_on: GoOn | None = None,
    ) -> PETSc.Vec:
        """Solve for what is not held in place, return b - A x; collective."""


class HeldProblem:
    """The QP with a given active set, for `updates.update`.

    The relative accuracy of level l is rtol^(2^(l - 2)): the fourth root of rtol, its square root,
    rtol, and its square where the check still fails because the increment is small relative to the
    reactions. It is relative to the reactions at the bounds for loose levels, as only these decide
    on the next set, and to all forces for the tight one.

    Args:
        x: (n,) in: initial guess; out: the last solution.
    """

    def __init__(
        self,
        qp: BoundQP,
        linear: Solver,
        x: PETSc.Vec,
        rtol: float,
    ) -> None:
        self.qp, self.linear, self.x, self.rtol = qp, linear, x, rtol
        self.visited = np.zeros(qp.bounded.size, dtype=bool)  # active in a state
        self.z = reaction(qp, x)
        self.guessed = self.z.norm()
        self.reactions: float | None = None  # at the bounds; unknown before the first solve
        self.best: Best | None = None
        self.level = LOOSE  # of the last solve
        self.asked = np.inf  # its tolerance
        self._checked: tuple[PETSc.Vec, KKT] | None = None  # z of the last check, its residuals

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        """Lower and upper bounds (k,)."""
        return self.qp.bounds()

    @property
    def continued(self) -> bool:
        """Whether an iteration goes on at the next accuracy.

        A factorisation takes one iteration or two, friction another method.
        """
        return self.qp.friction is None and not self.linear.direct

    def forget(self) -> None:
        """Start again from x = 0, after a solve that has failed."""
        self.x.set(0.0)
        self.z = self.qp.b.copy()

    def hold(self, state: State, level: int, worst: bool = False) -> Found[State]:
        """Solve in a state; x and z are the solution (collective).

        Args:
            state: active set and directions of slip.
            level: accuracy.
            worst: with friction, only the nodes with the largest error change their state.

        Raises:
            LinearSolveFailed: if the state leaves a body unconstrained.
        """
        self.visited |= state.active != 0
        if level > self.level:  # smaller errors become visible
            self.level, self.best = level, self.best and replace(self.best, error=np.inf)
        atol = self.solve(state, self.level)
        if is_noise(self.qp, self.x, self.z):
            return Found(state, 0, satisfied=True)
        law = self.qp.friction
        found = on_bounded(self.qp, self.x, self.z)
        atol = max(atol, self.linear.round_off(self.x))
        new = State(found.predicted(), state.directions, state.stiffness)
        strength = found.strength(state.active, new.active)
        changes = int((strength > atol).sum())
        if law is not None:
            sliders = on_friction(self.qp, self.x, self.z, found)
            missing = np.linalg.norm(sliders.error(), axis=1)
            changes += int((missing > atol).sum())
            new = State(new.active, *sliders.directions(state.directions))
            missing = np.where(state.slips(law) != new.slips(law), missing, 0.0)
            tops = maximum(self.qp.comm, strength.max(initial=0.0), missing.max(initial=0.0))
            largest = float(tops.max())
            if largest < (self.best.error if self.best else np.inf):
                self.best = Best(state, largest)
            if worst:
                new = state.towards(new, strength >= largest, missing >= largest)
        changes = int(self.qp.comm.allreduce(changes))
        satisfied = changes == 0 and self.level >= TIGHT and self._is_accurate(self.level)
        if self.continued and self.level >= TIGHT and changes == 0 and not satisfied:
            # more digits of the same set would not help where weakly active unknowns are wrong
            changes = int(self.qp.comm.allreduce(int((new.active != state.active).sum())))
        return Found(new, changes, satisfied)

    def solve(self, state: State, level: int) -> float:
        """Solve in a state; x and z are the solution; return the tolerance (collective)."""
        qp, active, (lower, upper) = self.qp, state.active, self.bounds
        on = active != 0
        held, values = qp.bounded[on], np.where(active > 0, upper, lower)[on]
        sliding = None
        if (law := self.qp.friction) is not None:
            stuck = state.sticks(law)
            held = np.concatenate([held, law.tangential[stuck]])
            values = np.concatenate([values, law.rest[stuck]])
            sliding = self._sliding(law, state)
        if any_rank(self.qp.comm, (self.x.array_r[held] != values).any())[0]:
            self.x.array[held] = values
            self.z = reaction(self.qp, self.x)
        held = np.sort(held)
        if self.reactions is None:
            self.reactions = max(self.guessed, self.z.norm())
        self.asked = self._tolerance(level)
        go_on = partial(self._go_on, state, held) if self.continued else None
        reached = self.asked
        for _ in range(LIMIT):  # until the tolerance holds with the reactions of the solution
            solved = self.linear.solve(
                qp.b, self.x, held, atol=SHARE * self.asked, z=self.z, sliding=sliding, go_on=go_on
            )
            self.z = solved.copy()
            self.reactions = norm(qp.comm, self.z.array_r[held])
            reached, self.asked = self.asked, self._tolerance(self.level)
            if SHARE * reached <= self.asked:
                break
        return reached

    def _go_on(self, state: State, held: Ints, x: PETSc.Vec, z: PETSc.Vec) -> float:
        """Return the tolerance with which an iteration goes on from x, z = b - A x; 0 to end.

        It ends where the state changes, or where the check is satisfied; collective.
        """
        self.reactions = norm(self.qp.comm, z.array_r[held])
        atol = self._tolerance(self.level)
        if self.asked > atol and SHARE * self.asked > atol:  # of the reactions before
            self.asked = atol
            return SHARE * atol
        found = on_bounded(self.qp, x, z)
        strength = found.strength(state.active, found.predicted())
        if any_rank(self.qp.comm, (strength > min(atol, self._tolerance(TIGHT))).any())[0]:
            return 0.0  # a change that is weak now, but not at the end
        if self.level < TIGHT:
            self.level, self.asked = self.level + 1, self._tolerance(self.level + 1)
            return SHARE * self.asked
        wrong = any_rank(self.qp.comm, (strength > 0.0).any())[0]
        self.asked *= SHARE**3  # about a digit
        exhausted = self.asked < ROUND_OFF * max(self.qp.b.norm(), self.reactions)
        if wrong or exhausted or check(self.qp, x, z).satisfied(self.rtol):
            return 0.0
        return SHARE * self.asked

    def _sliding(self, law: Friction, state: State) -> Sliding | None:
        """Return the linearised law of slipping nodes, None if no rank has any; collective."""
        slips = state.slips(law)
        if not any_rank(self.qp.comm, slips.any())[0]:
            return None
        parts = law.select(slips)
        normal = self.qp.bounded[parts.normal]
        return Sliding(normal, parts, state.directions[slips], state.stiffness[slips])

    def solution(self, outcome: Outcome[State], name: str) -> QPSolution:
        """Return the last solution."""
        kkt, state = self._check(), outcome.state
        law, directions = self.qp.friction, None
        if law is not None:
            directions = np.where(state.slips(law)[:, None], state.directions, 0.0)
        counts = outcome.updates, 0, 0
        return QPSolution(self.x, self.z, state.active, kkt, *counts, name, sliding=directions)

    def _accuracy(self, level: int) -> float:
        return float(max(self.rtol ** (2.0 ** (level - TIGHT)), ROUND_OFF))

    def _is_accurate(self, level: int) -> bool:
        """Tell whether the check is satisfied, or cannot be satisfied any better."""
        finest = self._accuracy(level) <= ROUND_OFF
        return finest or self._check().satisfied(self.rtol)

    def _check(self) -> KKT:
        """Return the residuals of the present x; collective."""
        if self._checked is None or self._checked[0] is not self.z:  # each x has a z of its own
            self._checked = self.z, check(self.qp, self.x, self.z)
        return self._checked[1]

    def _tolerance(self, level: int) -> float:
        """Return the largest residual at a level."""
        assert self.reactions is not None
        force = max(self.qp.b.norm(), self.reactions)
        if level >= TIGHT:
            return self._accuracy(level) * force
        return max(self.rtol * force, self._accuracy(level) * self.reactions)

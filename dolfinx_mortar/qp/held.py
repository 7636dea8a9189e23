# SPDX-License-Identifier: MIT
"""The large problem with a set held at its bounds: a linear system, solved as well as needed.

With friction, tangential unknowns of sticking nodes are held, too, and those of slipping nodes have
the law's reaction.
"""

from __future__ import annotations

from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.parallel import any_rank, maximum, norm
from dolfinx_mortar.arrays import Actives, Bools, Floats, Ints
from dolfinx_mortar.qp.bound_qp import (
    EPS,
    ROUND_OFF,
    BoundQP,
    QPSolution,
    check,
    on_bounded,
    on_friction,
    reaction,
)
from dolfinx_mortar.qp.friction import Friction, Sliding
from dolfinx_mortar.qp.linear import LinearSolver
from dolfinx_mortar.qp.updates import LIMIT, LOOSE, TIGHT, Found, Outcome

# Solves of sets with friction that come no nearer to the law; of 40 random problems (sweep
# friction, seeds 0 to 39: 938 QPs), whose sets all settle, none has more than 7 of them in a row.
PATIENCE = 20
# Who works for a check takes this share of its tolerance: its scale may shrink meanwhile.
SHARE = 0.5


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
        """Return a first state: of closed nodes all stick, or slip in given directions.

        Where it slips, it resists across its direction as the matrix does.
        """
        law = qp.friction
        if law is None:
            return State(active, np.zeros((0, 1)), np.zeros(0))
        d = np.zeros(law.rest.shape) if sliding is None else sliding
        diagonal = law.pick(qp.stiffness())
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


class HeldProblem:
    """The QP with a set held, for `updates.update`.

    Level l asks for the accuracy rtol^(2^(l - 2)): the fourth root, the square root, rtol itself,
    and its square where the check still says that a small step lies under large forces. Loose
    accuracies are shares of the reactions at the bounds, which is all that the next set is read
    from; rtol is one of all forces.

    Args:
        qp: the problem.
        linear: linear solver, attached to qp.A.
        x: (n,) in: a guess; out: the last solution.
        rtol: tolerance of the check.
    """

    def __init__(self, qp: BoundQP, linear: LinearSolver, x: PETSc.Vec, rtol: float) -> None:
        """Measure the forces of the guess."""
        self.qp, self.linear, self.x, self.rtol = qp, linear, x, rtol
        self.lower, self.upper = qp.bounds()
        self.z = reaction(qp, x)
        self.b_norm, self.guessed = qp.b.norm(), self.z.norm()
        self.reactions: float | None = None  # at the bounds; unknown before the first solve
        self.best: State | None = None  # the one that has come nearest to the law
        self.least = np.inf  # by how much, a force
        self.stalls = 0  # solves since then
        self.level = LOOSE  # of the last one

    def forget(self) -> None:
        """Begin anew from x = 0, after a solve that has failed."""
        self.x.set(0.0)
        self.z = self.qp.b.copy()

    def hold(self, state: State, level: int, share: float = 0.0) -> Found[State]:
        """Solve in a state; x and z are the solution (collective).

        Args:
            state: what is held, and how the rest slips.
            level: accuracy.
            share: nodes change sides whose error is at least this part of the largest.

        Raises:
            LinearSolveFailed: if the state leaves a body free.
        """
        active = state.active
        if level > self.level:  # errors show that were below what was asked for
            self.level, self.least, self.stalls = level, np.inf, 0
        atol = self.solve(state, level)
        law = self.qp.friction
        found = on_bounded(self.qp, self.x, self.z)
        atol = max(atol, self.linear.attached.operator.round_off(self.x))
        new = State(found.predicted(), state.directions, state.stiffness)
        strength = found.strength(active, new.active)
        changes = int((strength > atol).sum())
        if law is not None:
            sliders = on_friction(self.qp, self.x, self.z, found)
            missing = np.linalg.norm(sliders.error(), axis=1)
            changes += int((missing > atol).sum())
            new = State(new.active, *sliders.directions(state.directions))
            new = self._next(law, (state, new), strength, missing, share)
        changes = int(self.qp.comm.allreduce(changes))
        satisfied = changes == 0 and level >= TIGHT and self._is_accurate(level)
        return Found(new, changes, satisfied, hopeless=share == 0.0 and self.stalls >= PATIENCE)

    def solve(self, state: State, level: int) -> float:
        """Solve in a state; x and z are the solution; return the tolerance (collective)."""
        active = state.active
        on = active != 0
        held, values = self.qp.bounded[on], np.where(active > 0, self.upper, self.lower)[on]
        sliding = None
        if (law := self.qp.friction) is not None:
            stuck = state.sticks(law)
            held = np.concatenate([held, law.tangential[stuck]])
            values = np.concatenate([values, law.rest[stuck]])
            sliding = self._sliding(law, state)
        if any_rank(self.qp.comm, (self.x.array_r[held] != values).any())[0]:
            self.x.array[held] = values
            self.z = reaction(self.qp, self.x)
        return self._solve(np.sort(held), level, sliding)

    def _next(
        self,
        law: Friction,
        states: tuple[State, State],
        strength: Floats,
        missing: Floats,
        share: float,
    ) -> State:
        """Return the next state, in which only the worst nodes change sides; collective.

        Args:
            law: of friction.
            states: the one that has been solved, and the one that it predicts.
            strength: (k,) forces by which bounded unknowns differ between the two.
            missing: (m,) forces that are missing of the law.
            share: of the largest of these forces, from which on nodes change.
        """
        old, new = states
        missing = np.where(old.slips(law) != new.slips(law), missing, 0.0)
        tops = maximum(self.qp.comm, strength.max(initial=0.0), missing.max(initial=0.0))
        largest = float(tops.max())
        self.stalls += 1
        if largest < self.least:
            self.best, self.least, self.stalls = old, largest, 0
        return old.towards(new, strength >= share * largest, missing >= share * largest)

    def _sliding(self, law: Friction, state: State) -> Sliding | None:
        """Return the law of what slips, None if nothing does on any rank; collective."""
        slips = state.slips(law)
        if not any_rank(self.qp.comm, slips.any())[0]:
            return None
        parts = law.select(slips)
        normal = self.qp.bounded[parts.normal]
        return Sliding(normal, parts, state.directions[slips], state.stiffness[slips])

    def solution(self, outcome: Outcome[State], name: str) -> QPSolution:
        """Return the last solution."""
        kkt, state = check(self.qp, self.x, self.z), outcome.state
        counts = outcome.updates, 0, 0
        law = self.qp.friction
        directions = None if law is None else state.sliding(law)
        return QPSolution(self.x, self.z, state.active, kkt, *counts, name, sliding=directions)

    def count_changes(self, start: State, end: State) -> int:
        """Return in how many bounds two sets differ, weakly active ones left out; collective."""
        found = on_bounded(self.qp, self.x, self.z)
        strong = found.strong(start.active, end.active, self.rtol * self.z.norm())
        return int(self.qp.comm.allreduce(int(strong.sum())))

    def _accuracy(self, level: int) -> float:
        return float(max(self.rtol ** (2.0 ** (level - TIGHT)), ROUND_OFF * EPS))

    def _is_accurate(self, level: int) -> bool:
        """Tell whether the check agrees, or cannot be satisfied any better."""
        finest = self._accuracy(level) <= ROUND_OFF * EPS
        return finest or check(self.qp, self.x, self.z).satisfied(self.rtol)

    def _solve(self, held: Ints, level: int, sliding: Sliding | None) -> float:
        """Solve until the accuracy holds with the reactions that come out; return the tolerance."""
        if self.reactions is None:
            self.reactions = max(self.guessed, self.z.norm())
        atol = self._tolerance(level)
        for _ in range(LIMIT):
            found = self.linear.solve(
                self.qp.b, self.x, held, atol=SHARE * atol, z=self.z, sliding=sliding
            )
            self.z = found.copy()
            zb = self.z.array_r[held]
            self.reactions = norm(self.qp.comm, zb)
            reached, atol = atol, self._tolerance(level)
            if SHARE * reached <= atol:
                break
        return reached

    def _tolerance(self, level: int) -> float:
        """Return the largest residual at a level."""
        assert self.reactions is not None
        force = max(self.b_norm, self.reactions)
        if level >= TIGHT:
            return self._accuracy(level) * force
        return max(self.rtol * force, self._accuracy(level) * self.reactions)

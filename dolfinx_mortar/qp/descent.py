# SPDX-License-Identifier: MIT
"""Friction with given limits s in the plane: an active-set descent that cannot cycle.

The solution minimises, within the bounds, the convex

    J(x) = 1/2 x'Ax - b'x + sum_j s_j |x_t - rest|_j.

In a state (active bounds, sticking nodes, directions of the slipping ones) J is a quadratic, whose
minimum takes one solve. Updates of the active set step to that minimum and read the next state from
it. If few sticking nodes constrain a body, this may cycle: a belt on a drum, pulled equally at both
ends, slips outwards from one sticking node; if its neighbour should stick instead, that node slips,
too, and the unconstrained belt reverses its slip. Here x moves towards the minimum as far as J
decreases: to the first bound, to the node whose slip vanishes where J is least on the way, which
then sticks (in the belt: the neighbour), or to the minimum. Only in the minimum of a state are
bounds with reactions of the wrong sign released, and sticking nodes with |z_t| > s: the method of
Rosen (1960) and Fletcher (1971), for a quadratic and a sum of norms. J decreases from one such
minimum to the next, and there are finitely many.
"""

from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.arrays import Bools, Floats
from dolfinx_mortar.qp.bound_qp import BoundQP, on_bounded, reaction
from dolfinx_mortar.qp.friction import Friction
from dolfinx_mortar.qp.held import TIGHT, HeldProblem, Outcome, State


def descend(problem: HeldProblem, start: State, level: int = TIGHT) -> Outcome:
    """Minimise J; the x and z of the problem are the solution (collective).

    Args:
        problem: with friction in the plane, for limits that do not depend on the pressure.
        start: initial state.
        level: accuracy of the solution; solves are as accurate as its square.

    Raises:
        LinearSolveFailed: if a state leaves a body unconstrained.
    """
    return _Descent(problem, start, level + 1).run()


def most_solves(qp: BoundQP) -> int:
    """Return the largest number of solves of a descent; collective.

    With k bounds and m nodes it took at most 1.8 (k + m + 1) solves from random states of 12,000
    random problems, and at most k + m + 1 on belts of up to 192 nodes.
    """
    assert qp.friction is not None
    own = qp.bounded.size + qp.friction.normal.size
    return 4 * (int(qp.comm.allreduce(own)) + 1)


@dataclass(frozen=True)
class _Way:
    """The segment from x to the minimum of a state, in shares of its length."""

    slope: float  # of J in this state at x; 0 at the end
    bounds: Floats  # (k,) where unknowns reach their bounds, or inf
    ends: Floats  # (m,) where slips vanish, or inf
    jumps: Floats  # (m,) by which the slope of J increases there

    def least(self, comm: MPI.Comm) -> tuple[float, Bools, Bools]:
        """Minimise J along the segment within the bounds; collective.

        Returns:
            The share of the segment, the nodes (m,) whose slip has changed its sign up to there,
            and those (m,) whose slip vanishes there.
        """
        farthest = min(1.0, -float(maximum(comm, -self.bounds.min(initial=1.0))[0]))
        everywhere = comm.allgather((self.ends, self.jumps))
        ends, jumps = (np.concatenate(parts) for parts in zip(*everywhere, strict=True))
        order = np.argsort(ends, kind="stable")
        order = order[ends[order] < farthest]
        corners = np.concatenate([[0.0], ends[order]])
        # where the slope after each corner, slope (1 - share) + sum of jumps, vanishes
        roots = 1.0 + np.concatenate([[0.0], np.cumsum(jumps[order])]) / self.slope
        reached = np.flatnonzero(roots <= np.append(corners[1:], farthest))
        last = int(reached[0]) if reached.size else order.size
        share = max(corners[last], roots[last]) if reached.size else farthest
        sides, sticks = np.zeros((2, ends.size), dtype=bool)
        sides[order[:last]] = True
        if reached.size and last > 0 and roots[last] < corners[last]:
            sticks[order[last - 1]] = True
        first = sum(part[0].size for part in everywhere[: comm.rank])
        own = slice(first, first + self.ends.size)
        return share, sides[own], sticks[own]


class _Descent:
    """A point within the bounds, and its state."""

    def __init__(self, problem: HeldProblem, start: State, level: int) -> None:
        self.problem, self.qp, self.level = problem, problem.qp, level
        assert problem.qp.friction is not None
        self.law: Friction = problem.qp.friction
        problem.solve(start, level)
        self.x = problem.x.copy()
        bounded = self.qp.bounded
        self.x.array[bounded] = np.clip(self.x.array_r[bounded], *self.qp.bounds)
        slip = self.slip(self.x)
        turned = start.slips(self.law) & (slip != 0.0)
        sides = np.where(turned, np.sign(slip), start.directions[:, 0])
        self.state = State(start.active, sides[:, None], start.stiffness)
        self.z = reaction(self.qp, self.x)

    def slip(self, x: PETSc.Vec) -> Floats:
        """Return x_t - rest (m,)."""
        return np.asarray((self.law.pick(x.array_r) - self.law.rest)[:, 0])

    def run(self) -> Outcome:
        """Descend until the minimum of a state is that of J."""
        problem, most = self.problem, most_solves(self.qp)
        for updates in range(1, most + 1):
            atol = problem.solve(self.state, self.level)
            atol = max(atol, problem.linear.round_off(problem.x))
            if self.advance(atol):
                continue
            if self.release(atol) == 0:
                self.x.copy(problem.x)
                problem.z = self.z
                return Outcome(self.state, updates, "")
        return Outcome(self.state, most, f"friction still changed after {most} solves")

    def advance(self, atol: float) -> bool:
        """Step towards the minimum of the state; tell whether it is not reached; collective."""
        problem, state, bounded = self.problem, self.state, self.qp.bounded
        d = problem.x.copy()
        d.axpy(-1.0, self.x)
        slope = d.dot(problem.z) - d.dot(self.z)  # -d'Ad
        step, turns = d.array_r[bounded], self.law.pick(d.array_r)[:, 0]
        if -slope <= atol * d.norm():  # within the round-off of the forces
            return False
        lower, upper = self.qp.bounds
        side = np.where(step > 0.0, upper, lower)
        distance = np.where(state.active == 0, side - self.x.array_r[bounded], np.inf)
        bounds = np.divide(distance, step, out=np.full_like(step, np.inf), where=step != 0.0)
        against = state.slips(self.law) & (state.directions[:, 0] * turns < 0.0)
        ends = np.divide(-self.slip(self.x), turns, out=np.full_like(turns, np.inf), where=against)
        jumps = 2.0 * self.law.cohesion * np.abs(turns)
        way = _Way(slope, np.maximum(bounds, 0.0), np.maximum(ends, 0.0), jumps)
        share, sides, sticks = way.least(self.qp.comm)
        closes = (state.active == 0) & (way.bounds <= share)
        self.x.axpy(share, d)
        self.x.array[bounded[closes]] = side[closes]
        stuck = self.law.select(sticks)
        stuck.put(self.x.array, stuck.rest)
        self.z = reaction(self.qp, self.x)
        directions = np.where(sides[:, None], -state.directions, state.directions)
        directions[sticks] = 0.0
        active = np.where(closes, np.sign(step), state.active).astype(np.int8)
        self.state = State(active, directions, state.stiffness)
        return share < 1.0

    def release(self, atol: float) -> int:
        """Release bounds with reactions of the wrong sign, and nodes beyond their limit.

        Returns their number; forces up to atol count as zero; collective.
        """
        state, law = self.state, self.law
        pulls = state.active * on_bounded(self.qp, self.x, self.z).z < -atol
        resists = law.pick(self.z.array_r)[:, 0]
        beyond = state.sticks(law)[:, 0] & (np.abs(resists) > law.cohesion + atol)
        sides = np.where(beyond, np.sign(resists), state.directions[:, 0])
        active = np.where(pulls, 0, state.active).astype(np.int8)
        self.state = State(active, sides[:, None], state.stiffness)
        return int(self.qp.comm.allreduce(int(pulls.sum() + beyond.sum())))

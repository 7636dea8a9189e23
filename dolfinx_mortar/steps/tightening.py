# SPDX-License-Identifier: MIT
"""Tightening of bolts: the jump of a tie at which its resultant has a given value.

A bolt is cut by a tie whose sides shall overlap by s along a direction n. Its force F(s) = force.n
is sought at the other loads of the moment: F(s) = F0. Every try is a whole step from the committed
state, so what the path of the tries was leaves no trace in bodies that flow.

F rises with s in all that is stable: s is found by secants, kept between a value that is too small
and one that is too large as soon as both are known. The first try strains one layer of elements
beside the cut about as much as F0 would: n.K_ss n of the tie's nodes is a stiffness that is larger
than that of any bolt, by the number of layers.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.interfaces.tie import Tie
from dolfinx_mortar.steps.failures import AS_BEFORE
from dolfinx_mortar.steps.jumps import diagonal
from dolfinx_mortar.steps.newton import solve_step
from dolfinx_mortar.steps.problem import ContactProblem
from dolfinx_mortar.steps.report import NewtonNotConverged, StepReport
from dolfinx_mortar.steps.residuals import gap_round_off

log = logging.getLogger(__name__)

# Of the force: by so much the steps are solved more accurately than the force is sought.
SHARE_OF_STEPS = 0.1
# A jump grows by no more than this factor from try to try: gaps may close, bodies yield.
GROWTH = 30.0
# A force that stays below this share of what one layer of elements would carry is none.
NOTHING = 1e-6
# Tries in one search that may fail to converge; after each the way is halved.
HALVINGS = 8
# Of the way: jumps that are refused so near to one that converges end the search.
# Measured, plane bolt that yields: 15 to 23 s -> 5 to 8 s, forces less by 0.15 % than those at the
# very end; 0.1 saves no more, 0.02 half as much.
NEAR = 0.05
# Of the diagonal of the model: a longer jump is none of a small strain.
FARTHEST = 0.1


class PreloadNotReached(RuntimeError):
    """A preload that the model does not carry; all is as before.

    Attributes:
        tries: (jump along the direction, force) of the steps that converged.
    """

    def __init__(self, message: str, tries: Sequence[tuple[float, float]]) -> None:
        """Keep what was tried."""
        super().__init__(message)
        self.tries = list(tries)


class Steps:
    """Whole steps from the committed state, at the jumps that ties have."""

    def __init__(self, problem: ContactProblem, rtol: float, options: dict[str, Any]) -> None:
        """Begin at the present state."""
        self.problem, self.options = problem, options | {"rtol": SHARE_OF_STEPS * rtol}
        self.u, self.contacts = problem.u.x.array.copy(), problem.committed.contacts
        self.bolts = 1  # that are sought together
        self.reports: list[StepReport] = []

    def solve(self) -> None:
        """Solve one."""
        self.problem.u.x.array[:] = self.u
        self.problem.committed.contacts = self.contacts
        self.reports.append(solve_step(self.problem, **self.options))


class Search:
    """The search for s of one bolt, along n."""

    def __init__(
        self,
        problem: ContactProblem,
        tie: Tie,
        n: Floats,
        force: float,
        rtol: float,
        steps: Steps,
    ) -> None:
        """Begin at the present jump, which has a part across n that stays."""
        self.problem, self.tie, self.n, self.force, self.rtol = problem, tie, n, force, rtol
        self.steps = steps
        self.across = tie.tightening - (tie.tightening @ n) * n  # of a tightening before
        self.begin = self.jump
        self.layer, self.allowed = 0.0, 0.0
        self.tries: list[tuple[float, float]] = []
        self.refused: dict[float, NewtonNotConverged] = {}  # jumps whose steps do not converge

    @property
    def jump(self) -> float:
        """The present one, along n."""
        return float(self.tie.tightening @ self.n)

    @jump.setter
    def jump(self, s: float) -> None:
        self.tie.tightening = self.across + s * self.n

    @property
    def miss(self) -> float:
        """Force of the last step less what is wanted."""
        return float(self.tie.force @ self.n) - self.force

    def run(self, max_it: int) -> None:
        """Go to the first try that is near enough."""
        miss = self.measure(self.begin, self.begin)[1]
        self.allow(miss)
        self.go_on(miss, max_it)

    def allow(self, miss: float) -> None:
        """Set by how much the force may be missed at the end, by how much it is at first."""
        self.layer = layer_stiffness(self.problem, self.tie, self.n)
        self.allowed = self.rtol * max(abs(self.force), abs(miss + self.force))
        self.allowed += self.layer * gap_round_off(self.problem.u)

    def go_on(self, miss: float, max_it: int) -> None:
        """Try until near enough, from the jump where one is and what is missed there.

        Secants; when s is between two tries, the value of the end that stays counts half as much
        each time (Illinois), so that both ends move.
        """
        a = b = self.begin
        miss_a = miss_b = miss
        limit = farthest(self.problem)
        while abs(miss_b) > self.allowed:
            if len(self.steps.reports) >= max_it * self.steps.bolts:
                each = " for each bolt" if self.steps.bolts > 1 else ""
                raise self.failure(f"it is not found in max_it={max_it} steps{each}")
            if abs(b - self.begin) >= limit and miss_a * miss_b > 0.0:
                raise self.failure(self.describe_resistance(self.layer))
            s, miss = self.measure(self.propose(a, miss_a, b, miss_b, self.layer, limit), b)
            if miss * miss_b < 0.0 or miss_a * miss_b > 0.0:
                a, miss_a = b, miss_b
            else:
                miss_a *= 0.5
            b, miss_b = s, miss

    def propose(
        self, a: float, miss_a: float, b: float, miss_b: float, layer: float, limit: float
    ) -> float:
        """Return the next s after b; a is the try before, or the other side of the solution.

        Raises:
            PreloadNotReached: if the force lies beyond what is refused, which is near.
        """
        if a == b:
            return b + float(np.clip(-miss_b / layer, -limit, limit))
        slope = (miss_b - miss_a) / (b - a)
        if miss_a * miss_b < 0.0:
            return b - miss_b / slope
        way = b - self.begin
        step = GROWTH * way  # forward, however little resists
        if slope > NOTHING * layer and abs(miss_b / slope) < abs(step):
            step = -miss_b / slope
        s = self.begin + float(np.clip(way + step, -limit, limit))
        beyond = [one for one in self.refused if (one - b) * way > 0.0]
        if not beyond:
            return s
        end = min(beyond, key=lambda one: abs(one - b))
        half = (b + end) / 2.0
        if abs(s - b) < abs(half - b):
            return s
        if self.is_near(end, b):
            raise self.refusal(end) from self.refused[end]
        return half

    def is_near(self, refused: float, good: float) -> bool:
        """Return whether what lies between two jumps is not worth a step."""
        return abs(refused - good) <= NEAR * abs(refused - self.begin)

    def measure(self, s: float, good: float) -> tuple[float, float]:
        """Solve steps from the committed state with the jump s, or halfway to a good one.

        Returns:
            The jump whose step has converged, and the force less what is wanted.

        Raises:
            PreloadNotReached: if none does.
        """
        proposed = s
        while True:
            try:
                return s, self.solve(s)
            except NewtonNotConverged as error:
                self.refused[s] = error
                near = s != proposed and self.is_near(s, good)
                if s == good or near or len(self.refused) > HALVINGS:
                    raise self.refusal(s) from error
                s = (s + good) / 2.0

    def solve(self, s: float) -> float:
        """Solve a step with the jump s; return the force less what is wanted."""
        self.jump = s
        self.steps.solve()
        self.tries.append((s, self.miss + self.force))
        if self.problem.comm.rank == 0:
            log.info("preload: jump %g, force %g of %g", *self.tries[-1], self.force)
        return self.miss

    # -- what is said of failures ----------------------------------------------------------------

    def describe_resistance(self, layer: float) -> str:
        """Say why the force stays away although the jump is large."""
        jumps, forces = np.array(self.tries).T
        if np.abs(forces - forces[0]).max() <= NOTHING * layer * np.abs(jumps - jumps[0]).max():
            return (
                "nothing resists: supports, ties or contacts have to hold both ends of the bolt "
                "against the direction, which points out of the slave side for tension"
            )
        flows = bool(self.problem.solid.state)  # elastic bodies have none, and no hardening
        flow = "bodies flow (then give less force, or the law hardening), " if flows else ""
        return (
            f"a jump of {jumps[-1]:.4g}, {FARTHEST:.0%} of the model's diagonal away from "
            "the first, is too little, and the search ends there: the force is more than the "
            f"bolt's stiffness gives (check units, of force and stiffness), {flow}or sides let go"
        )

    def refusal(self, s: float) -> PreloadNotReached:
        """Return the error of a step that does not converge."""
        cause = self.refused[s].message.removesuffix(AS_BEFORE)
        return self.failure(
            f"the step to a jump of {s:.4g} does not converge ({cause}). Where smaller steps help, "
            "tighten in parts, by calls with rising forces"
        )

    def failure(self, why: str) -> PreloadNotReached:
        """Return the error, with what was reached."""
        along = ", ".join(f"{x:.4g}" for x in self.n)
        told = "no step has converged"
        if self.tries:
            s, force = min(self.tries, key=lambda one: abs(one[1] - self.force))
            told = f"nearest was {force:.6g} with a jump of {s:.4g}"
        return PreloadNotReached(
            f"force {self.force:g} along the direction [{along}] of {self.tie}: {why}; {told}. "
            "Displacement, jump and committed state are as before",
            self.tries,
        )


class Together:
    """The search for the jumps of several bolts, each of which changes the forces of the others.

    Pass by pass every bolt that is off is brought to its force while the jumps of the others stay.
    Tightening one lets its neighbours go, and on a soft gasket that takes many passes. But the last
    two tries of a bolt tell what its jump does to all forces, a column of dF/ds; so after a pass
    all jumps move at once by Newton's method, with the matrix updated from step to step (Broyden
    1965), for as long as that halves what is missed.

    Args:
        searches: one for each bolt; all have the same steps.
        tell: shows a line; on all ranks.
    """

    def __init__(self, searches: Sequence[Search], tell: Callable[[str], None]) -> None:
        """Know nothing yet."""
        self.searches, self.tell = searches, tell
        self.steps, self.comm = searches[0].steps, searches[0].problem.comm
        self.jumps, self.missed = np.zeros((2, len(searches)))
        self.slopes: Floats = np.zeros((len(searches), len(searches)))  # dF_i / ds_j

    def run(self, max_it: int) -> None:
        """Go to jumps at which all forces are near enough, in so many steps for each bolt."""
        self.steps.bolts = len(self.searches)
        self.searches[0].measure(self.searches[0].begin, self.searches[0].begin)
        self.note()
        for search in self.searches:
            search.allow(search.miss)
        self.slopes = np.diag([search.layer for search in self.searches])
        while self.off().max() > 1.0:
            self.one_by_one(max_it)
            while self.off().max() > 1.0 and self.may_go_on(max_it) and self.at_once():
                pass

    def off(self) -> Floats:
        """Return what is missed (bolts,), in parts of what may be missed."""
        return np.abs(self.missed) / np.array([search.allowed for search in self.searches])

    def may_go_on(self, max_it: int) -> bool:
        """Return whether there are steps left."""
        return len(self.steps.reports) < max_it * self.steps.bolts

    def one_by_one(self, max_it: int) -> None:
        """Bring every bolt that is off to its force, which tells a column of the slopes."""
        for k, search in enumerate(self.searches):
            if self.off()[k] <= 1.0:
                continue
            search.begin, search.refused = self.jumps[k], {}
            search.go_on(self.missed[k], max_it)
            jump, missed = self.jumps[k], self.missed
            self.note()
            self.slopes[:, k] = (self.missed - missed) / (self.jumps[k] - jump)

    def at_once(self) -> bool:
        """Move all jumps by a Newton step; return whether another one is worth it."""
        step = self.comm.bcast(-np.linalg.lstsq(self.slopes, self.missed)[0])
        if not 0.0 < np.abs(step).max() <= farthest(self.searches[0].problem):
            return False
        jumps, missed, worst = self.jumps, self.missed, self.off().max()
        self.set(jumps + step)
        try:
            self.steps.solve()
        except NewtonNotConverged:
            self.set(jumps)
            return False
        self.note()
        change = self.missed - missed
        self.slopes += np.outer(change - self.slopes @ step, step) / (step @ step)
        if self.off().max() >= worst:
            self.set(jumps)
            self.jumps, self.missed = jumps, missed
            return False
        return bool(self.off().max() < worst / 2.0)

    def set(self, jumps: Floats) -> None:
        """Give the ties jumps."""
        for search, jump in zip(self.searches, jumps, strict=True):
            search.jump = float(jump)

    def note(self) -> None:
        """Take the jumps and what the last step has missed, and tell how far it has come."""
        self.jumps = np.array([search.jump for search in self.searches])
        self.missed = np.array([search.miss for search in self.searches])
        for search, jump, miss in zip(self.searches, self.jumps, self.missed, strict=True):
            search.tries.append((float(jump), float(miss) + search.force))
        reached = " ".join(f"{search.tries[-1][1]:.4g}" for search in self.searches)
        wanted = " ".join(f"{search.force:.4g}" for search in self.searches)
        self.tell(f"preload, step {len(self.steps.reports)}: forces {reached} of {wanted}")


def layer_stiffness(problem: ContactProblem, tie: Tie, n: Floats) -> float:
    """Return the diagonal of n.K n summed over a tie's slave nodes; collective."""
    problem.solid.assemble_tangent(problem.K)  # the next step assembles its own
    problem.loads.add_tangent(problem.K)
    stiffness = problem.K.getDiagonal().array_r.reshape(-1, problem.d)
    local = float((stiffness[problem.system.link(tie).nodes] * n**2).sum())
    return float(problem.comm.allreduce(local, op=MPI.SUM))


def farthest(problem: ContactProblem) -> float:
    """Return how far a jump may go, a share of the diagonal of the model; collective."""
    return FARTHEST * diagonal(problem.V)

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
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx_mortar.algebra.parallel import any_rank
from dolfinx_mortar.arguments import as_numbers, is_number
from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.interfaces.tie import Tie
from dolfinx_mortar.steps.checks import (
    check_controls,
    check_owned,
    check_problem,
)
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
# Against the outward normal of the slave side, cosine: a direction that points into the body.
AGAINST = -0.5
# Along it, cosine: less is shear rather than tension. Cuts at 60 degrees to the axis are above.
ALONG = 0.45
# Mean of the unit normals of a side, length: a shorter one is that of a side around a shank.
AROUND = 0.1
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


@dataclass(frozen=True)
class Preload:
    """A tightened bolt."""

    jump: Floats  # (d,) the tie's tightening, which stays
    force: float  # reached, along the direction
    iterations: int  # steps solved
    reports: list[StepReport] = field(default_factory=list, repr=False)  # of these steps

    @property
    def report(self) -> StepReport:
        """The report of the step that is committed."""
        return self.reports[-1]


class PreloadNotReached(RuntimeError):
    """A preload that the model does not carry; all is as before.

    Attributes:
        tries: (jump along the direction, force) of the steps that converged.
    """

    def __init__(self, message: str, tries: Sequence[tuple[float, float]]) -> None:
        """Keep what was tried."""
        super().__init__(message)
        self.tries = list(tries)


def preload(
    problem: ContactProblem,
    tie: Tie,
    force: float,
    direction: Sequence[float] | Floats,
    *,
    rtol: float = 1e-6,
    max_it: int = 30,
    qp: str = "active-set",
) -> Preload:
    """Tighten a bolt that is cut by a tie until its force is reached; commit the step; collective.

    Find s so that with the jump ``tie.jump + s n`` the resultant on the slave side has the part
    ``tie.force @ n == force`` along the unit vector n of the direction, under the present loads and
    supports. For a bolt n points out of the slave side, into the master side: then the sides
    overlap by s, as if the shank were shorter by that, and a positive force is tension. s n is kept
    in ``tie.tightening``, so that later steps hold the jump while the force follows the loads. A
    tie that has been tightened before is tightened, or loosened, from where it is; several bolts
    are tightened one after the other, which changes the forces of those before.

    Args:
        problem: bodies and constraints; loads and supports are read at every try.
        tie: one of its ties.
        force: resultant in force units, of the part of the bolt that is modelled: of half a bolt on
            a plane of symmetry, give half the force. Negative: the sides are pushed apart.
        direction: d numbers, of any length.
        rtol: tolerance of the force, relative to it, or to the force before if that is larger.
        max_it: largest number of steps.
        qp: as in `newton`.

    Returns:
        Jump, force and reports. The step is committed, as those of `load_steps` are; the level and
        the history of these stay as they are.

    Raises:
        ValueError: for arguments that make no sense, on all ranks.
        PreloadNotReached: if the model does not carry the force: nothing resists, the direction is
            wrong, bodies flow or let go, or steps do not converge. Displacement, results, jump and
            committed state are then as before.
    """
    check_problem(problem, ContactProblem)
    problem.check_ranks(tie=tie, force=force, direction=direction, rtol=rtol, max_it=max_it, qp=qp)
    check_controls(qp, rtol, max_it)
    n = _check(problem, tie, force, direction)
    with _all_as_before(problem, tie):
        search = _Search(problem, tie, n, float(force), rtol, {"qp": qp, "max_it": 50})
        found = search.run(max_it)
    problem.commit()
    return found


def _check(problem: ContactProblem, tie: Any, force: Any, direction: Any) -> Floats:
    """Return the unit vector of the direction if all arguments make sense; collective."""
    other = not any(tie is one for one in problem.ties)
    if any_rank(problem.comm, other)[0]:
        raise ValueError(f"tie is {tie!r}: give one of problem.ties")
    check_owned(problem.interfaces, problem.supports)
    given = direction.tolist() if isinstance(direction, np.ndarray) else direction
    if not is_number(force):
        raise ValueError(f"force is {force!r}: give a finite number, the resultant of the bolt")
    numbers = as_numbers(given)
    n = np.zeros(0) if numbers is None else numbers
    if n.shape != (problem.d,) or not np.isfinite(n).all() or not n.any():
        raise ValueError(
            f"direction is {direction!r}: give {problem.d} finite components, not all zero, along "
            "the axis of the bolt"
        )
    n = n / np.abs(n).max()  # squares of very large or small components are none
    n = n / np.linalg.norm(n)
    _check_side(problem, tie, direction, n)
    return n


def _check_side(problem: ContactProblem, tie: Tie, direction: Any, n: Floats) -> None:
    """Raise an error where n points into the slave side, warn where it runs along it; collective.

    A side around a shank has no direction of its own.
    """
    normal = _outward(problem, tie)
    cosine = float(n @ normal)
    if cosine < AGAINST:
        raise ValueError(
            f"direction is {direction!r}, which points from the master side into the slave side: "
            "turn it round (out of the slave side) for tension; to push the sides apart, give a "
            "negative force then"
        )
    if cosine < ALONG and normal.any() and problem.comm.rank == 0:
        shown = np.round([cosine, *normal], 3) + 0.0  # no -0
        outward = ", ".join(f"{x:g}" for x in shown[1:])
        log.warning(
            "direction is %r, whose cosine with the normal [%s] out of the slave side of %s is "
            "%g: the sides slip along each other rather than overlap, and the force is shear. "
            "For tension give the axis of the bolt, out of the slave side",
            direction,
            outward,
            tie,
            shown[0],
        )


def _outward(problem: ContactProblem, tie: Tie) -> Floats:
    """Return the mean outward unit normal (d,) of the slave side, or 0; collective."""
    problem.audit()  # the sides have to be paired
    coupling = problem.system.link(tie).coupling
    weight = coupling.weight.max(axis=1, initial=0.0)[:, None]
    total = problem.comm.allreduce((weight * coupling.normals).sum(axis=0), op=MPI.SUM)
    length, area = float(np.linalg.norm(total)), problem.comm.allreduce(weight.sum(), op=MPI.SUM)
    return np.asarray(total / length if length > AROUND * area else 0.0 * total)


@contextmanager
def _all_as_before(problem: ContactProblem, tie: Tie) -> Iterator[None]:
    """Put displacement, results, tightening and contact set back if something fails."""
    u, shown, contacts = problem.u.x.array.copy(), problem.solid.keep(), problem.committed.contacts
    tightening, supports = tie.tightening, problem.committed.supports
    results = [(one, one.keep()) for one in problem.interfaces]
    try:
        yield
    except BaseException:
        problem.u.x.array[:] = u
        problem.solid.put_back(shown)
        problem.committed.contacts, problem.committed.supports = contacts, supports
        tie.tightening = tightening
        for one, kept in results:
            one.put_back(kept)
        raise


class _Search:
    """The search for s, along n."""

    def __init__(
        self,
        problem: ContactProblem,
        tie: Tie,
        n: Floats,
        force: float,
        rtol: float,
        options: dict[str, Any],
    ) -> None:
        self.problem, self.tie, self.n, self.force, self.rtol = problem, tie, n, force, rtol
        self.options = options | {"rtol": SHARE_OF_STEPS * rtol}
        self.across = tie.tightening - (tie.tightening @ n) * n  # of a tightening before
        self.begin = float(tie.tightening @ n)
        self.u, self.contacts = problem.u.x.array.copy(), problem.committed.contacts
        self.tries: list[tuple[float, float]] = []
        self.reports: list[StepReport] = []
        self.refused: dict[float, NewtonNotConverged] = {}  # jumps whose steps do not converge

    def run(self, max_it: int) -> Preload:
        """Return the first try that is near enough.

        Secants; when s is between two tries, the value of the end that stays counts half as much
        each time (Illinois), so that both ends move.
        """
        a, b = self.begin, self.begin
        miss_a = miss_b = self.measure(b, b)[1]
        layer = layer_stiffness(self.problem, self.tie, self.n)
        limit = FARTHEST * diagonal(self.problem.V)
        allowed = self.rtol * max(abs(self.force), abs(miss_b + self.force))
        allowed += layer * gap_round_off(self.problem.u)
        while abs(miss_b) > allowed:
            if len(self.reports) >= max_it:
                raise self.failure(f"it is not found in max_it={max_it} steps")
            if abs(b - self.begin) >= limit and miss_a * miss_b > 0.0:
                raise self.failure(self.describe_resistance(layer))
            s, miss = self.measure(self.propose(a, miss_a, b, miss_b, layer, limit), b)
            if miss * miss_b < 0.0 or miss_a * miss_b > 0.0:
                a, miss_a = b, miss_b
            else:
                miss_a *= 0.5
            b, miss_b = s, miss
        force = miss_b + self.force
        return Preload(self.tie.tightening.copy(), force, len(self.reports), self.reports)

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
        problem = self.problem
        problem.u.x.array[:] = self.u
        problem.committed.contacts = self.contacts
        self.tie.tightening = self.across + s * self.n
        self.reports.append(solve_step(problem, **self.options))
        force = float(self.tie.force @ self.n)
        self.tries.append((s, force))
        if problem.comm.rank == 0:
            log.info("preload: jump %g, force %g of %g", s, force, self.force)
        return force - self.force

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


def layer_stiffness(problem: ContactProblem, tie: Tie, n: Floats) -> float:
    """Return the diagonal of n.K n summed over a tie's slave nodes; collective."""
    problem.solid.assemble_tangent(problem.K)  # the next step assembles its own
    problem.loads.add_tangent(problem.K)
    diagonal = problem.K.getDiagonal().array_r.reshape(-1, problem.d)
    local = float((diagonal[problem.system.link(tie).nodes] * n**2).sum())
    return float(problem.comm.allreduce(local, op=MPI.SUM))

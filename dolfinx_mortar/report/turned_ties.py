# SPDX-License-Identifier: MIT
"""Ties of bodies after large rotations: errors of what is linear in them, or fixed in space.

A tie is an equation linear in u with the matrices of X. A jump b, and the overlap of a bolt with
it, is a given vector: where bodies turn by a rotation R it should be R b, and is off by |R b - b|.
A distance r of the sides at X should become R r. With ``surface="smooth"`` it moves by omega x r,
omega the mean rotation, which leaves out
|R r - r - sin(a) n x r| = (1 - cos a) |r| across the axis n; with "facets" it does not turn at all.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np

from dolfinx_mortar.algebra.parallel import any_rank, maximum
from dolfinx_mortar.arrays import QUARTER_OF_DIGITS, Floats
from dolfinx_mortar.geometry.turning import RigidMotion, best_motion, rigid_sums
from dolfinx_mortar.interfaces.interface import ask
from dolfinx_mortar.interfaces.link import Link
from dolfinx_mortar.interfaces.tie import Tie
from dolfinx_mortar.mortar.integrals import point_distances
from dolfinx_mortar.persistence.committed import Turns
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.report.small_strain import LARGEST_SHARE


@dataclass(frozen=True)
class TurnedTie:
    """A tie at the end of a step at finite strain."""

    tie: Tie
    link: Link
    R: Floats  # (d, d) rotation of the slave side since X
    jump: Floats | None  # (n, d) at the owned slave nodes, with the tightening
    longest: float  # of the jumps on all ranks
    turns: Turns | None  # None without a jump


def find_turned_ties(problem: ContactProblem) -> list[TurnedTie | None]:
    """Return how far the sides of ties have turned, None for other interfaces; collective.

    At finite strain only: at small strain all is linear in rotations, which has notes of its own.
    """
    if problem.solid.strain != "finite":
        return [None] * len(problem.interfaces)
    before = problem.committed.turns or [None] * len(problem.interfaces)
    return [
        _turned_tie(problem, interface, last) if isinstance(interface, Tie) else None
        for interface, last in zip(problem.interfaces, before, strict=True)
    ]


def _turned_tie(problem: ContactProblem, tie: Tie, last: Turns | None) -> TurnedTie:
    """Return it, with the rotation since when its jump has had its direction; collective.

    A user may turn a jump from step to step, as told.
    """
    link = problem.system.link(tie)
    R = _turned(problem, link)
    jump = ask(problem.comm, tie, "apart_at", problem.solid.V, link.nodes)
    lengths = np.zeros(0) if jump is None else np.linalg.norm(jump, axis=1)
    longest = float(maximum(problem.comm, lengths.max(initial=0.0))[0])
    if jump is None or not longest:
        return TurnedTie(tie, link, R, None, 0.0, None)
    along, since = jump / longest, np.eye(problem.d)
    if last is not None:
        differs = np.abs(along - last.along).max(initial=0.0) > QUARTER_OF_DIGITS
        if not any_rank(problem.comm, differs)[0]:
            return TurnedTie(tie, link, R, jump, longest, last)
    if problem.committed.begun:
        since = R
    turns = Turns(along, np.broadcast_to(since, (len(jump), *R.shape)))
    return TurnedTie(tie, link, R, jump, longest, turns)


def notes_on_turned_ties(problem: ContactProblem, ties: Sequence[TurnedTie | None]) -> list[str]:
    """Return notes on jumps and distances of ties that do not turn with the bodies; collective."""
    notes = []
    for at in ties:
        if at is not None:
            found = _note_on_jump(problem, at), _note_on_distance(problem, at.tie, at.link, at.R)
            notes += [note for note in found if note]
    return notes


def _note_on_jump(problem: ContactProblem, at: TurnedTie) -> str:
    """Return a note on a jump that has kept its direction while the side has turned; collective."""
    if at.turns is None or at.jump is None:
        return ""
    turned = np.einsum("ab,ncb->nac", at.R, at.turns.since)  # R R_0^T
    moved = np.linalg.norm(np.einsum("nab,nb->na", turned, at.jump) - at.jump, axis=1)
    angles = [_angle(one) for one in turned[:1]]  # the same at all nodes
    off, angle = maximum(problem.comm, moved.max(initial=0.0), max(angles, default=0.0))
    if off <= LARGEST_SHARE * at.longest:
        return ""
    return (
        f"{at.tie}: its jump, with the tightening, is up to {at.longest:.3g} long and has kept its "
        f"direction, but its sides have turned by {np.degrees(angle):.0f} degrees: the jump is "
        f"wrong by up to {off:.3g}, so that bolts lose force. Rotate it with the sides: in each "
        "step, for example by on_time=, set tie.jump, tie.tightening and tie.direction to R times "
        "their values before any rotation, where R is the rotation at the end of the step"
    )


def _note_on_distance(problem: ContactProblem, tie: Tie, link: Link, R: Floats) -> str:
    """Return a note on sides that are apart at X, and have turned far; collective."""
    angle, smooth = _angle(R), tie.smooth
    off = 1 - np.cos(angle) if smooth else 2 * np.sin(angle / 2)
    if off <= LARGEST_SHARE / 10:  # whatever a tie may reach
        return ""
    pairing, segments = link.mortar[0], link.mortar[1].segments
    distances, larger = point_distances(pairing, segments, None)
    apart, share = maximum(
        problem.comm, distances.max(initial=0.0), (distances / larger).max(initial=0.0)
    )
    if off * share <= LARGEST_SHARE:
        return ""
    remedy = "finer facets" if smooth else "surface='smooth', finer facets"
    return (
        f"{tie}: its sides are up to {apart:.3g} apart at X and have turned by "
        f"{np.degrees(angle):.0f} degrees, but the vectors between them "
        f"{'turn as by small rotations' if smooth else 'do not turn'}: they are wrong by up to "
        f"{off * apart:.3g}, {off * share:.0%} of a facet. Take sides that fit, {remedy}, or mesh "
        "the bodies nearer to their final position"
    )


def _angle(R: Floats) -> float:
    """Return the angle of a rotation (d, d) in radians."""
    return float(np.radians(RigidMotion(R, np.zeros(len(R))).angle()))


def _turned(problem: ContactProblem, link: Link) -> Floats:
    """Return the rotation (d, d) of the slave side since X; collective."""
    x = problem.X[link.nodes]
    origin = problem.X.mean(axis=0) if len(problem.X) else np.zeros(problem.d)
    origin = problem.comm.bcast(origin)
    moved = x + problem.owned_u.reshape(problem.X.shape)[link.nodes]
    sums = problem.comm.allreduce(rigid_sums(x - origin, moved - origin), op=MPI.SUM)
    if sums[0, 0] < 2:  # a point does not turn
        return np.eye(problem.d)
    return best_motion(sums).R

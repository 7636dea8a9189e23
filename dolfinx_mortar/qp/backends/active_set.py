# SPDX-License-Identifier: MIT
"""Primal-dual active set: semi-smooth Newton on z = max(0, z + c (x - upper)) and its mirror image.

Where the bounded unknowns are few, `condensed` finds the set first, and what follows here checks
it. Otherwise the updates below do the work: early ones are solved loosely, the last one tightly. A
set that comes back although solves are tight is a cycle; then the interior point takes over.
"""

from hashlib import blake2b

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.arrays import Actives, Ints
from dolfinx_mortar.qp import condensed
from dolfinx_mortar.qp.backends import interior_point
from dolfinx_mortar.qp.bound_qp import BoundQP, QPNotSolved, QPSolution, check, classify, reaction
from dolfinx_mortar.qp.linear import LinearSolveFailed, LinearSolver

MAX_SOLVES = 80
# Loose tolerance while the set still moves, and its reduction once it stays.
LOOSE, TIGHTEN = 1e-2, 1e-2
# Reactions at the bounds as a share of all forces, before they are known.
FIRST = 0.1
# To be tighter than this, it is cheaper to predict the set alone and to factorise with it held.
PREDICTED, TIGHT = 1e-3, 1e-6
FINEST = 1e-14


def solve(
    qp: BoundQP, linear: LinearSolver, *, start: Actives, rtol: float, settled: bool = False
) -> QPSolution:
    """Solve a bound-constrained QP by active-set updates (collective).

    Args:
        qp: the problem.
        linear: linear solver, attached to qp.A.
        start: (k,) first active set.
        rtol: tolerance of the last linear solve relative to the forces.
        settled: the first set is expected to be the right one up to a few unknowns: hold it and
            check, which takes one or two solves.

    Returns:
        The solution; its active set is one that solved the linear system, so that weakly active
        unknowns may be on either side.

    Raises:
        QPNotSolved: if the interior point, called after a cycle or a failed solve, fails too.
    """
    x = qp.b.duplicate()
    x.set(0.0)
    try:
        if condensed.is_worthwhile(qp, linear):
            if not settled:
                loose = rtol if rtol > TIGHT else PREDICTED
                start = condensed.predict(qp, linear, x, start, rtol=loose)
            solution = _update(qp, linear, x, start, rtol, loose=rtol)
        else:
            solution = _update(qp, linear, x, start, rtol, loose=LOOSE)
        if solution is not None:
            return solution
        reason = "the active set came back to an earlier one"
    except LinearSolveFailed as error:
        reason = f"an active set could not be solved ({error})"
    return _hand_over(qp, linear, start, rtol, reason)


def _hand_over(
    qp: BoundQP, linear: LinearSolver, start: Actives, rtol: float, reason: str
) -> QPSolution:
    """Let the interior point finish, and say so."""
    try:
        solution = interior_point.solve(qp, linear, start=start, rtol=rtol)
    except (LinearSolveFailed, PETSc.Error) as error:
        raise QPNotSolved(
            f"Active set: {reason}. The interior point failed as well ({error}). "
            "Most often a body can float away: add a support or a load that closes the contact."
        ) from error
    solution.note = f"handed to the interior point: {reason}. {solution.note}".strip()
    return solution


def _update(
    qp: BoundQP, linear: LinearSolver, x: PETSc.Vec, active: Actives, rtol: float, *, loose: float
) -> QPSolution | None:
    """Update the set until it stays; return None for a cycle.

    Early solves are accurate to a share of the reactions at the bounds, which is all that the next
    set is read from; the last one to ``rtol`` of all forces.
    """
    lower, upper = qp.bounds()
    seen: set[int] = set()
    z = reaction(qp, x)
    tolerance, b_norm = max(loose, rtol), qp.b.norm()
    force, held_force, updates = max(b_norm, z.norm()), 0.0, 1
    for number in range(MAX_SOLVES):
        held = active != 0
        x.array[qp.bounded[held]] = np.where(active > 0, upper, lower)[held]
        if number == 0:
            force = max(force, reaction(qp, x).norm())
        fixed = np.sort(qp.bounded[held])
        # nothing is known of the reactions at first
        scale = held_force if number > 0 else FIRST * force
        final = rtol * force
        atol = max(final, min(tolerance * scale, force))
        linear.solve(qp.b, x, fixed, atol=0.5 * atol)
        z = reaction(qp, x)
        held_force = _held_norm(z, fixed)
        force = max(b_norm, held_force)
        if atol > max(final, 2.0 * tolerance * held_force):
            continue
        new = classify(qp, x, z)
        differ = _differ(qp, x, z, active, new, atol=max(atol, linear.round_off(x)))
        if not differ and atol <= final:
            kkt = check(qp, x, z)
            if kkt.satisfied(rtol) or rtol <= FINEST:
                return QPSolution(x, z, active, kkt, updates, 0, 0, "active-set")
            # A small step under large forces: what is weak to the forces is not to the step.
            rtol, active = max(FINEST, TIGHTEN * rtol), new
            tolerance = min(tolerance, rtol)
            continue
        if not differ:  # look once more before the last solve
            tolerance = TIGHTEN * tolerance if tolerance >= LOOSE else 0.0
            continue
        if _came_back(qp, new, seen):
            if atol <= final:
                return None
            seen.clear()
            tolerance *= TIGHTEN
        active, updates = new, updates + 1
    return None


def _held_norm(z: PETSc.Vec, fixed: Ints) -> float:
    """Return the norm of the reactions of held unknowns."""
    zb = z.array_r[fixed]
    return float(np.sqrt(z.comm.tompi4py().allreduce(zb @ zb)))


def _differ(
    qp: BoundQP,
    x: PETSc.Vec,
    z: PETSc.Vec,
    active: Actives,
    new: Actives,
    *,
    atol: float,
) -> bool:
    """Tell whether two sets differ by more than weakly active unknowns.

    An unknown is weakly active if its reaction and its distance to the bound, times the stiffness,
    are both below the accuracy of the forces: then either side is right.
    """
    lower, upper = qp.bounds()
    side = np.where((active > 0) | (new > 0), upper, lower)
    side = np.where(np.isfinite(side), side, x.array_r[qp.bounded])
    c = qp.A.getDiagonal().array_r[qp.bounded]
    strength = np.abs(z.array_r[qp.bounded]) + c * np.abs(x.array_r[qp.bounded] - side)
    strong = (active != new) & (strength > atol)
    return bool(qp.comm.allreduce(int(strong.sum())))


def _came_back(qp: BoundQP, active: Actives, seen: set[int]) -> bool:
    """Tell whether this set, over all ranks, was there before; one number travels."""
    part = blake2b(active.tobytes(), digest_size=7, salt=str(qp.comm.rank).encode())
    everywhere = qp.comm.allreduce(int.from_bytes(part.digest()), op=MPI.SUM)
    known = everywhere in seen
    seen.add(everywhere)
    return known

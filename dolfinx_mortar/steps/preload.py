# SPDX-License-Identifier: MIT
"""Tightening of bolts: the jumps of ties at which their resultants have given values."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, overload

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
from dolfinx_mortar.steps.problem import ContactProblem
from dolfinx_mortar.steps.progress import lines
from dolfinx_mortar.steps.report import StepReport
from dolfinx_mortar.steps.tightening import Search, Steps, Together

log = logging.getLogger(__name__)

# Against the outward normal of the slave side, cosine: a direction that points into the body.
AGAINST = -0.5
# Along it, cosine: less is shear rather than tension. Cuts at 60 degrees to the axis are above.
ALONG = 0.45
# Mean of the unit normals of a side, length: a shorter one is that of a side around a shank.
AROUND = 0.1


@dataclass(frozen=True)
class Preload:
    """A tightened bolt."""

    jump: Floats  # (d,) the tie's tightening, which stays
    force: float  # reached, along the direction
    iterations: int  # steps solved, for all bolts that are tightened together
    reports: list[StepReport] = field(default_factory=list, repr=False)  # of these steps

    @property
    def report(self) -> StepReport:
        """The report of the step that is committed."""
        return self.reports[-1]


Direction = Sequence[float] | Floats


@overload
def preload(
    problem: ContactProblem,
    tie: Tie,
    force: float,
    direction: Direction,
    *,
    rtol: float = 1e-6,
    max_it: int = 30,
    qp: str = "active-set",
    progress: bool | None = None,
) -> Preload: ...


@overload
def preload(
    problem: ContactProblem,
    tie: Mapping[Tie, float],
    *,
    direction: Direction | Mapping[Tie, Direction],
    rtol: float = 1e-6,
    max_it: int = 30,
    qp: str = "active-set",
    progress: bool | None = None,
) -> dict[Tie, Preload]: ...


def preload(
    problem: ContactProblem,
    tie: Any,
    force: Any = None,
    direction: Any = None,
    *,
    rtol: float = 1e-6,
    max_it: int = 30,
    qp: str = "active-set",
    progress: bool | None = None,
) -> Any:
    """Tighten bolts that are cut by ties until their forces are reached; commit; collective.

        preload(problem, bolt, 37e3, [0, 0, -1])
        preload(problem, {left: 37e3, right: 37e3}, direction=[0, 0, -1])

    Find s so that with the jump ``tie.jump + s n`` the resultant on the slave side has the part
    ``tie.force @ n == force`` along the unit vector n of the direction, under the present loads and
    supports. For a bolt n points out of the slave side, into the master side: then the sides
    overlap by s, as if the shank were shorter by that, and a positive force is tension. s n is kept
    in ``tie.tightening``, so that later steps hold the jump while the force follows the loads. A
    tie that has been tightened before is tightened, or loosened, from where it is. Bolts in a
    dictionary have their forces all together at the end; those that are tightened by calls of their
    own change the forces of those before.

    Args:
        problem: bodies and constraints; loads and supports are read at every try.
        tie: one of its ties, or several with their forces.
        force: resultant in force units, of the part of the bolt that is modelled: of half a bolt on
            a plane of symmetry, give half the force. Negative: the sides are pushed apart.
        direction: d numbers, of any length; of several bolts, for all of them or by tie.
        rtol: tolerance of each force, relative to it, or to the force before if that is larger.
        max_it: largest number of steps, for each bolt.
        qp: as in `newton`.
        progress: show a line for each change of several bolts; None does as in `load_steps`.

    Returns:
        Jump, force and reports; of several bolts by tie. The step is committed, as those of
        `load_steps` are; the level and the history of these stay as they are.

    Raises:
        ValueError: for arguments that make no sense, on all ranks.
        PreloadNotReached: if the model does not carry a force: nothing resists, the direction is
            wrong, bodies flow or let go, or steps do not converge. Displacement, results, jumps and
            committed state are then as before.
    """
    check_problem(problem, ContactProblem)
    several = isinstance(tie, Mapping)
    asked = _by_tie(tie, force, direction) if several else ([tie], [force], [direction])
    ties, forces, directions = asked
    given = asked if several else (tie, force, direction)
    named = dict(zip(("tie", "force", "direction"), given, strict=True))
    problem.check_ranks(**named, rtol=rtol, max_it=max_it, qp=qp)
    check_controls(qp, rtol, max_it)
    normals = [_check(problem, *one) for one in zip(ties, forces, directions, strict=True)]
    tell = lines(problem.comm, progress)
    with _all_as_before(problem, ties):
        steps = Steps(problem, rtol, {"qp": qp, "max_it": 50})
        searches = [
            Search(problem, one, n, float(wanted), rtol, steps)
            for one, n, wanted in zip(ties, normals, forces, strict=True)
        ]
        if several:
            Together(searches, tell).run(max_it)
        else:
            searches[0].run(max_it)
    problem.commit()
    found = {
        one: Preload(one.tightening.copy(), float(one.force @ n), len(steps.reports), steps.reports)
        for one, n in zip(ties, normals, strict=True)
    }
    return found if several else found[tie]


def _by_tie(forces: Mapping[Any, Any], force: Any, direction: Any) -> tuple[list[Any], ...]:
    """Return ties, their forces and directions.

    Raises:
        ValueError: if there are no bolts, a force beside them, or directions of other ones.
    """
    if not forces:
        raise ValueError("tie is an empty dictionary: give bolts and their forces, {tie: force}")
    if force is not None:
        raise ValueError(
            f"force is {force!r}, but the forces are given with the ties: leave it out, and give "
            "direction=..."
        )
    if not isinstance(direction, Mapping):
        direction = dict.fromkeys(forces, direction)
    if set(direction) != set(forces):
        raise ValueError(
            f"direction has {list(direction)}, but tie has {list(forces)}: give one for each bolt, "
            "or one for all"
        )
    return list(forces), list(forces.values()), [direction[tie] for tie in forces]


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
def _all_as_before(problem: ContactProblem, ties: Sequence[Tie]) -> Iterator[None]:
    """Put displacement, results, tightenings and contact set back if something fails."""
    u, shown, contacts = problem.u.x.array.copy(), problem.solid.keep(), problem.committed.contacts
    supports, tightenings = problem.committed.supports, [tie.tightening for tie in ties]
    results = [(one, one.keep()) for one in problem.interfaces]
    try:
        yield
    except BaseException:
        problem.u.x.array[:] = u
        problem.solid.put_back(shown)
        problem.committed.contacts, problem.committed.supports = contacts, supports
        for tie, tightening in zip(ties, tightenings, strict=True):
            tie.tightening = tightening
        for one, kept in results:
            one.put_back(kept)
        raise

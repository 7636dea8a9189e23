# SPDX-License-Identifier: MIT
"""Tightening of bolts: one step in which the forces of ties are given, and their jumps found."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, overload

import numpy as np

from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.algebra.parallel import any_rank
from dolfinx_mortar.arguments import is_number
from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.interfaces.interface import check_owned
from dolfinx_mortar.interfaces.pretension import check_direction, describe_shear, find_axis
from dolfinx_mortar.interfaces.tie import Tie
from dolfinx_mortar.newton_method.failures import AS_BEFORE
from dolfinx_mortar.problem.checks import check_controls, check_problem
from dolfinx_mortar.problem.jumps import diagonal
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.step_report import NewtonNotConverged, StepReport
from dolfinx_mortar.steps.newton import solve_step

log = logging.getLogger(__name__)

# Of the diagonal of the model: a longer jump is none of a small strain.
FARTHEST = 0.1


class PreloadNotReached(RuntimeError):
    """A preload that the model does not carry; all is as before.

    Attributes:
        report: of the step that has failed, or led too far.
    """

    def __init__(self, message: str, report: StepReport) -> None:
        """Keep the report."""
        super().__init__(message)
        self.report = report


@dataclass(frozen=True)
class Preload:
    """A tightened bolt."""

    jump: Floats  # (d,) the tie's tightening, which stays
    force: float  # reached, along the direction
    report: StepReport = field(repr=False)  # of the step, for all bolts that it has tightened


Direction = Sequence[float] | Floats


@overload
def preload(
    problem: ContactProblem,
    tie: Tie,
    force: float,
    direction: Direction,
    *,
    rtol: float = 1e-7,
    max_it: int = 50,
    qp: str = "active-set",
) -> Preload: ...


@overload
def preload(
    problem: ContactProblem,
    tie: Mapping[Tie, float],
    *,
    direction: Direction | Mapping[Tie, Direction],
    rtol: float = 1e-7,
    max_it: int = 50,
    qp: str = "active-set",
) -> dict[Tie, Preload]: ...


def preload(
    problem: ContactProblem,
    tie: Any,
    force: Any = None,
    direction: Any = None,
    *,
    rtol: float = 1e-7,
    max_it: int = 50,
    qp: str = "active-set",
) -> Any:
    """Tighten bolts that are cut by ties, by one step with given forces; commit; collective.

        preload(problem, bolt, 37e3, [0, 0, -1])
        preload(problem, {left: 37e3, right: 37e3}, direction=[0, 0, -1])

    Find s so that with the jump ``tie.jump + s n`` the resultant on the slave side has the part
    ``tie.force @ n == force`` along the unit vector n of the direction, under the present loads and
    supports. For a bolt n points out of the slave side, into the master side: then the sides
    overlap by s, as if the shank were shorter by that, and a positive force is tension. s n is kept
    in ``tie.tightening``, so that later steps hold the jump while the force follows the loads. A
    tie that has been tightened before is tightened, or loosened, from where it is. Bolts in a
    dictionary have their forces all together; those that are tightened by calls of their own change
    the forces of those before. ``Tie(..., pretension=force)`` gives the force in steps of any
    driver.

    Args:
        problem: bodies and constraints, with the loads and supports of the moment.
        tie: one of its ties, or several with their forces.
        force: resultant in force units, of the part of the bolt that is modelled: of half a bolt on
            a plane of symmetry, give half the force. Negative: the sides are pushed apart.
        direction: d numbers, of any length; of several bolts, for all of them or by tie.
        rtol: as in `newton`; each force is also met to this share of it, or of the force before if
            that is larger.
        max_it: as in `newton`.
        qp: as in `newton`.

    Returns:
        Jump, force and report; of several bolts by tie. The step is committed, as those of
        `load_steps` are; the level and the history of these stay as they are.

    Raises:
        ValueError: for arguments that make no sense, on all ranks.
        PreloadNotReached: if the model does not carry a force: nothing resists, the direction is
            wrong, bodies flow or let go, or the step does not converge. Displacement, results,
            jumps and committed state are then as before.
    """
    check_problem(problem, ContactProblem)
    several = isinstance(tie, Mapping)
    with raised_together(problem.comm):
        asked = _by_tie(tie, force, direction) if several else ([tie], [force], [direction])
    ties, forces, directions = asked
    given = asked if several else (tie, force, direction)
    named = dict(zip(("tie", "force", "direction"), given, strict=True))
    problem.check_ranks(**named, rtol=rtol, max_it=max_it, qp=qp)
    check_controls(qp, rtol, max_it)
    axes = [_check(problem, *one) for one in zip(ties, forces, directions, strict=True)]
    problem.audit()  # without pretensions; the sides have to be paired
    for one, n in zip(ties, axes, strict=True):
        _check_axis(problem, one, n)
    with _all_as_before(problem), _pulled(ties, forces, axes):
        before = [one.tightening for one in ties]
        try:
            report = solve_step(problem, qp=qp, rtol=rtol, max_it=max_it, audit=False)
        except NewtonNotConverged as error:
            cause = error.message.removesuffix(AS_BEFORE)
            raise _failure(ties, forces, axes, cause, error.report) from error
        after = [one.tightening for one in ties]
        way = max(float(np.linalg.norm(b - a)) for a, b in zip(before, after, strict=True))
        if way > FARTHEST * diagonal(problem.V):
            cause = (
                f"a jump of {way:.4g} would do, more than {FARTHEST:.0%} of the model's diagonal"
            )
            raise _failure(ties, forces, axes, cause, report)
    problem.commit()
    found = {
        one: Preload(one.tightening.copy(), float(one.force @ n), report)
        for one, n in zip(ties, axes, strict=True)
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
    """Return the unit vector of the direction if the arguments are valid; collective."""
    other = not any(tie is one for one in problem.ties)
    if any_rank(problem.comm, other)[0]:
        raise ValueError(f"tie is {tie!r}: give one of problem.ties")
    check_owned(problem.interfaces, problem.supports)
    if tie.pretension is not None:
        raise ValueError(
            f"tie is {tie!r}, which has pretension={tie.pretension!r}: every step tightens it, so "
            "set tie.pretension to the force, or to None before"
        )
    if not is_number(force):
        raise ValueError(f"force is {force!r}: give a finite number, the resultant of the bolt")
    return check_direction(direction, problem.d)


def _check_axis(problem: ContactProblem, tie: Tie, n: Floats) -> None:
    """Raise a ValueError if a tie cannot be tightened along a unit vector; collective."""
    link = problem.system.link(tie)
    find_axis(link, n)
    shear = describe_shear(link, n)
    if shear and problem.comm.rank == 0:
        log.warning("%s", shear)


def _failure(
    ties: Sequence[Tie],
    forces: Sequence[float],
    axes: Sequence[Floats],
    cause: str,
    report: StepReport,
) -> PreloadNotReached:
    """Return the error of a preload that is not reached."""
    bolts = [
        f"{force:g} along the direction [{', '.join(f'{x:.4g}' for x in n)}] of {tie}"
        for tie, force, n in zip(ties, forces, axes, strict=True)
    ]
    return PreloadNotReached(
        f"force {'; '.join(bolts)}: {cause}. The force may be more than the bolt's stiffness gives "
        "(check units, of force and stiffness). Where smaller steps help, tighten in parts, by "
        "calls with rising forces. Displacement, jump and committed state are as before",
        report,
    )


@contextmanager
def _pulled(ties: Sequence[Tie], forces: Sequence[float], axes: Sequence[Floats]) -> Iterator[None]:
    """Give ties their pretensions for a step."""
    directions = [tie.direction for tie in ties]
    for tie, force, n in zip(ties, forces, axes, strict=True):
        tie.pretension, tie.direction = float(force), n
    try:
        yield
    finally:
        for tie, direction in zip(ties, directions, strict=True):
            tie.pretension, tie.direction = None, direction


@contextmanager
def _all_as_before(problem: ContactProblem) -> Iterator[None]:
    """Put displacement, results, tightenings and contact set back if something fails."""
    u, shown, contacts = problem.u.x.array.copy(), problem.solid.keep(), problem.committed.contacts
    supports = problem.committed.supports
    results = [(one, one.keep()) for one in problem.interfaces]
    try:
        yield
    except BaseException:
        problem.u.x.array[:] = u
        problem.solid.put_back(shown)
        problem.committed.contacts, problem.committed.supports = contacts, supports
        for one, kept in results:
            one.put_back(kept)
        raise

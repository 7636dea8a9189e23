# SPDX-License-Identifier: MIT
"""Tightening of bolts: one step in which the forces of ties are given and their jumps unknown."""

import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, overload

from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.algebra.parallel import any_rank
from dolfinx_mortar.arguments import is_number
from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.interfaces.interface import check_owned
from dolfinx_mortar.interfaces.pretension import check_direction, describe_shear, find_axis
from dolfinx_mortar.interfaces.tie import Tie
from dolfinx_mortar.newton_method.failures import AS_BEFORE
from dolfinx_mortar.problem.checks import check_controls, check_problem
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.step_report import NewtonNotConverged, StepReport
from dolfinx_mortar.steps.newton import solve_step

log = logging.getLogger(__name__)


class PreloadNotReached(RuntimeError):
    """A preload that the model does not carry; the state is as before.

    Attributes:
        report: of the step that has failed.
    """

    def __init__(self, message: str, report: StepReport) -> None:
        super().__init__(message)
        self.report = report


@dataclass(frozen=True)
class Preload:
    """A tightened bolt: what `preload` returns."""

    jump: Floats  # (d,) the tie's tightening, which stays
    force: float  # of the tie along the direction, positive in tension
    report: StepReport = field(repr=False)  # of the step, which may tighten several bolts


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
    """Tighten bolts cut by ties in one step with given forces, and commit it; collective.

        preload(problem, bolt, 37e3, [0, 0, -1])
        preload(problem, {left: 37e3, right: 37e3}, direction=[0, 0, -1])

    Find s so that with the jump ``tie.jump + s n`` the resultant on the slave side has the part
    ``tie.force @ n == force`` along the unit vector n of the direction, under the present loads and
    supports. For a bolt n points out of the slave side, into the master side: then the sides
    overlap by s, as if the shank were shorter by that, and a positive force is tension. s n is kept
    in ``tie.tightening``: later steps hold the jump constant, and the force depends on the loads. A
    tie that has been tightened before may be tightened further, or loosened. Bolts of one
    dictionary have their forces at the same time; those of a later call change the forces of
    earlier ones. ``Tie(..., pretension=force)`` gives the force in steps of any driver.

    Args:
        problem: bodies and constraints, with their present loads and supports.
        tie: one of its ties, or several with their forces.
        force: resultant of the part of the bolt in the model: half the force of a bolt on a plane
            of symmetry. A negative one pushes the sides apart.
        direction: vector (d,) of any length; of several bolts, for all of them or by tie.
        rtol: as in `newton`; also the error of each force, relative to the larger one of the force
            and that before.
        max_it: as in `newton`.
        qp: as in `newton`.

    Returns:
        Jump, force and report; of several bolts by tie. The step is committed, without an entry in
        the history of `load_steps`, and at the same level.

    Raises:
        ValueError: for invalid arguments, on all ranks.
        PreloadNotReached: if the model does not carry a force: nothing resists it, the direction is
            wrong, bodies flow or separate, or the step does not converge. Displacement, results,
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
    with _pulled(ties, forces, axes):
        try:
            report = solve_step(problem, qp=qp, rtol=rtol, max_it=max_it, audit=False)
        except NewtonNotConverged as error:
            cause = error.message.removesuffix(AS_BEFORE)
            raise _failure(ties, forces, axes, cause, error.report) from error
    problem.commit()
    found = {
        one: Preload(one.tightening.copy(), float(one.force @ n), report)
        for one, n in zip(ties, axes, strict=True)
    }
    return found if several else found[tie]


def _by_tie(forces: Mapping[Any, Any], force: Any, direction: Any) -> tuple[list[Any], ...]:
    """Return ties, their forces and directions.

    Raises:
        ValueError: without bolts, for a force besides them, or directions of other ties.
    """
    if not forces:
        raise ValueError("tie is an empty dictionary: give {tie: force}")
    if force is not None:
        raise ValueError(
            f"force is {force!r}, but tie has the forces: leave it out, and give direction=..."
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
            f"tie is {tie!r}, and every step tightens it to pretension={tie.pretension!r}: set "
            "tie.pretension to the force, or to None before"
        )
    if not is_number(force):
        raise ValueError(f"force is {force!r}: give a finite number, the resultant of the bolt")
    return check_direction(direction, problem.d)


def _check_axis(problem: ContactProblem, tie: Tie, n: Floats) -> None:
    """Raise a ValueError if a tie cannot be tightened along a unit vector; collective."""
    find_axis(tie.normal, n, str(tie))
    shear = describe_shear(tie.normal, n, str(tie))
    if shear and problem.comm.rank == 0:
        log.warning("%s", shear)


def _failure(
    ties: Sequence[Tie],
    forces: Sequence[float],
    axes: Sequence[Floats],
    cause: str,
    report: StepReport,
) -> PreloadNotReached:
    """Return the error."""
    bolts = [
        f"{force:g} along the direction [{', '.join(f'{x:.4g}' for x in n)}] of {tie}"
        for tie, force, n in zip(ties, forces, axes, strict=True)
    ]
    return PreloadNotReached(
        f"force {'; '.join(bolts)}: {cause}. The force may be too large for the stiffness of the "
        "bolt (check units of both). Otherwise tighten in parts, by calls with increasing forces. "
        "Displacement, jump and committed state are as before",
        report,
    )


@contextmanager
def _pulled(ties: Sequence[Tie], forces: Sequence[float], axes: Sequence[Floats]) -> Iterator[None]:
    """Set the pretensions of ties for a block."""
    directions = [tie.direction for tie in ties]
    for tie, force, n in zip(ties, forces, axes, strict=True):
        tie.pretension, tie.direction = float(force), n
    try:
        yield
    finally:
        for tie, direction in zip(ties, directions, strict=True):
            tie.pretension, tie.direction = None, direction

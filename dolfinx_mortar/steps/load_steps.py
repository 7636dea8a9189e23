# SPDX-License-Identifier: MIT
"""Load steps: Newton, commit, and smaller steps after a failure."""

from __future__ import annotations

import logging
import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy.typing as npt

from dolfinx import fem
from dolfinx_mortar.agreement import check_same_on_all_ranks
from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.checkpoint import check_folder
from dolfinx_mortar.interfaces.near import nodal_gaps
from dolfinx_mortar.newton_method.failures import AS_BEFORE
from dolfinx_mortar.persistence.committed import Walk
from dolfinx_mortar.persistence.restoring import Saved, read
from dolfinx_mortar.problem.checks import check_every, check_load_steps, check_problem
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.report.reaction import reactions
from dolfinx_mortar.step_report import LoadStep, NewtonNotConverged, StepReport
from dolfinx_mortar.steps.newton import solve_step
from dolfinx_mortar.steps.progress import lines
from dolfinx_mortar.steps.ramp import Ramp, check_range, difference, read_ramps

log = logging.getLogger(__name__)

# Of the largest level: levels that are calculated in another way differ by round-off.
SAME_LEVEL = 1e-12


@dataclass(frozen=True)
class Level:
    """A point on the loading path."""

    time: float
    overlap: float = 0.0  # depth by which the sides may still overlap
    share: float = 1.0  # of the step that ends here, a binary fraction

    def between(self, reached: Level) -> Level:
        """Return the level halfway from where one is."""
        return Level(
            (reached.time + self.time) / 2.0,
            (reached.overlap + self.overlap) / 2.0,
            (reached.share + self.share) / 2.0,
        )

    def cuts(self, reached: Level) -> int:
        """Return how often the whole step has been halved to get the part from where one is."""
        return round(-math.log2(self.share - reached.share))


@dataclass(frozen=True)
class Loading:
    """What a load level sets: the Constants of ramps, then what a user's function does."""

    ramps: Sequence[Ramp]
    on_time: Callable[[float], None] | None

    @property
    def changes(self) -> bool:
        """Whether another level may be another load."""
        return bool(self.ramps) or self.on_time is not None

    def set(self, problem: ContactProblem, level: float) -> None:
        """Set the loads of a level; an error on one rank is raised on all of them; collective."""
        for ramp in self.ramps:
            ramp.set(level)
        if self.on_time is not None:
            with raised_together(problem.comm):
                self.on_time(level)


@dataclass
class Keeper:
    """A walk under way: writes its checkpoints, if it has any, where there is something new."""

    problem: ContactProblem
    file: Path | None
    walk: Walk  # what the problem knows it by
    new: bool = False  # something has been committed since the last file

    def check_alone(self) -> None:
        """Raise a ValueError if another walk has begun: each would go on from the other's state."""
        if self.problem.committed.walk is not self.walk:
            raise ValueError(
                "problem: a second load_steps has begun on it before this one was done, and has "
                "moved it on; finish one walk before the next, or give each a problem of its own"
            )

    def write(self) -> None:
        """Write the committed state; collective."""
        if self.file is not None and self.new:
            self.problem.save(self.file)
            self.new = False


def load_steps(
    problem: ContactProblem,
    times: Iterable[float],
    *,
    ramp: Mapping[fem.Constant, Iterable[tuple[float, npt.ArrayLike]]] | None = None,
    on_time: Callable[[float], None] | None = None,
    start: float | None = None,
    qp: str = "active-set",
    rtol: float = 1e-6,
    max_it: int = 50,
    cuts: str = "halve",
    max_cuts: int = 6,
    progress: bool | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    every: int = 1,
) -> Iterator[LoadStep]:
    """Walk through load levels: set the loads, solve, commit, yield; collective.

        for step in dm.load_steps(problem, [0.5, 1.0], ramp={push: [(0.0, 0.0), (1.0, -0.1)]}):
            print(step.time, contact.force)

    A step that does not converge is halved, up to ``max_cuts`` times; the parts are committed one
    by one (the loading path matters to plasticity, they belong to the answer). Sides that overlap
    at the start of such a step are pushed apart in the same parts.

    Args:
        problem: the bodies and their constraints.
        times: load levels in the order of the loading; they may fall.
        ramp: a table for each Constant that changes, ``{push: [(0.0, 0.0), (1.0, -0.1)]}``: rows
            (level, value) with levels that rise, between which the value is linear. Values have the
            shape of the Constant. Tables must hold all levels, ``start`` too.
        on_time: sets what tables cannot say for a level, also for levels between two times; called
            after the Constants of ``ramp`` have their values. It may be called twice for a level,
            where a step is cut or a run goes on, so what it sets must depend on the level alone.
        start: level of the committed state; by default the last one that ``load_steps`` has
            reached on this problem, 0 at first.
        qp: as in ``newton``.
        rtol: as in ``newton``.
        max_it: as in ``newton``.
        cuts: "halve", or "none" to fail where a step does not converge as it is.
        max_cuts: largest number of halvings of one step.
        progress: print a line for each step on rank 0; None does if there is more than one step,
            nobody has configured logging, and it is no notebook. The log has them at level INFO.
        checkpoint: file, see below; a walk of its own has a file of its own.
        every: write it after so many steps, and after the last one.

    With ``checkpoint`` a program that was killed goes on where it was when it is run again. If the
    file is there, the state of the problem becomes that of the checkpoint, ``ramp`` and ``on_time``
    set its level, and only the steps that are left are made and yielded, with their numbers; the
    log says so. Of a walk that was finished none are left. The steps before are in
    ``problem.history``. ``times`` has to begin with the levels that were reached, up to round-off;
    more may follow than at first. So have tables of ``ramp`` to be as they were, in their order, as
    far as the walk has come. The file is written when the body of the loop is done with a
    step, so what the body does may be done twice, but is never left out; a loop that is left by
    ``break`` does not write the last step. ``Writer(.., resume=True)`` has each step once even so.
    A step that fails for good writes what has been committed since the last file, whatever
    ``every``: the steps before it, and those of its parts that have converged. To begin anew,
    delete the file.

    Yields:
        One ``LoadStep`` for every entry of ``times`` that is not yet done.

    Raises:
        ValueError: for arguments that make no sense, and for a checkpoint of another problem, with
            other levels, cut off or of another version; where a second walk has begun before this
            one is done; on all ranks.
        OSError: if a checkpoint cannot be written or read, on all ranks; after a step that has
            failed, too, whose error is then the ``__context__``.
        NewtonNotConverged: when the smallest step fails, too. Steps yielded before are committed,
            and those parts of the last one that have converged: the message says what is kept.
    """
    check_problem(problem, ContactProblem)
    check_same_on_all_ranks(problem.comm, on_time=on_time)
    levels = check_load_steps(times, start, max_cuts, cuts, problem.comm)
    loading = Loading(read_ramps(problem.comm, ramp), on_time)
    if on_time is not None and not callable(on_time):
        raise ValueError(f"on_time is {on_time!r}: give a function of the load level, or None")
    file = check_every(problem.comm, checkpoint, every)
    most = max_cuts if cuts == "halve" else 0
    options = {"qp": qp, "rtol": rtol, "max_it": max_it}
    committed = problem.committed
    begin = committed.level if start is None else float(start)
    check_range(loading.ramps, [begin, *levels])
    committed.level, committed.walked = begin, 0
    if file is not None:
        begin = _go_on(problem, file, levels, loading, begin)
    committed.walk = Walk(begin, [one.rows for one in loading.ramps])
    keeper = Keeper(problem, file, committed.walk)
    done = committed.walked
    tell = lines(problem.comm, False if progress is None and len(levels) == 1 else progress)
    for number, time in enumerate(levels[done:], start=done + 1):
        parts = _walk(problem, number, time, loading, most, options, keeper)
        supports = [one.as_dict() for one in reactions(problem)]
        step = LoadStep(number, time, parts[-1], parts, _forces(problem), supports)
        committed.history.append(step)
        committed.walked = number
        tell(f"load step {number} of {len(levels)} {step.outcome}")
        yield step
        keeper.check_alone()
        if number % every == 0 or number == len(levels):
            keeper.write()


def _forces(problem: ContactProblem) -> list[list[float]]:
    """Return the resultants on the slave sides."""
    return [list(map(float, interface.force)) for interface in problem.interfaces]


def _go_on(
    problem: ContactProblem,
    file: Path,
    levels: list[float],
    loading: Loading,
    begin: float,
) -> float:
    """Restore a checkpoint if there is one, and see that the next can be written; collective.

    Returns:
        The level at which the walk began: `begin` if there is no checkpoint.

    Raises:
        ValueError: on all ranks, if the levels do not begin with those that it has reached, or
            tables are others than until there.
        OSError: on all ranks, if no file can be written there.
    """
    # the others may not reach the folder; a name that cannot be is an error of the check
    if not problem.comm.bcast(problem.comm.rank == 0 and os.path.exists(file)):
        check_folder(problem.comm, file)
        return begin
    saved = read(problem.state, file)
    walk = saved.walk
    _check_walked(levels, walk, file)
    _check_tables(loading.ramps, saved, file)
    if len(walk) < len(levels):  # told now, not after the next step
        check_folder(problem.comm, file)
    saved.put()
    loading.set(problem, problem.committed.level)
    problem.solid.follow()  # what laws put out rests on parameters, too
    if problem.comm.rank == 0:
        left = "nothing is left to do" if len(walk) == len(levels) else "going on from there"
        log.warning(
            "checkpoint %s: %d of %d steps are done, to %g; %s",
            *(file, len(walk), len(levels), problem.committed.level, left),
        )
    before = problem.committed.walk
    return begin if before is None else before.start


def _check_walked(levels: list[float], walk: list[float], file: Path) -> None:
    """Raise a ValueError unless levels begin with those that were walked, up to round-off."""
    size = max(map(abs, walk), default=0.0)
    for k, reached in enumerate(walk):
        if k == len(levels) or abs(levels[k] - reached) > SAME_LEVEL * size:
            given = levels[k] if k < len(levels) else "missing"
            raise ValueError(
                f"times: level {k + 1} is {given}, but the checkpoint {str(file)!r} has walked "
                f"{len(walk)} levels, and there to {reached}: give times that begin so, give this "
                "walk a file of its own, or delete the file to begin anew"
            )


def _check_tables(ramps: Sequence[Ramp], saved: Saved, file: Path) -> None:
    """Raise a ValueError unless tables are those of the saved walk, as far as it has come."""
    before = saved.about["walk"]
    if before is None or not saved.walk:
        return
    been = [before["start"], *saved.walk, saved.about["level"]]
    if wrong := difference(before["ramp"], ramps, been):
        raise ValueError(
            f"ramp: {wrong}, when the checkpoint {str(file)!r} was written: give the tables of "
            "that walk, give this walk a file of its own, or delete the file to begin anew"
        )


def _walk(
    problem: ContactProblem,
    number: int,
    time: float,
    loading: Loading,
    most: int,
    options: dict[str, Any],
    keeper: Keeper,
) -> list[StepReport]:
    """Go to a level, in parts where that fails; return the reports of the parts; collective."""
    parts: list[StepReport] = []
    reached, pending = Level(problem.committed.level, share=0.0), [Level(time)]
    failures = 0
    while pending:
        level = pending[-1]
        loading.set(problem, level.time)
        keeper.check_alone()
        try:
            report = solve_step(problem, overlap=level.overlap, level=level.time, **options)
        except NewtonNotConverged as error:
            failures += 1
            if not parts:
                overlap = find_overlap(problem, options["rtol"])
                reached = replace(reached, overlap=overlap)
            way = level.time != reached.time and loading.changes
            if level.cuts(reached) >= most or not (way or level.overlap != reached.overlap):
                cause = error.message.removesuffix(AS_BEFORE)
                told = _describe(number, time, level, reached, most, cause)
                error.message = f"{told}. {_describe_kept(len(parts), reached)}"
                keeper.write()  # all ranks are here, and the last part has left no trace
                raise
            if problem.comm.rank == 0:
                log.warning("no convergence at %g, trying half the step", level.time)
            pending.append(level.between(reached))
            continue
        problem.commit()
        keeper.new, problem.committed.level = True, level.time
        reached = level
        parts.append(report)
        pending.pop()
    if failures:
        shown = ", ".join(f"{n} iterations" for n in (p.newton_iterations for p in parts))
        parts[-1].notes.append(f"the step was cut {failures} times and made in parts: {shown}")
    parts[-1].cuts = failures
    return parts


def find_overlap(problem: ContactProblem, rtol: float) -> float:
    """Return how deep sides overlap at the present displacement; collective.

    Less than rtol facet lengths is what a converged step leaves, and counts as nothing.
    """
    problem.update_geometry(0.0)
    gap = nodal_gaps(problem.system.links, problem.positions(), problem.n)
    deepest = float(maximum(problem.comm, (-gap).max(initial=0.0))[0])
    return deepest if deepest > rtol * problem.system.facet_length else 0.0


def _describe(
    number: int, time: float, level: Level, reached: Level, most: int, message: str
) -> str:
    """Return the message of a step that has failed for good."""
    cuts = f"{level.cuts(reached)} of {most} cuts"
    return (
        f"load step {number} to time {time:g} failed from {reached.time:g} to {level.time:g}, "
        f"after {cuts} (the last level that converged is {reached.time:g}): {message}"
    )


def _describe_kept(parts: int, reached: Level) -> str:
    """Say where a step that has failed for good leaves the problem, by what has converged of it."""
    if not parts:
        return "The displacement and the committed state are as before the step"
    count = "1 part of it that has" if parts == 1 else f"{parts} parts of it that have"
    still = f", where sides still overlap by {reached.overlap:.3g}" if reached.overlap else ""
    return (
        f"The {count} converged stay committed: displacement, state and results are those at level "
        f"{reached.time:g}{still}; a next walk goes on from there"
    )

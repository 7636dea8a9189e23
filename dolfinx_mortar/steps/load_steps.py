# SPDX-License-Identifier: MIT
"""Load steps: Newton's method, commit, smaller steps after a failure, checkpoints."""

from __future__ import annotations

import logging
import math
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from mpi4py import MPI

import numpy.typing as npt

from dolfinx import fem
from dolfinx_mortar.agreement import check_same_on_all_ranks
from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.arrays import SAME
from dolfinx_mortar.checkpoint import check_folder
from dolfinx_mortar.interfaces.near import nodal_gaps
from dolfinx_mortar.newton_method.failures import AS_BEFORE
from dolfinx_mortar.persistence.committed import Walk
from dolfinx_mortar.persistence.restoring import Saved, read
from dolfinx_mortar.problem.checks import check_every, check_load_steps, check_problem
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.qp import LinearSolver, QPNotSolved
from dolfinx_mortar.report.reaction import reactions
from dolfinx_mortar.step_report import LoadStep, NewtonNotConverged, StepReport
from dolfinx_mortar.steps.newton import solve_step
from dolfinx_mortar.steps.ramp import Ramp, check_range, difference, notes_on_unread, read_ramps

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Level:
    """A point on the load path."""

    time: float
    overlap: float = 0.0  # depth by which the sides may still overlap
    share: float = 1.0  # of the step that ends here, a binary fraction

    def between(self, reached: Level) -> Level:
        """Return the level halfway from the one reached."""
        return Level(
            (reached.time + self.time) / 2.0,
            (reached.overlap + self.overlap) / 2.0,
            (reached.share + self.share) / 2.0,
        )

    def cuts(self, reached: Level) -> int:
        """Return how often the step has been halved for the part from the level reached."""
        return round(-math.log2(self.share - reached.share))


@dataclass(frozen=True)
class Loading:
    """The loads of a level: Constants of ramps, then a user's function."""

    ramps: Sequence[Ramp]
    on_time: Callable[[float], None] | None

    @property
    def changes(self) -> bool:
        """Whether loads depend on the level."""
        return bool(self.ramps) or self.on_time is not None

    def set(self, problem: ContactProblem, level: float) -> None:
        """Set the loads of a level; an error on one rank is raised on all of them; collective."""
        for ramp in self.ramps:
            ramp.set(level)
        if self.on_time is not None:
            with raised_together(problem.comm):
                self.on_time(level)


@dataclass
class Solves:
    """How the steps of a walk are solved; with factorisations from where multigrid has failed."""

    problem: ContactProblem
    qp: str
    rtol: float
    max_it: int
    factorising: LinearSolver | None = None  # in place of the problem's

    def to(self, level: Level) -> StepReport:
        """Solve a step to a level, if multigrid fails with a factorisation; collective.

        If that fails as well, the next steps try multigrid again: the step was too large, or
        nothing holds a body.
        """
        try:
            return self._solve(level, self.factorising)
        except NewtonNotConverged as error:
            failed, given_up = isinstance(error.__cause__, QPNotSolved), error.report.linear_solver
            factorising = self.problem.linear.factorising() if failed else None
            if factorising is None:
                raise
        if self.problem.comm.rank == 0:
            log.warning("%s gave no solution at %g, trying a factorisation", given_up, level.time)
        report = self._solve(level, factorising)
        self.factorising = factorising
        report.notes.append(
            f"{given_up} gave no solution: this step and the next ones of these load steps are "
            "factorised (petsc_options={'pc_type': 'cholesky'} does so from the start)"
        )
        return report

    def _solve(self, level: Level, linear: LinearSolver | None) -> StepReport:
        return solve_step(
            self.problem,
            qp=self.qp,
            rtol=self.rtol,
            max_it=self.max_it,
            overlap=level.overlap,
            level=level.time,
            linear=linear,
        )


@dataclass
class Checkpoint:
    """The file of a run, written when the committed state is new."""

    problem: ContactProblem
    file: Path | None  # None for no checkpoints
    walk: Walk
    new: bool = False

    def check_alone(self) -> None:
        """Raise a ValueError if another run has started: each would change the other's state."""
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
    """Step through load levels: set the loads, solve, commit, yield; collective.

        for step in dm.load_steps(problem, [0.5, 1.0], ramp={push: [(0.0, 0.0), (1.0, -0.1)]}):
            print(step.time, contact.force)

    A step that does not converge is halved, up to ``max_cuts`` times, and its parts are committed
    (they are part of the solution, as plasticity depends on the load path). An overlap of the sides
    at the start of such a step is removed in the same parts. If multigrid gives no solution, the
    step is repeated with a factorisation, and all later steps are factorised (unless
    ``petsc_options`` choose a method, or beyond 200 000 unknowns); a note says so.

    Args:
        problem: the bodies and their constraints.
        times: load levels in the order of loading; they may decrease.
        ramp: a table for each Constant that changes, ``{push: [(0.0, 0.0), (1.0, -0.1)]}``: rows
            (level, value) with increasing levels, between which the value is linear. Values have
            the shape of the Constant. Tables must contain all levels, and ``start``. A note says
            where nothing reads a Constant.
        on_time: function of the level that sets other loads, also for levels between two times,
            after the Constants of ``ramp``. It may be called twice for a level, if a step is cut or
            a run is continued, so what it sets must depend on the level alone.
        start: level of the committed state; by default the last level of ``load_steps`` on this
            problem, at first 0.
        qp: as in ``newton``.
        rtol: as in ``newton``.
        max_it: as in ``newton``.
        cuts: "halve", or "none" for an error where a step does not converge.
        max_cuts: largest number of halvings of one step.
        progress: print a line for each step on rank 0; None prints if there is more than one step
            and logging is not configured, except in notebooks. The log has the lines at level INFO.
        checkpoint: file, see below; each run needs its own.
        every: write it after so many steps, and after the last one.

    With ``checkpoint`` a program that was killed continues when it is run again. If the file
    exists, its state is restored, ``ramp`` and ``on_time`` set its level, and only the remaining
    steps are made and yielded, with their numbers. The steps before are in ``problem.history``. The
    first entries of ``times`` have to be the levels that were reached, up to round-off; more may
    follow than at first. The tables of ``ramp`` have to be the same, in the same order, up to the
    level reached. The file is written after the body of the loop, which may therefore be run twice
    for a step, but is never left out; after ``break`` the last step is not written.
    ``Writer(.., resume=True)`` has each step once even so. If a step fails, what has been committed
    since the last file is written: the steps before it, and its converged parts. To start again,
    delete the file.

    Yields:
        One ``LoadStep`` for every remaining entry of ``times``.

    Raises:
        ValueError: for invalid arguments, for a checkpoint of another problem or with other levels,
            truncated or of another version, and if a second run starts before this one ends; on all
            ranks.
        OSError: if a checkpoint cannot be written or read, on all ranks; after a step that has
            failed, the error of the step is its ``__context__``.
        NewtonNotConverged: if the smallest step fails, too. Steps yielded before are committed, and
            the converged parts of the last one: the message says which.
    """
    check_problem(problem, ContactProblem)
    check_same_on_all_ranks(problem.comm, on_time=on_time)
    levels = check_load_steps(times, start, max_cuts, cuts, problem.comm)
    loading = Loading(read_ramps(problem.comm, ramp), on_time)
    if on_time is not None and not callable(on_time):
        raise ValueError(f"on_time is {on_time!r}: give a function of the load level, or None")
    file = check_every(problem.comm, checkpoint, every)
    most = max_cuts if cuts == "halve" else 0
    solves = Solves(problem, qp, rtol, max_it)
    committed = problem.committed
    begin = committed.level if start is None else float(start)
    check_range(loading.ramps, [begin, *levels])
    committed.level, committed.walked = begin, 0
    if file is not None:
        begin = _continue(problem, file, levels, loading, begin)
    committed.walk = Walk(begin, [one.rows for one in loading.ramps])
    written = Checkpoint(problem, file, committed.walk)
    done = committed.walked
    idle = _idle(problem, loading)
    tell = lines(problem.comm, False if progress is None and len(levels) == 1 else progress)
    for number, time in enumerate(levels[done:], start=done + 1):
        parts = _walk(solves, number, time, loading, most, written)
        parts[-1].notes += idle if number == done + 1 else []
        supports = [one.as_dict() for one in reactions(problem)]
        forces = [list(map(float, interface.force)) for interface in problem.interfaces]
        step = LoadStep(number, time, parts[-1], parts, forces, supports)
        committed.history.append(step)
        committed.walked = number
        tell(f"load step {number} of {len(levels)} {step.outcome}")
        yield step
        written.check_alone()
        if number % every == 0 or number == len(levels):
            written.write()


def _idle(problem: ContactProblem, loading: Loading) -> list[str]:
    """Return notes on tables without effect, which rank 0 logs; none if a function may use them."""
    if loading.on_time is not None:
        return []
    notes = notes_on_unread(loading.ramps, problem.constants())
    if problem.comm.rank == 0:
        for note in notes:
            log.warning("%s", note)
    return notes


def _continue(
    problem: ContactProblem,
    file: Path,
    levels: list[float],
    loading: Loading,
    begin: float,
) -> float:
    """Restore a checkpoint if there is one, and check that the next can be written; collective.

    Returns:
        The initial level of the run: `begin` without a checkpoint.

    Raises:
        ValueError: on all ranks, if the first levels are not those that it has reached, or if
            tables differ up to there.
        OSError: on all ranks, if no file can be written there.
    """
    # other ranks may have no access to the folder; the check has the errors of wrong names
    if not problem.comm.bcast(problem.comm.rank == 0 and os.path.exists(file)):
        check_folder(problem.comm, file)
        return begin
    saved = read(problem.state, file)
    walk = saved.walk
    _check_walked(levels, walk, file)
    _check_tables(loading.ramps, saved, file)
    if len(walk) < len(levels):  # an error now rather than after the next step
        check_folder(problem.comm, file)
    problem.outcome = saved.put()
    loading.set(problem, problem.committed.level)
    problem.solid.follow()  # results of laws depend on parameters, too
    if problem.comm.rank == 0:
        left = "nothing is left to do" if len(walk) == len(levels) else "going on from there"
        log.warning(
            "checkpoint %s: %d of %d steps are done, to %g; %s",
            *(file, len(walk), len(levels), problem.committed.level, left),
        )
    before = problem.committed.walk
    return begin if before is None else before.start


def _check_walked(levels: list[float], walk: list[float], file: Path) -> None:
    """Raise a ValueError unless the first levels are those reached, up to round-off."""
    size = max(map(abs, walk), default=0.0)
    for k, reached in enumerate(walk):
        if k == len(levels) or abs(levels[k] - reached) > SAME * size:
            given = levels[k] if k < len(levels) else "missing"
            raise ValueError(
                f"times: level {k + 1} is {given}, but the checkpoint {str(file)!r} has walked "
                f"{len(walk)} levels, and there to {reached}: give times that begin so, give this "
                "walk a file of its own, or delete the file to begin anew"
            )


def _check_tables(ramps: Sequence[Ramp], saved: Saved, file: Path) -> None:
    """Raise a ValueError unless tables are those of the saved run, up to the level reached."""
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
    solves: Solves, number: int, time: float, loading: Loading, most: int, written: Checkpoint
) -> list[StepReport]:
    """Step to a level, in parts if that fails; return the reports of the parts; collective."""
    problem = solves.problem
    parts: list[StepReport] = []
    reached, pending = Level(problem.committed.level, share=0.0), [Level(time)]
    failures = 0
    while pending:
        level = pending[-1]
        loading.set(problem, level.time)
        written.check_alone()
        try:
            report = solves.to(level)
        except NewtonNotConverged as error:
            failures += 1
            if not parts:
                overlap = find_overlap(problem, solves.rtol)
                reached = replace(reached, overlap=overlap)
            way = level.time != reached.time and loading.changes
            if level.cuts(reached) >= most or not (way or level.overlap != reached.overlap):
                cause = error.message.removesuffix(AS_BEFORE)
                made = f"{level.cuts(reached)} of {most} cuts"
                error.message = (
                    f"load step {number} to time {time:g} failed from {reached.time:g} to "
                    f"{level.time:g}, after {made} (the last level that converged is "
                    f"{reached.time:g}): {cause}. {_describe_kept(len(parts), reached)}"
                )
                written.write()  # the last part is undone, on all ranks
                raise
            if problem.comm.rank == 0:
                log.warning("no convergence at %g, trying half the step", level.time)
            pending.append(level.between(reached))
            continue
        problem.commit()
        written.new, problem.committed.level = True, level.time
        reached = level
        parts.append(report)
        pending.pop()
    if failures:
        shown = ", ".join(f"{n} iterations" for n in (p.newton_iterations for p in parts))
        parts[-1].notes.append(f"the step was cut {failures} times and made in parts: {shown}")
    parts[-1].cuts = failures
    return parts


def find_overlap(problem: ContactProblem, rtol: float) -> float:
    """Return the depth of overlaps at the present displacement; collective.

    Up to rtol facet lengths, the tolerance of a step, count as 0.
    """
    problem.update_geometry(0.0)
    gap = nodal_gaps(problem.system.links, problem.positions(), problem.n)
    deepest = float(maximum(problem.comm, (-gap).max(initial=0.0))[0])
    return deepest if deepest > rtol * problem.system.facet_length else 0.0


def _describe_kept(parts: int, reached: Level) -> str:
    """Say which state a failed step leaves, given the number of its converged parts."""
    if not parts:
        return "The displacement and the committed state are as before the step"
    count = "1 part of it that has" if parts == 1 else f"{parts} parts of it that have"
    still = f", where sides still overlap by {reached.overlap:.3g}" if reached.overlap else ""
    return (
        f"The {count} converged stay committed: displacement, state and results are those at level "
        f"{reached.time:g}{still}; a next walk goes on from there"
    )


def lines(comm: MPI.Comm, wanted: bool | None) -> Callable[[str], None]:
    """Return a function that logs a line on rank 0, and prints it unless the log is shown.

    Args:
        comm: communicator.
        wanted: whether to print; None prints if logging is not configured, except in notebooks.

    Raises:
        ValueError: on all ranks, if ``wanted`` is none of the three on any; collective.
    """
    with raised_together(comm):
        if not (wanted is None or isinstance(wanted, bool)):
            raise ValueError(f"progress is {wanted!r}: choose True, False or None")
    if comm.rank != 0:
        return lambda line: None
    notebook = type(sys.stderr).__module__.partition(".")[0] == "ipykernel"
    shown = not (log.hasHandlers() or notebook) if wanted is None else wanted

    def tell(line: str) -> None:
        log.info("%s", line)
        if shown and not (log.hasHandlers() and log.isEnabledFor(logging.INFO)):
            print(line, file=sys.stderr, flush=True)

    return tell

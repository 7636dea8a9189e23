# SPDX-License-Identifier: MIT
"""Steps along load levels or times: cuts after failures, commits, checkpoints."""

from __future__ import annotations

import logging
import math
import os
import sys
from collections.abc import (
    AsyncGenerator,
    Callable,
    Coroutine,
    Generator,
    Iterable,
    Iterator,
    Mapping,
)
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx import fem
from dolfinx_mortar.algebra.parallel import largest, raised_together
from dolfinx_mortar.common.agreement import check_same_on_all_ranks, find_constants
from dolfinx_mortar.common.arguments import FLAG, check_optional, instance
from dolfinx_mortar.common.arrays import SAME
from dolfinx_mortar.common.step_report import LoadStep, NewtonNotConverged, StepReport
from dolfinx_mortar.heat import HEAT, Heat
from dolfinx_mortar.interfaces.link import nodal_gaps
from dolfinx_mortar.persistence.checkpoints import check_folder, read
from dolfinx_mortar.persistence.committed import Walk
from dolfinx_mortar.problem.checks import check_every, check_load_steps, check_problem
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.report.reaction import reactions
from dolfinx_mortar.steps.failures import AS_BEFORE
from dolfinx_mortar.steps.newton import Field, in_turn, solve_step
from dolfinx_mortar.steps.ramp import check_range, difference, notes_on_unread, read_ramps

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Level:
    """A point on the load path."""

    time: float
    overlap: float = 0.0  # depth that may remain
    share: float = 1.0  # of the step that ends here, a binary fraction

    def between(self, reached: Level) -> Level:
        """The level halfway from the one reached."""
        return Level(
            (reached.time + self.time) / 2.0,
            (reached.overlap + self.overlap) / 2.0,
            (reached.share + self.share) / 2.0,
        )

    def cuts(self, reached: Level) -> int:
        """Number of halvings for the part from the level reached."""
        return round(-math.log2(self.share - reached.share))


class Run:
    """The steps of a run along levels, with its loads and checkpoint."""

    name = "load step"

    def __init__(
        self,
        problem: ContactProblem,
        times: Any,
        ramp: Any,
        on_time: Any,
        start: Any,
        cuts: Any,
        max_cuts: Any,
        progress: bool | None,
        checkpoint: Any,
        every: Any,
        heat: Any,
        dt: Any,
        **newton: Any,
    ) -> None:
        """Check the arguments, see `load_steps`; collective."""
        check_problem(problem, ContactProblem)
        check_same_on_all_ranks(problem.comm, on_time=on_time)
        self.problem, self.progress, self.every, self.newton = problem, progress, every, newton
        self.levels = check_load_steps(problem.comm, times, start, max_cuts, cuts)
        self.begin = problem.committed.level if start is None else float(start)
        self.ramps = read_ramps(problem.comm, ramp)
        self.on_time: Callable[[float], Any] | None = check_optional(
            "on_time", on_time, instance(Callable, "give a function of the level")
        )
        self.most = max_cuts * (cuts == "halve")  # halvings of a step
        self.file = check_every(problem.comm, checkpoint, every)
        self.fields: list[Field] = [] if check_optional("heat", heat, HEAT) is None else [heat]
        if self.fields and self.file is not None:
            raise ValueError(
                "checkpoint: a file has no temperatures, so leave out heat= or checkpoint="
            )
        for one in [] if heat is None else [i for f in heat.fields for i in f.interfaces]:
            if None is not one.interface.owner is not problem.supports:
                raise ValueError(f"heat: {one.interface} is of another problem: give one of this")
        remedy = "give the Constant of the laws"
        self.dt: fem.Constant | None = check_optional("dt", dt, instance(fem.Constant, remedy))
        self.walk: Walk | None = None
        self.new = False  # whether the committed state is not in the file

    def load(self, level: float) -> None:
        """Set Constants of ramps, then call a user's function; collective."""
        for ramp in self.ramps:
            ramp.set(level)
        if self.on_time is not None:
            with raised_together(self.problem.comm):
                returned = self.on_time(level)
                if isinstance(returned, Generator | Coroutine | AsyncGenerator):
                    returned.close() if isinstance(returned, Coroutine) else None
                    raise ValueError(
                        f"on_time({level:g}) returns a {type(returned).__name__} and has set "
                        "nothing: give a plain function, without yield and async"
                    )

    def may_cut(self) -> bool:
        """Whether a part is another problem than the step."""
        return bool(self.ramps) or self.on_time is not None or self.dt is not None

    def settings(self) -> dict[str, Any]:
        """Settings that change results, as JSON values."""
        return {}

    def to(self, level: Level) -> StepReport:
        """Solve a step to a level; collective."""
        if self.dt is not None:
            self.dt.value = level.time - self.problem.committed.level
        return solve_step(self.problem, overlap=level.overlap, level=level.time, **self.newton)

    def commit(self, report: StepReport) -> None:
        """Commit a converged step; collective."""
        self.problem.commit()

    def steps(self, done: int = 0) -> Iterator[LoadStep]:
        """Make the steps, see `load_steps`; collective.

        `done` is the number of levels of the last run, which this one continues.
        """
        problem, levels, start = self.problem, self.levels, self.begin
        committed, settings = problem.committed, self.settings()
        check_range(self.ramps, [start, *levels])
        committed.level, committed.walked = start, done
        if done and committed.walk is not None:
            _check_settings(settings, committed.walk.settings, "the run that these times continue")
            start = committed.walk.start
        if self.file is not None:
            start = self._continue(self.file, start)
        committed.walk = self.walk = Walk(start, [one.rows for one in self.ramps], settings)
        done = committed.walked  # of the checkpoint, if any
        used = find_constants([problem.inputs, [field.given for field in self.fields]])
        tables = {f"ramp: table {k}": one.constant for k, one in enumerate(self.ramps, start=1)}
        tables |= {} if self.dt is None else {"dt": self.dt}
        idle = [] if self.on_time else notes_on_unread(tables, used)
        for note in idle if problem.comm.rank == 0 else ():
            log.warning("%s", note)
        quiet = self.progress is None and len(levels) == 1
        tell = lines(problem.comm, False if quiet else self.progress)
        for number, time in enumerate(levels[done:], start=done + 1):
            step = self._step(number, time)
            step.report.notes += idle if number == done + 1 else []
            tell(f"{self.name} {number} of {len(levels)} {step.outcome}")
            yield step
            self._check_alone()
            if number % self.every == 0 or number == len(levels):
                self._write()

    def _check_alone(self) -> None:
        if self.problem.committed.walk is not self.walk:
            raise ValueError(
                "problem: another load_steps has begun on it before this one was finished, and has "
                "changed its state; finish one run before the next, or make a problem for each"
            )

    def _write(self) -> None:
        """Write the committed state, if it is new; collective."""
        if self.file is not None and self.new:
            self.problem.save(self.file)
            self.new = False

    def _continue(self, file: Path, begin: float) -> float:
        """Restore a checkpoint, or check that it can be written; return the first level."""
        problem, levels = self.problem, self.levels
        # other ranks may have no access to the folder; `check_folder` raises for wrong names
        if not problem.comm.bcast(problem.comm.rank == 0 and os.path.exists(file)):
            check_folder(problem.comm, file)
            return begin
        saved = read(problem.state, file)
        walk, before = saved.walk, saved.about["walk"]
        _check_walked(levels, walk, file)
        if walk:
            been = [before["start"], *walk, saved.about["level"]]
            if wrong := difference(before["ramp"], self.ramps, been):
                raise ValueError(
                    f"ramp: {wrong}, when the checkpoint {str(file)!r} was written: give the "
                    "tables of that run, give this run a file of its own, or delete the file to "
                    "begin anew"
                )
            _check_settings(self.settings(), before["settings"], f"the checkpoint {str(file)!r}")
        if len(walk) < len(levels):  # an error now rather than after the next step
            check_folder(problem.comm, file)
        saved.put()
        problem.outcome = None
        self.load(problem.committed.level)
        problem.solid.follow()  # results of laws depend on parameters
        if problem.comm.rank == 0:
            left = "nothing is left to do" if len(walk) == len(levels) else "going on from there"
            log.warning(
                "checkpoint %s: %d of %d steps are done, to %g; %s",
                *(file, len(walk), len(levels), problem.committed.level, left),
            )
        return begin if before is None else float(before["start"])

    def _step(self, number: int, time: float) -> LoadStep:
        """Make a step, in parts if it fails; collective."""
        problem, parts, failures = self.problem, list[StepReport](), 0
        reached, pending = Level(problem.committed.level, share=0.0), [Level(time)]
        while pending:
            level = pending[-1]
            self.load(level.time)
            self._check_alone()
            try:
                solve = partial(self.to, level)
                report = in_turn(problem, self.fields, solve, level.time, self.newton["rtol"])
            except NewtonNotConverged as error:
                failures += 1
                if not parts:
                    rigid = [one for one in problem.interfaces if one.rigid is not None]
                    if rigid or problem.system.driven:
                        self.load(reached.time)
                    overlap = find_overlap(problem, self.newton["rtol"])
                    reached = replace(reached, overlap=overlap)
                way, made = level.time != reached.time and self.may_cut(), level.cuts(reached)
                if made >= self.most or not (way or level.overlap != reached.overlap):
                    cause = error.message.removesuffix(AS_BEFORE)
                    error.message = (
                        f"{self.name} {number} to time {time:g} failed from {reached.time:g} to "
                        f"{level.time:g}, after {made} of {self.most} cuts (the last level that "
                        f"converged is {reached.time:g}): {cause}. "
                        f"{_describe_kept(len(parts), reached)}; problem.diagnose() says more"
                    )
                    self._write()  # all ranks have undone the last part
                    raise
                if problem.comm.rank == 0:
                    log.warning("no convergence at %g, trying half the step", level.time)
                pending.append(level.between(reached))
                continue
            parts.append(report)
            pending.pop()
            assert problem.outcome is not None and problem.outcome.before is not None
            with problem.undone(problem.outcome.before):
                self.commit(report)
                for field in self.fields:
                    field.commit()
                if not pending:
                    step = _book(problem, number, time, parts, failures)
            self.new, reached = True, level
        return step


def _check_walked(levels: list[float], walk: list[float], file: Path) -> None:
    size = max(map(abs, walk), default=0.0)
    for k, reached in enumerate(walk):
        if k == len(levels) or abs(levels[k] - reached) > SAME * size:
            given = levels[k] if k < len(levels) else "missing"
            raise ValueError(
                f"times: level {k + 1} is {given}, but the checkpoint {str(file)!r} has "
                f"{len(walk)} levels, this one {reached}: give times that begin so, give this "
                "run a file of its own, or delete the file to begin anew"
            )


def _check_settings(present: Mapping[str, Any], before: Mapping[str, Any], where: str) -> None:
    for name in {**present, **before}:
        if present.get(name) != before.get(name):
            raise ValueError(
                f"{name} is {present.get(name)!r}, in {where} {before.get(name)!r}: give the same, "
                "or the times after those alone, for a run of its own that goes on from there"
            )


def _book(
    problem: ContactProblem, number: int, time: float, parts: list[StepReport], cuts: int
) -> LoadStep:
    last = parts[-1]
    last.cuts = cuts
    if cuts:
        shown = ", ".join(f"{n} iterations" for n in (p.newton_iterations for p in parts))
        last.notes.append(f"the step was cut {cuts} times and made in parts: {shown}")
    supports = [one.as_dict() for one in reactions(problem)]
    forces = [list(map(float, interface.force)) for interface in problem.interfaces]
    step = LoadStep(number, time, last, parts, forces, supports)
    problem.committed.history.append(step)
    problem.committed.walked = number
    return step


def find_overlap(problem: ContactProblem, rtol: float) -> float:
    """Depth of overlaps at the present u, 0 within rtol facet lengths; collective."""
    problem.update_geometry()
    gap = nodal_gaps(problem.system.links, problem.positions(), problem.n)
    deepest = largest(problem.comm, np.minimum(gap, 0.0))
    return deepest if deepest > rtol * problem.system.facet_length else 0.0


def _describe_kept(parts: int, reached: Level) -> str:
    if not parts:
        return "The displacement and the committed state are as before the step"
    still = f", where sides still overlap by {reached.overlap:.3g}" if reached.overlap else ""
    return (
        f"Its {parts} converged parts stay committed: displacement, state and results are those at "
        f"level {reached.time:g}{still}; the next run goes on from there"
    )


def lines(comm: MPI.Comm, wanted: bool | None) -> Callable[[str], None]:
    """Function that logs a line on rank 0, and prints it if `wanted`; collective.

    None prints if logging is not configured, except in notebooks.

    Raises:
        ValueError: on all ranks, for other values.
    """
    with raised_together(comm):
        check_optional("progress", wanted, FLAG)
    if comm.rank != 0:
        return lambda line: None
    notebook = type(sys.stderr).__module__.partition(".")[0] == "ipykernel"
    shown = not (log.hasHandlers() or notebook) if wanted is None else wanted

    def tell(line: str) -> None:
        log.info("%s", line)
        if shown and not (log.hasHandlers() and log.isEnabledFor(logging.INFO)):
            print(line, file=sys.stderr, flush=True)

    return tell


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
    heat: Heat | None = None,
    dt: fem.Constant | None = None,
) -> Iterator[LoadStep]:
    """Step through load levels: set the loads, solve, commit, yield; collective.

        for step in dm.load_steps(problem, [0.5, 1.0], ramp={push: [(0.0, 0.0), (1.0, -0.1)]}):
            print(step.time, contact.force)

    A step that does not converge is halved, up to ``max_cuts`` times, and its parts are committed,
    as plasticity depends on the load path. An initial overlap of the sides is removed in the same
    parts. If multigrid fails, the rest of the step and all later ones use a factorisation (unless
    ``petsc_options`` choose a method, or beyond 200 000 unknowns); a note says so.

    Args:
        problem: the bodies and their constraints.
        times: load levels in the order of loading; they may decrease.
        ramp: a table for each Constant that changes: rows (level, value) with increasing levels,
            linear in between, for all levels and ``start``. A note says where nothing reads a
            Constant.
        on_time: function of the level that sets other loads, after ``ramp``; they must depend on
            the level alone, since cut steps and continued runs repeat levels.
        start: level of the committed state; by default the last level of ``load_steps`` on this
            problem, at first 0.
        qp, rtol, max_it: as in ``newton``.
        cuts: "halve", or "none" for an error where a step does not converge.
        max_cuts: largest number of halvings of one step.
        progress: print a line for each step on rank 0; None prints if there is more than one step
            and logging is not configured, except in notebooks. The log has the lines at level INFO.
        checkpoint: file, see below; each run needs its own.
        every: write it after so many steps, and after the last one.
        heat: temperature that is solved in turn with the step, until its changes are rtol times its
            range; levels are times then. Not in checkpoints.
        dt: Constant of laws of time, such as `Norton`, set to the length of each step between
            levels, of parts of steps too.

    With ``checkpoint`` a program that was killed continues when it is run again. If the file
    exists, its state is restored, the loads are set, and only the remaining steps are made and
    yielded, with their numbers; earlier steps are in ``problem.history``. Up to the level reached
    ``times`` and ``ramp`` have to be those of the saved run. The file is written after the body of
    the loop, which may therefore run twice for a step; after ``break`` the last step is not
    written. If a step fails, all that is committed is written. To start again, delete the file.

    Yields:
        One ``LoadStep`` for every remaining entry of ``times``.

    Raises:
        ValueError: on all ranks, for invalid arguments, a problem with `Inertia`, a checkpoint of
            another problem, version or levels, or truncated, and a second run before this one ends.
        OSError: on all ranks, if a checkpoint cannot be written or read; after a failed step its
            error is the ``__context__``.
        NewtonNotConverged: if the smallest step fails, too; the converged parts are committed.
    """
    given = times, ramp, on_time, start, cuts, max_cuts, progress, checkpoint, every, heat, dt
    run = Run(problem, *given, qp=qp, rtol=rtol, max_it=max_it)
    if problem.in_time:
        raise ValueError(
            "problem has an Inertia among its terms, which would move the bodies from level to "
            "level as if these were times: use dm.time_steps(problem, times), or leave it out"
        )
    yield from run.steps()

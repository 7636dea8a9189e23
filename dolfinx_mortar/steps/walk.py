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
    Iterator,
    Mapping,
    Sequence,
)
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

from mpi4py import MPI

from dolfinx_mortar.algebra.parallel import maximum, raised_together
from dolfinx_mortar.common.agreement import check_same_on_all_ranks, find_constants
from dolfinx_mortar.common.arguments import FLAG, check_optional, instance
from dolfinx_mortar.common.arrays import SAME
from dolfinx_mortar.common.step_report import LoadStep, NewtonNotConverged, StepReport
from dolfinx_mortar.interfaces.link import nodal_gaps
from dolfinx_mortar.persistence.checkpoints import check_folder, read
from dolfinx_mortar.persistence.committed import Walk
from dolfinx_mortar.problem.checks import check_every, check_load_steps, check_problem
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.qp import LinearSolver, QPNotSolved
from dolfinx_mortar.report.reaction import reactions
from dolfinx_mortar.steps.failures import AS_BEFORE
from dolfinx_mortar.steps.newton import solve_step
from dolfinx_mortar.steps.ramp import Ramp, check_range, difference, notes_on_unread, read_ramps

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


@dataclass(frozen=True)
class Loading:
    """Loads of a level: Constants of ramps, then a user's function."""

    ramps: Sequence[Ramp]
    on_time: Callable[[float], None] | None

    def __post_init__(self) -> None:
        check_optional("on_time", self.on_time, instance(Callable, "give a function of the level"))

    @property
    def changes(self) -> bool:
        """Whether loads depend on the level."""
        return bool(self.ramps) or self.on_time is not None

    def set(self, problem: ContactProblem, level: float) -> None:
        """Set the loads of a level; collective."""
        for ramp in self.ramps:
            ramp.set(level)
        if self.on_time is not None:
            with raised_together(problem.comm):
                returned: Any = self.on_time(level)
                if isinstance(returned, Generator | Coroutine | AsyncGenerator):
                    returned.close() if isinstance(returned, Coroutine) else None
                    raise ValueError(
                        f"on_time({level:g}) returns a {type(returned).__name__} and has set "
                        "nothing: give a plain function, without yield and async"
                    )


@dataclass
class Solves:
    """Solution of the steps of a run."""

    problem: ContactProblem
    qp: str
    rtol: float
    max_it: int
    factorising: LinearSolver | None = field(default=None, init=False)  # replaces the problem's
    name: ClassVar[str] = "load step"

    @property
    def linear(self) -> LinearSolver:
        """Present linear solver."""
        return self.factorising or self.problem.linear

    def commit(self, report: StepReport) -> None:
        """Commit a converged step; collective."""
        self.problem.commit()

    def settings(self) -> dict[str, Any]:
        """Settings that change results, as JSON values."""
        return {}

    def may_cut(self, loading: Loading) -> bool:
        """Whether a part is another problem than the step."""
        return loading.changes

    def to(self, level: Level) -> StepReport:
        """Solve a step to a level, by a factorisation if multigrid fails; collective.

        If both fail, later steps try multigrid again.
        """
        try:
            return self._solve(level, self.linear)
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

    def _solve(self, level: Level, linear: LinearSolver) -> StepReport:
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
    """File of a run, written if the committed state is new."""

    problem: ContactProblem
    file: Path | None  # None for no checkpoints
    walk: Walk
    new: bool = False

    def check_alone(self) -> None:
        """Raise a ValueError if another run has changed the committed state."""
        if self.problem.committed.walk is not self.walk:
            raise ValueError(
                "problem: another load_steps has begun on it before this one was finished, and has "
                "changed its state; finish one run before the next, or make a problem for each"
            )

    def write(self) -> None:
        """Write the committed state; collective."""
        if self.file is not None and self.new:
            self.problem.save(self.file)
            self.new = False


@dataclass(frozen=True)
class Way:
    """Levels and loads of a run, and how it goes."""

    begin: float  # committed level
    levels: list[float]
    loading: Loading
    most: int  # halvings of a step
    file: Path | None
    every: int
    progress: bool | None


def read_way(
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
) -> Way:
    """Checked arguments, see `load_steps`; collective."""
    check_problem(problem, ContactProblem)
    check_same_on_all_ranks(problem.comm, on_time=on_time)
    levels = check_load_steps(times, start, max_cuts, cuts, problem.comm)
    begin = problem.committed.level if start is None else float(start)
    loading = Loading(read_ramps(problem.comm, ramp), on_time)
    file = check_every(problem.comm, checkpoint, every)
    return Way(begin, levels, loading, max_cuts * (cuts == "halve"), file, every, progress)


def walk(solves: Solves, way: Way, *, done: int = 0) -> Iterator[LoadStep]:
    """Make the steps to given levels, see `load_steps`; collective.

    `done` is the number of levels of the last walk, which this one continues.
    """
    begin, levels, loading, file = way.begin, way.levels, way.loading, way.file
    problem = solves.problem
    committed = problem.committed
    check_range(loading.ramps, [begin, *levels])
    committed.level, committed.walked = begin, done
    settings = solves.settings()
    if done and committed.walk is not None:
        _check_settings(settings, committed.walk.settings, "the run that these times continue")
        begin = committed.walk.start
    if file is not None:
        begin = _continue(solves, file, levels, loading, begin)
    committed.walk = Walk(begin, [one.rows for one in loading.ramps], settings)
    written = Checkpoint(problem, file, committed.walk)
    done = committed.walked  # of the checkpoint, if any
    used = find_constants(problem.inputs)
    idle = [] if loading.on_time else notes_on_unread(loading.ramps, used)
    for note in idle if problem.comm.rank == 0 else ():
        log.warning("%s", note)
    quiet = way.progress is None and len(levels) == 1
    tell = lines(problem.comm, False if quiet else way.progress)
    for number, time in enumerate(levels[done:], start=done + 1):
        step = _walk(solves, number, time, loading, way.most, written)
        step.report.notes += idle if number == done + 1 else []
        tell(f"{solves.name} {number} of {len(levels)} {step.outcome}")
        yield step
        written.check_alone()
        if number % way.every == 0 or number == len(levels):
            written.write()


def _continue(
    solves: Solves,
    file: Path,
    levels: list[float],
    loading: Loading,
    begin: float,
) -> float:
    """Restore a checkpoint, or check that it can be written; return the first level."""
    problem = solves.problem
    # other ranks may have no access to the folder; `check_folder` raises for wrong names
    if not problem.comm.bcast(problem.comm.rank == 0 and os.path.exists(file)):
        check_folder(problem.comm, file)
        return begin
    saved = read(problem.state, file)
    walk, before = saved.walk, saved.about["walk"]
    _check_walked(levels, walk, file)
    if walk:
        been = [before["start"], *walk, saved.about["level"]]
        if wrong := difference(before["ramp"], loading.ramps, been):
            raise ValueError(
                f"ramp: {wrong}, when the checkpoint {str(file)!r} was written: give the tables of "
                "that run, give this run a file of its own, or delete the file to begin anew"
            )
        _check_settings(solves.settings(), before["settings"], f"the checkpoint {str(file)!r}")
    if len(walk) < len(levels):  # an error now rather than after the next step
        check_folder(problem.comm, file)
    saved.put()
    problem.outcome = None
    loading.set(problem, problem.committed.level)
    problem.solid.follow()  # results of laws depend on parameters
    if problem.comm.rank == 0:
        left = "nothing is left to do" if len(walk) == len(levels) else "going on from there"
        log.warning(
            "checkpoint %s: %d of %d steps are done, to %g; %s",
            *(file, len(walk), len(levels), problem.committed.level, left),
        )
    return begin if before is None else float(before["start"])


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


def _walk(
    solves: Solves, number: int, time: float, loading: Loading, most: int, written: Checkpoint
) -> LoadStep:
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
                rigid = [one for one in problem.interfaces if one.rigid is not None]
                if rigid or problem.system.driven:
                    loading.set(problem, reached.time)
                overlap = find_overlap(problem, solves.rtol)
                reached = replace(reached, overlap=overlap)
            way = level.time != reached.time and solves.may_cut(loading)
            if level.cuts(reached) >= most or not (way or level.overlap != reached.overlap):
                cause = error.message.removesuffix(AS_BEFORE)
                made = f"{level.cuts(reached)} of {most} cuts"
                error.message = (
                    f"{solves.name} {number} to time {time:g} failed from {reached.time:g} to "
                    f"{level.time:g}, after {made} (the last level that converged is "
                    f"{reached.time:g}): {cause}. {_describe_kept(len(parts), reached)}; "
                    "problem.diagnose() says more"
                )
                written.write()  # all ranks have undone the last part
                raise
            if problem.comm.rank == 0:
                log.warning("no convergence at %g, trying half the step", level.time)
            pending.append(level.between(reached))
            continue
        parts.append(report)
        pending.pop()
        assert problem.outcome is not None and problem.outcome.before is not None
        with problem.undone(problem.outcome.before):
            solves.commit(report)
            if not pending:
                step = _book(problem, number, time, parts, failures)
        written.new, reached = True, level
    return step


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
    deepest = float(maximum(problem.comm, (-gap).max(initial=0.0))[0])
    return deepest if deepest > rtol * problem.system.facet_length else 0.0


def _describe_kept(parts: int, reached: Level) -> str:
    if not parts:
        return "The displacement and the committed state are as before the step"
    count = "1 part of it that has" if parts == 1 else f"{parts} parts of it that have"
    still = f", where sides still overlap by {reached.overlap:.3g}" if reached.overlap else ""
    return (
        f"The {count} converged stay committed: displacement, state and results are those at level "
        f"{reached.time:g}{still}; the next run goes on from there"
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

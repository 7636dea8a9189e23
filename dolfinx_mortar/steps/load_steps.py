# SPDX-License-Identifier: MIT
"""Load steps: Newton, commit, and smaller steps after a failure."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.interfaces.near import nodal_gaps
from dolfinx_mortar.steps.checks import check_load_steps, check_problem
from dolfinx_mortar.steps.newton import solve_step
from dolfinx_mortar.steps.problem import ContactProblem
from dolfinx_mortar.steps.progress import progress as show_progress
from dolfinx_mortar.steps.report import NewtonNotConverged, StepReport

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class LoadStep:
    """A committed load step."""

    number: int  # 1, 2, ...
    time: float
    report: StepReport  # of the last part
    parts: list[StepReport] = field(default_factory=list)  # one, or several after cut-backs

    def __str__(self) -> str:
        """Return one line."""
        iterations = sum(part.newton_iterations for part in self.parts)
        cut = f" in {len(self.parts)} parts" if len(self.parts) > 1 else ""
        certificate = self.report.certificate
        active = certificate.active_nodes if certificate is not None else 0
        return (
            f"step {self.number} to {self.time:g}{cut}: {iterations} Newton iterations, "
            f"{active} nodes in contact"
        )


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


def load_steps(
    problem: ContactProblem,
    times: Iterable[float],
    *,
    on_time: Callable[[float], None] | None = None,
    start: float | None = None,
    qp: str = "active-set",
    rtol: float = 1e-6,
    max_it: int = 50,
    cuts: str = "halve",
    max_cuts: int = 6,
    progress: bool | None = None,
) -> Iterator[LoadStep]:
    """Walk through load levels: set the loads, solve, commit, yield; collective.

    A step that does not converge is halved, up to ``max_cuts`` times; the parts are committed one
    by one (the loading path matters to plasticity, they belong to the answer). Sides that overlap
    at the start of such a step are pushed apart in the same parts.

    Args:
        problem: the bodies and their constraints.
        times: load levels in the order of the loading; they may fall.
        on_time: sets loads and Dirichlet values for a level, also for levels between two times.
        start: level of the committed state; by default the last one that ``load_steps`` has
            reached on this problem, 0 at first.
        qp: as in ``newton``.
        rtol: as in ``newton``.
        max_it: as in ``newton``.
        cuts: "halve", or "none" to fail where a step does not converge as it is.
        max_cuts: largest number of halvings of one step.
        progress: show how far the walk has come; None does if both standard streams are terminals
            and there is more than one step.

    Yields:
        One ``LoadStep`` for every entry of ``times``.

    Raises:
        ValueError: for arguments that make no sense, on all ranks.
        NewtonNotConverged: when the smallest step fails, too. Steps yielded before are committed.
    """
    check_problem(problem, ContactProblem)
    levels = check_load_steps(times, start, max_cuts, cuts, problem.comm)
    most = max_cuts if cuts == "halve" else 0
    options = {"qp": qp, "rtol": rtol, "max_it": max_it}
    if start is not None:
        problem.committed.level = float(start)
    with show_progress(problem.comm, len(levels), progress) as advance:
        for number, time in enumerate(levels, start=1):
            parts = _walk(problem, number, time, on_time, most, options)
            advance()
            yield LoadStep(number, time, parts[-1], parts)


def _walk(
    problem: ContactProblem,
    number: int,
    time: float,
    on_time: Callable[[float], None] | None,
    most: int,
    options: dict[str, Any],
) -> list[StepReport]:
    """Go to a level, in parts where that fails; return the reports of the parts."""
    parts: list[StepReport] = []
    reached, pending = Level(problem.committed.level, share=0.0), [Level(time)]
    failures = 0
    while pending:
        level = pending[-1]
        _set_loads(problem, on_time, level.time)
        try:
            report = solve_step(problem, overlap=level.overlap, **options)
        except NewtonNotConverged as error:
            failures += 1
            if not parts:
                overlap = find_overlap(problem, options["rtol"])
                reached = replace(reached, overlap=overlap)
            way = level.time != reached.time and on_time is not None
            if level.cuts(reached) >= most or not (way or level.overlap != reached.overlap):
                error.message = _describe(number, time, level, reached, most, error.message)
                raise
            if problem.comm.rank == 0:
                log.warning("no convergence at %g, trying half the step", level.time)
            pending.append(level.between(reached))
            continue
        problem.commit()
        problem.committed.level = level.time
        reached = level
        parts.append(report)
        pending.pop()
    if failures:
        shown = ", ".join(f"{n} iterations" for n in (p.newton_iterations for p in parts))
        parts[-1].notes.append(f"the step was cut {failures} times and made in parts: {shown}")
    parts[-1].cuts = failures
    return parts


def _set_loads(
    problem: ContactProblem, on_time: Callable[[float], None] | None, time: float
) -> None:
    """Call the user's function; an error on one rank is raised on all of them; collective."""
    if on_time is not None:
        with raised_together(problem.comm):
            on_time(time)


def find_overlap(problem: ContactProblem, rtol: float) -> float:
    """Return how deep sides overlap at the present displacement; collective.

    Less than rtol facet lengths is what a converged step leaves, and counts as nothing.
    """
    x = problem.update_geometry(0.0, everywhere=True)
    gap = nodal_gaps(problem.system.links, x, problem.n)
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

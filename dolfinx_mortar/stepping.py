# SPDX-License-Identifier: MIT
"""Load steps: Newton, commit, and smaller steps after a failure."""

from __future__ import annotations

import logging
import math
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from mpi4py import MPI

from rich.progress import Progress

from dolfinx_mortar.newton import newton
from dolfinx_mortar.problem import ContactProblem
from dolfinx_mortar.report import NewtonNotConverged, StepReport

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class LoadStep:
    """A committed load step."""

    number: int  # 1, 2, ...
    time: float
    report: StepReport  # of the last part
    parts: list[StepReport] = field(default_factory=list)  # one, or several after cut-backs


def load_steps(
    problem: ContactProblem,
    times: Iterable[float],
    *,
    on_time: Callable[[float], None] | None = None,
    start: float = 0.0,
    qp: str = "active-set",
    rtol: float = 1e-6,
    max_it: int = 50,
    max_cuts: int = 6,
) -> Iterator[LoadStep]:
    """Walk through load levels: set the loads, solve, commit, yield; collective.

    A step that does not converge is halved, up to ``max_cuts`` times; the parts are committed one
    by one (the loading path matters to plasticity, they belong to the answer).

    Args:
        problem: the bodies and their constraints.
        times: load levels in the order of the loading; they may fall.
        on_time: sets loads and Dirichlet values for a level, also for levels between two times.
        start: level of the committed state.
        qp: as in ``newton``.
        rtol: as in ``newton``.
        max_it: as in ``newton``.
        max_cuts: largest number of halvings of one step.

    Yields:
        One ``LoadStep`` for every entry of ``times``.

    Raises:
        ValueError: for levels that are not finite.
        NewtonNotConverged: when the smallest step fails, too. Steps yielded before are committed.
    """
    levels = [float(t) for t in times]
    if not all(map(math.isfinite, levels)):
        raise ValueError(f"times is {levels}: every level must be finite")
    with _progress(problem.comm, len(levels)) as advance:
        reached = start
        for number, level in enumerate(levels, start=1):
            parts: list[StepReport] = []
            pending = [(level, 0)]
            while pending:
                target, cuts = pending[-1]
                if on_time is not None:
                    on_time(target)
                try:
                    parts.append(newton(problem, qp=qp, rtol=rtol, max_it=max_it))
                except NewtonNotConverged:
                    if cuts >= max_cuts or on_time is None:
                        raise
                    if problem.comm.rank == 0:
                        log.warning("no convergence at %g, trying half the step", target)
                    pending.append(((reached + target) / 2.0, cuts + 1))
                    continue
                problem.commit()
                reached = target
                pending.pop()
            advance()
            yield LoadStep(number, level, parts[-1], parts)


@contextmanager
def _progress(comm: MPI.Comm, total: int) -> Iterator[Callable[[], None]]:
    """Show a bar over the load steps on rank 0 of a terminal."""
    if comm.rank != 0 or total < 2 or not sys.stderr.isatty():
        yield lambda: None
        return
    with Progress(transient=True) as bar:
        task = bar.add_task("load steps", total=total)
        yield lambda: bar.advance(task)

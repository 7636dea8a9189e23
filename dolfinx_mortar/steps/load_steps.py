# SPDX-License-Identifier: MIT
"""Load steps: Newton, commit, and smaller steps after a failure."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field

from dolfinx_mortar.steps.newton import newton
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
        ValueError: for times that are no list of finite levels.
        NewtonNotConverged: when the smallest step fails, too. Steps yielded before are committed.
    """
    if not isinstance(times, Iterable):
        raise ValueError(f"times is {times!r}: give a list of levels, [{times!r}] for a single one")
    levels = [float(t) for t in times]
    if not all(map(math.isfinite, levels)):
        raise ValueError(f"times is {levels}: every level must be finite")
    with show_progress(problem.comm, len(levels), None) as advance:
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
                except NewtonNotConverged as error:
                    if cuts >= max_cuts or on_time is None:
                        tried = f"{cuts} of {max_cuts} cuts" if on_time else "no cuts (no on_time)"
                        error.message = (
                            f"load step {number} to time {level:g} failed from {reached:g} to "
                            f"{target:g}, after {tried}: {error.message}"
                        )
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

# SPDX-License-Identifier: MIT
"""Steps along load levels."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping

import numpy.typing as npt

from dolfinx import fem
from dolfinx_mortar.common.arguments import check_optional, instance
from dolfinx_mortar.common.step_report import LoadStep
from dolfinx_mortar.heat import HEAT, Heat
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.steps.walk import Solves, read_way, walk


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
    parts. If multigrid fails, this step and all later ones use a factorisation (unless
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
    given = times, ramp, on_time, start, cuts, max_cuts, progress, checkpoint, every
    way = read_way(problem, *given)
    if problem.in_time:
        raise ValueError(
            "problem has an Inertia among its terms, which would move the bodies from level to "
            "level as if these were times: use dm.time_steps(problem, times), or leave it out"
        )
    solves = Solves(problem, qp, rtol, max_it)
    solves.heat = check_optional("heat", heat, HEAT)
    solves.dt = check_optional("dt", dt, instance(fem.Constant, "give the Constant of the laws"))
    yield from walk(solves, way)

# SPDX-License-Identifier: MIT
"""How far a walk through load levels has come: a bar on a terminal, otherwise lines in the log.

Every step is a record of level INFO. Where nobody has configured logging, as in most batch jobs, it
is a line on the standard error stream of rank 0; notebooks, whose cells such lines would fill, stay
as they are. Streams and log handlers stay as they are, too, and no thread draws, so every finished
line of others stays whole.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext

from mpi4py import MPI

from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.log import is_configured
from dolfinx_mortar.steps.report import LoadStep

log = logging.getLogger(__name__)

Advance = Callable[[LoadStep], None]


def progress(
    comm: MPI.Comm, total: int, wanted: bool | None, *, done: int = 0
) -> AbstractContextManager[Advance]:
    """Return a context that shows how many of ``total`` steps are done.

        with progress(comm, len(levels), wanted=None) as advance:
            for level in levels:
                ...
                advance(step)

    Args:
        comm: ranks that walk together; rank 0 shows.
        total: number of steps.
        wanted: True shows, False does not; None shows if there is more than one step, as a bar
            where both standard streams are terminals, else as lines where logging is not
            configured, but not in notebooks.
        done: number of steps that an earlier run has made.

    Returns:
        A context manager that gives the function to call with every step. It shows a bar where
        the error stream is a terminal and rich is installed, else a line for each step.

    Raises:
        ValueError: on all ranks, if ``wanted`` is none of the three on any; collective.
    """
    _check(comm, wanted)
    if comm.rank != 0:
        return nullcontext(lambda step: None)
    terminals = sys.stdout.isatty() and sys.stderr.isatty()
    if wanted is None:
        wanted = total > 1 and (terminals or not (is_configured() or _in_notebook()))
        bar = terminals
    else:
        bar = sys.stderr.isatty()
    if wanted and bar:
        try:
            return _bar(total, done)
        except ImportError:
            pass
    return nullcontext(_lines(total, shown=wanted))


def lines(comm: MPI.Comm, wanted: bool | None) -> Callable[[str], None]:
    """Return what logs a line on rank 0 and, if wanted, prints it unless the log shows it.

    Args:
        comm: ranks that work together.
        wanted: None prints where logging is not configured, but not in notebooks.

    Raises:
        ValueError: on all ranks, if ``wanted`` is none of the three on any; collective.
    """
    _check(comm, wanted)
    if comm.rank != 0:
        return lambda line: None
    shown = not (is_configured() or _in_notebook()) if wanted is None else wanted

    def tell(line: str) -> None:
        log.info("%s", line)
        _show(line, shown=shown)

    return tell


def _check(comm: MPI.Comm, wanted: bool | None) -> None:
    """Raise a ValueError on all ranks unless ``wanted`` is True, False or None; collective."""
    with raised_together(comm):
        if not (wanted is None or isinstance(wanted, bool)):
            raise ValueError(f"progress is {wanted!r}: choose True, False or None")


def _show(line: str, *, shown: bool) -> None:
    """Print a line unless the log shows it."""
    if shown and not (is_configured() and log.isEnabledFor(logging.INFO)):
        print(line, file=sys.stderr, flush=True)


def _in_notebook() -> bool:
    """Tell whether the error stream ends in a notebook."""
    return type(sys.stderr).__module__.partition(".")[0] == "ipykernel"


def _tell(total: int, step: LoadStep) -> str:
    """Log a step; return its line."""
    line = f"load step {step.number} of {total} {step.outcome}"
    log.info("%s", line)
    return line


def _lines(total: int, *, shown: bool) -> Advance:
    """Return what logs every step, and prints its line unless the log shows it."""

    def advance(step: LoadStep) -> None:
        _show(_tell(total, step), shown=shown)

    return advance


def _bar(total: int, done: int) -> AbstractContextManager[Advance]:
    """Return a bar that is drawn at every step and erased at the end.

    Raises:
        ImportError: without rich.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    @contextmanager
    def drawn() -> Iterator[Advance]:
        # by default rich would replace the standard streams, and draw from a thread
        columns = TextColumn("load steps"), BarColumn(), MofNCompleteColumn(), TextColumn("")
        with Progress(
            *columns,
            console=Console(stderr=True),
            transient=True,
            auto_refresh=False,
            redirect_stdout=False,
            redirect_stderr=False,
        ) as bar:
            task = bar.add_task("", total=total, completed=done)

            def advance(step: LoadStep) -> None:
                _tell(total, step)
                bar.update(task, advance=1, refresh=True)

            yield advance

    return drawn()

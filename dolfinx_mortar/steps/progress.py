# SPDX-License-Identifier: MIT
"""How far a walk through load levels has come, shown on a terminal or as lines.

Writes to the standard error stream of rank 0, in one go between steps. Streams and log handlers
stay as they are, and no thread draws, so every finished line of others stays whole.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext

from mpi4py import MPI


def progress(
    comm: MPI.Comm, total: int, wanted: bool | None
) -> AbstractContextManager[Callable[[], None]]:
    """Return a context that shows how many of ``total`` steps are done.

        with progress(comm, len(levels), wanted=None) as advance:
            for level in levels:
                ...
                advance()

    Args:
        comm: ranks that walk together; rank 0 shows.
        total: number of steps.
        wanted: True shows, False does not; None shows if there is more than one step and both
            standard streams are terminals.

    Returns:
        A context manager that gives the function to call after every step. It shows a bar where
        the error stream is a terminal and rich is installed, else a line for each step.

    Raises:
        ValueError: if ``wanted`` is none of the three.
    """
    if wanted not in (None, True, False):
        raise ValueError(f"progress is {wanted!r}: choose True, False or None")
    if wanted is None:
        wanted = total > 1 and sys.stdout.isatty() and sys.stderr.isatty()
    if not wanted or comm.rank != 0:
        return nullcontext(_silent)
    if sys.stderr.isatty():
        try:
            return _bar(total)
        except ImportError:
            pass
    return nullcontext(_lines(total))


def _silent() -> None:
    """Show nothing."""


def _lines(total: int) -> Callable[[], None]:
    """Return what writes a line for every step."""
    numbers = iter(range(1, total + 1))

    def advance() -> None:
        print(f"load step {next(numbers)} of {total} done", file=sys.stderr, flush=True)

    return advance


def _bar(total: int) -> AbstractContextManager[Callable[[], None]]:
    """Return a bar that is drawn at every step and erased at the end.

    Raises:
        ImportError: without rich.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    @contextmanager
    def drawn() -> Iterator[Callable[[], None]]:
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
            task = bar.add_task("", total=total)
            yield lambda: bar.update(task, advance=1, refresh=True)

    return drawn()

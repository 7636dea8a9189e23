# SPDX-License-Identifier: MIT
"""Errors of some ranks, raised on all of them, so that no rank waits for another one for ever."""

from collections.abc import Iterator
from contextlib import contextmanager

from mpi4py import MPI


@contextmanager
def raised_together(comm: MPI.Comm) -> Iterator[None]:
    """Run a block without collective calls; if it fails on some ranks, raise on all; collective.

    A rank that failed raises its own error. The others raise an error with its text and rank: an
    OSError for an OSError, a ValueError for a ValueError, otherwise a RuntimeError. A
    KeyboardInterrupt or SystemExit of one rank is raised on all.

    >>> with raised_together(MPI.COMM_SELF):
    ...     raise ValueError("E is -1")
    Traceback (most recent call last):
    ValueError: E is -1
    """
    own: BaseException | None = None
    try:
        yield
    except (Exception, KeyboardInterrupt, SystemExit) as error:
        own = error
    raise_together(comm, own)


def raise_together(comm: MPI.Comm, own: BaseException | None) -> None:
    """Raise the error of this rank, or of another one; collective.

    Args:
        comm: communicator.
        own: the error of this rank, if any.
    """
    found = comm.allgather(None if own is None else _kind_and_text(own))
    if own is not None:
        raise own
    for rank, other in enumerate(found):
        if other is not None:
            kind, told = other  # a text, or the exit status of a program
            raise _KINDS[kind](f"{told} (on rank {rank})" if isinstance(told, str) else told)


_KINDS = (OSError, ValueError, KeyboardInterrupt, SystemExit, RuntimeError)


def _kind_and_text(error: BaseException) -> tuple[int, str | int]:
    """Return the index in _KINDS of what other ranks raise, and the text or the exit status."""
    for index, kind in enumerate(_KINDS):
        if isinstance(error, kind):
            if isinstance(error, SystemExit) and not isinstance(error.code, str):
                return index, error.code if isinstance(error.code, int) else int(bool(error.code))
            return index, str(error)
    return len(_KINDS) - 1, f"{type(error).__name__}: {error}"

# SPDX-License-Identifier: MIT
"""Errors of some ranks, raised on all of them, so that no rank waits for another one for ever."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc


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


@contextmanager
def named(name: str) -> Iterator[None]:
    """Run a block whose errors say in their text, or in a note, whose they are.

    >>> with named("Plane(slave=3): couple()"):
    ...     raise ValueError("no plane here")
    Traceback (most recent call last):
    ValueError: Plane(slave=3): couple(): no plane here
    """
    try:
        yield
    except Exception as error:
        if len(error.args) == 1 and isinstance(error.args[0], str):
            if name not in error.args[0]:
                error.args = (f"{name}: {error.args[0]}",)
        else:
            error.add_note(f"in {name}")
        raise


@contextmanager
def from_callbacks() -> Iterator[None]:
    """Run a block; what Python code that PETSc calls raises there is raised as it is.

    PETSc makes an error of its own of it, also of Ctrl-C, and leaves the vectors that it was
    working on locked: solvers have to be made anew.
    """
    try:
        yield
    except PETSc.Error as error:
        cause: BaseException = error
        while isinstance(cause, PETSc.Error) and cause.__cause__ is not None:
            cause = cause.__cause__
        if cause is error:
            raise
        raise cause from cause.__cause__


def is_ours(thing: object) -> bool:
    """Tell whether a class of this package made it: that fails on all ranks or on none."""
    return is_defined_here(type(thing))


def is_defined_here(made: Callable[..., Any]) -> bool:
    """Tell whether a class or function is one of this package."""
    return str(made.__module__).startswith(f"{__name__.partition('.')[0]}.")


def raise_together(comm: MPI.Comm, own: BaseException | None) -> None:
    """Raise the error of this rank, or of another one; collective.

    Args:
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
            return index, _text(error)
    return len(_KINDS) - 1, f"{type(error).__name__}: {_text(error)}"


def _text(error: BaseException) -> str:
    """Return the message of an error with its notes."""
    return "; ".join([str(error), *getattr(error, "__notes__", [])])

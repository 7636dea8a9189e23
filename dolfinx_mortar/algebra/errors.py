# SPDX-License-Identifier: MIT
"""Errors of some ranks, raised on all of them, so that no rank waits forever."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc


@contextmanager
def raised_together(comm: MPI.Comm) -> Iterator[None]:
    """Run a block without collective calls; an error of some ranks is raised on all; collective.

    Failed ranks raise their own error; others raise an OSError, ValueError, KeyboardInterrupt,
    SystemExit or RuntimeError with its text and rank.

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
    """Run a block whose errors get a name in their text, or in a note.

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
    """Run a block, raising the errors of Python code called by PETSc unchanged, also Ctrl-C.

    PETSc leaves vectors locked after such an error: solvers have to be created anew.
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
    """Whether the class of an object is of this package: it fails on all ranks or on none."""
    return is_defined_here(type(thing))


def is_defined_here(made: Callable[..., Any]) -> bool:
    """Whether a class or function is of this package."""
    return str(made.__module__).startswith(f"{__name__.partition('.')[0]}.")


def raise_together(comm: MPI.Comm, own: BaseException | None) -> None:
    """Raise the error of this rank (None without one), or of another one; collective."""
    found = comm.allgather(None if own is None else _kind_and_text(own))
    if own is not None:
        raise own
    for rank, other in enumerate(found):
        if other is not None:
            kind, told = other  # a text, or the exit status of a program
            raise _KINDS[kind](f"{told} (on rank {rank})" if isinstance(told, str) else told)


_KINDS = (OSError, ValueError, KeyboardInterrupt, SystemExit, RuntimeError)


def _kind_and_text(error: BaseException) -> tuple[int, str | int]:
    """Index in _KINDS of the error on other ranks, and its text or exit status."""
    for index, kind in enumerate(_KINDS):
        if isinstance(error, kind):
            if isinstance(error, SystemExit) and not isinstance(error.code, str):
                return index, error.code if isinstance(error.code, int) else int(bool(error.code))
            return index, _text(error)
    return len(_KINDS) - 1, f"{type(error).__name__}: {_text(error)}"


def _text(error: BaseException) -> str:
    """Message of an error with its notes."""
    return "; ".join([str(error), *getattr(error, "__notes__", [])])

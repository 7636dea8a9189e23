# SPDX-License-Identifier: MIT
"""Reductions over the ranks, and errors of some ranks raised on all, so that none waits."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx_mortar.algebra.csr import Layout
from dolfinx_mortar.common.arrays import Bools, Floats, Ints, Longs


def maximum(comm: MPI.Comm, *values: float | np.bool_) -> Floats:
    """Largest of each value over all ranks; NaN wins, unlike in MPI_MAX; collective.

    >>> maximum(MPI.COMM_SELF, 1.0, 2.0).tolist()
    [1.0, 2.0]
    """
    defined = [0.0 if value != value else float(value) for value in values]  # NaN is not itself
    result = np.array(defined + [float(value != value) for value in values])
    comm.Allreduce(MPI.IN_PLACE, result, op=MPI.MAX)
    largest, undefined = result[: len(values)], result[len(values) :] > 0.0
    largest[undefined] = np.nan
    return largest


def largest(comm: MPI.Comm, values: npt.NDArray[Any]) -> float:
    """Largest size of any entry on any rank, 0 for none; collective."""
    return float(maximum(comm, np.abs(values).max(initial=0.0))[0])


def norm(comm: MPI.Comm, *parts: Floats) -> float:
    """Euclidean norm of concatenated arrays, over all ranks; collective.

    >>> norm(MPI.COMM_SELF, np.array([3.0]), np.array([4.0]))
    5.0
    """
    return float(np.sqrt(comm.allreduce(float(sum(p @ p for p in parts)))))


def ratio(value: float | np.floating[Any], scale: float | np.floating[Any]) -> float:
    """Return value / scale, with 0 / 0 = 0.

    >>> ratio(1.0, 2.0), ratio(-0.0, 0.0), ratio(1.0, 0.0)
    (0.5, 0.0, inf)
    """
    return 0.0 if value == 0.0 else float(value / scale) if scale > 0.0 else float("inf")


def any_rank(comm: MPI.Comm, *flags: bool | np.bool_) -> Bools:
    """Whether each flag is set on any rank; collective."""
    return maximum(comm, *(float(flag) for flag in flags)) > 0.0


class Relaxed:
    """Changes of values that are iterated, times Aitken's factor; collective.

    Source: U. Kuettler, W. A. Wall, Comput. Mech. 43 (2008) 61-72, eq. 44.
    """

    def __init__(self, comm: MPI.Comm) -> None:
        self.comm = comm
        self.now: Floats | None = None  # values, if they are kept here
        self.last: tuple[Floats, float] | None = None  # change and factor

    def __call__(self, way: Floats) -> Floats:
        """Next change, given that of the iteration."""
        factor = 1.0
        if self.last is not None:
            before, last = self.last
            bend = way - before
            product, square = self.comm.allreduce(np.array([before @ bend, bend @ bend]))
            factor = float(np.clip(-last * product / square, 0.01, 1.0)) if square else 1.0
        self.last = way, factor
        return factor * way


def sums_at_nodes(comm: MPI.Comm, layout: Layout, nodes: Longs, values: Floats) -> Floats:
    """Sums (owned nodes, c) of values (e, c) at global nodes (e,) of any rank; collective.

    The order of summation does not depend on that of messages.
    """
    sums = np.zeros((values.shape[1], layout.size_local))
    if comm.size == 1:  # in the same order
        for addends, result in zip(values.T, sums, strict=True):
            result[:] = np.bincount(nodes, addends, layout.size_local)
        return sums.T
    starts = np.cumsum([0, *comm.allgather(layout.size_local)])
    rank = np.searchsorted(starts, nodes, side="right") - 1
    places = np.column_stack([rank, nodes - starts[rank]]).astype(PETSc.IntType)
    graph = PETSc.SF().create(comm)
    graph.setGraph(layout.size_local, None, places)
    for addends, result in zip(np.ascontiguousarray(values.T), sums, strict=True):
        graph.reduceBegin(MPI.DOUBLE, addends, result, MPI.SUM)
        graph.reduceEnd(MPI.DOUBLE, addends, result, MPI.SUM)
    graph.destroy()
    return sums.T


def values_at(comm: PETSc.Comm, values: Floats, rows: Longs | Ints) -> Floats:
    """Rows (r, k), by their global numbers, of owned rows (n, k); collective."""
    if comm.size == 1:
        return values[rows]
    k = values.shape[1]
    source = PETSc.Vec().createMPI((k * len(values), None), bsize=k, comm=comm)
    source.array[:] = values.ravel()
    wanted = PETSc.IS().createBlock(k, rows.astype(PETSc.IntType), comm=PETSc.COMM_SELF)
    target = PETSc.Vec().createSeq(k * len(rows), comm=PETSc.COMM_SELF)
    PETSc.Scatter().create(source, wanted, target, None).scatter(source, target)
    return target.array_r.reshape(-1, k).copy()


def free_unused(comm: MPI.Comm) -> None:
    """Free PETSc objects without references, which petsc4py only lists on ranks; collective."""
    PETSc.garbage_cleanup(comm)


@contextmanager
def raised_together(comm: MPI.Comm) -> Iterator[None]:
    """Run a block without collective calls; an error of some ranks is raised on all; collective.

    Other ranks raise an OSError, ValueError, KeyboardInterrupt, SystemExit or RuntimeError with the
    text and rank of the first.

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
    """Run a block, raising unchanged the errors of Python code called by PETSc, also Ctrl-C.

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
    """Whether an object's class is of this package: its errors occur on all ranks or none."""
    return is_defined_here(type(thing))


def is_defined_here(made: Callable[..., Any]) -> bool:
    """Whether a class or function is of this package."""
    return str(made.__module__).startswith(f"{__name__.partition('.')[0]}.")


def raise_together(comm: MPI.Comm, own: BaseException | None) -> None:
    """Raise the error of this rank, or else of another rank; collective."""
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
    return "; ".join([str(error), *getattr(error, "__notes__", [])])

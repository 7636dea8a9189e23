# SPDX-License-Identifier: MIT
"""The arguments of the meshes: errors that name argument, value and remedy, on all ranks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from mpi4py import MPI

import numpy as np

from dolfinx_mortar.arguments import is_name, is_number

Checked = TypeVar("Checked")

# A body this many radii away has lost its shape to round-off when gmsh and the tags see it.
FARTHEST = 1e3


def check_on_all_ranks(comm: Any, check: Callable[..., Checked], **given: Any) -> Checked:
    """Return check(**given); if it fails on any rank, all of them raise (collective).

    Raises:
        ValueError: with the message of the first rank whose check fails, or if an argument is not
            the same on all ranks.
    """
    if not isinstance(comm, MPI.Comm):
        raise ValueError(f"comm = {comm!r} must be an MPI communicator, such as MPI.COMM_WORLD.")
    problem = ""
    try:
        result = check(**given)
    except ValueError as error:
        problem = str(error)
    told = comm.allgather((problem, {name: repr(value) for name, value in given.items()}))
    for said, _ in told:
        if said:
            raise ValueError(said)
    for name in given:
        for rank, (_, values) in enumerate(told):
            if values[name] != told[0][1][name]:
                raise ValueError(
                    f"{name} = {told[0][1][name]} on rank 0, but {values[name]} on rank {rank}; "
                    "give all ranks the same."
                )
    return result


def choose(name: str, value: Any, known: Sequence[str]) -> None:
    """Raise a ValueError unless the value is one of the known names."""
    if not is_name(value, known):
        raise ValueError(f"{name} = {value!r} is not known; use one of {tuple(known)}.")


def finite(name: str, value: Any, remedy: str) -> float:
    """Return a finite number."""
    numbers = _numbers(value)
    if numbers is None or np.ndim(value) > 0:
        raise ValueError(f"{name} = {value!r} must be a finite number; {remedy}.")
    return numbers[0]


def positive(name: str, value: Any, parts: str, *, one: bool = False) -> tuple[float, ...]:
    """Return positive, finite numbers.

    Args:
        name: of the argument.
        value: what was given for it.
        parts: what the numbers are, separated by commas; this sets how many there are.
        one: whether one number may stand for all of them.
    """
    count = len(parts.split(","))
    numbers = _numbers(value) or []
    if one and np.ndim(value) == 0:
        numbers = numbers * count
    elif (count == 1) != (np.ndim(value) == 0):
        numbers = []
    if len(numbers) != count or min(numbers) <= 0.0:
        wanted = "one positive number" if count == 1 or one else f"{count} positive numbers"
        more = f", or a tuple of {count}" if one else ""
        raise ValueError(f"{name} = {value!r} must be {wanted}{more}: {parts}; none infinite.")
    return tuple(numbers)


def check_gap(gap: Any, radius: float, thickness: float) -> float:
    """Return the gap [mm] if bodies so far apart, or so deep in each other, make sense."""
    number = finite("gap", gap, "use 0 for bodies that touch in a point")
    deepest, farthest = min(radius, thickness), FARTHEST * radius
    if not -deepest < number <= farthest:
        raise ValueError(
            f"gap = {gap!r} must lie between {-deepest:g}, where one body reaches through the "
            f"other, and {farthest:g}, {FARTHEST:g} times the radius; use 0 for bodies that touch "
            "in a point."
        )
    return number


def _numbers(value: Any) -> list[float] | None:
    """Return a finite number, or the members of a list of some, as a list; None for all else."""
    values = value.tolist() if isinstance(value, np.ndarray | np.generic) else value
    values = list(values) if isinstance(values, list | tuple) else [values]
    if all(map(is_number, values)):
        return [float(v) for v in values]
    return None

# SPDX-License-Identifier: MIT
"""Ramps: values of Constants over load levels, given by tables."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx import fem
from dolfinx_mortar.common.agreement import check_same_on_all_ranks
from dolfinx_mortar.common.arguments import Rule, array, check, check_optional, instance
from dolfinx_mortar.common.arrays import SAME, Floats

Rows = list[list[float]]
"""A table in JSON: in every row the level, then the components of the value."""


@dataclass(frozen=True)
class Ramp:
    """A Constant and its values over load levels, linear between the rows of a table."""

    constant: fem.Constant
    levels: Floats  # (n,), increasing
    values: Floats  # (n, components)

    def at(self, level: float) -> Floats:
        """Components of the value at a level within the table."""
        return np.array([np.interp(level, self.levels, column) for column in self.values.T])

    def set(self, level: float) -> None:
        """Set the Constant to its value at a level."""
        self.constant.value[...] = self.at(level).reshape(self.constant.value.shape)

    @property
    def rows(self) -> Rows:
        """The table."""
        return [[*map(float, row)] for row in np.column_stack([self.levels, self.values])]


def read_ramps(comm: MPI.Comm, ramp: Any) -> list[Ramp]:
    """Ramps of {Constant: [(level, value), ...]}; collective.

    Raises:
        ValueError: on all ranks, for an invalid table, with its number and the remedy.
    """
    given = ramp
    if isinstance(ramp, Mapping):
        given = [(constant, _listed(table)) for constant, table in ramp.items()]
    check_same_on_all_ranks(comm, ramp=given)
    remedy = "give a dictionary {Constant: [(level, value), ...]}"
    check_optional("ramp", ramp, instance(Mapping, remedy))
    return [_read(f"ramp: table {k}", *one) for k, one in enumerate(given or (), start=1)]


def _listed(table: Any) -> Any:
    rows = isinstance(table, Iterable) and not isinstance(table, Mapping | str | bytes)
    return list(table) if rows else table


def _read(name: str, constant: Any, table: Any) -> Ramp:
    remedy = "give a dolfinx Constant, such as the value of a Dirichlet condition or a traction"
    check(f"{name}: the key", constant, instance(fem.Constant, remedy))
    shape = constant.value.shape
    wanted = f"give rows (level, value), at least two, with values of shape {shape}"
    many = isinstance(table, list) and len(table) > 1
    check(name, table, Rule(wanted, lambda table: table if many else None))
    rule = Rule(f"{wanted}, in finite numbers", partial(_row, shape))
    rows = [check(f"{name}: row {k}", row, rule) for k, row in enumerate(table, start=1)]
    levels, values = np.array(rows)[:, 0], np.array(rows)[:, 1:]
    if (np.diff(levels) <= 0.0).any():
        raise ValueError(f"{name} has levels {levels.tolist()}: they must rise from row to row")
    return Ramp(constant, levels, values)


def _row(shape: tuple[int, ...], row: Any) -> Floats | None:
    if not isinstance(row, Sequence | np.ndarray) or len(row) != 2:
        return None
    level, value = array(()).read(row[0]), array(shape).read(row[1])
    return None if level is None or value is None else np.append(level, value)


def notes_on_unread(given: Mapping[str, Any], read: Sequence[Any] | None) -> list[str]:
    """A note for each Constant that a run sets and nothing reads, by the addresses of values.

    `read` are the Constants that steps read, None if unknown.
    """
    if read is None:
        return []
    places = {_place(constant) for constant in read}
    return [
        f"{name} is for a Constant that nothing in the problem reads, so that it changes "
        "nothing: give the Constant itself to the form, law or condition, "
        "dirichletbc(push, ..) and not dirichletbc(push.value, ..), which copies its value"
        for name, constant in given.items()
        if _place(constant) not in places
    ]


def _place(constant: Any) -> int:
    return int(np.asarray(constant.value).__array_interface__["data"][0])


def check_range(ramps: Sequence[Ramp], levels: Sequence[float]) -> None:
    """Raise a ValueError unless all tables contain all levels of a run, up to round-off."""
    slack = SAME * max(map(abs, levels))
    for k, ramp in enumerate(ramps, start=1):
        first, last = ramp.levels[[0, -1]]
        if min(levels) < first - slack or max(levels) > last + slack:
            raise ValueError(
                f"ramp: table {k} holds levels from {first:g} to {last:g}, but the run goes from "
                f"{levels[0]:g} over levels between {min(levels):g} and {max(levels):g}: add rows"
            )


def difference(saved: Sequence[Rows], ramps: Sequence[Ramp], walked: Sequence[float]) -> str:
    """How tables differ from saved ones between the levels reached (`walked`), or ""."""
    if len(saved) != len(ramps):
        return f"there are {len(ramps)} tables now, {len(saved)} then"
    low, high = min(walked), max(walked)
    for k, (rows, ramp) in enumerate(zip(saved, ramps, strict=True), start=1):
        table = np.array(rows)
        old = Ramp(ramp.constant, table[:, 0], table[:, 1:])
        if old.values.shape[1] != ramp.values.shape[1]:
            return f"values of table {k} have another shape than then"
        # piecewise linear functions are equal if they agree at the nodes of both
        for level in np.unique(np.clip([low, high, *old.levels, *ramp.levels], low, high)):
            then, now = old.at(level), ramp.at(level)
            if (np.abs(then - now) > SAME * np.abs(old.values).max()).any():
                return (
                    f"table {k} gives {now.tolist()} at level {level:g} now, {then.tolist()} then"
                )
    return ""

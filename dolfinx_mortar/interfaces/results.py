# SPDX-License-Identifier: MIT
"""Results of interfaces: missing before the first step, and merged where slave sides meet."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from dolfinx import fem

if TYPE_CHECKING:
    from dolfinx_mortar.interfaces.interface import Interface


class NoResult(RuntimeError, AttributeError):
    """A result was asked for before the first step; also an AttributeError, for ``hasattr``."""

    def __init__(self, interface: Interface, name: str) -> None:
        """Say what is missing, and what to do."""
        super().__init__(f"{interface} has no {name} yet: solve a step first, newton(problem)")


class Result:
    """Stands for a result until a step sets it: asking for it is an error that says so."""

    def __set_name__(self, owner: type, name: str) -> None:
        """Take the name of the attribute."""
        self.name = name

    def __get__(self, interface: Interface | None, owner: type) -> Any:
        """Raise the error; a result that has been set hides this."""
        if interface is None:
            return self
        raise NoResult(interface, self.name)


def merge_results(
    interfaces: Sequence[Interface], name: str, function: fem.Function
) -> fem.Function:
    """Fill a Function with "pressure", "gap" or "status" of all interfaces; collective.

    A node on several slave sides has the value of the interface that gave it a multiplier, then of
    the first one in which it faces the master. Off the slave sides the value is 0.
    """
    owned = slice(None, interfaces[0].n_owned)
    merged = np.zeros(interfaces[0].n_owned)
    best = np.full(len(merged), -1)
    for interface in interfaces:
        nodes = interface.slave_surface.nodes[: interface.slave_surface.owned]
        facing = ~np.isnan(interface.gap.x.array[nodes])
        claim = np.where(facing, 1 + interface.carries, 0)
        take = claim > best[nodes]
        best[nodes[take]] = claim[take]
        values = getattr(interface, "active" if name == "status" else name).x.array
        merged[nodes[take]] = values[nodes[take]]
    function.x.array[owned] = merged
    function.x.scatter_forward()
    return function

# SPDX-License-Identifier: MIT
"""Offset of the gap of a contact, and Archard's wear, which makes it grow."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from dolfinx import fem
from dolfinx_mortar.common import arguments
from dolfinx_mortar.common.arguments import check, check_optional
from dolfinx_mortar.common.arrays import Floats, Ints
from dolfinx_mortar.interfaces.constraints import (
    FORCE,
    Limit,
    check_field,
    present_force,
    values_at_nodes,
)
from dolfinx_mortar.interfaces.interface import Interface
from dolfinx_mortar.interfaces.results import NoResult

PATH: arguments.Rule[Any] = arguments.Rule(
    "give a scalar Constant, the length of the path so far, to be set in every step",
    lambda value: FORCE.read(value) if isinstance(value, fem.Constant) else None,
)


@dataclass(frozen=True)
class Archard:
    """Wear of the slave side: the depth h along its normal grows by dh = k p ds in a step.

    p is the pressure at the end of the step, ds the distance that the sides slide in it. Implicit
    wear is part of the step, for any k ds: gap + k ds p >= 0, p >= 0 and one of them is 0. Explicit
    wear follows at the commit; it is stable for k ds K_jj / D_jj < 2, about k ds E < 2 facets, with
    the stiffness K_jj of a node: a longer step fails.

    Args:
        k: wear per pressure and length, >= 0 (1/pressure): a number, a scalar Constant, or a scalar
            Lagrange Function.
        slip: Constant, length of the prescribed path of sliding from the start on, of which a step
            takes its change: out of the plane, or in cycles. None for the contact's own slips.
        implicit: whether the pressure feels the wear of the step.
        most: largest depth that a step may add; a step that adds more fails, and may be cut.

    Raises:
        ValueError: for an invalid argument.

    Source: J. F. Archard, J. Appl. Phys. 24 (1953) 981-988.
    """

    k: Limit
    slip: fem.Constant | None = None
    implicit: bool = True
    most: float | None = None

    def __post_init__(self) -> None:
        if not isinstance(check_field("wear: k", self.k), fem.Constant | fem.Function):
            check("wear: k", self.k, arguments.NOT_NEGATIVE)
        check_optional("wear: slip", self.slip, PATH)
        check("wear: implicit", self.implicit, arguments.FLAG)
        check_optional("wear: most", self.most, arguments.POSITIVE)

    @property
    def path(self) -> float:
        """Present length; a ValueError for NaN and infinity."""
        return 0.0 if self.slip is None else present_force("wear: slip", self.slip)


class Wearing(Interface):
    """Interface with an offset of its gap, and perhaps with wear."""

    offset: Limit | None = None
    wear: Archard | None = None
    _path = 0.0  # at the last commit

    def set_offset(self, offset: Any, wear: Any) -> None:
        """Check and set both; a ValueError for own slips without friction."""
        self.offset = None if offset is None else check_field("offset", offset)
        law = arguments.instance(Archard, "give a dolfinx_mortar.interfaces.wear.Archard(k)")
        self.wear = check_optional("wear", wear, law)
        if self.wear is not None and self.wear.slip is None and self.law is None:
            raise ValueError(
                "wear: slip is None, the contact's own slips, but it has no friction to measure "
                "them: give slip=, or friction= (perhaps a small one)"
            )

    def take(self, owner: object, V: fem.FunctionSpace) -> None:
        """Assign to a problem, without wear; collective."""
        super().take(owner, V)
        if self.wear is not None:
            scalar, self._path = self.gap.function_space, self.wear.path
            self.nodal |= {
                n: fem.Function(scalar, name=n) for n in ("wear_depth", "committed_depth")
            }

    @property
    def wear_depth(self) -> fem.Function:
        """Depth of wear of the slave side, part of the gap."""
        if self.wear is None:
            raise NoResult(self, "wear_depth", "it has no wear: give wear=")
        return self._function("wear_depth")

    def apart(self, V: fem.FunctionSpace, nodes: Ints) -> Floats | None:
        """Offset and depth of wear (n,), or None; a ValueError for NaN and infinity; collective."""
        found = None
        if self.offset is not None:
            found = values_at_nodes("offset", self.offset, self.gap.function_space, signed=True)[
                nodes
            ]
        if self.wear is not None:
            found = self.wear_depth.x.array[nodes] + (0.0 if found is None else found)
        return found

    def wear_rates(self, nodes: Ints, slid: Floats) -> Floats:
        """Wear per pressure (n,), k ds, for own slips (n,) in the step; collective."""
        assert self.wear is not None
        k = values_at_nodes("wear: k", self.wear.k, self.gap.function_space, signed=False)[nodes]
        way = slid if self.wear.slip is None else np.abs(self.wear.path - self._path)
        return k * way

    def wear_by(self, depth: Floats, nodes: Ints) -> None:
        """Set the depth after the step, with (n,) at owned nodes more than before; collective."""
        found = self.wear_depth
        found.x.array[:] = self.nodal["committed_depth"].x.array
        found.x.array[nodes] += depth
        found.x.scatter_forward()

    def state(self, ended: bool) -> dict[str, Floats]:
        """See `Interface.state`: the path; the depth is a Function that is committed with it."""
        if self.wear is None:
            return super().state(ended)
        path = self.wear.path if ended else self._path
        return super().state(ended) | {"path": np.array([path]), "commits": np.array([1.0 * ended])}

    def restore(self, state: Mapping[str, Floats]) -> None:
        """See `Interface.restore`."""
        super().restore(state)
        if self.wear is not None:
            self._path = float(state["path"][0])
            if state["commits"][0]:
                self.nodal["committed_depth"].x.array[:] = self.wear_depth.x.array

# SPDX-License-Identifier: MIT
"""Values computed at the integration points of a region before each assembly."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dolfinx import fem, mesh
from dolfinx_mortar.arrays import Floats, Ints
from dolfinx_mortar.materials.response import Response
from dolfinx_mortar.materials.tensor import tensor_of
from dolfinx_mortar.solid.laws import Region
from ufl.core.expr import Expr


class PointValuesOfRegion(ABC):
    """What is found at the points of a region before anything is assembled.

    Attributes:
        region: the law and its cells.
        response: of the law, in terms of what is found.
    """

    response: Response

    def __init__(
        self,
        region: Region,
        strain: Expr,
        state: Mapping[str, fem.Function],
        inputs: Sequence[fem.Function],
        degree: int,
    ) -> None:
        """Create what is filled; the inputs are what the 3x3 strain depends on; collective."""
        self.region = region
        self._committed = {name: state[name] for name in region.law.state}
        self._inputs = [*inputs, *self._committed.values(), region.parameters.function]
        self._seen: list[Floats] = []
        self._create(strain, degree)

    @abstractmethod
    def _create(self, strain: Expr, degree: int) -> None:
        """Create the Functions and the response, compile; collective."""

    def fill(self) -> None:
        """Evaluate the law, unless nothing has changed; without communication.

        Raises:
            ValueError: if the law fails; the values are then as before.
        """
        now = [f.x.array for f in self._inputs]
        if len(self._seen) == len(now) and all(map(np.array_equal, now, self._seen)):
            return
        self._evaluate()
        self._seen = self._copies(now)

    def _copies(self, now: list[Floats]) -> list[Floats]:
        """Return copies of the inputs that have been evaluated."""
        return [values.copy() for values in now]

    def settle(self) -> None:  # noqa: B027 - most have evaluated everything by then
        """Evaluate what is needed only at the end of a step; without communication."""

    def _state_at(self, cells: Ints) -> dict[str, Floats]:
        """Return the committed internal variables at the points of cells, (q,) or (q, 3, 3)."""
        shapes = self.region.law.state
        return {
            name: tensor_of(at_points(f, cells)) if shapes[name] else at_points(f, cells)[:, 0]
            for name, f in self._committed.items()
        }

    @abstractmethod
    def _evaluate(self) -> None:
        """Fill the Functions."""


def middle_of(domain: mesh.Mesh, cell: int) -> str:
    """Return the midpoint of a local cell in words."""
    cells = np.array([cell], dtype=np.int32)
    x = mesh.compute_midpoints(domain, domain.topology.dim, cells)[0]
    return "(" + ", ".join(f"{v:.4g}" for v in x[: domain.geometry.dim]) + ")"


def at_points(f: fem.Function, cells: Any) -> Floats:
    """Return the values (q, components) at the points of some cells."""
    dofmap = f.function_space.dofmap
    return np.asarray(f.x.array.reshape(-1, dofmap.bs)[dofmap.list[cells].ravel()])


def set_points(f: fem.Function, cells: Any, values: Floats) -> None:
    """Set the values (q, components) at the points of some cells."""
    dofmap = f.function_space.dofmap
    f.x.array.reshape(-1, dofmap.bs)[dofmap.list[cells].ravel()] = values


def pairs(size: int) -> list[tuple[int, int]]:
    """Return rows and columns of the upper triangle, row by row."""
    return [(i, j) for i in range(size) for j in range(i, size)]


def symmetric_rows(upper: fem.Function, size: int) -> list[list[Expr]]:
    """Return the rows of a symmetric matrix that is stored by its upper triangle."""
    number = {pair: k for k, pair in enumerate(pairs(size))}
    return [[upper[number[min(i, j), max(i, j)]] for j in range(size)] for i in range(size)]

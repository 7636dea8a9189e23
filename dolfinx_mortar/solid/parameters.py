# SPDX-License-Identifier: MIT
"""Parameters of a law in its cells: numbers, and what the user may change between steps."""

import re
from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx import fem
from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.arrays import Bools, Floats, Ints
from dolfinx_mortar.materials.protocol import Law
from dolfinx_mortar.materials.ranges import grouped, named_parameters, wrong_values
from dolfinx_mortar.solid.sources import (
    Followed,
    Part,
    check_source,
    create_source,
    middle_of,
    point_function,
)
from ufl.checks import is_cellwise_constant
from ufl.core.expr import Expr


class ParameterTable(Followed):
    """All parameters of a law, one value per cell, or per integration point if one needs that.

    Attributes:
        function: one component per parameter, DG0 or at the integration points.
        symbols: the parameters by name, as UFL.
    """

    def __init__(
        self,
        u: fem.Function,
        law: Law,
        materials: Sequence[Any],
        cells: Sequence[Ints],
        degree: int,
    ) -> None:
        """Create the parameters of materials of one law, with the numbers in; collective.

        What may change is filled in by `follow`.

        Args:
            u: displacement, on which no parameter may depend.
            materials: all of one class.
            cells: local cells of each, ghosts included.
            degree: of the quadrature of the solid.

        Raises:
            ValueError: on all ranks, if a parameter depends on u, belongs to another mesh or is
                known at other points than those of the solid.
        """
        self._law, self._cells = law, np.sort(np.concatenate(cells))
        self._names = names = list(named_parameters(materials[0]))
        given = [
            (on, list(named_parameters(material).values()))
            for material, on in zip(materials, cells, strict=True)
        ]
        moving = [
            (on, i, value)
            for on, values in given
            for i, value in enumerate(values)
            if isinstance(value, Expr)
        ]
        for _, i, value in moving:
            check_source(u, f"{law.name}: {names[i]}", value)
        width = max(len(names), 1)  # a law may have no parameter at all
        if all(is_cellwise_constant(value) for _, _, value in moving):
            space = fem.functionspace(u.function_space.mesh, ("DG", 0, (width,)))
            function = fem.Function(space)
        else:
            function = point_function(u.function_space.mesh, degree, (width,))
        dofmap = function.function_space.dofmap
        for on, values in given:
            row = [0.0 if isinstance(value, Expr) else value for value in values] or [0.0]
            function.x.array.reshape(-1, width)[dofmap.list[on]] = row
        sources = [
            create_source(on, Part(f"{law.name}: {names[i]}", function, value, slice(i, i + 1)))
            for on, i, value in moving
        ]
        super().__init__(function, sources)
        self.symbols = grouped({name: function[i] for i, name in enumerate(names)})

    def values(self, cells: Ints, points: int) -> SimpleNamespace:
        """Return the parameters by name at so many points of each cell, (cells * points,) each."""
        return grouped(self._by_name(self._table(cells, points)))

    def _table(self, cells: Ints, points: int) -> Floats:
        """Return the parameters (cells * points, parameters) at so many points of each cell."""
        dofs = self.function.function_space.dofmap.list[cells]
        table = self.function.x.array.reshape(-1, max(len(self._names), 1))[dofs]
        table = np.broadcast_to(table, (len(cells), points, table.shape[2]))
        return np.asarray(table.reshape(len(cells) * points, table.shape[2]))

    def _by_name(self, table: Floats) -> dict[str, Floats]:
        """Return the columns of a table (q, parameters) by name."""
        return {name: table[:, i] for i, name in enumerate(self._names)}

    def judge(self) -> None:
        """Raise ValueError on all ranks if something is out of range in an owned cell; collective.

        Also where the law fails to tell.
        """
        V = self.function.function_space
        domain, points = V.mesh, V.dofmap.list.shape[1]
        size = domain.topology.index_map(domain.topology.dim).size_local
        owned = self._cells[self._cells < size]
        values = self._by_name(self._table(owned, points))
        wrong: dict[str, Bools] = {}
        with raised_together(domain.comm):
            if len(owned):  # rules of users need not handle empty arrays
                law = self._law
                wrong = wrong_values(law.name, law.ranges, law.conditions, values)
        rules = sorted(set().union(*domain.comm.allgather(set(wrong))))
        for rule in rules[:1]:
            where = wrong.get(rule, np.zeros(len(owned) * points, dtype=bool))
            bad = where.reshape(-1, points).any(axis=1)
            count = domain.comm.allreduce(int(bad.sum()), op=MPI.SUM)
            places = domain.comm.allgather(middle_of(domain, owned[bad][0]) if bad.any() else "")
            numbers = _extent(domain.comm, {name: v[where] for name, v in values.items()}, rule)
            raise ValueError(
                f"{self._law.name}: {rule} does not hold in {count} cells, such as the one "
                f"around {next(filter(None, places))}; there {numbers}."
            )


def _extent(comm: MPI.Comm, values: Mapping[str, Floats], rule: str) -> str:
    """Return the extent of the parameters that a rule names, in words; collective."""
    parts = []
    for name in sorted(set(values) & set(re.findall(r"\w+", rule))):
        low = np.nanmin(values[name], initial=np.inf)
        high = np.nanmax(values[name], initial=-np.inf)
        low, high = comm.allreduce(float(low), op=MPI.MIN), comm.allreduce(float(high), op=MPI.MAX)
        undefined = comm.allreduce(bool(np.isnan(values[name]).any()), op=MPI.LOR)
        parts.append(f"{name} is NaN" if undefined else f"{name} is {low:.6g} to {high:.6g}")
    return ", ".join(parts)

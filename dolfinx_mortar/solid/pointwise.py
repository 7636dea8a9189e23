# SPDX-License-Identifier: MIT
"""Laws that are functions of numbers in a solid: Functions that they fill before each assembly.

The compiled forms know their stress and tangent as values at the integration points.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from mpi4py import MPI

import numba
import numpy as np

import basix.ufl
import ufl
from dolfinx import fem, mesh
from dolfinx_mortar import compat
from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.materials.pointwise import PointValues, stored, tensor_of, values_at_points
from dolfinx_mortar.materials.protocol import is_pointwise
from dolfinx_mortar.materials.response import Response
from dolfinx_mortar.materials.tensor import INDEX, from_components, to_components
from dolfinx_mortar.solid.laws import Region
from dolfinx_mortar.solid.state import create_field
from ufl.core.expr import Expr


class PointwiseFields:
    """Stress, tangent and new state of a pointwise law at the points of its cells.

    Attributes:
        region: the law and its cells.
        response: the same for the forms.
    """

    def __init__(
        self,
        region: Region,
        strain: Expr,
        state: Mapping[str, fem.Function],
        inputs: Sequence[fem.Function],
        degree: int,
    ) -> None:
        """Create the Functions; collective.

        Args:
            region: the law and its cells.
            strain: 3x3.
            state: committed internal variables of the solid.
            inputs: what the strain depends on.
            degree: of the quadrature.
        """
        self.region = region
        domain = region.parameters.function.function_space.mesh
        self._strain = create_field(domain, degree, (3, 3), "strain")
        self._stress = create_field(domain, degree, (3, 3), "stress")
        size = self._stress.function_space.dofmap.bs
        element = basix.ufl.quadrature_element(
            domain.basix_cell(),
            value_shape=(size * (size + 1) // 2,),
            scheme="default",
            degree=degree,
        )
        self._tangent = fem.Function(fem.functionspace(domain, element))
        points = compat.interpolation_points(self._strain.function_space)
        self._measured = fem.Expression(to_components(strain, size), points)
        self._committed = {name: state[name] for name in region.law.state}
        self._new = {name: f.copy() for name, f in self._committed.items()}
        self._inputs = [*inputs, *self._committed.values(), region.parameters.function]
        self._seen: list[Floats] = []

    @property
    def response(self) -> Response:
        """The values as UFL, for the forms."""
        new = {
            name: from_components(f) if self.region.law.state[name] else f
            for name, f in self._new.items()
        }
        return Response(from_components(self._stress), None, new, self._change)

    def fill(self) -> None:
        """Evaluate the law, unless nothing has changed; without communication.

        Raises:
            ValueError: if the law raises, returns something of another form, or gives NaN; the
                values are then as before.
        """
        now = [f.x.array for f in self._inputs]
        if len(self._seen) == len(now) and all(map(np.array_equal, now, self._seen)):
            return
        cells = self.region.cells
        self._strain.interpolate(self._measured, cells)
        strain = tensor_of(_at(self._strain, cells))
        state = {
            name: tensor_of(_at(f, cells)) if self.region.law.state[name] else _at(f, cells)[:, 0]
            for name, f in self._committed.items()
        }
        points = self._strain.function_space.dofmap.list.shape[1]
        p = self.region.parameters.values(cells, points)
        found = values_at_points(self.region.law, strain, state, p)
        self._judge(found, strain, points)
        size = self._stress.function_space.dofmap.bs
        _set(self._stress, cells, stored(found.stress, size))
        _set(self._tangent, cells, packed(found.tangent, size))
        for name, f in self._new.items():
            new = found.state[name]
            _set(f, cells, stored(new, size) if new.ndim == 3 else new[:, None])
        self._seen = [values.copy() for values in now]

    def _change(self, direction: Expr) -> Expr:
        """Return the tangent times a direction, 3x3."""
        size = self._stress.function_space.dofmap.bs
        e, rows = to_components(direction, size), _matrix(self._tangent, size)
        # a stored shear stands for two components
        sums = [
            sum(rows[i][j] * (1 if j < 3 else 2) * e[j] for j in range(size)) for i in range(size)
        ]
        return from_components(ufl.as_vector(sums))

    def _judge(self, found: PointValues, strain: Floats, points: int) -> None:
        """Raise ValueError if something is NaN, naming the first point."""
        undefined = np.flatnonzero(found.undefined)
        if undefined.size:
            cell, point = divmod(int(undefined[0]), points)
            domain = self._stress.function_space.mesh
            x = mesh.compute_midpoints(
                domain, domain.topology.dim, self.region.cells[cell : cell + 1]
            )[0]
            middle = ", ".join(f"{v:.4g}" for v in x[: domain.geometry.dim])
            values = ", ".join(f"{v:.6g}" for v in stored(strain[undefined[:1]])[0])
            raise ValueError(
                f"{self.region.law.__name__}.update gives NaN or infinity at {undefined.size} "
                f"integration points, first at point {point} of the cell around ({middle}), where "
                f"the strain (xx, yy, zz, xy, yz, xz) is ({values})."
            )


def create_pointwise(
    regions: Sequence[Region],
    strain: Expr,
    state: Mapping[str, fem.Function],
    inputs: Sequence[fem.Function],
    degree: int,
) -> dict[type, PointwiseFields]:
    """Return the fields of the laws that are pointwise, by class; collective, see the class."""
    return {
        region.law: PointwiseFields(region, strain, state, inputs, degree)
        for region in regions
        if is_pointwise(region.law)
    }


def fill_pointwise(comm: MPI.Comm, fields: Mapping[type, PointwiseFields]) -> None:
    """Evaluate pointwise laws where something has changed; collective if there are any.

    Raises:
        ValueError: on all ranks, if a law fails on any.
    """
    if fields:
        with raised_together(comm):
            for field in fields.values():
                field.fill()


def _at(f: fem.Function, cells: Any) -> Floats:
    """Return the values (q, components) at the points of some cells."""
    dofmap = f.function_space.dofmap
    return np.asarray(f.x.array.reshape(-1, dofmap.bs)[dofmap.list[cells].ravel()])


def _set(f: fem.Function, cells: Any, values: Floats) -> None:
    """Set the values (q, components) at the points of some cells."""
    dofmap = f.function_space.dofmap
    f.x.array.reshape(-1, dofmap.bs)[dofmap.list[cells].ravel()] = values


def _pairs(size: int) -> list[tuple[int, int]]:
    """Return rows and columns of the upper triangle, row by row."""
    return [(i, j) for i in range(size) for j in range(i, size)]


def packed(tangent: Floats, size: int) -> Floats:
    """Return the upper triangle of the stored part of tangents (q, 3, 3, 3, 3), row by row.

    Entry (I, J) is the mean of what the symmetries of strain, stress and energy make equal.
    """
    terms = np.empty((len(_pairs(size)), 4), dtype=np.int64)
    for t, (a, b) in enumerate(_pairs(size)):
        (i, j), (k, m) = INDEX[a], INDEX[b]
        ways = [(i, j, k, m), (i, j, m, k), (k, m, i, j), (k, m, j, i)]
        terms[t] = [np.ravel_multi_index(way, (3, 3, 3, 3)) for way in ways]
    return np.asarray(_means(np.ascontiguousarray(tangent).reshape(len(tangent), 81), terms))


@numba.njit(cache=True)
def _means(values, terms):  # type: ignore[no-untyped-def]
    """Return the means (q, t) of the columns terms (t, 4) of values (q, n).

    By array expressions they would take as long as all the rest of an assembly.
    """
    means = np.empty((len(values), len(terms)))
    for q in range(len(values)):
        for t in range(len(terms)):
            a, b, c, d = terms[t]
            means[q, t] = (values[q, a] + values[q, b] + values[q, c] + values[q, d]) / 4
    return means


def _matrix(upper: fem.Function, size: int) -> list[list[Expr]]:
    """Return the rows of a symmetric matrix that is stored by its upper triangle."""
    number = {pair: k for k, pair in enumerate(_pairs(size))}
    return [[upper[number[min(i, j), max(i, j)]] for j in range(size)] for i in range(size)]

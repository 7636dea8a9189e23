# SPDX-License-Identifier: MIT
"""Laws of arrays at finite strain: energy, stress P and dP/dF at the integration points.

What `pointwise.PointwiseFields` is for a small strain, see `materials.finite_law`. P and F have
five entries that may be non-zero in the plane and on rings, nine in space, and the symmetric
tangent 15 or 45.
"""

from collections.abc import Sequence

import numpy as np

import ufl
from dolfinx import fem
from dolfinx_mortar import compat
from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.arrays import Floats, Ints
from dolfinx_mortar.materials.finite_law import FiniteValues, create_finite_law
from dolfinx_mortar.materials.response import Response
from dolfinx_mortar.materials.tensor import GRADIENT, stored
from dolfinx_mortar.solid.at_points import (
    PointValuesOfRegion,
    middle_of,
    pairs,
    set_points,
    symmetric_rows,
)
from dolfinx_mortar.solid.sources import point_function
from dolfinx_mortar.solid.state import as_tensors
from ufl.core.expr import Expr


class FinitePointFields(PointValuesOfRegion):
    """Energy, stress P, tangent and new state of a law of arrays at F.

    Attributes:
        normal: in plane stress the stretch out of the plane less 1, zero in other regions.
    """

    normal: fem.Function | None = None

    def _create(self, strain: Expr, degree: int) -> None:
        """Create the Functions; compile F, which is what `strain` is; collective."""
        domain = self.region.parameters.function.function_space.mesh
        self._entries = GRADIENT[domain.geometry.dim]
        with raised_together(domain.comm):
            has_energy = self._create_law(domain.geometry.dim)
        size = len(self._entries)
        self._stress = point_function(domain, degree, (size,))
        self._tangent = point_function(domain, degree, (len(pairs(size)),))
        self._energy = point_function(domain, degree) if has_energy else None
        if self.region.law.plane_stress:
            self.normal = point_function(domain, degree)
        points = compat.interpolation_points(self._stress.function_space)
        self._gradient = fem.Expression(self._wanted(strain), points)
        self._new = {name: f.copy() for name, f in self._committed.items()}
        new, P = as_tensors(self.region, self._new), self._tensor(list(self._stress))
        self.response = Response(P, self._energy, new, self._change)

    def _create_law(self, dimension: int) -> bool:
        """Create the law at points; return whether it has a potential."""
        self._law = create_finite_law(self.region.law)
        return self._law.has_energy

    def _wanted(self, F: Expr) -> Expr:
        """Return what is evaluated at the points before the law is called."""
        return ufl.as_vector([F[i, j] for i, j in self._entries])

    def _tensor(self, entries: Sequence[Expr]) -> Expr:
        """Return the 3x3 tensor of stored entries."""
        rows: list[list[Expr]] = [[ufl.as_ufl(0.0)] * 3 for _ in range(3)]
        for (i, j), entry in zip(self._entries, entries, strict=True):
            rows[i][j] = entry
        return ufl.as_tensor(rows)

    def _change(self, direction: Expr) -> Expr:
        """Return dP/dF : direction, 3x3."""
        size = len(self._entries)
        f = [direction[i, j] for i, j in self._entries]
        rows = symmetric_rows(self._tangent, size)
        return self._tensor([sum(rows[a][b] * f[b] for b in range(size)) for a in range(size)])

    def _evaluate(self) -> None:
        """Call the law.

        Raises:
            ValueError: if F has no positive determinant, or the law raises, returns something of
                another form, or gives NaN.
        """
        cells, size = self.region.cells, len(self._entries)
        V = self._stress.function_space
        points, (rows, columns) = V.dofmap.list.shape[1], zip(*self._entries, strict=True)
        F = np.zeros((len(cells) * points, 3, 3))
        F[:, rows, columns] = np.asarray(self._gradient.eval(V.mesh, cells)).reshape(-1, size)
        state = self._state_at(cells)
        self._judge(np.linalg.det(F) <= 0.0, F, "is not called where det F is not positive:")
        found = self._law.evaluate(F, state, self.region.parameters.values(cells, points))
        self._judge(found.undefined, F, "gives NaN or infinity")
        self._take(found, np.array(rows), np.array(columns))

    def _take(self, found: FiniteValues, rows: Ints, columns: Ints) -> None:
        """Store what a law has found."""
        cells = self.region.cells
        a, b = np.array(pairs(len(self._entries))).T
        tangent = found.tangent[:, rows[a], columns[a], rows[b], columns[b]]
        mirrored = found.tangent[:, rows[b], columns[b], rows[a], columns[a]]
        set_points(self._stress, cells, found.stress[:, rows, columns])
        set_points(self._tangent, cells, (tangent + mirrored) / 2)
        if self._energy is not None:
            assert found.energy is not None
            set_points(self._energy, cells, found.energy[:, None])
        if self.normal is not None:
            assert found.normal is not None
            set_points(self.normal, cells, found.normal[:, None])
        for name, f in self._new.items():
            new: Floats = found.state[name]
            components = f.function_space.dofmap.bs
            set_points(f, cells, stored(new, components) if new.ndim == 3 else new[:, None])

    def _judge(self, bad: np.ndarray, F: Floats, what: str) -> None:
        """Raise ValueError if something is wrong at some points, naming the first."""
        wrong = np.flatnonzero(bad)
        if wrong.size:
            points = self._stress.function_space.dofmap.list.shape[1]
            cell, point = divmod(int(wrong[0]), points)
            place = middle_of(self._stress.function_space.mesh, self.region.cells[cell])
            values = ", ".join(f"{v:.6g}" for v in F[wrong[0]].ravel())
            raise ValueError(
                f"{self.region.law.name} {what} at {wrong.size} integration points, first at point "
                f"{point} of the cell around {place}, where F (row by row) is ({values})."
            )

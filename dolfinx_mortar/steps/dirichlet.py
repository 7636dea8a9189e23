# SPDX-License-Identifier: MIT
"""Dirichlet conditions as marks and values of dofs, whichever ranks have located them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dolfinx import fem, la
from dolfinx_mortar.arrays import Bools, Floats


def prescribed_dofs(V: fem.FunctionSpace, bcs: Sequence[fem.DirichletBC]) -> Bools:
    """Return (local nodes, d): which displacement components are prescribed; collective."""
    d = V.dofmap.index_map_bs
    marks = la.vector(V.dofmap.index_map, d)
    marks.array[:] = 0.0
    for bc in bcs:
        marks.array[bc.dof_indices()[0]] = 1.0
    marks.scatter_reverse(la.InsertMode.add)
    marks.scatter_forward()
    return np.asarray(marks.array > 0.0).reshape(-1, d)


def prescribed_values(V: fem.FunctionSpace, bcs: Sequence[fem.DirichletBC]) -> Floats:
    """Return the prescribed values at owned dofs, 0 where there is none; collective."""
    d, layout = V.dofmap.index_map_bs, V.dofmap.index_map
    values, known = np.zeros((2, d * (layout.size_local + layout.num_ghosts)))
    for bc in bcs:
        bc.set(values)
        known[bc.dof_indices()[0]] = 1.0
    shared = la.vector(layout, 2 * d)
    table = shared.array.reshape(-1, 2 * d)
    table[:] = np.hstack([(known * values).reshape(-1, d), known.reshape(-1, d)])
    shared.scatter_reverse(la.InsertMode.add)
    own = slice(None, d * layout.size_local)
    total, count = (table[: layout.size_local, part].ravel() for part in np.s_[:d, d:])
    # The owner's own value is exact; the mean of the others' stands in where it has none.
    return np.where(known[own] > 0, values[own], total / np.maximum(count, 1.0))


@dataclass(frozen=True)
class Dirichlet:
    """Dirichlet conditions of a problem; values are read anew at every step."""

    V: fem.FunctionSpace
    bcs: list[fem.DirichletBC]
    fixed: Bools  # (local nodes, d) which components are prescribed

    @property
    def owned(self) -> Bools:
        """Which components of the owned nodes are prescribed, (n, d)."""
        return np.asarray(self.fixed[: self.V.dofmap.index_map.size_local])

    def values(self) -> Floats:
        """Return the prescribed values at owned dofs, 0 where there is none; collective."""
        return prescribed_values(self.V, self.bcs)

    def increment(self, target: Floats, u: Floats) -> Floats:
        """Return prescribed minus present values, (owned nodes, d), 0 where free."""
        difference = (target - u[: target.size]).reshape(self.owned.shape)
        return np.where(self.owned, difference, 0.0)


def create_dirichlet(V: fem.FunctionSpace, bcs: list[fem.DirichletBC]) -> Dirichlet:
    """Find the prescribed dofs; collective."""
    return Dirichlet(V, bcs, prescribed_dofs(V, bcs))

# SPDX-License-Identifier: MIT
"""One cell under a prescribed homogeneous strain: the response of a law at a material point."""

from functools import cached_property
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx import fem, mesh
from dolfinx_mortar.materials.tensor import COMPONENTS
from dolfinx_mortar.solid.solid import Solid

INDEX = {c: ("xyz".index(c[0]), "xyz".index(c[1])) for c in COMPONENTS[3]}


class MaterialPoint:
    """A law at one integration point, on each rank for itself."""

    def __init__(self, law: Any, d: int = 3, kinematics: str | None = None) -> None:
        self._law, self.d, self._kinematics = law, d, kinematics

    @cached_property
    def solid(self) -> Solid:
        """The cell, compiled when first needed: many modules keep a point that all tests share."""
        if self.d == 2:
            domain = mesh.create_unit_square(MPI.COMM_SELF, 1, 1)
        else:
            domain = mesh.create_unit_cube(MPI.COMM_SELF, 1, 1, 1)
        V = fem.functionspace(domain, ("Lagrange", 1, (self.d,)))
        return Solid(fem.Function(V), self._law, kinematics=self._kinematics)

    @cached_property
    def x(self) -> np.ndarray:
        return self.solid.V.tabulate_dof_coordinates()[:, : self.d]

    def reset(self) -> None:
        for f in self.solid.state.values():
            f.x.array[:] = 0.0

    def set_plastic_strain(self, ep: np.ndarray) -> None:
        """Prescribe the committed plastic strain, a symmetric (3, 3)."""
        stored = [ep[INDEX[c]] for c in COMPONENTS[self.d]]
        self.solid.state["plastic_strain"].x.array.reshape(-1, len(stored))[:] = stored

    def stress(self, strain: np.ndarray) -> np.ndarray:
        """Return the stress (3, 3) of the law for a strain (3, 3), with the committed state."""
        self.solid.u.x.array[:] = (self.x @ strain[: self.d, : self.d]).ravel()
        self.solid.evaluate()
        return self._tensor("stress")

    def commit(self) -> np.ndarray:
        """Commit the state of the last strain and return the plastic strain (3, 3)."""
        self.solid.evaluate()
        self.solid.commit()
        return self._tensor("plastic_strain")

    def _tensor(self, name: str) -> np.ndarray:
        """Return a stored tensor at the first integration point as (3, 3)."""
        stored = self.solid.fields.values(name)[0, 0]
        result = np.zeros((3, 3))
        for c, value in zip(COMPONENTS[self.d], stored, strict=True):
            i, j = INDEX[c]
            result[i, j] = result[j, i] = value
        return result

# SPDX-License-Identifier: MIT
"""Strain and rotation at the integration points: what a small strain leaves out of a finite one.

With the strain e and the rotation w, the symmetric and the skew part of H = grad u, Green and
Lagrange's strain is e + H^T H / 2. A small strain takes e; of a rotation by an angle a, however
rigid, it leaves out a^2 / 2 in both directions across the axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

import ufl
from dolfinx import fem
from dolfinx_mortar import compat
from dolfinx_mortar.arrays import Floats, Ints
from dolfinx_mortar.materials.pointwise import stored, tensor_of
from dolfinx_mortar.materials.response import elastic_response
from dolfinx_mortar.materials.tensor import from_components, to_components
from dolfinx_mortar.solid.eigenstrain import Eigenstrain
from dolfinx_mortar.solid.kinematics import Kinematics
from dolfinx_mortar.solid.laws import Region
from ufl.core.expr import Expr


@dataclass(frozen=True)
class Gradients:
    """Values at the n integration points of the owned cells, cell by cell."""

    strain: Floats  # (n, 3, 3), what the kinematics measure
    seen: Floats  # (n, 3, 3), less the eigenstrain: what the laws see
    rotation: Floats  # (n, 3), axial vector of the skew part of grad u, radians
    small: bool  # whether the strain is a small one, linear in u

    @cached_property
    def left_out(self) -> Floats:
        """H^T H / 2 (n, 3, 3) of a small strain, zero for others."""
        if not self.small:
            return np.zeros_like(self.strain)
        x, y, z = np.moveaxis(self.rotation, -1, 0)
        H = self.strain.copy()
        for i, j, w in ((2, 1, x), (0, 2, y), (1, 0, z)):
            H[..., i, j] += w
            H[..., j, i] -= w
        result = np.empty_like(H)
        for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)):  # products of stacks are slow
            result[:, i, j] = result[:, j, i] = 0.5 * np.einsum("nk,nk->n", H[:, :, i], H[:, :, j])
        return result

    def turned(self, stress: Floats) -> Floats:
        """Return stress : W^T W / 2 (n,), the part of a small strain's rotation W alone.

        Args:
            stress: (n, 3, 3).
        """
        if not self.small:
            return np.zeros(len(stress))
        w = self.rotation
        along = np.einsum("ni,nij,nj->n", w, stress, w)
        return np.asarray(0.5 * ((w * w).sum(axis=1) * np.trace(stress, axis1=1, axis2=2) - along))


class PointGradients:
    """Compiled strain and rotation of the displacement of a solid."""

    def __init__(
        self,
        u: fem.Function,
        kinematics: Kinematics,
        eigenstrain: Eigenstrain | None,
        stress: fem.Function,
    ) -> None:
        """Compile; collective.

        Args:
            u: displacement.
            kinematics: the measure.
            eigenstrain: what the laws do not see of the strain.
            stress: quadrature Function, for its points and components.
        """
        self._space = stress.function_space
        size, strain = self._space.dofmap.bs, kinematics.measure(u)
        parts = [to_components(strain, size), _axial(ufl.grad(u))]
        if eigenstrain is not None:
            parts.append(to_components(strain - eigenstrain.tensor, size))
        entries = [part[i] for part in parts for i in range(part.ufl_shape[0])]
        points = compat.interpolation_points(self._space)
        self._entries = len(entries)
        self._compiled = fem.Expression(ufl.as_vector(entries), points)
        self._small = kinematics.linear_in(u)

    def evaluate(self) -> Gradients:
        """Return strain and rotation at u, whose ghosts are up to date; without communication."""
        domain, size = self._space.mesh, self._space.dofmap.bs
        owned = np.arange(domain.topology.index_map(domain.topology.dim).size_local, dtype="i4")
        values = np.asarray(self._compiled.eval(domain, owned)).reshape(-1, self._entries)
        last = size + (1 if domain.geometry.dim == 2 else 3)
        strain, rotation = tensor_of(values[:, :size]), np.zeros((len(values), 3))
        rotation[:, size - last :] = values[:, size:last]
        seen = tensor_of(values[:, last:]) if values.shape[1] > last else strain
        return Gradients(strain, seen, rotation, self._small)


def elastic_stresses(
    regions: Sequence[Region], stress: fem.Function, strain: Floats, cells: Ints
) -> Floats:
    """Return C : strain (k, components) at the points of given cells; collective, compiles.

    Args:
        regions: the laws.
        stress: quadrature Function, for its points and components.
        strain: (n, 3, 3) at the points of the owned cells.
        cells: owned ones.
    """
    space, field = stress.function_space, fem.Function(stress.function_space)
    size = space.dofmap.bs
    owned = len(strain) // space.dofmap.list.shape[1]
    field.x.array.reshape(-1, size)[space.dofmap.list[:owned].ravel()] = stored(strain, size)
    points, found = compat.interpolation_points(space), [np.zeros((0, size))]
    for region in regions:
        response = elastic_response(region.law, from_components(field), region.symbols)
        compiled = fem.Expression(to_components(response, size), points)
        on = np.intersect1d(cells, region.cells).astype(np.int32)
        found.append(np.asarray(compiled.eval(space.mesh, on)).reshape(-1, size))
    return np.concatenate(found)


def _axial(gradient: Expr) -> Expr:
    """Return the axial vector of the skew part of grad u, of which the plane has the last entry."""
    pairs = [(1, 0)] if gradient.ufl_shape[0] == 2 else [(2, 1), (0, 2), (1, 0)]
    return ufl.as_vector([(gradient[i, j] - gradient[j, i]) / 2 for i, j in pairs])

# SPDX-License-Identifier: MIT
"""Strain, rotation and volume at the integration points, and the terms that a small strain omits.

With the strain e and the rotation w, the symmetric and the skew part of H = grad u, Green and
Lagrange's strain is e + H^T H / 2. A small strain takes e; of a rotation by an angle a, however
rigid, it leaves out a^2 / 2 in both directions across the axis.
"""

import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh
from dolfinx_mortar import compat
from dolfinx_mortar.algebra.parallel import any_rank
from dolfinx_mortar.arguments import check, one_of
from dolfinx_mortar.arrays import Floats, Ints
from dolfinx_mortar.materials.response import Response
from dolfinx_mortar.materials.tensor import (
    INDEX,
    double_contraction,
    tensor_of,
    to_components,
)
from dolfinx_mortar.solid.eigenstrain import Eigenstrain
from dolfinx_mortar.solid.kinematics import Kinematics
from dolfinx_mortar.solid.sources import Part, create_source, middle_of, point_function
from ufl.core.expr import Expr


def check_finite(strain: Any, eigenstrain: Any) -> None:
    """Raise a ValueError for an unknown strain, and what a finite one does not go with."""
    check("strain", strain, one_of("small", "finite"))
    if strain == "finite" and eigenstrain is not None:
        raise ValueError(
            "strain is 'finite', and eigenstrain is given: a strain without stress is subtracted "
            "from a small strain, while F would have to be split into a product; leave eigenstrain "
            "out, or choose strain='small'"
        )


class Volumes:
    """J = det F at the integration points.

    Attributes:
        J: quadrature Function that `Solid.evaluate` fills; 1 before.
        source: what fills it.
        thickness: F_zz, of plates the stretch through their thickness; at the points only.
    """

    def __init__(self, u: fem.Function, gradient: Expr, degree: int) -> None:
        """Compile the determinant; collective."""
        domain = u.function_space.mesh
        cells = domain.topology.index_map(domain.topology.dim)
        every = np.arange(cells.size_local + cells.num_ghosts, dtype=np.int32)
        self.J = point_function(domain, degree, (), "J")
        self.J.x.array[:] = 1.0
        self.source = create_source(every, Part("J", self.J, ufl.det(gradient)))
        self.thickness = gradient[2, 2]
        self._owned = cells.size_local
        self._comm = domain.comm

    def inverted(self) -> bool:
        """Tell whether J at u is no positive number at any point; collective."""
        return bool(any_rank(self._comm, not (self._now() > 0.0).all())[0])

    def smallest(self) -> float:
        """Return the smallest J at u, NaN if one is undefined; collective."""
        values = self._now()
        return float(self._comm.allreduce(float(values.min(initial=np.inf)), op=MPI.MIN))

    def describe_inverted(self) -> str:
        """Say where a cell is turned inside out at u, "" if nowhere; collective."""
        words = "are turned inside out", "J = det F"
        return describe_lowest(self.J.function_space.mesh, self._now(), 0.0, *words)

    def _now(self) -> np.ndarray:
        """Return J at u (owned cells, points)."""
        return self.source.evaluate(self.source.cells[: self._owned])[..., 0]


def describe_lowest(domain: Mesh, values: Floats, limit: float, cells_do: str, name: str) -> str:
    """Say where values at points (owned cells, points) are not above a limit; collective.

    Args:
        domain: the mesh.
        values: NaN is not above any limit.
        limit: for all of them.
        cells_do: what cells do whose values are not above it.
        name: of the values.

    Returns:
        How many cells do, and the worst one of a rank; empty if none.
    """
    bad = ~(values > limit).all(axis=1)
    where = ""
    if bad.any():
        lowest = np.where(np.isnan(values), -np.inf, values).min(axis=1)
        cell = int(np.argmin(lowest))
        number = int(domain.topology.original_cell_index[cell])
        where = (
            f"cell {number} of the input around {middle_of(domain, cell)} at X, whose "
            f"{name} is {values[cell].min():.3g}"
        )
    found = [place for place in domain.comm.allgather(where) if place]
    count = domain.comm.allreduce(int(bad.sum()))
    return f"{count} cells {cells_do}, such as {found[0]}" if found else ""


def as_cauchy(response: Response, gradient: Expr) -> Response:
    """Return a response whose stress is Cauchy's, P F^T / det F, for what is shown."""
    cauchy = response.stress * ufl.transpose(gradient) / ufl.det(gradient)
    return dataclasses.replace(response, stress=cauchy)


# Row and column (i, j) of the entries H_ij > H_ji that a rotation about x, y, z adds to grad u.
TURNS = ((2, 1), (0, 2), (1, 0))


@dataclass(frozen=True)
class Gradients:
    """Values at the n integration points of some cells, cell by cell.

    Tensors have their stored components (n, 4 or 6), each of which is contiguous in memory.
    """

    strain: Floats  # what the kinematics measure
    seen: Floats  # less the eigenstrain: what the laws see
    rotation: Floats  # (n, 1 or 3), axial vector of the skew part of grad u, radians; about z in 2D
    small: bool  # whether the strain is a small one, linear in u

    @cached_property
    def left_out(self) -> Floats:
        """H^T H / 2 (n, 4 or 6) of a small strain, zero for others."""
        if not self.small:
            return np.zeros_like(self.strain)
        H: dict[tuple[int, int], Floats] = {}
        for k, (i, j) in enumerate(INDEX[: self.strain.shape[1]]):
            H[i, j] = H[j, i] = self.strain[:, k]
        for (i, j), w in self._turns():
            H[i, j], H[j, i] = H[i, j] + w, H[j, i] - w
        return _half_square(H, self.strain.shape)

    def turned(self, stress: Floats) -> Floats:
        """Return stress : W^T W / 2 (n,), the part of a small strain's rotation W alone."""
        if not self.small:
            return np.zeros(len(stress))
        W: dict[tuple[int, int], Floats] = {}
        for (i, j), w in self._turns():
            W[i, j], W[j, i] = w, -w
        return double_contraction(stress, _half_square(W, self.strain.shape))

    def _turns(self) -> Iterator[tuple[tuple[int, int], Floats]]:
        """Return row, column and value of what the rotation adds to the gradient."""
        axes = self.rotation.shape[1]
        columns = (self.rotation[:, k] for k in range(axes))
        return zip(TURNS[-axes:], columns, strict=True)


def _half_square(H: Mapping[tuple[int, int], Floats], shape: tuple[int, ...]) -> Floats:
    """Return the stored components of H^T H / 2 by the entries of H that are not zero."""
    result = np.zeros(shape, order="F")
    for c, (i, j) in enumerate(INDEX[: shape[1]]):
        for k in range(3):
            if (k, i) in H and (k, j) in H:
                result[:, c] += H[k, i] * H[k, j]
    result *= 0.5
    return result


class PointGradients:
    """Compiled strain and rotation of the displacement of a solid."""

    def __init__(
        self,
        u: fem.Function,
        kinematics: Kinematics,
        eigenstrain: Eigenstrain | None,
        stress: fem.Function,
        *,
        small: bool,
    ) -> None:
        """Compile for the points and components of the stress; collective."""
        self._space = stress.function_space
        size, strain = self._space.dofmap.bs, kinematics.strain(u)
        parts = [to_components(strain, size), _axial(ufl.grad(u))]
        if eigenstrain is not None:
            parts.append(to_components(strain - eigenstrain.tensor, size))
        entries = [part[i] for part in parts for i in range(part.ufl_shape[0])]
        points = compat.interpolation_points(self._space)
        self._entries, self._axes = len(entries), parts[1].ufl_shape[0]
        self._compiled = fem.Expression(ufl.as_vector(entries), points)
        self.small = small

    def evaluate(self, cells: Ints | None = None) -> Gradients:
        """Return strain and rotation at u, whose ghosts are up to date; without communication.

        In some cells, or in all that this rank owns.
        """
        domain, size = self._space.mesh, self._space.dofmap.bs
        if cells is None:
            owned = domain.topology.index_map(domain.topology.dim).size_local
            cells = np.arange(owned, dtype=np.int32)
        found = np.asarray(self._compiled.eval(domain, cells)).reshape(-1, self._entries)
        values: Floats = np.asfortranarray(found)
        strain, rotation, seen = np.split(values, [size, size + self._axes], axis=1)
        return Gradients(strain, seen if seen.shape[1] else strain, rotation, self.small)

    def describe_shortened(self, limit: float) -> str:
        """Say where a finite strain at u shortens lengths to less than a limit; collective.

        Empty if nowhere, and where u is not a number. What flows keeps its volume: J does not tell.
        """
        strain = np.nan_to_num(self.evaluate().strain, posinf=0.0, neginf=0.0)
        C = np.eye(3) + 2 * tensor_of(strain)
        stretches = np.sqrt(np.maximum(np.linalg.eigvalsh(C)[:, 0], 0.0))
        values = stretches.reshape(-1, self._space.dofmap.list.shape[1])
        words = f"are shortened to less than {limit:g} of a length", "smallest stretch"
        return describe_lowest(self._space.mesh, values, limit, *words)


def _axial(gradient: Expr) -> Expr:
    """Return the axial vector of the skew part of grad u, of which the plane has the last entry."""
    pairs = TURNS[2:] if gradient.ufl_shape[0] == 2 else TURNS
    return ufl.as_vector([(gradient[i, j] - gradient[j, i]) / 2 for i, j in pairs])

# SPDX-License-Identifier: MIT
"""Strain, rotation and volume at the integration points, and the terms neglected at small strain.

With H = grad u the Green-Lagrange strain is sym H + H^T H / 2.
"""

import dataclasses
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh
from dolfinx_mortar.algebra.parallel import any_rank
from dolfinx_mortar.common.arguments import check, one_of
from dolfinx_mortar.common.arrays import Floats, Ints
from dolfinx_mortar.materials.response import Response
from dolfinx_mortar.materials.tensor import tensor_of
from dolfinx_mortar.solid.eigenstrain import Eigenstrain
from dolfinx_mortar.solid.kinematics import Kinematics
from dolfinx_mortar.solid.sources import Part, create_source, middle_of, point_function
from ufl.core.expr import Expr


def check_finite(strain: Any, eigenstrain: Any) -> None:
    """Raise a ValueError for an unknown strain, and arguments that exclude a finite one."""
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
        J: quadrature Function filled by `Solid.evaluate`; 1 before.
        thickness: F_zz, the stretch through a plate.
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
        """Whether J at u is not positive at any point; collective."""
        return bool(any_rank(self._comm, not (self._now() > 0.0).all())[0])

    def smallest(self) -> float:
        """Smallest J at u, NaN if one is undefined; collective."""
        values = self._now()
        return float(self._comm.allreduce(float(values.min(initial=np.inf)), op=MPI.MIN))

    def describe_inverted(self) -> str:
        """Message about inverted cells at u, or ""; collective."""
        words = "are turned inside out", "J = det F"
        return describe_lowest(self.J.function_space.mesh, self._now(), 0.0, *words)

    def _now(self) -> np.ndarray:
        return self.source.evaluate(self.source.cells[: self._owned])[0][..., 0]


def describe_lowest(domain: Mesh, values: Floats, limit: float, cells_do: str, name: str) -> str:
    """Message on cells with values (owned cells, points) <= limit or NaN, or ""; collective."""
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
    """Response with Cauchy's stress, P F^T / det F, for output."""
    cauchy = response.stress * ufl.transpose(gradient) / ufl.det(gradient)
    return dataclasses.replace(response, stress=cauchy)


# Entries (i, j) with H_ij > H_ji for positive rotations about x, y, z.
TURNS = ((2, 1), (0, 2), (1, 0))


@dataclass(frozen=True)
class Gradients:
    """Values at the n integration points of some cells, cell by cell; tensors (n, 4 or 6)."""

    strain: Floats
    rotation: Floats  # (n, 1 or 3), axial vector of the skew part of grad u, radians; about z in 2D
    left_out: Floats  # H^T H / 2 at small strain, else zero
    turned: Floats  # W^T W / 2, W the skew part
    seen: Floats  # strain less the eigenstrain


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
        self._space, self.small = stress.function_space, small
        strain, g = kinematics.strain(u), ufl.grad(u)
        turns = TURNS[2:] if g.ufl_shape[0] == 2 else TURNS
        rotation = [(g[i, j] - g[j, i]) / 2 for i, j in turns]
        parts = [strain, ufl.as_vector(rotation)]
        if small:
            rows: list[list[Any]] = [[0] * 3 for _ in range(3)]
            for (i, j), w in zip(turns, rotation, strict=True):
                rows[i][j], rows[j][i] = w, -w
            W = ufl.as_tensor(rows)
            parts += [ufl.transpose(H) * H / 2 for H in (strain + W, W)]
        if eigenstrain is not None:
            parts.append(strain - eigenstrain.tensor)
        named = (Part("strain and rotation", stress, part) for part in parts)
        self._source = create_source(np.arange(0, dtype=np.int32), *named)

    def evaluate(self, cells: Ints | None = None) -> Gradients:
        """Strain and rotation at u, by default in owned cells; not collective."""
        domain = self._space.mesh
        if cells is None:
            owned = domain.topology.index_map(domain.topology.dim).size_local
            cells = np.arange(owned, dtype=np.int32)
        found = self._source.evaluate(cells)
        strain, rotation, *rest = (part.reshape(-1, part.shape[2]) for part in found)
        if not self.small:
            rest = [np.zeros_like(strain)] * 2 + rest
        return Gradients(strain, rotation, rest[0], rest[1], rest[2] if rest[2:] else strain)

    def describe_shortened(self, limit: float) -> str:
        """Message on shortening below a limit at finite strain, or ""; collective."""
        strain = np.nan_to_num(self.evaluate().strain, posinf=0.0, neginf=0.0)
        C = np.eye(3) + 2 * tensor_of(strain)
        stretches = np.sqrt(np.maximum(np.linalg.eigvalsh(C)[:, 0], 0.0))
        values = stretches.reshape(-1, self._space.dofmap.list.shape[1])
        words = f"are shortened to less than {limit:g} of a length", "smallest stretch"
        return describe_lowest(self._space.mesh, values, limit, *words)

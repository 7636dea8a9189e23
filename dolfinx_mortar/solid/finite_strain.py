# SPDX-License-Identifier: MIT
"""Finite strain: checks of arguments, volumes at the integration points, Cauchy's stress."""

import dataclasses
from typing import Any

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh
from dolfinx_mortar.algebra.parallel import any_rank
from dolfinx_mortar.arguments import check, one_of
from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.materials.response import Response
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
        values: what is judged; NaN is not above any limit.
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

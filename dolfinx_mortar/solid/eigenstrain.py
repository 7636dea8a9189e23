# SPDX-License-Identifier: MIT
"""Eigenstrain, the strain of a body without stress."""

from collections.abc import Mapping, Sequence
from numbers import Number
from typing import Any

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem, mesh
from dolfinx_mortar.algebra.parallel import maximum, raised_together
from dolfinx_mortar.common.arguments import array, check
from dolfinx_mortar.common.arrays import HALF_OF_DIGITS, Ints
from dolfinx_mortar.common.tags import label
from dolfinx_mortar.solid.laws import by_cells
from dolfinx_mortar.solid.sources import (
    Followed,
    Part,
    check_source,
    create_source,
    point_function,
)
from ufl.algorithms.analysis import extract_arguments
from ufl.core.expr import Expr

WANTED = (
    "give a scalar (the same in all three directions) or a 3x3 tensor, as a real number, an array, "
    "a Constant, a Function or UFL"
)


class Eigenstrain(Followed):
    """Eigenstrain at the integration points of a mesh, zero by default.

    Attributes:
        function: a scalar, if isotropic, else the nine components row by row.
    """

    def __init__(
        self, u: fem.Function, parts: Sequence[tuple[str, Expr, Ints]], degree: int
    ) -> None:
        """Compile the parts, each with name, scalar or 3x3 tensor and cells; collective."""
        full = any(value.ufl_shape for _, value, _ in parts)
        shape = (9,) if full else ()
        function = point_function(u.function_space.mesh, degree, shape, "eigenstrain")
        sources = []
        for name, value, cells in parts:
            if full:
                tensor = value if value.ufl_shape else value * ufl.Identity(3)
                value = ufl.as_vector([tensor[i, j] for i in range(3) for j in range(3)])
            sources.append(create_source(cells, Part(name, function, value)))
        super().__init__(function, sources)

    @property
    def tensor(self) -> Expr:
        """The eigenstrain as a 3x3 tensor in UFL."""
        return self.tensor_of(self.function)

    @staticmethod
    def tensor_of(f: fem.Function) -> Expr:
        """3x3 tensor of a Function such as `function`."""
        if not f.ufl_shape:
            return f * ufl.Identity(3)
        return ufl.sym(ufl.as_tensor([[f[3 * i + j] for j in range(3)] for i in range(3)]))

    def judge(self) -> None:
        """Raise a ValueError for NaN, infinity, asymmetry, or shear out of the plane."""
        V = self.function.function_space
        owned = V.mesh.topology.index_map(V.mesh.topology.dim).size_local
        table = self.function.x.array.reshape(-1, V.dofmap.bs)
        for source in self._sources:
            cells = source.cells[source.cells < owned]
            values = table[V.dofmap.list[cells].ravel()]
            undefined = ~np.isfinite(values).all(axis=1)
            skew, out_of_plane = np.zeros((2, len(undefined)), dtype=bool)
            if V.dofmap.bs == 9:
                largest = maximum(V.mesh.comm, np.abs(values[~undefined]).max(initial=0.0))[0]
                e = values.reshape(-1, 3, 3)
                # derivatives of interpolated fields lose digits
                apart = np.abs(e - np.swapaxes(e, 1, 2)) > HALF_OF_DIGITS * largest
                skew = apart.any(axis=(1, 2))
                shear = (e[:, :2, 2] + e[:, 2, :2] != 0.0).any(axis=1)
                out_of_plane = shear & ~undefined & (V.mesh.geometry.dim == 2)
            counts = np.array([part.sum() for part in (undefined, skew, out_of_plane)], dtype=int)
            bad = V.mesh.comm.allreduce(counts, op=MPI.SUM)
            told = {
                "is NaN or infinite": "check what it depends on",
                "is not symmetric": "give its symmetric part, ufl.sym(..) or (e + e.T) / 2",
                "has components xz or yz": "bodies in the plane cannot follow: set them to 0",
            }
            for count, (what, remedy) in zip(bad, told.items(), strict=True):
                if count:
                    raise ValueError(
                        f"{source.parts[0].name} {what} at {count} integration points; {remedy}"
                    )


def create_eigenstrain(
    u: fem.Function, given: Any, cell_tags: mesh.MeshTags | None, degree: int
) -> Eigenstrain | None:
    """Eigenstrain given by a user, or None; collective."""
    if given is None:
        return None
    domain, parts = u.function_space.mesh, []
    imap = domain.topology.index_map(domain.topology.dim)
    every = np.arange(imap.size_local + imap.num_ghosts, dtype=np.int32)
    of_cells = [("eigenstrain", given, every)]
    if isinstance(given, Mapping):
        by_tag, tags = by_cells(domain, cell_tags, given, "eigenstrain")
        of_cells = [
            (f"eigenstrain[{label(cell_tags, tag)}]", value, every[tags == tag])
            for tag, value in by_tag.items()
        ]
    for name, value, cells in of_cells:
        with raised_together(domain.comm):
            parts.append((name, _as_expression(u, name, value), cells))
    found = Eigenstrain(u, parts, degree)
    found.follow()
    return found


def _as_expression(u: fem.Function, name: str, value: Any) -> Expr:
    domain = u.function_space.mesh
    if isinstance(value, Number | np.ndarray | list | tuple):
        value = fem.Constant(domain, check(name, value, array(finite=False, remedy=WANTED)))
    if not isinstance(value, Expr) or value.ufl_free_indices or extract_arguments(value):
        raise ValueError(f"{name} is a {type(value).__name__}: {WANTED}")
    if value.ufl_shape not in ((), (3, 3)):
        out = "; a strain in the plane has a component out of it, too" * (value.ufl_shape == (2, 2))
        raise ValueError(f"{name} has the shape {value.ufl_shape}: {WANTED}{out}")
    check_source(u, name, value)
    return value

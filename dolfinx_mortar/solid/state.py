# SPDX-License-Identifier: MIT
"""Functions at the integration points: stress, internal variables, and what fills them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np

import basix.ufl
import ufl
from dolfinx import default_scalar_type, fem, mesh
from dolfinx_mortar import compat
from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.arrays import Ints
from dolfinx_mortar.materials.response import Response
from dolfinx_mortar.materials.tensor import COMPONENTS, from_components, to_components
from dolfinx_mortar.solid.laws import Region
from ufl.core.expr import Expr


@dataclass(frozen=True)
class Evaluation:
    """A compiled expression with the Function and the cells that it fills."""

    what: str  # for messages: the law and what it gives
    target: fem.Function
    cells: Ints  # local cells, ghosts included
    expression: fem.Expression

    def fill(self) -> None:
        """Evaluate the expression."""
        self.target.interpolate(self.expression, self.cells)

    def undefined(self) -> int:
        """Return the number of integration points of the local cells with NaN or infinity."""
        dofmap = self.target.function_space.dofmap
        values = self.target.x.array.reshape(-1, dofmap.bs)[dofmap.list[self.cells]]
        return int(np.sum(~np.isfinite(values).all(axis=-1)))


def fill_all(comm: MPI.Comm, evaluations: Sequence[Evaluation]) -> None:
    """Evaluate all expressions; if that raises, the Functions are as before; collective.

    Raises:
        ValueError: on all ranks, if a law gives NaN or infinity on any, naming the law.
    """
    before = {f: f.x.array.copy() for f in {evaluation.target for evaluation in evaluations}}
    try:
        for evaluation in evaluations:
            evaluation.fill()
        _check_defined(comm, evaluations)
    except BaseException:
        for f, values in before.items():
            f.x.array[:] = values
        raise


def _check_defined(comm: MPI.Comm, evaluations: Sequence[Evaluation]) -> None:
    """Raise a ValueError on all ranks if a law has given NaN or infinity on any; collective."""
    counts = maximum(comm, *(float(evaluation.undefined()) for evaluation in evaluations))
    for evaluation, count in zip(evaluations, counts, strict=True):
        if count:
            raise ValueError(
                f"{evaluation.what} is NaN or infinite at {count:.0f} integration points or more; "
                "check the law with dolfinx_mortar.materials.check and its parameters"
            )


def create_field(domain: mesh.Mesh, degree: int, shape: tuple[int, ...], name: str) -> fem.Function:
    """Create a quadrature Function for a scalar, shape (), or a tensor, shape (3, 3)."""
    value_shape = (len(COMPONENTS[domain.geometry.dim]),) if shape else ()
    element = basix.ufl.quadrature_element(
        domain.basix_cell(), value_shape=value_shape, scheme="default", degree=degree
    )
    return fem.Function(fem.functionspace(domain, element), name=name)


def create_state(
    regions: Sequence[Region], domain: mesh.Mesh, degree: int
) -> dict[str, fem.Function]:
    """Create the internal variables of all laws, shared where laws use the same name.

    Raises:
        ValueError: if two laws have an internal variable of one name in two shapes.
    """
    shapes: dict[str, tuple[int, ...]] = {}
    owner: dict[str, str] = {}
    for region in regions:
        for name, shape in region.law.state.items():
            first = owner.setdefault(name, region.law.name)
            if shapes.setdefault(name, shape) != shape:
                raise ValueError(
                    f"materials: the state {name!r} has the shape {shapes[name]} in {first} and "
                    f"{shape} in {region.law.name}; give one of them another name."
                )
    return {name: create_field(domain, degree, shape, name) for name, shape in shapes.items()}


def committed_state(region: Region, state: Mapping[str, fem.Function]) -> dict[str, Expr]:
    """Return the committed internal variables of a law as UFL, () or (3, 3) by name."""
    return {
        name: from_components(state[name]) if shape else state[name]
        for name, shape in region.law.state.items()
    }


def create_evaluations(
    regions: Sequence[Region],
    responses: Sequence[Response],
    staged: Mapping[str, fem.Function],
    stress: fem.Function,
) -> list[Evaluation]:
    """Compile stress and new internal variables of all regions; collective.

    All read the displacement and the committed state, so the order does not matter.
    """
    points = compat.interpolation_points(stress.function_space)
    size = stress.function_space.dofmap.bs
    zero = fem.Constant(stress.function_space.mesh, default_scalar_type(0.0))
    evaluations = []
    for region, response in zip(regions, responses, strict=True):
        given = [("stress", stress, response.stress)]
        given += [(name, staged[name], value) for name, value in response.updated.items()]
        for name, target, value in given:
            stored = to_components(value, size) if value.ufl_shape else value
            compiled = fem.Expression(_on_mesh(stored, zero), points)
            what = f"{region.law.name}: {name}"
            evaluations.append(Evaluation(what, target, region.cells, compiled))
    return evaluations


def _on_mesh(value: Expr, zero: fem.Constant) -> Expr:
    """Return a value as it is, or with a zero that lives on a mesh if a law returns mere numbers.

    Without a mesh, dolfinx does not know where to evaluate it.
    """
    if ufl.domain.extract_domains(value):
        return value
    if not value.ufl_shape:
        return value + zero
    return ufl.as_vector([value[i] + zero for i in range(value.ufl_shape[0])])

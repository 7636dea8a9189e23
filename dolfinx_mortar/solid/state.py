# SPDX-License-Identifier: MIT
"""Functions at the integration points: stress, internal variables, and what fills them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import basix.ufl
from dolfinx import fem, mesh
from dolfinx_mortar import compat
from dolfinx_mortar.arrays import Ints
from dolfinx_mortar.materials.response import Response
from dolfinx_mortar.materials.tensor import COMPONENTS, to_components
from dolfinx_mortar.solid.laws import Region


@dataclass(frozen=True)
class Evaluation:
    """A compiled expression with the Function and the cells that it fills."""

    target: fem.Function
    cells: Ints  # local cells, ghosts included
    expression: fem.Expression

    def fill(self) -> None:
        """Evaluate the expression."""
        self.target.interpolate(self.expression, self.cells)


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
    """Create the internal variables of all laws, shared where laws use the same name."""
    shapes: dict[str, tuple[int, ...]] = {}
    for region in regions:
        for name, shape in region.law.state.items():
            assert shapes.setdefault(name, shape) == shape, f"two shapes of state {name}"
    return {name: create_field(domain, degree, shape, name) for name, shape in shapes.items()}


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
    evaluations = []
    for region, response in zip(regions, responses, strict=True):
        targets = [(stress, response.stress)]
        targets += [(staged[name], value) for name, value in response.updated.items()]
        for target, value in targets:
            stored = to_components(value, size) if value.ufl_shape else value
            evaluations.append(Evaluation(target, region.cells, fem.Expression(stored, points)))
    return evaluations

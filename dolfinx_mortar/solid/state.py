# SPDX-License-Identifier: MIT
"""Functions at the integration points: stress and internal variables, and their evaluation."""

from collections.abc import Mapping, Sequence

from mpi4py import MPI

from dolfinx import fem, mesh
from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.materials.response import Response
from dolfinx_mortar.materials.tensor import COMPONENTS, from_components, to_components
from dolfinx_mortar.solid.laws import Region
from dolfinx_mortar.solid.sources import Part, Source, create_source, point_function
from ufl.core.expr import Expr


def fill_all(comm: MPI.Comm, evaluations: Sequence[Source]) -> None:
    """Evaluate all expressions; if that raises, the Functions are as before; collective.

    Raises:
        ValueError: on all ranks, if a law gives NaN or infinity on any, naming the law.
    """
    filled = {part.function for source in evaluations for part in source.parts}
    before = {f: f.x.array.copy() for f in filled}
    try:
        for evaluation in evaluations:
            evaluation.fill()
        _check_defined(comm, evaluations)
    except BaseException:
        for f, values in before.items():
            f.x.array[:] = values
        raise


def _check_defined(comm: MPI.Comm, evaluations: Sequence[Source]) -> None:
    """Raise a ValueError on all ranks if a law has given NaN or infinity on any; collective."""
    names = [part.name for source in evaluations for part in source.parts]
    found = [float(count) for source in evaluations for count in source.undefined()]
    for name, count in zip(names, maximum(comm, *found), strict=True):
        if count:
            raise ValueError(
                f"{name} is NaN or infinite at {count:.0f} integration points or more; "
                "check the law with dolfinx_mortar.materials.check and its parameters"
            )


def create_field(domain: mesh.Mesh, degree: int, shape: tuple[int, ...], name: str) -> fem.Function:
    """Create a quadrature Function for a scalar, shape (), or a tensor, shape (3, 3)."""
    size = (len(COMPONENTS[domain.geometry.dim]),) if shape else ()
    return point_function(domain, degree, size, name)


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


def as_tensors(region: Region, state: Mapping[str, fem.Function]) -> dict[str, Expr]:
    """Return the internal variables of a law as UFL, () or (3, 3) by name."""
    return {
        name: from_components(state[name]) if shape else state[name]
        for name, shape in region.law.state.items()
    }


def create_evaluations(
    regions: Sequence[Region],
    responses: Sequence[Response],
    staged: Mapping[str, fem.Function],
    stress: fem.Function,
) -> list[Source]:
    """Compile stress and new internal variables of all regions; collective.

    All read the displacement and the committed state, so the order does not matter.
    """
    size, evaluations = stress.function_space.dofmap.bs, []
    for region, response in zip(regions, responses, strict=True):
        given = [("stress", stress, response.stress)]
        given += [(name, staged[name], value) for name, value in response.updated.items()]
        parts = [
            Part(
                f"{region.law.name}: {name}",
                target,
                to_components(value, size) if value.ufl_shape else value,
            )
            for name, target, value in given
        ]
        evaluations.append(create_source(region.cells, *parts))
    return evaluations

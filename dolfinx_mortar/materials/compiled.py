# SPDX-License-Identifier: MIT
"""A law as a compiled function of numbers: the code that a solid runs, without any mesh."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

import ufl
from dolfinx_mortar.arrays import Floats, Ints
from dolfinx_mortar.kernels import compile_vectors, constants
from dolfinx_mortar.materials.plane_stress import Equation, solve
from dolfinx_mortar.materials.protocol import Law, create_law
from dolfinx_mortar.materials.ranges import grouped, named_parameters
from dolfinx_mortar.materials.response import (
    Response,
    elastic_response,
    respond,
    values_at_points,
)
from dolfinx_mortar.materials.tensor import from_components, stored, tensor_of, to_components
from ufl.core.expr import Expr


@dataclass(frozen=True)
class Point:
    """What a law gives at one strain and state, in numbers."""

    stress: Floats  # (3, 3)
    elastic: Floats  # (3, 3), C : strain
    change: Floats  # (3, 3), d stress / d strain : direction
    energy: float  # NaN if the law has none
    state: dict[str, Floats]  # at the end of the step, () or (6,)

    @property
    def finite(self) -> bool:
        """Whether nothing is NaN or infinite, but for an energy that does not exist."""
        parts = [self.stress, self.elastic, self.change, *self.state.values()]
        return all(bool(np.isfinite(part).all()) for part in parts)


class CompiledLaw:
    """The response of a law, compiled for one point.

    Attributes:
        shapes: stored shape of the internal variables by name, () or (6,).
        has_energy: whether the law has a potential.
    """

    def __init__(self, material: Any, law: Law | None = None) -> None:
        law = create_law("law", material) if law is None else law
        self.shapes = stored_shapes(law)
        given = parameters(material)
        self._name, self._parameters = law.name, list(given.values())
        strain, along, z, *rest = symbols((6,), (6,), (), *self.shapes.values(), *[()] * len(given))
        state = dict(zip(self.shapes, rest, strict=False))
        p = grouped(dict(zip(given, rest[len(state) :], strict=True)))
        response = respond(law, strain, state, p, z if law.condensed else None)
        self.has_energy = response.energy is not None
        # One by one: UFL compares equal parts of what is compiled together, tree by tree.
        elastic, change = elastic_response(law, strain, p), response.change(along)
        parts = [entries(t) for t in (response.stress, elastic, change)]
        parts.append([ufl.as_ufl(0.0) if response.energy is None else response.energy])
        parts += state_entries(response, self.shapes)
        self._closed = response.normal_strain is not None
        if law.condensed:
            parts.append(list(response.equation or [response.normal_strain]))
        self._kernels = compile_vectors([ufl.as_vector(list(part)) for part in parts])
        self._equation = self._kernels.pop() if law.condensed else None

    def __call__(self, strain: Floats, direction: Floats, state: Mapping[str, Floats]) -> Point:
        """Evaluate the law.

        Strain, direction of the tangent and tensors of the committed state are stored, (6,).
        """
        committed = [np.atleast_1d(state[name]) for name in self.shapes]
        numbers = np.concatenate([strain, direction, [0.0], *committed, self._parameters])
        if self._equation is not None and self._closed:
            numbers[12] = self._equation(numbers)[0]
        elif self._equation is not None:
            numbers[12] = solve(self._name, self._at(numbers), (1, 1))[0, 0]
        values = np.concatenate([kernel(numbers) for kernel in self._kernels])
        stress, elastic, change = values[:27].reshape(3, 3, 3)
        energy, rest = values[27] if self.has_energy else np.nan, values[28:]
        new = {}
        for name, shape in self.shapes.items():
            new[name], rest = (rest[:6], rest[6:]) if shape else (rest[0], rest[1:])
        return Point(stress, elastic, change, float(energy), new)

    def _at(self, numbers: Floats) -> Equation:
        """Return the equation of the strain out of the plane, the other numbers given."""
        kernel = self._equation
        assert kernel is not None

        def equation(rows: Ints, z: Floats) -> Floats:
            values = kernel(np.concatenate([numbers[:12], z[0], numbers[13:]]))
            return values.reshape(1, 1, 4)

        return equation


class PointwiseNumbers:
    """A pointwise law at one point, as `CompiledLaw` is for one in UFL."""

    has_energy = False

    def __init__(self, material: Any, law: Law) -> None:
        self.shapes = stored_shapes(law)
        self._law, self._p = law, parameters(material)
        self._elastic = compile_elastic(law, self._p)

    def __call__(self, strain: Floats, direction: Floats, state: Mapping[str, Floats]) -> Point:
        """Evaluate the law, see `CompiledLaw`."""
        found = values_at_points(
            self._law, tensor_of(strain[None]), *at_one_point(self.shapes, state, self._p)
        )
        change = np.einsum("ijkl,kl->ij", found.tangent[0], tensor_of(direction[None])[0])
        elastic = self._elastic(np.array([*strain, *self._p.values()])).reshape(3, 3)
        return Point(found.stress[0], elastic, change, np.nan, of_one_point(found.state))


def parameters(material: Any) -> dict[str, float]:
    """Return the parameters of a material as numbers; a ValueError if one depends on place."""
    numbers = {}
    for name, value in named_parameters(material).items():
        if isinstance(value, Expr) and not isinstance(value, ufl.Constant):
            raise ValueError(
                f"{type(material).__name__}: {name} = {value} depends on place; try the law "
                f"out with numbers, dataclasses.replace(law, {name}=...)."
            )
        numbers[name] = float(getattr(value, "value", value))
    return numbers


def entries(tensor: Expr) -> list[Expr]:
    """Return the nine entries of a tensor, row by row."""
    return [tensor[i, j] for i in range(3) for j in range(3)]


def stored_shapes(law: Law) -> dict[str, tuple[int, ...]]:
    """Return how the internal variables are stored, () or (6,), by name."""
    return {name: (6,) if shape else () for name, shape in law.state.items()}


def state_entries(response: Response, shapes: Mapping[str, tuple[int, ...]]) -> list[list[Expr]]:
    """Return the stored components of the internal variables at the end of the step."""
    new = [(response.updated[name], shape) for name, shape in shapes.items()]
    return [list(to_components(value, 6)) if shape else [value] for value, shape in new]


def compile_elastic(law: Law, given: Mapping[str, float]) -> Callable[[Floats], Floats]:
    """Return C : strain (9,) as a function of stored strain and parameters, (6 + p,)."""
    strain, *rest = symbols((6,), *[()] * len(given))
    p = grouped(dict(zip(given, rest, strict=True)))
    (kernel,) = compile_vectors([ufl.as_vector(entries(elastic_response(law, strain, p)))])
    return kernel


def at_one_point(
    shapes: Mapping[str, tuple[int, ...]], state: Mapping[str, Floats], given: Mapping[str, float]
) -> tuple[dict[str, Floats], Any]:
    """Return state and parameters as laws of arrays take them."""
    committed = {
        name: tensor_of(np.atleast_2d(state[name])) if shape else np.atleast_1d(state[name])
        for name, shape in shapes.items()
    }
    return committed, grouped({name: np.array([value]) for name, value in given.items()})


def of_one_point(state: Mapping[str, Floats]) -> dict[str, Floats]:
    """Return the stored state of the only point, () or (6,), of that of a law of arrays."""
    return {name: stored(v)[0] if v.ndim == 3 else v[0] for name, v in state.items()}


def symbols(*shapes: tuple[int, ...]) -> list[Expr]:
    """Return `constants` in turn as scalars, (), and tensors, by components (6,) or (3, 3)."""
    sizes = [int(np.prod(shape)) for shape in shapes]
    numbers = iter(list(constants(sum(sizes))))
    found: list[Expr] = []
    for shape, size in zip(shapes, sizes, strict=True):
        part = [next(numbers) for _ in range(size)]
        if not shape:
            found += part
        elif shape == (6,):
            found.append(from_components(ufl.as_vector(part)))
        else:
            found.append(ufl.as_tensor([part[:3], part[3:6], part[6:]]))
    return found

# SPDX-License-Identifier: MIT
"""Functions at points of the bodies, and the expressions that fill them."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np

import basix.ufl
import ufl
from dolfinx import default_scalar_type, fem, mesh
from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.common import compat
from dolfinx_mortar.common.arrays import Floats, Ints
from dolfinx_mortar.common.spaces import check_real
from dolfinx_mortar.materials.tensor import COMPONENTS, to_components
from ufl.algorithms.analysis import extract_coefficients, extract_constants
from ufl.core.expr import Expr


@dataclass(frozen=True)
class Part:
    """A value, and the components of a Function that it fills."""

    name: str  # of the user's argument, for messages
    function: fem.Function
    value: Expr  # scalar, vector of components or 3x3 tensor
    components: slice = slice(None)

    @property
    def entries(self) -> list[Expr]:
        """Components of the value."""
        value = self.value
        if value.ufl_shape == (3, 3):
            value = to_components(value, self.function.function_space.dofmap.bs)
        return [value[i] for i in range(*value.ufl_shape)] if value.ufl_shape else [value]


@dataclass(frozen=True)
class Source:
    """Values in some cells, given by one expression."""

    parts: Sequence[Part]
    cells: Ints  # local cells, ghosts included
    expression: fem.Expression
    inputs: tuple[Any, ...]

    def evaluate(self, cells: Ints | None = None) -> list[Floats]:
        """Values (cells, points, components) of each part; not collective."""
        cells = self.cells if cells is None else cells
        space = self.parts[0].function.function_space
        values = np.asarray(self.expression.eval(space.mesh, cells))
        ends = np.cumsum([len(part.entries) for part in self.parts])
        # dolfinx 0.9 has points and components on one axis, 0.11 on two
        values = values.reshape(len(cells), space.dofmap.list.shape[1], ends[-1])
        return np.split(values, ends[:-1], axis=-1)

    def fill(self) -> list[float]:
        """Fill the Functions; return the numbers of undefined points; not collective."""
        found = self.evaluate()
        for part, values in zip(self.parts, found, strict=True):
            dofmap = part.function.function_space.dofmap
            table = part.function.x.array.reshape(-1, dofmap.bs)[:, part.components]
            table[dofmap.list[self.cells]] = values
        return [float(np.sum(~np.isfinite(values).all(axis=-1))) for values in found]

    def numbers(self) -> list[Floats]:
        """Values of the inputs."""
        return [
            np.asarray(f.value) if isinstance(f, fem.Constant) else f.x.array for f in self.inputs
        ]


def create_source(cells: Ints, *parts: Part) -> Source:
    """Compile parts with the same points; a ValueError on all ranks if invalid; collective."""
    V = parts[0].function.function_space
    value = ufl.as_vector([entry for part in parts for entry in part.entries])
    # a number alone has no mesh
    zero = fem.Constant(V.mesh, np.zeros(value.ufl_shape, dtype=default_scalar_type))
    try:
        expression = fem.Expression(value + zero, compat.interpolation_points(V))
    except Exception as error:
        raise ValueError(
            f"{', '.join(part.name for part in parts)} cannot be evaluated at the integration "
            f"points ({error}); a Function in a quadrature space must have the quadrature_degree "
            "of the Solid."
        ) from error
    inputs = (*extract_coefficients(value), *extract_constants(value))
    return Source(parts, cells, expression, inputs)


def point_function(
    domain: mesh.Mesh, degree: int, shape: tuple[int, ...] = (), name: str | None = None
) -> fem.Function:
    """Create a Function of scalars, vectors or stored (3, 3) tensors at quadrature points."""
    size = (len(COMPONENTS[domain.geometry.dim]),) if shape == (3, 3) else shape
    element = basix.ufl.quadrature_element(
        domain.basix_cell(), value_shape=size, scheme="default", degree=degree
    )
    return fem.Function(fem.functionspace(domain, element), name=name)


@contextmanager
def unchanged(functions: Iterable[fem.Function], *, on_error: bool = False) -> Iterator[None]:
    """Restore Functions after a block, or only after one that fails; not collective."""
    kept = [(f, f.x.array.copy()) for f in functions]
    try:
        yield
        kept = [] if on_error else kept
    finally:
        for f, values in kept:
            f.x.array[:] = values


def middle_of(domain: mesh.Mesh, cell: int) -> str:
    """Midpoint of a local cell in words."""
    x = mesh.compute_midpoints(domain, domain.topology.dim, np.array([cell], dtype=np.int32))[0]
    return "(" + ", ".join(f"{v:.4g}" for v in x[: domain.geometry.dim]) + ")"


def check_source(u: fem.Function, name: str, value: Expr) -> None:
    """Raise a ValueError unless a value is real, on the mesh and independent of u."""
    check_real(name, *extract_coefficients(value), *extract_constants(value))
    if u in extract_coefficients(value):
        raise ValueError(
            f"{name} depends on the displacement; write a law, see dolfinx_mortar.Material."
        )
    own = u.function_space.mesh.ufl_domain()
    if any(d not in (None, own) for d in ufl.domain.extract_domains(value)):
        raise ValueError(f"{name} lives on another mesh than the displacement; interpolate it.")


class Followed(ABC):
    """Values at points in `function`, evaluated again if `varying`."""

    def __init__(self, function: fem.Function, sources: Sequence[Source]) -> None:
        self.function = function
        self.varying = bool(sources)
        self._sources = list(sources)
        self._seen: list[Floats] | None = None

    def outdated(self) -> bool:
        """Whether data have changed on this rank."""
        now = [numbers for source in self._sources for numbers in source.numbers()]
        return self._seen is None or not all(map(np.array_equal, now, self._seen))

    def follow(self) -> None:
        """Evaluate everything; collective.

        Raises:
            ValueError: on all ranks, for invalid values; all are then unchanged.
        """
        with unchanged([self.function], on_error=True):
            for source in self._sources:
                source.fill()
            self.judge()
        self._seen = [n.copy() for source in self._sources for n in source.numbers()]

    @abstractmethod
    def judge(self) -> None:
        """Raise a ValueError on all ranks for invalid values; collective."""

    def forget(self) -> None:
        """Mark the values as outdated."""
        self._seen = None


def follow_changed(comm: MPI.Comm, followed: Sequence[Followed]) -> None:
    """Evaluate what has changed on any rank; collective if any may change."""
    varying = [one for one in followed if one.varying]
    changed = np.array([one.outdated() for one in varying], dtype=bool)
    if varying:
        comm.Allreduce(MPI.IN_PLACE, changed, op=MPI.LOR)
    for one, outdated in zip(varying, changed, strict=True):
        if outdated:
            one.follow()


def fill_all(comm: MPI.Comm, evaluations: Sequence[Source]) -> None:
    """Evaluate all expressions; collective.

    Raises:
        ValueError: on all ranks, naming a law that gives NaN or infinity on any.
    """
    names = [part.name for source in evaluations for part in source.parts]
    found = [count for source in evaluations for count in source.fill()]
    for name, count in zip(names, maximum(comm, *found), strict=True):
        if count:
            raise ValueError(
                f"{name} is NaN or infinite at {count:.0f} integration points or more; "
                "check the law with dolfinx_mortar.materials.check and its parameters"
            )

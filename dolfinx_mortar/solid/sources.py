# SPDX-License-Identifier: MIT
"""Functions at points of the bodies, and the expressions that fill them; strain, rotation, volume.

With H = grad u the Green-Lagrange strain is sym H + H^T H / 2.
"""

import dataclasses
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
from dolfinx.mesh import Mesh
from dolfinx_mortar.algebra.parallel import any_rank, maximum
from dolfinx_mortar.common import compat
from dolfinx_mortar.common.arrays import Floats, Ints
from dolfinx_mortar.common.spaces import check_real
from dolfinx_mortar.materials.response import Response
from dolfinx_mortar.materials.tensor import COMPONENTS, tensor_of, to_components
from dolfinx_mortar.solid.kinematics import Kinematics
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
        eigenstrain: Any,
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

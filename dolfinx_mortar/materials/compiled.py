# SPDX-License-Identifier: MIT
"""A law as a compiled function of numbers: the code that a solid runs, without any mesh."""

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numba
import numpy as np
from llvmlite import ir

import basix.ufl
import ffcx.codegeneration.jit
import ufl
from dolfinx_mortar.arrays import Floats, Ints
from dolfinx_mortar.materials.plane_stress import Equation, solve
from dolfinx_mortar.materials.protocol import Law, create_law
from dolfinx_mortar.materials.ranges import grouped, named_parameters
from dolfinx_mortar.materials.response import elastic_response, respond, values_at_points
from dolfinx_mortar.materials.tensor import from_components, stored, tensor_of, to_components
from ufl.core.expr import Expr

ANYWHERE = np.full((1, 3), 0.25)  # in the reference tetrahedron, on which nothing depends
_CORNERS = np.vstack([np.zeros(3), np.eye(3)])


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
        self.shapes = {name: (6,) if shape else () for name, shape in law.state.items()}
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
        for name, shape in self.shapes.items():
            new = response.updated[name]
            parts.append(to_components(new, 6) if shape else [new])
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
        self.shapes = {name: (6,) if shape else () for name, shape in law.state.items()}
        self._law, self._p = law, parameters(material)
        strain, *rest = symbols((6,), *[()] * len(self._p))
        p = grouped(dict(zip(self._p, rest, strict=True)))
        (self._elastic,) = compile_vectors(
            [ufl.as_vector(entries(elastic_response(law, strain, p)))]
        )

    def __call__(self, strain: Floats, direction: Floats, state: Mapping[str, Floats]) -> Point:
        """Evaluate the law, see `CompiledLaw`."""
        p = grouped({name: np.array([value]) for name, value in self._p.items()})
        committed = {
            name: tensor_of(np.atleast_2d(state[name])) if shape else np.atleast_1d(state[name])
            for name, shape in self.shapes.items()
        }
        found = values_at_points(self._law, tensor_of(strain[None]), committed, p)
        change = np.einsum("ijkl,kl->ij", found.tangent[0], tensor_of(direction[None])[0])
        new = {name: stored(v)[0] if v.ndim == 3 else v[0] for name, v in found.state.items()}
        elastic = self._elastic(np.array([*strain, *self._p.values()])).reshape(3, 3)
        return Point(found.stress[0], elastic, change, np.nan, new)


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


def constants(count: int) -> ufl.Constant:
    """Return numbers of which `compile_vectors` makes the argument of functions."""
    domain = ufl.Mesh(basix.ufl.element("Lagrange", "tetrahedron", 1, shape=(3,)))
    return ufl.Constant(domain, shape=(count,))


def symbols(*shapes: tuple[int, ...]) -> list[Expr]:
    """Return `constants` in turn as scalars, (), and tensors of stored components, (6,)."""
    numbers = constants(sum(6 if shape else 1 for shape in shapes))
    rest = iter(range(len(numbers)))
    return [
        from_components(ufl.as_vector([numbers[next(rest)] for _ in range(6)]))
        if shape
        else numbers[next(rest)]
        for shape in shapes
    ]


def compile_vectors(vectors: list[Expr]) -> list[Callable[[Floats], Floats]]:
    """Return for each expression a function of the constants (n,) that gives its values."""
    # A number of its own distinguishes equal expressions, whose code would have the same name.
    told = [ufl.as_vector([*vector, ufl.as_ufl(k + 1.0)]) for k, vector in enumerate(vectors)]
    # In a folder of its own, so that ranks that compile at the same time do not meet.
    with tempfile.TemporaryDirectory() as folder:
        compiled, module, _ = ffcx.codegeneration.jit.compile_expressions(
            [(vector, ANYWHERE) for vector in told],
            cache_dir=Path(folder),
            cffi_extra_compile_args=["-O1"],
        )
    return [
        _evaluation(module.ffi, one.tabulate_tensor_float64, vector.ufl_shape[0])
        for one, vector in zip(compiled, vectors, strict=True)
    ]


def _evaluation(ffi: Any, kernel: Any, count: int) -> Callable[[Floats], Floats]:
    """Return a compiled expression as a function of its constants."""
    nothing = [ffi.NULL] * (len(ffi.typeof(kernel).args) - 4)  # newer kernels take more

    def evaluate(numbers: Floats) -> Floats:
        values, none = np.zeros(count + 1), np.zeros(1)
        arrays = (values, none, np.ascontiguousarray(numbers), _CORNERS)
        kernel(*(ffi.cast("double *", ffi.from_buffer(a)) for a in arrays), *nothing)
        return values[:count]

    return evaluate


@dataclass(frozen=True)
class Kernel:
    """A compiled expression of `constants`."""

    address: int  # of its function in C
    size: int  # how many values it has
    module: Any  # keeps the code


def compile_kernel(vector: Expr) -> Kernel:
    """Compile a vector of expressions of `constants`."""
    with tempfile.TemporaryDirectory() as folder:
        compiled, module, _ = ffcx.codegeneration.jit.compile_expressions(
            [(vector, ANYWHERE)], cache_dir=Path(folder), cffi_extra_compile_args=["-O2"]
        )
    return kernel_of(compiled[0], module, vector)


def kernel_of(compiled: Any, module: Any, vector: Expr) -> Kernel:
    """Return what FFCx has made of a vector of expressions."""
    ffi = module.ffi
    address = int(ffi.cast("uintptr_t", compiled.tabulate_tensor_float64))
    return Kernel(address, vector.ufl_shape[0], (compiled, module))


def tabulate(kernel: Kernel, numbers: Floats) -> Floats:
    """Return the values (q, size) of a kernel at q points, for their numbers (q, n)."""
    values = np.zeros((len(numbers), kernel.size))
    _tabulate(kernel.address, numbers, values, _CORNERS)
    return values


@numba.extending.intrinsic
def _call(typing, address, values, numbers, corners):  # type: ignore[no-untyped-def]
    """Call a function of FFCx by its address; all arguments are addresses."""
    integer = numba.types.intp

    def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        pointer = ir.IntType(8).as_pointer()
        # values, coefficients, constants, coordinates, entity, permutation; newer ones take more
        function = ir.FunctionType(ir.VoidType(), [pointer] * 7)
        called, values, numbers, corners = arguments
        none = ir.Constant(pointer, None)
        given = [builder.inttoptr(a, pointer) for a in (values, numbers, corners)]
        where = builder.inttoptr(called, function.as_pointer())
        builder.call(where, [given[0], none, given[1], given[2], none, none, none])
        return context.get_dummy_value()

    return numba.types.void(integer, integer, integer, integer), generate


@numba.njit(cache=True)
def _tabulate(address, numbers, values, corners):  # type: ignore[no-untyped-def]
    """Call a kernel at all points."""
    for q in range(len(numbers)):
        _call(address, values[q].ctypes.data, numbers[q].ctypes.data, corners.ctypes.data)

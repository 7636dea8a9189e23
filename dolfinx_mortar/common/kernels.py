# SPDX-License-Identifier: MIT
"""UFL expressions as compiled functions of numbers, without a mesh."""

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numba
import numpy as np
from llvmlite import ir

import basix.ufl
import ffcx.codegeneration.jit
import ufl
from dolfinx_mortar.common.arrays import Floats
from ufl.core.expr import Expr

ANYWHERE = np.full((1, 3), 0.25)  # any point
_CORNERS = np.vstack([np.zeros(3), np.eye(3)])


def constants(count: int) -> ufl.Constant:
    """Symbols for the arguments of `compile_kernel`."""
    domain = ufl.Mesh(basix.ufl.element("Lagrange", "tetrahedron", 1, shape=(3,)))
    return ufl.Constant(domain, shape=(count,))


@dataclass(frozen=True)
class Kernel:
    """A compiled expression of `constants`."""

    address: int
    size: int
    module: Any  # keeps the code alive


def compile_kernel(vector: Expr) -> Kernel:
    """Compile a vector of expressions of `constants`."""
    with tempfile.TemporaryDirectory() as folder:
        compiled, module, _ = ffcx.codegeneration.jit.compile_expressions(
            [(vector, ANYWHERE)], cache_dir=Path(folder), cffi_extra_compile_args=["-O2"]
        )
    return kernel_of(compiled[0], module, vector)


def kernel_of(compiled: Any, module: Any, vector: Expr) -> Kernel:
    """Kernel of a compiled vector."""
    ffi = module.ffi
    address = int(ffi.cast("uintptr_t", compiled.tabulate_tensor_float64))
    return Kernel(address, vector.ufl_shape[0], (compiled, module))


def tabulate(kernel: Kernel, numbers: Floats) -> Floats:
    """Values (q, size) of a kernel for numbers (q, n)."""
    values = np.zeros((len(numbers), kernel.size))
    _tabulate(kernel.address, numbers, values, _CORNERS)
    return values


@numba.extending.intrinsic
def _call(typing, address, values, numbers, corners):  # type: ignore[no-untyped-def]
    integer = numba.types.intp

    def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        pointer = ir.IntType(8).as_pointer()
        # values, coefficients, constants, coordinates, entity, permutation; newer ones have more
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
    for q in range(len(numbers)):
        _call(address, values[q].ctypes.data, numbers[q].ctypes.data, corners.ctypes.data)

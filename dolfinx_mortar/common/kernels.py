# SPDX-License-Identifier: MIT
"""UFL expressions as compiled functions of numbers, without a mesh."""

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numba
import numba.experimental.function_type
import numpy as np

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
class Kernel(numba.types.WrapperAddressProtocol):
    """A compiled expression of `constants`, as a function of seven pointers for Numba."""

    address: int
    size: int
    module: Any  # keeps the code alive

    def __wrapper_address__(self) -> int:
        return self.address

    def signature(self) -> Any:
        """Types of the result and of the arguments."""
        return numba.types.void(*[numba.types.uintp] * 7)


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
    _tabulate(kernel, numbers, values, _CORNERS)
    return values


@numba.njit(cache=True)
def _tabulate(kernel, numbers, values, corners):  # type: ignore[no-untyped-def]
    none, x = np.uintp(0), corners.ctypes.data
    for q in range(len(numbers)):
        # values, coefficients, constants, coordinates, entity, permutation; newer ones have more
        kernel(values[q].ctypes.data, none, numbers[q].ctypes.data, x, none, none, none)

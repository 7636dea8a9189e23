# SPDX-License-Identifier: MIT
"""The jump of a tie: forms in which it may be given, and its values at the slave nodes."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from dolfinx import fem
from dolfinx_mortar.arguments import as_numbers
from dolfinx_mortar.arrays import Floats, Ints
from dolfinx_mortar.spaces import check_nodal, check_real
from ufl.core.expr import Expr

Jump = Sequence[float] | Floats | fem.Constant | fem.Function | Callable[[Floats], Floats] | None
"""A vector in Cartesian components, the same everywhere or one at each point."""


def check_jump(jump: Any, d: int) -> Any:
    """Return a jump as it is kept, numbers as an array; without communication.

    Args:
        jump: what a user gives.
        d: how many components it needs.

    Raises:
        ValueError: for what is none, has another shape, or holds NaN or infinity.
    """
    if jump is None:
        return None
    example = ", ".join(["0"] * (d - 1) + ["0.1"])
    wanted = (
        f"give {d} Cartesian components of a length, [{example}], or a Constant, a Function or a "
        "function of points x (3, n) that has them"
    )
    if isinstance(jump, fem.Constant | fem.Function):
        check_real("jump", jump)
        if isinstance(jump, fem.Function):
            check_nodal("jump", jump, (d,), wanted)
        elif jump.value.shape != (d,):
            raise ValueError(f"jump is a Constant of shape {jump.value.shape}: {wanted}")
        return jump
    if isinstance(jump, Expr):  # those can be called, too
        raise ValueError(
            f"jump is an expression of UFL, {type(jump).__name__}: interpolate it into a Function "
            "of the displacement's space, and that again where it changes between steps"
        )
    if callable(jump):
        return jump
    values = as_numbers(jump)
    if values is None:
        raise ValueError(f"jump is {jump!r}: {wanted}")
    if values.shape != (d,):
        raise ValueError(f"jump is {jump!r}, of shape {values.shape}: {wanted}")
    if not np.isfinite(values).all():
        raise ValueError(f"jump is {jump!r}: it must be finite; {wanted}")
    return values


def nodal_function(jump: Any, V: fem.FunctionSpace) -> Any:
    """Return a Function as one of V, all else as it is; collective for Functions."""
    if not isinstance(jump, fem.Function) or jump.function_space == V:
        return jump
    jump.x.scatter_forward()
    nodal = fem.Function(V)
    nodal.interpolate(jump)
    return nodal


def values_at(jump: Any, V: fem.FunctionSpace, nodes: Ints) -> Floats:
    """Return the jump (n, d) at owned nodes; without communication.

    Args:
        jump: what `check_jump` has returned, a Function as one of V.
        nodes: (n,) local numbers.

    Raises:
        ValueError: if a function of points returns another shape.
    """
    d = V.dofmap.index_map_bs
    if jump is None:
        return np.zeros((len(nodes), d))
    if isinstance(jump, fem.Function):
        return np.array(jump.x.array.reshape(-1, d)[nodes])
    if isinstance(jump, fem.Constant):
        return np.tile(jump.value, (len(nodes), 1))
    if isinstance(jump, np.ndarray):
        return np.tile(jump, (len(nodes), 1))
    if not len(nodes):  # functions need not handle an empty set of points
        return np.zeros((0, d))
    x = np.ascontiguousarray(V.tabulate_dof_coordinates()[nodes].T)
    found = as_numbers(jump(x))
    if found is None:
        raise ValueError("jump: the function returns no real numbers; it must return a vector (d,)")
    if found.shape != (d, len(nodes)):
        raise ValueError(
            f"jump: the function returns the shape {found.shape} for {len(nodes)} points x (3, n); "
            f"it must return {(d, len(nodes))}, a vector for each point"
        )
    return found.T

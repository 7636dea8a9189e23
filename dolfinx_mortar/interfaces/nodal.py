# SPDX-License-Identifier: MIT
"""Functions that users give to an interface: one value at every node, on the mesh of the bodies."""

from typing import Any

from dolfinx import fem


def check_nodal(name: str, function: fem.Function, shape: tuple[int, ...], wanted: str) -> None:
    """Raise a ValueError unless a Function has one value of a shape at every node.

    Args:
        function: what it is.
        shape: () for a scalar, (d,) for a vector.
        wanted: what to give instead, for the message.
    """
    V = function.function_space
    element = V.ufl_element()
    if V.component():
        raise ValueError(f"{name} is a part of a Function: give function.sub(i).collapse()")
    if element.family_name != "P" or element.discontinuous:
        raise ValueError(
            f"{name} is a Function with the element {element}, which has not one value at every "
            f"node: interpolate it into a Lagrange space; {wanted}"
        )
    if element.reference_value_shape != shape:
        raise ValueError(
            f"{name} is a Function with values of shape {element.reference_value_shape}: {wanted}"
        )


def check_mesh(name: str, value: Any, V: fem.FunctionSpace) -> None:
    """Raise a ValueError if a value lives on another mesh than the displacement."""
    domain = None
    if isinstance(value, fem.Function):
        domain = value.function_space.mesh.ufl_domain()
    elif isinstance(value, fem.Constant):
        domain = value.ufl_domain()
    if domain is not None and domain != V.mesh.ufl_domain():
        raise ValueError(
            f"{name} is a {type(value).__name__} on another mesh than solid.u: make it on "
            "solid.mesh"
        )

# SPDX-License-Identifier: MIT
"""What a problem may be made of: checks of its arguments, the same on all ranks."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from numbers import Integral, Real
from typing import Any

import numpy as np

import ufl
from dolfinx import fem
from dolfinx_mortar.algebra.parallel import any_rank
from dolfinx_mortar.interfaces.interface import Interface
from dolfinx_mortar.solid.solid import Solid

GEOMETRIES = ("updated", "reference")


def check_arguments(
    solid: Solid,
    interfaces: Iterable[Interface],
    bcs: Iterable[fem.DirichletBC],
    loads: ufl.Form | None,
    geometry: str,
) -> tuple[list[Interface], list[fem.DirichletBC]]:
    """Return interfaces and Dirichlet conditions as lists if a problem can be made; collective.

    Raises:
        ValueError: if not, naming the argument and the remedy.
    """
    if not isinstance(solid, Solid):
        raise ValueError(f"solid is {solid!r}: give a Solid(u, materials, cell_tags)")
    if geometry not in GEOMETRIES:
        raise ValueError(f"geometry is {geometry!r}: choose 'updated' or 'reference'")
    sides = _check_interfaces(_as_list("interfaces", interfaces))
    conditions = _check_conditions(_as_list("bcs", bcs), solid.V)
    if loads is not None:
        _check_loads(loads, solid.V)
    finite = np.isfinite(solid.V.mesh.geometry.x).all()
    if any_rank(solid.V.mesh.comm, not finite)[0]:
        raise ValueError("the mesh's coordinates hold NaN or infinity; check the mesh")
    return sides, conditions


def check_owned(interfaces: Iterable[Interface], owner: object) -> None:
    """Raise a ValueError if a problem made later has taken over an interface.

    Args:
        interfaces: those of the problem.
        owner: what the problem has taken them for.
    """
    for interface in interfaces:
        if interface.owner is not owner:
            raise ValueError(
                f"interfaces: {interface} belongs to a problem made later; give each its own"
            )


def check_controls(rtol: Any, max_it: Any) -> None:
    """Raise a ValueError unless the controls of Newton's method make sense."""
    if not (isinstance(rtol, Real) and 0.0 < float(rtol) < 1.0):
        raise ValueError(f"rtol is {rtol!r}: need a number, 0 < rtol < 1")
    if not isinstance(max_it, Integral) or max_it < 1:
        raise ValueError(f"max_it is {max_it!r}: need an integer, max_it >= 1")


def _as_list(name: str, given: Any) -> list[Any]:
    """Return the members of a sequence; a lone object is an error with a hint."""
    if given is None:
        raise ValueError(f"{name} is None: give a list, [] for none")
    if not isinstance(given, Iterable):
        raise ValueError(f"{name} is {given!r}: give a list, [{name[:-1]}]")
    return list(given)


def _check_interfaces(interfaces: list[Any]) -> list[Interface]:
    """Return interfaces if they are some, and all different."""
    for k, interface in enumerate(interfaces):
        if not isinstance(interface, Interface):
            raise ValueError(f"interfaces holds {interface!r}: give Contact or Tie objects")
        if any(interface is other for other in interfaces[:k]):
            raise ValueError(f"interfaces holds the same object {interface!r} twice: give it once")
    return interfaces


def _check_conditions(bcs: Sequence[Any], V: fem.FunctionSpace) -> list[fem.DirichletBC]:
    """Return Dirichlet conditions if they are some, on V or its components."""
    for bc in bcs:
        if not isinstance(bc, fem.DirichletBC):
            raise ValueError(f"bcs holds {bc!r}: make it with dolfinx.fem.dirichletbc")
        space = bc.function_space
        if not V._cpp_object.contains(getattr(space, "_cpp_object", space)):
            raise ValueError(
                "bcs holds a condition on another space than that of solid.u: make it on "
                "u.function_space or a component, u.function_space.sub(i)"
            )
    return list(bcs)


def _check_loads(loads: Any, V: fem.FunctionSpace) -> None:
    """Raise a ValueError unless the loads are a linear form of V's test function."""
    wanted = "give a linear form, for example inner(t, v) * ds"
    if isinstance(loads, fem.Form):
        raise ValueError(f"loads is a compiled form: {wanted}, in UFL as it is before fem.form")
    if not isinstance(loads, ufl.Form):  # its repr may fill pages
        raise ValueError(f"loads is a {type(loads).__name__}: {wanted}")
    if len(loads.arguments()) != 1:
        raise ValueError(f"loads has {len(loads.arguments())} arguments, not one: {wanted}")
    space = loads.arguments()[0].ufl_function_space()
    if space != V.ufl_function_space():
        raise ValueError(
            "loads: the test function belongs to another space; make it with "
            "TestFunction(u.function_space)"
        )

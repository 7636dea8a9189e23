# SPDX-License-Identifier: MIT
"""What a law makes of a strain: its methods called and what they return judged, as UFL."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import ufl
from ufl.classes import Label, Variable
from ufl.core.expr import Expr


@dataclass(frozen=True)
class Response:
    """The answer of a law to a strain."""

    stress: Expr  # (3, 3)
    energy: Expr | None  # the incremental potential, if the law has one
    updated: dict[str, Expr]  # internal variables at the end of the step, () or (3, 3)
    # direction, 3x3 -> d stress / d strain : direction; None leaves it to UFL
    change: Callable[[Expr], Expr] | None = None


def respond(law: type, strain: Expr, state: Mapping[str, Expr], p: Any) -> Response:
    """Return stress, energy and new internal variables of a law.

    A law without a stress gives the derivative of its energy.

    Args:
        law: class of the material.
        strain: 3x3 UFL expression.
        state: committed internal variables by name, () or (3, 3).
        p: parameters as attributes.

    Raises:
        ValueError: if a method of the law raises, or returns something of the wrong shape or name.
    """
    energy = None
    if callable(getattr(law, "energy", None)):
        energy = _call(law, "energy", (), strain, state, p)
    if callable(getattr(law, "stress", None)):
        stress = _call(law, "stress", (3, 3), strain, state, p)
    else:
        # Not ufl.variable: its running number would get into the signature of the compiled code.
        variable = Variable(strain, Label(-1))
        stress = ufl.diff(_call(law, "energy", (), variable, state, p), variable)
    change = None
    if callable(getattr(law, "tangent", None)):

        def change(direction: Expr) -> Expr:
            return _call(law, "tangent", (3, 3), strain, state, p, direction)

    return Response(stress, energy, _updated_state(law, strain, state, p), change)


def elastic_response(law: type, strain: Expr, p: Any) -> Expr:
    """Return C : strain of a law, 3x3.

    Raises:
        ValueError: if the method raises, or returns something of another shape.
    """
    return _call(law, "elastic_stress", (3, 3), strain, p)


def _updated_state(law: type, strain: Expr, state: Mapping[str, Expr], p: Any) -> dict[str, Expr]:
    """Return the new internal variables, one for each that is declared."""
    if not callable(getattr(law, "updated_state", None)):
        return {}
    new = _guarded(law, "updated_state", strain, state, p)
    where = f"{law.__name__}.updated_state"
    if not isinstance(new, Mapping):
        raise ValueError(f"{where} returns {new!r}; it must return a dictionary by name.")
    shapes: Mapping[str, tuple[int, ...]] = law.state  # type: ignore[attr-defined]
    declared = ", ".join(shapes) or "nothing"
    for name in new:
        if name not in shapes:
            raise ValueError(f"{where} returns {name!r}, but `state` declares {declared}.")
    for name in shapes:
        if name not in new:
            raise ValueError(f"{where} does not return {name!r}, which `state` declares.")
    return {name: _shaped(f"{where}: {name}", new[name], shapes[name]) for name in shapes}


def _call(law: type, method: str, shape: tuple[int, ...], *arguments: Any) -> Expr:
    """Return what a method of a law gives, as UFL of the right shape."""
    return _shaped(f"{law.__name__}.{method}", _guarded(law, method, *arguments), shape)


def _guarded(law: type, method: str, *arguments: Any) -> Any:
    """Call a method of a law; its errors name it."""
    try:
        return getattr(law, method)(*arguments)
    except Exception as error:
        wanted = _ARGUMENTS.get(method, "(strain, state, p)")
        raise ValueError(
            f"{law.__name__}.{method} raised {type(error).__name__}: {error} (it is called as a "
            f"static method, {method}{wanted}, with UFL)"
        ) from error


_ARGUMENTS = {"elastic_stress": "(strain, p)", "tangent": "(strain, state, p, direction)"}


def _shaped(what: str, value: Any, shape: tuple[int, ...]) -> Expr:
    """Return a value as UFL, or raise a ValueError if it is something else."""
    try:
        expression = ufl.as_ufl(value)
    except Exception as error:
        raise ValueError(f"{what} is a {type(value).__name__}; it must be UFL.") from error
    if expression.ufl_shape != shape or expression.ufl_free_indices:
        indices = ", with free indices" if expression.ufl_free_indices else ""
        raise ValueError(
            f"{what} has the shape {expression.ufl_shape}{indices}; it must be {shape}."
        )
    return expression

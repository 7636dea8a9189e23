# SPDX-License-Identifier: MIT
"""Parameters of a law: numbers, or UFL scalars that may change; and the ranges they must be in."""

import dataclasses
from collections.abc import Callable, Mapping
from numbers import Real
from types import SimpleNamespace
from typing import Any, TypeAlias

import numpy as np

from dolfinx_mortar.arguments import check, number
from dolfinx_mortar.arrays import Bools, Floats
from ufl.core.expr import Expr

Parameter: TypeAlias = float | Expr
"""A number, a dolfinx Constant or Function, or a scalar UFL expression of such and of position.

Constants and Functions may change between steps; nothing is compiled anew.
"""
Range = tuple[float, float, bool]
"""Lower end, upper end (never allowed), and whether the lower end is allowed."""


def named_parameters(material: Any) -> dict[str, Any]:
    """Return the parameters of a material by name; those of a tuple as ``name[0]``, ``name[1]`` ..

    >>> from dolfinx_mortar.materials import Ogden
    >>> named_parameters(Ogden(mu=(0.6, -0.1), alpha=(1.3, -2.0), K=1e3))["mu[1]"]
    -0.1
    """
    found: dict[str, Any] = {}
    for field in dataclasses.fields(material):
        value = getattr(material, field.name)
        if isinstance(value, tuple):
            found |= {f"{field.name}[{i}]": entry for i, entry in enumerate(value)}
        else:
            found[field.name] = value
    return found


def grouped(values: Mapping[str, Any]) -> SimpleNamespace:
    """Return what `named_parameters` has named as attributes, tuples as tuples again."""
    groups: dict[str, Any] = {}
    for name, value in values.items():
        stem, _, number = name.partition("[")
        groups[stem] = (*groups.get(stem, ()), value) if number else value
    return SimpleNamespace(**groups)


def ungrouped(p: SimpleNamespace) -> dict[str, Any]:
    """Return what `grouped` was made of.

    >>> ungrouped(grouped({"a": 1, "b[0]": 2, "b[1]": 3}))
    {'a': 1, 'b[0]': 2, 'b[1]': 3}
    """
    found: dict[str, Any] = {}
    for name, value in vars(p).items():
        several = isinstance(value, tuple)
        found |= {f"{name}[{i}]": v for i, v in enumerate(value)} if several else {name: value}
    return found


def check_fields(law: Any) -> None:
    """Raise ValueError unless the numbers among the parameters of a law are in its ranges.

    What may change is judged by the `Solid`, which knows its values. The law is a dataclass with
    ``ranges`` and, for what involves several parameters, ``conditions(p)``, see `Material`.
    """
    kind = type(law)
    given = {name: (getattr(law, name), *limits) for name, limits in kind.ranges.items()}
    check_parameters(kind.__name__, **given)
    values = {field.name: getattr(law, field.name) for field in dataclasses.fields(law)}
    if all(isinstance(value, Real) for value in values.values()):
        rules = getattr(kind, "conditions", None)
        for rule, holds in conditions(kind.__name__, rules, values).items():
            if not holds.all():
                numbers = ", ".join(f"{name} = {value!r}" for name, value in values.items())
                raise ValueError(f"{kind.__name__}: {rule} does not hold for {numbers}.")


def check_parameters(law: str, **ranges: tuple[Parameter, float, float, bool]) -> None:
    """Raise ValueError unless each parameter=(value, *`Range`) is a finite number in it, or UFL."""
    for name, (value, lower, upper, closed) in ranges.items():
        if not isinstance(value, Expr):
            above, least = (-np.inf, lower) if closed else (lower, -np.inf)
            check(f"{law}: {name}", value, number(above=above, least=least, below=upper))


def wrong_values(
    law: str,
    ranges: Mapping[str, Range],
    rules: Callable[..., Any] | None,
    values: Mapping[str, Floats],
) -> dict[str, Bools]:
    """Return the rules that do not hold, in words, and at which places (n,)."""
    found = {
        f"{name} in {interval(*limits)}": ~_inside(values[name], *limits)
        for name, limits in ranges.items()
    }
    sound = ~np.any(list(found.values()), axis=0) if found else True
    for rule, holds in conditions(law, rules, values).items():
        found[rule] = sound & ~holds
    return {rule: wrong for rule, wrong in found.items() if wrong.any()}


def conditions(
    law: str, rules: Callable[..., Any] | None, values: Mapping[str, Any]
) -> dict[str, Bools]:
    """Return what a law asks of several parameters, in words, and whether or where it holds."""
    if rules is None:
        return {}
    shape = np.shape(next(iter(values.values()), 0.0))
    try:
        with np.errstate(all="ignore"):
            found = dict(rules(grouped(values)))
        return {rule: np.broadcast_to(np.asarray(f, bool), shape) for rule, f in found.items()}
    except Exception as error:
        raise ValueError(
            f"{law}.conditions raised {type(error).__name__}: {error}; it must return "
            "rule -> whether or where it holds, of numbers or arrays (n,)."
        ) from error


def _inside(values: Floats, lower: float, upper: float, closed: bool) -> Bools:
    """Return which values are finite and in a range."""
    above = values >= lower if closed else values > lower
    return np.asarray(np.isfinite(values) & above & (values < upper))


def interval(lower: float, upper: float, closed: bool) -> str:
    """Return how a message writes a range.

    >>> interval(-1.0, 0.5, False)
    '(-1.0, 0.5)'
    """
    return f"{'[' if closed else '('}{lower}, {upper})"

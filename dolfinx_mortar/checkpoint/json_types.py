# SPDX-License-Identifier: MIT
"""Whether values read from JSON have the types of a type hint."""

from __future__ import annotations

import dataclasses
import types
from collections.abc import Mapping
from typing import Any, Union, get_args, get_origin, get_type_hints, is_typeddict


def check_form(name: str, value: Any, hint: Any) -> None:
    """Raise a ValueError that names what differs, unless a JSON value has the form of a type.

    Args:
        name: how messages call the value.
        value: of dictionaries, lists, texts, numbers, flags and None.
        hint: a type made of them, of unions, of TypedDicts and of dataclasses. A dataclass is a
            dictionary of its fields; those with a default may be missing, others may be there.

    >>> check_form("sizes", [1, 2.5], list[float])
    >>> check_form("sizes", [1, True], list[float])
    Traceback (most recent call last):
    ValueError: sizes[1] is True: need float
    """
    origin = get_origin(hint)
    if origin in (Union, types.UnionType):
        _check_union(name, value, get_args(hint))
    elif origin is list:
        _demand(isinstance(value, list), name, value, "a list")
        for k, entry in enumerate(value):
            check_form(f"{name}[{k}]", entry, get_args(hint)[0])
    elif origin is dict:
        _demand(isinstance(value, dict), name, value, "a dictionary")
        for key, entry in value.items():
            check_form(f"{name}[{key!r}]", entry, get_args(hint)[1])
    elif is_typeddict(hint) or dataclasses.is_dataclass(hint):
        _demand(isinstance(value, dict), name, value, "a dictionary")
        _check_entries(name, value, hint)
    elif hint is not Any:
        _demand(_is_plain(value, hint), name, value, hint.__name__)


def _check_union(name: str, value: Any, hints: tuple[Any, ...]) -> None:
    """Check a value that may have one of several forms, None or another in most cases."""
    others = [hint for hint in hints if hint is not types.NoneType]
    if value is None and len(others) < len(hints):
        return
    for hint in others[:-1]:
        try:
            return check_form(name, value, hint)
        except ValueError:
            continue
    check_form(name, value, others[-1])


def _check_entries(name: str, value: Mapping[str, Any], hint: Any) -> None:
    """Check the entries of a dictionary whose keys are known."""
    optional = set()
    if dataclasses.is_dataclass(hint):
        none = dataclasses.MISSING
        fields = dataclasses.fields(hint)
        optional = {f.name for f in fields if (f.default, f.default_factory) != (none, none)}
    for key, one in get_type_hints(hint).items():
        if key in value:
            check_form(f"{name}[{key!r}]", value[key], one)
        elif key not in optional:
            raise ValueError(f"{name}[{key!r}] is missing")


def _is_plain(value: Any, hint: type) -> bool:
    """Tell whether a value is of a type as JSON knows it: True is no number, 1 is a float, too."""
    if hint is float:
        return isinstance(value, int | float) and not isinstance(value, bool)
    return isinstance(value, hint) and (hint is bool or not isinstance(value, bool))


def _demand(fits: bool, name: str, value: Any, wanted: str) -> None:
    if not fits:
        shown = repr(value)
        shown = shown if len(shown) <= 60 else f"{shown[:57]}..."
        raise ValueError(f"{name} is {shown}: need {wanted}")

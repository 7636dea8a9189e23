# SPDX-License-Identifier: MIT
"""Declared rules for arguments; not collective.

>>> check("n", 3, integer(1)), check("x", [1, 2], array((2,), (3,)))
(3, array([1., 2.]))
>>> check("rtol", 1.5, number(above=0.0, below=1.0))
Traceback (most recent call last):
ValueError: rtol is 1.5: give a finite number > 0 and < 1
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any, Generic, TypeVar

import numpy as np

from dolfinx_mortar.common.arrays import Floats

T = TypeVar("T")


@dataclass(frozen=True)
class Rule(Generic[T]):
    """Rule for an argument."""

    remedy: str
    read: Callable[[Any], T | None]  # converts a value, None for a wrong one


def check(name: str, value: Any, rule: Rule[T], remedy: str = "") -> T:
    """Converted argument, or a ValueError with name, value and remedy."""
    found = rule.read(value)
    if found is None:
        raise ValueError(f"{name} is {_shown(value)}: {remedy or rule.remedy}")
    return found


def check_optional(name: str, value: Any, rule: Rule[T], remedy: str = "") -> T | None:
    """Converted argument, or None."""
    remedy = remedy or f"{rule.remedy}, or None"
    return None if value is None else check(name, value, rule, remedy)


def check_all(rule: Rule[Any], **values: Any) -> None:
    """Check several arguments by one rule."""
    for name, value in values.items():
        check(name, value, rule)


def number(
    what: str = "a finite number",
    *,
    above: float = -math.inf,
    least: float = -math.inf,
    below: float = math.inf,
    most: float = math.inf,
) -> Rule[float]:
    """Rule for finite numbers in a range; ``what`` describes them."""
    limits = {">": above, ">=": least, "<": below, "<=": most}
    told = " and ".join(f"{sign} {n:g}" for sign, n in limits.items() if math.isfinite(n))

    def read(value: Any) -> float | None:
        inside = is_number(value) and above < value < below and least <= value <= most
        return float(value) if inside else None

    return Rule(f"give {what} {told}".rstrip(), read)


def integer(least: int, most: float = math.inf) -> Rule[int]:
    """Rule for integers in a range."""
    remedy = number("an integer", least=least, most=most).remedy
    return Rule(remedy, lambda n: int(n) if is_integer(n) and least <= n <= most else None)


def one_of(*names: str) -> Rule[str]:
    """Rule for some names.

    >>> one_of("a").remedy, one_of("a", "b", "c").remedy
    ("choose 'a'", "choose 'a', 'b' or 'c'")
    """
    *others, last = map(repr, names or ("nothing",))
    remedy = f"choose {', '.join(others)}{' or ' * bool(others)}{last}"
    return Rule(remedy, lambda value: value if isinstance(value, str) and value in names else None)


def instance(kind: Any, remedy: str) -> Rule[Any]:
    """Rule for objects of a class, or of one of several."""
    return Rule(remedy, lambda value: value if isinstance(value, kind) else None)


def _read_flag(value: Any) -> bool | None:
    return bool(value) if isinstance(value, bool | np.bool_) else None


FLAG = Rule("give True or False", _read_flag)


def array(
    *shapes: tuple[int | None, ...],
    remedy: str = "",
    finite: bool = True,
    holds: Callable[[Floats], object] = lambda found: True,
) -> Rule[Floats]:
    """Rule for arrays of numbers, of any shape or given ones (None for any size)."""
    sizes = " or ".join(str(shape[0]) for shape in shapes if shape)

    def read(value: Any) -> Floats | None:
        found = as_numbers(value)
        if found is None or (finite and not np.isfinite(found).all()):
            return None
        fits = (
            len(shape) == found.ndim
            and all(n in (None, m) for n, m in zip(shape, found.shape, strict=True))
            for shape in shapes
        )
        return found if (not shapes or any(fits)) and holds(found) else None

    return Rule(remedy or f"give {sizes} finite coordinates", read)


NUMBER = number()
NOT_NEGATIVE = number(least=0.0)
POSITIVE = number(above=0.0)
FINITE = array(remedy="give finite numbers")
POISSON = number("Poisson's ratio, 0.499 for an incompressible body,", above=-1.0, below=0.5)


def is_number(value: Any) -> bool:
    """Whether a value is a finite real number, not a boolean.

    >>> [is_number(v) for v in (1, np.float32(2.5), True, np.nan, 10**400, 1j, "1", None)]
    [True, True, False, False, False, False, False, False]
    """
    try:
        return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:  # beyond all floats
        return False


def is_integer(value: Any) -> bool:
    """Whether a value is an integer, not a boolean."""
    return isinstance(value, Integral) and not isinstance(value, bool)


def as_numbers(value: Any) -> Floats | None:
    """Real numbers as an array, None for texts, truth and complex values.

    >>> as_numbers([1, np.nan]), as_numbers([[1], [2, 3]]), as_numbers([True]), as_numbers([1j])
    (array([ 1., nan]), None, None, None)
    """
    try:
        array = np.asarray(value)
    except ValueError:
        return None
    return array.astype(np.float64) if array.dtype.kind in "fiu" else None


def _shown(value: Any) -> str:
    """Text of a value in an error; of large arrays shape and first non-finite value.

    >>> _shown([1.0, None]), _shown(np.full((4, 3), np.inf))
    ('[1.0, None]', 'an array of shape (4, 3), with inf at [0, 0]')
    """
    numbers = as_numbers(value)
    if numbers is None or numbers.size < 10:
        text = repr(value.tolist() if isinstance(value, np.ndarray) else value)
        return text if len(text) < 300 else f"{text[:300]} ..."  # UFL fills pages
    bad = np.argwhere(~np.isfinite(numbers))
    found = f", with {numbers[tuple(bad[0])]} at {bad[0].tolist()}" if len(bad) else ""
    return f"an array of shape {numbers.shape}{found}"

# SPDX-License-Identifier: MIT
"""Checks of arguments that all sub-packages share, without communication."""

import math
from collections.abc import Collection
from numbers import Integral, Real
from typing import Any

import numpy as np

from dolfinx_mortar.arrays import Floats


def is_number(value: Any) -> bool:
    """Tell whether a value is a finite real number, and no truth value.

    >>> [is_number(v) for v in (1, np.float32(2.5), True, np.nan, 10**400, 1j, "1", None)]
    [True, True, False, False, False, False, False, False]
    """
    try:
        return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:  # an integer beyond all floats
        return False


def is_integer(value: Any) -> bool:
    """Tell whether a value is an integer, and no truth value."""
    return isinstance(value, Integral) and not isinstance(value, bool)


def is_name(value: Any, known: Collection[str]) -> bool:
    """Tell whether a value is one of the known names; arrays and the like are none."""
    return isinstance(value, str) and value in known


def as_numbers(value: Any) -> Floats | None:
    """Return real numbers of any shape as an array, None for texts, truth and complex values.

    >>> as_numbers([1, np.nan]), as_numbers([[1], [2, 3]]), as_numbers([True]), as_numbers([1j])
    (array([ 1., nan]), None, None, None)
    """
    try:
        array = np.asarray(value)
    except ValueError:  # lists of unequal length
        return None
    return array.astype(np.float64) if array.dtype.kind in "fiu" else None

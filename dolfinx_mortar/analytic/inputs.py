# SPDX-License-Identifier: MIT
"""Checks of the numbers of closed solutions; all errors are ValueErrors that name the argument."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from dolfinx_mortar.arguments import as_numbers, is_number
from dolfinx_mortar.arrays import Floats


def numbers(name: str, values: npt.ArrayLike) -> Floats:
    """Return finite numbers as an array of any shape."""
    array = as_numbers(values)
    if array is None or not np.isfinite(array).all():
        raise ValueError(f"{name} = {values!r} must hold finite numbers only.")
    return array


def check_positive(**values: float) -> None:
    """Raise ValueError unless all are positive and finite."""
    for name, value in values.items():
        if not (is_number(value) and value > 0.0):
            raise ValueError(f"{name} = {value!r} must be a positive, finite number.")


def check_poisson(**values: float) -> None:
    """Raise ValueError unless all are Poisson's ratios of compressible bodies."""
    for name, nu in values.items():
        if not (is_number(nu) and -1.0 < nu < 0.5):
            raise ValueError(
                f"{name} = {nu!r} must lie in (-1, 0.5); take 0.499 for an incompressible body."
            )

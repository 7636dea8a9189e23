# SPDX-License-Identifier: MIT
"""What numbers closed solutions take."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinx_mortar.arrays import Floats


def is_number(value: Any) -> bool:
    """Tell whether a value is one real number, and no truth value."""
    array = np.asarray(value)
    return array.ndim == 0 and array.dtype.kind in "fiu"


def numbers(name: str, values: npt.ArrayLike) -> Floats:
    """Return finite numbers as an array of any shape."""
    array = np.asarray(values)
    if array.size and (array.dtype.kind not in "fiu" or not np.isfinite(array).all()):
        raise ValueError(f"{name} = {values!r} must hold finite numbers only.")
    return array.astype(float)


def check_positive(**values: float) -> None:
    """Raise ValueError unless all are positive and finite."""
    for name, value in values.items():
        if not (is_number(value) and 0.0 < value < np.inf):
            raise ValueError(f"{name} = {value!r} must be a positive, finite number.")


def check_record(name: str, value: Any, kind: type, maker: str) -> None:
    """Raise ValueError unless an argument is what another function of this room returns."""
    if not isinstance(value, kind):
        raise ValueError(f"{name} = {value!r} must be what {maker} returns.")


def check_poisson(**values: float) -> None:
    """Raise ValueError unless all are Poisson's ratios of compressible bodies."""
    for name, nu in values.items():
        if not (is_number(nu) and -1.0 < nu < 0.5):
            raise ValueError(
                f"{name} = {nu!r} must lie in (-1, 0.5); take 0.499 for an incompressible body."
            )

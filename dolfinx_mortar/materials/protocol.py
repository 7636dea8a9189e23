# SPDX-License-Identifier: MIT
"""What a material law is: numbers, and UFL expressions of them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from numbers import Real
from types import SimpleNamespace
from typing import Any, ClassVar, Protocol

import numpy as np

from ufl.core.expr import Expr


class Material(Protocol):
    """A frozen dataclass whose fields are the parameters, with the law as static methods.

    A law knows no mesh. It gets the strain (3x3 UFL), the committed state and the parameters `p`
    (attributes named like the fields) as UFL symbols, so that the compiled code is the same for all
    values of the parameters. Then either of

    * `energy(strain, state, p)`, the incremental potential psi of the step; the stress is
      d psi / d strain and the tangent its derivative, both taken by UFL, or
    * `stress(strain, state, p)`, for a law without a potential (no line search on the energy).

    A law that has both gives its stress in closed form, and UFL differentiates only that.

    Attributes:
        state: internal variables, name -> shape; () or (3, 3) (symmetric).
        linear: True if the stress is a linear function of the strain and nothing else.
    """

    state: ClassVar[Mapping[str, tuple[int, ...]]]
    linear: ClassVar[bool]

    @staticmethod
    def elastic_stress(strain: Expr, p: Any) -> Expr:
        """Return C : strain, the stress of an elastic increment (defines the energy norm)."""

    @staticmethod
    def updated_state(strain: Expr, state: Mapping[str, Expr], p: Any) -> dict[str, Expr]:
        """Return the internal variables at the end of the step, one per name in `state`."""

    @staticmethod
    def output(state: Mapping[str, np.ndarray], p: SimpleNamespace) -> dict[str, np.ndarray]:
        """Return further fields (q,) or (q, components) at q integration points, from NumPy."""


def check_parameters(law: str, **ranges: tuple[float, float, float, bool]) -> None:
    """Raise ValueError unless each parameter is a finite number in its range.

    Args:
        law: name of the law, for the message.
        ranges: parameter=(value, lower, upper, lower_allowed); the upper end is never allowed.
    """
    for name, (value, lower, upper, closed) in ranges.items():
        number = isinstance(value, Real) and math.isfinite(value)
        if not number or not (lower <= value if closed else lower < value) or value >= upper:
            bracket = "[" if closed else "("
            raise ValueError(
                f"{law}: {name} = {value!r} must be a finite number in {bracket}{lower}, {upper})."
            )

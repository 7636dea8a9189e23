# SPDX-License-Identifier: MIT
"""Wright's omega function in UFL, for equations of a line and an exponential."""

from __future__ import annotations

from typing import Any

import ufl
from ufl.core.expr import Expr

# Steps of third order from starts that are off by 0.07 at most: 4e-5, 6e-15. Each step makes the
# tree of the expression eight times as large, which costs time in UFL, not in the compiled code.
STEPS = 2
# Below, three terms of the series in exp(y) are exact to round-off (the next is 8/3 exp(4 y)), and
# keep digits that y - ln w loses.
SMALL = -15.0


def wright_omega(y: Any, steps: int = STEPS) -> Expr:
    """Return w > 0 with w + ln w = y, relative error below 1e-14, 4e-5 after one step, for any y.

    Equivalently the principal branch of Lambert's function, W(exp(y)). UFL must not differentiate
    it: d omega / dy = omega / (1 + omega).
    """
    z, t, high = ufl.exp(ufl.min_value(y, 0.0)), y - 1, ufl.max_value(y, 1.0)
    w = ufl.conditional(
        ufl.lt(y, 4.0),
        1 + t / 2 + t**2 / 16,  # Taylor's polynomial where w = 1
        high - 5.4 * high / (high + 16.0),  # to 1 %
    )
    w = ufl.conditional(ufl.lt(y, -0.5), z / (1 + z), w)
    for _ in range(steps):  # Halley's method
        rest, a = y - w - ufl.ln(w), 1 + w
        w = w * (1 + 2 * rest * a / (2 * a**2 - rest))
    return ufl.conditional(ufl.lt(y, SMALL), z * (1 - z * (1 - 1.5 * z)), w)

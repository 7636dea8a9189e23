# SPDX-License-Identifier: MIT
"""Hertz' pressure fitted to nodal values."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from dolfinx_mortar.arguments import array, check
from dolfinx_mortar.arrays import HALF_OF_DIGITS, Bools, Floats

# A node is at the edge of a contact where p^2 has fallen below this share of p0^2: its facets reach
# out of the contact, and its pressure is their mean. Half and twice as much change the peak and the
# half-width of nodal means over 19 facets by less than 0.5 % (tests/test_analytic.py).
EDGE = 0.1


def fit_pressure(x: npt.ArrayLike, p: npt.ArrayLike) -> tuple[float, float]:
    """Fit a Hertz distribution to nodal pressures: least squares of p^2 linear in x^2.

        p^2 = p0^2 (1 - x^2/a^2) = c0 + c1 x^2,    p0 = sqrt(c0),    a = sqrt(-c0/c1)

    Unlike the largest nodal value and the last active node, the fit is not limited to the
    resolution of one element. Nodes at the edge, where the p^2 that the nodes farther inside
    predict is below a tenth of p0^2, are left out. Nodal means with 3, 4 and 6 facets across the
    contact give a to 6, 5 and 3 %, with the edge to 35, 24 and 13 % (root mean square of places).

    Args:
        x: distances (n,) of the active nodes from the middle of the contact.
        p: pressures (n,) at these nodes, positive in compression.

    Returns:
        Peak pressure p0 and half-width a; (nan, nan) where fewer than two distances are known or
        the pressure does not fall with the distance, as for a contact of very few nodes.

    Raises:
        ValueError: for arrays of different shapes, or with members that are no finite numbers.

    >>> peak, width = fit_pressure([-3.0, 0.0, 3.0], [8.0, 10.0, 8.0])
    >>> round(peak, 12), round(width, 12)
    (10.0, 5.0)
    """
    distances = check("x", x, array((None,), remedy="give distances (n,), finite numbers"))
    wanted = f"give pressures of as many nodes, {len(distances)} finite numbers"
    values = check("p", p, array((len(distances),), remedy=wanted))
    squares = distances**2, values**2
    # The farthest nodes may be at the edge: the others tell where it is.
    farthest = squares[0].max(initial=0.0)
    c0, c1 = _fit_line(*squares, squares[0] <= (1.0 - EDGE) * farthest)
    c0, c1 = _fit_line(*squares, ~(c0 + c1 * squares[0] < EDGE * c0))  # all, if that is no line
    if not (c1 < 0.0 < c0):
        return np.nan, np.nan
    return float(np.sqrt(c0)), float(np.sqrt(-c0 / c1))


def _fit_line(x: Floats, y: Floats, on: Bools) -> tuple[float, float]:
    """Return (c0, c1) of the least-squares line y = c0 + c1 x of some points; NaN of one x."""
    x, y = x[on], y[on]
    if len(x) < 2 or np.ptp(x) <= HALF_OF_DIGITS * np.max(x):
        return np.nan, np.nan
    slope = float(np.sum((x - x.mean()) * (y - y.mean())) / np.sum((x - x.mean()) ** 2))
    return float(y.mean()) - slope * float(x.mean()), slope

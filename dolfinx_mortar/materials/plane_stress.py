# SPDX-License-Identifier: MIT
"""Plane stress by local condensation: the strain out of the plane is an unknown of each point.

With the strain e in the plane and z out of it, a law gives sigma(e, z) with the moduli C. Then

    sigma_zz(e, z) = 0,         psi(e) = psi(e, z),
    d sigma / d e = C - C : zz (x) zz : C / C_zzzz.

At finite strain e is F in the plane, sigma is P and z the stretch out of the plane less 1. For a
linear law z = -sigma_zz(e, 0) / C_zzzz, in the compiled code; for all others Newton's method finds
z before anything is assembled.
"""

from collections.abc import Callable
from typing import Any

import numba
import numpy as np

import ufl
from dolfinx_mortar.arrays import HALF_OF_DIGITS, LIMIT, ROUND_OFF, Floats, Ints
from ufl.core.expr import Expr

NORMAL = ufl.as_tensor([[0.0, 0, 0], [0, 0, 0], [0, 0, 1.0]])


def with_normal_strain(strain: Expr, z: Any) -> Expr:
    """The strain in the plane of a 3x3 tensor, symmetrised, with z out of it."""
    shear = (strain[0, 1] + strain[1, 0]) / 2
    return ufl.as_tensor([[strain[0, 0], shear, 0], [shear, strain[1, 1], 0], [0, 0, z]])


def with_normal_stretch(F: Expr, z: Any) -> Expr:
    """F in the plane of a 3x3 tensor with the stretch 1 + z out of it."""
    return _with_normal(F, 1.0 + z)


def _with_normal(tensor: Expr, normal: Any) -> Expr:
    """The part in the plane of a 3x3 tensor, which need not be symmetric, with a zz."""
    (a, b), (c, d) = ((tensor[i, 0], tensor[i, 1]) for i in range(2))
    return ufl.as_tensor([[a, b, 0], [c, d, 0], [0, 0, normal]])


def in_plane(tensor: Expr) -> Expr:
    """A 3x3 tensor with zeros out of the plane."""
    rows = [[tensor[i, j] for j in range(2)] for i in range(2)]
    return ufl.as_tensor([[*rows[0], 0], [*rows[1], 0], [0, 0, 0]])


def condensed(change: Callable[[Expr], Expr], *, finite: bool = False) -> Callable[[Expr], Expr]:
    """Return d -> C : d - C : zz (C : d)_zz / C_zzzz in the plane, from the function d -> C : d."""
    flat = _with_normal if finite else with_normal_strain

    def in_plane_change(direction: Expr) -> Expr:
        fixed, normal = change(flat(direction, 0.0)), change(NORMAL)
        return in_plane(fixed - fixed[2, 2] / normal[2, 2] * normal)

    return in_plane_change


Equation = Callable[[Ints, Floats], Floats]
"""Rows (k,) and z (k, m) there -> sigma_zz, C_zzzz, elastic C_zzzz, |sigma|: (k, m, 4)."""


def solve(
    law: str,
    equation: Equation,
    shape: tuple[int, int],
    *,
    finite: bool = False,
    start: Floats | None = None,
) -> Floats:
    """Return z with sigma_zz(z) = 0, NaN where the law is undefined.

    Newton's method from z = 0 or a start that depends on strain and state alone. Where the
    potential is convex, sigma_zz grows with z: iterates outside of the interval between pressure
    and tension bisect it. Where C_zzzz is not positive, steps are those of the elastic modulus, and
    double. At finite strain no step goes further than half of the way to z = -1, and stresses have
    the round-off of moduli.

    Args:
        law: its name.
        equation: of rows that are evaluated together, such as cells.
        shape: number of rows, and of points in each.
        finite: whether z is a stretch less 1.
        start: of z.

    Raises:
        ValueError: if there are points at which no z is found; the message names the law.
    """
    floor = ROUND_OFF if finite else 0.0
    z = np.zeros(shape) if start is None else np.where(np.isfinite(start), start, 0.0)
    high = np.full(shape, np.inf)
    low = np.full(shape, -1.0 if finite else -np.inf)
    rows: Ints = np.arange(shape[0], dtype=np.int32)
    for iteration in range(LIMIT):
        values = equation(rows, z[rows])
        # Newton's method doubles the digits: before the last iteration half of them are right.
        rows = rows[: _advance(z, low, high, rows, values, HALF_OF_DIGITS, floor, 0.5**iteration)]
        if not rows.size:
            return z
    raise ValueError(
        f"{law}: in plane stress, no strain out of the plane was found that leaves no stress there "
        f"around {len(rows)} points after {LIMIT} iterations; check the law with "
        f"dolfinx_mortar.materials.check(law{'' if finite else ', plane_stress=True'}), or take "
        "smaller steps"
    )


@numba.njit(cache=True, error_model="numpy")
def _advance(z, low, high, rows, values, share, floor, softer):  # type: ignore[no-untyped-def]
    """Make one iteration in some rows; return the number of unfinished ones, moved to the front."""
    left = 0
    for k in range(len(rows)):
        row, done = rows[k], True
        for q in range(z.shape[1]):
            residual, modulus, elastic, stress = values[k, q]
            if residual == 0.0:
                continue
            step = -residual / (softer * elastic)
            new = z[row, q] - residual / modulus if modulus > 0.0 else z[row, q] + step
            if floor > 0.0:  # a stretch is at most halved
                new = max(new, (z[row, q] - 1.0) / 2)
            small = abs(residual) <= max(share * stress, floor * elastic) and np.isfinite(stress)
            if not small:
                if residual < 0.0:
                    low[row, q] = z[row, q]
                else:
                    high[row, q] = z[row, q]
                new, narrow = _kept_between(low[row, q], high[row, q], new, z[row, q] + step)
                # a law undefined from the start, as for a strain that is NaN, is done
                done = done and (narrow or (softer == 1.0 and np.isnan(stress)))
            z[row, q] = new
        if not done:
            rows[left] = row
            left += 1
    return left


@numba.njit(cache=True, error_model="numpy")
def _kept_between(low, high, new, instead):  # type: ignore[no-untyped-def]
    """Return an iterate in an interval, or its middle, and whether numbers cannot divide it."""
    if low < new < high:
        return new, False
    middle = (low + high) / 2
    if not np.isfinite(middle):
        return instead, False
    return middle, middle == low or middle == high

# SPDX-License-Identifier: MIT
"""A signed distance that a user gives as a function of points."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from dolfinx_mortar.arguments import as_numbers
from dolfinx_mortar.arrays import EPS, Floats
from dolfinx_mortar.shapes.shape import Distance, Shape, check_length, check_vector

Function = Callable[[Floats], Any]


class SignedDistance(Shape):
    """phi, a function of points; derivatives that are not given are central differences.

    Args:
        phi: points x (d, n) -> distances (n,), positive outside, with abs(grad phi) = 1 near the
            surface.
        point: d coordinates that tell where the tool is, about which it turns.
        gradient: x (d, n) -> (d, n).
        hessian: x (d, n) -> (d, d, n).
        length: over which phi varies, the least radius of the surface for one: differences are
            taken over a part of it, the cube root of the round-off for the best accuracy. Needed
            where a derivative is not given.

    Raises:
        ValueError: for what is no function, coordinates that are not 2 or 3 finite ones, and a
            length that is not > 0, or missing. When it is evaluated, for another shape, and NaN.
    """

    def __init__(
        self,
        phi: Function,
        point: Any,
        *,
        gradient: Function | None = None,
        hessian: Function | None = None,
        length: Any = None,
    ) -> None:
        for name, function in (("phi", phi), ("gradient", gradient), ("hessian", hessian)):
            if not callable(function) and (name == "phi" or function is not None):
                raise ValueError(f"{name} is {function!r}: give a function of points x (d, n)")
        self._point = check_vector("point", point)
        self.phi, self.gradient, self.hessian = phi, gradient, hessian
        if length is None and (gradient is None or hessian is None):
            raise ValueError(
                "length is None: give the length over which phi varies, such as the least radius "
                "of the surface, for differences; or gradient and hessian"
            )
        self.length = 1.0 if length is None else check_length("length", length)

    @property
    def point(self) -> Floats:
        """As given, (d,)."""
        return self._point

    def given(self) -> Mapping[str, Any]:
        """Return the arguments by name."""
        return {"point": self._point, "length": self.length}

    def distance(self, x: Floats) -> Distance:
        """Return the distances of points x (n, d)."""
        return Distance(self._values(x), self._gradients(x), self._hessians(x))

    def _values(self, x: Floats) -> Floats:
        return _returned("phi", self.phi, x, ())

    def _gradients(self, x: Floats) -> Floats:
        if self.gradient is not None:
            return _returned("gradient", self.gradient, x, (x.shape[1],))
        return _differences(self._values, x, EPS ** (1 / 3) * self.length)

    def _hessians(self, x: Floats) -> Floats:
        if self.hessian is not None:
            return _returned("hessian", self.hessian, x, (x.shape[1],) * 2)
        # second differences have the round-off of a square
        power = 1 / 3 if self.gradient is not None else 1 / 5
        found = _differences(self._gradients, x, EPS**power * self.length)
        return np.asarray((found + np.swapaxes(found, 1, 2)) / 2)


def _returned(name: str, function: Function, x: Floats, shape: tuple[int, ...]) -> Floats:
    """Return what a function returns at points x (n, d), (n, ..).

    Raises:
        ValueError: for another shape, and NaN or infinity.
    """
    n = len(x)
    if not n:  # functions need not handle an empty set of points
        return np.zeros((0, *shape))
    found = as_numbers(function(np.ascontiguousarray(x.T)))
    if found is None or found.shape != (*shape, n):
        has = "no numbers" if found is None else f"the shape {found.shape}"
        raise ValueError(
            f"{name} returns {has} for {n} points x {(x.shape[1], n)}; it must return {(*shape, n)}"
        )
    if not np.isfinite(found).all():
        bad = int(np.argmin(np.isfinite(found.reshape(-1, n)).all(axis=0)))
        place = ", ".join(f"{c:.4g}" for c in x[bad])
        raise ValueError(f"{name} returns NaN or infinity at ({place})")
    return np.asarray(np.moveaxis(found, -1, 0), dtype=np.float64)


def _differences(function: Callable[[Floats], Floats], x: Floats, step: float) -> Floats:
    """Return central differences (n, .., d) of a function of points x (n, d)."""
    ways = step * np.eye(x.shape[1])
    parts = [(function(x + way) - function(x - way)) / (2 * step) for way in ways]
    return np.stack(parts, axis=-1)

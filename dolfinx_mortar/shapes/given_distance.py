# SPDX-License-Identifier: MIT
"""A signed distance given by the user."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

import ufl
from dolfinx_mortar.common.arguments import check, check_optional
from dolfinx_mortar.common.arrays import EPS, Floats
from dolfinx_mortar.common.kernels import Kernel, compile_kernel, constants, tabulate
from dolfinx_mortar.shapes.shape import (
    LENGTH,
    POINT,
    Distance,
    Shape,
    check_finite,
    returned,
)
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.algorithms.apply_derivatives import apply_derivatives
from ufl.constantvalue import ConstantValue
from ufl.core.expr import Expr
from ufl.corealg.traversal import traverse_unique_terminals

Function = Callable[[Floats], Any]


class SignedDistance(Shape):
    """phi, in UFL with exact derivatives, or a function of points.

    Missing derivatives of a function are central differences.

    Args:
        phi: an expression of a ``ufl.SpatialCoordinate`` with d components and numbers; or a
            function, points x (d, n) -> distances (n,). Positive outside, with abs(grad phi) = 1
            near the surface.
        point: d coordinates of the tool's reference point.
        gradient: x (d, n) -> (d, n).
        hessian: x (d, n) -> (d, d, n).
        length: scale of phi for differences, such as the least radius of the surface.

    Raises:
        ValueError: naming a wrong argument; in evaluations for other shapes and NaN.

    Example:
        >>> from basix.ufl import element
        >>> x = ufl.SpatialCoordinate(ufl.Mesh(element("Lagrange", "triangle", 1, shape=(2,))))
        >>> disc = SignedDistance(ufl.sqrt(ufl.dot(x, x)) - 1.0, (0.0, 0.0))
        >>> disc.distance(np.array([[0.0, 2.0]])).hessian.tolist()
        [[[0.5, 0.0], [0.0, 0.0]]]
    """

    def __init__(
        self,
        phi: Expr | Function,
        point: Any,
        *,
        gradient: Function | None = None,
        hessian: Function | None = None,
        length: Any = None,
    ) -> None:
        self.point = check("point", point, POINT)
        self.phi, self.gradient, self.hessian = phi, gradient, hessian
        self._kernel: Kernel | None = None
        if isinstance(phi, Expr):
            if any(given is not None for given in (gradient, hessian, length)):
                raise ValueError("phi is in UFL: leave out gradient, hessian and length")
            self._kernel, self.length = _compile(phi, len(self.point)), None
            return
        for name, function in (("phi", phi), ("gradient", gradient), ("hessian", hessian)):
            if not callable(function) and (name == "phi" or function is not None):
                raise ValueError(
                    f"{name} is {function!r}: give a function of points x (d, n)"
                    f"{', or an expression of UFL' * (name == 'phi')}"
                )
        if length is None and (gradient is None or hessian is None):
            raise ValueError(
                "length is None: give the length over which phi varies, such as the least radius "
                "of the surface, for differences; or gradient and hessian"
            )
        self.length = check_optional("length", length, LENGTH)

    def given(self) -> Mapping[str, Any]:
        """See `Shape`."""
        return {"point": self.point, "length": self.length}

    def distance(self, x: Floats) -> Distance:
        """See `Shape`."""
        if self._kernel is None:
            return Distance(self.values(x), self._gradients(x), self._hessians(x))
        d = x.shape[1]
        found = tabulate(self._kernel, np.ascontiguousarray(x))
        parts = {"phi": found[:, 0], "grad phi": found[:, 1 : d + 1], "Hess phi": found[:, d + 1 :]}
        for name, part in parts.items():
            check_finite(name, part, x)
        value, gradient, hessian = parts.values()
        return Distance(value, gradient, hessian.reshape(-1, d, d))

    def values(self, x: Floats) -> Floats:
        """See `Shape`."""
        if self._kernel is None:
            return _returned("phi", self.phi, x, ())
        found = tabulate(self._kernel, np.ascontiguousarray(x))[:, 0]
        check_finite("phi", found, x)
        return found

    def _gradients(self, x: Floats) -> Floats:
        if self.gradient is not None:
            return _returned("gradient", self.gradient, x, (x.shape[1],))
        return _differences(self.values, x, self._step(1 / 3))

    def _hessians(self, x: Floats) -> Floats:
        if self.hessian is not None:
            return _returned("hessian", self.hessian, x, (x.shape[1],) * 2)
        # second differences square the round-off
        power = 1 / 3 if self.gradient is not None else 1 / 5
        found = _differences(self._gradients, x, self._step(power))
        return (found + np.swapaxes(found, 1, 2)) / 2

    def _step(self, power: float) -> float:
        assert self.length is not None
        return float(EPS**power * self.length)


def _compile(phi: Expr, d: int) -> Kernel:
    if phi.ufl_shape != () or phi.ufl_free_indices:
        raise ValueError(f"phi is {phi}, of shape {phi.ufl_shape}: give a scalar expression")
    phi = apply_derivatives(apply_algebra_lowering(phi))
    parts = list(traverse_unique_terminals(phi))
    at = [p for p in parts if isinstance(p, ufl.SpatialCoordinate) and p.ufl_shape == (d,)]
    numbers = ConstantValue, ufl.classes.MultiIndex
    others = [
        f"{p} of shape {p.ufl_shape}" for p in parts if p not in at and not isinstance(p, numbers)
    ]
    if others or not at:
        raise ValueError(
            f"phi contains {', '.join(others) or 'no SpatialCoordinate'}: give an expression of x, "
            f"a SpatialCoordinate of {d} coordinates as point, and numbers; position and rotation "
            "move the tool"
        )
    x = ufl.variable(constants(d))
    value = ufl.replace(phi, dict.fromkeys(at, x))
    gradient = ufl.diff(value, x)
    hessian = ufl.diff(gradient, x)
    both = [hessian[i, j] for i in range(d) for j in range(d)]
    return compile_kernel(ufl.as_vector([value, *(gradient[i] for i in range(d)), *both]))


def _returned(name: str, function: Function, x: Floats, shape: tuple[int, ...]) -> Floats:
    n = len(x)
    if not n:
        return np.zeros((0, *shape))
    values = function(np.ascontiguousarray(x.T))
    found = np.moveaxis(check(f"{name}(x)", values, returned((*shape, n), n)), -1, 0)
    check_finite(name, found, x)
    return found


def _differences(function: Callable[[Floats], Floats], x: Floats, step: float) -> Floats:
    """Central differences (n, .., d) at points x (n, d)."""
    ways = step * np.eye(x.shape[1])
    parts = [(function(x + way) - function(x - way)) / (2 * step) for way in ways]
    return np.stack(parts, axis=-1)

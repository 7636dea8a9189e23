# SPDX-License-Identifier: MIT
"""Base of all shapes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from inspect import signature
from typing import Any

import numpy as np

from dolfinx_mortar.common.arguments import Rule, array, check, instance, is_number, number
from dolfinx_mortar.common.arrays import Bools, Floats, Longs, place


@dataclass(frozen=True)
class Distance:
    """Signed distances phi of points, their gradients and Hessians."""

    value: Floats  # (n,) positive outside
    gradient: Floats  # (n, d) outward unit normals
    hessian: Floats  # (n, d, d) curvatures, 1 / length

    def less(self, radius: float) -> Distance:
        """Distance from the surface offset outwards by a radius."""
        return replace(self, value=self.value - radius)

    def __neg__(self) -> Distance:
        """Distance with inside and outside exchanged."""
        return Distance(-self.value, -self.gradient, -self.hessian)

    def where(self, mine: Bools, other: Distance) -> Distance:
        """This distance at masked points (n,), the other one elsewhere."""
        return Distance(
            np.where(mine, self.value, other.value),
            np.where(mine[:, None], self.gradient, other.gradient),
            np.where(mine[:, None, None], self.hessian, other.hessian),
        )


def check_finite(name: str, found: Floats, x: Floats) -> None:
    """Raise a ValueError for NaN or infinity at points x (n, d)."""
    finite = np.isfinite(found).all(axis=tuple(range(1, found.ndim)))
    if not finite.all():
        raise ValueError(f"{name} is NaN or infinite at {place(x[np.argmin(finite)])}")


def check_returned(shape: Shape, found: Any, x: Floats) -> Distance:
    """Checked result of `Shape.distance` at x (n, d)."""
    kind, (n, d) = type(shape).__name__, x.shape
    check(f"{kind}.distance()", found, instance(Distance, "return a shapes.Distance"))
    for name, size in (("value", (n,)), ("gradient", (n, d)), ("hessian", (n, d, d))):
        who = f"{kind}: the {name} of its distance"
        check_finite(who, check(who, getattr(found, name), returned(size, n)), x)
    return found


def returned(shape: tuple[int, ...], n: int) -> Rule[Floats]:
    """Rule for results of a shape at n points."""
    return array(shape, finite=False, remedy=f"return numbers of shape {shape} for {n} points")


class Shape(ABC):
    """A region with the signed distance phi of points from its surface, positive outside.

    grad phi is the outward unit normal at the nearest point, the Hessian of phi the curvature, 1 /
    (R + phi) for a sphere. Coordinates are those of the mesh for the tool in its initial position;
    in axisymmetry (r, z). Errors name the wrong argument.

    Attributes:
        point: reference point (d,), the centre or the tip.
    """

    point: Floats

    @abstractmethod
    def distance(self, x: Floats) -> Distance:
        """Distances of points x (n, d)."""

    def values(self, x: Floats) -> Floats:
        """Values phi (n,) alone at points x (n, d)."""
        return self.distance(x).value

    def given(self) -> Mapping[str, Any]:
        """Arguments by name; by default the attributes of these names."""
        return {name: getattr(self, name) for name in signature(type(self)).parameters}

    @property
    def surface(self) -> tuple[Floats, Longs] | None:
        """Points (n, d), and lines or triangles (m, d); None for analytic shapes."""
        return None

    def misfit(self, d: int, revolved: bool) -> str:
        """Why it is unusable in d dimensions or axisymmetry (about r = 0), or ""."""
        n = len(self.point)
        return "" if n == d else f"{self!r} has points of {n} components, the mesh of {d}"

    def __repr__(self) -> str:
        shown = ", ".join(f"{k}={_shown(v)}" for k, v in self.given().items() if v is not None)
        return f"{type(self).__name__}({shown})"


def _shown(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return repr([float(f"{v:.6g}") for v in value])
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_shown, value))}]"
    return f"{value:g}" if is_number(value) else repr(value)


DIRECTION = "it has no direction of {} finite components, not all 0: give one"
POINT = array((2,), (3,))
LENGTH = number("a finite length", above=0.0)
CREASE = number("an angle in degrees,", least=0.0, most=90.0)


def check_unit(name: str, value: Any, d: int) -> Floats:
    """Unit vector (d,) of a direction; raise a ValueError for others."""
    found = check(name, value, array((d,), holds=np.any, remedy=DIRECTION.format(d)))
    found = found / np.abs(found).max()  # squares may over- or underflow
    return found / np.linalg.norm(found)


def refuse(who: str, x: Floats, wrong: Bools, what: str, remedy: str) -> None:
    """Raise a ValueError with number and first place of points."""
    if wrong.any():
        first = place(x[np.argmax(wrong)])
        raise ValueError(
            f"{who} {wrong.sum()} {what} among {len(x)}, the first one around {first}: {remedy}"
        )


def unit_vectors(v: Floats) -> tuple[Floats, Floats]:
    """Lengths (n,) and unit vectors, 0 for 0."""
    size = np.linalg.norm(v, axis=1)
    return size, np.divide(v, size[:, None], out=np.zeros_like(v), where=size[:, None] > 0.0)


def of_centre(offset: Floats) -> Distance:
    """Distances from a point, of offsets (n, d).

    Derivatives are e = offset / r and (I - e e^T) / r, 0 at the point.
    """
    r, e = unit_vectors(offset)
    across = np.eye(offset.shape[1]) - e[:, :, None] * e[:, None, :]
    inverse = np.divide(1.0, r, out=np.zeros_like(r), where=r > 0.0)
    return Distance(r, e, across * inverse[:, None, None])


def of_axis(offset: Floats, axis: Floats) -> Distance:
    """Distances from a line along a unit vector (d,) through the origin."""
    along = offset @ axis
    found = of_centre(offset - along[:, None] * axis)
    inverse = np.divide(1.0, found.value, out=np.zeros_like(along), where=found.value > 0.0)
    rest = axis[:, None] * axis[None, :] * inverse[:, None, None]
    return Distance(found.value, found.gradient, found.hessian - rest)

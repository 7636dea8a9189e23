# SPDX-License-Identifier: MIT
"""The base of all shapes: a signed distance with its derivatives, and the problems it suits.

phi(x) is the distance of a point from the surface of a tool, positive outside and negative inside.
grad phi is the unit normal of the surface at the nearest point of it, out of the tool, and the
Hessian of phi the curvature there, 1 / (R + phi) of a sphere.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from dolfinx_mortar.arguments import Rule, array, check, instance, is_number, number
from dolfinx_mortar.arrays import Bools, Floats, Longs


@dataclass(frozen=True)
class Distance:
    """Signed distances of points and their derivatives."""

    value: Floats  # (n,) phi, positive outside
    gradient: Floats  # (n, d) unit normals, out of the tool
    hessian: Floats  # (n, d, d) curvatures, 1 / length

    def __neg__(self) -> Distance:
        """Return the distance from the same surface with the other side as outside."""
        return Distance(-self.value, -self.gradient, -self.hessian)

    def where(self, mine: Bools, other: Distance) -> Distance:
        """Return this distance at some points (n,), the other one elsewhere."""
        return Distance(
            np.where(mine, self.value, other.value),
            np.where(mine[:, None], self.gradient, other.gradient),
            np.where(mine[:, None, None], self.hessian, other.hessian),
        )


def check_finite(name: str, found: Floats, x: Floats) -> None:
    """Raise a ValueError for NaN and infinity among values (n, ..) at points x (n, d)."""
    finite = np.isfinite(found).all(axis=tuple(range(1, found.ndim)))
    if not finite.all():
        place = ", ".join(f"{c:.4g}" for c in x[int(np.argmin(finite))])
        raise ValueError(f"{name} is NaN or infinite at ({place})")


def check_returned(shape: Shape, found: Any, x: Floats) -> Distance:
    """Return what `Shape.distance` has returned for points x (n, d).

    Raises:
        ValueError: for what is no `Distance`, arrays of other shapes, NaN and infinity.
    """
    kind, (n, d) = type(shape).__name__, x.shape
    check(f"{kind}.distance()", found, instance(Distance, "return a shapes.Distance"))
    for name, size in (("value", (n,)), ("gradient", (n, d)), ("hessian", (n, d, d))):
        who = f"{kind}: the {name} of its distance"
        check_finite(who, check(who, getattr(found, name), returned(size, n)), x)
    return found


def returned(shape: tuple[int, ...], n: int) -> Rule[Floats]:
    """Return the rule of what functions return for n points: numbers of a shape."""
    return array(shape, finite=False, remedy=f"return numbers of shape {shape} for {n} points")


class Shape(ABC):
    """A region of space, by the signed distance phi of points from its surface, positive outside.

    Its coordinates are those of the mesh while the tool is where it starts. In an axisymmetric
    problem points are (r, z), and shapes are their sections.
    """

    @property
    @abstractmethod
    def point(self) -> Floats:
        """A point (d,) that tells where the shape is: its centre, or its tip."""

    @abstractmethod
    def distance(self, x: Floats) -> Distance:
        """Return the distances of points x (n, d)."""

    def values(self, x: Floats) -> Floats:
        """Return phi (n,) alone, at points x (n, d)."""
        return self.distance(x).value

    @abstractmethod
    def given(self) -> Mapping[str, Any]:
        """Return the arguments by name."""

    @property
    def surface(self) -> tuple[Floats, Longs] | None:
        """Points (n, d), and lines or triangles (m, d) of them; None if it is not made of these."""
        return None

    def misfit(self, d: int, revolved: bool) -> str:
        """Say why the shape is none in d dimensions, or none of revolution; "" if it is one.

        Args:
            d: dimension of the mesh.
            revolved: whether the problem is axisymmetric, about the axis r = 0.
        """
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
    """Return the unit vector (d,) of a direction, or raise a ValueError, as for one of 0."""
    found = check(name, value, array((d,), holds=np.any, remedy=DIRECTION.format(d)))
    found = found / np.abs(found).max()  # squares of very large or small components are none
    return np.asarray(found / np.linalg.norm(found))


def refuse(who: str, x: Floats, wrong: Bools, what: str, remedy: str) -> None:
    """Raise a ValueError with their number and the first place if some of x (m, d) are wrong."""
    if wrong.any():
        place = ", ".join(f"{c:.4g}" for c in x[int(np.argmax(wrong))])
        raise ValueError(
            f"{who} {wrong.sum()} {what} among {len(x)}, the first one around ({place}): {remedy}"
        )


def unit_vectors(v: Floats) -> tuple[Floats, Floats]:
    """Return the lengths (n,) of vectors (n, d) and the unit vectors, 0 where there is none."""
    size = np.linalg.norm(v, axis=1)
    return size, np.divide(v, size[:, None], out=np.zeros_like(v), where=size[:, None] > 0.0)


def of_centre(offset: Floats) -> Distance:
    """Return the distances from a point, of offsets (n, d) from it; 0 derivatives at the point.

    Derivatives are e = offset / r and (I - e e^T) / r.
    """
    r, e = unit_vectors(offset)
    across = np.eye(offset.shape[1]) - e[:, :, None] * e[:, None, :]
    inverse = np.divide(1.0, r, out=np.zeros_like(r), where=r > 0.0)
    return Distance(r, e, across * inverse[:, None, None])


def of_axis(offset: Floats, axis: Floats) -> Distance:
    """Return the distances from a line along a unit vector (d,) through the origin."""
    along = offset @ axis
    found = of_centre(offset - along[:, None] * axis)
    inverse = np.divide(1.0, found.value, out=np.zeros_like(along), where=found.value > 0.0)
    rest = axis[:, None] * axis[None, :] * inverse[:, None, None]
    return Distance(found.value, found.gradient, found.hessian - rest)


def of_section(u: Distance, v: Distance, phi: Distance) -> Distance:
    """Return phi(u, v), of two functions u and v of points, with phi in the plane of (u, v)."""
    g, H = phi.gradient, phi.hessian
    a, b = u.gradient, v.gradient
    gradient = g[:, :1] * a + g[:, 1:] * b
    hessian = g[:, 0, None, None] * u.hessian + g[:, 1, None, None] * v.hessian
    parts = np.stack([a, b], axis=1)
    hessian = hessian + np.einsum("nab,nai,nbj->nij", H, parts, parts)
    return Distance(phi.value, gradient, hessian)

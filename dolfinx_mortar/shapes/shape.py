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

from dolfinx_mortar.arguments import as_numbers, is_number
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
    kind = type(shape).__name__
    if not isinstance(found, Distance):
        raise ValueError(f"{kind}.distance() returns {found!r}: return a shapes.Distance")
    n, d = x.shape
    for name, size in (("value", (n,)), ("gradient", (n, d)), ("hessian", (n, d, d))):
        given = getattr(found, name)
        array = as_numbers(given)
        if array is None or array.shape != size:
            has = "no numbers" if array is None else f"the shape {array.shape}"
            raise ValueError(
                f"{kind}.distance() returns a {name} that has {has} for {n} points, not {size}"
            )
        check_finite(f"{kind}: the {name} of its distance", array, x)
    return found


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


def check_vector(name: str, value: Any, d: int | None = None) -> Floats:
    """Return a vector of 2 or 3 finite components, or of d.

    Raises:
        ValueError: for anything else.
    """
    found = as_numbers(value.tolist() if isinstance(value, np.ndarray) else value)
    sizes = ((2,), (3,)) if d is None else ((d,),)
    if found is None or found.shape not in sizes or not np.isfinite(found).all():
        wanted = "2 or 3" if d is None else f"{d}"
        raise ValueError(f"{name} is {value!r}: give {wanted} finite coordinates")
    return np.asarray(found, dtype=np.float64)


def check_unit(name: str, value: Any, d: int) -> Floats:
    """Return the unit vector (d,) of a direction.

    Raises:
        ValueError: for what has not d finite components, or only zeros.
    """
    found = check_vector(name, value, d)
    largest = np.abs(found).max()
    if largest == 0.0:
        raise ValueError(f"{name} is {value!r}: it has no direction; give a vector that is not 0")
    found = found / largest  # squares of very large or small components are none
    return np.asarray(found / np.linalg.norm(found))


def check_length(name: str, value: Any, *, least: str = "> 0") -> float:
    """Return a length.

    Raises:
        ValueError: for what is no finite number, or not > 0 (>= 0).
    """
    if not is_number(value) or value < 0.0 or (value == 0.0 and least == "> 0"):
        raise ValueError(f"{name} is {value!r}: give a finite length {least}")
    return float(value)


def check_flag(name: str, value: Any) -> bool:
    """Return a truth value.

    Raises:
        ValueError: for anything else, such as a text, which would count as True.
    """
    if not isinstance(value, bool | np.bool_):
        raise ValueError(f"{name} is {value!r}: give True or False")
    return bool(value)


def check_angle(name: str, value: Any) -> float:
    """Return an angle in degrees, from 0 to 90.

    Raises:
        ValueError: for anything else.
    """
    if not is_number(value) or not 0.0 <= value <= 90.0:
        raise ValueError(f"{name} is {value!r}: give an angle in degrees, from 0 to 90")
    return float(value)


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

# SPDX-License-Identifier: MIT
"""Union, intersection and complement of shapes."""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from dolfinx_mortar.arguments import array, check, instance, number
from dolfinx_mortar.arrays import HALF_OF_DIGITS, LIMIT, Floats
from dolfinx_mortar.shapes.primitives import Plane
from dolfinx_mortar.shapes.shape import Distance, Shape, check_unit


class _Combined(Shape):
    """Shapes combined by the least or the largest phi."""

    sign: ClassVar[float]

    def __init__(self, *shapes: Shape) -> None:
        for shape in shapes or (None,):
            check(f"{type(self).__name__}: a shape", shape, instance(Shape, "give one or more"))
        sizes = sorted({len(shape.point) for shape in shapes})
        if len(sizes) > 1:
            raise ValueError(
                f"{type(self).__name__} has shapes of {sizes} coordinates: all need the same"
            )
        self.shapes, self.point = shapes, shapes[0].point

    def given(self) -> Mapping[str, Any]:
        return {f"shape{k}": shape for k, shape in enumerate(self.shapes, start=1)}

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(map(repr, self.shapes))})"

    def misfit(self, d: int, revolved: bool) -> str:
        return next((m for shape in self.shapes if (m := shape.misfit(d, revolved))), "")

    def distance(self, x: Floats) -> Distance:
        found, *others = (shape.distance(x) for shape in self.shapes)
        for other in others:
            found = found.where(self.sign * found.value <= self.sign * other.value, other)
        return found


class Union(_Combined):
    """Union of shapes of the same dimension: phi = min phi_k, exact outside."""

    sign = 1.0


class Intersection(_Combined):
    """Intersection of shapes of the same dimension: phi = max phi_k.

    Surface and distances from faces are exact; off an edge phi is the larger of both distances,
    less than that from the edge.

    Raises:
        ValueError: also for an empty intersection.
    """

    sign = -1.0

    def __init__(self, *shapes: Shape) -> None:
        super().__init__(*shapes)
        if self._is_empty():
            raise ValueError(
                f"{self!r} is empty: no point is within all of the shapes, so that nothing could "
                "meet the tool; check where they are, and which sides of them are inside"
            )

    def _is_empty(self) -> bool:
        """Whether repeated projections onto the farthest shape end at a gap (convex: a proof)."""
        x = np.array([shape.point for shape in _leaves(self)])
        for _ in range(LIMIT):
            try:
                found = [shape.distance(x) for shape in self.shapes]
            except Exception:
                return False
            values = np.array([one.value for one in found])
            gradients = np.array([one.gradient for one in found])
            order, every = np.argsort(-values, axis=0), np.arange(len(x))
            far = values[order[0], every]
            if not (far > 0.0).all():
                return False
            x = x - far[:, None] * gradients[order[0], every]
        if len(found) < 2:
            return False
        gap = far + values[order[1], every]
        facing = (gradients[order[0], every] * gradients[order[1], every]).sum(axis=1)
        size = np.abs(x).max() + far.max()
        return bool(((gap > HALF_OF_DIGITS * size) & (facing < HALF_OF_DIGITS - 1.0)).all())


def _leaves(shape: Any) -> list[Shape]:
    if isinstance(shape, Complement):
        return _leaves(shape.shape)
    if isinstance(shape, _Combined):
        return [leaf for part in shape.shapes for leaf in _leaves(part)]
    return [shape]


class Complement(Shape):
    """Complement of a shape: phi = -phi_0, such as a socket or a die."""

    def __init__(self, shape: Shape) -> None:
        self.shape = check("Complement: shape", shape, instance(Shape, "give one"))
        self.point = self.shape.point

    def misfit(self, d: int, revolved: bool) -> str:
        """See `Shape`."""
        return self.shape.misfit(d, revolved)

    def distance(self, x: Floats) -> Distance:
        """See `Shape`."""
        return -self.shape.distance(x)


def berkovich(tip: Any, axis: Any, turned: float = 0.0) -> Intersection:
    """Berkovich's pyramid: three faces at 65.27 degrees to the axis.

    The area of its section at depth h is 24.5 h^2.

    Args:
        tip: 3 coordinates.
        axis: direction from the tip into the tool.
        turned: degrees of rotation about the axis, -360 to 360.
    """
    at, a = check("tip", tip, array((3,))), check_unit("axis", axis, 3)
    check("turned", turned, number("an angle in degrees", least=-360.0, most=360.0))
    first = np.cross(a, np.eye(3)[np.argmin(np.abs(a))])
    first /= np.linalg.norm(first)
    second, face = np.cross(a, first), np.radians(65.27)
    planes = []
    for k in range(3):
        angle = np.radians(turned + 120.0 * k)
        out = np.cos(angle) * first + np.sin(angle) * second
        planes.append(Plane(at, np.cos(face) * out - np.sin(face) * a))
    return Intersection(*planes)

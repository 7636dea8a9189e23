# SPDX-License-Identifier: MIT
"""Planes, spheres, cylinders, tori, cones and wedges; union, intersection and complement."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from dolfinx_mortar.common.arguments import array, check, instance, number
from dolfinx_mortar.common.arrays import HALF_OF_DIGITS, LIMIT, SAME, Floats
from dolfinx_mortar.shapes.shape import (
    LENGTH,
    POINT,
    Distance,
    Shape,
    check_unit,
    of_axis,
    of_centre,
)


class Plane(Shape):
    """phi = n.(x - p).

    Args:
        point: p, d coordinates.
        normal: n, of any length, out of the tool, towards the body.
    """

    def __init__(self, point: Any, normal: Any) -> None:
        self.point = check("point", point, POINT)
        self.normal = check_unit("normal", normal, len(self.point))

    def misfit(self, d: int, revolved: bool) -> str:
        """See `Shape`."""
        if revolved and abs(self.normal[0]) > SAME:
            return f"{self!r} is not across the axis, so no plane of revolution: give a Cone"
        return super().misfit(d, revolved)

    def distance(self, x: Floats) -> Distance:
        """See `Shape`."""
        n, d = x.shape
        gradient = np.tile(self.normal, (n, 1))
        return Distance((x - self.point) @ self.normal, gradient, np.zeros((n, d, d)))


class _Revolved(Shape):
    """A shape about an axis."""

    radius: Any
    axis: Any = None
    in_plane: ClassVar[str]
    about = "axis=(0, 1) and a centre (0, z)"

    def misfit(self, d: int, revolved: bool) -> str:
        """See `Shape`."""
        if d == 2 and not revolved:
            return f"{self!r} is no plane figure: give {self.in_plane}"
        off = abs(self.point[0]) > SAME * (self.radius + np.abs(self.point).max())
        if revolved and (off or (self.axis is not None and abs(self.axis[0]) > SAME)):
            return f"{self!r} is not about the axis: give {self.about}"
        return super().misfit(d, revolved)


class _Round(_Revolved):
    def __init__(self, centre: Any, radius: Any) -> None:
        self.centre = self.point = check("centre", centre, POINT)
        self.radius = check("radius", radius, LENGTH)


class Sphere(_Round):
    """phi = |x - c| - R: a ball in space, or about the axis of an axisymmetric problem.

    Args:
        centre: c, d coordinates.
        radius: R.
    """

    in_plane = "a Cylinder"
    about = "a centre (0, z), or a Torus"

    def distance(self, x: Floats) -> Distance:
        """See `Shape`."""
        return of_centre(x - self.centre).less(self.radius)


class Cylinder(_Round):
    """phi = |x - c| - R about an axis; in the plane a disc.

    Args:
        centre: c, d coordinates of a point of the axis.
        radius: R.
        axis: d components; None in plane problems.
    """

    in_plane = "no axis, which is across the plane"

    def __init__(self, centre: Any, radius: Any, axis: Any = None) -> None:
        super().__init__(centre, radius)
        self.axis = None if axis is None else check_unit("axis", axis, len(self.centre))
        if self.axis is None and len(self.centre) == 3:
            raise ValueError("axis is None: give the direction of the cylinder's axis in space")

    def misfit(self, d: int, revolved: bool) -> str:
        """See `Shape`."""
        if self.axis is None and revolved:
            return f"{self!r} is no shape of revolution: give a Sphere or a Torus"
        return Shape.misfit(self, d, revolved) if self.axis is None else super().misfit(d, revolved)

    def distance(self, x: Floats) -> Distance:
        """See `Shape`."""
        offset = x - self.centre
        found = of_centre(offset) if self.axis is None else of_axis(offset, self.axis)
        return found.less(self.radius)


class Torus(_Round):
    """phi = |(|x - c| across the axis - R, x - c along it)| - r: a ring of round section.

    Args:
        centre: c, d coordinates.
        radius: R, of the circle through the sections' centres.
        tube: r, of the sections; r > R closes the hole, and phi is exact outside.
        axis: d components; default (0, 1) in axisymmetry.
    """

    in_plane = "Cylinders, and their Union"

    def __init__(self, centre: Any, radius: Any, tube: Any, axis: Any = None) -> None:
        super().__init__(centre, radius)
        self.tube = check("tube", tube, LENGTH)
        if axis is None and len(self.centre) == 2:
            axis = (0.0, 1.0)
        self.axis = check_unit("axis", axis, len(self.centre))

    def distance(self, x: Floats) -> Distance:
        """See `Shape`."""
        n, offset = len(x), x - self.centre
        rho = of_axis(offset, self.axis)
        # phi of the section in the coordinates rho - R and along the axis
        phi = of_centre(np.stack([rho.value - self.radius, offset @ self.axis], axis=1))
        parts = np.stack([rho.gradient, np.tile(self.axis, (n, 1))], axis=1)
        hessian = phi.gradient[:, 0, None, None] * rho.hessian
        hessian = hessian + parts.swapaxes(1, 2) @ phi.hessian @ parts
        gradient = (phi.gradient[:, None] @ parts)[:, 0]
        return Distance(phi.value, gradient, hessian).less(self.tube)


class _Pointed(Shape):
    """A sharp section offset outwards by the tip radius, see `Cone`."""

    def __init__(self, tip: Any, half_angle: Any, axis: Any, radius: Any = 0.0) -> None:
        self.tip = self.point = check("tip", tip, POINT)
        flank = number("the degrees between axis and flank,", above=0.0, below=90.0)
        self.half_angle = check("half_angle", half_angle, flank)
        self.axis = check_unit("axis", axis, len(self.tip))
        self.radius = check("radius", radius, number("a finite length", least=0.0))

    def distance(self, x: Floats) -> Distance:
        """See `Shape`."""
        offset = x - self._centre
        return self._section(x, of_axis(offset, self.axis), of_centre(offset))

    def _section(self, x: Floats, across: Distance, tip: Distance) -> Distance:
        """Distances of points x (n, d), from those ``across`` the axis and from the ``tip``."""
        height, angle = (x - self._centre) @ self.axis, np.radians(self.half_angle)
        s, c = np.sin(angle), np.cos(angle)
        flank = Distance(
            c * across.value - s * height, c * across.gradient - s * self.axis, c * across.hessian
        )
        lost = across.value <= SAME * (np.abs(height) + self.radius)
        flank = replace(flank, gradient=np.where(lost[:, None], -self.axis, flank.gradient))
        found = flank.where(s * across.value + c * height > 0.0, tip)
        sharp = found.value == 0.0
        gradient = np.where((sharp & lost)[:, None], -self.axis, found.gradient)
        return replace(found, gradient=gradient).less(self.radius)

    @property
    def _centre(self) -> Floats:
        return self.tip + self.radius * self.axis


class Cone(_Revolved, _Pointed):
    """A cone in space, or about the axis of an axisymmetric problem.

    With the distance rho from the axis, the height h over the centre of the tip and the half angle
    a, phi = rho cos a - h sin a - R at the flank, sqrt(rho^2 + h^2) - R at the tip.

    Args:
        tip: d coordinates of its lowest point.
        half_angle: degrees between axis and flank; 70.3 is equivalent to Berkovich's pyramid.
        axis: d components, from the tip into the tool.
        radius: R of the tip, 0 if sharp.
    """

    in_plane = "a Wedge"
    about = "axis=(0, 1) or (0, -1), and a tip (0, z)"


class Wedge(_Pointed):
    """A wedge in the plane, or in space along an edge, with the section of a `Cone`.

    In axisymmetry it is the rim of a ring, as of a punch or die.

    Args:
        tip: d coordinates of a point of its edge.
        half_angle: degrees between axis and flanks.
        axis: d components, from the tip into the tool.
        radius: of the tip, 0 if sharp.
        edge: direction of the edge in space, normal to the axis; None in the plane.
    """

    def __init__(
        self, tip: Any, half_angle: Any, axis: Any, radius: Any = 0.0, edge: Any = None
    ) -> None:
        super().__init__(tip, half_angle, axis, radius)
        d = len(self.tip)
        if (edge is None) != (d == 2):
            wanted = "none in plane problems" if d == 2 else "the direction of the edge in space"
            raise ValueError(f"edge is {edge!r}: give {wanted}")
        self.edge = None if edge is None else check_unit("edge", edge, d)
        if self.edge is not None and abs(self.edge @ self.axis) > np.sqrt(SAME):
            raise ValueError(f"edge is {edge!r}: it has to be across the axis {axis!r}")

    def distance(self, x: Floats) -> Distance:
        """See `Shape`."""
        if self.edge is None:
            return super().distance(x)
        offset, d = x - self._centre, x.shape[1]
        side = np.cross(self.edge, self.axis)
        sign = np.where(offset @ side < 0.0, -1.0, 1.0)
        flat = np.zeros((len(x), d, d))
        across = Distance(np.abs(offset @ side), sign[:, None] * side, flat)
        return self._section(x, across, of_axis(offset, self.edge))


class _Combined(Shape):
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

    Surface and distances from faces are exact; near an edge phi is less than the distance from it.

    Raises:
        ValueError: also for an empty intersection.
    """

    sign = -1.0

    def __init__(self, *shapes: Shape) -> None:
        super().__init__(*shapes)
        if len(shapes) > 1 and self._is_empty():
            raise ValueError(
                f"{self!r} is empty: no point is within all of the shapes, so that nothing could "
                "meet the tool; check where they are, and which sides of them are inside"
            )

    def _is_empty(self) -> bool:
        """Whether repeated projections onto the farthest shape leave a gap (convex: a proof)."""
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
    """Berkovich's pyramid: three faces at 65.27 degrees to the axis, section 24.5 depth^2.

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

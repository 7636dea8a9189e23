# SPDX-License-Identifier: MIT
"""Cones and wedges, with a tip that may be rounded."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from dolfinx_mortar.arguments import check, number
from dolfinx_mortar.arrays import SAME, Floats
from dolfinx_mortar.shapes.shape import (
    POINT,
    Distance,
    Shape,
    check_unit,
    of_axis,
    of_centre,
)


class _Pointed(Shape):
    """A sharp section offset outwards by the tip radius, see `Cone`."""

    def __init__(self, tip: Any, half_angle: Any, axis: Any, radius: Any) -> None:
        self.tip = check("tip", tip, POINT)
        flank = number("the degrees between axis and flank,", above=0.0, below=90.0)
        self.half_angle = check("half_angle", half_angle, flank)
        self.axis = check_unit("axis", axis, len(self.tip))
        self.radius = check("radius", radius, number("a finite length", least=0.0))

    @property
    def point(self) -> Floats:
        """Tip (d,), where the axis meets the surface."""
        return self.tip

    def given(self) -> Mapping[str, Any]:
        names = "tip", "half_angle", "axis", "radius"
        return {name: getattr(self, name) for name in names}

    def _section(self, x: Floats, across: Distance, tip: Distance) -> Distance:
        """Distances of points x (n, d), given those ``across`` the axis and from the ``tip``."""
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
        return Distance(found.value - self.radius, gradient, found.hessian)

    @property
    def _centre(self) -> Floats:
        return np.asarray(self.tip + self.radius * self.axis)


class Cone(_Pointed):
    """A cone in space, or about the axis of an axisymmetric problem.

    With the distance rho from the axis, the height h over the centre of the tip and the half angle
    a, phi = rho cos a - h sin a - R at the flank, sqrt(rho^2 + h^2) - R at the tip.

    Args:
        tip: d coordinates of its lowest point.
        half_angle: degrees between axis and flank; 70.3 is equivalent to Berkovich's pyramid.
        axis: d components, from the tip into the tool.
        radius: R of the tip, 0 if sharp.
    """

    def __init__(self, tip: Any, half_angle: Any, axis: Any, radius: Any = 0.0) -> None:
        super().__init__(tip, half_angle, axis, radius)

    def misfit(self, d: int, revolved: bool) -> str:
        """See `Shape`."""
        if d == 2 and not revolved:
            return f"{self!r} is no plane figure: give a Wedge"
        size = self.radius + float(np.abs(self.tip).max())
        off = abs(self.axis[0]) > SAME or abs(self.tip[0]) > SAME * size
        if revolved and off:
            return f"{self!r} is not about the axis: give axis=(0, 1) or (0, -1), a tip (0, z)"
        return super().misfit(d, revolved)

    def distance(self, x: Floats) -> Distance:
        """See `Shape`."""
        offset = x - self._centre
        return self._section(x, of_axis(offset, self.axis), of_centre(offset))


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

    def given(self) -> Mapping[str, Any]:
        """See `Shape`."""
        return {**super().given(), "edge": self.edge}

    def distance(self, x: Floats) -> Distance:
        """See `Shape`."""
        offset, d = x - self._centre, x.shape[1]
        if self.edge is None:
            return self._section(x, of_axis(offset, self.axis), of_centre(offset))
        side = np.cross(self.edge, self.axis)
        sign = np.where(offset @ side < 0.0, -1.0, 1.0)
        flat = np.zeros((len(x), d, d))
        across = Distance(np.abs(offset @ side), sign[:, None] * side, flat)
        return self._section(x, across, of_axis(offset, self.edge))

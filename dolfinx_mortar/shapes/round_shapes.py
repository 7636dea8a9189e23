# SPDX-License-Identifier: MIT
"""Spheres, cylinders and tori."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from dolfinx_mortar.arguments import check
from dolfinx_mortar.arrays import SAME, Floats
from dolfinx_mortar.shapes.shape import (
    LENGTH,
    POINT,
    Distance,
    Shape,
    check_unit,
    of_axis,
    of_centre,
    of_section,
)


class _Round(Shape):
    """Shape with centre and radius."""

    def __init__(self, centre: Any, radius: Any) -> None:
        self.centre = check("centre", centre, POINT)
        self.radius = check("radius", radius, LENGTH)

    @property
    def point(self) -> Floats:
        """Centre (d,)."""
        return self.centre

    def given(self) -> Mapping[str, Any]:
        return {"centre": self.centre, "radius": self.radius}

    @property
    def _size(self) -> float:
        return self.radius + float(np.abs(self.centre).max())


class Sphere(_Round):
    """phi = |x - c| - R: a ball in space, or about the axis of an axisymmetric problem.

    Args:
        centre: c, d coordinates.
        radius: R.
    """

    def misfit(self, d: int, revolved: bool) -> str:
        """See `Shape`."""
        if d == 2 and not revolved:
            return f"{self!r} is no plane figure: give a Cylinder"
        if revolved and abs(self.centre[0]) > SAME * self._size:
            return f"{self!r} is not centred on the axis, where it would be a Torus: give that"
        return super().misfit(d, revolved)

    def distance(self, x: Floats) -> Distance:
        """See `Shape`."""
        found = of_centre(x - self.centre)
        return Distance(found.value - self.radius, found.gradient, found.hessian)


class Cylinder(_Round):
    """phi = |x - c| - R about an axis; in the plane a disc.

    Args:
        centre: c, d coordinates of a point of the axis.
        radius: R.
        axis: d components; None in plane problems.
    """

    def __init__(self, centre: Any, radius: Any, axis: Any = None) -> None:
        super().__init__(centre, radius)
        self.axis = None if axis is None else check_unit("axis", axis, len(self.centre))
        if self.axis is None and len(self.centre) == 3:
            raise ValueError("axis is None: give the direction of the cylinder's axis in space")

    def given(self) -> Mapping[str, Any]:
        """See `Shape`."""
        return {**super().given(), "axis": self.axis}

    def misfit(self, d: int, revolved: bool) -> str:
        """See `Shape`."""
        if d == 2 and not revolved and self.axis is not None:
            return f"{self!r} has an axis, which in plane problems is across the plane: give none"
        if revolved:
            if self.axis is None:
                return f"{self!r} is no shape of revolution: give a Sphere or a Torus"
            if abs(self.axis[0]) > SAME or abs(self.centre[0]) > SAME * self._size:
                return f"{self!r} is not about the axis: give axis=(0, 1) and a centre (0, z)"
        return super().misfit(d, revolved)

    def distance(self, x: Floats) -> Distance:
        """See `Shape`."""
        offset = x - self.centre
        found = of_centre(offset) if self.axis is None else of_axis(offset, self.axis)
        return Distance(found.value - self.radius, found.gradient, found.hessian)


class Torus(_Round):
    """phi = |(|x - c| across the axis - R, x - c along it)| - r: a ring of round section.

    Args:
        centre: c, d coordinates.
        radius: R, of the circle through the sections' centres.
        tube: r, of the sections; r > R closes the hole, and phi is exact outside.
        axis: d components; default (0, 1) in axisymmetry.
    """

    def __init__(self, centre: Any, radius: Any, tube: Any, axis: Any = None) -> None:
        super().__init__(centre, radius)
        self.tube = check("tube", tube, LENGTH)
        if axis is None and len(self.centre) == 2:
            axis = (0.0, 1.0)
        self.axis = check_unit("axis", axis, len(self.centre))

    def given(self) -> Mapping[str, Any]:
        """See `Shape`."""
        return {**super().given(), "tube": self.tube, "axis": self.axis}

    def misfit(self, d: int, revolved: bool) -> str:
        """See `Shape`."""
        if d == 2 and not revolved:
            return f"{self!r} is no plane figure: give Cylinders, and their Union"
        if revolved and (abs(self.axis[0]) > SAME or abs(self.centre[0]) > SAME * self._size):
            return f"{self!r} is not about the axis: give axis=(0, 1) and a centre (0, z)"
        return super().misfit(d, revolved)

    def distance(self, x: Floats) -> Distance:
        """See `Shape`."""
        n, d = x.shape
        offset = x - self.centre
        across = of_axis(offset, self.axis)
        along = Distance(offset @ self.axis, np.tile(self.axis, (n, 1)), np.zeros((n, d, d)))
        section = np.stack([across.value - self.radius, along.value], axis=1)
        found = of_section(across, along, of_centre(section))
        return Distance(found.value - self.tube, found.gradient, found.hessian)

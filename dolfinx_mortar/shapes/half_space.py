# SPDX-License-Identifier: MIT
"""A half space behind a plane."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from dolfinx_mortar.arguments import check
from dolfinx_mortar.arrays import SAME, Floats
from dolfinx_mortar.shapes.shape import POINT, Distance, Shape, check_unit


class Plane(Shape):
    """phi = n.(x - p).

    Args:
        point: p, d coordinates.
        normal: n, of any length, out of the tool, towards the body.
    """

    def __init__(self, point: Any, normal: Any) -> None:
        self._point = check("point", point, POINT)
        self.normal = check_unit("normal", normal, len(self._point))

    @property
    def point(self) -> Floats:
        """A point (d,) of the plane."""
        return self._point

    def given(self) -> Mapping[str, Any]:
        """See `Shape`."""
        return {"point": self._point, "normal": self.normal}

    def misfit(self, d: int, revolved: bool) -> str:
        """See `Shape`."""
        if revolved and abs(self.normal[0]) > SAME:
            return f"{self!r} is not across the axis, so no plane of revolution: give a Cone"
        return super().misfit(d, revolved)

    def distance(self, x: Floats) -> Distance:
        """See `Shape`."""
        n, d = x.shape
        gradient = np.tile(self.normal, (n, 1))
        return Distance((x - self._point) @ self.normal, gradient, np.zeros((n, d, d)))

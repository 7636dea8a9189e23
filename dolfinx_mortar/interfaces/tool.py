# SPDX-License-Identifier: MIT
"""A rigid tool: its shape, and where it is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import basix.ufl
import ufl
from dolfinx import default_real_type, fem
from dolfinx_mortar.arrays import Bools, Floats
from dolfinx_mortar.geometry.facets import facet_normals
from dolfinx_mortar.geometry.segments import FACING
from dolfinx_mortar.mortar.surface import facets_at
from dolfinx_mortar.mortar.whole_side import WholeSide
from dolfinx_mortar.shapes import Distance, Shape


@dataclass(frozen=True)
class Pose:
    """Where a tool is: x = position + R (xi - point) of a point xi of the tool as it starts."""

    position: Floats  # (d,) of the tool's point
    rotation: Floats  # (1,) angle in the plane, (3,) rotation vector in space
    point: Floats  # (d,) where that point starts

    @property
    def R(self) -> Floats:
        """The rotation (d, d)."""
        if len(self.position) == 2:
            c, s = np.cos(self.rotation[0]), np.sin(self.rotation[0])
            return np.array([[c, -s], [s, c]])
        return np.asarray(Rotation.from_rotvec(self.rotation).as_matrix())

    def to_tool(self, x: Floats) -> Floats:
        """Return the points of the tool (n, d) that are at x (n, d)."""
        return (x - self.position) @ self.R + self.point

    def to_space(self, xi: Floats) -> Floats:
        """Return where points of the tool (n, d) are."""
        return (xi - self.point) @ self.R.T + self.position

    def distance(self, shape: Shape, x: Floats) -> Distance:
        """Return the distances of points x (n, d) from the surface of a shape."""
        found, R = shape.distance(self.to_tool(x)), self.R
        return Distance(found.value, found.gradient @ R.T, R @ found.hessian @ R.T)


class Tool:
    """A shape, and the Constants that say where it is.

    Attributes:
        shape: as given.
        point: (d,) about which it turns, where it starts.
        position: Constant (d,), where that point is.
        rotation: Constant, an angle in the plane, a rotation vector (3,) in space.
        revolved: whether the problem is axisymmetric, so that the tool stays on the axis.
    """

    def __init__(self, shape: Any, reference: Any, d: int) -> None:
        """Make the Constants, in d dimensions.

        Raises:
            ValueError: for what is no shape, one of another dimension, and a point that has not d
                finite coordinates.
        """
        if not isinstance(shape, Shape):
            raise ValueError(
                f"shape is {shape!r}: give one of dolfinx_mortar.shapes, such as Plane(point, "
                "normal), or SignedDistance(phi, point)"
            )
        if len(shape.point) != d:
            raise ValueError(
                f"shape is {shape!r}, of {len(shape.point)} coordinates, but the mesh has {d}"
            )
        self.shape, self.revolved = shape, False
        self.point = shape.point.copy() if reference is None else _check_point(reference, d)
        cell = "tetrahedron" if d == 3 else "triangle"  # of no mesh
        domain = ufl.Mesh(basix.ufl.element("Lagrange", cell, 1, shape=(d,)))
        turn = np.zeros(3) if d == 3 else 0.0
        self.position = fem.Constant(domain, self.point.astype(default_real_type))
        self.rotation = fem.Constant(domain, np.asarray(turn, dtype=default_real_type))

    def check(self, d: int, revolved: bool) -> None:
        """Take note of the kinematics.

        Raises:
            ValueError: for a shape that is none in d dimensions, or none of revolution.
        """
        if misfit := self.shape.misfit(d, revolved):
            raise ValueError(f"shape: {misfit}")
        self.revolved = revolved

    def pose(self) -> Pose:
        """Return where it is at present.

        Raises:
            ValueError: for NaN and infinity, and in an axisymmetric problem off the axis.
        """
        position = np.array(self.position.value, dtype=np.float64)
        rotation = np.array(self.rotation.value, dtype=np.float64).reshape(-1)
        for name, value in (("position", position), ("rotation", rotation)):
            if not np.isfinite(value).all():
                raise ValueError(f"{name} is {value.tolist()}: set the Constant to finite numbers")
        if self.revolved and (rotation.any() or position[0] != self.point[0]):
            raise ValueError(
                f"position is {position.tolist()} and rotation {rotation.tolist()}: in an "
                f"axisymmetric problem a tool moves along the axis only, from {self.point.tolist()}"
            )
        return Pose(position, rotation, self.point)


def _check_point(given: Any, d: int) -> Floats:
    found = np.asarray(given, dtype=np.float64) if np.size(given) == d else np.zeros(0)
    if found.shape != (d,) or not np.isfinite(found).all():
        raise ValueError(f"reference is {given!r}: give {d} finite coordinates")
    return found


def find_facing(side: WholeSide, pose: Pose, shape: Shape, x: Floats) -> Bools:
    """Return which facets (m,) of this rank face the tool, for nodes at x (n, d).

    Those whose mean normal meets that of the tool at their centre at less than 78 degrees.
    """
    facets = facets_at(side.slave, x)
    tool = pose.distance(shape, facets.x.mean(axis=1)).gradient
    return np.asarray(-(facet_normals(facets) * tool).sum(axis=1) > FACING)

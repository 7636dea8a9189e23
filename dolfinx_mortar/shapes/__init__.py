# SPDX-License-Identifier: MIT
"""Shapes of rigid tools: signed distances with normals and curvatures, in arrays."""

from dolfinx_mortar.shapes.given_distance import SignedDistance
from dolfinx_mortar.shapes.polyline import Polyline
from dolfinx_mortar.shapes.primitives import (
    Complement,
    Cone,
    Cylinder,
    Intersection,
    Plane,
    Sphere,
    Torus,
    Union,
    Wedge,
    berkovich,
)
from dolfinx_mortar.shapes.shape import Distance, Shape
from dolfinx_mortar.shapes.triangles import Triangles

__all__ = [
    "Complement",
    "Cone",
    "Cylinder",
    "Distance",
    "Intersection",
    "Plane",
    "Polyline",
    "Shape",
    "SignedDistance",
    "Sphere",
    "Torus",
    "Triangles",
    "Union",
    "Wedge",
    "berkovich",
]

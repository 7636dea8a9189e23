# SPDX-License-Identifier: MIT
"""Segments of facets of second order, which are clipped in parts."""

import numpy as np
import pytest

from dolfinx_mortar.geometry import segments
from dolfinx_mortar.geometry.elements import QUAD9, TRI6
from dolfinx_mortar.geometry.facets import Facets, facet_normals, points_of, tributary_weights
from dolfinx_mortar.geometry.parts import parts_of


@pytest.mark.parametrize("element", [TRI6, QUAD9], ids=["six", "nine"])
def test_curved_facets_are_integrated_as_they_are(element):
    """The area of a piece of a paraboloid, not of its four flat parts."""
    xi = element.points
    x = np.column_stack([xi, 0.2 * (xi[:, 0] ** 2 + 0.5 * xi[:, 0] * xi[:, 1])])
    slave = Facets(element, x[None])
    corner = np.array([[-9.0, -9.0], [9.0, -9.0], [9.0, 9.0], [-9.0, 9.0]])
    if not element.bilinear:
        corner = np.array([[-9.0, -9.0], [27.0, -9.0], [-9.0, 27.0]])
    flat = np.column_stack([corner, np.full(len(corner), 1.0)])
    master = Facets(element, (element.vertex_functions(xi) @ flat)[None, list(element.mirrored)])
    pairs = np.zeros((1, 2), dtype=np.int32)
    points = segments.create_segments(slave, np.zeros((1, 1, 3)), master, pairs)
    area, parts = (tributary_weights(f).sum() for f in (slave, parts_of(slave)))
    assert abs(points.weight.sum() - area) < 0.1 * abs(parts - area)
    assert abs(parts - area) > 1e-4 * area
    # points lie on both surfaces, over each other along the normal of their part
    x_s = points_of(slave, points.slave, points.xi_s)
    x_m = points_of(master, points.master, points.xi_m)
    n = facet_normals(parts_of(slave))
    across = np.linalg.norm(np.cross((x_m - x_s)[:, None], n[None]), axis=2).min(axis=1)
    assert across.max() < 1e-12 and np.abs(x_m[:, 2] - 1.0).max() < 1e-12

# SPDX-License-Identifier: MIT
"""Segments of facets of second order, which are clipped in parts."""

import numpy as np
import pytest

from dolfinx_mortar.geometry import area, segments
from dolfinx_mortar.geometry.facets import (
    QUAD9,
    TRI6,
    Facets,
    facet_normals,
    points_of,
    tributary_weights,
)
from dolfinx_mortar.geometry.plane import parts_of


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
    x_m = element.first.shape_functions(xi) @ flat
    master = Facets(element, x_m[None, list(element.mirrored)])
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


def sides(element, bend):
    """Return two facets over two others, on a paraboloid that turns by 2 bend over each facet."""
    x = element.points if element.bilinear else 2 * element.points - 0.6
    shifts = np.array([[0.1, 0.2], [-1.7, 0.1]]), np.array([[0.0, 0.0], [-2.0, 0.0]])
    found = []
    for shift in shifts:
        at = x[None] + shift[:, None]
        found.append(Facets(element, np.dstack([at, bend / 2 * (at**2).sum(axis=2)])))
    return found[0], Facets(element, found[1].x[:, list(element.mirrored)])


def products(slave, master):
    """Return int N_j N_l (pairs, k, k), and int N_j (pairs, k)."""
    pairs = np.array([[0, 0], [0, 1], [1, 0], [1, 1]], dtype=np.int32)
    p = segments.create_segments(slave, np.zeros((2, 1, 3)), master, pairs)
    N, L = (slave.element.shape_functions(xi) for xi in (p.xi_s, p.xi_m))
    w = np.eye(4)[p.pair].T[:, None] * p.weight * N.T
    return w @ L, w.sum(axis=2)


@pytest.mark.parametrize(("element", "largest"), [(TRI6, 2e-3), (QUAD9, 1e-6)], ids=["six", "nine"])
def test_rules_are_exact_on_flat_facets_and_close_on_curved_ones(element, largest, monkeypatch):
    for bend in (0.0, 0.01, 0.1):
        found = products(*sides(element, bend))
        with monkeypatch.context() as context:
            context.setattr(area, "least_degree", lambda slave, master: 24)
            exact = products(*sides(element, bend))
        turn, size = 2 * bend, exact[1].sum()
        assert size > 1.0
        assert np.abs(found[0] - exact[0]).max() < (1e-14 + largest * turn**2) * size
        assert np.abs(found[1] - exact[1]).max() < (1e-14 + 1e-5 * turn**4) * size

# SPDX-License-Identifier: MIT
"""Distances between facets, and which bodies face each other, against all pairs one by one."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from dolfinx_mortar.geometry.elements import QUAD4
from dolfinx_mortar.geometry.facets import Facets
from dolfinx_mortar.geometry.flat import distances, facet_distances

MANY = settings(max_examples=40, deadline=None)
NUMBERS = st.integers(0, 2**32 - 1).map(np.random.default_rng)


def least(a, b):
    """Return the distance of two parallelograms or lines, by a least-squares problem in a box."""
    edges = [x[[1, -1]][: len(x) // 2] - x[0] if len(x) > 2 else x[1:] - x[0] for x in (a, b)]
    A = np.concatenate([edges[0], -edges[1]]).T
    found = lsq_linear(A, b[0] - a[0], (0.0, 1.0), method="bvls", tol=1e-15)
    return np.linalg.norm(A @ found.x - (b[0] - a[0]))


@given(NUMBERS)
@MANY
def test_distances_of_lines_and_parallelograms(rng):
    lines = rng.normal(size=(2, 2, 2))
    assert np.isclose(distances(*lines[:, None])[0], least(*lines), atol=1e-7)
    corners = rng.normal(size=(2, 3, 3))
    quads = np.concatenate([corners, corners[:, [0]] + corners[:, [2]] - corners[:, [1]]], axis=1)
    found = facet_distances(*(Facets(QUAD4, x[None]) for x in quads))[0]
    assert np.isclose(found, least(*quads), atol=1e-7)


def test_distance_of_triangles_that_pierce_each_other_or_lie_in_a_line():
    flat = np.array([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]])
    for tip, expected in ((-1.0, 0.0), (0.25, 0.25)):
        pin = np.array([[[0.2, 0.2, tip], [0.2, 0.2, 3], [0.25, 0.2, 3]]])
        assert abs(distances(flat, pin)[0] - expected) < 1e-15
        assert abs(distances(pin, flat)[0] - expected) < 1e-15
    line = np.array([[[0.0, 0], [1, 0]]])
    assert distances(line, line + np.array([3.0, 0.0]))[0] == 2.0
    assert distances(line, line[:, ::-1] + np.array([0.5, 0.25]))[0] == 0.25

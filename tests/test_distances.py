# SPDX-License-Identifier: MIT
"""Distances between facets, and which bodies face each other, against all pairs one by one."""

from mpi4py import MPI

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from dolfinx_mortar.geometry.elements import LINE2, QUAD4
from dolfinx_mortar.geometry.facets import Facets
from dolfinx_mortar.geometry.flat import distances, facet_distances
from dolfinx_mortar.mortar.facing_bodies import Skin, find_facing

MANY = settings(max_examples=40, deadline=None)
NUMBERS = st.integers(0, 2**32 - 1).map(np.random.default_rng)
CUBE = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], dtype=float)
SQUARE = np.array(
    [[[0, 0], [1, 0]], [[1, 0], [1, 1]], [[1, 1], [0, 1]], [[0, 1], [0, 0]]], dtype=float
)
SIDES = np.array(
    [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
)


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


@pytest.mark.parametrize("d", [2, 3])
@given(NUMBERS)
@MANY
def test_boxes_that_face_each_other(d, rng):
    """Of two boxes one above the other, turned together: the area both cover, and their gap."""
    size, gap = rng.uniform(0.5, 2.0, (2, d)), rng.uniform(-0.2, 1.0)
    shift = np.append(rng.uniform(-0.4, 0.4, d - 1), size[0, -1] + gap)
    turn = np.linalg.qr(rng.normal(size=(d, d)))[0]
    turn[0] *= np.linalg.det(turn)
    corners, kind = (CUBE[SIDES], QUAD4) if d == 3 else (SQUARE, LINE2)
    x = np.concatenate([corners * size[0], corners * size[1] + shift]) @ turn.T
    body, top = np.repeat([0, 1], len(corners)), 1 if d == 3 else 2
    facets = Facets(kind, x)
    found = find_facing(MPI.COMM_SELF, Skin(facets, body, body[:, None]))
    over = np.minimum(size[0, :-1], shift[:-1] + size[1, :-1]) - np.maximum(0.0, shift[:-1])
    below = found.facet == top  # of the lower box, beside what flanks see in an overlap
    middle = size[0, :-1] / 2 - shift[:-1]
    lies_in = ((middle > 0.0) & (middle < size[1, :-1])).all()
    if gap > 0.0 or (gap > -0.5 * size[:, -1].min() and lies_in):
        assert np.isclose(found.area[below].sum(), over.prod(), rtol=1e-9)
        assert np.isclose(found.distance[below].min(), gap, atol=1e-7)
        assert (found.part[below] == [0, 1]).all()
    if gap > 0.0:
        assert sorted(found.facet.tolist()) == [top, len(corners)]

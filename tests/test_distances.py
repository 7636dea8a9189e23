# SPDX-License-Identifier: MIT
"""Distances between facets, and which bodies face each other, against all pairs one by one."""

from mpi4py import MPI

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from dolfinx_mortar.geometry.elements import LINE2, QUAD4
from dolfinx_mortar.geometry.facets import Facets, facet_normals
from dolfinx_mortar.geometry.flat import distances, facet_distances
from dolfinx_mortar.mortar.facing_bodies import Skin, find_facing

MANY = settings(max_examples=40, deadline=None)
NUMBERS = st.integers(0, 2**32 - 1).map(np.random.default_rng)
CUBE = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], dtype=float)
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


def rectangle(rng, place, columns=3):
    """Return the boundary of a turned rectangle around a place."""
    size, turn = rng.uniform(0.3, 0.9, 2), rng.uniform(0.0, 2 * np.pi)
    corners = (np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) - 0.5) * size
    R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    corners = corners @ R.T + place
    x, shares = [], np.linspace(0.0, 1.0, columns + 1)
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        points = a + shares[:, None] * (b - a)
        x += list(np.stack([points[:-1], points[1:]], axis=1))
    return np.array(x)


def apart(a, b):
    """Return the distances (m, n) of lines a (m, 2, 2) and b (n, 2, 2) that do not cross."""

    def to_lines(p, x):
        e = x[:, 1] - x[:, 0]
        r = p[:, None, None] - x[:, 0]
        share = np.clip((r * e).sum(axis=-1) / (e**2).sum(axis=-1), 0.0, 1.0)
        return np.linalg.norm(r - share[..., None] * e, axis=-1)[:, 0]

    ends = [to_lines(a[:, k], b) for k in (0, 1)] + [to_lines(b[:, k], a).T for k in (0, 1)]
    return np.min(ends, axis=0)


def first_hits(x, n, points, normal):
    """Return which lines x lie first before points (r, d) along a normal that they face; or -1."""
    e, faces = x[:, 1] - x[:, 0], n @ normal < -0.2
    determinant = np.where(faces, normal[1] * e[:, 0] - normal[0] * e[:, 1], 1.0)
    r = x[:, 0] - points[:, None]
    t = (e[:, 0] * r[..., 1] - e[:, 1] * r[..., 0]) / determinant
    s = (normal[0] * r[..., 1] - normal[1] * r[..., 0]) / determinant
    t = np.where(faces & (s >= 0.0) & (s <= 1.0) & (t > 0.0), t, np.inf)
    return np.where(np.isfinite(t).any(axis=1), np.argmin(t, axis=1), -1)


@given(NUMBERS)
@MANY
def test_facing_rectangles_are_those_that_rays_meet_first(rng):
    """Areas of random bodies that face each other by 100 rays each, distances by all pairs."""
    places = 1.3 * np.array([[0, 0], [1, 0], [0, 1], [1, 1]])  # apart: diagonals are below 1.28
    parts = [rectangle(rng, place) for place in places]
    x = np.concatenate(parts)
    body = np.repeat(np.arange(4), [len(p) for p in parts])
    facets = Facets(LINE2, x)
    found = find_facing(MPI.COMM_SELF, Skin(facets, body, body[:, None]))
    n, rays = facet_normals(facets), 100
    shares = (np.arange(rays) + 0.5)[:, None] / rays
    area, length = np.zeros((len(x), len(x))), np.linalg.norm(x[:, 1] - x[:, 0], axis=1)
    for k, (a, b) in enumerate(x):
        hit = first_hits(x, n, a + shares * (b - a), n[k])
        np.add.at(area[k], hit[hit >= 0], length[k] / rays)
    to_bodies = np.stack([area[:, body == k].sum(axis=1) * (body != k) for k in range(4)], axis=1)
    own = np.zeros_like(to_bodies)
    np.add.at(own, (found.facet, found.part[:, 1]), found.area)
    # at the ends of parts a ray is counted or not; a facet can face at most six of them
    assert (np.abs(own - to_bodies) <= 12 * length[:, None] / rays).all()
    least_of, distance = {}, apart(x, x)
    for k, m in np.argwhere(area > 2.5 * length[:, None] / rays):
        if body[k] != body[m]:
            pair = body[k], body[m]
            least_of[pair] = min(distance[k, m], least_of.get(pair, np.inf))
    for pair, expected in least_of.items():
        own = found.distance[(found.part == pair).all(axis=1)].min()
        one, other = (body == of for of in pair)
        assert distance[np.ix_(one, other)].min() - 1e-12 <= own <= expected + 1e-12


@given(NUMBERS)
@MANY
def test_closest_distance_of_boxes(rng):
    """Of two boxes one above the other, turned together, that is their gap."""
    size, gap = rng.uniform(0.5, 2.0, (2, 3)), rng.uniform(-0.2, 1.0)
    shift = np.append(rng.uniform(-0.4, 0.4, 2), size[0, 2] + gap)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    x = np.stack([CUBE[SIDES] * size[0], CUBE[SIDES] * size[1] + shift]) @ turn.T
    body = np.repeat([0, 1], 6)
    facets = Facets(QUAD4, x.reshape(12, 4, 3))
    found = find_facing(MPI.COMM_SELF, Skin(facets, body, body[:, None]))
    over = np.minimum(size[0, :2], shift[:2] + size[1, :2]) - np.maximum(0.0, shift[:2])
    below = found.facet == 1  # the top of the lower box, beside what flanks see in an overlap
    middle = size[0, :2] / 2 - shift[:2]
    lies_in = ((middle > 0.0) & (middle < size[1, :2])).all()
    if gap > 0.0 or (gap > -0.5 * size[:, 2].min() and lies_in):
        assert np.isclose(found.area[below].sum(), over.prod(), rtol=1e-9)
        assert np.isclose(found.distance[below].min(), gap, atol=1e-7)
    if gap > 0.0:
        assert sorted(found.facet.tolist()) == [1, 6]

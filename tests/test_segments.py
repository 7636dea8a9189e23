# SPDX-License-Identifier: MIT
"""Projection, clipping and candidates, by identities on polylines."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dolfinx_mortar.geometry import line, segments
from dolfinx_mortar.geometry.facets import LINE2, LINE3, Facets, normals_at_nodes
from dolfinx_mortar.geometry.segments import create_cones
from tests.cases.polylines import assemble, chain, nodal_normals

EXACT = 1e-12


def flat(splits, y=0.0, angle=0.0, up=False):
    """Return the nodes of a straight polyline; the outward normal is -y unless `up`."""
    x = np.sort(np.asarray(splits, dtype=float))[:: -1 if up else 1]
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([x, np.full_like(x, y)], axis=1) @ np.array([[c, s], [-s, c]])


def polyline(x):
    return Facets(LINE2, x[chain(len(x))])


def split(low, high):
    inner = st.lists(st.floats(0.001, 0.999), max_size=9)
    return inner.map(lambda s: low + (high - low) * np.unique(np.round([0, *s, 1], 6)))


@settings(deadline=None)
@given(split(0, 1), split(-0.3, 0.7), st.floats(-3, 3), st.floats(0, 7), st.floats(-1, 1))
def test_covered_length_and_projection_on_flat_sides(slave, master, shift, angle, gap):
    """The covered length is the overlap, and every point is projected along the normal."""
    master = master + shift
    o = assemble(flat(slave, angle=angle), flat(master, -gap, angle, up=True))
    low, high = np.maximum(slave[:-1], master[0]), np.minimum(slave[1:], master[-1])
    assert np.abs(o.covered - np.maximum(high - low, 0)).max() < EXACT
    p = o.points
    N, L = LINE2.shape_functions(p.xi_s), LINE2.shape_functions(p.xi_m)
    x_s = np.einsum("qk,qki->qi", N, o.x_s[chain(len(slave))][p.slave])
    x_m = np.einsum("qk,qki->qi", L, o.x_m[chain(len(master))][p.master])
    normal = np.array([np.sin(angle), -np.cos(angle)])
    assert np.abs(x_m - x_s - gap * normal).max(initial=0) < EXACT
    assert np.abs(p.xi_s).max(initial=0) <= 1 + EXACT
    assert np.abs(p.xi_m).max(initial=0) <= 1 + 1e-9  # master facets may be 1e-3 short
    assert (p.weight > 0).all()
    assert (np.diff(p.slave) >= 0).all()


def test_coincident_nodes_leave_neither_holes_nor_slivers():
    x = np.array([0.0, 0.1, 0.35, 0.7, 1.0])
    noise = 1e-15 * np.array([0, 1, -1, 1, 0])
    for master in (x, x + noise, x - noise):
        o = assemble(flat(x), flat(master, up=True))
        assert len(o.points.weight) == 3 * 4
        assert np.abs(o.covered - np.diff(x)).max() < 1e-14


LAYERS = {  # heights of sides that face the slave, or show it their back, and what they cover
    "the nearer": ([(0.6, 0.2, -0.1), (1.0, 0.0, -0.5)], [0.4, 0.6]),
    "in another order": ([(1.0, 0.0, -0.5), (0.6, 0.2, -0.1)], [0.6, 0.4]),
    "the one that overlaps": ([(1.0, 0.0, 0.1), (1.0, 0.0, -0.2)], [1.0, 0.0]),
    "not the back of a thin one": ([(1.0, 0.0, -0.1), (0.0, 1.0, -0.05)], [1.0, 0.0]),
    "not what is parallel": ([(0.0, 1.0, -0.1)], [0.0]),
    "not what is beside": ([(1.5, 1.0, 0.0)], [0.0]),
}


@pytest.mark.parametrize("case", LAYERS)
def test_the_nearest_side_that_faces_the_slave_covers(case):
    ends, expected = LAYERS[case]
    x_m = [(x, y) for first, last, y in ends for x in (first, last)]
    o = assemble(flat([0, 1]), x_m, facets_m=np.arange(len(x_m)).reshape(-1, 2))
    weights = np.bincount(o.points.master, o.points.weight, minlength=len(ends))
    assert weights == pytest.approx(expected, abs=1e-14)
    assert o.points.facet_weights.sum() == pytest.approx(1.0)


def test_points_lie_on_the_interpolated_normal():
    angle = np.linspace(-2.0, -1.0, 4)
    x_s = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    x_m = flat([-0.9, -0.2, 0.1, 0.8], -1.2, up=True)
    o = assemble(x_s, x_m)
    p, facets = o.points, chain(4)
    assert len(p.weight) > 0
    N, L = LINE2.shape_functions(p.xi_s), LINE2.shape_functions(p.xi_m)
    normal = np.einsum("qk,qki->qi", N, nodal_normals(x_s, facets)[facets][p.slave])
    ray = np.einsum("qk,qki->qi", L, x_m[facets][p.master])
    ray -= np.einsum("qk,qki->qi", N, x_s[facets][p.slave])
    cross = ray[:, 0] * normal[:, 1] - ray[:, 1] * normal[:, 0]
    assert np.abs(cross).max() < 1e-14
    assert ((ray * normal).sum(axis=1) > 0).all()


def test_points_lie_on_the_master_between_its_ends():
    """A facet of an iterate whose normals meet it twice, once beyond an end, as at -2.29 here."""
    slave = np.array([[1.25, 0.364], [-1.1, 0.043], [-0.356, -0.395]])
    normals = np.array([[-0.2625, 0.965], [0.4204, 0.907], [-0.4164, 0.909]])
    master = np.array([[-0.6155, 1.097], [0.825, 0.957], [0.201, 0.003]])
    sides = Facets(LINE3, slave[None]), normals[None], Facets(LINE3, master[None])
    _, _, xi_m, _ = line.place_points(*sides, np.zeros((1, 2), np.int32), np.full(1, np.inf))
    assert len(xi_m) == 5 and np.abs(xi_m).max() <= 1.0


def test_long_master_beyond_a_corner():
    """The far end of the master has no projection at all; the facet is covered nonetheless."""
    x_s = [[-1, 0], [0, 0], [1, 0], [1, 1]]
    o = assemble(x_s, [[50, -0.1], [-50, -0.1]])
    assert o.covered[:2] == pytest.approx([1.0, 1.0], abs=EXACT)
    assert o.covered[2] == 0.0  # its normal is at a right angle to the master's


def test_every_facet_may_be_a_candidate_of_every_other():
    """Far away and provided for rotation: more pairs than the first allocation holds."""
    grid = np.linspace(0, 1, 61)
    x_s, x_m = polyline(flat(grid)), polyline(flat(grid, -99, up=True))
    pairs = segments.find_candidates(x_s, np.full_like(x_s.x, (0, -1)), x_m, np.ones(60))
    assert (pairs == np.stack(np.divmod(np.arange(3600), 60), axis=1)).all()


# -- facets of three nodes


def bent(rng, m):
    """Return facets (m, 3, 2) along x, of any shape that the audit lets pass, and their normals."""
    x = np.zeros((m, 3, 2))
    x[:, 1, 0] = 1.0
    x[:, 2] = [0.5, 0.0] + rng.uniform(-1, 1, (m, 2)) * [0.15, 0.3]
    facets = Facets(LINE3, x)
    n = normals_at_nodes(facets) + rng.uniform(-0.3, 0.3, x.shape)
    return facets, n / np.linalg.norm(n, axis=2, keepdims=True)


def test_cones_hold_the_normals_between_the_nodes(rng):
    """Those of three nodes turn further than any of these; the facet stays near its nodes."""
    facets, n = bent(rng, 200)
    cones = create_cones(facets.x, segments.bounding_directions(facets, n), np.zeros(len(facets.x)))
    xi = np.linspace(-1, 1, 41)[:, None]
    N = LINE3.shape_functions(xi)
    x, between = (np.einsum("qk,mki->mqi", N, v) for v in (facets.x, n))
    cosine = np.einsum("mqi,mi->mq", between, cones.axis) / np.linalg.norm(between, axis=2)
    assert (np.sqrt(1 - np.minimum(cosine, 1) ** 2) / cosine <= cones.slope[:, None] + 1e-9).all()
    assert (np.linalg.norm(x - cones.centre[:, None], axis=2) <= cones.radius[:, None]).all()


def test_normals_of_bent_facets_meet_the_point_that_is_projected(rng):
    """The root lies where the sign changes, also near the centre of curvature (bisection)."""
    facets, n = bent(rng, 300)
    x, n = (line._polynomials(facets.element, v) for v in (facets.x, n))
    found = halved = 0
    for a, b, at, share in zip(
        x, n, *rng.uniform([[-1], [0.3]], [[1], [1.2]], (2, 300)), strict=True
    ):
        powers = at ** np.arange(3)
        slopes = [line._moment(a, b, *(powers @ v), at)[1] for v in (a, a + b)]
        y = powers @ (a + share * slopes[0] / (slopes[0] - slopes[1]) * b)  # slope 0 at share 1
        f = np.array([line._moment(a, b, *y, xi) for xi in np.linspace(-1, 1, 41)])
        xi, first, last = line._project_node(a, b, *y), f[0, 0], f[-1, 0]
        if first > 0 > last:
            found += 1
            assert abs(line._moment(a, b, *y, xi)[0]) < 1e-13 * max(1, np.abs(y).max())
            halved += (f[:, 1] >= 0).any()  # Newton's method alone need not converge
        elif first <= 0 <= last:
            assert np.isnan(xi)
        else:
            assert xi == (-1.0 if first <= 0 else 1.0)
    assert found > 100 and halved > 10

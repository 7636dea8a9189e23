# SPDX-License-Identifier: MIT
"""Projection, clipping and candidates in 3D, by identities on surfaces without a mesh."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dolfinx_mortar.geometry import facets
from dolfinx_mortar.geometry.facets import QUAD4
from tests.cases.meshes_3d import rotation
from tests.cases.surfaces import Side, assemble, grid, joined, ring, triangles

EXACT = 1e-12
TURN = rotation((0.3, -1.0, 0.7), 1.1)
CORNERS = np.array([[0.0, 0], [1, 0], [0, 1], [1, 1]])
PAIRS = pytest.mark.parametrize("k_s, k_m", [(3, 3), (3, 4), (4, 3), (4, 4)])


def areas(side):
    return np.linalg.norm(facets.area_vectors(side.geometry), axis=1)


def check_identities(slave, master, normal, gap, *, tolerance=EXACT):
    """Check the operators of two flat sides, the master at slave + gap * normal and the larger."""
    o = assemble(slave, master)
    scale = np.abs(slave.x).max()
    assert np.abs(o.covered - areas(slave)).max() < tolerance
    # the normal of a facet is as inexact as its nodes over its height
    height = areas(slave) / facets.bounding_balls(slave.corners)[1]
    error = np.abs(o.x_m - o.x_s - gap * normal).max(axis=1)
    assert (error < tolerance + 1e-14 * scale * abs(gap) / height[o.points.slave]).all()
    assert (o.points.weight > 0).all()
    assert (np.diff(o.points.slave) >= 0).all()
    # D is diagonal, constants and linear fields are reproduced, nothing is lost on the way
    assert np.abs(o.D - np.diag(o.weights)).max() < tolerance
    assert np.abs(o.D.sum(axis=1) - o.M.sum(axis=1)).max() < tolerance
    assert np.abs(o.D.sum(axis=0) - o.weights).max() < tolerance
    assert np.abs(o.M.sum(axis=0) - o.master_weights).max() < tolerance
    linear = o.M @ (master.x - gap * normal) - o.D @ slave.x
    assert np.abs(linear).max() < tolerance * scale
    whole = np.zeros(len(slave.x))
    np.add.at(whole, slave.facets, o.points.facet_weights)
    # the integral of N_j over the whole of a quadrilateral is one of those that are nearly exact
    assert np.abs(o.weights - whole).max() < 10 * tolerance
    return o


def points_2d(low, high):
    """Return a strategy of points in a square with its corners; also close together."""
    coordinate = st.floats(low, high)
    wild = st.lists(st.tuples(coordinate, coordinate), max_size=12)
    box = low + (high - low) * CORNERS
    return wild.map(lambda p: np.concatenate([box, np.reshape(p, (-1, 2))]))


@settings(max_examples=80)
@given(points_2d(0, 1), points_2d(-0.25, 1.5), st.floats(-2, 2), st.booleans())
def test_random_triangles(slave, master, gap, shared):
    """Slivers, touching edges, coincident and almost coincident nodes."""
    if shared:  # the slave nodes also occur on the master side, some of them a little off
        noise = np.resize([0, 1e-16, -1e-15, 1e-13, 1e-11, 1e-9, -1e-7, 1e-5], slave.shape)
        master = np.concatenate([master, slave + noise])
    x_s = triangles(slave).moved(TURN)
    x_m = triangles(master).reversed().moved(TURN, gap * TURN[:, 2])
    check_identities(x_s, x_m, TURN[:, 2], gap)


def lines(low, high):
    widths = st.lists(st.floats(0.05, 1), min_size=1, max_size=5)
    return widths.map(lambda w: low + (high - low) * np.cumsum([0, *w]) / np.sum(w))


@PAIRS
@settings(max_examples=25)
@given(
    x=st.tuples(lines(0, 1), lines(0, 1)),
    y=st.tuples(lines(-0.3, 1), lines(0, 1.4)),
    jitter=st.floats(0, 0.6),
    seed=st.integers(0, 1000),
    angle=st.floats(0, 7),
)
def test_random_grids(k_s, k_m, x, y, jitter, seed, angle):
    """Facets of both kinds, of any convex shape; flat quadrilaterals are integrated exactly."""
    slave = grid(*x, jitter, seed, k_s).moved(TURN)
    turn = rotation((0, 0, 1), angle) if k_s == k_m else np.eye(3)
    wide = grid(y[0] * 3 - 1, y[1] * 3 - 1, jitter, seed + 1, k_m).reversed()
    middle = np.array([0.5, 0.5, 0])
    master = wide.moved(TURN @ turn, TURN @ (middle - turn @ middle + [0, 0, 0.1]))
    check_identities(slave, master, TURN[:, 2], 0.1)


@PAIRS
@pytest.mark.parametrize("seed", range(4))
def test_nearest_of_several_masters_covers(k_s, k_m, seed):
    """Layers behind each other, the nearer ones smaller: no point is covered twice."""
    slave = grid(np.linspace(0, 1, 3), np.linspace(0, 1, 3), 0.3, seed, k_s)
    near = grid([0.2, 0.35, 0.6], [0.25, 0.8], 0, seed, k_m).moved(shift=(0, 0, 0.1))
    other = grid([0.5, 0.9], [0.1, 0.4, 0.9], 0, seed, k_m).moved(shift=(0, 0, -0.2))
    far = grid(np.linspace(-1, 2, 5), np.linspace(-1, 2, 5), 0.3, seed, k_m)
    far = far.moved(shift=(0, 0, 0.5))
    master = joined(far, other, near).renumbered(seed).reversed()
    o = assemble(slave, master)
    assert np.abs(o.covered - areas(slave)).max() < EXACT
    height = master.corners[:, :, 2].mean(axis=1)
    shares = [o.used[np.isclose(height, z)].sum() for z in (0.1, -0.2, 0.5)]
    beside = 0.4 * 0.8 - 0.1 * 0.55  # of the second layer, beside the first
    first = 0.4 * 0.55
    assert shares == pytest.approx([first, beside, 1 - first - beside], abs=EXACT)


@PAIRS
def test_crossing_masters_cover_once(k_s, k_m):
    """Two layers that penetrate each other: everything is covered, by either."""
    slave = grid([0, 0.4, 1], [0, 0.7, 1], k=k_s)
    slope = np.array([[1, 0, 0], [0, 1, 0], [0.4, 0, 1]])
    flat = grid(np.linspace(-1, 2, 6), [-1, 0.2, 2], k=k_m)
    master = joined(flat.moved(slope, (0, 0, 0.1)), flat.moved(shift=(0, 0, 0.3))).reversed()
    assert np.abs(assemble(slave, master).covered - areas(slave)).max() < EXACT


@pytest.mark.parametrize("count", [8, 40, 100])
@pytest.mark.parametrize("k_s", [3, 4])
def test_polygons_of_many_corners(k_s, count):
    """A ring of small masters leaves a disc of the large one behind them, a polygon of as many."""
    near, far = ring(count)
    o = assemble(grid([0, 1], [0, 1], k=k_s), joined(far, near))
    assert o.covered.sum() == pytest.approx(1.0, abs=EXACT)
    assert o.used[len(far.facets) :].sum() == pytest.approx(areas(near).sum(), abs=EXACT)


@pytest.mark.parametrize(("cosine", "covered"), [(0.18, 0.0), (0.22, 1.0), (-1.0, 0.0)])
def test_what_stands_steeper_than_a_fifth_does_not_face(cosine, covered):
    """A decision: a master plane whose normal has less than that against the slave is a flank."""
    slope = np.sqrt(1 / cosine**2 - 1)
    steep = grid([-1, 2], [-1, 2]).moved([[1, 0, 0], [0, 1, 0], [slope, 0, 1]])
    steep = steep if cosine < 0 else steep.reversed()
    o = assemble(grid([0, 1], [0, 1]), steep.moved(shift=(0, 0, 0.1)))
    assert o.covered.sum() == pytest.approx(covered, abs=EXACT)


def curved(side, bend):
    return Side(np.column_stack([side.x[:, :2], bend(*side.x[:, :2].T)]), side.facets)


@pytest.mark.parametrize(
    ("warp", "tolerance"), [(0.02, 1e-13), (0.1, 1e-13), (0.2, 1e-13), (0.5, 1e-11), (1.0, 1e-7)]
)
@pytest.mark.parametrize("shift", [0.0, 0.1])
def test_integrals_over_warped_quadrilaterals(warp, tolerance, shift):
    """Phi_j N_l against many Gauss points on a facet that is as good as square from above."""
    x = np.array([[0.0, 0, warp], [1 + shift, 0, -warp], [1, 1, warp], [0, 1, -warp]])
    slave = Side(x, np.arange(4, dtype=np.int32)[None])
    o = assemble(slave, grid([-3, 4], [-3, 4], k=4).reversed().moved(shift=(0, 0, 0.5)))
    points, weights = np.polynomial.legendre.leggauss(30)
    xi = np.stack(np.meshgrid(points, points), axis=-1).reshape(-1, 2)
    J = (
        np.linalg.norm(facets.scaled_normals(slave.geometry, xi)[0], axis=1)
        * np.outer(weights, weights).ravel()
        / 4
    )
    N, N_q = (QUAD4.shape_functions(v) for v in (xi, o.points.xi_s))
    expected, found = (N.T * J) @ N, (N_q.T * o.points.weight) @ N_q
    assert np.abs(found - expected).max() < tolerance


def saddle(x, y):
    return 0.3 * x**2 - 0.2 * y**2 + 0.2 * x * y


@PAIRS
def test_points_lie_on_the_normal_of_the_slave_facet(k_s, k_m):
    slave = curved(grid(np.linspace(0, 1, 4), np.linspace(0, 1, 5), 0.5, 1, k_s), saddle)
    master = curved(grid(np.linspace(-1, 2, 7), np.linspace(-1, 2, 6), 0.5, 2, k_m), saddle)
    o = assemble(slave, master.reversed().moved(shift=(0.1, 0, 0.4)))
    normals = facets.facet_normals(slave.geometry)[o.points.slave]
    assert len(normals) > 0
    assert np.abs(np.cross(o.x_m - o.x_s, normals)).max() < EXACT


@PAIRS
@pytest.mark.parametrize(("seed", "scale"), [(0, 1e-6), (1, 1e6)])
def test_numbering_and_units_do_not_matter(k_s, k_m, seed, scale):
    """Operators as bilinear forms of fields are the same for any order of nodes and facets."""
    slave = curved(grid(np.linspace(0, 1, 4), np.linspace(0, 1, 5), 0.5, 1, k_s), saddle)
    master = curved(grid(np.linspace(-0.4, 2, 7), np.linspace(0.3, 2, 6), 0.5, 2, k_m), saddle)

    def forms(slave, master, unit):
        o = assemble(slave.moved(unit * np.eye(3)), master.moved(unit * np.eye(3)))
        f, g = np.exp(slave.x @ [0.3, 0.8, 0.1]), np.cos(master.x @ [1, 2, 1.0])
        return np.array([f @ o.D @ f, f @ o.M @ g, o.covered.sum()]) / unit**2

    one = forms(slave, master.reversed(), 1.0)
    other = forms(slave.renumbered(seed), master.reversed().renumbered(seed + 10), scale)
    # the surface of warped facets is not a polynomial; everything else is exact
    assert np.abs(one - other).max() < (1e-7 if k_s == 4 else 1e-11)


@PAIRS
@settings(max_examples=20)
@given(seed=st.integers(0, 10**6), n=st.integers(1, 6), m=st.integers(1, 6))
def test_candidates_contain_all_segments(k_s, k_m, seed, n, m):
    """The broad phase loses nothing: all pairs as candidates give the same segments."""
    rng = np.random.default_rng(seed)
    a, b = (
        grid(np.linspace(0, 1, n + 1), np.linspace(0, 1, n + 1), 0.4, seed, k_s),
        grid(np.linspace(-0.2, 1, m + 1), np.linspace(0, 1.3, m + 1), 0.4, seed + 1, k_m),
    )
    slave = Side(a.x + rng.uniform(-0.1, 0.1, a.x.shape) / n, a.facets)
    master = Side(b.x + rng.uniform(-0.1, 0.1, b.x.shape) / m + [0, 0, 0.3], b.facets).reversed()
    sizes = len(slave.facets), len(master.facets)
    every = np.stack(np.divmod(np.arange(sizes[0] * sizes[1]), sizes[1]), axis=1)
    o, complete = assemble(slave, master), assemble(slave, master, pairs=every.astype(np.int32))
    for name in ("slave", "master", "xi_s", "xi_m", "weight"):
        assert (getattr(o.points, name) == getattr(complete.points, name)).all()


def test_facets_that_cover_nothing():
    """Beside the slave, and those that deformation has turned inside out; no pairs at all."""
    folded = Side(np.pad(CORNERS, ((0, 0), (0, 1))), np.array([[0, 1, 2, 3]]))
    whole, one = grid([-1, 2], [-1, 2]), np.zeros((1, 2), dtype=np.int32)
    for slave, master, pairs in (
        (grid([0, 1], [0, 1]), grid([1, 2], [0, 1]), None),
        (folded, whole, one),
        (whole, folded, one),
        (whole, whole, one[:0]),
    ):
        assert len(assemble(slave, master.reversed(), pairs=pairs).points.weight) == 0


def test_inverse_map_takes_the_root_inside():
    """Of the two points of a bilinear facet over a point of the plane, the one on the facet."""
    dart = Side(
        np.array([[0.0, 0, 0], [1, 0, 0], [0.6, 0.6, 0], [0, 1, 0]]), np.array([[0, 1, 2, 3]])
    )
    wide = grid([-1, 2], [-1, 2]).reversed()
    for o in (assemble(dart, wide), assemble(wide.reversed(), dart.reversed())):
        assert np.abs(o.points.xi_s).max() <= 1 + EXACT
        assert np.abs(o.points.xi_m).max() <= 1 + EXACT
        assert np.abs(o.x_s - o.x_m).max() < EXACT
        assert o.covered.sum() == pytest.approx(0.6, abs=EXACT)

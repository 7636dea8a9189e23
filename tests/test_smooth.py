# SPDX-License-Identifier: MIT
"""Smooth surfaces over facets: normals and heights on spheres, cylinders, arcs and edges."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem, mesh
from dolfinx_mortar.geometry.curvature import (
    NodeNormals,
    common_sagittas,
    curvatures,
    curved_sagittas,
    edge_sagittas,
    edges,
    heights,
    own_curvatures,
)
from dolfinx_mortar.geometry.facets import LINE2, LINE3, QUAD4, QUAD9, TRI3, TRI6, Facets
from dolfinx_mortar.mortar.curvature_correction import _count_edges, smooth_normals
from dolfinx_mortar.mortar.surface import create_surface, facets_at, nodal_normals
from tests.cases.close_fits import rings
from tests.cases.meshes_3d import rotation
from tests.test_results import TIP, cracked

COMM = MPI.COMM_WORLD
RADIUS = 8.0
CELLS = ["tetrahedron", "hexahedron"]


def ball(comm, h, cell):
    """Return the surface of the quarter of a half ball, and what its symmetry planes prescribe."""
    m = dm.meshing.sphere(comm, h=h, cell=cell, core=1.0, radius=RADIUS)
    V = fem.functionspace(m.mesh, ("Lagrange", 1, (3,)))
    surface = create_surface(V, m.facet_tags, 4, "slave")
    fixed = np.abs(surface.X) < 1e-9
    fixed[:, 2] = False
    return surface, fixed


def true_heights(facets, centre, radius, xi, axes=slice(None)):
    x = np.einsum("qk,mki->mqi", facets.element.shape_functions(xi), facets.x)
    return radius - np.linalg.norm((x - centre)[:, :, axes], axis=2)


def found_heights(facets, normals, nodes, xi):
    return at_points(facets, edge_sagittas(facets, normals, nodes), xi)


def at_points(facets, c, xi):
    columns = [
        heights(facets, c, np.arange(len(c)), np.broadcast_to(p, (len(c), len(p)))) for p in xi
    ]
    return np.stack(columns, axis=1)


# -- normals and heights ---------------------------------------------------------------------------


@pytest.mark.mpi
@pytest.mark.parametrize("cell", CELLS)
def test_normals_are_exact_on_a_sphere(cell):
    """On an uneven mesh, on planes of symmetry and where both meet; the free rim is open."""
    surface, fixed = ball(COMM, 0.5, cell)
    found = smooth_normals(surface, surface.X, fixed, 40.0)
    exact = (surface.X - [0.0, 0.0, RADIUS]) / RADIUS
    assert not found.sharp.any()
    rim = np.abs(surface.X[:, 2] - RADIUS) < 1e-9
    assert np.array_equal(found.open, rim) and COMM.allreduce(int(rim.sum())) > 3
    assert np.abs(found.n - exact)[found.regular].max(initial=0.0) < 1e-12
    # without the symmetry, the facets at the planes lie on one side only
    alone = smooth_normals(surface, surface.X, np.zeros_like(fixed), 40.0)
    assert alone.open[fixed.any(axis=1)].all()


@pytest.mark.parametrize("element", [LINE2, TRI3, QUAD4])
def test_heights_over_a_sphere_are_of_fourth_order(element, rng):
    """Facets of any shape, with the sphere's normals at their nodes."""
    d = 2 if element is LINE2 else 3
    flat = scattered(element, rng, 1.0)
    xi = np.array([[0.2] * (d - 1), [0.3, 0.1][: d - 1], [0.6, 0.2][: d - 1]])
    errors = []
    for size in (0.2, 0.1):
        x = size * flat + np.eye(d)[-1]
        x /= np.linalg.norm(x, axis=2, keepdims=True)
        no = np.zeros(20 * element.nodes, dtype=bool)
        normals = NodeNormals(x.reshape(-1, d), no, no)
        facets, nodes = Facets(element, x), np.arange(len(no)).reshape(x.shape[:2])
        true = true_heights(facets, np.zeros(d), 1.0, xi)
        errors.append(np.abs(found_heights(facets, normals, nodes, xi) - true).max())
        assert errors[-1] < 0.1 * true.max()
    assert 10.0 < errors[0] / errors[1] < 24.0


@pytest.mark.parametrize(
    ("element", "axes"),
    [(LINE3, [0, 1]), *((e, axes) for e in (TRI6, QUAD9) for axes in ([0, 1, 2], [0, 2]))],
)
def test_heights_over_curved_facets(element, axes, rng):
    """Over spheres and cylinders two orders higher than the facets, wherever their nodes lie."""
    d = element.points.shape[1] + 1
    flat, xi = scattered(element, rng, 0.5, 0.1), element.rule[0]
    left = []
    for size in (0.4, 0.2):
        x = (-1) ** (d == 2) * size * flat + np.eye(d)[-1]  # outward normals
        x[:, :, axes] /= np.linalg.norm(x[:, :, axes], axis=2, keepdims=True)
        facets = Facets(element, x)
        K = own_curvatures(facets)
        same = K[:, None].repeat(len(element.vertices), axis=1)
        true = true_heights(facets, np.zeros(d), 1.0, xi, axes)
        found = at_points(facets, curved_sagittas(facets, K, same), xi)
        left.append(np.abs(found - true).max() / np.abs(true).max())
    assert left[0] < 0.03 and left[1] < 0.3 * left[0]


def scattered(element, rng, size, spread=0.3):
    """Return facets (20,) near the origin of the plane, with their nodes off any grid."""
    d = element.points.shape[1] + 1
    flat = element.points + rng.uniform(-spread, spread, (20, element.nodes, d - 1))
    return size * np.concatenate([flat, np.zeros((*flat.shape[:2], 1))], axis=2)


@pytest.mark.parametrize("element", [LINE2, TRI3, QUAD4])
def test_curvatures_are_those_of_the_surface(element, rng):
    """Over z = -x.H x / 2 they are H, whatever the facets and the units."""
    H = np.array([[0.7, 0.2, 0.0], [0.2, -0.3, 0.0], [0.0, 0.0, 0.0]])
    if element is LINE2:
        H = np.diag([0.7, 0.0])
    for size in (1e-3, 1e3):
        x = scattered(element, rng, 1e-3 * size)
        x[..., -1] = -0.5 * np.einsum("mki,ij,mkj->mk", x, H / size, x)
        n = x @ (H / size) + np.eye(len(H))[-1]
        n /= np.linalg.norm(n, axis=2, keepdims=True)
        no = np.zeros(20 * element.nodes, dtype=bool)
        facets, nodes = Facets(element, x), np.arange(len(no)).reshape(x.shape[:2])
        c = edge_sagittas(facets, NodeNormals(n.reshape(-1, len(H)), no, no), nodes)
        found = size * curvatures(facets, c)
        assert found == pytest.approx(np.broadcast_to(H, found.shape), abs=5e-3)
        assert np.linalg.eigvalsh(found)[:, 0].max() < 1e-3  # tangential


@pytest.mark.parametrize("element", [LINE2, TRI3, QUAD4])
def test_the_common_surface_lies_between_its_sides(element, rng):
    """Of a surface and its counterpart it is that one, of a ball on a plane half the ball."""
    facets = Facets(element, scattered(element, rng, 0.1))
    c = (edges(facets) ** 2).sum(axis=2) / RADIUS
    K = curvatures(facets, c)
    assert common_sagittas(facets, c, -K) == pytest.approx(c, rel=1e-10)
    assert common_sagittas(facets, c, 0.0 * K) == pytest.approx(c / 2, rel=1e-10)
    assert common_sagittas(facets, c, K) == pytest.approx(0.0 * c, abs=1e-10 * c.max())


@pytest.mark.parametrize("element", [TRI3, QUAD4])
def test_needles_and_collapsed_facets_have_a_curvature(element, rng):
    """What they cannot tell is left out, round-off of the sagittas too."""
    x = scattered(element, rng, 1.0)
    for width in (1e-3, 1e-12, 0.0):
        x[..., 1] *= width
        facets = Facets(element, x)
        c = (edges(facets) ** 2).sum(axis=2) / RADIUS
        c *= 1.0 + 1e-13 * rng.standard_normal(c.shape)
        assert np.abs(curvatures(facets, c)).max() < 10.0 / RADIUS


@pytest.mark.mpi
@pytest.mark.parametrize("cell", ["triangle", "quadrilateral", *CELLS])
def test_flat_sides_and_sharp_edges_keep_their_facets(cell):
    """The whole boundary of a block, sheared: no height anywhere."""
    d = 2 if cell in ("triangle", "quadrilateral") else 3
    create = mesh.create_unit_square if d == 2 else mesh.create_unit_cube
    m = create(COMM, *(3, 2, 4)[:d], mesh.CellType[cell])
    m.geometry.x[:, 0] += 0.3 * m.geometry.x[:, 1]
    m.topology.create_connectivity(d - 1, d)
    outside = mesh.exterior_facet_indices(m.topology)
    tags = mesh.meshtags(m, d - 1, outside, np.full(len(outside), 3, dtype=np.int32))
    surface = create_surface(fem.functionspace(m, ("Lagrange", 1, (d,))), tags, 3, "slave")
    found = smooth_normals(surface, surface.X, np.zeros(surface.X.shape, dtype=bool), 40.0)
    assert not found.open.any()
    assert COMM.allreduce(int(found.sharp.sum())) > 0
    c = edge_sagittas(facets_at(surface, surface.X), found, surface.facets)
    assert np.abs(c).max(initial=0.0) < 1e-14


def polygon(n, ends=(-200.0, 200.0)):
    """Return the outer side of a ring of n cells with its nodes on the unit circle."""
    domain, tags = rings(MPI.COMM_SELF, (0.5, 1.0), (3.0, 4.0), (n, n), (1, 1))
    facets = tags.find(2)
    x = mesh.compute_midpoints(domain, 1, facets)
    angle = np.degrees(np.arctan2(x[:, 1], x[:, 0]))
    facets = facets[(angle > ends[0]) & (angle < ends[1])]
    tags = mesh.meshtags(domain, 1, facets, np.full(len(facets), 3, dtype=np.int32))
    return create_surface(fem.functionspace(domain, ("Lagrange", 1, (2,))), tags, 3, "slave")


POLYGONS = {  # of the unit circle: sides, feature angle, sharp, open nodes, ends
    "a curve": (12, 40.0, False, 0),
    "edges": (8, 40.0, True, 0),
    "a curve by a larger angle": (8, 50.0, False, 0),
    "an arc, whose ends are no edges": (24, 40.0, False, 2, (-40.0, 100.0)),
}


@pytest.mark.parametrize("case", POLYGONS)
def test_the_feature_angle_tells_edges_from_curves(case):
    """Facets of a polygon of n sides meet in 360 / n degrees; an arc keeps its curvature."""
    n, angle, sharp, count, *ends = POLYGONS[case]
    surface = polygon(n, *ends)
    found = smooth_normals(surface, surface.X, np.zeros(surface.X.shape, dtype=bool), angle)
    assert (found.sharp == sharp).all() and found.open.sum() == count
    c = edge_sagittas(facets_at(surface, surface.X), found, surface.facets)
    side = 2 * np.sin(np.pi / n)
    assert c == pytest.approx(np.full(c.shape, 0.0 if sharp else side**2), abs=1e-13)


# -- where there is no normal ----------------------------------------------------------------------


def test_opposite_facets_have_no_normal():
    """At the tip of a crack the one-ring of a node cancels: facets count, the audit is told."""
    domain, tags = cracked()
    lips = np.isin(tags.values, (20, 11))
    tags = mesh.meshtags(domain, 1, tags.indices[lips], np.full_like(tags.values[lips], 3))
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    surface = create_surface(V, tags, 3, "slave")
    end = np.abs(surface.X[:, 0] - TIP) < 1e-9
    x, fixed = (surface.X + 3.0) @ rotation((0, 0, 1), 0.7)[:2, :2], np.zeros((len(end), 2), bool)
    found = smooth_normals(surface, x, fixed, 180.0)
    assert np.array_equal(found.sharp, end) and end.sum() == 1 < len(end)
    for n in (found.n, nodal_normals(surface, x)):  # what is left is round-off, no direction
        assert (n[end] == 0.0).all()
        assert np.abs(np.linalg.norm(n[~end], axis=1) - 1.0).max() < 1e-14
    assert np.abs(edge_sagittas(facets_at(surface, x), found, surface.facets)).max() < 1e-14
    normals = smooth_normals(surface, surface.X, fixed, 180.0)
    assert _count_edges(normals, surface.owned).tolist() == [1, 1]

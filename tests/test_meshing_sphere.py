# SPDX-License-Identifier: MIT
"""The quarter of a half ball on a block: volumes, tags, shapes of cells, separation."""

from mpi4py import MPI

import numpy as np
import pytest
from scipy.spatial import cKDTree

import ufl
from dolfinx import fem
from dolfinx.mesh import entities_to_geometry
from dolfinx_mortar import compat, meshing
from dolfinx_mortar.meshing import two_bodies
from tests.cases.integrals import integral

COMM = MPI.COMM_WORLD
CELLS = ["hexahedron", "tetrahedron"]
TAGS = (1, 2, 3, 4, 5, 6)


@pytest.mark.parametrize("cell", CELLS)
def test_volumes_areas_and_flux_of_tagged_parts(cell):
    m = meshing.sphere(COMM, cell=cell, h=0.25, radius=6.0, block=(24.0, 20.0, 8.0), gap=0.25)
    one, n = fem.Constant(m.mesh, 1.0), ufl.FacetNormal(m.mesh)
    dx = ufl.Measure("dx", m.mesh, subdomain_data=m.cell_tags)
    ds = ufl.Measure("ds", m.mesh, subdomain_data=m.facet_tags)
    assert integral(one * dx(m.cell_tags.tag("block"))) == pytest.approx(960.0, rel=1e-12)
    assert integral(one * dx(m.cell_tags.tag("ball"))) == pytest.approx(36.0 * np.pi, rel=4e-2)
    areas = [integral(one * ds(tag)) for tag in TAGS]
    circle = 9.0 * np.pi
    expected = [120.0, circle, 120.0, 18.0 * np.pi, 80.0 + circle, 96.0 + circle]
    assert areas[0] == pytest.approx(120.0, rel=1e-12)
    assert areas == pytest.approx(expected, rel=3e-2)
    assert integral(one * ds) == pytest.approx(sum(areas) + 8.0 * 22.0, rel=1e-12)  # far sides
    flux = [integral(n[2] * ds(tag)) for tag in TAGS]  # outward: bottom down, ball down
    assert flux == pytest.approx([-120.0, areas[1], 120.0, -areas[1], 0.0, 0.0], abs=1e-9)
    assert integral(n[0] * ds(5)) == pytest.approx(-areas[4], rel=1e-12)
    assert integral(n[1] * ds(6)) == pytest.approx(-areas[5], rel=1e-12)


@pytest.mark.parametrize("cell", CELLS)
def test_the_half_is_the_quarter_and_its_image(cell):
    options = {"cell": cell, "h": 0.25, "radius": 6.0, "block": (24.0, 20.0, 8.0), "gap": 0.25}
    quarter, half = (meshing.sphere(COMM, **options, half=half) for half in (False, True))
    sizes, moments = [], []
    for m in (quarter, half):
        one, n = fem.Constant(m.mesh, 1.0), ufl.FacetNormal(m.mesh)
        dx = ufl.Measure("dx", m.mesh, subdomain_data=m.cell_tags)
        ds = ufl.Measure("ds", m.mesh, subdomain_data=m.facet_tags)
        volumes = [integral(one * dx(tag)) for tag in (1, 2)]
        sizes.append([*volumes, *(integral(one * ds(tag)) for tag in TAGS)])
        x = ufl.SpatialCoordinate(m.mesh)
        moments.append([integral(x[0] * dx), integral(n[0] * ds), integral(n[2] * ds(4))])
    expected = 2.0 * np.array(sizes[0])
    expected[2 + TAGS.index(5)] = 0.0
    assert sizes[1] == pytest.approx(expected, rel=1e-9, abs=1e-9)
    assert moments[1] == pytest.approx([0.0, 0.0, 2.0 * moments[0][2]], abs=1e-8)
    cells = [m.mesh.topology.index_map(3).size_global for m in (quarter, half)]
    assert cells[1] == 2 * cells[0]


@pytest.mark.parametrize("cell", CELLS)
def test_bodies_share_no_node_and_both_have_the_contact_point(cell):
    m = meshing.sphere(COMM, cell=cell, h=0.25)
    V = fem.functionspace(m.mesh, ("Lagrange", 1))
    x = V.tabulate_dof_coordinates()[: V.dofmap.index_map.size_local]
    x = np.concatenate(COMM.allgather(x))
    assert np.sum(np.linalg.norm(x, axis=1) < 1e-12) == 2
    distance = np.sort(cKDTree(x).query(x, k=2)[0][:, 1])
    assert distance[1] < 1e-12 < 1e-3 < distance[2]  # only the two contact points coincide
    # round surface: all its nodes are on the sphere, whatever the mapping
    facets = m.facet_tags.find("sphere")
    on = x_of(m, facets)
    assert np.abs(np.linalg.norm(on - [0.0, 0.0, 8.0], axis=-1) - 8.0).max(initial=0.0) < 1e-9


def x_of(m: meshing.TaggedMesh, facets: np.ndarray) -> np.ndarray:
    if len(facets) == 0:  # dolfinx would divide by their number
        return np.empty((0, 3))
    return m.mesh.geometry.x[entities_to_geometry(m.mesh, 2, facets)].reshape(-1, 3)


def test_hexahedra_are_nearly_cubes_everywhere():
    """Volume of a cell over the cube of its mean edge, and growth in proportion to distance."""
    m = meshing.sphere(COMM, h=0.25)
    owned = m.mesh.topology.index_map(3).size_local
    x = m.mesh.geometry.x[compat.cell_nodes(m.mesh)[:owned]]
    edges = np.stack([x[:, 1] - x[:, 0], x[:, 2] - x[:, 0], x[:, 4] - x[:, 0]], axis=1)
    lengths = np.linalg.norm(edges, axis=2)
    shape = np.abs(np.linalg.det(edges)) / lengths.max(axis=1) ** 3
    assert shape.min(initial=1.0) > 0.1
    middle = np.linalg.norm(x.mean(axis=1), axis=1)
    far = middle > 2.0
    assert ((lengths.mean(axis=1) / middle)[far] < 0.4).all()


def test_tags_and_counts_follow_the_element_size():
    cells = [
        meshing.sphere(COMM, h=h).mesh.topology.index_map(3).size_global for h in (0.5, 0.25, 0.125)
    ]
    assert 5.0 < cells[1] / cells[0] < 10.0
    assert 6.0 < cells[2] / cells[1] < 8.5


@pytest.mark.parametrize(
    "options",
    [
        {"cell": "prism"},
        {"h": 0.0},
        {"h": 2.0},
        {"h": "fine"},
        {"h": (0.1, 0.1, 0.1)},
        {"radius": -1.0},
        {"block": (30.0, 10.0)},
        {"block": (30.0, 30.0, np.nan)},
        {"gap": np.inf},
        {"gap": -8.0},
        {"core": 20.0},
        {"core": "1"},
        {"h": 0.2, "core": 0.1},
    ],
)
def test_bad_arguments_are_named(options, monkeypatch):
    monkeypatch.setattr(two_bodies, "distribute", pytest.fail)
    with pytest.raises(ValueError, match=f"^{next(iter(options))} is "):
        meshing.sphere(COMM, **options)


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize(
    ("radius", "block", "gap"),
    [
        (8.0, (30.0, 30.0, 10.0), -7.99),
        (8.0, (30.0, 30.0, 10.0), 8e3),
        (8e-3, (30e-3, 30e-3, 10e-3), 1e-4),
    ],
)
def test_no_gap_and_no_size_swallows_a_tag(cell, radius, block, gap):
    m = meshing.sphere(COMM, cell=cell, h=radius / 16, radius=radius, block=block, gap=gap)
    one, n = fem.Constant(m.mesh, 1.0), ufl.FacetNormal(m.mesh)
    ds = ufl.Measure("ds", m.mesh, subdomain_data=m.facet_tags)
    areas = np.array([integral(one * ds(tag)) for tag in TAGS]) / radius**2
    top, circle = block[0] * block[1] / 4 / radius**2, np.pi / 4
    side = block[0] * block[2] / 2 / radius**2 + circle
    assert areas == pytest.approx([top, circle, top, 2 * circle, side, side], rel=5e-2)
    assert integral(n[2] * ds(4)) / radius**2 == pytest.approx(-areas[1], rel=1e-9)

# SPDX-License-Identifier: MIT
"""Surfaces on any number of ranks: facets, orientation, normals, sums over ranks, bad input."""

from mpi4py import MPI

import numpy as np
import pytest

import basix.ufl
import dolfinx
import dolfinx_mortar as dm
from dolfinx_mortar.geometry.elements import QUAD4
from dolfinx_mortar.geometry.facets import Facets, distortions, facet_normals
from dolfinx_mortar.mortar.surface import (
    _check_shapes,
    accumulate,
    coordinates,
    create_surface,
    facets_at,
    nodal_normals,
)
from tests.cases.meshes import two_blocks
from tests.test_results import TIP, cracked

COMM = MPI.COMM_WORLD
PARTITIONS = ["graph", "shared_facet", "stripes", "bodies", "empty"]
pytestmark = pytest.mark.mpi


def space(mesh, degree=1):
    return dolfinx.fem.functionspace(mesh, ("Lagrange", degree, (mesh.geometry.dim,)))


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
@pytest.mark.parametrize("partition", PARTITIONS)
def test_facets_point_outwards_and_occur_once(cell, partition):
    """The length of each side, and the flux of x through all sides: twice the area."""
    angle = 0.4
    mesh, _, tags = two_blocks(COMM, (7, 2), (5, 2), cell=cell, angle=angle, partition=partition)
    V = space(mesh)
    flux = 0.0
    for tag, length, count in ((1, 1, 7), (2, 1, 5), (3, 1, 7), (4, 1, 5), (5, 2, 4), (6, 2, 4)):
        surface = create_surface(V, tags, tag, "slave")
        x = coordinates(surface, None)[surface.facets]
        size = np.linalg.norm(x[:, 1] - x[:, 0], axis=1)
        normals = facet_normals(facets_at(surface, surface.X))
        assert COMM.allreduce(len(surface.facets)) == count
        assert COMM.allreduce(size.sum()) == pytest.approx(length, abs=1e-13)
        flux += COMM.allreduce((size * (normals * x.mean(axis=1)).sum(axis=1)).sum())
        if tag == 3:
            expected = np.array([-np.sin(angle), np.cos(angle)])
            assert np.abs(normals - expected).max(initial=0) < 1e-13
    assert flux == pytest.approx(4.0, abs=1e-12)


@pytest.mark.parametrize("partition", PARTITIONS)
def test_nodes_are_those_of_the_surface(partition):
    """Every node of the surface has exactly one owner that knows it, also without a facet there."""
    mesh, _, tags = two_blocks(COMM, (8, 2), (5, 2), partition=partition)
    surface = create_surface(space(mesh), tags, 3, "slave")
    assert (np.diff(surface.nodes) > 0).all()
    assert (surface.nodes[: surface.owned] < surface.V.dofmap.index_map.size_local).all()
    owned = np.concatenate(COMM.allgather(surface.X[: surface.owned]))
    owned = owned[np.argsort(owned[:, 0])]
    assert np.abs(owned - np.stack([np.linspace(0, 1, 9), np.zeros(9)], axis=1)).max() < 1e-14
    used = np.unique(surface.facets)
    assert set(range(surface.owned, len(surface.nodes))) <= set(used.tolist())


@pytest.mark.parametrize("partition", PARTITIONS)
def test_sums_over_ranks(partition):
    """Each node gets the number of its facets, whoever integrates them."""
    mesh, _, tags = two_blocks(COMM, (8, 2), (5, 2), partition=partition)
    surface = create_surface(space(mesh), tags, 3, "slave")
    count = np.bincount(surface.facets.ravel(), minlength=len(surface.nodes))
    expected = np.where(np.abs(surface.X[:, 0] - 0.5) > 0.499, 1.0, 2.0)
    assert (accumulate(surface, count) == expected).all()
    both = accumulate(surface, np.stack([count, -count], axis=1))
    assert (both == np.stack([expected, -expected], axis=1)).all()


def test_nodal_normals_of_the_polyline():
    """Unweighted averages: facets of the same length here, but see the next test."""
    points = np.array([[0.0, 0.0], [4.0, 3.0], [7.0, 7.0], [0.0, 9.0]])
    cells = np.array([[0, 1, 3], [1, 2, 3]])
    element = basix.ufl.element("Lagrange", "triangle", 1, shape=(2,))
    mesh = dolfinx.mesh.create_mesh(MPI.COMM_SELF, cells, x=points, e=element)
    mesh.topology.create_entities(1)
    below = dolfinx.mesh.locate_entities_boundary(mesh, 1, lambda x: x[1] < 7.5)
    tags = dolfinx.mesh.meshtags(mesh, 1, below, np.full(len(below), 5, dtype=np.int32))
    surface = create_surface(space(mesh), tags, 5, "slave")
    normals = nodal_normals(surface, surface.X)[np.argsort(surface.X[:, 0])]
    expected = np.array([[3 / 5, -4 / 5], [1 / np.sqrt(2), -1 / np.sqrt(2)], [4 / 5, -3 / 5]])
    assert len(below) == 2
    assert np.abs(normals - expected).max() < 1e-15


@pytest.mark.parametrize("partition", PARTITIONS)
def test_nodal_normals_of_the_deformed_surface(partition):
    """Against a loop over the deformed polyline, with facets of very different length."""

    def move(x):
        return np.stack([0 * x[0], 0.3 * np.sin(5 * x[0])])

    lines = np.array([0, 0.05, 0.3, 0.33, 0.7, 0.8, 1.0])
    mesh, _, tags = two_blocks(COMM, (6, 2), (5, 2), splits_lower=lines, partition=partition)
    V = space(mesh)
    u = dolfinx.fem.Function(V)
    u.interpolate(move)
    surface = create_surface(V, tags, 3, "slave")
    x = coordinates(surface, u)
    line = np.stack([lines, 0.3 * np.sin(5 * lines)], axis=1)
    t = np.diff(line, axis=0)
    n = np.stack([-t[:, 1], t[:, 0]], axis=1) / np.linalg.norm(t, axis=1)[:, None]
    total = np.zeros_like(line)
    total[:-1] += n
    total[1:] += n
    total /= np.linalg.norm(total, axis=1)[:, None]
    where = np.searchsorted(lines, surface.X[:, 0] - 1e-9)
    assert np.abs(x - line[where]).max(initial=0) < 1e-14
    assert np.abs(nodal_normals(surface, x) - total[where]).max(initial=0) < 1e-13


@pytest.mark.parametrize("angle", [0.0, 0.1, 0.4, 0.7, 1.1])
def test_normals_that_cancel_are_zero(angle):
    """At the tip of a crack of which both faces are marked the rest is round-off, no direction."""
    mesh, tags = cracked()
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    mesh.geometry.x[:, :2] = (mesh.geometry.x[:, :2] + [3.0, 7.0]) @ turn.T
    both = np.sort(np.concatenate([tags.find(20), tags.find(11)]))
    tags = dolfinx.mesh.meshtags(mesh, 1, both, np.full(len(both), 3, dtype=np.int32))
    surface = create_surface(space(mesh), tags, 3, "slave")
    tip = np.linalg.norm(surface.X - turn @ [3.0 + TIP, 7.0], axis=1) < 1e-9
    length = np.linalg.norm(nodal_normals(surface, surface.X), axis=1)
    assert (length[tip] == 0.0).all()
    assert np.abs(length[~tip] - 1.0).max(initial=0.0) < 1e-14
    assert COMM.allreduce(int(tip[: surface.owned].sum())) == 1


def test_tags_given_by_one_rank_only():
    """A facet that only one rank has marked, as ghost or as owner, is found by its owner."""
    mesh, _, tags = two_blocks(COMM, (6, 2), (5, 2), partition="shared_facet")
    fdim = 1
    facet_map = mesh.topology.index_map(fdim)
    everywhere = dolfinx.la.vector(facet_map)
    everywhere.array[:] = 0
    everywhere.array[tags.find(3)] = 1
    everywhere.scatter_forward()
    marked = np.flatnonzero(everywhere.array).astype(np.int32)
    ghosts = marked[marked >= facet_map.size_local]
    given = np.zeros(facet_map.size_local + facet_map.num_ghosts)
    given[ghosts] = 1
    # owners leave out the facets that another rank has as a ghost
    shared = dolfinx.la.vector(facet_map)
    shared.array[:] = given
    shared.scatter_reverse(dolfinx.la.InsertMode.add)
    own = marked[marked < facet_map.size_local]
    own = own[shared.array[own] == 0]
    few = np.sort(np.concatenate([own, ghosts])).astype(np.int32)
    sparse = dolfinx.mesh.meshtags(mesh, fdim, few, np.full(len(few), 3, dtype=np.int32))
    V = space(mesh)
    one, other = create_surface(V, tags, 3, "slave"), create_surface(V, sparse, 3, "slave")
    assert (one.entities == other.entities).all()


def interior_tags(mesh):
    """Tag all facets, also those inside."""
    mesh.topology.create_entities(1)
    facets = np.arange(mesh.topology.index_map(1).size_local, dtype=np.int32)
    return dolfinx.mesh.meshtags(mesh, 1, facets, np.full(len(facets), 3, dtype=np.int32))


def test_bad_tags_raise_on_all_ranks():
    mesh, cell_tags, tags = two_blocks(COMM, (4, 2), (3, 2))
    other_mesh, _, other_tags = two_blocks(COMM, (4, 2), (3, 2))
    V = space(mesh)
    with pytest.raises(ValueError, match=r"slave=17 marks no facet.*\[1, 2, 3, 4, 5, 6\]"):
        create_surface(V, tags, 17, "slave")
    with pytest.raises(ValueError, match=r"master=3.*inside the mesh"):
        create_surface(V, interior_tags(mesh), 3, "master")
    with pytest.raises(ValueError, match=r"slave=3.*another mesh"):
        create_surface(V, other_tags, 3, "slave")
    with pytest.raises(ValueError, match="dimension 2"):
        create_surface(V, cell_tags, 1, "slave")
    assert other_mesh is not mesh


def test_bad_spaces():
    mesh, _, tags = two_blocks(COMM, (4, 2), (3, 2))
    P1 = basix.ufl.element("Lagrange", "triangle", 1)
    elements = [
        ("Lagrange", 1),
        ("Lagrange", 3, (2,)),
        ("Lagrange", 1, (3,)),
        ("DG", 1, (2,)),
        ("N1curl", 1),
        basix.ufl.mixed_element([P1, P1]),
    ]
    for element in elements:
        with pytest.raises(ValueError, match="continuous vector Lagrange element of degree 1"):
            create_surface(dolfinx.fem.functionspace(mesh, element), tags, 3, "slave")


def test_cells_not_supported():
    mesh = dolfinx.mesh.create_unit_cube(COMM, 2, 2, 2, dolfinx.mesh.CellType.prism)
    mesh.topology.create_entities(2)
    facets = np.zeros(0, dtype=np.int32)
    tags = dolfinx.mesh.meshtags(mesh, 2, facets, facets)
    with pytest.raises(ValueError, match="prism in 3D are not supported"):
        create_surface(space(mesh), tags, 3, "slave")


def test_coordinates_that_are_not_finite():
    mesh, _, tags = two_blocks(COMM, (4, 2), (3, 2))
    if COMM.rank == 0:
        mesh.geometry.x[:, 0] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        for tag in (3, 4):
            create_surface(space(mesh), tags, tag, "slave")


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
def test_curved_cells_are_refused(cell):
    """A space of degree 1 on cells of degree 2: the surface would be taken for straight."""
    element = basix.ufl.element("Lagrange", cell, 2, shape=(2,))
    kind = getattr(dolfinx.mesh.CellType, cell)
    nodes = basix.create_element(basix.ElementFamily.P, getattr(basix.CellType, cell), 2,
                                 basix.LagrangeVariant.equispaced).points  # fmt: skip
    cells = np.arange(len(nodes), dtype=np.int64)[None]
    first = COMM.rank == 0
    mesh = dolfinx.mesh.create_mesh(
        COMM, cells if first else cells[:0], x=nodes if first else nodes[:0], e=element
    )
    assert mesh.topology.cell_name() == kind.name
    mesh.topology.create_connectivity(1, 2)
    facets = dolfinx.mesh.exterior_facet_indices(mesh.topology)
    tags = dolfinx.mesh.meshtags(mesh, 1, facets, np.full(len(facets), 3, dtype=np.int32))
    with pytest.raises(ValueError, match="cells of the mesh are of degree 2"):
        create_surface(space(mesh), tags, 3, "slave")


@pytest.mark.parametrize("tag", [2**40, -(2**31) - 1, 2**31, True, False, 3.0, "3", None])
def test_tags_that_no_mesh_can_hold(tag):
    mesh, _, tags = two_blocks(COMM, (4, 2), (3, 2))
    with pytest.raises(ValueError, match=f"slave is {tag!r}: "):
        create_surface(space(mesh), tags, tag, "slave")
    with pytest.raises(ValueError, match=f"master is {tag!r}: "):
        dm.Contact(tags, slave=3, master=tag)


def test_tags_of_numpy():
    mesh, _, tags = two_blocks(COMM, (4, 2), (3, 2))
    assert create_surface(space(mesh), tags, np.int64(3), "slave").tag == 3


@pytest.mark.parametrize("cosine", [0.29, 0.31])
def test_how_far_a_facet_may_be_warped(cosine):
    """A decision: corners whose normal has less than 0.3 along the mean normal are refused."""
    # over a square of side 1, corners at +-w have normals (+-2 w, +-2 w, 1)
    w = np.sqrt((1 / cosine**2 - 1) / 8)
    x = np.array([[[0.0, 0, w], [1, 0, -w], [1, 1, w], [0, 1, -w]]])
    facets = Facets(QUAD4, x)
    assert distortions(facets) == pytest.approx([cosine])
    if cosine < 0.3:
        with pytest.raises(ValueError, match="badly warped"):
            _check_shapes(facets, COMM, "slave=3")
    else:
        _check_shapes(facets, COMM, "slave=3")

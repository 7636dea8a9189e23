# SPDX-License-Identifier: MIT
"""Surfaces on any number of ranks: facets, orientation, normals, sums over ranks, bad input."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx
from dolfinx_mortar.geometry.facets import QUAD4, Facets, distortions
from dolfinx_mortar.mortar.surface import (
    _check_shapes,
    coordinates,
    create_surface,
    nodal_normals,
)
from tests.cases import polylines
from tests.cases.meshes import two_blocks
from tests.cases.meshes_3d import two_boxes
from tests.cases.mortar import space
from tests.cases.pressed_blocks import rejected

COMM = MPI.COMM_WORLD
PARTITIONS = ["graph", "shared_facet", "stripes", "bodies", "empty"]
pytestmark = pytest.mark.mpi


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
    total = polylines.nodal_normals(line[::-1], polylines.chain(7))[::-1]
    where = np.searchsorted(lines, surface.X[:, 0] - 1e-9)
    assert np.abs(x - line[where]).max(initial=0) < 1e-14
    assert np.abs(nodal_normals(surface, x) - total[where]).max(initial=0) < 1e-13


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


@pytest.mark.parametrize(
    ("cell", "order", "node", "to", "words"),
    [
        ("hexahedron", 1, (0.5, 0.5, 0), (0.95, 0.95, 0), ["inverted or badly warped"]),
        ("hexahedron", 1, (0.5, 0.5, 0), (0.5, 0.5, 2.5), ["inverted or badly warped"]),
        ("tetrahedron", 1, (0.5, 0.5, 0), (0.5, 0, 0), ["degenerate"]),
        *(
            (cell, 2, (0.25, 0.5, 0), to, ["2 facets are ", "middle node lies", "one around (0."])
            for cell in ("tetrahedron", "hexahedron")
            for to in ((0.38, 0.5, 0), (0.55, 0.5, 0), (0.25, 0.5, 0.6))
        ),
    ],
)
def test_facets_that_are_folded_or_warped(cell, order, node, to, words):
    """By one node beyond the opposite diagonal, far out of the plane, or off its middle."""

    def move(x):
        return np.where((np.linalg.norm(x - node, axis=1) < 1e-9)[:, None], to, x)

    n = (2, 2, 1)
    mesh, _, tags = two_boxes(COMM, n, n, cell=cell, gap=3.0, order=order, transform=move)
    with rejected("slave=3: ", *words):
        create_surface(space(mesh, order), tags, 3, "slave")


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

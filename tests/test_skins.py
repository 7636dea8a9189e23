# SPDX-License-Identifier: MIT
"""Sides that run around edges and corners: partners, thickness, and what they hold."""

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx import fem
from dolfinx_mortar.geometry.facets import facet_normals, points_of
from dolfinx_mortar.mortar.integrals import find_segments
from dolfinx_mortar.mortar.pairing import create_pairing, received_facets
from dolfinx_mortar.mortar.surface import create_surface, facets_at
from tests.cases.meshes import BOTTOM, skins, two_blocks
from tests.cases.meshes_3d import rotation, two_boxes
from tests.cases.two_bodies import SIDES, TwoBodies

COMM = MPI.COMM_WORLD
HEIGHTS = 0.5, 0.75


def create(cell, **options):
    """Return space, tags of whole skins, and up."""
    if cell == "triangle":
        up = np.array([-np.sin(0.4), np.cos(0.4)])
        mesh, cells, facets = two_blocks(
            COMM, (6, 3), (5, 4), angle=0.4, heights=HEIGHTS, **options
        )
    else:
        turn = rotation((1, 2, 3), 0.7)
        up = turn @ [0.0, 0.0, 1.0]
        mesh, cells, facets = two_boxes(
            COMM, (3, 3, 2), (2, 3, 2), cell=cell, turn=turn, heights=HEIGHTS, **options,
        )  # fmt: skip
    V = fem.functionspace(mesh, ("Lagrange", 1, (mesh.geometry.dim,)))
    return V, skins(mesh, cells, facets, keep=()), up


@pytest.mark.mpi
@pytest.mark.parametrize("gap", [0.1, -0.1])
@pytest.mark.parametrize("cell", ["triangle", "tetrahedron", "hexahedron"])
def test_partners_face_each_other_from_outside(cell, gap):
    """Whole skins have the partners of the two sides between the bodies, and no others."""
    V, tags, up = create(cell, gap=gap)
    for slave, master in (SIDES, SIDES[::-1]):
        sides = (create_surface(V, tags, tag, "side") for tag in (slave, master))
        pairing = create_pairing(*sides, None)
        points, _ = find_segments(pairing, None)
        facets = facets_at(pairing.slave, pairing.slave.X)
        n = facet_normals(facets)[points.slave]
        across = np.abs(n @ up) > 0.5
        x_m = points_of(received_facets(pairing, None), points.master, points.xi_m)
        along = ((x_m - points_of(facets, points.slave, points.xi_s)) * n).sum(axis=1)
        assert np.abs(along[across] - gap).max(initial=0) < 1e-12
        # in the plane averaged normals fan out at the edges, one way or the other
        fan = 2 * abs(gap) if cell == "triangle" else 1e-12
        assert COMM.allreduce(points.weight[across].sum()) == pytest.approx(1.0, abs=fan)
        # flanks that overlap look through both bodies, one thickness deep
        assert not (~across).any()


@pytest.mark.mpi
@pytest.mark.parametrize("cells", [2, 4])
def test_clamped_bodies_are_held(cells):
    """What edges seem to take from the contact is no part of what clamps hold."""
    sizes = {"n_lower": (3, 3, 2), "n_upper": (cells, cells, 2), "upper": (0.2, 0.8, 0.2, 0.8)}
    case = TwoBodies("tetrahedron", whole=True, **sizes)
    audit = case.problem([case.interface(swap=True)]).audit()
    assert not audit.held_by_contact
    assert audit.interfaces[0].least_gap == audit.interfaces[0].largest_gap == 0.0


@pytest.mark.mpi
def test_a_tall_block_stands_on_a_plate():
    """It cannot tilt: edges are no facets of a curved side, along which a body may slide."""
    case = TwoBodies(whole=True, n_lower=(4, 2), n_upper=(3, 6), heights=(1.0, 4.0))
    V = case.V.sub(0)
    corner = fem.locate_dofs_geometrical(
        (V, V.collapse()[0]), lambda x: np.isclose(x[0], 0.0) & np.isclose(x[1], 4.0)
    )
    slide = fem.dirichletbc(fem.Function(V.collapse()[0]), corner, V)
    assert case.problem(bcs=[case.held(BOTTOM), slide]).audit().held_by_contact

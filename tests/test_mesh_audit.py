# SPDX-License-Identifier: MIT
"""The audit of meshes: which are refused, and that sound ones are not, whatever their numbering."""

import numpy as np
import pytest

import basix.ufl
import dolfinx_mortar as dm
from dolfinx import mesh
from dolfinx_mortar.audit import mesh_audit
from dolfinx_mortar.audit.mesh_audit import check_mesh
from tests.cases.meshes import two_blocks
from tests.cases.meshes_3d import rotation, two_boxes
from tests.cases.pressed_blocks import COMM, PressedBlocks, rejected

KINDS = ["triangle", "quadrilateral", "tetrahedron", "hexahedron"]
PLANE = ["triangle", "quadrilateral"]


def create(kind, n=4, **options):
    """Return two boxes of side 1, on each other, of n cells along each edge."""
    if kind in PLANE:
        return two_blocks(COMM, (n, n), (n, n), cell=kind, **options)[0]
    return two_boxes(COMM, (n,) * 3, (n,) * 3, cell=kind, **options)[0]


def move(domain, point, target):
    """Move the mesh's node at a point, on every rank that has it."""
    d = domain.geometry.dim
    x = domain.geometry.x
    x[np.abs(x[:, :d] - point).max(axis=1) < 1e-6, :d] = target


@pytest.mark.mpi
@pytest.mark.parametrize("kind", KINDS)
def test_sound_meshes_pass(kind):
    for partition in ("graph", "shared_facet", "bodies"):
        check_mesh(create(kind, partition=partition))


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize("kind", KINDS)
def test_units_and_places_do_not_matter(kind, scale):
    """Mirrored, far from the origin, flat cells: all are sound."""
    d = 2 if kind in PLANE else 3
    stretch = np.r_[-1.0, 1e-3, 1.0][:d]
    check_mesh(create(kind, transform=lambda x: scale * (1e3 + stretch * x)))


# -- inverted and folded


@pytest.mark.mpi
@pytest.mark.parametrize("kind", KINDS)
def test_a_node_moved_through_its_cells(kind):
    """Node (1/4, .., -1/4) of the lower box, inside, or at its surface z = -1."""
    domain = create(kind, partition="stripes" if kind in PLANE else "graph")
    d = domain.geometry.dim
    start = np.full(d, 0.25)
    start[-1] = -0.25
    move(domain, start, start + 0.6 * np.eye(d)[0])
    with rejected(
        "mesh: ",
        f" of {2 * 4**d * {'triangle': 2, 'tetrahedron': 6}.get(kind, 1)}",
        "inverted",
        "around (",
        "no node was moved",
    ):
        check_mesh(domain)


@pytest.mark.mpi
def test_nodes_around_the_cell_instead_of_a_tensor_product():
    """The order of most other programs is the usual mistake."""
    for kind, around in (("quadrilateral", [0, 1, 3, 2]), ("hexahedron", [0, 1, 3, 2, 4, 5, 7, 6])):
        with rejected("mesh: 1 of 1 cells are inverted: the Jacobian changes", "tensor product"):
            check_mesh(one_cell(kind, 1, order=around))


@pytest.mark.mpi
def test_the_first_step_asks_for_the_audit():
    case = PressedBlocks(n_lower=(4, 4))
    problem = case.problem()
    move(case.mesh, [0.5, -0.5], [0.95, -0.5])
    with rejected("inverted or folded"):
        dm.newton(problem)


# -- collapsed


@pytest.mark.mpi
@pytest.mark.parametrize("kind", KINDS)
def test_a_collapsed_body_is_named(kind):
    """The lower box has no height; turned, its Jacobians are round-off."""
    for angle in (0.0, 0.3):
        check_collapsed(kind, angle)


def check_collapsed(kind, angle):
    turn = rotation([0.0, 0.0, 1.0] if kind in PLANE else [1.0, 1.0, 0.0], angle)
    d = 2 if kind in PLANE else 3

    def flatten(x):
        x = x.copy()
        x[: len(x) // 2, -1] = 0.0
        x += 0.03 * np.sin(7.0 * x[:, ::-1] + 1.0) * (np.arange(d) < d - 1)
        return x @ turn[:d, :d].T + 0.7

    domain = create(kind, transform=flatten)
    cells = 4**d * {"triangle": 2, "tetrahedron": 6}.get(kind, 1)
    with rejected(f"mesh: {cells} of {2 * cells} cells have collapsed", "without volume"):
        check_mesh(domain)


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_what_has_collapsed_does_not_hang_on_the_limit(factor, monkeypatch):
    monkeypatch.setattr(mesh_audit, "ROUND_OFF", factor * mesh_audit.ROUND_OFF)
    test_a_collapsed_body_is_named("tetrahedron")
    test_units_and_places_do_not_matter("tetrahedron", 1.0)


def test_a_quadrilateral_may_be_a_triangle():
    """Two nodes at one place: the Jacobian is 0 there, and has one sign elsewhere."""
    domain = mesh.create_unit_square(COMM, 4, 4, mesh.CellType.quadrilateral)
    move(domain, [1.0, 1.0], [0.75, 1.0])
    check_mesh(domain)


# -- others


@pytest.mark.mpi
def test_coordinates_that_are_none():
    for value in (np.nan, np.inf):
        domain = mesh.create_unit_square(COMM, 4, 4)
        move(domain, [0.0, 0.0], [0.0, value])
        with rejected("mesh: 2 of 32 cells have coordinates", "NaN or infinite", "check the mesh"):
            check_mesh(domain)


def one_cell(kind, degree, at=None, to=None, order=None):
    """Return a mesh of one cell, one of its nodes moved, or its nodes in another order."""
    cell, variant = basix.CellType[kind], basix.LagrangeVariant.equispaced
    points = basix.create_element(basix.ElementFamily.P, cell, degree, variant).points.copy()
    if at is not None:
        points[np.abs(points - at).max(axis=1) < 1e-9] = to
    first, d = COMM.rank == 0, points.shape[1]
    nodes = np.arange(len(points)) if order is None else np.array(order)
    cells = nodes[None] if first else np.empty((0, len(points)), dtype=np.int64)
    element = basix.ufl.element("Lagrange", kind, degree, shape=(d,))
    return mesh.create_mesh(COMM, cells, x=points if first else np.empty((0, d)), e=element)


@pytest.mark.parametrize("kind", KINDS)
def test_geometry_of_degree_two(kind):
    """Sound; beyond, it is refused."""
    d = 2 if kind in PLANE else 3
    check_mesh(one_cell(kind, 2))
    check_mesh(one_cell(kind, 2, [0.5, 0.0, 0.0][:d], [0.5, -0.1, 0.0][:d]))
    with rejected("mesh", "degree 3", "degree 1 or 2"):
        check_mesh(one_cell(kind, 3))


@pytest.mark.parametrize("kind", KINDS)
def test_a_middle_node_far_off_the_middle(kind):
    """The cell is folded."""
    d = 2 if kind in PLANE else 3
    check_mesh(one_cell(kind, 2, [0.5, 0.0, 0.0][:d], [0.3, 0.0, 0.0][:d]))
    with rejected("mesh: 1 of 1 cells are inverted", "changes sign"):
        check_mesh(one_cell(kind, 2, [0.5, 0.0, 0.0][:d], [0.5, 0.9, 0.0][:d]))

# SPDX-License-Identifier: MIT
"""Mortar operators in 3D as PETSc matrices, on any number of ranks; ties and bad input."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx
import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.geometry.facets import facet_normals
from dolfinx_mortar.mortar import duals
from dolfinx_mortar.mortar.assembly import assemble_mortar
from dolfinx_mortar.mortar.duals import default_keep, node_weights
from dolfinx_mortar.mortar.integrals import find_segments
from dolfinx_mortar.mortar.pairing import create_pairing
from dolfinx_mortar.mortar.surface import accumulate, create_surface, facets_at, nodal_normals
from dolfinx_mortar.newton_method.contacts import Contacts
from dolfinx_mortar.report import certificate
from dolfinx_mortar.steps import step_end
from tests.cases.meshes_3d import (
    BACK,
    BOTTOM,
    BOTTOM_OF_UPPER,
    FRONT,
    LEFT,
    RIGHT,
    TOP,
    TOP_OF_LOWER,
    rotation,
    two_boxes,
)

COMM = MPI.COMM_WORLD
EXACT = 1e-12
TILTED = rotation((1.0, 2.0, 0.5), 0.7)
CELLS = pytest.mark.parametrize("cell", ["tetrahedron", "hexahedron"])
SIDES = pytest.mark.parametrize(
    "sides", [(TOP_OF_LOWER, BOTTOM_OF_UPPER), (BOTTOM_OF_UPPER, TOP_OF_LOWER)]
)
PARTITIONS = pytest.mark.parametrize(
    "partition", ["graph", "shared_facet", "stripes", "bodies", "empty"]
)


def space(mesh, degree=1):
    return fem.functionspace(mesh, ("Lagrange", degree, (3,)))


def owned_coordinates(V):
    return V.tabulate_dof_coordinates()[: V.dofmap.index_map.size_local]


def field(A, values):
    """Return a vector that A can be applied to."""
    v = A.createVecRight()
    v.array[:] = np.ravel(values)
    return v


def largest(values):
    return maximum(COMM, np.abs(values).max(initial=0.0))[0]


@pytest.mark.mpi
@PARTITIONS
@SIDES
@CELLS
@pytest.mark.parametrize("degree", [1, 2])
def test_inclined_flat_interface(partition, sides, cell, degree):
    """Row sums, linear fields, diagonal D, gap and covered area across an open flat gap."""
    gap = 0.1
    mesh, _, tags = two_boxes(
        COMM, (3, 4, 2), (4, 3, 2), cell=cell, turn=TILTED, jitter=0.4, gap=gap,
        upper=(-0.3, 0.85, 0.2, 1.4), partition=partition,
    )  # fmt: skip
    V = space(mesh, degree)
    mortar = assemble_mortar(V, tags, slave=sides[0], master=sides[1])
    x, ones = (
        field(mortar.D, owned_coordinates(V)),
        field(mortar.D, np.ones(V.dofmap.index_map.size_local * 3)),
    )
    row, total = mortar.D * ones, mortar.M * ones
    assert largest((row - total).array) < EXACT
    normal = TILTED[:, 2] if sides[0] == TOP_OF_LOWER else -TILTED[:, 2]
    offset = (mortar.M * x - mortar.D * x).array.reshape(-1, 3)
    weight = row.array[::3]
    assert largest(offset - gap * weight[:, None] * normal) < EXACT
    assert largest(mortar.gap.array - gap * weight) < EXACT
    assert COMM.allreduce(weight.sum()) == pytest.approx(0.85 * 0.8, abs=EXACT)
    assert (weight > 0).all()


@pytest.mark.mpi
@CELLS
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("n", [1, 2])
def test_multipliers_push_wherever_the_master_ends(n, cell, degree):
    """Row sums of D, the forces of unit pressures, are positive, and add up to the covered area.

    A small master in far corners of facets, where functions of second order are negative.
    """
    mesh, _, tags = two_boxes(COMM, (n, n, 1), (2, 2, 1), cell=cell, gap=0.5)
    V = space(mesh, degree)
    u, rng = fem.Function(V), np.random.default_rng(7)
    for _ in range(50):
        size = rng.uniform(0.1, 0.6, 2)
        corner = rng.uniform(0.0, 1.0 - size)

        def move(x, corner=corner, size=size):
            way = corner[:, None] + (size - 1.0)[:, None] * x[:2]
            return np.where(x[2] > 0.25, np.vstack([way, np.zeros_like(x[2])]), 0.0)

        u.interpolate(move)
        mortar = assemble_mortar(V, tags, slave=TOP_OF_LOWER, master=BOTTOM_OF_UPPER, u=u)
        force = (mortar.D * field(mortar.D, np.ones(len(owned_coordinates(V)) * 3))).array[::3]
        assert (force > 0).all()
        assert COMM.allreduce(force.sum()) == pytest.approx(size.prod(), abs=EXACT)


class Corners:
    """A block of second order in far corners of slave facets, pressed by 25 N."""

    def __init__(self, friction=None, geometry="updated"):
        """Make the problem, and solve it."""
        mesh, _, tags = two_boxes(
            MPI.COMM_SELF, (2, 2, 1), (2, 2, 1), cell="hexahedron", upper=(0.25, 0.75, 0.25, 0.75)
        )
        V = space(mesh, 2)
        solid, top = dm.Solid(fem.Function(V), dm.Elastic(E=210e3, nu=0.0)), tags.find(TOP)
        foot = fem.locate_dofs_topological(V, 2, tags.find(BOTTOM))
        bcs = [fem.dirichletbc(np.zeros(3), foot, V)]
        if friction is None:
            guides = ((V.sub(i), fem.locate_dofs_topological(V.sub(i), 2, top)) for i in (0, 1))
            bcs += [fem.dirichletbc(0.0, dofs, part) for part, dofs in guides]
        self.t = fem.Constant(mesh, np.array([0.0, 0.0, -100.0]))
        ds = ufl.Measure("ds", mesh, subdomain_data=tags)
        loads = ufl.inner(self.t, ufl.TestFunction(V)) * ds(TOP)
        self.contact = dm.Contact(
            tags, slave=TOP_OF_LOWER, master=BOTTOM_OF_UPPER, friction=friction
        )
        self.problem = dm.ContactProblem(
            solid, [self.contact], bcs=bcs, loads=loads, geometry=geometry
        )
        self.report = dm.newton(self.problem)


@pytest.mark.parametrize(
    ("friction", "load"),
    [(None, (0.0, 0.0, 20.0)), (0.2, (21.0, 0.0, -100.0))],
    ids=["pull", "push"],
)
def test_what_nothing_holds_leaves(friction, load):
    """Pulled up, or pushed by 5 % more than mu N."""
    case = Corners(friction)
    assert case.contact.force[2] == pytest.approx(-25.0, rel=1e-5)
    assert case.report.certificate.sign < EXACT
    case.t.value[:] = load
    with pytest.raises(dm.NewtonNotConverged):
        dm.newton(case.problem)


def test_contacts_that_pull_are_told(monkeypatch):
    """Multipliers in the far corners, whose row sums are negative where nothing asks for them."""
    with monkeypatch.context() as unasked:
        unasked.setattr(duals, "any_rank", lambda *_: [False])
        case = Corners(geometry="reference")
    (link,) = case.problem.system.links
    corners = np.isclose(np.abs(case.problem.X[:, :2] - 0.5), 0.5).all(axis=1)
    on = corners & np.isin(np.arange(len(corners)), link.nodes[link.coupling.kept[:, 0]])
    assert on.sum() == 4
    pull = certificate.find_pull(case.problem, Contacts(on, on.astype(float)))
    assert pull > 0.9
    forces = link.coupling.weight * on[link.nodes, None] * link.coupling.normals
    assert certificate._pull_of_patches(link, forces) > 0.5
    monkeypatch.setattr(step_end, "find_pull", lambda *_: pull)
    report = dm.newton(case.problem)
    assert report.certificate.sign == pull
    assert any(note.startswith("contacts pull, by ") for note in report.notes)


def curved(x):
    """Bend both bodies, the upper one away from the lower."""
    z = x[:, 2] + 0.2 * x[:, 0] ** 2 - 0.15 * x[:, 1] ** 2 + 0.1 * x[:, 0] * x[:, 1]
    away = np.where(x[:, 2] > 0.05, 0.1 * x[:, 0] ** 2, 0)
    return np.column_stack([x[:, :2], z + away])


def forms(comm, partition, sides, cell):
    """Return numbers that describe D, M, N and the gap independently of numbers and ranks."""
    mesh, _, tags = two_boxes(
        comm, (3, 4, 2), (4, 3, 2), cell=cell, jitter=0.4, gap=0.1, transform=curved,
        upper=(-0.3, 0.85, 0.2, 1.4), partition=partition,
    )  # fmt: skip
    V = space(mesh)
    mortar = assemble_mortar(V, tags, slave=sides[0], master=sides[1])
    X = owned_coordinates(V)
    f = field(mortar.D, np.cos(X @ np.array([[1.0, 0.2, 0.3], [0.1, 2, 0], [1, 1, 1]])))
    own = X[mortar.nodes - V.dofmap.index_map.local_range[0]]
    g, h = mortar.D.createVecLeft(), mortar.gap.duplicate()
    g.array[:], h.array[:] = np.exp(own).ravel(), np.sin(own.sum(axis=1))
    return np.array(
        [
            g.dot(mortar.D * f),
            g.dot(mortar.M * f),
            g.dot(mortar.N * h),
            h.dot(mortar.gap),
            float(mortar.gap.getSize()),
        ]
    )


@pytest.mark.mpi
@PARTITIONS
@SIDES
@CELLS
def test_same_operators_on_any_number_of_ranks(partition, sides, cell):
    alone = forms(MPI.COMM_SELF, "graph", sides, cell)
    together = forms(COMM, partition, sides, cell)
    assert np.abs(together - alone).max() < 1e-12


def test_normals_of_a_box():
    """Facets point outwards; nodal normals at edges and corners are the means of the sides'."""
    for cell in ("tetrahedron", "hexahedron"):
        mesh, _, tags = two_boxes(COMM, (2, 2, 2), (1, 1, 1), cell=cell)
        V = space(mesh)
        for tag, axis, sign in ((LEFT, 0, -1), (RIGHT, 0, 1), (FRONT, 1, -1), (BACK, 1, 1)):
            surface = create_surface(V, tags, tag, "slave")
            expected = sign * np.eye(3)[axis]
            assert (
                np.abs(facet_normals(facets_at(surface, surface.X)) - expected).max(initial=0)
                < 1e-14
            )
            assert np.abs(nodal_normals(surface, surface.X) - expected).max(initial=0) < 1e-14
        lower = dolfinx.mesh.exterior_facet_indices(mesh.topology)
        everything = dolfinx.mesh.meshtags(mesh, 2, lower, np.full(len(lower), 9, dtype=np.int32))
        surface = create_surface(V, everything, 9, "slave")
        n_f = facet_normals(facets_at(surface, surface.X))
        assert np.abs(np.abs(n_f).max(axis=1, initial=1) - 1).max(initial=0) < 1e-14


@pytest.mark.mpi
@SIDES
@CELLS
def test_tied_linear_field(sides, cell):
    """A linear field with shear passes through a jittered, inclined interface exactly."""
    mesh, _, facets = two_boxes(COMM, (2, 3, 2), (3, 2, 2), cell=cell, turn=TILTED, jitter=0.4)
    V = space(mesh)
    strain = np.array([[1e-3, 4e-4, 0], [-2e-4, 2e-3, 3e-4], [5e-4, 1e-4, -1e-3]])
    exact, u = fem.Function(V), fem.Function(V)
    exact.interpolate(lambda x: strain @ x[:3])
    E, nu = 1000.0, 0.3
    symmetric = (strain + strain.T) / 2
    stress = E / (1 + nu) * (symmetric + nu / (1 - 2 * nu) * np.trace(strain) * np.eye(3))
    n, v = ufl.FacetNormal(mesh), ufl.TestFunction(V)
    ds = ufl.Measure("ds", mesh, subdomain_data=facets)
    loads = ufl.dot(ufl.dot(fem.Constant(mesh, stress), n), v) * ds((LEFT, RIGHT, FRONT, BACK))
    dofs = [fem.locate_dofs_topological(V, 2, facets.find(tag)) for tag in (BOTTOM, TOP)]
    bc = fem.dirichletbc(exact, np.unique(np.concatenate(dofs)))
    tie = dm.Tie(facets, slave=sides[0], master=sides[1])
    problem = dm.ContactProblem(dm.Solid(u, dm.Elastic(E, nu)), [tie], bcs=[bc], loads=loads)
    report = dm.newton(problem, rtol=1e-11)
    assert largest(u.x.array - exact.x.array) < 1e-10 * largest(exact.x.array)
    assert report.certificate.force_balance < 1e-10


# -- bad input -------------------------------------------------------------------------------------


def one_hexahedron_moved(node, to):
    """Return the transformation that moves a node of the interface."""

    def transform(x):
        x = x.copy()
        x[np.linalg.norm(x - node, axis=1) < 1e-9] = to
        return x

    return transform


@pytest.mark.mpi
@pytest.mark.parametrize("to", [(0.95, 0.95, 0.0), (0.5, 0.5, 2.5)])
def test_folded_and_warped_facets(to):
    """A node beyond the opposite diagonal, or far out of the plane."""
    mesh, _, tags = two_boxes(
        COMM, (2, 2, 1), (2, 2, 1), cell="hexahedron", gap=3.0,
        transform=one_hexahedron_moved((0.5, 0.5, 0.0), to),
    )  # fmt: skip
    with pytest.raises(ValueError, match=r"slave=3: .* inverted or badly warped"):
        create_surface(space(mesh), tags, 3, "slave")


@pytest.mark.mpi
@CELLS
@pytest.mark.parametrize("to", [(0.38, 0.5, 0.0), (0.55, 0.5, 0.0), (0.25, 0.5, 0.6)])
def test_middle_nodes_off_the_middle(cell, to):
    """Near an end of its edge, beyond it, or far above it: the two facets beside it are counted."""
    mesh, _, tags = two_boxes(
        COMM, (2, 2, 1), (2, 2, 1), cell=cell, gap=3.0, order=2,
        transform=one_hexahedron_moved((0.25, 0.5, 0.0), to),
    )  # fmt: skip
    words = r"slave=3: 2 facets are .* or its middle node lies .*, such as the one around \(0\.\d"
    with pytest.raises(ValueError, match=words):
        create_surface(space(mesh, 2), tags, 3, "slave")


@pytest.mark.mpi
def test_degenerate_triangles():
    mesh, _, tags = two_boxes(
        COMM, (2, 2, 1), (2, 2, 1), gap=3.0,
        transform=one_hexahedron_moved((0.5, 0.5, 0.0), (0.5, 0.0, 0.0)),
    )  # fmt: skip
    with pytest.raises(ValueError, match=r"slave=3: .* degenerate"):
        create_surface(space(mesh), tags, 3, "slave")


@pytest.mark.mpi
def test_tags_of_another_dimension():
    mesh, cells, _ = two_boxes(COMM)
    with pytest.raises(ValueError, match="dimension 3; facets have dimension 2"):
        create_surface(space(mesh), cells, 1, "slave")


@pytest.mark.mpi
@pytest.mark.parametrize("whole", [True, False])
def test_closed_surface_in_contact_with_itself(whole):
    """Parts of the surface of one body, all of it or three faces, meet through the body only."""
    cube = dolfinx.mesh.create_unit_cube(COMM, 4, 4, 4)
    cube.topology.create_connectivity(2, 3)
    facets = dolfinx.mesh.exterior_facet_indices(cube.topology)
    x, _, z = dolfinx.mesh.compute_midpoints(cube, 2, facets).T
    marks = np.where(x < (0.4 if whole else 1e-9), 1, 2)
    some = whole | (np.abs(x - 0.5) > 0.499) | (z < 1e-9)
    tags = dolfinx.mesh.meshtags(cube, 2, facets, np.where(some, marks, 3).astype(np.int32))
    V = space(cube)
    bottom = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[2], 0))
    bc = fem.dirichletbc(np.zeros(3), bottom, V)
    solid = dm.Solid(fem.Function(V), dm.Elastic(1.0, 0.3))
    problem = dm.ContactProblem(solid, [dm.Contact(tags, slave=1, master=2)], bcs=[bc])
    with pytest.raises(ValueError, match="parts of one surface"):
        dm.newton(problem)


@pytest.mark.mpi
@pytest.mark.parametrize("cell", ["tetrahedron", "hexahedron"])
def test_vertices_of_triangles_are_kept_with_the_middles_beside_them_only(cell):
    """Their own functions integrate to nothing: alone they could carry no multiplier."""
    mesh, _, tags = two_boxes(COMM, (2, 2, 1), (3, 3, 1), cell=cell)
    V = space(mesh, 2)
    slave = create_surface(V, tags, TOP_OF_LOWER, "slave")
    master = create_surface(V, tags, BOTTOM_OF_UPPER, "master")
    pairing = create_pairing(V, slave, master, None, moving=False)
    points, _ = find_segments(pairing, None)
    weights = node_weights(pairing, points)
    count = np.zeros(len(slave.nodes))
    count[slave.facets[:, list(slave.element.vertices)]] = 1.0
    vertices = accumulate(slave, count) > 0
    kept = default_keep(pairing, points, *weights, vertices)
    expected = vertices if cell == "hexahedron" else np.zeros_like(vertices)
    assert (kept == expected).all()
    assert (default_keep(pairing, points, *weights, ~vertices) == ~vertices).all()
    assert default_keep(pairing, points, *weights).all()

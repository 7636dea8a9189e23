# SPDX-License-Identifier: MIT
"""Mortar operators as PETSc matrices on any number of ranks, in the plane and in space."""

from itertools import product

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx
import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from dolfinx_mortar.mortar import duals
from dolfinx_mortar.mortar.assembly import assemble_mortar
from dolfinx_mortar.mortar.duals import default_keep, node_weights
from dolfinx_mortar.mortar.integrals import find_segments
from dolfinx_mortar.mortar.pairing import outside_margin
from dolfinx_mortar.mortar.surface import accumulate, create_surface
from dolfinx_mortar.problem.contacts import Contacts
from dolfinx_mortar.report import certificate
from tests.cases.meshes import BOTTOM, BOTTOM_OF_UPPER, TOP, TOP_OF_LOWER, two_blocks
from tests.cases.meshes_3d import rotation, two_boxes
from tests.cases.mortar import (
    bend,
    curved,
    largest,
    owned_coordinates,
    pair_up,
    row_sums,
    space,
    vector_of,
)
from tests.cases.pressed_blocks import PressedBlocks
from tests.cases.solid import hold, plane
from tests.cases.two_bodies import TwoBodies, create_problem

COMM = MPI.COMM_WORLD
PARTITIONS = ["graph", "shared_facet", "stripes", "bodies", "empty"]
SIDES = [(3, 4), (4, 3)]
CELLS = ["triangle", "quadrilateral", "tetrahedron", "hexahedron"]
EXACT = 1e-12
UPPER = (-0.3, 0.85, 0.2, 1.4)
pytestmark = pytest.mark.mpi


@pytest.mark.parametrize(
    ("cell", "degree", "partition", "sides"),
    [
        (*kind, PARTITIONS[i % 5], SIDES[i % 3 % 2])
        for i, kind in enumerate([*product(CELLS, (1, 2))] * 2)
    ],
)
def test_inclined_flat_interface(cell, degree, partition, sides):
    """Row sums, linear fields, diagonal D, gap and covered area across an open flat gap."""
    options = {"cell": cell, "gap": 0.1, "jitter": 0.4, "partition": partition}
    if cell in CELLS[:2]:
        turn, area = rotation((0, 0, 1), 0.3)[:2, :2], 0.75
        mesh, _, tags = two_blocks(COMM, (7, 2), (5, 2), x_upper=(-0.3, 0.75), angle=0.3, **options)
    else:
        turn, area = rotation((1.0, 2.0, 0.5), 0.7), 0.85 * 0.8
        mesh, _, tags = two_boxes(COMM, (3, 4, 2), (4, 3, 2), upper=UPPER, turn=turn, **options)
    V, d = space(mesh, degree), len(turn)
    mortar = assemble_mortar(V, tags, slave=sides[0], master=sides[1])
    m = mortar.gap.getSize()
    assert m > 4 and mortar.gap.getLocalSize() == len(mortar.nodes)
    assert mortar.D.getSize() == mortar.M.getSize() == (d * m, d * V.dofmap.index_map.size_global)
    first, last = V.dofmap.index_map.local_range
    assert ((mortar.nodes >= first) & (mortar.nodes < last)).all()

    weights, of_M = row_sums(mortar)
    assert largest(weights - of_M) < EXACT and (weights > 0.0).all()
    assert COMM.allreduce(weights.sum()) == pytest.approx(d * area, abs=EXACT)
    x = vector_of(mortar.D, owned_coordinates(V))
    normal = (1 if sides[0] == 3 else -1) * turn[:, -1]
    jump = (mortar.M * x - mortar.D * x).array.reshape(-1, d)
    assert largest(jump - 0.1 * weights * normal) < EXACT
    assert largest(mortar.gap.array - 0.1 * weights[:, 0]) < EXACT
    n = (mortar.N * vector_of(mortar.N, 1.0)).array.reshape(-1, d)
    assert largest(n - normal) < EXACT
    if degree == 2:
        return
    start, columns, values = mortar.D.getValuesCSR()
    rows = np.repeat(np.arange(len(start) - 1), np.diff(start))
    kept = np.concatenate(COMM.allgather(mortar.nodes))
    diagonal = columns == d * mortar.nodes[rows // d] + rows % d
    assert np.count_nonzero(diagonal & (values > 0)) == d * len(mortar.nodes)
    assert (values[np.isin(columns // d, kept) & ~diagonal] == 0).all()


def forms(comm, cell, partition, sides):
    """Return numbers that describe D, M, N and the gap independently of numbers and ranks."""
    options = {"cell": cell, "gap": 0.1, "partition": partition}
    if cell == "triangle":
        ends = {"x_lower": (-1, 1.1), "x_upper": (-1.2, 0.9)}
        bodies = two_blocks(comm, (13, 2), (9, 2), jitter=0.5, transform=bend, **ends, **options)
    else:
        options |= {"jitter": 0.4, "transform": curved, "upper": UPPER}
        bodies = two_boxes(comm, (3, 4, 2), (4, 3, 2), **options)
    V = space(bodies[0])
    X, u = owned_coordinates(V), fem.Function(V)
    d = X.shape[1]
    u.interpolate(lambda x: 0.02 * np.stack([np.sin(3 * x[0]), np.cos(2 * x[0]) * x[1], x[2]])[:d])
    mortar = assemble_mortar(V, bodies[2], slave=sides[0], master=sides[1], u=u)
    f = vector_of(mortar.D, np.cos(X @ np.array([[1.0, 0.2, 0.3], [0.1, 2, 0], [1, 1, 1]])[:d, :d]))
    at = X[mortar.nodes - V.dofmap.index_map.local_range[0]]
    g, normal = mortar.D.createVecLeft(), mortar.N * vector_of(mortar.N, np.sin(at.sum(axis=1)))
    g.array[:] = np.exp(at).ravel()
    products = [g.dot(v) for v in (mortar.D * f, mortar.M * f, normal)]
    return np.array([*products, mortar.gap.norm(), float(mortar.gap.getSize())])


@pytest.mark.parametrize(
    ("cell", "partition", "sides"),
    [
        (cell, partition, SIDES[(i + k) % 2])
        for i, cell in enumerate(("triangle", "tetrahedron", "hexahedron"))
        for k, partition in enumerate(PARTITIONS)
    ],
)
def test_same_operators_on_any_number_of_ranks(cell, partition, sides):
    alone = forms(MPI.COMM_SELF, cell, "graph", sides)
    assert np.abs(forms(COMM, cell, partition, sides) - alone).max() < EXACT and alone[-1] >= 8


@pytest.mark.parametrize("coverage", [1.0, 0.051, 0.049, 1e-6])
@pytest.mark.parametrize("sides", SIDES)
def test_coverage_decides_and_constants_stay(coverage, sides):
    """The last slave facet is covered to `coverage`: its end node is kept above 5 % only."""
    end = 0.75 + 0.25 * coverage
    long, short = [0, 0.25, 0.5, 0.75, 1.0], [-0.1, 0.3, end]
    lower, upper = (long, short) if sides == (3, 4) else (short, long)
    mesh, _, tags = two_blocks(COMM, splits_lower=lower, splits_upper=upper, partition="stripes")
    V = space(mesh)
    mortar = assemble_mortar(V, tags, slave=sides[0], master=sides[1])
    tip = coverage**2  # int N_2 over the covered part, relative to the whole
    assert mortar.gap.getSize() == (5 if tip > 0.05 else 4)
    of_D, of_M = row_sums(mortar)
    assert largest(of_D - of_M) < 1e-14
    assert COMM.allreduce(of_D.sum()) == pytest.approx(2 * end, abs=1e-14)
    x = vector_of(mortar.D, owned_coordinates(V))
    assert largest((mortar.D * x - mortar.M * x).array) < 1e-14


@pytest.mark.parametrize("partition", PARTITIONS)
@pytest.mark.parametrize(
    ("n_lower", "x", "jitter", "at"),
    [((3, 2), (0.4, 0.401), 0.3, 1 / 3), ((1, 3), (0.49, 0.51), 0.0, 1.0)],
    ids=["nearer", "at larger x"],
)
def test_a_covered_facet_always_has_a_kept_node(n_lower, x, jitter, at, partition):
    """An island in the middle of a facet: one node carries all of it, the same on all ranks."""
    mesh, _, tags = two_blocks(COMM, n_lower, (2, 2), x_upper=x, partition=partition, jitter=jitter)
    V = space(mesh)
    mortar = assemble_mortar(V, tags, slave=3, master=4)
    assert COMM.allreduce(row_sums(mortar)[0].sum()) == pytest.approx(2 * (x[1] - x[0]), rel=1e-9)
    own = owned_coordinates(V)[mortar.nodes - V.dofmap.index_map.local_range[0], 0]
    assert np.concatenate(COMM.allgather(own)) == pytest.approx([at], abs=0.05 if jitter else 1e-15)


@pytest.mark.parametrize("tag", [3, 4])
def test_displacements_that_are_not_finite(tag):
    """At one node of one rank; all ranks hear of it, and a search is due."""
    mesh, _, tags = two_blocks(COMM, (4, 2), (3, 2), gap=0.1, partition="stripes")
    V = space(mesh)
    u = fem.Function(V)
    side = create_surface(V, tags, tag, "side")
    if COMM.rank == 0:
        u.x.array[2 * side.nodes[0]] = np.nan
    with pytest.raises(ValueError, match="u holds NaN or infinity"):
        assemble_mortar(V, tags, slave=3, master=4, u=u)
    with np.errstate(invalid="ignore"):
        assert outside_margin(pair_up(V, tags), u)


def test_bodies_beside_each_other_may_meet_later():
    mesh, _, tags = two_blocks(COMM, (4, 2), (3, 2), x_upper=(2.0, 3.0), gap=0.1)
    mortar = assemble_mortar(space(mesh), tags, slave=3, master=4)
    assert mortar.gap.getSize() == 0 and mortar.D.norm() == 0


@pytest.mark.parametrize("geometry", ["reference", "updated"])
def test_the_papers_matrices_are_those_of_the_solver(rng, geometry):
    """N^T (D - M) v is D_jj w_n of the change of basis, and the weighted gap D_jj times its gap."""
    case = PressedBlocks(n_lower=(5, 2), n_upper=(4, 2), x_upper=(0.3, 1.2))
    problem = case.problem(geometry=geometry)
    dm.newton(problem)
    (link,), coupling = problem.system.links, problem.system.links[0].coupling
    contact, kept = link.interface, link.coupling.kept[:, 0]
    options = {"slave": contact.slave, "master": contact.master, "u": problem.configuration}
    paper = assemble_mortar(
        problem.V, contact.facet_tags, **options, feature_angle=contact.feature_angle
    )
    numbers = problem.V.dofmap.index_map.local_to_global(link.nodes[kept])
    assert np.array_equal(paper.nodes, numbers)
    v = problem.vector(rng.normal(size=problem.n * problem.d))
    along, relative = paper.N.createVecRight(), paper.D.createVecLeft()
    (paper.D - paper.M).mult(v, relative)
    paper.N.multTranspose(relative, along)
    weight = coupling.weight[kept, 0]
    assert along.array_r == pytest.approx(weight * link.relative(v)[kept, 0], abs=1e-13)
    x = problem.positions() if geometry == "updated" else problem.vector(problem.X)
    gaps = weight * (link.gaps(x) + coupling.heights)[kept]
    assert paper.gap.array_r == pytest.approx(gaps, abs=1e-13)


# -- a factor of all integrals, 2 pi r of rings ----------------------------------------------------


def ring(points):
    return 2 * np.pi * points[:, 0]


@pytest.mark.parametrize("slave", [3, 4])
@pytest.mark.parametrize("x", [(0.0, 1.0), (2.0, 3.0)])
def test_a_weight_is_in_every_integral(slave, x):
    """Row sums are the areas of the swept disc, linear fields pass, also on the axis."""
    mesh, _, tags = two_blocks(COMM, (3, 2), (5, 3), x_lower=x, x_upper=x, jitter=0.4)
    V = space(mesh)
    mortar = assemble_mortar(V, tags, slave=slave, master=7 - slave, weight=ring)
    of_D, of_M = row_sums(mortar)
    assert (of_D > 0.0).all() and largest(of_D - of_M) < EXACT
    assert COMM.allreduce(of_D.sum()) == pytest.approx(
        2 * np.pi * (x[1] ** 2 - x[0] ** 2), rel=EXACT
    )
    linear = vector_of(mortar.D, owned_coordinates(V))
    assert largest((mortar.D * linear - mortar.M * linear).array) < EXACT


# -- second order, and closed surfaces -------------------------------------------------------------


@pytest.mark.parametrize("cell", CELLS[2:])
@pytest.mark.parametrize(("n", "degree"), [(1, 2), (2, 1), (2, 2)])
def test_multipliers_push_wherever_the_master_ends(n, cell, degree):
    """Row sums of D, the forces of unit pressures, are positive, and add up to the covered area."""
    mesh, _, tags = two_boxes(COMM, (n, n, 1), (2, 2, 1), cell=cell, gap=0.5)
    V = space(mesh, degree)
    u, rng = fem.Function(V), np.random.default_rng(7)
    for _ in range(20):
        size = rng.uniform(0.1, 0.6, 2)
        corner = rng.uniform(0.0, 1.0 - size)

        def move(x, corner=corner, size=size):
            way = corner[:, None] + (size - 1.0)[:, None] * x[:2]
            return np.where(x[2] > 0.25, np.vstack([way, np.zeros_like(x[2])]), 0.0)

        u.interpolate(move)
        mortar = assemble_mortar(V, tags, slave=TOP_OF_LOWER, master=BOTTOM_OF_UPPER, u=u)
        force = row_sums(mortar)[0]
        assert (force > 0).all()
        assert COMM.allreduce(force.sum()) == pytest.approx(3 * size.prod(), abs=EXACT)


@pytest.mark.parametrize("cell", CELLS[2:])
def test_vertices_of_triangles_are_kept_with_the_middles_beside_them_only(cell):
    """Their own functions integrate to nothing: alone they could carry no multiplier."""
    mesh, _, tags = two_boxes(COMM, (2, 2, 1), (3, 3, 1), cell=cell)
    pairing = pair_up(space(mesh, 2), tags, moving=False)
    slave, (points, _) = pairing.slave, find_segments(pairing, None)
    count = np.zeros(len(slave.nodes))
    count[slave.facets[:, list(slave.element.vertices)]] = 1.0
    vertices = accumulate(slave, count) > 0
    for allowed in (vertices, ~vertices, np.ones_like(vertices)):
        kept = default_keep(pairing, points, *node_weights(pairing, points), allowed)
        alone = cell == "tetrahedron" and allowed is vertices
        assert (kept == (allowed & (not alone))).all()


class Corners:
    """A block of second order in far corners of slave facets, pressed by 25 N."""

    def __init__(self, friction=None, geometry="updated"):
        """Make the problem, and solve it."""
        n, upper = (2, 2, 1), (0.25, 0.75, 0.25, 0.75)
        sizes = {"n_lower": n, "n_upper": n, "upper": upper, "comm": MPI.COMM_SELF}
        case = TwoBodies("hexahedron", 2, **sizes)
        guides = (0, 1) if friction is None else ()
        bcs = [case.held(BOTTOM), *(case.held(TOP, 0.0, i) for i in guides)]
        self.t = fem.Constant(case.mesh, np.array([0.0, 0.0, -100.0]))
        ds = ufl.Measure("ds", case.mesh, subdomain_data=case.facets)
        loads = ufl.inner(self.t, ufl.TestFunction(case.V)) * ds(TOP)
        self.contact, law = case.interface(friction=friction), dm.Elastic(E=210e3, nu=0.0)
        self.problem = case.problem([self.contact], bcs, law, loads=loads, geometry=geometry)
        self.report = dm.newton(self.problem)


@pytest.mark.serial
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


@pytest.mark.serial
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
    monkeypatch.setattr(certificate, "find_pull", lambda *_: pull)
    report = dm.newton(case.problem)
    assert report.certificate.sign == pull
    assert any(note.startswith("contacts pull, by ") for note in report.notes)


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
    V, contact = space(cube), dm.Contact(tags, slave=1, master=2)
    with pytest.raises(ValueError, match="parts of one surface"):
        dm.newton(create_problem(V, [contact], [hold(V, plane(2))]))

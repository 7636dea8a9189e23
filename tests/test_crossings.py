# SPDX-License-Identifier: MIT
"""Boundaries of bodies that cross where nothing couples them: found, with depth and place."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from dolfinx.mesh import exterior_facet_indices, meshtags
from dolfinx_mortar.geometry.facets import facet_sizes
from dolfinx_mortar.geometry.flat import find_overlaps as overlaps_of_facets
from dolfinx_mortar.geometry.flat import near_pairs
from dolfinx_mortar.mortar.surface import create_surface, facets_at, nodal_sagittas
from dolfinx_mortar.report.penetration import SUNK, Overlap, find_overlaps
from tests.cases import lug as lug_case
from tests.cases.box_piles import THREE, create_boxes
from tests.cases.meshes import BOTTOM, BOTTOM_OF_UPPER, TOP, TOP_OF_LOWER, UPPER, two_blocks
from tests.cases.meshes_3d import two_boxes
from tests.cases.msh_files import msh_file

COMM = MPI.COMM_WORLD
LAW = dm.Elastic(1000.0, 0.3)


def random_facets(d, count, seed):
    """Return lines or triangles of two bodies, some of them small, and their bodies."""
    rng = np.random.default_rng(seed)
    size = 2.0 ** -rng.integers(0, 6, size=count)[:, None, None]
    x = rng.uniform(0, 1, (count, 1, d)) + size * rng.uniform(-0.5, 0.5, (count, d, d))
    return x, rng.integers(0, 2, count)


def pierces(p, q, facet):
    """Tell whether the edge p q passes through a line or a triangle, by its own equation."""
    # p + t (q - p) = facet[0] + sum_a s_a (facet[a] - facet[0])
    A = np.column_stack([q - p, *(facet[0] - facet[1:])])
    t, *s = np.linalg.solve(A, facet[0] - p)
    return 0 < t < 1 and min(s) > 0 and sum(s) < 1


@pytest.mark.parametrize(("d", "n"), [(2, 60), (3, 120)])
def test_all_pairs_and_no_others(d, n):
    """Facets of all sizes at random: those found are those of a search over all pairs."""
    x, body = random_facets(d, n, d)
    pairs = near_pairs(x, body, ~np.eye(2, dtype=bool))
    depth, _ = overlaps_of_facets(x, np.zeros(len(x)), pairs)
    found = {*map(frozenset, pairs[depth > 0.0].tolist())}
    edges = [(0, 1)] if d == 2 else [(0, 1), (1, 2), (2, 0)]
    every = [(a, b) for a in range(n) for b in range(n) if body[a] != body[b]]
    crossing = {
        frozenset((a, b))
        for a, b in every
        if any(pierces(x[a, i], x[a, j], x[b]) for i, j in edges)
    }
    assert len(crossing) > 10 and found == crossing


def find_crossing(problem):
    """Return the deepest overlap that no interface couples."""
    return find_overlaps(problem).get(-1, Overlap(0.0, 0.0, []))


def sunk(partition="graph", interfaces=(), way=-0.3):
    """Return two blocks, the upper one .2 in the lower one, whose sides are not parallel to it."""
    mesh, _, facets = two_blocks(COMM, gap=0.1, x_upper=(0.2, 0.8), partition=partition)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    down = fem.Constant(mesh, (0.0, way))
    bottom, top = (fem.locate_dofs_topological(V, 1, facets.find(tag)) for tag in (BOTTOM, TOP))
    bcs = [fem.dirichletbc(np.zeros(2), bottom, V), fem.dirichletbc(down, top, V)]
    made = [make(facets, slave=BOTTOM_OF_UPPER, master=TOP_OF_LOWER) for make in interfaces]
    return dm.ContactProblem(dm.Solid(fem.Function(V), LAW), made, bcs=bcs)


@pytest.mark.mpi
@pytest.mark.parametrize("partition", ["graph", "bodies", "empty"])
def test_a_block_that_nothing_stops(partition):
    """Its lower side is .2 deep, in facets that are 1/3 long."""
    problem = sunk(partition)
    report = dm.newton(problem)
    found = find_crossing(problem)
    assert found.depth == pytest.approx(0.2)
    assert found.share == pytest.approx(0.6) == report.certificate.crossing
    assert found.place[1] == pytest.approx(-0.2)
    assert min(abs(found.place[0] - x) for x in (0.2, 0.8)) < 1e-12
    (note,) = [note for note in report.notes if "deep in each other" in note]
    assert "60% of the finer facet" in note and "Give them a Contact" in note.why


@pytest.mark.mpi
def test_a_body_deeper_than_its_whole_skin_reaches():
    """Its contact has no pairs beyond half of its thickness."""
    blocks, cells, facets = two_blocks(COMM, gap=-0.2, x_upper=(0.2, 0.8), heights=(1.0, 0.3))
    V = fem.functionspace(blocks, ("Lagrange", 1, (2,)))
    outer, to_cell = exterior_facet_indices(blocks.topology), blocks.topology.connectivity(1, 2)
    upper = np.isin([to_cell.links(f)[0] for f in outer], cells.find(UPPER))
    skins = meshtags(blocks, 1, outer, np.where(upper, 2, 1).astype(np.int32))
    ends = [fem.locate_dofs_topological(V, 1, facets.find(tag)) for tag in (BOTTOM, TOP)]
    bcs = [fem.dirichletbc(np.zeros(2), dofs, V) for dofs in ends]
    contact = dm.Contact(skins, slave=2, master=1)
    report = dm.newton(dm.ContactProblem(dm.Solid(fem.Function(V), LAW), [contact], bcs=bcs))
    (note,) = [note for note in report.notes if "deep in each other" in note]
    assert "tag only faces that touch" in note.why


@pytest.mark.mpi
@pytest.mark.parametrize("make", [dm.Contact, dm.Tie])
def test_what_is_coupled_does_not_cross(make):
    """In contact, and tied across a gap that closes: nothing is deeper than the mesh explains."""
    report = dm.newton(sunk(interfaces=[make]))
    assert report.certificate.crossing < 0.05
    assert not any("deep in each other" in note for note in report.notes)


@pytest.mark.mpi
@pytest.mark.parametrize("depth", [0.01, 0.1])
@pytest.mark.parametrize("cell", ["triangle", "hexahedron"])
def test_the_flank_of_a_block_in_contact(cell, depth):
    """How deep it is does not depend on how far the facet below reaches beyond the flank."""
    if cell == "triangle":
        mesh, _, facets = two_blocks(COMM, x_upper=(0.2, 0.8), gap=-depth)
    else:
        upper = (0.1, 0.9, 0.1, 0.9)
        mesh, _, facets = two_boxes(COMM, (3, 3, 2), cell=cell, upper=upper, gap=-depth)
    V = fem.functionspace(mesh, ("Lagrange", 1, (mesh.geometry.dim,)))
    for tags in ((TOP_OF_LOWER, BOTTOM_OF_UPPER), (BOTTOM_OF_UPPER, TOP_OF_LOWER)):
        contact = dm.Contact(facets, slave=tags[0], master=tags[1])
        problem = dm.ContactProblem(dm.Solid(fem.Function(V), LAW), [contact])
        assert find_crossing(problem).depth == pytest.approx(depth)


@pytest.mark.mpi
@pytest.mark.parametrize("cell", ["tetrahedron", "hexahedron"])
def test_beside_a_contact(cell):
    """Sides of a contact do not count where they face each other, their flanks do."""
    mesh, _, facets = two_boxes(
        COMM, (3, 3, 2), (2, 3, 2), cell=cell, upper=(0.1, 0.9, 0.1, 0.9), gap=0.05
    )
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    contact = dm.Contact(facets, slave=TOP_OF_LOWER, master=BOTTOM_OF_UPPER)
    problem = dm.ContactProblem(dm.Solid(fem.Function(V), LAW), [contact])
    for way, crosses in (((0, 0, 0.0), False), ((0.91, 0, -0.3), False), ((0.6, 0, -0.3), True)):
        move = np.array(way)[:, None]
        problem.u.interpolate(lambda x, move=move: move * (x[2] > 0.01))
        assert (find_crossing(problem).share > 0.1) is crosses


def skins_of(mesh, cells):
    """Tag the whole skin of each body with the tag of its cells."""
    mesh.topology.create_connectivity(2, 3)
    facets = exterior_facet_indices(mesh.topology)
    cell_of, tag_of = mesh.topology.connectivity(2, 3), np.zeros(cells.indices.max() + 1, np.int32)
    tag_of[cells.indices] = cells.values
    return meshtags(mesh, 2, facets, tag_of[cell_of.array[cell_of.offsets[facets]]])


@pytest.mark.mpi
@pytest.mark.parametrize("whole", [False, True])
@pytest.mark.parametrize(
    "cells", [((1, 1, 1), (1, 1, 1), (1, 1, 1)), ((5, 2, 2), (2, 2, 2), (3, 2, 2))]
)
def test_edges_that_touch_a_flank_do_not_cross_it(cells, whole):
    """Three boxes around an edge, strained alike up to 1e-9, as a solver leaves them.

    The edges of the base pass through the flanks on it by that, .2 to 1 from their ends.
    """
    mesh, tags = create_boxes(COMM, [(*box, n) for box, n in zip(THREE, cells, strict=True)])
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    contacts = dm.find_pairs(mesh, tags, show=False).contacts
    if whole:
        skins = skins_of(mesh, tags)
        contacts = [dm.Contact(skins, slave=s, master=m) for s, m in ((2, 1), (3, 1), (2, 3))]
    problem = dm.ContactProblem(dm.Solid(fem.Function(V), LAW), contacts)
    strain = np.array([[-0.01], [0.003], [-0.01]])
    turn = np.array([[12.9898, 78.233, 37.719], [39.346, 11.135, 83.155], [73.156, 52.235, 9.151]])
    for seed in range(10):  # numbers that do not depend on the ranks
        problem.u.interpolate(
            lambda x, seed=seed: strain * x + 1e-9 * np.sin(1e3 * turn @ (x + 0.1 * seed))
        )
        assert find_crossing(problem).share < 1e-6


def test_sagittas_of_a_cylinder():
    """R (1 - cos(a / 2)) of facets over an angle a, at all nodes, also at rims."""
    _, tags = mesh = lug_case.create_lug("hexahedron", (4.0, 4.0))
    V = fem.functionspace(mesh[0], ("Lagrange", 1, (3,)))
    surface = create_surface(V, tags, 3, "slave")
    angle = np.pi / np.ceil(np.pi * lug_case.HOLE / 4.0)
    exact = lug_case.HOLE * (1.0 - np.cos(angle / 2))
    found = nodal_sagittas(surface, surface.X, 40.0)
    size = facet_sizes(facets_at(surface, surface.X).x).mean() / (angle * lug_case.HOLE)
    assert found / size == pytest.approx(np.full(len(found), exact), rel=0.02)


def ring_on_shaft(model):
    """Draw a ring that fits on a longer shaft of radius .5."""
    occ = model.occ
    shaft = occ.addCylinder(0, 0, -0.8, 0, 0, 1.6, 0.5)
    ring, bore = (occ.addCylinder(0, 0, -0.3, 0, 0, 0.6, r) for r in (0.7, 0.5))
    (part,), _ = occ.cut([(3, ring)], [(3, bore)])
    occ.synchronize()
    for tag in (shaft, part[1]):
        model.addPhysicalGroup(3, [tag])
    model.mesh.generate(3)


@pytest.mark.mpi
@pytest.mark.parametrize("down", [False, True])
def test_the_end_of_a_ring_on_a_shaft(down):
    """Facets of the shaft cross it at the rim of the bore, by sagittas; pressed down, deeper."""
    with msh_file(ring_on_shaft, MeshSizeMax=0.15, MeshSizeMin=0.15) as file:
        mesh, cells, _ = dm.meshing.read_msh(file, COMM)
    contacts = dm.find_pairs(mesh, cells, show=False).contacts
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    problem = dm.ContactProblem(dm.Solid(fem.Function(V), LAW), contacts)
    if down:
        move = np.array([[0.0], [-0.1], [0.0]])
        problem.u.interpolate(
            lambda x: np.where(np.hypot(*x[:2]) > 0.499, move, 0.0), cells.find(2)
        )
    assert (find_crossing(problem).share > SUNK) is down

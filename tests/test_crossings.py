# SPDX-License-Identifier: MIT
"""Boundaries of bodies that cross where nothing couples them, and distances of facets."""

from mpi4py import MPI

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

import dolfinx_mortar as dm
from dolfinx import fem
from dolfinx_mortar.geometry import flat
from dolfinx_mortar.geometry.facets import QUAD4, Facets
from dolfinx_mortar.report.penetration import Overlap, find_overlaps
from tests.cases.block_piles import ABOVE, BELOW, Blocks
from tests.cases.meshes import box_cells, box_points, create_distributed, skins
from tests.cases.two_bodies import TwoBodies, create_problem, held

COMM = MPI.COMM_WORLD


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
    pairs = flat.near_pairs(x, body, ~np.eye(2, dtype=bool))
    depth, _ = flat.find_overlaps(x, np.zeros(len(x)), pairs)
    found = {*map(frozenset, pairs[depth > 0.0].tolist())}
    edges = [(0, 1)] if d == 2 else [(0, 1), (1, 2), (2, 0)]
    every = [(a, b) for a in range(n) for b in range(n) if body[a] != body[b]]
    crossing = {
        frozenset((a, b))
        for a, b in every
        if any(pierces(x[a, i], x[a, j], x[b]) for i, j in edges)
    }
    assert len(crossing) > 10 and found == crossing


def least(a, b):
    """Return the distance of two parallelograms or lines, by a least-squares problem in a box."""
    edges = [x[[1, -1]][: len(x) // 2] - x[0] if len(x) > 2 else x[1:] - x[0] for x in (a, b)]
    A = np.concatenate([edges[0], -edges[1]]).T
    found = lsq_linear(A, b[0] - a[0], (0.0, 1.0), method="bvls", tol=1e-15)
    return np.linalg.norm(A @ found.x - (b[0] - a[0]))


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1).map(np.random.default_rng))
def test_distances_of_lines_and_parallelograms(rng):
    lines = rng.normal(size=(2, 2, 2))
    assert np.isclose(flat.distances(*lines[:, None])[0], least(*lines), atol=1e-7)
    corners = rng.normal(size=(2, 3, 3))
    quads = np.concatenate([corners, corners[:, [0]] + corners[:, [2]] - corners[:, [1]]], axis=1)
    found = flat.facet_distances(*(Facets(QUAD4, x[None]) for x in quads))[0]
    assert np.isclose(found, least(*quads), atol=1e-7)


def test_distance_of_triangles_that_pierce_each_other_or_lie_in_a_line():
    base = np.array([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]])
    for tip, expected in ((-1.0, 0.0), (0.25, 0.25)):
        pin = np.array([[[0.2, 0.2, tip], [0.2, 0.2, 3], [0.25, 0.2, 3]]])
        assert abs(flat.distances(base, pin)[0] - expected) < 1e-15
        assert abs(flat.distances(pin, base)[0] - expected) < 1e-15
    line = np.array([[[0.0, 0], [1, 0]]])
    assert flat.distances(line, line + np.array([3.0, 0.0]))[0] == 2.0
    assert flat.distances(line, line[:, ::-1] + np.array([0.5, 0.25]))[0] == 0.25


def find_crossing(problem):
    return find_overlaps(problem).get(-1, Overlap(0.0, 0.0, []))


def sunk(partition="graph", interfaces=(), way=-0.3):
    case = TwoBodies(gap=0.1, x_upper=(0.2, 0.8), partition=partition)
    return case.problem(
        [case.interface(kind, swap=True) for kind in interfaces], case.bcs(0.0, way)
    )


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
    case = TwoBodies(gap=-0.2, x_upper=(0.2, 0.8), heights=(1.0, 0.3))
    case.tags = skins(case.mesh, case.cells, case.facets, keep=())
    report = dm.newton(case.problem([case.interface(swap=True)]))
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
        case = TwoBodies(x_upper=(0.2, 0.8), gap=-depth)
    else:
        case = TwoBodies(cell, n_lower=(3, 3, 2), upper=(0.1, 0.9, 0.1, 0.9), gap=-depth)
    for swap in (False, True):
        problem = case.problem([case.interface(swap=swap)], [])
        assert find_crossing(problem).depth == pytest.approx(depth)


@pytest.mark.mpi
@pytest.mark.parametrize("cell", ["tetrahedron", "hexahedron"])
def test_beside_a_contact(cell):
    """Sides of a contact do not count where they face each other, their flanks do."""
    sizes = {"n_lower": (3, 3, 2), "n_upper": (2, 3, 2), "upper": (0.1, 0.9, 0.1, 0.9)}
    case = TwoBodies(cell, gap=0.05, **sizes)
    problem = case.problem(bcs=[])
    for way, crosses in (((0, 0, 0.0), False), ((0.91, 0, -0.3), False), ((0.6, 0, -0.3), True)):
        case.raise_upper(*way)
        assert (find_crossing(problem).share > 0.1) is crosses


# A base, and two boxes on it, side by side: all three meet in an edge.
THREE = (
    ((0.0, 0.0, -1.0), (2.0, 1.0, 0.0)),
    ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)),
    ((1.0, 0.0, 0.0), (2.0, 1.0, 1.0)),
)


def create_boxes(boxes):
    """Create boxes, each of its lowest and highest corner and cells in three directions."""
    points, cells, first = [], [], 0
    for low, high, n in boxes:
        lines = [np.linspace(a, b, m + 1) for a, b, m in zip(low, high, n, strict=True)]
        points.append(box_points(lines))
        cells.append(first + box_cells(n, "hexahedron"))
        first += len(points[-1])
    return create_distributed(COMM, np.concatenate(points), np.concatenate(cells), "hexahedron")


@pytest.mark.mpi
@pytest.mark.parametrize(
    "cells", [((1, 1, 1), (1, 1, 1), (1, 1, 1)), ((5, 2, 2), (2, 2, 2), (3, 2, 2))]
)
def test_edges_that_touch_a_flank_do_not_cross_it(cells):
    """Three boxes around an edge, strained alike up to 1e-9, as a solver leaves them."""
    mesh = create_boxes([(*box, n) for box, n in zip(THREE, cells, strict=True)])
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    contacts = dm.find_pairs(mesh, show=False).contacts
    problem = create_problem(V, contacts)
    strain = np.array([[-0.01], [0.003], [-0.01]])
    turn = np.array([[12.9898, 78.233, 37.719], [39.346, 11.135, 83.155], [73.156, 52.235, 9.151]])
    for seed in range(10):  # numbers that do not depend on the ranks
        problem.u.interpolate(
            lambda x, seed=seed: strain * x + 1e-9 * np.sin(1e3 * turn @ (x + 0.1 * seed))
        )
        assert find_crossing(problem).share < 1e-6


@pytest.mark.mpi
def test_a_jump_excuses_the_sides_of_its_tie_only():
    boxes = [(0, 1, 0, 1, 2, 2), (0, 1, 1, 2, 3, 2), (3, 4, 0, 1, 2, 2), (3, 4, 0.8, 1.8, 3, 2)]
    b = Blocks(boxes)
    tie = b.join(dm.Tie, (2, BELOW), (1, ABOVE))
    tie.jump = 0.0, -0.5
    problem = b.problem([tie], [held(b.V, b.cells, k) for k in (1, 3, 4)], dm.Elastic(1.0, 0.0))
    dm.newton(problem)
    assert find_crossing(problem).depth == pytest.approx(0.2)

# SPDX-License-Identifier: MIT
"""Mortar operators as PETSc matrices on any number of ranks, and the search they rest on."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx
import dolfinx_mortar as dm
from dolfinx_mortar.mortar.assembly import assemble_mortar
from dolfinx_mortar.mortar.duals import default_keep, node_weights
from dolfinx_mortar.mortar.integrals import find_segments
from dolfinx_mortar.mortar.operators import create_operators
from dolfinx_mortar.mortar.pairing import outside_margin
from dolfinx_mortar.mortar.surface import create_surface
from tests.cases.meshes import two_blocks
from tests.cases.mortar import (
    node_matrices,
    operators,
    owned_coordinates,
    pair_up,
    space,
    vector_of,
)
from tests.cases.pressed_blocks import PressedBlocks

COMM = MPI.COMM_WORLD
PARTITIONS = ["graph", "shared_facet", "stripes", "bodies", "empty"]
EXACT = 1e-12
pytestmark = pytest.mark.mpi


def bend(points):
    """Bend the upper block to an arc that touches y = 0.1."""
    result, up = points.copy(), points[:, 1] > 0.05
    angle, radius = points[up, 0] / 2, 2.1 - points[up, 1]
    result[up] = np.stack([radius * np.sin(angle), 2.1 - radius * np.cos(angle)], axis=1)
    return result


@pytest.mark.parametrize("partition", PARTITIONS)
@pytest.mark.parametrize("sides", [(3, 4), (4, 3)])
@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
def test_inclined_flat_interface(partition, sides, cell):
    """Row sums, linear fields, diagonal D, gap and covered length across an open flat gap."""
    angle, gap = 0.3, 0.1
    mesh, _, tags = two_blocks(
        COMM, (7, 2), (5, 2), x_upper=(-0.3, 0.75), gap=gap, cell=cell, angle=angle, jitter=0.4,
        partition=partition,
    )  # fmt: skip
    V = space(mesh)
    mortar = assemble_mortar(V, tags, slave=sides[0], master=sides[1])
    m, d = mortar.gap.getSize(), 2
    assert m > 4
    assert mortar.D.getSize() == (d * m, d * V.dofmap.index_map.size_global)
    assert mortar.M.getSize() == mortar.D.getSize()
    assert mortar.N.getSize() == (d * m, m)
    assert mortar.gap.getLocalSize() == len(mortar.nodes)
    first, last = V.dofmap.index_map.local_range
    assert ((mortar.nodes >= first) & (mortar.nodes < last)).all()

    ones = vector_of(mortar.D, np.ones((last - first, 2)))
    D_ones = (mortar.D * ones).array
    assert np.abs(D_ones - (mortar.M * ones).array).max(initial=0) < EXACT
    x = vector_of(mortar.D, owned_coordinates(V))
    side = 1 if sides[0] == 3 else -1
    normal = side * np.array([-np.sin(angle), np.cos(angle)])
    weights = D_ones.reshape(-1, 2)[:, :1]
    jump = (mortar.M * x - mortar.D * x).array.reshape(-1, 2)
    assert np.abs(jump - gap * weights * normal).max(initial=0) < EXACT
    assert np.abs(mortar.gap.array - gap * weights[:, 0]).max(initial=0) < EXACT
    assert COMM.allreduce(D_ones.sum()) == pytest.approx(2 * 0.75, abs=EXACT)

    start, columns, values = mortar.D.getValuesCSR()
    rows = np.repeat(np.arange(len(start) - 1), np.diff(start))
    kept = set(np.concatenate(COMM.allgather(mortar.nodes)).tolist())
    diagonal = columns == d * mortar.nodes[rows // d] + rows % d
    assert (values[diagonal] > 0).all()
    assert np.count_nonzero(diagonal) == d * len(mortar.nodes)
    others = np.isin(columns // d, list(kept)) & ~diagonal
    assert (values[others] == 0).all()
    n = (mortar.N * vector_of(mortar.N, np.ones(len(mortar.nodes)))).array.reshape(-1, 2)
    assert np.abs(n - normal).max(initial=0) < EXACT


def test_half_covered_facet_of_a_mesh():
    """Slave facet (1,2)-(3,2) below master (0,2)-(2,2): the exact fractions."""
    mesh, _, tags = two_blocks(
        MPI.COMM_SELF, (1, 1), (1, 1), x_lower=(0, 2), x_upper=(1, 3),
        transform=lambda x: x + np.array([0, 2]),
    )  # fmt: skip
    V = space(mesh)
    mortar = assemble_mortar(V, tags, slave=4, master=3)
    x = owned_coordinates(V)
    slave = [np.flatnonzero((np.abs(x - [a, 2]) < 1e-12).all(axis=1) & upper(V))[0] for a in (1, 3)]
    master = [
        np.flatnonzero((np.abs(x - [a, 2]) < 1e-12).all(axis=1) & ~upper(V))[0] for a in (2, 0)
    ]
    row = [int(np.flatnonzero(mortar.nodes == s)[0]) for s in slave]
    for c in range(2):
        rows = [2 * i + c for i in row]
        D = mortar.D.getValues(rows, [2 * j + c for j in slave])
        M = mortar.M.getValues(rows, [2 * j + c for j in master])
        assert np.abs(D - np.diag([0.75, 0.25])).max() < 1e-15
        assert np.abs(M - np.array([[9, 9], [9, -3]]) / 24).max() < 1e-15
    assert np.abs(mortar.gap.array).max() < 1e-15


def upper(V):
    """Tell which nodes belong to cells above y = 2."""
    dofs = V.dofmap.list
    centre = V.tabulate_dof_coordinates()[dofs, 1].mean(axis=1)
    result = np.zeros(V.dofmap.index_map.size_local, dtype=bool)
    result[dofs[centre > 2].ravel()] = True
    return result


def nodal_table(comm, partition, sides):
    """Return gap, D_jj, row sums and P (x, y, x^2) of all kept nodes, ordered by position."""
    mesh, _, tags = two_blocks(
        comm, (13, 2), (9, 2), x_lower=(-1, 1.1), x_upper=(-1.2, 0.9), gap=0.1, jitter=0.5,
        transform=bend, partition=partition,
    )  # fmt: skip
    V = space(mesh)
    u = dolfinx.fem.Function(V)
    u.interpolate(lambda x: 0.02 * np.stack([np.sin(3 * x[0]), np.cos(2 * x[0]) * x[1]]))
    mortar = assemble_mortar(V, tags, slave=sides[0], master=sides[1], u=u)
    x = owned_coordinates(V)
    columns = [x[mortar.nodes - V.dofmap.index_map.local_range[0]], mortar.gap.array[:, None]]
    for field in (np.ones_like(x), x, x**2):
        for A in (mortar.D, mortar.M):
            columns.append((A * vector_of(A, field)).array.reshape(-1, 2))
    table = np.concatenate(comm.allgather(np.concatenate(columns, axis=1)))
    return table[np.argsort(table[:, 0])]


@pytest.mark.parametrize("sides", [(3, 4), (4, 3)])
@pytest.mark.parametrize("partition", PARTITIONS)
def test_same_operators_on_any_number_of_ranks(partition, sides):
    alone = nodal_table(MPI.COMM_SELF, "graph", sides)
    together = nodal_table(COMM, partition, sides)
    assert alone.shape == together.shape
    assert len(alone) >= 8
    assert np.abs(alone - together).max() < 1e-14


def test_gap_is_negative_where_the_bodies_overlap():
    mesh, _, tags = two_blocks(COMM, (4, 2), (3, 2))
    V = space(mesh)
    u = dolfinx.fem.Function(V)
    lowered = create_surface(V, tags, 4, "master").nodes
    for height in (0.2, -0.1):
        u.x.array[:] = 0
        u.x.array[2 * lowered + 1] = height
        u.x.scatter_forward()
        mortar = assemble_mortar(V, tags, slave=3, master=4, u=u)
        total = COMM.allreduce(mortar.gap.array.sum())
        assert total == pytest.approx(height, abs=1e-14)


@pytest.mark.parametrize("coverage", [1.0, 0.5, 0.051, 0.049, 1e-3, 1e-6])
@pytest.mark.parametrize("sides", [(3, 4), (4, 3)])
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
    ones = vector_of(mortar.D, np.ones_like(owned_coordinates(V)))
    D_ones, M_ones = (mortar.D * ones).array, (mortar.M * ones).array
    assert np.abs(D_ones - M_ones).max(initial=0) < 1e-14
    assert COMM.allreduce(D_ones.sum()) == pytest.approx(2 * end, abs=1e-14)
    x = vector_of(mortar.D, owned_coordinates(V))
    assert np.abs((mortar.D * x - mortar.M * x).array).max(initial=0) < 1e-14


@pytest.mark.parametrize("partition", PARTITIONS)
def test_a_covered_facet_always_has_a_kept_node(partition):
    """An island in the middle of one facet: the node that is nearer carries all of it."""
    mesh, _, tags = two_blocks(
        COMM, (3, 2), (2, 2), x_upper=(0.4, 0.401), partition=partition, jitter=0.3
    )
    V = space(mesh)
    mortar = assemble_mortar(V, tags, slave=3, master=4)
    assert mortar.gap.getSize() == 1
    ones = vector_of(mortar.D, np.ones_like(owned_coordinates(V)))
    weight = COMM.allreduce((mortar.D * ones).array.sum())
    assert weight == pytest.approx(2e-3, rel=1e-9)
    where = mortar.nodes - V.dofmap.index_map.local_range[0]
    x = COMM.allreduce(owned_coordinates(V)[where, 0].sum())
    assert 0.3 < x < 0.4


def test_ties_are_broken_alike_on_all_ranks():
    """Both nodes are equally covered, up to round-off: the one at larger x."""
    for partition in PARTITIONS:
        mesh, _, tags = two_blocks(COMM, (1, 3), (2, 3), x_upper=(0.49, 0.51), partition=partition)
        mortar = assemble_mortar(space(mesh), tags, slave=3, master=4)
        where = mortar.nodes - space(mesh).dofmap.index_map.local_range[0]
        x = owned_coordinates(space(mesh))[where, 0]
        assert np.concatenate(COMM.allgather(x)) == pytest.approx([1.0])


def test_removed_nodes_by_choice():
    """Rows vanish, the weight goes to the neighbours, row sums stay."""
    mesh, _, tags = two_blocks(COMM, (6, 2), (4, 2), partition="stripes")
    V = space(mesh)
    pairing = pair_up(V, tags, 3, 4)
    points, _ = find_segments(pairing, None)
    x = pairing.slave.X[:, 0]
    keep = (x > 0.01) & (np.abs(x - 0.5) > 0.01)
    D, M = node_matrices(pairing, points, keep)
    ones = D.createVecRight()
    ones.set(1.0)
    D_ones, M_ones = (D * ones).array, (M * ones).array
    assert np.abs(D_ones - M_ones).max(initial=0) < 1e-14
    assert COMM.allreduce(D_ones.sum()) == pytest.approx(1.0, abs=1e-14)
    removed = pairing.slave.nodes[: pairing.slave.owned][~keep[: pairing.slave.owned]]
    assert (D_ones[removed] == 0).all()
    assert COMM.allreduce(np.count_nonzero(D_ones)) == 5


def test_allowed_nodes_only():
    mesh, _, tags = two_blocks(COMM, (6, 2), (4, 2), partition="stripes")
    pairing = pair_up(space(mesh), tags, 3, 4)
    points, _ = find_segments(pairing, None)
    weights = node_weights(pairing, points)
    allowed = pairing.slave.X[:, 0] > 0.4
    assert (default_keep(pairing, points, *weights) == 1).all()
    assert (default_keep(pairing, points, *weights, allowed) == allowed).all()


# -- moving bodies ---------------------------------------------------------------------------------


def moving(partition="stripes", n=(12, 9)):
    """Return pairing of a flat and a bent side, and the mask of nodes of the upper block."""
    mesh, cells, tags = two_blocks(
        COMM, (n[0], 1), (n[1], 1), x_lower=(-1, 1), x_upper=(-0.9, 0.9), gap=0.1, transform=bend,
        partition=partition,
    )  # fmt: skip
    V = space(mesh)
    top = dolfinx.fem.locate_dofs_topological(V, 2, cells.find(2))
    return V, pair_up(V, tags, 3, 4), top


def shift(V, nodes, by):
    u = dolfinx.fem.Function(V)
    u.x.array.reshape(-1, 2)[nodes] = by
    u.x.scatter_forward()
    return u


def test_rigid_motion_of_both_bodies_is_no_sliding():
    V, pairing, _ = moving()
    before = [A.copy() for A in operators(pairing)[:2]]
    u = dolfinx.fem.Function(V)
    c, s = np.cos(0.7) - 1, np.sin(0.7)
    u.interpolate(lambda x: np.stack([5 + c * x[0] - s * x[1], -3 + s * x[0] + c * x[1]]))
    assert not outside_margin(pairing, u)
    for A, B in zip(before, operators(pairing, u)[:2], strict=True):
        assert (A - B).norm() < 1e-13


def test_operators_are_records():
    """Those of one configuration stay what they are when others are made, on the same pattern."""
    V, pairing, top = moving()
    D, M, keep = operators(pairing)
    segments, normals = find_segments(pairing, None)
    made = create_operators(pairing, None, segments, normals, np.ones((len(keep), 1), dtype=bool))
    before = [A.copy() for A in (D, M)], made.D.copy(), made.M.copy()
    u = shift(V, top, (0.05, 0.01))
    others = operators(pairing, u)
    assert (others[1] - M).norm() > 1e-6
    for A, B, other in zip((D, M), before[0], others, strict=False):
        assert (A - B).norm() == 0.0
        for mine, its in zip(A.getValuesCSR()[:2], other.getValuesCSR()[:2], strict=True):
            assert (mine == its).all()
    assert (made.D == before[1]).all() and (made.M == before[2]).all()
    assert (pairing.M.matrix(made.M[:, 0]) - M).norm() == 0.0


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_units(scale):
    """D and M scale with the length, the gap with its square; the decisions are the same."""
    gaps = []
    for s in (1.0, scale):
        mesh, _, tags = two_blocks(
            COMM, (8, 2), (5, 2), x_upper=(-0.2, 0.77), gap=0.1, angle=0.4, jitter=0.4,
            transform=lambda x, s=s: s * x,
        )  # fmt: skip
        mortar = assemble_mortar(space(mesh), tags, slave=3, master=4)
        gaps.append((mortar.gap.getSize(), mortar.gap.norm() / s**2, mortar.M.norm() / s))
    assert gaps[0] == pytest.approx(gaps[1], rel=1e-12)


# -- bad input -------------------------------------------------------------------------------------


def test_bad_pairs_raise_on_all_ranks():
    mesh, _, tags = two_blocks(COMM, (4, 2), (3, 2), partition="stripes")
    V = space(mesh)
    with pytest.raises(ValueError, match=r"slave=3 and master=3 share 4 facets"):
        assemble_mortar(V, tags, slave=3, master=3)
    with pytest.raises(ValueError, match=r"slave=3 and master=2 can never meet"):
        assemble_mortar(V, tags, slave=3, master=2)
    with pytest.raises(ValueError, match=r"slave=9 marks no facet"):
        assemble_mortar(V, tags, slave=9, master=4)
    other = dolfinx.fem.Function(space(two_blocks(COMM)[0]))
    with pytest.raises(ValueError, match=r"u has to be a Function of V"):
        assemble_mortar(V, tags, slave=3, master=4, u=other)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("tag", [3, 4])
def test_displacements_that_are_not_finite(bad, tag):
    """At one node of one rank; all ranks hear of it, and a search is due."""
    mesh, _, tags = two_blocks(COMM, (4, 2), (3, 2), gap=0.1, partition="stripes")
    V = space(mesh)
    pairing = pair_up(V, tags, 3, 4)
    u = dolfinx.fem.Function(V)
    side = create_surface(V, tags, tag, "side")
    if COMM.rank == 0:
        u.x.array[2 * side.nodes[0]] = bad
    with pytest.raises(ValueError, match="u holds NaN or infinity"):
        assemble_mortar(V, tags, slave=3, master=4, u=u)
    with np.errstate(invalid="ignore"):
        assert outside_margin(pairing, u)


def test_bodies_beside_each_other_may_meet_later():
    """Facing sides without any overlap are no error; nothing is covered yet."""
    mesh, _, tags = two_blocks(COMM, (4, 2), (3, 2), x_upper=(2.0, 3.0), gap=0.1)
    mortar = assemble_mortar(space(mesh), tags, slave=3, master=4)
    assert mortar.gap.getSize() == 0
    assert mortar.D.norm() == 0


@pytest.mark.mpi
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

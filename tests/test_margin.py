# SPDX-License-Identifier: MIT
"""The margin of the search: no segment is ever lost without notice, in 2D and in 3D."""

from dataclasses import replace

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx import fem
from dolfinx_mortar.algebra.parallel import any_rank
from dolfinx_mortar.mortar.integrals import find_segments
from dolfinx_mortar.mortar.pairing import create_pairing, outside_margin
from tests.cases.meshes import UPPER, two_blocks
from tests.cases.meshes_3d import rotation, two_boxes
from tests.cases.mortar import moving, pair_up, space
from tests.test_mortar import PARTITIONS

COMM = MPI.COMM_WORLD
pytestmark = pytest.mark.mpi


def two_sides(cell, partition="stripes"):
    """Return the pairing of two blocks, and the nodes of the upper one."""
    if cell == "triangle":
        mesh, cells, tags = two_blocks(COMM, (9, 1), (7, 1), gap=0.02, partition=partition)
    else:
        mesh, cells, tags = two_boxes(
            COMM, (4, 3, 1), (3, 4, 1), cell=cell, gap=0.02, partition=partition
        )
    d = mesh.geometry.dim
    V = space(mesh)
    return pair_up(V, tags), fem.locate_dofs_topological(V, d, cells.find(UPPER))


def slide(pairing, nodes, shift):
    u = fem.Function(pairing.slave.V)
    d = len(shift)
    u.x.array.reshape(-1, d)[nodes] = shift
    u.x.scatter_forward()
    return u


def named(pairing, slave, master):
    """Return {(slave facet, global nodes of the master facet)} of pairs on this rank."""
    nodes = pairing.master_nodes[pairing.master_facets]
    return {(s, *nodes[m]) for s, m in zip(slave.tolist(), master, strict=True)}


CELLS = pytest.mark.parametrize("cell", ["triangle", "tetrahedron", "hexahedron"])


@CELLS
@pytest.mark.parametrize("partition", ["bodies", "empty"])
def test_a_segment_of_a_pair_that_is_no_candidate_calls_for_a_search(cell, partition):
    """Bodies slide step by step: whenever a fresh search has a segment that is not provided for."""
    pairing, upper = two_sides(cell, partition)
    known, lost = named(pairing, *pairing.pairs.T), []
    direction = np.array([0.8, 0.6, 0.0] if cell != "triangle" else [1.0, 0.0])
    for amount in np.linspace(0.0, 0.7, 8):
        u = slide(pairing, upper, amount * direction)
        fresh = create_pairing(pairing.slave, pairing.master, u, moving=False)
        found = find_segments(fresh, u)[0]
        lost.append(any_rank(COMM, bool(named(fresh, found.slave, found.master) - known))[0])
        assert outside_margin(pairing, u) or not lost[-1]
    assert not lost[0]
    assert lost[-1]


@CELLS
def test_one_missing_candidate_is_noticed(cell):
    """Any pair that has a segment, on one rank only: all ranks hear of it."""
    pairing, _ = two_sides(cell)
    used = np.unique(find_segments(pairing, None)[0].pair)
    assert not outside_margin(pairing, None)
    counts = COMM.allgather(len(used))
    rank = int(np.argmax(counts))
    for k in range(0, counts[rank], 5):
        left = np.ones(len(pairing.pairs), dtype=bool)
        if COMM.rank == rank:
            left[used[k]] = False
        assert outside_margin(replace(pairing, pairs=pairing.pairs[left]), None)


@pytest.mark.parametrize("partition", PARTITIONS)
def test_margin_of_sliding(partition):
    """Half a facet of sliding and rigid motions are within the margin, several facets are not."""
    V, pairing, upper = moving(partition)
    u, R = fem.Function(V), rotation((0, 0, 1), 0.7)[:2, :2] - np.eye(2)
    u.interpolate(lambda x: np.array([[5.0], [-3.0]]) + R @ x[:2])
    assert not outside_margin(pairing, None) and not outside_margin(pairing, u)
    for amount in (0.0, 0.08, -0.08, 1.0, -1.0):
        u = slide(pairing, upper, (amount, 0.0))
        assert outside_margin(pairing, u) == (abs(amount) > 0.5)
        assert not outside_margin(create_pairing(pairing.slave, pairing.master, u), u)


def test_margin_where_a_rank_has_no_master_facet():
    """The upper block jumps over slave facets whose rank has not received any of its facets."""
    mesh, cells, tags = two_blocks(
        COMM, (16, 1), (3, 1), x_lower=(0, 4), x_upper=(3.5, 4), gap=0.1, partition="stripes"
    )
    V = space(mesh)
    pairing = pair_up(V, tags)
    upper = fem.locate_dofs_topological(V, 2, cells.find(UPPER))
    assert outside_margin(pairing, slide(pairing, upper, (-3.3, 0.0)))
    assert not outside_margin(pairing, slide(pairing, upper, (3.0, 0.0)))  # apart for good

# SPDX-License-Identifier: MIT
"""The margin of the search: no segment is ever lost without notice, in 2D and in 3D."""

from dataclasses import replace

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx import fem
from dolfinx_mortar.algebra.parallel import any_rank
from dolfinx_mortar.mortar import pairing as search
from dolfinx_mortar.mortar.operators import _best_nodes, find_segments
from dolfinx_mortar.mortar.pairing import create_pairing, outside_margin
from dolfinx_mortar.mortar.surface import create_surface
from tests.meshes import TOP_OF_LOWER, UPPER, two_blocks
from tests.meshes_3d import BOTTOM_OF_UPPER, two_boxes

COMM = MPI.COMM_WORLD
pytestmark = pytest.mark.mpi


def pair_up(cell, partition="stripes"):
    """Return the pairing of two blocks, and the nodes of the upper one."""
    if cell == "triangle":
        mesh, cells, tags = two_blocks(COMM, (9, 1), (7, 1), gap=0.02, partition=partition)
    else:
        mesh, cells, tags = two_boxes(
            COMM, (4, 3, 1), (3, 4, 1), cell=cell, gap=0.02, partition=partition
        )
    d = mesh.geometry.dim
    V = fem.functionspace(mesh, ("Lagrange", 1, (d,)))
    sides = [create_surface(V, tags, t, "side") for t in (TOP_OF_LOWER, BOTTOM_OF_UPPER)]
    return create_pairing(V, *sides, None), fem.locate_dofs_topological(V, d, cells.find(UPPER))


def slide(pairing, nodes, shift):
    u = fem.Function(pairing.slave.V)
    d = len(shift)
    u.x.array.reshape(-1, d)[nodes] = shift
    u.x.scatter_forward()
    return u


def with_segments(pairing, u):
    """Return {(slave facet, global nodes of the master facet)} of all segments of this rank."""
    found = find_segments(pairing, u)[0]
    nodes = pairing.master_nodes[pairing.master_facets]
    return {(s, *nodes[m]) for s, m in zip(found.slave.tolist(), found.master, strict=True)}


def candidates(pairing):
    nodes = pairing.master_nodes[pairing.master_facets]
    return {(s, *nodes[m]) for s, m in pairing.pairs.tolist()}


CELLS = pytest.mark.parametrize("cell", ["triangle", "tetrahedron", "hexahedron"])


@CELLS
@pytest.mark.parametrize("partition", ["bodies", "empty"])
def test_a_segment_of_a_pair_that_is_no_candidate_calls_for_a_search(cell, partition):
    """Bodies slide step by step: whenever a fresh search has a segment that is not provided for."""
    pairing, upper = pair_up(cell, partition)
    known, lost = candidates(pairing), []
    direction = np.array([0.8, 0.6, 0.0] if cell != "triangle" else [1.0, 0.0])
    for amount in np.linspace(0.0, 0.7, 8):
        u = slide(pairing, upper, amount * direction)
        fresh = create_pairing(pairing.slave.V, pairing.slave, pairing.master, u, moving=False)
        lost.append(any_rank(COMM, bool(with_segments(fresh, u) - known))[0])
        assert outside_margin(pairing, u) or not lost[-1]
    assert not lost[0]
    assert lost[-1]


@CELLS
def test_one_missing_candidate_is_noticed(cell):
    """Any pair that has a segment, on one rank only: all ranks hear of it."""
    pairing, _ = pair_up(cell)
    used = np.unique(find_segments(pairing, None)[0].pair)
    assert not outside_margin(pairing, None)
    counts = COMM.allgather(len(used))
    rank = int(np.argmax(counts))
    for k in range(0, counts[rank], 5):
        left = np.ones(len(pairing.pairs), dtype=bool)
        if COMM.rank == rank:
            left[used[k]] = False
        assert outside_margin(replace(pairing, pairs=pairing.pairs[left]), None)


@CELLS
@pytest.mark.parametrize("groups", [8, 32])
def test_groups_of_facets_only_cost(cell, groups, monkeypatch):
    """However many cones tell the others what a rank needs: the same candidates."""
    expected = candidates(pair_up(cell)[0])
    monkeypatch.setattr(search, "_GROUPS", groups)
    assert candidates(pair_up(cell)[0]) == expected


def test_equally_covered_nodes_are_chosen_by_place():
    """The one at the largest x, then y; differences of round-off decide nothing."""
    X = np.array([[[0.0, 0, 0], [1 + 1e-15, 0, 0], [1, 1, 0], [0, 1, 0]]])
    noise = np.array([0, 1e-15, -1e-15, 0])
    assert _best_nodes(np.full((1, 4), 0.3) + noise, X)[0] == 2
    assert _best_nodes(np.full((1, 4), 0.3) - noise, 1e-9 * X)[0] == 2
    assert _best_nodes(np.array([[0.3, 0.3, 0.2, 0.1]]), X)[0] == 1
    assert _best_nodes(np.array([[0.3, 0.1, 0.2, 0.301]]), X)[0] == 3
    assert len(_best_nodes(np.zeros((0, 4)), np.zeros((0, 4, 3)))) == 0

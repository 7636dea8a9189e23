# SPDX-License-Identifier: MIT
"""A rank without cells, or without a facet of the interface, takes part like any other."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from tests.cases.meshes import BOTTOM_OF_UPPER, TOP, TOP_OF_LOWER
from tests.cases.pressed_blocks import PressedBlocks

COMM = MPI.COMM_WORLD
pytestmark = pytest.mark.mpi


def pressed(comm, partition, d, kind, law, order=1):
    """Return force, certificate and number of cells of each rank of two blocks pressed together."""
    grids = {2: ((5, 2), (7, 2)), 3: ((2, 3, 1), (3, 2, 1))}[d]
    options = {"n_lower": grids[0], "n_upper": grids[1], "jitter": 0.3, "partition": partition}
    options |= {"cell": "hexahedron"} if d == 3 else {"order": order, "degree": order}
    case = PressedBlocks(comm=comm, d=d, **options)
    interface = kind(case.facets, slave=TOP_OF_LOWER, master=BOTTOM_OF_UPPER)
    problem = case.problem([interface], law={1: dm.Elastic(1000.0, 0.3), 2: law})
    report = dm.newton(problem, rtol=1e-11)
    problem.commit()
    count = case.mesh.topology.index_map(d).size_local
    return np.array(interface.force), report.certificate, comm.allgather(count)


ELASTIC, PLASTIC = dm.Elastic(500.0, 0.2), dm.VonMises(E=1000.0, nu=0.3, Y=2.0, a=100.0)
CASES = {
    "plane contact elastic": (2, dm.Contact, ELASTIC, 1),
    "plane contact curved": (2, dm.Contact, ELASTIC, 2),
    "plane tie plastic": (2, dm.Tie, PLASTIC, 1),
    "space contact plastic": (3, dm.Contact, PLASTIC, 1),
    "space tie elastic": (3, dm.Tie, ELASTIC, 1),
}


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_same_force_with_a_rank_that_has_nothing(case):
    alone, expected, _ = pressed(MPI.COMM_SELF, "graph", *case)
    force, certificate, cells = pressed(COMM, "empty", *case)
    assert COMM.size == 1 or cells[-1] == 0
    assert np.abs(force - alone).max() < 1e-9 * np.abs(alone).max()
    assert certificate.force_balance < 1e-9
    for name in ("left_out_strain", "left_out_work", "left_out_lengths", "rotation"):
        assert getattr(certificate, name) == pytest.approx(getattr(expected, name), rel=1e-6)


def test_operators_with_a_rank_that_has_nothing():
    case = PressedBlocks(n_lower=(4, 2), n_upper=(3, 2), partition="empty")
    V, facets = case.V, case.facets
    mortar = dm.assemble_mortar(V, facets, slave=TOP_OF_LOWER, master=BOTTOM_OF_UPPER)
    assert mortar.gap.getSize() == 5
    assert len(mortar.nodes) == 0 or COMM.size == 1 or COMM.rank < COMM.size - 1
    with pytest.raises(ValueError, match="can never meet"):
        dm.assemble_mortar(V, facets, slave=TOP_OF_LOWER, master=TOP)

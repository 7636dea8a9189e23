# SPDX-License-Identifier: MIT
"""A rank without cells, or without a facet of the interface, takes part like any other."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from tests.cases.meshes import BOTTOM, BOTTOM_OF_UPPER, TOP, TOP_OF_LOWER, two_blocks
from tests.cases.meshes_3d import two_boxes

COMM = MPI.COMM_WORLD
pytestmark = pytest.mark.mpi


def pressed(comm, partition, d, kind, law):
    """Return force, certificate and number of cells of each rank of two blocks pressed together."""
    if d == 2:
        mesh, cells, facets = two_blocks(comm, (5, 2), (7, 2), jitter=0.3, partition=partition)
    else:
        mesh, cells, facets = two_boxes(
            comm, (2, 3, 1), (3, 2, 1), cell="hexahedron", jitter=0.3, partition=partition
        )
    V = fem.functionspace(mesh, ("Lagrange", 1, (d,)))
    bcs = []
    for tag, value in ((BOTTOM, 0.0), (TOP, -0.01)):
        dofs = fem.locate_dofs_topological(V, d - 1, facets.find(tag))
        bcs.append(fem.dirichletbc(np.append(np.zeros(d - 1), value), dofs, V))
    solid = dm.Solid(fem.Function(V), {1: dm.Elastic(1000.0, 0.3), 2: law}, cells)
    interface = kind(facets, slave=TOP_OF_LOWER, master=BOTTOM_OF_UPPER)
    problem = dm.ContactProblem(solid, [interface], bcs=bcs)
    report = dm.newton(problem, rtol=1e-11)
    problem.commit()
    count = mesh.topology.index_map(d).size_local
    return np.array(interface.force), report.certificate, comm.allgather(count)


ELASTIC, PLASTIC = dm.Elastic(500.0, 0.2), dm.VonMises(E=1000.0, nu=0.3, Y=2.0, a=100.0)
CASES = {  # of two values of three things each, all pairs
    "plane contact elastic": (2, dm.Contact, ELASTIC),
    "plane tie plastic": (2, dm.Tie, PLASTIC),
    "space contact plastic": (3, dm.Contact, PLASTIC),
    "space tie elastic": (3, dm.Tie, ELASTIC),
}


@pytest.mark.parametrize(("d", "kind", "law"), CASES.values(), ids=CASES)
def test_same_force_with_a_rank_that_has_nothing(d, kind, law):
    alone, expected, _ = pressed(MPI.COMM_SELF, "graph", d, kind, law)
    force, certificate, cells = pressed(COMM, "empty", d, kind, law)
    assert COMM.size == 1 or cells[-1] == 0
    assert np.abs(force - alone).max() < 1e-9 * np.abs(alone).max()
    assert certificate.force_balance < 1e-9
    for name in ("left_out_strain", "left_out_work", "left_out_lengths", "rotation"):
        assert getattr(certificate, name) == pytest.approx(getattr(expected, name), rel=1e-6)


def test_operators_with_a_rank_that_has_nothing():
    mesh, _, facets = two_blocks(COMM, (4, 2), (3, 2), partition="empty")
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    mortar = dm.assemble_mortar(V, facets, slave=TOP_OF_LOWER, master=BOTTOM_OF_UPPER)
    assert mortar.gap.getSize() == 5
    assert len(mortar.nodes) == 0 or COMM.size == 1 or COMM.rank < COMM.size - 1
    with pytest.raises(ValueError, match="can never meet"):
        dm.assemble_mortar(V, facets, slave=TOP_OF_LOWER, master=TOP)

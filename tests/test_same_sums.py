# SPDX-License-Identifier: MIT
"""Sums over ranks are reproducible to the last bit, whatever the order of messages."""

import time

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx.fem import petsc as fem_petsc
from dolfinx_mortar.algebra.congruence import as_aij
from dolfinx_mortar.algebra.csr import Triplets, add_blocks
from dolfinx_mortar.algebra.parallel import sums_at_nodes
from dolfinx_mortar.solid import term
from tests.cases.block_piles import COMM, STEEL, Blocks

pytestmark = pytest.mark.mpi
TIMES = 30  # one rank is late in each; every second sum of matrices differed when PETSc made them


def check_same(compute):
    """Compare the values (..) of this rank with those of the first time, one rank being late."""
    late, first = np.random.default_rng(1), compute()
    for rank in late.integers(0, COMM.size, TIMES if COMM.size > 1 else 1):
        if COMM.rank == rank:
            time.sleep(0.5e-3)
        same = np.array_equal(compute(), first)
        assert COMM.allreduce(same, op=MPI.LAND)


def dealt_out():
    """A block whose neighbouring cells are on different ranks: nodes get values from all."""
    b = Blocks([(0.0, 2.0, 0.0, 1.0, 7, 4)], partition="dealt out", cell="quadrilateral")
    rng = np.random.default_rng(COMM.rank)
    b.u.x.array[:] = 1e-2 * rng.normal(size=b.u.x.array.size)
    b.u.x.scatter_forward()
    return b


@pytest.mark.parametrize("kind", ["aij", "baij"])
def test_tangents_of_bodies(kind):
    """The form's matrix is that of PETSc's own assembly up to round-off."""
    b = dealt_out()
    solid = dm.Solid(b.u, STEEL)
    K, expected = solid.create_matrix(kind), solid.create_matrix(kind)

    def compute():
        solid.assemble_tangent(K)
        return values_of(K)

    check_same(compute)
    fem_petsc.assemble_matrix(expected, solid.forms.tangent.form)
    expected.assemble()
    scale = expected.norm()
    expected.axpy(-1.0, K)
    assert expected.norm() <= 1e-15 * scale


@pytest.mark.skipif(COMM.size > 1, reason="of one rank")
def test_all_tangents_of_a_rank_have_the_bits_of_petsc(monkeypatch):
    """Also those after the first, added to values on a larger pattern; by one pass, not by it."""
    b = dealt_out()
    solid = dm.Solid(b.u, STEEL)
    K, expected = solid.create_matrix(), solid.create_matrix()
    K.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
    fem_petsc.assemble_matrix(expected, solid.forms.tangent.form)
    expected.assemble()
    solid.assemble_tangent(K)
    first, last = 0, K.getSize()[0] - 1
    for row, column in ((first, last), (last, first)):
        K.setValue(row, column, 0.0)
    K.assemble()
    calls: list[object] = []
    monkeypatch.setattr(term, "add_blocks", lambda *a: (calls.append(a), add_blocks(*a)))
    for _ in range(2):
        solid.assemble_tangent(K)
        difference = K.copy()
        difference.axpy(-1.0, expected, PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
        assert difference.norm() == 0.0
    solid.add_tangent(K)
    assert len(calls) == 3
    K.axpy(-2.0, expected, PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
    assert K.norm() == 0.0


def values_of(K):
    """Return the entries of a matrix."""
    return as_aij(K).getValuesCSR()[2]


def test_products_of_mean_dilatations():
    """Each solid makes its own."""
    b = dealt_out()

    def compute():
        solid = dm.Solid(b.u, STEEL, volumetric="reduced")
        K = solid.create_matrix()
        solid.assemble_tangent(K)
        return values_of(K)

    check_same(compute)


def test_sums_at_nodes():
    """Of numbers from every rank at all nodes; they are the sums."""
    V = dealt_out().V
    layout, rng = V.dofmap.index_map, np.random.default_rng(COMM.rank)
    nodes = rng.permutation(np.repeat(np.arange(layout.size_global), 2))
    values = rng.normal(size=(len(nodes), 2))
    check_same(lambda: sums_at_nodes(COMM, layout, nodes, values))
    dense = np.zeros((layout.size_global, 2))
    np.add.at(dense, nodes, values)
    total, own = COMM.allreduce(dense), slice(*layout.local_range)
    np.testing.assert_allclose(sums_at_nodes(COMM, layout, nodes, values), total[own], atol=1e-12)


def test_sums_of_triplets():
    """Also where PETSc plans the exchange anew."""
    layout, rng = dealt_out().V.dofmap.index_map, np.random.default_rng(COMM.rank)
    rows, columns = rng.integers(0, layout.size_global, (2, 400))
    values = rng.normal(size=400)
    check_same(lambda: Triplets(COMM, layout, rows // 4, columns // 4).sum(values))

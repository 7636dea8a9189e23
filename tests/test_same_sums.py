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
from dolfinx_mortar.algebra.csr import Triplets
from dolfinx_mortar.algebra.parallel import sums_at_nodes
from tests.cases.block_piles import COMM, STEEL, Blocks

pytestmark = pytest.mark.mpi
TIMES = 30  # one rank is late in each; every second sum of matrices differed when PETSc made them


def check_same(compute):
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


def values_of(K):
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
    """Of entries of all ranks, repeated, some zero; also where PETSc plans the exchange anew."""
    layout, rng = dealt_out().V.dofmap.index_map, np.random.default_rng(COMM.rank)
    n = layout.size_global
    rows, columns = (rng.integers(0, n, (2, 400)) // 4).astype(PETSc.IntType)
    given, values = (rows.copy(), columns.copy()), rng.normal(size=400)
    values[columns < 3] = 0.0
    triplets = Triplets(COMM, layout, rows, columns)
    assert (rows == given[0]).all() and (columns == given[1]).all()  # PETSc sorts copies
    check_same(lambda: Triplets(COMM, layout, rows, columns).sum(values))
    dense, count = np.zeros((2, n, n))
    np.add.at(dense, (rows, columns), values)
    np.add.at(count, (rows, columns), 1.0)
    total, count = (COMM.allreduce(a)[slice(*layout.local_range)] for a in (dense, count))
    found = triplets.sum(values)
    assert len(found) == np.count_nonzero(count)  # those that are zero stay
    assert found == pytest.approx(total[triplets.rows, triplets.columns], abs=1e-12)
    assert (triplets.matrix(found).getValuesCSR()[2] == found).all()
    for row in (-1, n):  # PETSc does not look, it would write past the end
        with pytest.raises(AssertionError):
            Triplets(COMM, layout, [row], [0])

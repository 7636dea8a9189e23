# SPDX-License-Identifier: MIT
"""The QP condensed to its bounded unknowns by MUMPS's Schur complement."""

from dataclasses import replace

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest
import scipy.sparse as sp
from programs import from_arrays, gathered, membrane

from dolfinx_mortar.algebra.congruence import CongruentOperator
from dolfinx_mortar.qp import LinearSolver, solve
from dolfinx_mortar.qp.condensed import Condensed, Dense
from dolfinx_mortar.qp.linear import LinearSolveFailed
from dolfinx_mortar.qp.preconditioner import set_apart

COMM, COMM_SELF = MPI.COMM_WORLD, MPI.COMM_SELF


@pytest.mark.mpi
def test_a_solution_depends_on_the_program_alone():
    """Not on other programs that the linear solver has seen before: to the last bit on one rank."""
    qp, other = membrane(16), membrane(16, force=3.0)
    linear = LinearSolver(COMM, prefix="alone_")
    expected = solve(qp, linear=linear)
    solve(other, linear=linear)
    found = solve(qp, linear=linear)
    x, round_off = gathered(expected.x), 0.0 if COMM.size == 1 else 1e-13
    assert np.abs(gathered(found.x) - x).max() <= round_off * np.abs(x).max()
    assert found.linear_iterations == expected.linear_iterations


def assert_condensed(found, A, b, own):
    """S and g of the unknowns with bounds, and x of all for any values of these."""
    qp, rest = found.about(), np.setdiff1d(np.arange(len(A)), own)
    inner = np.linalg.solve(A[np.ix_(rest, rest)], np.c_[A[np.ix_(rest, own)], b[rest]])
    S, g = A[np.ix_(own, own)] - A[np.ix_(own, rest)] @ inner[:, :-1], b[own].copy()
    g -= A[np.ix_(own, rest)] @ inner[:, -1]
    np.testing.assert_allclose(found.dense.S, S, atol=1e-11 * np.abs(S).max())
    np.testing.assert_allclose(qp.b.array_r, g, atol=1e-11 * np.abs(g).max())
    given = np.arange(float(len(own)))
    for start in None, found.expand(given):  # of which round-off is left
        found.about(start)
        x = found.expand(given)
        np.testing.assert_allclose(x[own], given)
        expected = inner[:, -1] - inner[:, :-1] @ given
        np.testing.assert_allclose(x[rest], expected, atol=1e-11 * np.abs(expected).max())


@pytest.mark.mpi
@pytest.mark.parametrize("held_by", [0.0, 1.0], ids=["by contact alone", "by supports"])
def test_one_factorisation_serves_all_products(held_by):
    """Of (I + C)^T K (I + C), for any C on the same unknowns, some of which are decoupled."""
    line = sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(20, 20)).toarray()
    line[0, 0] = line[-1, -1] = 1.0 + held_by
    program = from_arrays(line, *np.zeros((3, 20)), COMM_SELF)
    product, linear = CongruentOperator(program.A), LinearSolver(COMM_SELF, prefix="product_")
    rng, rows, columns = np.random.default_rng(3), [3, 4, 5], [4, 12, 13]
    apart, b = np.union1d(rows, columns).astype(np.int32), program.b
    b.array[:] = rng.normal(size=20)
    bounds = [([3, 5], [4, 9], 1), ([3], [4, 9], 1)]
    for own, out, factorised in [*bounds, ([5], [4, 9], 1), ([5], [4, 9, 15], 2)]:
        C, change = PETSc.Mat().createAIJ((20, 20), nnz=3, comm=COMM_SELF), np.zeros((20, 20))
        change[np.ix_(rows, columns)] = 0.3 * rng.normal(size=(3, 3))
        C.setValues(rows, columns, change[np.ix_(rows, columns)])
        C.assemble()
        product.follow(C, np.array(out, dtype=np.int32))
        A = (np.eye(20) + change).T @ line @ (np.eye(20) + change)
        A[out], A[:, out] = 0.0, 0.0
        A[out, out] = product.scale
        qp = replace(
            program, A=product.matrix, product=product, bounded=np.array(own, dtype=np.int32)
        )
        linear.set_matrix(qp.A, apart=apart, product=product)
        assert_condensed(Condensed(qp, linear, 0.0), A, b.array_r, qp.bounded)
        assert linear.counts.factorisations == factorised


def test_too_many_bounds_are_not_left_for_last():
    """Their complement is dense: at most twice the entries of the matrix itself."""
    qp = membrane(12, comm=MPI.COMM_SELF)
    options = LinearSolver(MPI.COMM_SELF, prefix="many_").options
    few = int(np.sqrt(2 * qp.A.getInfo()["nz_used"]))
    unknowns = np.arange(few + 1, dtype=np.int32)
    assert set_apart(replace(qp, bounded=unknowns[:few]), options) is not None
    assert set_apart(replace(qp, bounded=unknowns), options) is None


def test_a_body_that_contact_alone_holds_has_a_singular_complement(rng):
    """Round-off leaves a pivot that may be positive; the answer would be any number."""
    for _ in range(20):
        weights = np.triu(rng.random((6, 6)), 1)
        weights += weights.T
        laplacian = np.diag(weights.sum(axis=1)) - weights
        dense = Dense(laplacian, np.diag(laplacian))
        b = dense.matrix.createVecRight()
        b.array[:] = rng.random(6)
        with pytest.raises(LinearSolveFailed):
            dense.solve(b, b.duplicate(), np.zeros(0, dtype=np.int32), atol=0.0)

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
from dolfinx_mortar.qp.dense import Condensed, Dense
from dolfinx_mortar.qp.linear import LinearSolveFailed, NotDefinite
from dolfinx_mortar.qp.schur import set_apart

COMM, COMM_SELF = MPI.COMM_WORLD, MPI.COMM_SELF
INF = np.inf


@pytest.mark.mpi
def test_a_solution_depends_on_the_program_alone() -> None:
    """Not on other programs that the linear solver has seen before: to the last bit on one rank.

    On several ranks MUMPS adds up in the order in which messages come.
    """
    qp, other = membrane(16), membrane(16, force=3.0)
    linear = LinearSolver(COMM, prefix="alone_")
    expected = solve(qp, linear=linear)
    solve(other, linear=linear)
    found = solve(qp, linear=linear)
    x, round_off = gathered(expected.x), 0.0 if COMM.size == 1 else 1e-13
    assert np.abs(gathered(found.x) - x).max() <= round_off * np.abs(x).max()
    assert found.linear_iterations == expected.linear_iterations


def test_all_updates_cost_one_factorisation() -> None:
    linear = LinearSolver(COMM_SELF, prefix="one_")
    qp = membrane(48, comm=COMM_SELF)
    solution = solve(qp, linear=linear)
    assert solution.factorisations == 1
    assert solution.linear_iterations <= 3


def _dense(A: PETSc.Mat) -> np.ndarray:
    indptr, columns, values = A.getValuesCSR()
    dense = np.zeros(A.size)
    dense[np.repeat(np.arange(A.size[0]), np.diff(indptr)), columns] = values
    return dense


@pytest.mark.mpi
def test_one_factorisation_serves_all_sets() -> None:
    """With its unknowns apart, S is that of the dense matrix, and a set costs no other one."""
    qp = membrane(12, comm=MPI.COMM_SELF, force=1.0)
    linear = LinearSolver(MPI.COMM_SELF, prefix="apart_")
    apart = set_apart(qp, linear.options)
    assert apart is not None
    linear.set_matrix(qp.A, apart=apart)
    A, x = _dense(qp.A), qp.b.duplicate()
    inside = np.setdiff1d(np.arange(A.shape[0]), apart)
    for held in (apart, apart[::2], apart[:3], apart[:0]):
        x.set(0.0)
        x.array[held] = 1.0
        linear.solve(qp.b, x, held.astype(np.int32), atol=1e-12)
        free = np.setdiff1d(np.arange(A.shape[0]), held)
        right = qp.b.array_r[free] - A[np.ix_(free, held)].sum(axis=1)
        np.testing.assert_allclose(x.array_r[free], np.linalg.solve(A[np.ix_(free, free)], right))
    assert (linear.counts.factorisations, linear.counts.iterations) == (1, 4)
    schur = linear.setup.preconditioner.schur
    assert schur is not None
    coupled = A[np.ix_(apart, inside)]
    expected = A[np.ix_(apart, apart)] - coupled @ np.linalg.solve(
        A[np.ix_(inside, inside)], coupled.T
    )
    np.testing.assert_allclose(schur.S, expected, atol=1e-12 * np.abs(expected).max())


@pytest.mark.mpi
def test_a_set_that_holds_no_body_is_found_in_the_complement() -> None:
    qp = membrane(12, comm=MPI.COMM_SELF, held=False, force=1.0)
    qp.A.shift(-1e-6)  # a singular S has pivots of either sign
    linear = LinearSolver(MPI.COMM_SELF, prefix="loose_")
    linear.set_matrix(qp.A, apart=set_apart(qp, linear.options))
    none = np.zeros(0, dtype=np.int32)
    with pytest.raises(LinearSolveFailed, match="leading minor"):
        linear.solve(qp.b, qp.b.duplicate(), none, atol=0.0)


def assert_solved(A, decoupled, scale, held, b, x) -> None:
    """That x solves A x = b but for what is held; A, dense, loses what is decoupled."""
    A[decoupled], A[:, decoupled] = 0.0, 0.0
    A[decoupled, decoupled] = scale
    free = np.setdiff1d(np.arange(len(A)), held)
    expected = np.linalg.solve(A[np.ix_(free, free)], b.array_r[free])
    np.testing.assert_allclose(x.array_r[free], expected, rtol=1e-9)


@pytest.mark.mpi
@pytest.mark.parametrize("d", [1, 2], ids=["rows refer to rows", "nodes to themselves"])
@pytest.mark.parametrize("held_by", [0.0, 1.0], ids=["by contact alone", "by supports"])
def test_one_factorisation_serves_all_products(held_by: float, d: int) -> None:
    """Of (I + C)^T K (I + C), for any C on the same unknowns, some of which are decoupled.

    Against dense algebra; without supports K is singular, and so is its Schur complement. The rows
    of C refer to each other, or only to those of the same node.
    """
    line = sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(20, 20)).toarray()
    line[0, 0] = line[-1, -1] = 1.0 + held_by
    K = from_arrays(line, *np.zeros((3, 20)), COMM_SELF).A
    product, linear = CongruentOperator(K), LinearSolver(COMM_SELF, prefix="product_")
    K.setBlockSize(d)
    rng, rows, columns = np.random.default_rng(3), [3, 4, 5], [4, 12, 13]
    if d == 2:
        rows, columns = [2, 3, 4, 5], [2, 3, 4, 5, 12, 13]
    apart = np.union1d(rows, columns).astype(np.int32)
    bounded = np.array([3, 5], dtype=np.int32)
    decoupled = np.array([4, 9] if held_by else [4], dtype=np.int32)  # in K 9 alone is fixed
    b, x = K.createVecRight(), K.createVecRight()
    b.array[:] = rng.normal(size=20)
    for held in (bounded, bounded[:1], bounded[1:]):
        dense = np.zeros((20, 20))
        dense[np.ix_(rows, columns)] = 0.3 * rng.normal(size=(len(rows), len(columns)))
        if d == 2:
            dense[2:4, 4:6] = dense[4:6, 2:4] = 0.0
        C = PETSc.Mat().createAIJ((20, 20), nnz=len(columns), comm=COMM_SELF)
        C.setValues(rows, columns, dense[np.ix_(rows, columns)])
        C.assemble()
        product.follow(C, decoupled)
        linear.set_matrix(product.matrix, apart=apart, product=product, bounded=bounded)
        x.set(0.0)
        linear.solve(b, x, held, atol=1e-10)
        T = np.eye(20) + dense
        A = T.T @ line @ T
        assert_solved(A, decoupled, product.scale, held, b, x)
        schur = linear.setup.preconditioner.schur
        assert schur is not None
        assert (schur.R is not None) == (held_by > 0.0)
        rest = np.setdiff1d(np.arange(20), bounded)
        coupled = A[np.ix_(rest, bounded)]
        inner = A[np.ix_(bounded, bounded)]
        inner = inner - coupled.T @ np.linalg.solve(A[np.ix_(rest, rest)], coupled)
        np.testing.assert_allclose(schur.model(), inner, atol=1e-9)
    assert linear.counts.factorisations == 1
    assert linear.counts.iterations == 3


@pytest.mark.mpi
def test_a_body_that_could_nearly_move() -> None:
    """Held on stiff neighbours: the inverse without contact has lost what it needs, S has not."""
    stiffness = np.ones(19)
    stiffness[3:5] = 1e6
    line = np.diag([1e-7, *np.zeros(18), 1e-7])
    for i, k in enumerate(stiffness):
        line[i : i + 2, i : i + 2] += k * np.array([[1.0, -1.0], [-1.0, 1.0]])
    K = from_arrays(line, *np.zeros((3, 20)), COMM_SELF).A
    product, linear = CongruentOperator(K), LinearSolver(COMM_SELF, prefix="nearly_")
    apart, held = (np.array(v, dtype=np.int32) for v in ([3, 4, 5, 12, 13], [3, 5]))
    none = np.zeros(0, dtype=np.int32)
    b, x = K.createVecRight(), K.createVecRight()
    b.array[:] = np.random.default_rng(3).normal(size=20)
    product.follow(None, none)
    linear.set_matrix(product.matrix, apart=apart, product=product, bounded=held)
    x.set(0.0)
    linear.solve(b, x, held, atol=1e-9)
    assert_solved(line, none, product.scale, held, b, x)
    schur = linear.setup.preconditioner.schur
    assert schur is not None and schur.R is None
    assert linear.counts.iterations == 1


@pytest.mark.mpi
def test_products_with_other_bounds_and_supports() -> None:
    """Other bounded unknowns keep the factorisation; other supports elsewhere need a new one."""
    line = sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(20, 20)).toarray()
    K = from_arrays(line, *np.zeros((3, 20)), COMM_SELF).A
    product, linear = CongruentOperator(K), LinearSolver(COMM_SELF, prefix="supports_")
    C = PETSc.Mat().createAIJ((20, 20), nnz=1, comm=COMM_SELF)
    C.setValue(3, 12, 0.3)
    C.assemble()
    T, apart = np.eye(20), np.array([3, 5, 12], dtype=np.int32)
    T[3, 12] = 0.3
    b, x = K.createVecRight(), K.createVecRight()
    b.array[:] = np.random.default_rng(3).normal(size=20)
    for held, out, factorised in ([3], [9], 1), ([5, 12], [9], 1), ([5], [9, 15], 2):
        decoupled, bounded = np.array(out, dtype=np.int32), np.array(held, dtype=np.int32)
        product.follow(C, decoupled)
        linear.set_matrix(product.matrix, apart=apart, product=product, bounded=bounded)
        linear.factorise(bounded)  # unless it is that of this matrix
        x.set(0.0)
        linear.solve(b, x, bounded, atol=1e-10)
        A = T.T @ line @ T
        assert_solved(A, decoupled, product.scale, bounded, b, x)
        assert linear.counts.factorisations == factorised
    assert linear.counts.iterations == 3


@pytest.mark.mpi
def test_a_singular_complement_has_no_inverse() -> None:
    """Whatever sign round-off leaves in its last pivot."""
    rng, held = np.random.default_rng(5), np.array([4], dtype=np.int32)
    apart = np.array([4, 9, 11], dtype=np.int32)
    for _ in range(20):
        springs = rng.random(19)
        line = np.diag(-springs, 1) + np.diag(-springs, -1)
        line -= np.diag(line.sum(axis=1))
        K = from_arrays(line, *np.zeros((3, 20)), COMM_SELF).A
        linear, b = LinearSolver(COMM_SELF, prefix="loose_"), K.createVecRight()
        linear.set_matrix(K, apart=apart)
        b.array[:] = rng.normal(size=20)
        x = b.duplicate()
        linear.solve(b, x, held, atol=1e-9)
        schur = linear.setup.preconditioner.schur
        assert schur is not None and schur.R is None
        free = np.setdiff1d(np.arange(20), held)
        expected = np.linalg.solve(line[np.ix_(free, free)], b.array_r[free])
        np.testing.assert_allclose(x.array_r[free], expected, rtol=1e-8, atol=1e-8)


def test_too_many_bounds_are_not_left_for_last() -> None:
    """Their complement is dense: no more entries than the matrix itself."""
    qp = membrane(12, comm=MPI.COMM_SELF)
    options = LinearSolver(MPI.COMM_SELF, prefix="many_").options
    few = int(np.sqrt(qp.A.getInfo()["nz_used"]))
    unknowns = np.arange(few + 1, dtype=np.int32)
    assert set_apart(replace(qp, bounded=unknowns[:few]), options) is not None
    assert set_apart(replace(qp, bounded=unknowns), options) is None


@pytest.mark.mpi
def test_other_bounds_have_another_complement() -> None:
    """Of the same matrix: held unknowns are among those that the factorisation leaves for last."""
    qp, linear = membrane(12, comm=MPI.COMM_SELF), LinearSolver(MPI.COMM_SELF, prefix="other_")
    for bounded in (qp.bounded[:6], qp.bounded, qp.bounded[3:]):
        none = np.setdiff1d(qp.bounded, bounded)
        lower, upper = qp.lower.copy(), qp.upper.copy()
        lower.array[none], upper.array[none] = PETSc.NINFINITY, PETSc.INFINITY
        other = replace(qp, bounded=bounded, lower=lower, upper=upper)
        alone = solve(other, linear=LinearSolver(MPI.COMM_SELF, prefix="alone_"))
        again = solve(other, linear=linear)
        np.testing.assert_allclose(again.x.array_r, alone.x.array_r, atol=1e-12)
        assert (again.active == alone.active).all()


def test_the_condensed_problem_is_that_of_dense_algebra():
    """S and g of the free unknowns, and x of all for any values of the bounded ones."""
    qp, linear = membrane(12, comm=COMM_SELF, force=1.0), LinearSolver(COMM_SELF, prefix="S_")
    linear.set_matrix(qp.A, apart=qp.held, bounded=qp.held)
    found = Condensed(qp, linear, qp.bounded[:0], np.zeros(0))
    A, G = _dense(qp.A), qp.held
    rest = np.setdiff1d(np.arange(len(A)), G)
    inner = np.linalg.solve(A[np.ix_(rest, rest)], np.c_[A[np.ix_(rest, G)], qp.b.array_r[rest]])
    S, g = A[np.ix_(G, G)] - A[np.ix_(G, rest)] @ inner[:, :-1], qp.b.array_r[G].copy()
    g -= A[np.ix_(G, rest)] @ inner[:, -1]
    np.testing.assert_allclose(found.dense.S, S, atol=1e-11 * np.abs(S).max())
    np.testing.assert_allclose(found.qp.b.array_r, g, atol=1e-11 * np.abs(g).max())
    given = np.arange(float(len(G)))
    x = found.expand(given)
    np.testing.assert_allclose(x[G], given)
    np.testing.assert_allclose(x[rest], inner[:, -1] - inner[:, :-1] @ given, atol=1e-11)


def test_a_body_that_contact_alone_holds_has_a_singular_complement(rng):
    """Round-off leaves a pivot that may be positive; the answer would be any number."""
    for _ in range(20):
        weights = np.triu(rng.random((6, 6)), 1)
        weights += weights.T
        laplacian = np.diag(weights.sum(axis=1)) - weights
        dense = Dense(laplacian, np.diag(laplacian))
        b = dense.matrix.createVecRight()
        b.array[:] = rng.random(6)
        with pytest.raises(NotDefinite):
            dense.solve(b, b.duplicate(), np.zeros(0, dtype=np.int32), atol=0.0)

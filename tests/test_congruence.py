# SPDX-License-Identifier: MIT
"""(I + C)^T K (I + C): the operator that is never formed against the matrix, on any ranks."""

import weakref

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest

from dolfinx import fem
from dolfinx_mortar.algebra.congruence import CongruentOperator, ProductOfBases, as_aij
from dolfinx_mortar.algebra.csr import BlockMatrix, add_blocks
from dolfinx_mortar.algebra.parallel import free_unused
from tests.cases.meshes import two_blocks

COMM = MPI.COMM_WORLD
pytestmark = pytest.mark.mpi


@pytest.fixture(params=[("aij", 2), ("baij", 2), ("baij", 3)])
def matrices(request, rng):
    """A symmetric K in either format, C with blocks in every third row, on nodes of all ranks."""
    kind, d = request.param
    V = fem.functionspace(two_blocks(COMM)[0], ("Lagrange", 1, (d,)))
    layout = V.dofmap.index_map
    n, N = layout.size_local, layout.size_global
    some = np.arange(0, n, 3)
    rows, columns = np.repeat(some, 4), rng.integers(0, N, 4 * len(some))
    C = BlockMatrix(COMM, layout, d, rows, columns)
    C.fill(rng.normal(size=(len(rows), d, d)))
    half = BlockMatrix(COMM, layout, d, np.arange(n), rng.integers(0, N, n))
    half.fill(rng.normal(size=(n, d, d)))
    K = half.matrix.copy()
    K.axpy(1.0, half.matrix.transpose(PETSc.Mat()))
    K.shift(10.0)
    K.setBlockSize(d)
    return K.convert(kind), C.matrix


def decoupled(K):
    return np.arange(1, K.getLocalSize()[0], 5, dtype=np.int32)


def random_vector(K, rng):
    x = K.createVecRight()
    x.array[:] = rng.normal(size=x.local_size)
    return x


def diagonal_by_hand(K, C):
    """Return that of (I + C)^T D (I + C) for the diagonal D of K."""
    alone = as_aij(K).copy()
    alone.zeroEntries()
    alone.setDiagonal(K.getDiagonal())
    return ProductOfBases().fill([alone], [(C, C)]).getDiagonal()


@pytest.mark.parametrize("coupled", [True, False])
def test_operator_is_the_matrix(matrices, coupled, rng):
    """Product and decoupled unknowns, also with new values."""
    K, C = matrices
    C, operator, state = C if coupled else None, CongruentOperator(K), -1
    for held in (decoupled(K), decoupled(K)[1:]):
        operator.follow(C, held)
        assert operator.matrix.stateGet() > state  # PETSc sees that the matrix is another one
        explicit, state = operator.matrix.copy(), operator.matrix.stateGet()
        assert explicit.getType().endswith("aij") and "baij" not in explicit.getType()
        x = random_vector(K, rng)
        y = operator.matrix * x
        assert y.norm() > 1.0
        assert (y - explicit * x).norm() < 1e-13 * y.norm()
        for A in (operator.matrix, explicit):
            assert (A.getDiagonal().array_r[held] == operator.scale).all()
        mean = operator.diagonal.sum() / operator.diagonal.getSize()
        assert operator.scale == pytest.approx(mean, rel=1e-14)
        for A in matrices:
            A.scale(-2.0)


def test_nothing_is_decoupled_in_product(matrices, rng):
    """(I + C)^T K (I + C) x by hand."""
    K, C = matrices
    operator = CongruentOperator(K)
    operator.follow(C, decoupled(K))
    x, y = random_vector(K, rng), K.createVecRight()
    operator.product(x, y)
    moved = K * (x + C * x)
    expected = moved.copy()
    C.multTransposeAdd(moved, moved, expected)
    assert (y - expected).norm() < 1e-14 * y.norm()


def test_the_diagonal_is_that_of_the_diagonal(matrices):
    """Of other values and patterns of C, those with fewer rows included, and other K.

    Terms of K off its diagonal are left out.
    """
    K, C = matrices
    operator = CongruentOperator(K)

    def follow(C):
        operator.follow(C, np.empty(0, dtype=np.int32))
        expected = diagonal_by_hand(K, C)
        assert (operator.diagonal - expected).norm() < 1e-13 * expected.norm()

    follow(C)
    K.scale(2.0)
    C.scale(-0.5)
    follow(C)
    fewer = C.copy()
    first, last = fewer.getOwnershipRange()
    fewer.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
    fewer.zeroRows(np.arange(first, last, 2, dtype=PETSc.IntType), diag=0.0)
    follow(fewer)


def test_nothing_is_kept_alive(matrices):
    """Neither Python nor PETSc counts references in a circle; so a problem is freed at once."""
    K, C = matrices
    operator = CongruentOperator(K)
    operator.follow(C, decoupled(K))
    context = weakref.ref(operator.matrix.getPythonContext())
    assert context() is not None
    del operator
    free_unused(COMM)  # on several ranks PETSc waits until all have let go
    assert context() is None


@pytest.mark.skipif(COMM.size > 1, reason="of matrices on one rank")
def test_what_has_no_place_is_an_error(matrices):
    C = matrices[1]
    with pytest.raises(ValueError, match="no place for a block"):
        add_blocks(C, np.array([0, 1]), np.array([10**6]), np.ones((1, 2, 2)))


def test_products_read_the_upper_half_of_blocks_in_space(matrices):
    """Operators of one K share it."""
    K, C = matrices
    operator = CongruentOperator(K)
    operator.follow(C, decoupled(K))
    factor = operator.half.factor
    half = "baij" in K.getType() and K.getBlockSize() == 3
    assert ("sbaij" in factor.getType()) == half and (half or factor is K)
    assert CongruentOperator(K, operator.half).half.factor is factor

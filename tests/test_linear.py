# SPDX-License-Identifier: MIT
"""Linear solves with held unknowns: options, reuse and renewal of factorisations, failures."""

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest
from programs import membrane

from dolfinx_mortar.qp import (
    MULTIGRID,
    LinearSolveFailed,
    LinearSolver,
    check_options,
)

COMM = MPI.COMM_WORLD
RTOL = 1e-11


@pytest.fixture
def qp():
    program = membrane(24)
    program.b.array[:] = np.cos(1.7 * np.arange(*program.b.getOwnershipRange()))
    return program


@pytest.fixture
def database():
    """PETSc's options, as before after the test."""
    options = PETSc.Options()
    before = options.getAll()
    yield options
    for key in set(options.getAll()) - set(before):
        options.delValue(key)


def none():
    return np.zeros(0, dtype=np.int32)


def solved(linear, qp, held):
    """Solve from zero; return the relative residual on the unknowns that are not held."""
    x = qp.b.duplicate()
    x.set(0.0)
    linear.set_matrix(qp.A)
    linear.solve(qp.b, x, held, atol=RTOL * qp.b.norm())
    r = qp.b - qp.A * x
    r.array[held] = 0.0
    assert np.abs(x.array_r[held]).max(initial=0.0) == 0.0
    return float(r.norm() / qp.b.norm())


@pytest.mark.mpi
def test_held_unknowns_keep_their_values(qp):
    linear = LinearSolver(COMM, prefix="held_")
    linear.set_matrix(qp.A)
    x = qp.b.duplicate()
    x.set(0.0)
    x.array[qp.bounded] = 0.25
    z = linear.solve(qp.b, x, qp.bounded, atol=RTOL * qp.b.norm())
    r = qp.b - qp.A * x
    assert (z.array_r == r.array_r).all()  # the reactions at held unknowns, too
    r.array[qp.bounded] = 0.0
    assert r.norm() <= RTOL * qp.b.norm()
    assert (x.array_r[qp.bounded] == 0.25).all()
    before = linear.counts.iterations
    again = linear.solve(qp.b, x, qp.bounded, atol=RTOL * qp.b.norm(), z=z.copy())
    assert (again.array_r == (qp.b - qp.A * x).array_r).all()
    assert linear.counts.iterations == before  # z says that x solves it


@pytest.mark.mpi
def test_forces_whose_squares_underflow_are_zero(qp):
    """Conjugate gradients cannot reduce them: three ranks left 1e-161 of no load at all."""
    linear = LinearSolver(COMM, prefix="tiny_", options={"ksp_type": "cg", "pc_type": "jacobi"})
    linear.set_matrix(qp.A)
    linear.solve(0.0 * qp.b, 1e-158 * qp.b, none(), atol=0.0)
    assert linear.counts.iterations == 0


@pytest.mark.mpi
def test_a_slightly_changed_matrix_needs_no_factorisation(qp):
    linear = LinearSolver(COMM, prefix="slight_")
    solved(linear, qp, none())
    diagonal = qp.A.getDiagonal()
    diagonal.array[::7] *= 1.0 + 1e-5
    qp.A.setDiagonal(diagonal)
    assert solved(linear, qp, none()) <= RTOL
    assert linear.counts.factorisations == 1
    diagonal.array[::2] *= 3.0
    qp.A.setDiagonal(diagonal)
    before = linear.counts.iterations
    assert solved(linear, qp, none()) <= RTOL
    assert linear.counts.factorisations == 2  # an old one has as many iterations as two cost
    assert linear.counts.iterations - before <= 2 * linear.setup.renewal.after + 2
    assert linear.counts.symbolic == 1


@pytest.mark.parametrize(
    ("options", "method"),
    [
        ({}, "cg + cholesky (mumps)"),
        ({"ksp_type": "preonly"}, "preonly"),
        ({"pc_type": "gamg"}, "gamg"),
        ({"ksp_type": "minres", "pc_type": "jacobi"}, "minres + jacobi"),
    ],
)
def test_other_methods(qp, options, method):
    """Their description outlives the matrix: a report may ask after a search."""
    linear = LinearSolver(COMM, prefix="other_", options=options)
    assert linear.description == "not used yet"
    assert solved(linear, qp, qp.bounded) <= RTOL
    linear.clear()
    assert method in linear.description


def test_options_of_the_user_win_and_ours_leave_no_trace(qp, database):
    database["mine_pc_type"] = "jacobi"
    before = database.getAll()
    linear = LinearSolver(COMM, prefix="mine_", options={"pc_type": "lu", "ksp_type": "minres"})
    solved(linear, qp, none())
    assert linear.description == "minres + jacobi"
    assert database.getAll() == before


@pytest.mark.mpi
@pytest.mark.parametrize("kept", [False, True])
def test_too_small_a_workspace_is_enlarged(database, kept):
    """But not one that the database keeps small: that is an error."""
    qp, options = membrane(60), {"mat_mumps_icntl_14": -70}
    qp.b.set(1.0)
    if kept:
        database["small_mat_mumps_icntl_14"] = -70
    linear = LinearSolver(COMM, prefix="small_", options={} if kept else options)
    if kept:
        with pytest.raises(LinearSolveFailed, match="database has -small_mat_mumps_icntl_14"):
            solved(linear, qp, none())
        assert linear.counts.factorisations == 1
    else:
        assert solved(linear, qp, none()) <= RTOL
        assert linear.setup.ksp.getPC().getFactorMatrix().getMumpsIcntl(14) > 0


@pytest.mark.mpi
@pytest.mark.parametrize("pc", ["cholesky", "lu"])
def test_a_singular_matrix_is_an_error(pc):
    qp = membrane(12, held=False)
    qp.b.set(1.0)
    with pytest.raises(LinearSolveFailed, match="nothing holds a body") as caught:
        solved(LinearSolver(COMM, prefix="singular_", options={"pc_type": pc}), qp, none())
    assert "choose a factorisation" not in str(caught.value)  # it is one


@pytest.fixture
def indefinite():
    """Tridiagonal matrix (64, 64) with eigenvalues 1.5 - 2 cos(i pi / 65), on this rank alone."""
    A = PETSc.Mat().createAIJ((64, 64), nnz=3, comm=MPI.COMM_SELF)
    for i in range(64):
        columns = [j for j in (i - 1, i, i + 1) if 0 <= j < 64]
        A.setValues(i, columns, [1.5 if j == i else -1.0 for j in columns])
    A.assemble()
    return A


def test_multigrid_of_an_indefinite_matrix(indefinite):
    """Estimates of eigenvalues read what was written alone: a set-up ends alike on all ranks."""
    linear = LinearSolver(MPI.COMM_SELF, prefix="estimate_", multigrid=True)
    linear.set_matrix(indefinite)
    linear.factorise(none())
    assert linear.negative_pivots() > 0


def test_multigrid_after_a_set_up_that_failed(indefinite):
    """Conjugate gradients cannot estimate eigenvalues of the first matrix."""
    options = {"pc_gamg_esteig_ksp_type": "cg"}
    linear = LinearSolver(MPI.COMM_SELF, prefix="again_", options=options, multigrid=True)
    linear.set_matrix(indefinite)
    with pytest.raises(LinearSolveFailed):
        linear.factorise(none())
    indefinite.shift(1.5)
    linear.factorise(none())


# -- options


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"ksp_type": "nonsense"}, "nonsense"),
        ({"pc_type": "no_such_type"}, "no_such_type"),
        ({"pc_factor_mat_solver_type": "no_such_package"}, "no_such_package"),
        ({"ksp_rtol": "small"}, "small"),
        ({"ksp_max_it": [3]}, r"'ksp_max_it': \[3\]"),
        ({3: "cg"}, "3: 'cg'"),
        ({"-pc_type": "lu"}, "no dash"),
        ("pc_type lu", "give a dictionary"),
    ],
)
def test_options_that_cannot_work_are_refused_at_once(options, message, database):
    before = database.getAll()
    with pytest.raises(ValueError, match=f"petsc_options.*{message}"):
        LinearSolver(COMM, prefix="refused_", options=options)
    assert database.getAll() == before


@pytest.mark.mpi
def test_options_wrong_on_one_rank_are_refused_on_all():
    last = COMM.rank == COMM.size - 1
    with pytest.raises(ValueError, match="no_such_type" if last else "on rank"):
        check_options(COMM, "one_", {"pc_type": "no_such_type" if last else "lu"})


@pytest.mark.mpi
@pytest.mark.parametrize("method", [{}, MULTIGRID, {"pc_type": "jacobi"}])
def test_options_that_nobody_asks_for_are_named(qp, method):
    typed = {"ksp_tipe": "cg", "mat_mumps_icnt_14": 30, "ksp_max_it": 377}
    linear = LinearSolver(COMM, prefix="typed_", options=method | typed)
    solved(linear, qp, none())
    assert linear.options.unread() == ["ksp_tipe", "mat_mumps_icnt_14"]


@pytest.mark.mpi
@pytest.mark.parametrize("typed", [True, False])
def test_the_limit_of_iterations_is_an_option(qp, database, typed):
    """Of the caller, or in the database, which wins."""
    options = {"pc_type": "none", "ksp_max_it": 5 if typed else 400}
    if not typed:
        database["limit_ksp_max_it"] = 5
    linear = LinearSolver(COMM, prefix="limit_", options=options)
    with pytest.raises(LinearSolveFailed, match=r"the residual is.*choose a factorisation"):
        solved(linear, qp, none())
    assert linear.setup.max_iterations == 5 and linear.counts.iterations <= 10
    assert linear.options.unread() == []


def test_options_of_methods_that_are_used_are_not_named(qp):
    """Also those that PETSc reads at a set-up only; our own defaults are nobody's mistake."""
    for in_space in (False, True):  # before anything is solved
        assert LinearSolver(COMM, prefix="no_", multigrid=in_space).options.unread() == []
    options = {"mat_mumps_icntl_14": 30, "mat_mumps_icntl_7": 2}
    direct = LinearSolver(COMM, prefix="direct_", options=MULTIGRID | {"pc_type": "lu"} | options)
    options = {"mg_levels_ksp_type": "chebyshev", "mg_levels_pc_type": "jacobi"}
    multigrid = LinearSolver(COMM, prefix="levels_", options=MULTIGRID | options)
    for linear in (direct, multigrid):
        solved(linear, qp, none())
        assert linear.options.unread() == []

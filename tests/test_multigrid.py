# SPDX-License-Identifier: MIT
"""Contact in 3D by conjugate gradients and multigrid: the basis, the answer, the failures."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx_mortar.algebra.congruence import Congruence
from tests.ball_case import create_problem

COMM = MPI.COMM_WORLD


@pytest.fixture(scope="module")
def solved():
    """A solved problem, with the default solver."""
    problem, contact = create_problem()
    return problem, contact, dm.newton(problem)


def random_vector(problem):
    v = problem.K.createVecRight()
    v.array[:] = np.random.default_rng(COMM.rank).standard_normal(v.local_size)
    return v


def test_default_is_multigrid_and_the_report_says_so(solved):
    report = solved[2]
    assert "cg" in report.linear_solver and "gamg" in report.linear_solver
    assert report.factorisations == 1


def test_change_of_basis_is_undone(solved):
    problem = solved[0]
    y = random_vector(problem)
    u = y.duplicate()
    problem.system.transformation.apply(y, u)
    back = problem.system.transformation.inverse(u)
    back.axpy(-1.0, y)
    assert back.norm() < 1e-12 * y.norm()


def test_released_basis_is_consistent(solved):
    """Energies in both unknowns agree for y = (I - E) v; motions are the same displacements."""
    problem = solved[0]
    held = (3 * np.flatnonzero(problem.committed.active)).astype(np.int32)
    motion = random_vector(problem)
    T = problem.system.transformation
    C, E = T.uncouple(held)
    A, B = T.transform(problem.K), Congruence(problem.K, C).product
    for v in (random_vector(problem), T.uncoupled(motion, E)):
        y = v.copy()
        y.axpy(-1.0, E * v)
        assert v.dot(B * v) == pytest.approx(y.dot(A * y), rel=1e-11)
    back = y.duplicate()
    T.apply(y, back)
    back.axpy(-1.0, motion)
    assert back.norm() < 1e-12 * motion.norm()


@pytest.mark.parametrize("slave", ["block", "ball"])
def test_iterative_and_direct_solvers_agree(slave):
    forces, u = [], []
    for options in ({}, {"pc_type": "cholesky"}):
        problem, contact = create_problem(slave=slave, petsc_options=options)
        dm.newton(problem)
        forces.append(contact.force)
        u.append(problem.u.x.array.copy())
    assert np.allclose(forces[0], forces[1], rtol=0, atol=1e-7 * np.abs(forces[1]).max())
    size = COMM.allreduce(np.abs(u[1]).max(), op=MPI.MAX)
    assert np.allclose(u[0], u[1], rtol=0, atol=1e-8 * size)


@pytest.mark.parametrize("backend", ["interior-point", "tron"])
def test_other_backends_agree(backend, solved):
    problem, contact = create_problem()
    dm.newton(problem, qp=backend)
    assert np.allclose(contact.force, solved[1].force, rtol=1e-6, atol=1e-6)


def test_iterations_do_not_grow_with_the_mesh():
    counts = []
    for h in (0.5, 0.25):
        report = dm.newton(create_problem(h=h)[0])
        counts.append((report.qp_iterations, report.iterations[0].linear_iterations))
    assert counts[1][0] <= counts[0][0] + 2
    assert counts[1][1] <= 1.6 * counts[0][1]


def test_plastic_step_reuses_the_set_up():
    law = dm.VonMises(E=206_900.0, nu=0.29, Y=450 * np.sqrt(2 / 3), a=10_000.0)
    report = dm.newton(create_problem(law=law)[0])
    assert report.newton_iterations > 3
    assert report.factorisations < report.newton_iterations


def test_stagnating_solver_is_named():
    """A preconditioner that does nothing within a few iterations gives an error, not an answer."""
    problem, _ = create_problem(petsc_options={"pc_type": "none"})
    problem.linear.max_iterations = 5
    with pytest.raises(dm.NewtonNotConverged, match=r"residual is .* iterations"):
        dm.newton(problem)
    assert np.abs(problem.u.x.array).max(initial=0.0) == 0.0

# SPDX-License-Identifier: MIT
"""Unsymmetric and indefinite matrices, and the functions that use `BoundQP.definite`."""

from dataclasses import replace

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest
from programs import from_arrays, gathered, membrane

from dolfinx_mortar.qp import (
    LinearSolver,
    QPNotSolved,
    UnusableQP,
    solve,
)
from dolfinx_mortar.qp import operator as operators
from dolfinx_mortar.qp.operator import Operator

COMM = MPI.COMM_WORLD
INF = np.inf
N = 40

pytestmark = pytest.mark.mpi


def unsymmetric(rng):
    """Diffusion with a wind: an M-matrix, for which the conditions have one solution."""
    wind = 0.6
    A = 2.1 * np.eye(N) - (1 + wind) * np.eye(N, k=-1) - (1 - wind) * np.eye(N, k=1)
    upper = np.where(np.arange(N) % 3, INF, np.where(np.arange(N) < N // 2, rng.random(N), 50.0))
    return A, 0.2 * np.ones(N), upper


def indefinite(rng):
    """Negative diagonal entries of both kinds of unknowns, and zeros."""
    half = N // 2
    A = np.zeros((N, N))
    A[:half, :half] = -np.eye(half)
    A[:2, :2] = [[0.0, -1.0], [-1.0, 0.0]]
    own, coupling = np.full(half, -0.5), np.full(half, 1.5)
    own[:3], coupling[:2] = (3.0, 3.0, 0.0), 0.1
    A[half:, half:] = np.diag(own)
    A[:half, half:] = np.diag(coupling) + 0.05 * rng.standard_normal((half, half))
    A[half:, :half] = A[:half, half:].T
    upper = np.where(np.arange(N) < half, INF, 0.1)
    return A, rng.standard_normal(N), upper


def spread(A, b, upper):
    return replace(from_arrays(A, b, np.full(N, -INF), upper, COMM), definite=False)


@pytest.mark.parametrize("make", [unsymmetric, indefinite])
@pytest.mark.parametrize("options", [{}, {"pc_type": "none"}])
def test_the_conditions_hold(make, options, rng):
    """By LU and GMRES without being asked; both bounds that are active and open ones."""
    A, b, upper = make(rng)
    linear = LinearSolver(COMM, prefix="general_", options=options)
    found = solve(spread(A, b, upper), linear=linear, rtol=1e-12)
    x = gathered(found.x)
    z, some = b - A @ x, np.isfinite(upper)
    assert np.abs(z[~some]).max() < 1e-10
    assert z[some].min() > -1e-10 and (upper - x)[some].min() > -1e-10
    assert np.abs(z[some] * (upper - x)[some]).max() < 1e-10
    assert z[some].max() > 1e-3 < (upper - x)[some].max()
    assert linear.description == f"gmres + {'none' if options else 'lu (mumps)'}"


def test_one_solver_takes_both_kinds(rng):
    """The same matrix, said to be definite or not; Cholesky would read half of the other one."""
    qp, linear = membrane(8), LinearSolver(COMM, prefix="both_")
    expected = gathered(solve(qp, linear=linear).x)
    assert linear.description == "cg + cholesky (mumps)"
    found = solve(replace(qp, definite=False), linear=linear)
    assert linear.description == "gmres + lu (mumps)"
    np.testing.assert_allclose(gathered(found.x), expected, atol=1e-9)
    solve(qp, linear=linear)
    assert linear.description == "cg + cholesky (mumps)"


def test_what_needs_a_definite_matrix_says_so(rng):
    A, b, upper = indefinite(rng)
    with pytest.raises(ValueError, match=r"'interior-point'.*definite matrix.*'active-set'"):
        solve(spread(A, b, upper), "interior-point")
    with pytest.raises(UnusableQP, match="entries <= 0"):
        solve(replace(spread(A, b, upper), definite=True))
    falling = from_arrays(-np.eye(3), -np.ones(3), np.full(3, -INF), np.zeros(3), COMM)
    with pytest.raises(QPNotSolved, match=r"came back.*open and close in turn: refine the mesh"):
        solve(replace(falling, definite=False))  # z = -1 where closed, x = 1 where open


@pytest.mark.parametrize("lowest", [-1.0, -1e-3, 1e-3])
def test_conjugate_gradients_meet_a_negative_eigenvalue(lowest, monkeypatch):
    """One of a thousand, the others from 1 to 2; not if they stop too early."""
    values = 1.0 + np.arange(1000) / 1000
    values[333] = lowest
    qp = from_arrays(np.diag(values), *np.zeros((3, 1000)), COMM)
    operator, pc = Operator(qp.A, copied=False, definite=True), PETSc.PC().create(COMM)
    pc.setType("none")
    pc.setOperators(operator.matrix)
    operator.hold(np.zeros(0, dtype=np.int32))
    for resolved, met in ((0.005, lowest < 0.0), (0.02, lowest < 0.0), (3.0, False)):
        monkeypatch.setattr(operators, "RESOLVED", resolved)
        assert operators.meets_negative_curvature(operator, pc, 1000) == met


@pytest.mark.parametrize(("entries", "count"), [((1.0, 2.0), 0), ((1.0, -2.0), 1), ((1.0, 0.0), 1)])
def test_a_singular_matrix_counts_as_one_negative_eigenvalue(entries, count):
    """A pivot of 0 fails the factorisation, which has no negative ones to count then."""
    ends = np.ones(N)
    ends[: len(entries)] = entries
    qp = spread(np.diag(ends), np.zeros(N), np.full(N, INF))
    assert operators.count_negative(qp.A) == count

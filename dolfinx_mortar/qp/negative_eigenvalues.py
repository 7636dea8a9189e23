# SPDX-License-Identifier: MIT
"""Whether a symmetric matrix has negative eigenvalues, by the data of a linear solver.

A factorisation by MUMPS for symmetric matrices counts them (Sylvester's law of inertia). Other
factorisations do not, so that one more is made. Conjugate gradients meet a negative curvature: of a
random vector b every eigenvector has a part of about |b| / sqrt(n), which the residual keeps until
the iteration has resolved its eigenvalue, whatever the symmetries of loads are. For that the
preconditioner has to be positive: the factorisation of multigrid's coarsest level, P^T A P,
inverts a negative eigenvalue and hides it, and is asked itself.
"""

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.qp.operator import Operator

# Of |b| / sqrt(n): what is left of the part along an eigenvector that has been resolved. With a
# chance of 0.8 % the part is smaller from the start (a normal variable below 0.01). Of 480 runs (4
# matrices, 3 preconditioners, 4 lowest eigenvalues) 1e-4 to 0.1 meet all, in the same iterations,
# 0.3 misses 1 %, 1 5 %, 3 21 %. Where there is none to meet, 0.1 saves a tenth of the iterations.
RESOLVED = 0.01


def counts_pivots(pc: PETSc.PC) -> bool:
    """Tell whether a factorisation counts its negative pivots."""
    return bool(pc.getType() == "cholesky" and pc.getFactorSolverType() == "mumps")


def negative_pivots(pc: PETSc.PC) -> int:
    """Return how many pivots of a symmetric factorisation by MUMPS are negative, INFOG(12).

    0 of other methods.
    """
    return int(pc.getFactorMatrix().getMumpsInfog(12)) if counts_pivots(pc) else 0


def count_negative(A: PETSc.Mat) -> int:
    """Return the number of negative eigenvalues of a symmetric matrix, factorising it; collective.

    A singular matrix counts as one that has one. The same on all ranks, which may see other reasons
    of a failure.
    """
    pc = PETSc.PC().create(A.comm)
    try:
        pc.setType(PETSc.PC.Type.CHOLESKY)
        pc.setFactorSolverType(PETSc.Mat.SolverType.MUMPS)
        pc.setOperators(A)
        pc.setUp()
        found = 1 if pc.getFailedReason() else negative_pivots(pc)
        return int(A.comm.tompi4py().allreduce(found, op=MPI.MAX))
    finally:
        pc.destroy()


def meets_negative_curvature(operator: Operator, pc: PETSc.PC, max_it: int) -> bool:
    """Tell whether conjugate gradients for a random vector meet x.A x <= 0; collective.

    Args:
        operator: A and the unknowns that are held.
        pc: a positive definite preconditioner.
    """
    comm = operator.A.comm.tompi4py()
    x, b = operator.A.createVecs()
    b.array[:] = np.random.default_rng(comm.rank).standard_normal(b.local_size)
    b.array[operator.free.held] = 0.0
    free = comm.allreduce(b.local_size - len(operator.free.held), op=MPI.SUM)
    ksp = PETSc.KSP().create(operator.A.comm)
    try:
        ksp.setType(PETSc.KSP.Type.CG)
        ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        ksp.setPC(pc)
        ksp.setOperators(operator.matrix)
        ksp.setTolerances(rtol=RESOLVED / np.sqrt(max(free, 1)), atol=0.0, max_it=max_it)
        ksp.solve(b, x)
        return bool(ksp.getConvergedReason() == PETSc.KSP.ConvergedReason.DIVERGED_INDEFINITE_MAT)
    finally:
        ksp.destroy()

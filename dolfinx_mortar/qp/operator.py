# SPDX-License-Identifier: MIT
"""The matrix of a linear system with fixed unknowns and slipping nodes, and its residuals.

Negative eigenvalues are counted by MUMPS (Sylvester's law of inertia). With multigrid, conjugate
gradients for a random b find one: its eigenvector's part of b, about |b| / sqrt(n), remains until
it is resolved.
"""

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.congruence import ContextOf, decouple
from dolfinx_mortar.common.arrays import ROUND_OFF, UNDERFLOW, Floats, Ints
from dolfinx_mortar.qp.bound_qp import Sliding

# Part of |b| / sqrt(n): 1e-4 to 0.1 found all negative eigenvalues.
RESOLVED = 0.01


class Operator:
    """A with fixed unknowns.

    A factorisation takes a copy of A with zeroed rows and columns, on the same pattern; an
    iteration applies A, to vectors that vanish at fixed unknowns.

    Attributes:
        matrix: A on free unknowns, without a copy: with slipping nodes the derivative of r.
        factorised: without slipping nodes, A itself or the copy.
        held: owned local indices of fixed unknowns, ascending.
        sliding: law of slipping nodes, or None.
        z: b - A x of the last residual.
        r: the same, 0 at fixed unknowns, and the error in the law at slipping nodes.
    """

    def __init__(self, A: PETSc.Mat, *, copied: bool, definite: bool) -> None:
        self.A, self.definite, self.copied = A, definite, copied
        self.held: Ints = np.empty(0, dtype=np.int32)
        self.sliding: Sliding | None = None
        self.z, self.r = A.createVecRight(), A.createVecRight()
        self._diagonal = A.getDiagonal()
        self._state = -1  # of A at the last hold
        self._added: tuple[Ints, Floats] = self.held, np.zeros(0)  # see `Sliding`
        self._changes = 0  # of what is added
        self.matrix = PETSc.Mat().createPython(A.getSizes(), ContextOf(self), A.comm)
        self.factorised = A.duplicate(copy=True) if copied else A
        if copied:
            self.factorised.setOption(PETSc.Mat.Option.SPD, definite)
            self.factorised.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)

    @property
    def state(self) -> int:
        """Changes with the values of A, and with what yielding bounds add."""
        return int(self.A.stateGet()) + (self._changes << 32)

    def hold(self, held: Ints) -> None:
        """Fix these unknowns of the present A (collective)."""
        comm, added = self.A.comm.tompi4py(), self._added
        if self.copied:
            added = (self.held[:0], np.zeros(0)) if self.sliding is None else self.sliding.added
            alike = all(np.array_equal(added[i], self._added[i]) for i in (0, 1))
            self._changes += not comm.allreduce(alike, op=MPI.LAND)
        same = self._state == self.state and np.array_equal(self.held, held)
        if comm.allreduce(same, op=MPI.LAND):
            return
        self.A.getDiagonal(self._diagonal)
        if self.copied:
            self.A.copy(self.factorised, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
            decouple(self.factorised, held, self._diagonal.sum() / self._diagonal.getSize())
            diagonal = self.factorised.getDiagonal()
            diagonal.array[added[0]] += added[1]
            self.factorised.setDiagonal(diagonal)
        self.held, self._added, self._state = held.copy(), added, self.state

    # called by PETSc

    def mult(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Set y, zero at fixed unknowns."""
        self.A.mult(x, y)
        if self.sliding is not None:
            self.sliding.add(x.array_r, y.array)
        y.array[self.held] = 0.0

    def residual(
        self, b: PETSc.Vec, x: PETSc.Vec, held: Ints, z: PETSc.Vec | None = None
    ) -> PETSc.Vec:
        """`r`, from z = b - A x if known; the next call reuses the vector."""
        if z is None:
            self.A.mult(x, self.z)
            self.z.aypx(-1.0, b)
        else:
            z.copy(self.z)
        self.z.copy(self.r)
        if (sliding := self.sliding) is not None:
            values, law = self.z.array_r, sliding.law
            law.put(self.r.array, law.pick(values) - sliding.reaction(x.array_r, values))
        self.r.array[held] = 0.0
        return self.r

    def round_off(self, x: PETSc.Vec) -> float:
        """Round-off of A x."""
        scaled = x.duplicate()
        scaled.pointwiseMult(self._diagonal, x)
        if self.sliding is not None:
            rows, more = self.sliding.added
            scaled.array[rows] += more * x.array_r[rows]
        return max(ROUND_OFF * scaled.norm(), UNDERFLOW)

    def clear(self) -> None:
        """Free the matrices."""
        self.matrix.destroy()
        if self.copied:
            self.factorised.destroy()


def negative_pivots(pc: PETSc.PC) -> int | None:
    """Negative pivots of a Cholesky factorisation by MUMPS, INFOG(12), else None."""
    if pc.getType() != "cholesky" or pc.getFactorSolverType() != "mumps":
        return None
    return int(pc.getFactorMatrix().getMumpsInfog(12))


def count_negative(A: PETSc.Mat) -> int:
    """Number of negative eigenvalues, 1 if A is singular; collective."""
    pc = PETSc.PC().create(A.comm)
    try:
        pc.setType(PETSc.PC.Type.CHOLESKY)
        pc.setFactorSolverType(PETSc.Mat.SolverType.MUMPS)
        pc.setOperators(A)
        pc.setUp()
        found = 1 if pc.getFailedReason() else negative_pivots(pc) or 0
        return int(A.comm.tompi4py().allreduce(found, op=MPI.MAX))
    finally:
        pc.destroy()


def meets_negative_curvature(operator: Operator, pc: PETSc.PC, max_it: int) -> bool:
    """Whether conjugate gradients find x.A x <= 0; collective."""
    comm = operator.A.comm.tompi4py()
    x, b = operator.A.createVecs()
    b.array[:] = np.random.default_rng(comm.rank).standard_normal(b.local_size)
    b.array[operator.held] = 0.0
    free = comm.allreduce(b.local_size - len(operator.held))
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

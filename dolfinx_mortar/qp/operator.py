# SPDX-License-Identifier: MIT
"""The matrix of a linear system, some unknowns held or sliding: residuals, round-off, masks."""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.congruence import decouple
from dolfinx_mortar.arrays import Floats, Ints
from dolfinx_mortar.qp.bound_qp import EPS, ROUND_OFF
from dolfinx_mortar.qp.friction import Sliding
from dolfinx_mortar.qp.multigrid import FreePart


class Operator:
    """A with unknowns held, as PETSc's linear solver sees it.

    With a factorisation it is a copy of A whose rows and columns are zeroed with the pattern kept,
    so that nothing is allocated and the symbolic factorisation lives as long as the pattern;
    otherwise A itself is applied, and its rows at held unknowns are left out.

    Args:
        A: the matrix.
        direct: whether it is to be factorised.
        definite: whether A is symmetric and positive definite, see `BoundQP`.

    Attributes:
        A: the matrix.
        definite: as above.
        matrix: what is solved with, and what the factorisation is of.
        sliding_matrix: A with the rows of slipping nodes as their law has them.
        held: owned local indices of held unknowns, ascending; None before the first.
        z: b - A x of the last residual.
        r: the same with zeros at held unknowns, and what is missing of the law at slipping nodes.
    """

    def __init__(self, A: PETSc.Mat, *, direct: bool, definite: bool) -> None:
        """Make what is solved with; nothing is held yet."""
        self.A, self.definite = A, definite
        self.held: Ints | None = None
        self.z, self.r = A.createVecRight(), A.createVecRight()
        self._diagonal = A.getDiagonal()
        self._state = -1  # of A when it was masked last
        self._free = None if direct else FreePart(A)
        if self._free is None:
            self.matrix = A.duplicate(copy=True)
            self.matrix.setOption(PETSc.Mat.Option.SPD, definite)
            self.matrix.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        else:
            self.matrix = PETSc.Mat().createPython(A.getSizes(), self._free, A.comm)
        self.sliding: Sliding | None = None
        self._slippery = SlipperyPart(A)
        self.sliding_matrix = PETSc.Mat().createPython(A.getSizes(), self._slippery, A.comm)

    @property
    def state(self) -> int:
        """A number that changes with the values of A."""
        return int(self.A.stateGet())

    @property
    def diagonal(self) -> Floats:
        """Owned diagonal of A."""
        return np.asarray(self._diagonal.array_r)

    def hold(self, held: Ints) -> None:
        """Hold these unknowns, of the present A (collective)."""
        same = self.held is not None and np.array_equal(self.held, held)
        comm = self.A.comm.tompi4py()
        if self._state == self.state and comm.allreduce(same, op=MPI.LAND):
            return
        self.A.getDiagonal(self._diagonal)
        if self._free is None:
            self.A.copy(self.matrix, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
            decouple(self.matrix, held)
        else:
            self._free.held = held
        self._slippery.held = held
        self.held, self._state = held.copy(), self.state

    def slide(self, sliding: Sliding | None) -> None:
        """Say which nodes slip, before it is said what is held; on all ranks or on none."""
        self.sliding = self._slippery.sliding = sliding

    def residual(self, b: PETSc.Vec, x: PETSc.Vec, held: Ints) -> PETSc.Vec:
        """Return b - A x as `r` has it; the next call reuses the vector."""
        self.A.mult(x, self.z)
        self.z.aypx(-1.0, b)
        return self._missing(x, held)

    def take(self, z: PETSc.Vec, x: PETSc.Vec) -> PETSc.Vec:
        """Return the same from b - A x that is at hand."""
        assert self.held is not None
        z.copy(self.z)
        return self._missing(x, self.held)

    def _missing(self, x: PETSc.Vec, held: Ints) -> PETSc.Vec:
        self.z.copy(self.r)
        if self.sliding is not None:
            z, law = self.z.array_r, self.sliding.law
            law.put(self.r.array, law.pick(z) - self.sliding.reaction(x.array_r, z))
        self.r.array[held] = 0.0
        return self.r

    def round_off(self, x: PETSc.Vec) -> float:
        """Return the round-off of A x, the smallest residual that can be expected."""
        scaled = x.duplicate()
        scaled.pointwiseMult(self._diagonal, x)
        return float(ROUND_OFF * EPS * scaled.norm())

    def destroy(self) -> None:
        """Free the copy."""
        self.matrix.destroy()
        self.sliding_matrix.destroy()


class SlipperyPart:
    """Context of a PETSc Mat of type python: the derivative of `Operator.r` for changes of x.

    For vectors that vanish at held unknowns; not symmetric.
    """

    def __init__(self, A: PETSc.Mat) -> None:
        """Hold nothing, and let nothing slip."""
        self.A = A
        self.held: Ints = np.empty(0, dtype=np.int32)
        self.sliding: Sliding | None = None

    def mult(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Set y to the product (called by PETSc)."""
        self.A.mult(x, y)
        if self.sliding is not None:
            self.sliding.add(x.array_r, y.array)
        y.array[self.held] = 0.0

# SPDX-License-Identifier: MIT
"""Linear systems with some unknowns held, and the reuse of factorisations among them."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from time import perf_counter
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.arrays import Ints
from dolfinx_mortar.qp.bound_qp import EPS, ROUND_OFF
from dolfinx_mortar.qp.friction import Sliding
from dolfinx_mortar.qp.multigrid import Unknowns
from dolfinx_mortar.qp.operator import Operator
from dolfinx_mortar.qp.options import SolverOptions, check_options
from dolfinx_mortar.qp.preconditioner import LinearCounts, Preconditioner
from dolfinx_mortar.qp.renewal import REFACTOR_AFTER, SETUP_AFTER, Renewal, SlownessTest
from dolfinx_mortar.qp.updates import LIMIT

log = logging.getLogger(__name__)

MAX_ITERATIONS = 500
# Unknowns of which a factorisation in 3D may replace multigrid: 219 thousand of hexahedra take
# 4.1 GiB and 25 s (117 thousand 2.1 GiB and 10 s; MUMPS, one rank).
MOST_FACTORISED = 200_000
# A well-posed stiffness matrix loses up to 6 to 8 digits; one that loses 12 is singular.
SINGULAR_LOSS = 1e-4


class LinearSolveFailed(RuntimeError):
    """A linear system could not be solved; the message has the reason and the remedy."""


@dataclass(frozen=True)
class Attached:
    """What belongs to one matrix, and goes with it."""

    operator: Operator
    ksp: PETSc.KSP
    sliding_ksp: PETSc.KSP  # of matrices that friction makes unsymmetric
    preconditioner: Preconditioner
    renewal: Renewal
    max_iterations: int  # of one run of an iteration
    dx: PETSc.Vec  # (n,) the last correction

    def destroy(self) -> None:
        """Free the matrices and the factorisation; collective."""
        self.preconditioner.clear()
        self.ksp.destroy()
        self.sliding_ksp.destroy()
        self.operator.destroy()


class LinearSolver:
    """Solve A_ff x_f = b_f - A_fc x_c for changing sets c of held unknowns and changing A.

    The numeric factorisation of an earlier set or an earlier A preconditions conjugate gradients;
    it is renewed as soon as the observed convergence promises that this is cheaper (`Renewal`).

    Args:
        comm: communicator of the matrices.
        prefix: prefix of all PETSc options of this solver.
        options: PETSc options without prefix over the defaults (CG with MUMPS Cholesky, or GMRES
            with LU for matrices that are not definite); what the user's options database has under
            the prefix wins.
        multigrid: precondition with it by default.
        unknowns: those in which multigrid works, for solvers that are not direct; by default those
            of the matrix.
        refactor_after: iterations that cost as much as a new factorisation or set-up; measured
            values by default.

    Attributes:
        options: the PETSc options.
        unknowns: as above.
        counts: what it has done so far.
        description: name of the last method in use, for reports.

    Raises:
        ValueError: for options that PETSc cannot use, on all ranks.
    """

    def __init__(
        self,
        comm: MPI.Comm,
        *,
        prefix: str,
        options: Mapping[str, Any] | None = None,
        multigrid: bool = False,
        unknowns: Unknowns | None = None,
        refactor_after: int | None = None,
    ) -> None:
        """Try the options; the large PETSc objects follow with the first matrix."""
        check_options(comm, prefix, options)
        self.options = SolverOptions(prefix, options, multigrid=multigrid)
        self.counts = LinearCounts()
        self._comm = comm
        self.unknowns = unknowns
        self._refactor_after = refactor_after
        self.description = "not used yet"
        self._attached: Attached | None = None

    @property
    def direct(self) -> bool:
        """Tell whether the preconditioner is a factorisation."""
        return self.options.direct

    def factorise_instead(self) -> bool:
        """Factorise from now on; False, and no change, where that is no remedy; collective.

        It is none if that is done already, if the user has chosen the method, or for a matrix that
        is too large.
        """
        known = self._attached is not None
        small = known and self._operator.A.getSize()[0] <= MOST_FACTORISED
        if self.direct or self.options.chosen or not small:
            return False
        self.clear()
        self.options = SolverOptions(self.options.prefix, self.options.given)
        return True

    def take_up_multigrid(self) -> None:
        """Go back from factorisations to multigrid; collective."""
        self.clear()
        self.options = SolverOptions(self.options.prefix, self.options.given, multigrid=True)

    def attach(self, A: PETSc.Mat, *, definite: bool = True) -> None:
        """Take A as the matrix of the next solves (collective).

        The factorisation at hand stays as preconditioner if A is the object seen before.

        Args:
            A: (n, n) matrix.
            definite: whether it is symmetric and positive definite, see `BoundQP`.
        """
        if self._attached is not None:
            known = self._operator
            if A.handle == known.A.handle and definite == known.definite:
                return
        self.clear()  # and nothing is attached should an option prove wrong
        self.options.definite = definite
        ksp = PETSc.KSP().create(self._comm)
        ksp.setOptionsPrefix(self.options.prefix)
        ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        ksp.setTolerances(max_it=MAX_ITERATIONS)
        with self.options.database(self.options.prefix):
            ksp.setFromOptions()
            operator = Operator(A, direct=self.direct, definite=definite)
            preconditioner = Preconditioner(operator, ksp, self.options, self.unknowns)
        if ksp.getType() == "gmres":
            ksp.setPCSide(PETSc.PC.Side.RIGHT)  # so that its residuals are the true ones
        elif ksp.getType() != "cg":
            ksp.setNormType(PETSc.KSP.NormType.DEFAULT)
        ksp.setOperators(operator.matrix)
        after = SETUP_AFTER if not self.direct else REFACTOR_AFTER
        renewal = Renewal(self._refactor_after or after, direct=self.direct)
        sliding = _create_sliding_ksp(operator, ksp)
        limit = ksp.getTolerances()[3]
        dx = A.createVecRight()
        self._attached = Attached(operator, ksp, sliding, preconditioner, renewal, limit, dx)
        self.description = f"{ksp.getType()} + {preconditioner.description}"
        self.counts.symbolic += 1

    def clear(self) -> None:
        """Free the matrix and the factorisation: two at a time would need twice the memory."""
        if self._attached is not None:
            self._attached.destroy()
        self._attached = None

    def forget(self) -> None:
        """Let the next solve begin with a factorisation of its own; its pattern stays known."""
        if self._attached is not None:
            self._attached.preconditioner.held = None

    @property
    def attached(self) -> Attached:
        """What belongs to the attached matrix."""
        assert self._attached is not None, "no matrix is attached"
        return self._attached

    @property
    def _operator(self) -> Operator:
        return self.attached.operator

    def factorise(self, held: Ints) -> None:
        """Factorise A with these held, unless that is what the factorisation is of (collective).

        Raises:
            LinearSolveFailed: for a singular matrix or one that does not fit into memory.
        """
        self._operator.hold(held)
        if self.attached.preconditioner.is_of(held):
            return
        begin = perf_counter()
        failure = self.attached.preconditioner.renew(held, self.counts)
        self.counts.seconds_factor += perf_counter() - begin
        if failure:
            order = self._operator.matrix.size[0]
            raise LinearSolveFailed(
                f"The factorisation of a matrix of order {order} failed {failure}"
            )

    def apply(self, r: PETSc.Vec, x: PETSc.Vec) -> None:
        """Apply the factorisation (or preconditioner) at hand once: x = F^-1 r."""
        begin = perf_counter()
        self.attached.ksp.getPC().apply(r, x)
        self.counts.iterations += 1
        self.counts.seconds_solve += perf_counter() - begin

    def solve(
        self,
        b: PETSc.Vec,
        x: PETSc.Vec,
        held: Ints,
        *,
        atol: float,
        z: PETSc.Vec | None = None,
        sliding: Sliding | None = None,
    ) -> PETSc.Vec:
        """Solve for the unknowns that are not held, in place (collective).

        Args:
            b: (n,) right-hand side.
            x: (n,) in: values of the held unknowns and a guess for the others; out: solution.
            held: owned local indices of held unknowns, ascending.
            atol: largest 2-norm of b - A x over unknowns not held.
            z: (n,) b - A x of the given x, if it is at hand.
            sliding: nodes that slip, on all ranks or on none: there the reaction of their law
                replaces 0 on the right.

        Returns:
            (n,) b - A x, also at held unknowns; the next call reuses the vector.

        Raises:
            LinearSolveFailed: if the true residual stays above both atol and round-off, or if
                the solution is so large that the matrix must be singular.
        """
        operator = self._operator
        operator.slide(sliding)
        operator.hold(held)
        before = self.counts.iterations
        self.counts.solves += 1
        missing = operator.residual(b, x, held) if z is None else operator.take(z, x)
        first = norm = missing.norm()
        if not norm <= atol:
            norm = self._correct(b, x, held, atol, norm)
        self._judge(b, x, (first, norm, atol), self.counts.iterations - before)
        return operator.z

    def _correct(self, b: PETSc.Vec, x: PETSc.Vec, held: Ints, atol: float, norm: float) -> float:
        """Correct x until its residual, at first norm, is below atol or round-off; return it.

        It ends as well where a new factorisation makes it no smaller.
        """
        for _ in range(LIMIT):
            if self._is_far(held):
                self.factorise(held)
            fresh = self.attached.preconditioner.is_of(held)
            target, before = max(atol, self._operator.round_off(x) / ROUND_OFF), norm
            self._sweep(max(target / norm, EPS))
            dx = self.attached.dx
            dx.array[held] = 0.0  # an old factorisation may not know that they are held
            if np.isfinite(dx.norm()):
                x.axpy(1.0, dx)
                norm = self._operator.residual(b, x, held).norm()
            if norm <= max(atol, self._operator.round_off(x)):
                break
            exhausted = self._ksp.getIterationNumber() >= self.attached.max_iterations
            if fresh and (exhausted or not norm < before):
                break
            if not fresh:
                if not self.direct and (self._diverged() or not norm < before):
                    self.counts.breakdowns += 1
                    if self._comm.rank == 0:
                        log.info("an old preconditioner failed and is set up anew")
                self.factorise(held)
        return float(norm)

    def _diverged(self) -> bool:
        """Tell whether the last iteration broke down: an old set-up need not be definite."""
        return bool(self._ksp.getConvergedReason() < 0)

    @property
    def _ksp(self) -> PETSc.KSP:
        """The solver for the matrix at hand."""
        sliding = self._operator.sliding
        return self.attached.ksp if sliding is None else self.attached.sliding_ksp

    def _is_far(self, held: Ints) -> bool:
        """Tell whether the factorisation, if there is one, is of no use for this mask."""
        different = self.attached.preconditioner.differences(held)
        return different is None or self.attached.renewal.is_far(different)

    def _sweep(self, reduction: float) -> None:
        """Solve for the correction dx of the present residual, to be reduced by a factor."""
        begin = perf_counter()
        attached, held = self.attached, self._operator.held
        assert held is not None
        attached.preconditioner.follow(held)
        stale = not attached.preconditioner.is_of(held)
        test = SlownessTest(attached.renewal, reduction, attached.max_iterations, stale=stale)
        ksp = self._ksp
        if ksp.getType() != "preonly":
            ksp.setConvergenceTest(test)
        ksp.setTolerances(max_it=attached.max_iterations)
        ksp.solve(attached.operator.r, attached.dx)
        self.counts.iterations += max(1, ksp.getIterationNumber())
        attached.renewal.learn(test.norms, stale=stale)
        self.counts.seconds_solve += perf_counter() - begin

    def _judge(
        self, b: PETSc.Vec, x: PETSc.Vec, norms: tuple[float, float, float], iterations: int
    ) -> None:
        """Raise if a solution is none; the norms are first and last residual and their limit."""
        first, norm, atol = norms
        round_off = self._operator.round_off(x)
        tolerance = max(atol, round_off)
        if np.isfinite(norm) and norm <= tolerance:
            force = max(first, norm, b.norm())
            if round_off <= SINGULAR_LOSS * force:
                return
            self._operator.residual(b, x, np.empty(0, dtype=np.int32))
            # with the reactions of what is held, and what slips
            force = max(force, self._operator.z.norm())
            if round_off <= SINGULAR_LOSS * force or force == 0.0:
                return
            cause = f"its round-off {round_off:.1e} is near the forces {force:.1e}"
        else:
            cause = f"the residual is {norm:.1e}, not {tolerance:.1e}"
        remedy = ""
        if not self.direct:
            cause += f" after {iterations} iterations"
            remedy = (
                " Otherwise choose a direct solver (pc_type cholesky) or a better preconditioner."
            )
        reason = self._ksp.getConvergedReason()
        raise LinearSolveFailed(
            f"The linear solver, {self.description}, gave no solution: {cause} (PETSc reason "
            f"{reason}). A solution with large round-off comes from a "
            f"singular matrix: a body is held by nothing.{remedy}"
        )


class Applied:
    """Context of a PETSc PC of type python: that of another solver."""

    def __init__(self, pc: PETSc.PC) -> None:
        """Keep it."""
        self.pc = pc

    def apply(self, pc: PETSc.PC, r: PETSc.Vec, z: PETSc.Vec) -> None:
        """Set z = M^-1 r (called by PETSc)."""
        self.pc.apply(r, z)


def _create_sliding_ksp(operator: Operator, ksp: PETSc.KSP) -> PETSc.KSP:
    """Return a solver for slipping nodes, with the preconditioner of another one."""
    sliding = PETSc.KSP().create(ksp.comm)
    sliding.setType(PETSc.KSP.Type.GMRES)
    sliding.setPCSide(PETSc.PC.Side.RIGHT)  # so that its residuals are the true ones
    sliding.setPC(PETSc.PC().createPython(Applied(ksp.getPC()), comm=ksp.comm))
    sliding.setOperators(operator.sliding_matrix)
    return sliding

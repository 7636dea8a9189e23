# SPDX-License-Identifier: MIT
"""Linear systems with some unknowns held, and the reuse of factorisations among them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from time import perf_counter
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.parallel import free_unused
from dolfinx_mortar.arrays import Ints
from dolfinx_mortar.qp import mumps
from dolfinx_mortar.qp.bound_qp import EPS, ROUND_OFF
from dolfinx_mortar.qp.counts import LinearCounts
from dolfinx_mortar.qp.multigrid import CreatePreconditioning, FreePart, Multigrid, Preconditioning

DEFAULTS = {"ksp_type": "cg", "pc_type": "cholesky", "pc_factor_mat_solver_type": "mumps"}
# For three dimensions, where a factorisation takes too much time and memory.
# The threshold drops entries that are zero up to round-off.
MULTIGRID = {"pc_type": "gamg", "pc_gamg_threshold": 0.005}
# A numeric factorisation in 2D costs as much as 5 to 7 solves with it (measured at 5k, 50k and
# 200k unknowns, MUMPS): beyond that many iterations a new one is cheaper than an old one.
REFACTOR_AFTER = 6
# A set-up of multigrid in 3D costs as much as 40 to 50 iterations with it (GAMG, 40k to 260k
# unknowns). Renewed when an old one has cost half as many more than a new one would have, it takes
# the same time as to wait for all, and the iterations grow less with the mesh.
SETUP_AFTER = 20
# Conjugate gradients need a few iterations before their rate tells anything.
TRIAL_ITERATIONS = 3
# A mask that differs by this many times REFACTOR_AFTER unknowns makes an old factorisation useless.
FAR = 4
MAX_ITERATIONS = 500
LEAST_RATE = 0.01  # log of the reduction per iteration below which none is expected
MAX_SWEEPS = 6
# A well-posed stiffness matrix loses up to 6 to 8 digits; one that loses 12 is singular.
SINGULAR_LOSS = 1e-4


class LinearSolveFailed(RuntimeError):
    """A linear system could not be solved; the message has the reason and the remedy."""


class LinearSolver:
    """Solve A_ff x_f = b_f - A_fc x_c for changing sets c of held unknowns and changing A.

    With a factorisation the operator is a copy of A whose rows and columns in c are zeroed with the
    pattern kept, so nothing is allocated and the symbolic factorisation lives as long as the
    pattern; otherwise A itself is applied, and its rows in c are left out. The numeric
    factorisation of an earlier set or an earlier A preconditions conjugate gradients; it is renewed
    as soon as the observed convergence promises that this is cheaper. The decisions depend on
    residuals only, never on clocks, and so are the same on all ranks.

    Args:
        comm: communicator of the matrices.
        prefix: prefix of all PETSc options of this solver.
        options: PETSc options without prefix over the defaults (CG with MUMPS Cholesky); what the
            user's options database has under the prefix wins.
        preconditioning: for solvers that are not direct: returns the matrix to precondition with,
            given the held unknowns. It is asked at every set-up; by default the masked matrix.
        refactor_after: iterations that cost as much as a new factorisation or set-up; measured
            values by default.
    """

    def __init__(
        self,
        comm: MPI.Comm,
        *,
        prefix: str,
        options: dict[str, Any] | None = None,
        preconditioning: CreatePreconditioning | None = None,
        refactor_after: int | None = None,
    ) -> None:
        """Remember the options; PETSc objects follow with the first matrix."""
        self.comm = comm
        self.prefix = prefix
        self.options = DEFAULTS | (options or {})
        self.preconditioning = preconditioning
        self._refactor_after = refactor_after
        self.max_iterations = MAX_ITERATIONS  # of one sweep
        self.counts = LinearCounts()
        self.memory: dict[str, Any] = {}  # what a backend has learnt about the matrices
        self._A: PETSc.Mat | None = None
        self._seen: tuple[int, int] = (-1, -1)  # object state of A: as masked, as factorised
        self._fixed: Ints | None = None  # mask of the operator
        self._factor_fixed: Ints | None = None  # mask of the factorisation
        self._fresh_rate = 0.0  # log of the reduction per iteration when it was new
        self._excess = 0.0  # iterations above those of a new one, since it was new

    @property
    def direct(self) -> bool:
        """Tell whether the preconditioner is a mumps."""
        chosen = PETSc.Options(self.prefix).getString("pc_type", str(self.options["pc_type"]))
        return chosen in ("cholesky", "lu")

    @property
    def refactor_after(self) -> int:
        """Iterations that cost as much as a new factorisation or set-up."""
        if self._refactor_after is not None:
            return self._refactor_after
        return REFACTOR_AFTER if self.direct else SETUP_AFTER

    @property
    def description(self) -> str:
        """Name the method, for reports."""
        if self._A is None:
            return "not used yet"
        name = self._pc.getType()
        if self.direct:
            name += f" ({self._pc.getFactorSolverType()})"
        return f"{self._ksp.getType()} + {name}"

    @contextmanager
    def database(self, prefix: str, more: Mapping[str, Any] | None = None) -> Iterator[None]:
        """Hold our options in PETSc's database: they are read at set-up as well as at creation."""
        opts = PETSc.Options()
        mine = {f"{prefix}{key}": value for key, value in (self.options | dict(more or {})).items()}
        mine = {key: value for key, value in mine.items() if not opts.hasName(key)}
        for key, value in mine.items():
            opts.setValue(key, value)
        try:
            yield
        finally:
            for key in mine:
                opts.delValue(key)

    def attach(self, A: PETSc.Mat) -> None:
        """Take A as the matrix of the next solves (collective).

        The factorisation at hand stays as preconditioner if A is the object seen before.
        """
        if self._A is not None and A.handle == self._A.handle:
            return
        self.release()  # until all options have proved valid
        self._r, self._dx = A.createVecRight(), A.createVecRight()
        self._seen, self._fixed, self._factor_fixed = (-1, -1), None, None
        self._ksp = PETSc.KSP().create(self.comm)
        self._ksp.setOptionsPrefix(self.prefix)
        self._ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        with self.database(self.prefix):
            self._ksp.setFromOptions()
            self._pc = self._ksp.getPC()
            if self.direct:
                self._masked = A.duplicate(copy=True)
                self._masked.setOption(PETSc.Mat.Option.SPD, True)
                self._masked.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
            else:
                self._operator = FreePart(A)
                self._masked = PETSc.Mat().createPython(A.getSizes(), self._operator, self.comm)
                self._multigrid = Multigrid(self.comm, self.prefix)
                self._pc = self._multigrid.inner
                self._ksp.setPC(PETSc.PC().createPython(self._multigrid, comm=self.comm))
        if self._ksp.getType() != "cg":
            self._ksp.setNormType(PETSc.KSP.NormType.DEFAULT)
        if self._ksp.getType() != "preonly":
            self._ksp.setConvergenceTest(self._converged)
        self._ksp.setOperators(self._masked)
        self._A = A
        self.counts.symbolic += 1

    def release(self) -> None:
        """Free the matrix and the factorisation: two at a time would need twice the memory."""
        if self._A is not None:
            self._ksp.destroy()
            self._masked.destroy()
        self._A = None

    def is_fresh(self, fixed: Ints) -> bool:
        """Tell whether the factorisation is that of the present A with this mask (collective)."""
        same = self._factor_fixed is not None and np.array_equal(self._factor_fixed, fixed)
        return self._seen[1] == self._state() and bool(self.comm.allreduce(same, op=MPI.LAND))

    def _state(self) -> int:
        assert self._A is not None
        return int(self._A.stateGet())

    def _mask(self, fixed: Ints) -> None:
        """Set the operator to A with rows and columns of `fixed` replaced by a scaled identity."""
        same = self._fixed is not None and np.array_equal(self._fixed, fixed)
        if self._seen[0] == self._state() and self.comm.allreduce(same, op=MPI.LAND):
            return
        assert self._A is not None
        self._diagonal = self._A.getDiagonal()
        if self.direct:
            self._A.copy(self._masked, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
            self._decouple(self._masked, fixed)
        else:
            self._operator.held = fixed
        self._fixed = fixed.copy()
        self._seen = (self._state(), self._seen[1])

    def _decouple(self, matrix: PETSc.Mat, fixed: Ints) -> None:
        """Replace rows and columns by those of a scaled identity."""
        typical = self._diagonal.sum() / self._diagonal.getSize()
        rows = (fixed + matrix.getOwnershipRange()[0]).astype(PETSc.IntType)
        matrix.zeroRowsColumns(rows, diag=typical)

    def factorise(self, fixed: Ints) -> None:
        """Factorise A with `fixed` held, unless that is what the factorisation is of (collective).

        Raises:
            LinearSolveFailed: for a singular matrix or one that does not fit into memory.
        """
        self._mask(fixed)
        if self.is_fresh(fixed):
            return
        begin = perf_counter()
        if not self.direct:
            self._multigrid.release()  # two at a time would need twice the memory
        free_unused(self.comm)
        pc = self._pc
        if self.direct:
            self._set_up_factorisation(pc)
        else:
            with self.database(self.prefix):
                self._multigrid.renew(self._create_preconditioning(fixed), fixed)
                self.counts.factorisations += 1
        self._factor_fixed = fixed.copy()
        self._seen = (self._seen[0], self._state())
        self.counts.seconds_factor += perf_counter() - begin
        if pc.getFailedReason() != 0:
            self._factor_fixed = None
            raise LinearSolveFailed(
                f"The factorisation of a matrix of order {self._masked.size[0]} failed "
                f"({mumps.reason(pc)}). {mumps.remedy(pc)}"
            )

    def _set_up_factorisation(self, pc: PETSc.PC) -> None:
        """Factorise the masked matrix, with more workspace if there was too little."""
        pc.setReusePreconditioner(False)
        self._ksp.setOperators(self._masked)
        for _ in range(MAX_SWEEPS):
            with self.database(self.prefix):
                pc.setUp()
                self.counts.factorisations += 1
                if not self._enlarge_workspace(pc):
                    break
        pc.setReusePreconditioner(True)

    def _create_preconditioning(self, fixed: Ints) -> Preconditioning:
        if self.preconditioning is not None:
            return self.preconditioning(fixed)
        assert self._A is not None
        B = self._A.copy()
        self._decouple(B, fixed)
        return Preconditioning(B, None, [])

    def _enlarge_workspace(self, pc: PETSc.PC) -> bool:
        """Double MUMPS' workspace if it was too small; tell whether to try again."""
        enough = mumps.enough_workspace(pc)
        if enough is None:
            return False
        self.options["mat_mumps_icntl_14"] = enough
        pc.reset()  # a failed factor cannot be used again
        self._ksp.setOperators(self._masked)
        self.counts.symbolic += 1
        return True

    def is_slow(self, norms: list[float], tolerance: float) -> bool:
        """Tell."""
        its = len(norms) - 1
        if 2 * its < self.refactor_after or not norms[-1] > 0.0:
            return False
        rate = np.log(norms[-1] / norms[0]) / its
        return bool(rate >= 0.0 or np.log(tolerance / norms[-1]) / rate > self.refactor_after)

    def apply(self, r: PETSc.Vec, x: PETSc.Vec) -> None:
        """Apply the factorisation (or preconditioner) at hand once: x = F^-1 r."""
        begin = perf_counter()
        self._ksp.getPC().apply(r, x)
        self.counts.iterations += 1
        self.counts.seconds_solve += perf_counter() - begin

    def residual(self, b: PETSc.Vec, x: PETSc.Vec, fixed: Ints) -> PETSc.Vec:
        """Return b - A x with zeros at `fixed`; the vector is reused by the next call."""
        assert self._A is not None
        self._A.mult(x, self._r)
        self._r.aypx(-1.0, b)
        self._r.array[fixed] = 0.0
        return self._r

    def solve(self, b: PETSc.Vec, x: PETSc.Vec, fixed: Ints, *, atol: float) -> int:
        """Solve for the unknowns that are not held, in place (collective).

        Args:
            b: (n,) right-hand side.
            x: (n,) in: values of the held unknowns and a guess for the others; out: solution.
            fixed: owned local indices of held unknowns, ascending.
            atol: largest 2-norm of b - A x over unknowns not held.

        Returns:
            The number of iterations.

        Raises:
            LinearSolveFailed: if the true residual stays above both atol and round-off, or if
                the solution is so large that the matrix must be singular.
        """
        self._mask(fixed)
        before = self._begun = self.counts.iterations
        self.counts.solves += 1
        norm, previous = self.residual(b, x, fixed).norm(), np.inf
        first = norm
        for _ in range(MAX_SWEEPS):
            floor = self.round_off(x)
            if norm <= atol or (norm <= floor and norm > 0.3 * previous):
                break
            if self._is_far(fixed):
                self.factorise(fixed)
            self._sweep(max(0.5 * atol, 0.02 * floor) / norm)
            self._dx.array[fixed] = 0.0  # an old factorisation may not know that they are held
            x.axpy(1.0, self._dx)
            norm, previous = self.residual(b, x, fixed).norm(), norm
            if norm <= max(atol, self.round_off(x)):
                continue
            if not self.is_fresh(fixed):
                self.factorise(fixed)
            elif not self.direct and not norm < 0.5 * previous:
                break  # a new set-up does no better
        self._judge(b, x, max(first, norm), norm, atol)
        return self.counts.iterations - before

    def _is_far(self, fixed: Ints) -> bool:
        """Tell whether the factorisation is of no use for this mask (collective).

        An unknown more or less in the mask is a change of rank one, and costs up to one iteration.
        """
        if self._factor_fixed is None:
            return self._seen[1] < 0
        if not self.direct:
            return self._excess > self.refactor_after
        different = self.comm.allreduce(np.setxor1d(self._factor_fixed, fixed).size)
        return bool(different > FAR * self.refactor_after)

    def _sweep(self, reduction: float) -> None:
        """Solve for the correction dx of the present residual, to be reduced by a factor."""
        begin = perf_counter()
        if not self.direct:
            self._multigrid.hold(self._fixed, self._diagonal.array_r)  # type: ignore[arg-type]
        self._reduction, self._reached = max(reduction, 1e-14), 0.0
        self._stale = not self.is_fresh(self._fixed)  # type: ignore[arg-type]
        self._ksp.setTolerances(max_it=self.max_iterations)
        self._ksp.solve(self._r, self._dx)
        its = self._ksp.getIterationNumber()
        self.counts.iterations += max(1, its)
        if self._stale:
            self._excess += its - self._reached / min(self._fresh_rate, -LEAST_RATE)
        else:
            self._fresh_rate, self._excess = self._reached / max(its, 1), 0.0
        self.counts.seconds_solve += perf_counter() - begin

    def round_off(self, x: PETSc.Vec) -> float:
        """Return the round-off of A x, the smallest residual that can be expected."""
        scaled = self._dx.duplicate()
        scaled.pointwiseMult(self._diagonal, x)
        return float(ROUND_OFF * EPS * scaled.norm())

    def _converged(self, ksp: PETSc.KSP, its: int, norm: float) -> int:
        """Stop at the tolerance, or when an old factorisation turns out too slow a guide."""
        Reason = PETSc.KSP.ConvergedReason
        if its == 0:
            self._first = norm
        if not np.isfinite(norm):
            return int(Reason.DIVERGED_NANORINF)
        reached = norm / self._first if self._first > 0.0 else 0.0
        self._reached = float(np.log(max(reached, np.finfo(float).tiny)))
        if reached <= self._reduction:
            return int(Reason.CONVERGED_RTOL)
        if its >= self.max_iterations:
            return int(Reason.DIVERGED_MAX_IT)
        if self._stale and self.direct and its >= TRIAL_ITERATIONS:
            rate = np.log(reached) / its
            left = np.log(self._reduction / reached) / rate if rate < 0.0 else np.inf
            if left > self.refactor_after:
                return int(Reason.CONVERGED_ITS)
        return int(Reason.CONVERGED_ITERATING)

    def _judge(self, b: PETSc.Vec, x: PETSc.Vec, first: float, norm: float, atol: float) -> None:
        """Raise if a solution is none."""
        round_off = self.round_off(x)
        tolerance = max(atol, round_off)
        if np.isfinite(norm) and norm <= tolerance:
            assert self._A is not None
            self._A.mult(x, self._dx)
            self._dx.aypx(-1.0, b)  # with the reactions of held unknowns
            force = max(first, b.norm(), self._dx.norm())
            if round_off <= SINGULAR_LOSS * force or force == 0.0:
                return
            cause = f"its round-off {round_off:.1e} is near the forces {force:.1e}"
        else:
            cause = f"the residual is {norm:.1e}, not {tolerance:.1e}"
        remedy = "Otherwise choose a direct solver (pc_type cholesky) or a better preconditioner."
        if not self.direct:
            cause += f" after {self.counts.iterations - self._begun} iterations"
        raise LinearSolveFailed(
            f"The linear solver, {self.description}, gave no solution: {cause} (PETSc reason "
            f"{self._ksp.getConvergedReason()}). A solution with large round-off comes from a "
            f"singular matrix: a body is held by nothing. {remedy}"
        )

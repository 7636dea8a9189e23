# SPDX-License-Identifier: MIT
"""Linear systems with fixed unknowns, and the reuse of factorisations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from time import perf_counter
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.congruence import CongruentOperator
from dolfinx_mortar.common.arrays import (
    EPS,
    LIMIT,
    QUARTER_OF_DIGITS,
    ROUND_OFF,
    UNDERFLOW,
    Ints,
)
from dolfinx_mortar.qp.bound_qp import Sliding
from dolfinx_mortar.qp.operator import (
    Operator,
    count_negative,
    meets_negative_curvature,
    negative_pivots,
)
from dolfinx_mortar.qp.options import SolverOptions, check_options
from dolfinx_mortar.qp.preconditioner import (
    RENEWAL_COST,
    LinearCounts,
    Preconditioner,
    Renewal,
    SchurComplement,
    Unknowns,
)

# Largest order in 3D that may be factorised instead of multigrid: about 4 GiB.
MOST_FACTORISED = 200_000

# PETSc 3.22 crashes at its third factorisation while another one exists.
ALONE = "superlu_dist"


class LinearSolveFailed(RuntimeError):
    """A linear system could not be solved; the message has the remedy."""


@dataclass(frozen=True)
class MatrixSetup:
    """Solvers and preconditioner of one matrix."""

    operator: Operator
    ksp: PETSc.KSP
    sliding_ksp: PETSc.KSP  # of matrices that friction makes unsymmetric
    preconditioner: Preconditioner  # perhaps that of a definite matrix nearby
    renewal: Renewal
    max_iterations: int


class LinearSolver:
    """Solve A_ff x_f = b_f - A_fc x_c for changing A and sets c of fixed unknowns.

    The factorisation for an earlier set or A preconditions conjugate gradients until a new one is
    predicted to be cheaper (`Renewal`).

    Args:
        comm: of the matrices.
        prefix: of all PETSc options of this solver.
        options: PETSc options without prefix over the defaults (CG with MUMPS Cholesky, or GMRES
            with LU for indefinite matrices); the user's options database takes precedence.
        multigrid: whether it is the default preconditioner.
        unknowns: of multigrid; by default those of the matrix.

    Raises:
        ValueError: for options that PETSc cannot use, on all ranks.
    """

    exact = False

    def __init__(
        self,
        comm: MPI.Comm,
        *,
        prefix: str,
        options: Mapping[str, Any] | None = None,
        multigrid: bool = False,
        unknowns: Unknowns | None = None,
    ) -> None:
        check_options(comm, prefix, options)
        self.options = SolverOptions(prefix, options, multigrid=multigrid)
        self.counts = LinearCounts()
        self._comm = comm
        self.unknowns = unknowns
        self.description = "not used yet"
        self._setups: dict[bool, MatrixSetup] = {}  # by whether the matrix is definite
        self._kind = True  # of the present matrix
        self._order = 0  # of the last matrix, 0 before any
        self.beyond = 0  # negative eigenvalues of the condensed matrix

    @property
    def _setup(self) -> MatrixSetup | None:
        return self._setups.get(self._kind)

    @property
    def schur(self) -> SchurComplement | None:
        """Schur complement of the present matrix, if any."""
        return None if self._setup is None else self._setup.preconditioner.schur

    @property
    def direct(self) -> bool:
        """Whether the preconditioner is a factorisation."""
        return self.options.direct

    def give_up_multigrid(self) -> bool:
        """Factorise from now on, unless the user chose, or the matrix is too large; collective."""
        if self.direct or self.options.chosen or not 0 < self._order <= MOST_FACTORISED:
            return False
        self.options.multigrid = False
        self.clear()
        return True

    @property
    def remedy(self) -> str:
        """Remedy where an iteration fails; empty for a factorisation."""
        if self.direct:
            return ""
        return (
            " Otherwise choose a factorisation, petsc_options={'pc_type': 'cholesky'}, or a better "
            "preconditioner."
        )

    def set_matrix(
        self,
        A: PETSc.Mat,
        *,
        definite: bool = True,
        apart: Ints | None = None,
        product: CongruentOperator | None = None,
        near: PETSc.Mat | None = None,
    ) -> None:
        """Set the matrix of the next solves (collective).

        The factorisation of the same object remains as preconditioner, and that of a definite
        matrix next to an indefinite one's, except with SuperLU_DIST.

        Args:
            A: (n, n)
            definite: see `BoundQP`.
            apart: unknowns of S, which `apply` fixes; None for any.
            product: A as an operator whose K is factorised.
            near: (n, n) definite matrix whose preconditioner serves A.
        """
        if near is not None and not self.direct:
            self._set_beside(A, near)
            return
        self._kind = self.options.definite = definite
        self._order = A.getSize()[0]
        if self._setup is not None:
            before = self._operator
            if A.handle == before.A.handle and self.setup.preconditioner.serves(apart):
                self._describe()
                return
        self._drop(definite)
        if self.direct and self.options["pc_factor_mat_solver_type"] == ALONE:
            self._drop(not definite)
        ksp = PETSc.KSP().create(self._comm)
        ksp.setOptionsPrefix(self.options.prefix)
        ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        ksp.setConvergenceHistory(reset=True)
        with self.options.database(self.options.prefix):
            ksp.setFromOptions()
            schur = None
            if apart is not None:
                schur = SchurComplement(apart, product or CongruentOperator(A))
            operator = Operator(A, copied=self.direct and schur is None, definite=definite)
            preconditioner = Preconditioner(operator, ksp, self.options, self.unknowns, schur)
        if ksp.getType() == "gmres":
            ksp.setPCSide(PETSc.PC.Side.RIGHT)  # its residuals are the true ones
        elif ksp.getType() != "cg":
            ksp.setNormType(PETSc.KSP.NormType.DEFAULT)
        ksp.setOperators(operator.matrix, operator.factorised)
        renewal = Renewal(RENEWAL_COST["direct" if self.direct else "iterative"], self.direct)
        sliding = self._gmres(ksp.getPC())
        limit = ksp.getTolerances()[3]
        self._setups[definite] = MatrixSetup(operator, ksp, sliding, preconditioner, renewal, limit)
        self._describe()
        self.counts.symbolic += 1

    def _set_beside(self, A: PETSc.Mat, near: PETSc.Mat) -> None:
        """Set an indefinite matrix, preconditioned by a definite one; collective."""
        self.set_matrix(near)
        self._kind, base, beside = False, self._setups[True], self._setups.get(False)
        if beside is not None and beside.operator.A.handle == A.handle:
            if beside.preconditioner is base.preconditioner:
                return
        self._drop(False)
        operator = Operator(A, copied=False, definite=False)
        ksp = self._gmres(PETSc.PC().createPython(base.preconditioner.multigrid, comm=self._comm))
        ksp.setOperators(operator.matrix)
        renewal = Renewal(base.renewal.after, direct=False)
        parts = operator, ksp, ksp, base.preconditioner, renewal, base.max_iterations
        self._setups[False] = MatrixSetup(*parts)

    def _gmres(self, pc: PETSc.PC) -> PETSc.KSP:
        ksp = PETSc.KSP().create(self._comm)
        ksp.setType(PETSc.KSP.Type.GMRES)
        ksp.setPCSide(PETSc.PC.Side.RIGHT)
        ksp.setPC(pc)
        ksp.setConvergenceHistory(reset=True)
        return ksp

    def _describe(self) -> None:
        setup = self.setup
        self.description = f"{setup.ksp.getType()} + {setup.preconditioner.description}"

    def clear(self) -> None:
        """Free the matrices and their factorisations; collective."""
        for kind in list(self._setups):
            self._drop(kind)

    def abandon(self) -> None:
        """Drop all matrices, perhaps locked by an error; without communication."""
        self._setups = {}

    def _drop(self, kind: bool) -> None:
        setup, other = self._setups.pop(kind, None), self._setups.get(not kind)
        if setup is None:
            return
        if other is None or other.preconditioner is not setup.preconditioner:
            setup.preconditioner.clear()
        elif kind:  # the other one is nothing without it
            self._drop(False)
            setup.preconditioner.clear()
        setup.ksp.destroy()
        setup.sliding_ksp.destroy()
        setup.operator.clear()

    def forget(self, *, keep_definite: bool = False) -> None:
        """Renew the factorisations at the next solves, except that of a definite A if asked."""
        for definite, setup in self._setups.items():
            if not (definite and keep_definite):
                setup.preconditioner.held = None

    def negative_pivots(self) -> int:
        """Negative pivots of the last factorisation (or coarsest level), or 0; collective."""
        if self._setup is None or self._setup.preconditioner.held is None:
            return 0
        multigrid, operator = self._setup.preconditioner.multigrid, self._operator
        if multigrid is None:
            found = negative_pivots(self._setup.preconditioner.pc)
            return self.beyond + (count_negative(operator.factorised) if found is None else found)
        if multigrid.negative:
            self.factorise(operator.held)  # an old one is of another matrix
        return multigrid.negative

    @property
    def setup(self) -> MatrixSetup:
        """Solvers and preconditioner of the present matrix."""
        assert self._setup is not None, "no matrix is set"
        return self._setup

    @property
    def _operator(self) -> Operator:
        return self.setup.operator

    def round_off(self, x: PETSc.Vec) -> float:
        """Round-off of A x; collective."""
        return self._operator.round_off(x)

    def factorise(self, held: Ints) -> None:
        """Factorise A with these unknowns fixed, unless that is the present one (collective).

        Raises:
            LinearSolveFailed: for a singular matrix, or too little memory.
        """
        self._operator.hold(held)
        if self.setup.preconditioner.is_of(held):
            return
        self.beyond = 0
        begin = perf_counter()
        failure = self.setup.preconditioner.renew(held, self.counts)
        self.counts.seconds_factor += perf_counter() - begin
        if failure:
            order = self._operator.matrix.size[0]
            raise LinearSolveFailed(
                f"The factorisation of a matrix of order {order} failed {failure}"
            )

    def is_indefinite(self) -> bool:
        """Whether the free part of the present matrix, assumed definite, is not; collective."""
        if not self._kind or self._setup is None:
            return False
        setup, operator = self.setup, self._operator
        if self.direct or setup.preconditioner.held is None:  # no system had to be solved
            self.factorise(operator.held)
        if (negative := self.negative_pivots() > 0) or self.direct:
            return negative
        setup.preconditioner.follow(operator.held)
        return meets_negative_curvature(operator, setup.ksp.getPC(), setup.max_iterations)

    def apply(self, r: PETSc.Vec, x: PETSc.Vec) -> None:
        """Apply the present factorisation or preconditioner once."""
        begin = perf_counter()
        self.setup.preconditioner.follow(self._operator.held)
        self.setup.ksp.getPC().apply(r, x)
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
        """Solve for the free unknowns, in place (collective).

        Args:
            b: (n,)
            x: (n,) in: values of the fixed unknowns and a guess for the others; out: solution.
            held: owned local indices of fixed unknowns, ascending.
            atol: largest 2-norm of b - A x over free unknowns.
            z: (n,) b - A x of the given x, if known.
            sliding: law of the slipping nodes, on all ranks or on none.

        Returns:
            (n,) b - A x, also at fixed unknowns; the next call reuses the vector.

        Raises:
            LinearSolveFailed: if the residual remains above atol and round-off, or the matrix must
                be singular.
        """
        operator = self._operator
        operator.sliding = sliding
        operator.hold(held)
        before = self.counts.iterations
        first = norm = operator.residual(b, x, held, z).norm()
        if not norm <= max(atol, operator.round_off(x)):
            norm = self._iterate(b, x, held, atol, norm)
        self._judge(b, x, (first, norm, atol), self.counts.iterations - before)
        return operator.z

    def _iterate(self, b: PETSc.Vec, x: PETSc.Vec, held: Ints, atol: float, norm: float) -> float:
        """Correct x until its residual is small or stagnates; return its norm."""
        setup, ksp, dx = self.setup, self._ksp, x.duplicate()
        preconditioner, operator, renewal = setup.preconditioner, setup.operator, setup.renewal
        for _ in range(LIMIT):
            different = preconditioner.differences(held)
            if different is None or renewal.is_far(different):
                self.factorise(held)
            fresh, before = preconditioner.is_of(held), norm
            preconditioner.follow(held)
            floor, limit = operator.round_off(x) * (EPS / ROUND_OFF), setup.max_iterations
            if self.direct and not fresh:
                limit = min(limit, 2 * renewal.after)
            reduction = max(EPS, max(atol, floor) / norm)
            ksp.setTolerances(rtol=reduction, atol=0.0, divtol=1.0 / EPS, max_it=limit)
            begin = perf_counter()
            ksp.solve(operator.r, dx)
            self.counts.iterations += max(1, ksp.getIterationNumber())
            renewal.learn(ksp.getConvergenceHistory(), stale=not fresh)
            self.counts.seconds_solve += perf_counter() - begin
            dx.array[held] = 0.0  # an old factorisation may change them
            if np.isfinite(dx.norm()):
                x.axpy(1.0, dx)
                norm = operator.residual(b, x, held).norm()
            if norm <= max(atol, operator.round_off(x)):
                break
            if fresh and (ksp.getIterationNumber() >= setup.max_iterations or not norm < before):
                break
            if not fresh:
                self.factorise(held)  # an old set-up may be indefinite
        return float(norm)

    @property
    def _ksp(self) -> PETSc.KSP:
        sliding = self._operator.sliding is not None
        return self.setup.sliding_ksp if sliding else self.setup.ksp

    def _judge(
        self, b: PETSc.Vec, x: PETSc.Vec, norms: tuple[float, float, float], iterations: int
    ) -> None:
        """Raise if x is no solution, by the first and last residual norm and their tolerance.

        Nor is x one if its round-off is near the forces: see QUARTER_OF_DIGITS.
        """
        first, norm, atol = norms
        round_off = self._operator.round_off(x)
        tolerance = max(atol, round_off)
        if np.isfinite(norm) and norm <= tolerance:
            force = max(first, norm, b.norm())
            if round_off > QUARTER_OF_DIGITS * force:  # with reactions of fixed unknowns, too
                self._operator.residual(b, x, np.empty(0, dtype=np.int32))
                force = max(force, self._operator.z.norm())
            if round_off <= max(QUARTER_OF_DIGITS * force, UNDERFLOW):
                return
            cause = f"its round-off {round_off:.1e} is near the forces {force:.1e}"
        else:
            cause = f"the residual is {norm:.1e}, not {tolerance:.1e}"
        if not self.direct:
            cause += f" after {iterations} iterations"
        raise LinearSolveFailed(
            f"The linear solver, {self.description}, gave no solution: {cause} (PETSc reason "
            f"{self._ksp.getConvergedReason()}). Most often the matrix is singular: either nothing "
            "holds a body, or plastic flow or buckling has reduced the stiffness to zero; smaller "
            f"steps help then.{self.remedy}"
        )

# SPDX-License-Identifier: MIT
"""The QP of a Newton iteration with its solution: tangent, shift, accuracy.

Two tangents lead to a balance: that of the bodies in the present geometry, which is then updated (a
fixed point), and the exact one of the moving surfaces, too, whose QP is not symmetric. At finite
strain the first may be indefinite; then multiples of the elastic stiffness are added to it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from petsc4py import PETSc

import numpy as np

from dolfinx_mortar import qp as backends
from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.arrays import QUARTER_OF_DIGITS, Actives, Floats
from dolfinx_mortar.interfaces.interface import Interface
from dolfinx_mortar.newton_method import driven_tools
from dolfinx_mortar.newton_method.contacts import Contacts
from dolfinx_mortar.newton_method.linearisation import (
    Balance,
    Corrections,
    Linearisation,
    linearise,
    linearise_all,
)
from dolfinx_mortar.newton_method.residuals import (
    DIGIT,
    Residuals,
    Scales,
    next_tolerance,
    tightest,
)
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.problem.step_data import StepData
from dolfinx_mortar.qp import LinearSolver, QPSolution
from dolfinx_mortar.qp.solver import ACTIVE_SET
from dolfinx_mortar.terms.sum import Energy

# Relative residual of forces below which an indefinite tangent is used as it is, see `definite`.
# With shifted ones it stays above 3e-3 and 6e-3 where a cube of metal of 4^3 cells is pressed to
# .55 and .5 of its height in one step, and Newton's method leaves the saddle in 30 iterations.
STABLE = 1e-2
# The least multiple of the elastic stiffness that is added to an indefinite tangent, and the
# largest; each is ten times the one before. A compression by a share e of the moduli needs about e,
# in a slender column, whose elastic stiffness against bending is low, e times its length over its
# thickness, squared.
SHIFTS = 0.01, 1000.0
# How often a QP with the exact tangent is solved once more, with the parts of gap rows that T_g
# neglects. They are some per cent of the rows, so that each correction gains one to two digits:
# with 0, 1, 2, 4, 6 of them five cases in the plane take 219, 194, 192, 192, 192 iterations.
CORRECTIONS = 3


@dataclass(frozen=True)
class Iterate:
    """What an iteration leaves to the next one."""

    u: Floats  # (n,)
    tools: list[tuple[Interface, dict[str, Floats]]]  # states of those that forces drive
    travel: Floats  # (m,) of these in the step
    balance: Balance
    contacts: Contacts
    start: Actives  # the active set with which its QP starts
    scales: Scales
    energy: Energy | None  # J(u), where a line search may need it
    norm: float  # |u|_e
    stiffness: PETSc.Vec  # diagonal of the last K^
    largest: float = 0.0  # largest multiplier so far
    pressure: Floats | None = None  # (owned cells,) mean stresses by the last linearisation
    shift: float = 0.0  # of the last tangent
    negative: bool = False  # whether the last tangent that could be shifted is indefinite
    turned: float = np.inf  # by how much the update of the geometry has changed contact forces
    slow: bool = False  # whether the fixed point is
    barred: float = np.inf  # the exact tangent is not used above this residual


@dataclass(frozen=True)
class Solution:
    """The QP of an iteration and its solution."""

    lin: Linearisation
    solved: QPSolution
    driven: driven_tools.Settled | None = None  # motions of the tools that forces drive
    shift: float = 0.0  # multiple of the elastic stiffness in the tangent
    negative: bool = False  # whether the tangent is indefinite
    rejected: str = ""  # why it is not the exact tangent, where that was tried

    @property
    def exact(self) -> bool:
        """Whether it has the exact tangent of the moving geometry."""
        return self.lin.geometry is not None


@dataclass(frozen=True)
class Subproblem:
    """How the QPs of a step are made and solved.

    Attributes:
        problem: of the step.
        data: read at its start.
        backend: name of the QP backend.
        rtol: tolerance of the step.
        solver: the linear solver.
    """

    problem: ContactProblem
    data: StepData
    backend: str
    rtol: float
    solver: LinearSolver

    @property
    def linear(self) -> bool:
        """Whether all laws and terms are."""
        return bool(self.problem.terms.linear)

    @property
    def finite(self) -> bool:
        """Whether strains are."""
        return self.problem.solid.strain == "finite"

    @property
    def moving(self) -> bool:
        """Whether the geometry of contacts follows u; ties stay at X."""
        return self.problem.geometry == "updated" and bool(self.problem.contacts)

    @property
    def driven(self) -> bool:
        """Whether tools or rigid sides are driven by forces, and move in every iteration."""
        return bool(self.problem.system.driven)

    @property
    def may_be_exact(self) -> bool:
        """Whether the motion of the surfaces can be linearised.

        With driven tools only where strains are finite and there are other contacts: a stack that
        a tool presses by a force diverges without. It has no derivative by the motions of tools,
        and with tools alone takes an iteration a step more (a cylinder on rubber: 8 and 7).
        """
        if not self.moving or self.backend != ACTIVE_SET:
            return False
        others = [link.interface.driven() is None for link in self.problem.system.unilateral]
        return not self.driven or (self.finite and any(others))

    def solve(self, old: Iterate, residuals: Sequence[Residuals], *, exact: bool) -> Solution:
        """Return the QP at an iterate with its solution; collective.

        Args:
            old: the iterate.
            residuals: of all iterates of the step, the last one included.
            exact: use the exact tangent; where its QP has no solution, the other one.
        """
        tangent = not self.linear or (not residuals and self.problem.terms.vary(self.problem.K))
        rejected = ""
        if exact:
            try:
                found = self.exact(old, residuals, tangent)
            except backends.QPNotSolved as error:
                rejected = f"without the exact tangent ({error})"
            else:
                curvature = found.solved.x.dot(found.lin.qp.b - found.solved.z)  # x.A x
                if not old.shift or curvature > 0.0:
                    return self.drive(found, old)
                rejected = "without the exact tangent, which is indefinite"
        found = self.definite(old, residuals, tangent)
        return replace(self.drive(found, old), rejected=rejected)

    def drive(self, found: Solution, old: Iterate) -> Solution:
        """Return the solution in which tools carry their loads, with their motions."""
        if found.solved.travel is None:
            return found
        given = found.lin.drives, found.lin, found.solved, old.scales.extent
        driven = driven_tools.settle(*given)
        return replace(found, lin=driven.lin, solved=driven.solved, driven=driven)

    def definite(self, old: Iterate, residuals: Sequence[Residuals], tangent: bool) -> Solution:
        """Return the QP of the bodies' tangent, made positive, and its solution; collective.

        At finite strain K may be indefinite, far from the solution or beyond a bifurcation. Then
        multiples of the elastic stiffness are added until it is positive on the free unknowns; an
        iteration begins with a tenth of what the last one needed. Near a balance Newton's step goes
        to it, be it stable or not. What no multiple makes definite is singular, no strain holds it:
        there the solution without one stands.
        """
        near = bool(residuals) and residuals[-1].forces < STABLE
        least, most = SHIFTS
        begun = shift = 0.0 if near or old.shift <= least else old.shift / 10.0
        failed: Exception | None = None
        loose = False  # all tangents that could be solved are not definite
        while True:
            try:
                found = self.shifted(shift, old, residuals, tangent)
            except (backends.QPNotSolved, backends.UnusableQP) as error:
                failed = failed or error
                if near and not shift and self.finite and not self.solver.direct:
                    break  # shifted steps would leave a saddle again
            else:
                if not self.finite or not found.negative or (near and shift == 0.0):
                    return found
                loose = (loose or shift == begun) and not found.solved.definite
            self.solver.forget()  # what has been factorised is of no use
            if not self.finite or shift >= most:
                break
            shift = max(least, 10.0 * shift)
        if loose and failed is None:
            return self.shifted(begun, old, residuals, tangent)
        raise failed or backends.QPNotSolved(
            "the tangent stays indefinite, whatever multiple of the elastic one is added"
        )

    def shifted(
        self, shift: float, old: Iterate, residuals: Sequence[Residuals], tangent: bool
    ) -> Solution:
        """Return the QP with a multiple of the elastic stiffness, and its solution; collective."""
        lin = linearise(
            self.problem,
            old.balance,
            tangent=tangent,
            shift=shift,
            pressure=old.pressure,
            linear=self.solver,
        )
        lin = self.with_scalars(lin, old)
        solved = self.solve_qp(lin, old.start, old, self.accuracy(lin, residuals))
        negative = False
        if self.finite:
            pivots = maximum(self.problem.comm, float(self.solver.negative_pivots()))[0]
            negative = bool(pivots > 0) or not solved.definite
        return Solution(lin, solved, shift=shift, negative=negative)

    def exact(self, old: Iterate, residuals: Sequence[Residuals], tangent: bool) -> Solution:
        """Return the QP of the exact tangent and its solution; collective.

        Its bounds are corrected by what the rows of T_g neglect, see `Corrections`.
        """
        lin = linearise_all(
            self.problem,
            old.balance,
            self.data.partners,
            old.contacts.multipliers,
            old.contacts.tangential,
            tangent=tangent,
            pressure=old.pressure,
            linear=self.solver,
        )
        lin = self.with_scalars(lin, old)
        rtol, corrections = self.accuracy(lin, residuals), Corrections()
        solved = self.solve_qp(lin, old.start, old, rtol)
        for _ in range(CORRECTIONS):
            lin, left = corrections.apply(lin, solved)
            if left <= DIGIT * residuals[-1].limit:
                break
            last, guess = solved, None if self.solver.direct else solved.x
            solved = self.solve_qp(lin, solved.active, old, rtol, guess)
            solved = replace(
                solved,
                updates=last.updates + solved.updates,
                linear_iterations=last.linear_iterations + solved.linear_iterations,
                factorisations=last.factorisations + solved.factorisations,
            )
        return Solution(lin, solved, negative=old.negative)

    def with_scalars(self, lin: Linearisation, old: Iterate) -> Linearisation:
        """Return the QP with the motions of tools that forces drive as unknowns; collective."""
        given = None if old.balance.friction is None else old.contacts.multipliers
        known = None if given is None else old.balance.known(given)
        drives = driven_tools.find_drives(self.problem, known)
        if drives is None:
            return lin
        if self.problem.in_time:
            drives.check_gaps(old.balance, old.contacts.active, old.scales.facet_length)
        at = lin, DIGIT * self.rtol, old.scales.begun
        scalars = driven_tools.as_scalars(drives, *at)
        return replace(lin, qp=replace(lin.qp, scalars=scalars), drives=drives)

    def accuracy(self, lin: Linearisation, residuals: Sequence[Residuals]) -> float:
        """Return the relative tolerance of the next QP."""
        if self.driven:  # deep drawing takes 606 iterations in 46 parts without, for 153 in 36
            return tightest(self.rtol)
        if self.linear and not self.moving:
            return tightest(self.rtol)  # one QP is the whole step
        # where only the geometry changes, the factorisation is that of the first QP: 2 to 4 of 12
        # to 18 solves are saved by not asking it for more digits
        new = self.solver.direct and not (self.linear and residuals)
        kind = "direct" if new else "iterative"
        found = next_tolerance(kind, self.rtol, lin.qp.b.norm(), residuals)
        stiff = self.finite and self.problem.solid.volumetric != "full"
        if self.solver.direct or not (stiff or lin.balance.limits is not None):
            return found
        # Forces of the bulk modulus hide those of shear, so that 1e-2 leaves shears wrong. A block
        # bent with K/mu = 5000 took 7 to 48 iterations, and metal failed; with 1e-3 it takes 5 to
        # 32, with 1e-4 4 to 6, as with a factorisation, in a tenth of the time. With friction too
        # loose a solution slips elsewhere: three steps of the bolted tee take 53 iterations with
        # 1e-2, 26, 27, 24 with 1e-3, 1e-4, 1e-6, and .39, .48, .63 of the time.
        most = QUARTER_OF_DIGITS if stiff else DIGIT**3
        return max(tightest(self.rtol), min(found, most))

    def solve_qp(
        self,
        lin: Linearisation,
        start: Actives,
        old: Iterate,
        rtol: float,
        guess: PETSc.Vec | None = None,
    ) -> QPSolution:
        """Return the solution of a QP; collective."""
        limits, kappa = old.balance.limits, None
        if self.finite:
            # Where it slides, diag(A) is a hundred times too large: a ball dragged over a block (50
            # thousand unknowns) had eigenvalues with a negative real part, and GMRES stood still.
            kappa = old.contacts.kappa(limits)
        with self.problem.timings("linear_solves"):
            try:
                solved = backends.solve(
                    lin.qp,
                    self.backend,
                    self.solver,
                    start_active=start,
                    start_sliding=old.contacts.directions(limits),
                    start_kappa=kappa,
                    guess=guess,
                    rtol=rtol,
                )
            except backends.NoResistance as error:
                raise driven_tools.unresisted(lin.drives, lin, error.which) from error
        if solved.travel is None:  # else see `driven_tools.settle`
            # supports and ties are satisfied exactly, also by an iterative solver
            equal = lin.balance.equal
            solved.x.array[equal.dofs] = equal.upper
        return solved

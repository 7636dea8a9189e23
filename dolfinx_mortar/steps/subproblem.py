# SPDX-License-Identifier: MIT
"""QP of a Newton iteration and its solution: tangent, shift, accuracy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from petsc4py import PETSc

import numpy as np

from dolfinx_mortar import qp as backends
from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.common.arrays import QUARTER_OF_DIGITS, Actives, Floats
from dolfinx_mortar.interfaces.constraints import equalities, join
from dolfinx_mortar.interfaces.interface import Interface
from dolfinx_mortar.problem.checks import StepData
from dolfinx_mortar.problem.contacts import (
    DIGIT,
    Contacts,
    Residuals,
    Scales,
    next_tolerance,
    tightest,
)
from dolfinx_mortar.problem.linearisation import (
    Balance,
    Linearisation,
    corrected,
    linearise,
    support_slots,
    to_displacement,
    to_reduced,
)
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.qp import LinearSolver, QPSolution
from dolfinx_mortar.qp.solver import ACTIVE_SET
from dolfinx_mortar.steps import driven_tools
from dolfinx_mortar.terms.sum import Energy

# Relative residual of forces below which an indefinite tangent is used unshifted.
STABLE = 1e-2
# Multiples of the elastic stiffness added to an indefinite tangent: a column needs about the strain
# times (length / thickness)^2.
SHIFTS = 0.01, 1000.0


@dataclass(frozen=True)
class Iterate:
    """Result of an iteration."""

    u: Floats  # (n,)
    tools: list[tuple[Interface, dict[str, Floats]]]  # of driven interfaces
    travel: Floats  # (m,) motion in the step
    balance: Balance
    contacts: Contacts
    start: Actives  # active set of the QP
    scales: Scales
    energy: Energy | None
    norm: float  # |u|_e
    stiffness: PETSc.Vec  # diagonal of the last K^
    penalty: float = 0.0  # largest multiplier so far
    pressure: Floats | None = None  # (owned cells,) linearised mean stresses
    shift: float = 0.0
    negative: bool = False  # whether the last tangent is indefinite
    turned: float = np.inf  # change of contact forces by the geometry update
    slow: bool = False  # whether the fixed point converges slowly
    barred: float = np.inf  # residual above which the tangent is not exact
    residuals: Sequence[Residuals] = ()  # of the iterates so far, in an undone step the last twice


@dataclass(frozen=True)
class Solution:
    """QP of an iteration and its solution, in which driven tools balance their loads."""

    lin: Linearisation
    solved: QPSolution
    travel: Floats | None = None  # (m,) of tools
    shift: float = 0.0
    negative: bool = False
    rejected: str = ""  # why the exact tangent was rejected

    @property
    def exact(self) -> bool:
        """Whether the tangent is exact."""
        return self.lin.geometry is not None


@dataclass(frozen=True)
class Subproblem:
    """Construction and solution of the QPs of a step."""

    problem: ContactProblem
    data: StepData
    backend: str
    rtol: float

    @property
    def solver(self) -> LinearSolver:
        """Linear solver."""
        return self.problem.linear

    @property
    def linear(self) -> bool:
        """Whether all laws and terms are linear."""
        return bool(self.problem.terms.linear)

    @property
    def finite(self) -> bool:
        """Whether strains are finite."""
        return self.problem.solid.strain == "finite"

    @property
    def moving(self) -> bool:
        """Whether contact geometry is updated; ties stay at X."""
        return self.problem.geometry == "updated" and bool(self.problem.contacts)

    @property
    def driven(self) -> bool:
        """Whether forces drive tools or rigid sides."""
        return bool(self.problem.system.driven)

    @property
    def may_be_exact(self) -> bool:
        """Whether the exact tangent is available and useful."""
        if not self.moving or self.backend != ACTIVE_SET:
            return False
        others = [link.interface.driven() is None for link in self.problem.system.unilateral]
        return not self.driven or (self.finite and any(others))

    def solve(self, old: Iterate, *, exact: bool) -> Solution:
        """Solve the QP at an iterate, at first with the exact tangent if `exact`; collective."""
        varies = not old.residuals and self.problem.terms.vary(self.problem.K)
        tangent, found, rejected = varies or not self.linear, None, ""
        if exact:
            try:
                found = self.exact(old, tangent)
            except backends.QPNotSolved as error:
                rejected = f"without the exact tangent ({error})"
            else:
                curvature = found.solved.x.dot(found.lin.qp.b - found.solved.z)  # x.A x
                if old.shift and not curvature > 0.0:
                    found, rejected = None, "without the exact tangent, which is indefinite"
        if found is None:
            found = replace(self.definite(old, tangent), rejected=rejected)
        if found.solved.travel is None:
            return found
        lin, travel = driven_tools.settle(found.lin, found.solved, old.scales.extent)
        return replace(found, lin=lin, travel=travel)

    def definite(self, old: Iterate, tangent: bool) -> Solution:
        """Solve the QP of the bodies' tangent, made positive definite; collective.

        Multiples of the elastic stiffness are added until K is positive definite, first a tenth of
        the last one; near equilibrium none, so that unstable equilibria converge.
        """
        near = bool(old.residuals) and old.residuals[-1].forces < STABLE
        least, most = SHIFTS
        shift = 0.0 if near or old.shift <= least else old.shift / 10.0
        failed: Exception | None = None
        while True:
            try:
                lin = self.program(old, tangent, shift=shift)
                solved, negative = self.solve_qp(lin, old), False
                if self.finite:
                    pivots = maximum(self.problem.comm, float(self.solver.negative_pivots()))[0]
                    negative = bool(pivots > 0)
            except (backends.QPNotSolved, backends.UnusableQP) as error:
                failed = failed or error
                if near and not shift and self.finite and not self.solver.direct:
                    break  # shifts would leave a saddle again
            else:
                if not negative or (near and shift == 0.0):
                    return Solution(lin, solved, shift=shift, negative=negative)
            self.solver.forget()
            if not self.finite or shift >= most:
                break
            shift = max(least, 10.0 * shift)
        raise failed or backends.QPNotSolved(
            "the tangent stays indefinite, whatever multiple of the elastic one is added"
        )

    def exact(self, old: Iterate, tangent: bool) -> Solution:
        """Solve with the exact tangent and correct bounds; collective."""
        lin = self.program(old, tangent, exact=True)
        solved = self.solve_qp(lin, old)
        lin, left = corrected(lin, solved)
        if left > DIGIT * old.residuals[-1].limit:
            last, guess = solved, None if self.solver.direct else solved.x
            solved = self.solve_qp(lin, replace(old, start=solved.active), guess)
            names = "updates", "linear_iterations", "factorisations"
            sums = {name: getattr(last, name) + getattr(solved, name) for name in names}
            solved = replace(solved, **sums)
        return Solution(lin, solved, negative=old.negative)

    def program(
        self, old: Iterate, tangent: bool, *, shift: float = 0.0, exact: bool = False
    ) -> Linearisation:
        """QP, with the motions of driven tools as unknowns; collective."""
        contacts, scales = old.contacts, old.scales
        moving = contacts.multipliers, contacts.tangential, self.data.partners
        lin = linearise(
            self.problem,
            old.balance,
            tangent=tangent,
            shift=shift,
            pressure=old.pressure,
            moving=moving if exact else None,
        )
        given = old.balance.friction is not None
        known = old.balance.known(contacts.multipliers) if given else None
        drives = driven_tools.find_drives(self.problem, known)
        if drives is not None:
            if self.problem.in_time:
                drives.check_gaps(old.balance, contacts.active, scales.facet_length)
            scalars = driven_tools.as_scalars(drives, lin, DIGIT * self.rtol, scales.begun)
            lin = replace(lin, qp=replace(lin.qp, scalars=scalars), drives=drives)
        return lin

    def accuracy(self, lin: Linearisation, residuals: Sequence[Residuals]) -> float:
        """Relative tolerance of the next QP."""
        # loose QPs with tools take four times the iterations, or change depths of wear; a linear
        # step is a single QP
        tight = self.driven or lin.balance.give is not None
        if tight or (self.linear and not self.moving):
            return tightest(self.rtol)
        new = self.solver.direct and not (self.linear and residuals)
        kind = "direct" if new else "iterative"
        found = next_tolerance(kind, self.rtol, lin.qp.b.norm(), residuals)
        stiff = self.finite and self.problem.solid.volumetric != "full"
        if self.solver.direct or not (stiff or lin.balance.limits is not None):
            return found
        # Bulk forces hide shear at K/mu = 5000, and loose friction changes slips.
        most = QUARTER_OF_DIGITS if stiff else DIGIT**3
        return max(tightest(self.rtol), min(found, most))

    def solve_qp(
        self, lin: Linearisation, old: Iterate, guess: PETSc.Vec | None = None
    ) -> QPSolution:
        """Solve a QP; collective."""
        limits, kappa = old.balance.limits, None
        if self.finite:
            # diag(A) is far too large where nodes slide: GMRES stagnates
            kappa = old.contacts.kappa(limits)
        with self.problem.timings("linear_solves"):
            try:
                solved = backends.solve(
                    lin.qp,
                    self.backend,
                    self.solver,
                    start_active=old.start,
                    start_sliding=old.contacts.directions(limits),
                    start_kappa=kappa,
                    guess=guess,
                    rtol=self.accuracy(lin, old.residuals),
                )
            except backends.NoResistance as error:
                raise driven_tools.unresisted(lin, error.which) from error
        if solved.travel is None:
            # exactly, also by an iterative solver
            equal = lin.balance.equal
            solved.x.array[equal.dofs] = equal.upper
        return solved


def respond(problem: ContactProblem, forces: Floats, rtol: float) -> Floats | None:
    """Return y (owned nodes, d) with K y = f, K the last tangent, or None; collective.

    Supports and ties hold, contacts do not act.
    """
    T, r = problem.system.transformation, problem.vector(forces)
    found = problem.system.constraints(problem.positions(), problem.vector(problem.owned_u))
    tied, contacts = found.select(found.equal), found.select(~found.equal)
    none = np.zeros(len(tied.dofs))
    infinite = np.full(len(contacts.dofs), np.inf)
    slots = support_slots(problem)[1]
    supported = equalities(slots, np.zeros(len(slots)))
    balance = Balance(
        r=r,
        reduced=to_reduced(T, r),
        equal=join([supported, replace(tied, lower=none, upper=none)]),
        bounds=replace(contacts, lower=-infinite, upper=infinite),
        elements=0.0,
        external=0.0,
    )
    try:
        lin = linearise(problem, balance, tangent=False)
        solved = backends.solve(
            lin.qp,
            linear=problem.linear,
            start_active=np.zeros(len(contacts.dofs), dtype=np.int8),
            rtol=tightest(rtol),
        )
    except (backends.QPNotSolved, backends.UnusableQP):
        return None
    return to_displacement(T, solved.x).array_r.reshape(forces.shape).copy()

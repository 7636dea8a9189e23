# SPDX-License-Identifier: MIT
"""The factorisation or multigrid at hand, and what it is of."""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.parallel import free_unused
from dolfinx_mortar.arrays import Ints
from dolfinx_mortar.qp.multigrid import Multigrid, OwnUnknowns, Unknowns
from dolfinx_mortar.qp.operator import Operator
from dolfinx_mortar.qp.options import SolverOptions
from dolfinx_mortar.qp.updates import LIMIT

# INFOG(1): workspace too small; ICNTL(14) is the percentage by which it exceeds the estimate.
WORKSPACE_ERRORS = (-8, -9)
WORKSPACE = "mat_mumps_icntl_14"
# INFOG(1): could not allocate, or not within its limit; and PETSc's PC_FACTOR_OUTMEMORY.
MEMORY_ERRORS, OUT_OF_MEMORY = (-7, -13, -18, -19, -20), 3


@dataclass
class LinearCounts:
    """What the solver has done so far."""

    symbolic: int = 0  # analyses of a pattern
    factorisations: int = 0  # numeric factorisations or preconditioner set-ups
    iterations: int = 0  # applications of the factorisation or preconditioner
    solves: int = 0
    breakdowns: int = 0  # old set-ups with which an iteration failed
    seconds_factor: float = 0.0
    seconds_solve: float = 0.0


class Preconditioner:
    """M^-1 of an operator as it was at some time, for a KSP.

    Args:
        operator: the operator.
        ksp: its solver, which gets this preconditioner.
        options: PETSc options of both.
        unknowns: in which multigrid works; by default those of the operator.
    """

    def __init__(
        self,
        operator: Operator,
        ksp: PETSc.KSP,
        options: SolverOptions,
        unknowns: Unknowns | None,
    ) -> None:
        """Create the PC; nothing is set up."""
        self.operator, self.ksp, self.options = operator, ksp, options
        self.unknowns = OwnUnknowns(operator.A) if unknowns is None else unknowns
        self.held: Ints | None = None  # when it was set up
        self._state = -1  # of A at that time
        # state of A, and held unknowns, that multigrid's finest level is of
        self._followed: tuple[int, Ints] = (-1, np.empty(0, dtype=np.int32))
        self.multigrid: Multigrid | None = None
        self.pc = ksp.getPC()
        if not options.direct:
            self.multigrid = Multigrid(operator.A, options.prefix)
            self.pc = self.multigrid.inner
            ksp.setPC(PETSc.PC().createPython(self.multigrid, comm=ksp.comm))

    @property
    def description(self) -> str:
        """Name of the method."""
        name = str(self.pc.getType())
        return f"{name} ({self.pc.getFactorSolverType()})" if self.options.direct else name

    def is_of(self, held: Ints) -> bool:
        """Tell whether it is that of the present A with this mask (collective)."""
        same = self.held is not None and np.array_equal(self.held, held)
        comm = self.ksp.comm.tompi4py()
        return self._state == self.operator.state and bool(comm.allreduce(same, op=MPI.LAND))

    def differences(self, held: Ints) -> int | None:
        """Return how many unknowns its mask differs by (collective); None if there is none."""
        if self.held is None:
            return None
        return int(self.ksp.comm.tompi4py().allreduce(np.setxor1d(self.held, held).size))

    def clear(self) -> None:
        """Free the factorisation or the levels, and let go of the matrices; collective.

        PETSc keeps them in a PC that somebody else knows, also when the KSP is destroyed.
        """
        self.ksp.getPC().reset()
        if self.multigrid is not None:
            self.multigrid.clear()

    def renew(self, held: Ints, counts: LinearCounts) -> str:
        """Set up anew; return why it failed and what to do, or nothing (collective)."""
        if self.multigrid is not None:
            self.multigrid.clear()  # two at a time would need twice the memory
        free_unused(self.ksp.comm.tompi4py())
        if self.multigrid is None:
            self._factorise(counts)
        else:
            with self.options.database(self.options.prefix):
                data = self.unknowns.preconditioning(held)
                self.multigrid.renew(data, held, definite=self.operator.definite)
                self._followed = -1, held
            counts.factorisations += 1
        self.held, self._state = held.copy(), self.operator.state
        if self.pc.getFailedReason() == 0:
            return ""
        self.held = None
        why = f"({reason(self.pc)}). {remedy(self.pc)}"
        if self.multigrid is None:
            self.pc.reset()  # PETSc would take a failed factor of the same matrix for a good one
        return why

    def follow(self, held: Ints) -> None:
        """Let multigrid know what is held now; collective."""
        if self.multigrid is None:
            return
        if not self.multigrid.follows:
            self.multigrid.hold(held, self.operator.diagonal)
            return
        now = self.operator.state
        same = self._followed[0] == now and np.array_equal(self._followed[1], held)
        if not self.ksp.comm.tompi4py().allreduce(same, op=MPI.LAND):
            self.multigrid.follow(self.unknowns.change(held), held)
            self._followed = now, held.copy()

    def _factorise(self, counts: LinearCounts) -> None:
        """Factorise the masked matrix, with more workspace if there was too little."""
        self.pc.setReusePreconditioner(False)
        self.ksp.setOperators(self.operator.matrix)
        for _ in range(LIMIT):
            with self.options.database(self.options.prefix):
                self.pc.setUp()
            counts.factorisations += 1
            enough = enough_workspace(self.pc)
            if enough is None:
                break
            self.options.grown[WORKSPACE] = enough
            if self.options[WORKSPACE] != str(enough):
                break  # what the user's options database has wins, and cannot grow
            self.pc.reset()  # a failed factor cannot be used again
            self.ksp.setOperators(self.operator.matrix)
            counts.symbolic += 1
        self.pc.setReusePreconditioner(True)


# -- what MUMPS says about a factorisation that failed ----------------------------------------


def mumps_factor(pc: PETSc.PC) -> PETSc.Mat | None:
    """Return the factor if it is one of MUMPS."""
    direct = pc.getType() in ("cholesky", "lu")
    return pc.getFactorMatrix() if direct and pc.getFactorSolverType() == "mumps" else None


def enough_workspace(pc: PETSc.PC) -> int | None:
    """Return a value of ICNTL(14) that doubles the workspace, if that is why MUMPS failed."""
    factor = mumps_factor(pc)
    if factor is None or factor.getMumpsInfog(1) not in WORKSPACE_ERRORS:
        return None
    return 2 * max(int(factor.getMumpsIcntl(14)), 20)


def reason(pc: PETSc.PC) -> str:
    """Return the codes of a failure."""
    factor = mumps_factor(pc)
    code = f", MUMPS INFOG(1) = {factor.getMumpsInfog(1)}" if factor is not None else ""
    return f"PETSc reason {pc.getFailedReason()}{code}"


def remedy(pc: PETSc.PC) -> str:
    """Say what to do about a failure."""
    factor = mumps_factor(pc)
    code = 0 if factor is None else factor.getMumpsInfog(1)
    if code in WORKSPACE_ERRORS:
        return (
            f"PETSc's options database has -{pc.getOptionsPrefix()}{WORKSPACE}, which keeps the "
            "workspace too small: raise it, or leave it out."
        )
    if code in MEMORY_ERRORS or pc.getFailedReason() == OUT_OF_MEMORY:
        return (
            "It does not fit into memory. Use an iterative solver, as is the default in 3D: "
            'petsc_options={"ksp_type": "cg", "pc_type": "gamg"}; or more ranks on more machines.'
        )
    return (
        "Most often a body is held by nothing: add a Dirichlet condition or a contact that holds "
        "it, or check the material constants."
    )

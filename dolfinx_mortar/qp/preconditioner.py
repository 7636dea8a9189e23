# SPDX-License-Identifier: MIT
"""The factorisation or multigrid at hand, and what it is of."""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.parallel import free_unused
from dolfinx_mortar.arrays import Ints
from dolfinx_mortar.qp import mumps
from dolfinx_mortar.qp.counts import LinearCounts
from dolfinx_mortar.qp.multigrid import Multigrid, OwnUnknowns, Unknowns
from dolfinx_mortar.qp.operator import Operator
from dolfinx_mortar.qp.options import SolverOptions
from dolfinx_mortar.qp.tolerances import LIMIT


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
                self.multigrid.renew(self.unknowns.preconditioning(held), held)
                self._followed = -1, held
            counts.factorisations += 1
        self.held, self._state = held.copy(), self.operator.state
        if self.pc.getFailedReason() == 0:
            return ""
        self.held = None
        return f"({mumps.reason(self.pc)}). {mumps.remedy(self.pc)}"

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
            enough = mumps.enough_workspace(self.pc)
            if enough is None:
                break
            self.options.values[mumps.WORKSPACE] = enough
            if self.options[mumps.WORKSPACE] != str(enough):
                break  # what the user's options database has wins, and cannot grow
            self.pc.reset()  # a failed factor cannot be used again
            self.ksp.setOperators(self.operator.matrix)
            counts.symbolic += 1
        self.pc.setReusePreconditioner(True)

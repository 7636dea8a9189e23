# SPDX-License-Identifier: MIT
"""The committed state of a problem in one record, of which checkpoints are made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from mpi4py import MPI

import numpy as np

from dolfinx import fem
from dolfinx_mortar.algebra.parallel import any_rank
from dolfinx_mortar.arrays import Bools, Floats
from dolfinx_mortar.interfaces.interface import Interface
from dolfinx_mortar.interfaces.system import InterfaceSystem, Paired
from dolfinx_mortar.solid.solid import Solid
from dolfinx_mortar.solid.term import Term
from dolfinx_mortar.step_report import LoadStep
from dolfinx_mortar.supports.dirichlet import Dirichlet

COLUMN_OF_TERM = "term"


@dataclass(frozen=True)
class SupportForces:
    """What supports exert on the bodies at the end of a step."""

    forces: Floats  # (owned nodes, d), zero without a Dirichlet condition
    points: Floats  # (owned nodes, d) at which they act


@dataclass(frozen=True, eq=False)  # compared by identity: two calls may have the same levels
class Walk:
    """A call of `load_steps`."""

    start: float  # level at which it began
    ramp: list[list[list[float]]]  # tables, see `steps.ramp`


@dataclass(frozen=True)
class Slips:
    """Totals of friction since the start."""

    slid: Floats  # (interfaces, owned nodes) length of the slip path
    dissipated: Floats  # (interfaces, owned nodes) energy dissipated by friction


@dataclass
class Committed:
    """The state from which the next step starts, beside u and the internal variables."""

    active: Bools  # (owned nodes,) closed contacts of the last step that has converged
    displacement: Floats  # (n,) owned, from which slips are measured
    slid: Floats  # (interfaces, owned nodes), see `Slips`
    dissipated: Floats  # (interfaces, owned nodes), see `Slips`
    begun: bool = False  # a step has been committed
    sliding: Floats | None = None  # (owned nodes, d) slip directions of closed nodes, 0 if stuck
    found_at: Floats | None = None  # (n,) displacement at which the last step has ended
    found_slips: Slips | None = None  # at the end of the last step, with friction
    found_paired: Paired | None = None  # where the last step has paired the surfaces
    paired: Paired | None = None  # the same of the last commit
    earlier: tuple[Bools, Floats | None] | None = None  # closed contacts of the last commit
    level: float = 0.0  # load level, of the last step of `load_steps`
    history: list[LoadStep] = field(default_factory=list)  # all steps of `load_steps`
    brought: int = 0  # how many of them a checkpoint has restored
    walked: int = 0  # how many of them belong to the last call
    walk: Walk | None = None  # the last call of `load_steps`, the only one that may continue
    supports: SupportForces | None = None  # of the last step that has converged

    @property
    def contacts(self) -> tuple[Bools, Floats | None]:
        """Active set and directions of slip at closed nodes, of the last step that converged."""
        return self.active, self.sliding

    @contacts.setter
    def contacts(self, found: tuple[Bools, Floats | None]) -> None:
        self.active, self.sliding = found

    def has_ended_at(self, comm: MPI.Comm, u: Floats) -> bool:
        """Tell whether the last step has ended at a displacement (n,); collective.

        If the displacement has been reset since, the results of that step are not used.
        """
        elsewhere = self.found_at is None or not np.array_equal(self.found_at, u)
        return not any_rank(comm, elsewhere)[0]

    def contacts_at(self, comm: MPI.Comm, u: Floats) -> tuple[Bools, Floats | None]:
        """Return the contacts that a step from a displacement (n,) begins with; collective.

        Those of the last step if it has ended there, otherwise those of the last commit.
        """
        if self.found_at is None or self.has_ended_at(comm, u):
            return self.contacts
        return self.earlier or (np.zeros_like(self.active), None)

    def commit(self, comm: MPI.Comm, u: Floats) -> None:
        """Commit the results of the step that has ended at a displacement (n,); collective."""
        self.begun = True
        ended = self.has_ended_at(comm, u)
        self.paired = self.found_paired if ended else self.paired
        if self.found_slips is not None and ended:
            self.slid, self.dissipated = self.found_slips.slid, self.found_slips.dissipated
        self.contacts = self.earlier = self.contacts_at(comm, u)
        self.displacement, self.found_at = u.copy(), u.copy()


@dataclass(frozen=True)
class ProblemState:
    """The parts of a problem that have a state or identify it, for checkpoints."""

    solid: Solid
    interfaces: Sequence[Interface]
    system: InterfaceSystem
    supports: Dirichlet
    geometry: str
    committed: Committed
    terms: Sequence[tuple[str, Term]]  # what else adds forces, by name

    @property
    def u(self) -> fem.Function:
        """The displacement."""
        return self.solid.u

    @property
    def states_of_terms(self) -> dict[str, fem.Function]:
        """States of the terms by the name of their column in a checkpoint."""
        return {
            f"{COLUMN_OF_TERM} {k} {name}": f
            for k, (_, term) in enumerate(self.terms)
            for name, f in term.state.items()
        }

    @property
    def comm(self) -> MPI.Comm:
        """The ranks."""
        return self.solid.mesh.comm

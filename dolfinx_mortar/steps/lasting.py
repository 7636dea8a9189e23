# SPDX-License-Identifier: MIT
"""What of a problem goes on from step to step, in one record: what a checkpoint is made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from mpi4py import MPI

from dolfinx import fem
from dolfinx_mortar.arrays import Bools, Floats
from dolfinx_mortar.interfaces.contact import Contact
from dolfinx_mortar.interfaces.coupling import Sides
from dolfinx_mortar.interfaces.interface import Interface
from dolfinx_mortar.interfaces.system import InterfaceSystem
from dolfinx_mortar.solid.solid import Solid
from dolfinx_mortar.steps.dirichlet import Dirichlet
from dolfinx_mortar.steps.report import LoadStep


@dataclass(frozen=True)
class SupportForces:
    """What supports exert on the bodies at the end of a step."""

    forces: Floats  # (owned nodes, d), zero where nothing is prescribed
    points: Floats  # (owned nodes, d) where they act


@dataclass
class Committed:
    """What the next step starts from, beside the displacement and the internal variables."""

    active: Bools  # (owned nodes,) closed contacts
    displacement: Floats  # (n,) owned, from which slips are measured
    slid: Floats  # (interfaces, owned nodes) length of the way that nodes have slipped
    dissipated: Floats  # (interfaces, owned nodes) energy that friction has taken there
    begun: bool = False  # a step has been committed
    sliding: Floats | None = None  # (owned nodes, d) directions in which closed nodes slip, or 0
    level: float = 0.0  # load level, of the last step of `load_steps`
    history: list[LoadStep] = field(default_factory=list)  # all steps of `load_steps`
    brought: int = 0  # how many of them a checkpoint has brought
    walked: int = 0  # how many of them belong to the last call
    walk: object = None  # the last call of `load_steps`, the only one that may go on
    supports: SupportForces | None = None  # of the last step that has converged
    search: bool = False  # the next step pairs the surfaces anew, after a checkpoint

    @property
    def contacts(self) -> tuple[Bools, Floats | None]:
        """Which contacts are closed, and which of them slip whither: the guess of the next step."""
        return self.active, self.sliding

    @contacts.setter
    def contacts(self, found: tuple[Bools, Floats | None]) -> None:
        self.active, self.sliding = found

    def take_slips(self, sides: Sequence[Sides], interfaces: Sequence[Interface]) -> None:
        """Take over what the last step has added to the slips."""
        for k, (side, interface) in enumerate(zip(sides, interfaces, strict=True)):
            if isinstance(interface, Contact) and interface.sliding is not None:
                self.slid[k, side.nodes] = interface.sliding.slip.x.array[side.nodes]
                self.dissipated[k, side.nodes] = interface.sliding.energy.x.array[side.nodes]


@dataclass(frozen=True)
class Lasting:
    """Where the state of a problem lives, and what tells the problem from others."""

    solid: Solid
    interfaces: Sequence[Interface]
    system: InterfaceSystem
    supports: Dirichlet
    geometry: str
    committed: Committed

    @property
    def u(self) -> fem.Function:
        """The displacement."""
        return self.solid.u

    @property
    def comm(self) -> MPI.Comm:
        """The ranks."""
        return self.solid.mesh.comm

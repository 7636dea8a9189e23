# SPDX-License-Identifier: MIT
"""The committed state of a problem, for checkpoints and undoing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from mpi4py import MPI

from dolfinx import fem
from dolfinx_mortar.common.arrays import Bools, Floats
from dolfinx_mortar.common.step_report import LoadStep
from dolfinx_mortar.interfaces.interface import Interface
from dolfinx_mortar.interfaces.system import InterfaceSystem
from dolfinx_mortar.solid.solid import Solid
from dolfinx_mortar.solid.supports import Dirichlet
from dolfinx_mortar.solid.term import Term, ask_term


@dataclass(frozen=True)
class SupportForces:
    """Forces of the supports on the bodies at the end of a step."""

    forces: Floats  # (owned nodes, d), zero without a Dirichlet condition
    points: Floats  # (owned nodes, d) at which they act


@dataclass(frozen=True, eq=False)  # two calls may have the same levels
class Walk:
    """A call of `load_steps` or `time_steps`."""

    start: float
    ramp: list[list[list[float]]]  # tables, see `steps.ramp`
    settings: dict[str, Any]  # of its steps by name


@dataclass(frozen=True)
class Slips:
    """Totals of friction since the start."""

    slid: Floats  # (interfaces, owned nodes) length of the slip path
    dissipated: Floats  # (interfaces, owned nodes) energy dissipated by friction


@dataclass(frozen=True)
class Gained:
    """Additions of Newton's iterations to the predicted motion of a step."""

    by: Floats  # (n,) displacement
    travel: Floats  # (m,) motions of tools driven by forces
    duration: float  # increment of the level


@dataclass(frozen=True)
class StepOutcome:
    """Results of a converged step for `Committed.commit`."""

    at: Floats  # (n,) displacement at the end of the step
    active: Bools  # (owned nodes,) closed contacts
    sliding: Floats | None
    paired: Floats | None
    slips: Slips | None  # with friction
    # (owned nodes, d) normal contact forces on both sides
    normal: Floats | None = None
    tangential: Floats | None = None
    ended: Sequence[Any] = ()  # of the interfaces, see `Interface.state`
    level: float | None = None  # level at its end; None for that of the committed state
    gained: Gained | None = None  # None without a level
    before: Before | None = None  # the last commit


@dataclass
class Committed:
    """The state at the start of the next step, without u and the internal variables."""

    active: Bools  # (owned nodes,) closed contacts
    displacement: Floats  # (n,) owned, origin of slips
    slid: Floats  # (interfaces, owned nodes), see `Slips`
    dissipated: Floats  # (interfaces, owned nodes), see `Slips`
    begun: bool = False  # a step has been committed
    sliding: Floats | None = None
    paired: Floats | None = None
    level: float = 0.0  # load level, of the last step of `load_steps`
    history: list[LoadStep] = field(default_factory=list)
    brought: int = 0  # of them, number restored by a checkpoint
    walked: int = 0  # of them, number of the last call
    walk: Walk | None = None  # the last call of `load_steps`, which may continue
    supports: SupportForces | None = None  # of the last step that has converged
    gained: Gained | None = None  # in the last step, see `ContactProblem.begin_step`

    def commit(self, u: Floats, outcome: StepOutcome | None) -> None:
        """Commit the displacement (n,), with the outcome of the step."""
        self.begun, self.displacement, self.gained = True, u.copy(), None
        if outcome is None:
            return
        self.active, self.sliding, self.paired = outcome.active, outcome.sliding, outcome.paired
        self.gained = outcome.gained
        if outcome.level is not None:
            self.level = outcome.level
        if outcome.slips is not None:
            self.slid, self.dissipated = outcome.slips.slid, outcome.slips.dissipated


@dataclass(frozen=True)
class ProblemState:
    """The parts of a problem that have a state or identify it, for checkpoints."""

    solid: Solid
    interfaces: Sequence[Interface]
    system: InterfaceSystem
    supports: Dirichlet
    geometry: str
    committed: Committed
    terms: Sequence[tuple[str, Term]]

    @property
    def states_of_terms(self) -> dict[str, fem.Function]:
        """States of the terms by column of a checkpoint; collective."""
        pairs = zip(self.terms, self.ask_terms("state"), strict=True)
        return {f"{of}: {name}": f for (of, _), state in pairs for name, f in state.items()}

    def ask_terms(self, name: str) -> list[dict[str, Any]]:
        """Mapping of each term by a method; collective."""

        def ask_one(named: str, term: Term) -> dict[str, Any]:
            return ask_term(self.comm, f"{named}: {name}", term, lambda: dict(getattr(term, name)))

        return [ask_one(*one) for one in self.terms]

    @property
    def comm(self) -> MPI.Comm:
        """The ranks."""
        return self.solid.mesh.comm


class Before:
    """Copy of all that a step and its commit change: displacement, results, state."""

    def __init__(self, state: ProblemState, outcome: StepOutcome | None) -> None:
        """Copy the state, and an outcome that has not been committed; collective."""
        self.state, self.outcome = state, outcome
        functions = [state.solid.u, *state.states_of_terms.values()]
        self._values = [(f, f.x.array.copy()) for f in functions]
        self._points = state.solid.points.keep()
        self._results = [(i, i.keep(), i.state(False)) for i in state.interfaces]
        self._committed = vars(state.committed) | {"history": [*state.committed.history]}

    def restore(self) -> None:
        """Restore the copy, perhaps on this rank only; not collective."""
        state = self.state
        for f, values in self._values:
            f.x.array[:] = values
        state.solid.points.put_back(self._points)
        for interface, kept, began in self._results:
            interface.put_back(kept)
            interface.restore(began)
        history = state.committed.history  # the user may refer to this list
        history[:] = self._committed["history"]
        vars(state.committed).update(self._committed, history=history)
        for term in (state.solid, *(term for _, term in state.terms)):
            term.roll_back()

# SPDX-License-Identifier: MIT
"""Restoring a checkpoint: all of it is checked before any of the state is changed."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.arrays import Bools, Floats
from dolfinx_mortar.checkpoint import read_about, read_tables, size_of
from dolfinx_mortar.disk import check_path
from dolfinx_mortar.interfaces.interface import Resultants, check_owned
from dolfinx_mortar.interfaces.system import Paired
from dolfinx_mortar.persistence.committed import (
    Gained,
    ProblemState,
    Slips,
    StepOutcome,
    SupportForces,
    Walk,
)
from dolfinx_mortar.persistence.contents import (
    NODES,
    POINTS,
    RESULTANTS,
    SLIPS,
    UNCOMMITTED,
    check_about,
    check_values,
    name_of,
    named,
)
from dolfinx_mortar.persistence.identity import describe, differences, material_numbers
from dolfinx_mortar.persistence.saving import places_of
from dolfinx_mortar.spaces import set_owned
from dolfinx_mortar.step_report import LoadStep

Tables = Mapping[str, Mapping[str, Floats]]


@dataclass(frozen=True)
class Saved:
    """A checkpoint of this problem, read and checked, but not yet restored."""

    state: ProblemState
    about: Mapping[str, Any]
    tables: Tables
    steps: list[LoadStep]  # the history

    @property
    def walk(self) -> list[float]:
        """The levels that the last call of `load_steps` has reached."""
        return [step.time for step in self.steps[len(self.steps) - self.about["walked"] :]]

    def put(self) -> StepOutcome:
        """Make it the state of the problem; return what a commit takes over; collective.

        Raises:
            Exception: on all ranks, that of `Interface.take_found`; nothing is changed.
        """
        self._take_found()
        state, committed = self.state, self.state.committed
        set_owned(state.u, self.tables[NODES]["displacement"])
        for name, f in state.states_of_terms.items():
            set_owned(f, self.tables[NODES][name])
        committed.active, committed.sliding = self._contacts("")
        supports = self.tables[NODES].get("supports")
        halves = None if supports is None else np.split(supports, 2, axis=1)
        committed.supports = None if halves is None else SupportForces(*halves)
        before = self.tables[NODES].get("committed", self.tables[NODES]["displacement"])
        committed.displacement = before.flatten()
        shown = self.tables[POINTS]
        for name, field in state.solid.lasting_fields().items():
            same = name.replace("shown/", "committed/")
            set_owned(field, shown[name] if name in shown else shown[same])
        state.solid.forget_data()
        slips = Slips(*np.zeros((2, *committed.slid.shape)))
        for k, resultants in enumerate(self.about["interfaces"]):
            _take(state, k, slips, resultants, self.tables.get(name_of(k), {}))
        committed.paired = self._paired()
        committed.gained = self._gained(0, "")
        committed.begun = self.about["begun"]
        committed.level, committed.walked = self.about["level"], self.about["walked"]
        walk = self.about["walk"]
        committed.walk = None if walk is None else Walk(**walk)
        committed.history[:], committed.brought = self.steps, len(self.steps)
        state.system.faced = True
        u = self.tables[NODES]["displacement"].flatten()
        last = UNCOMMITTED if f"{UNCOMMITTED}active" in self.tables[NODES] else ""
        gained = self._gained(1, UNCOMMITTED) if last else committed.gained
        contacts = self._contacts(last)
        return StepOutcome(u, *contacts, committed.paired, slips, gained=gained)

    def _gained(self, k: int, prefix: str) -> Gained | None:
        """Return what a step has gained; None where that is not known, as in files of before."""
        rates = [*self.about.get("gained", []), None, None][k]
        by = self.tables[NODES].get(f"{prefix}gained")
        if rates is None or by is None:
            return None
        return Gained(by.flatten(), np.array(rates["travel"], float), float(rates["duration"]))

    def _contacts(self, prefix: str) -> tuple[Bools, Floats | None]:
        """Return closed contacts and slip directions; without a column, steps begin stuck."""
        nodes = self.tables[NODES]
        return nodes[f"{prefix}active"][:, 0] > 0.0, nodes.get(f"{prefix}sliding")

    def _take_found(self) -> None:
        """Give the interfaces what steps have found; they stay as they are if one refuses it."""
        interfaces = self.state.interfaces
        kept = [interface.keep() for interface in interfaces]
        try:
            with raised_together(self.state.comm):
                for interface, found in zip(interfaces, self.about["found"], strict=True):
                    interface.take_found(found)
        except BaseException:
            for interface, before in zip(interfaces, kept, strict=True):
                interface.put_back(before)
            raise

    def _paired(self) -> Paired | None:
        """Return where the surfaces were paired; None where that is not known."""
        state, tables = self.state, self.tables
        at = tables[NODES].get("paired", np.zeros((0, 1))).flatten()
        near = [tables.get(name_of(k), {}).get("near") for k in range(len(state.interfaces))]
        known = [marks[:, 0] > 0.0 for marks in near if marks is not None]
        complete = len(known) == len(near) and "paired" in tables[NODES]
        if state.geometry == "reference":
            complete = len(known) == len(near)
        return Paired(at, known) if complete else None


def read(state: ProblemState, path: str | os.PathLike[str]) -> Saved:
    """Read a checkpoint of this problem, from any number of ranks; collective.

    Raises:
        OSError: on all ranks, if there is no such file, or it cannot be read.
        ValueError: on all ranks, if it is no checkpoint, cut off or damaged, of another version or
            of another problem, with all differences in the message; if it holds what no such
            problem can have; or if an interface is used by a problem made later.
    """
    file, comm = check_path(state.comm, path), state.comm
    check_owned(state.interfaces, state.supports)
    about, present = read_about(comm, file), describe(state)
    with raised_together(comm), named(file):
        wrong = differences(about["problem"], present)
        if not wrong:
            check_about(state, about, present)
            steps = [LoadStep.from_dict(step) for step in about["steps"]]
    tables: Tables = {}
    if not wrong:
        places = places_of(state, [found is not None for found in about["interfaces"]])
        names = {NODES: "mesh, nodes", POINTS: "mesh, integration points"}
        names |= {name_of(k): f"{i}, slave nodes" for k, i in enumerate(state.interfaces)}
        tables, others = read_tables(comm, file, places, size_of(state.solid.V.mesh))
        wrong = [f"{names[name]}: {text}" for name, text in others.items()]
    if not wrong:
        with raised_together(comm), named(file):
            for name, values in tables.items():
                check_values(state, name, values)
        here = material_numbers(state.solid)
        moved = comm.allreduce(int((tables[POINTS]["material"] != here).sum()), op=MPI.SUM)
        wrong = [f"solid: {moved} integration points have another material"] if moved else []
    if wrong:
        raise ValueError(
            f"path is {str(file)!r}, a checkpoint of another problem: {'; '.join(wrong)}"
        )
    return Saved(state, about, tables, steps)


def _take(
    state: ProblemState,
    k: int,
    ended: Slips,
    resultants: Mapping[str, list[float]] | None,
    values: Mapping[str, Floats],
) -> None:
    """Set the results of an interface, or clear them, and the slips; collective."""
    interface, committed = state.interfaces[k], state.committed
    interface.clear()
    committed.slid[k], committed.dissipated[k] = 0.0, 0.0
    if resultants is None:
        return
    nodes = state.system.sides[k].nodes
    multiplier = values["multiplier"]
    vectors: dict[str, Floats] = {name: np.array(resultants[name], float) for name in RESULTANTS}
    interface.resultants = Resultants(
        **vectors,
        multiplier=interface.shown(multiplier),
        nodes=nodes,
        carries=values["carries"][:, 0] > 0.0,
    )
    for function in interface.functions:
        at_nodes = values[function.name]
        function.x.array.reshape(-1, at_nodes.shape[1])[nodes] = at_nodes
        function.x.scatter_forward()
    if interface.rough:
        columns = committed.slid[k], committed.dissipated[k], ended.slid[k], ended.dissipated[k]
        for column, name in zip(columns, (*SLIPS, "slip", "energy"), strict=True):
            column[nodes] = values[name][:, 0]
    interface.sum_up(state.comm, nodes)

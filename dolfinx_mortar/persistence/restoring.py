# SPDX-License-Identifier: MIT
"""Restoring a checkpoint: it is compared with the problem before any of the state is changed.

Its checksum shows that it is as it was written, so its contents are not validated.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx import fem
from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.checkpoint import read_about, read_tables, size_of
from dolfinx_mortar.disk import check_path
from dolfinx_mortar.interfaces.interface import Interface, Resultants, ask, check_owned
from dolfinx_mortar.interfaces.system import Paired
from dolfinx_mortar.persistence.committed import ProblemState, Slips, SupportForces, Walk
from dolfinx_mortar.persistence.identity import describe, differences, material_numbers
from dolfinx_mortar.persistence.saving import NODES, POINTS, RESULTANTS, SLIPS, name_of, places_of
from dolfinx_mortar.step_report import LoadStep

Tables = Mapping[str, Mapping[str, Floats]]


@dataclass(frozen=True)
class Saved:
    """A checkpoint of this problem, read and compared, but not yet restored."""

    state: ProblemState
    about: Mapping[str, Any]
    tables: Tables
    steps: list[LoadStep]  # the history

    @property
    def walk(self) -> list[float]:
        """The levels that the last call of `load_steps` has reached."""
        return [step.time for step in self.steps[len(self.steps) - self.about["walked"] :]]

    def put(self) -> None:
        """Make it the state of the problem; collective."""
        state, committed = self.state, self.state.committed
        _set(state.u, self.tables[NODES]["displacement"])
        for name, f in state.states_of_terms.items():
            _set(f, self.tables[NODES][name])
        closed = self.tables[NODES]["active"][:, 0] > 0.0
        # without a column, begin stuck
        committed.contacts = committed.earlier = closed, self.tables[NODES].get("sliding")
        committed.found_at = self.tables[NODES]["displacement"].flatten()
        supports = self.tables[NODES].get("supports")
        halves = None if supports is None else np.split(supports, 2, axis=1)
        committed.supports = None if halves is None else SupportForces(*halves)
        before = self.tables[NODES].get("committed", self.tables[NODES]["displacement"])
        committed.displacement = before.flatten()
        shown = self.tables[POINTS]
        for name, field in state.solid.lasting_fields().items():
            same = name.replace("shown/", "committed/")
            _set(field, shown[name] if name in shown else shown[same])
        committed.found_slips = Slips(*np.zeros((2, *committed.slid.shape)))
        for k, interface in enumerate(state.interfaces):
            resultants = self.about["interfaces"][k]
            _take(state, k, interface, resultants, self.tables.get(name_of(k), {}))
            ask(state.comm, interface, "take_found", self.about["found"][k])
        committed.paired = committed.found_paired = self._paired()
        committed.begun = self.about["begun"]
        committed.level, committed.walked = self.about["level"], self.about["walked"]
        walk = self.about["walk"]
        committed.walk = None if walk is None else Walk(**walk)
        committed.history[:], committed.brought = self.steps, len(self.steps)
        state.system.faced = True

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
            of another problem, with all differences in the message; or if an interface is used by
            a problem made later.
    """
    file, comm = check_path(state.comm, path), state.comm
    check_owned(state.interfaces, state.supports)
    about = read_about(comm, file)
    wrong = differences(about["problem"], describe(state))
    tables: Tables = {}
    if not wrong:
        places = places_of(state, [found is not None for found in about["interfaces"]])
        names = {NODES: "mesh, nodes", POINTS: "mesh, integration points"}
        names |= {name_of(k): f"{i}, slave nodes" for k, i in enumerate(state.interfaces)}
        tables, others = read_tables(comm, file, places, size_of(state.solid.V.mesh))
        wrong = [f"{names[name]}: {text}" for name, text in others.items()]
    if not wrong:
        here = material_numbers(state.solid)
        moved = comm.allreduce(int((tables[POINTS]["material"] != here).sum()), op=MPI.SUM)
        wrong = [f"solid: {moved} integration points have another material"] if moved else []
    if wrong:
        raise ValueError(
            f"path is {str(file)!r}, a checkpoint of another problem: {'; '.join(wrong)}"
        )
    return Saved(state, about, tables, [LoadStep.from_dict(step) for step in about["steps"]])


def _take(
    state: ProblemState,
    k: int,
    interface: Interface,
    resultants: Mapping[str, list[float]] | None,
    values: Mapping[str, Floats],
) -> None:
    """Give an interface its results, or take them away; collective."""
    interface.clear()
    committed, ended = state.committed, state.committed.found_slips
    assert ended is not None
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


def _set(f: fem.Function, values: Floats) -> None:
    """Set a Function to owned values (n, c); collective."""
    f.x.array[: values.size] = values.ravel()
    f.x.scatter_forward()

# SPDX-License-Identifier: MIT
"""Checkpoints of a problem: saving its committed state, and restoring it as a whole.

Displacement, internal variables, stress, contacts, slips, forces of supports and load level;
results of the interfaces; tightening of ties; history of load steps, tables of their ramps. What a
program sets before each step is not saved: loads, supports, jumps, changing parameters.
"""

import dataclasses
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx import fem
from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.algebra.parallel import any_rank
from dolfinx_mortar.arrays import Bools, Floats
from dolfinx_mortar.checkpoint import (
    Table,
    find_places,
    read_about,
    read_tables,
    size_of,
    write,
)
from dolfinx_mortar.disk import check_path
from dolfinx_mortar.interfaces.interface import Interface, check_owned
from dolfinx_mortar.interfaces.results import Resultants
from dolfinx_mortar.interfaces.system import Paired
from dolfinx_mortar.persistence.committed import (
    Before,
    Committed,
    Gained,
    ProblemState,
    Slips,
    StepOutcome,
    SupportForces,
    Walk,
)
from dolfinx_mortar.persistence.identity import describe, differences, material_numbers
from dolfinx_mortar.spaces import set_owned
from dolfinx_mortar.step_report import LoadStep

NODES, POINTS = "nodes", "points"
SLIPS = ("slid", "dissipated")
RESULTANTS = ("force", "moment", "master_force", "master_moment", "place")
UNCOMMITTED = "uncommitted "  # before what a step has found that has not been committed
UNDEFINED = ("gap",)  # NaN where a slave node faces no master


def save(state: ProblemState, path: str | os.PathLike[str], outcome: StepOutcome | None) -> None:
    """Write a checkpoint, with the outcome of a step not yet committed; `ContactProblem.save`."""
    file = check_path(state.comm, path)
    check_owned(state.interfaces, state.supports)
    committed = state.committed
    results = [_resultants(interface) for interface in state.interfaces]
    about = {
        "problem": describe(state),
        "begun": committed.begun,
        "level": committed.level,
        "walked": committed.walked,
        "walk": None if committed.walk is None else dataclasses.asdict(committed.walk),
        "steps": [step.as_dict() for step in committed.history],
        "interfaces": results,
        "gained": [_rates(committed), _rates(outcome)],
        "found": [{n: v.tolist() for n, v in i.state(False).items()} for i in state.interfaces],
    }
    values = {NODES: _nodal(state, outcome), POINTS: _at_points(state)}
    for k, interface in enumerate(state.interfaces):
        if results[k] is not None:
            values[_name_of(k)] = _on_interface(interface) | _slips(state, k) | _near(state, k)
    with raised_together(state.comm):
        for name, table in values.items():
            for column, array in table.items():
                if column not in UNDEFINED and not np.isfinite(array).all():
                    raise ValueError(f"{name}: {column} holds NaN or infinity: nothing is saved")
    places = _places_of(state, [result is not None for result in results])
    write(state.comm, file, about, {name: Table(at, values[name]) for name, at in places.items()})


@dataclass(frozen=True)
class Saved:
    """A checkpoint of this problem, read, but not yet restored."""

    state: ProblemState
    about: Mapping[str, Any]
    tables: Mapping[str, Mapping[str, Floats]]
    steps: list[LoadStep]  # the history

    @property
    def walk(self) -> list[float]:
        """The levels that the last call of `load_steps` has reached."""
        return [step.time for step in self.steps[len(self.steps) - self.about["walked"] :]]

    def put(self) -> StepOutcome:
        """Make it the state of the problem; return what a commit takes over; collective.

        Raises:
            Exception: on all ranks, that of `Interface.restore`; nothing is changed.
        """
        before = Before(self.state, None)
        try:
            return self._put()
        except BaseException:
            before.restore()
            raise

    def _put(self) -> StepOutcome:
        state, committed, nodes = self.state, self.state.committed, self.tables[NODES]
        with raised_together(state.comm):
            for interface, found in zip(state.interfaces, self.about["found"], strict=True):
                interface.restore({name: np.array(v, float) for name, v in found.items()})
        set_owned(state.u, nodes["displacement"])
        for name, f in state.states_of_terms.items():
            set_owned(f, nodes[name])
        committed.active, committed.sliding = self._contacts("")
        supports = nodes.get("supports")
        halves = None if supports is None else np.split(supports, 2, axis=1)
        committed.supports = None if halves is None else SupportForces(*halves)
        committed.displacement = nodes.get("committed", nodes["displacement"]).flatten()
        shown = self.tables[POINTS]
        for name, field in state.solid.lasting_fields().items():
            same = name.replace("shown/", "committed/")
            set_owned(field, shown[name] if name in shown else shown[same])
        state.solid.forget_data()
        slips = Slips(*np.zeros((2, *committed.slid.shape)))
        for k, resultants in enumerate(self.about["interfaces"]):
            _take(state, k, slips, resultants, self.tables.get(_name_of(k), {}))
        committed.paired, committed.gained = self._paired(), self._gained(0, "")
        committed.begun = self.about["begun"]
        committed.level, committed.walked = self.about["level"], self.about["walked"]
        walk = self.about["walk"]
        committed.walk = None if walk is None else Walk(**walk)
        committed.history[:], committed.brought = self.steps, len(self.steps)
        state.system.faced = True
        last = UNCOMMITTED if f"{UNCOMMITTED}active" in nodes else ""
        gained = self._gained(1, UNCOMMITTED) if last else committed.gained
        u, contacts = nodes["displacement"].flatten(), self._contacts(last)
        return StepOutcome(u, *contacts, committed.paired, slips, gained=gained)

    def _gained(self, k: int, prefix: str) -> Gained | None:
        """Return what a step has gained, None for nothing."""
        rates = self.about["gained"][k]
        if rates is None:
            return None
        by = self.tables[NODES][f"{prefix}gained"].flatten()
        return Gained(by, np.array(rates["travel"], float), float(rates["duration"]))

    def _contacts(self, prefix: str) -> tuple[Bools, Floats | None]:
        """Return closed contacts and slip directions; without a column, steps begin stuck."""
        nodes = self.tables[NODES]
        return nodes[f"{prefix}active"][:, 0] > 0.0, nodes.get(f"{prefix}sliding")

    def _paired(self) -> Paired | None:
        """Return where the surfaces were paired; None where that is not known."""
        state, tables = self.state, self.tables
        at = tables[NODES].get("paired", np.zeros((0, 1))).flatten()
        near = [tables.get(_name_of(k), {}).get("near") for k in range(len(state.interfaces))]
        known = [marks[:, 0] > 0.0 for marks in near if marks is not None]
        complete = "paired" in tables[NODES] or state.geometry == "reference"
        return Paired(at, known) if complete and len(known) == len(near) else None


def read(state: ProblemState, path: str | os.PathLike[str]) -> Saved:
    """Read a checkpoint of this problem, from any number of ranks; collective.

    Raises:
        OSError: on all ranks, if there is no such file, or it cannot be read.
        ValueError: on all ranks, if it is no checkpoint, cut off or damaged, of another version or
            of another problem, with all differences in the message; or if an interface is used by a
            problem made later.
    """
    file, comm = check_path(state.comm, path), state.comm
    check_owned(state.interfaces, state.supports)
    about = read_about(comm, file)
    wrong = differences(about["problem"], describe(state))
    tables: dict[str, dict[str, Floats]] = {}
    if not wrong:
        places = _places_of(state, [found is not None for found in about["interfaces"]])
        names = {NODES: "mesh, nodes", POINTS: "mesh, integration points"}
        names |= {_name_of(k): f"{i}, slave nodes" for k, i in enumerate(state.interfaces)}
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
    vectors: dict[str, Floats] = {name: np.array(resultants[name], float) for name in RESULTANTS}
    shown = values["multiplier"]
    interface.resultants = Resultants(
        **vectors,
        multiplier=shown[:, 0] if interface.unilateral else shown,
        nodes=nodes,
        carries=values["carries"][:, 0] > 0.0,
    )
    for function in interface.nodal.values():
        at_nodes = values[function.name]
        function.x.array.reshape(-1, at_nodes.shape[1])[nodes] = at_nodes
        function.x.scatter_forward()
    if interface.law is not None:
        columns = committed.slid[k], committed.dissipated[k], ended.slid[k], ended.dissipated[k]
        for column, name in zip(columns, (*SLIPS, "slip", "energy"), strict=True):
            column[nodes] = values[name][:, 0]
    interface.sum_up(state.comm, nodes)


# -- values of this rank -------------------------------------------------------------------------


def _name_of(k: int) -> str:
    """Return the name of the table of an interface."""
    return f"interface {k}"


def _places_of(state: ProblemState, results: Sequence[bool]) -> dict[str, Floats]:
    """Return the places of the tables; interfaces without results have none; collective."""
    nodes = find_places(state.solid.V)
    sides = enumerate(state.system.sides)
    return {NODES: nodes, POINTS: find_places(state.solid.stress.function_space)} | {
        _name_of(k): nodes[side.nodes] for k, side in sides if results[k]
    }


def _nodal(state: ProblemState, outcome: StepOutcome | None) -> dict[str, Floats]:
    u = _owned(state.u)
    found = {"displacement": u} | _contacts(state, state.committed)
    if outcome is not None:
        contacts = _contacts(state, outcome)
        found |= {f"{UNCOMMITTED}{name}": values for name, values in contacts.items()}
    if (paired := state.committed.paired) is not None and len(paired.at):
        found["paired"] = paired.at.reshape(u.shape)
    if (supports := state.committed.supports) is not None:
        found["supports"] = np.hstack([supports.forces, supports.points])
    if state.system.has_friction:  # slips are measured from it
        found["committed"] = state.committed.displacement.reshape(u.shape)
    return found | {name: _owned(f) for name, f in state.states_of_terms.items()}


def _contacts(state: ProblemState, last: StepOutcome | Committed) -> dict[str, Floats]:
    """Return closed contacts and slip directions."""
    found = {"active": last.active[:, None].astype(float)}
    if state.system.has_friction and last.sliding is not None:
        found["sliding"] = last.sliding
    if last.gained is not None:
        found["gained"] = last.gained.by.reshape(-1, state.solid.V.dofmap.index_map_bs)
    return found


def _rates(last: StepOutcome | Committed | None) -> dict[str, Any] | None:
    """Return what a step has gained that is not nodal, None for nothing."""
    gained = None if last is None else last.gained
    if gained is None:
        return None
    return {"travel": gained.travel.tolist(), "duration": gained.duration}


def _at_points(state: ProblemState) -> dict[str, Floats]:
    """Return the fields at the owned points; those that are shown only if not committed as well."""
    fields = {name: _owned(f) for name, f in state.solid.lasting_fields().items()}
    for name in [name for name in fields if name.startswith("shown/")]:
        differs = not np.array_equal(fields[name], fields[name.replace("shown/", "committed/")])
        if not any_rank(state.comm, differs)[0]:
            del fields[name]
    return fields | {"material": material_numbers(state.solid)}


def _on_interface(interface: Interface) -> dict[str, Floats]:
    """Return the results at the owned slave nodes."""
    found = interface.resultants
    assert found is not None
    nodal = {name: _owned(f)[found.nodes] for name, f in interface.nodal.items()}
    multiplier = found.multiplier if found.multiplier.ndim > 1 else found.multiplier[:, None]
    return nodal | {"multiplier": multiplier, "carries": found.carries[:, None].astype(float)}


def _near(state: ProblemState, k: int) -> dict[str, Floats]:
    """Return which owned slave nodes are transformed by T, nothing before the first commit."""
    paired = state.committed.paired
    return {} if paired is None else {"near": paired.near[k][:, None].astype(float)}


def _slips(state: ProblemState, k: int) -> dict[str, Floats]:
    """Return total slip and dissipation at the owned slave nodes, nothing without friction."""
    interface, nodes = state.interfaces[k], state.system.sides[k].nodes
    if interface.law is None:
        return {}
    columns = state.committed.slid[k], state.committed.dissipated[k]
    return {name: c[nodes, None] for name, c in zip(SLIPS, columns, strict=True)}


def _resultants(interface: Interface) -> dict[str, Any] | None:
    """Return the resultants, None before the first step."""
    found = interface.resultants
    return None if found is None else {n: getattr(found, n).tolist() for n in RESULTANTS}


def _owned(f: fem.Function) -> Floats:
    """Return the owned values (n, c) of a Function."""
    dofmap = f.function_space.dofmap
    return np.asarray(f.x.array.reshape(-1, dofmap.bs)[: dofmap.index_map.size_local])

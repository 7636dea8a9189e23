# SPDX-License-Identifier: MIT
"""Saving the committed state of a problem in a checkpoint; the counterpart is `restoring`.

Displacement, internal variables, stress, closed contacts, slips, forces of supports and load level;
results of the interfaces (multipliers, pressures, gaps, resultants); tightening of ties; history of
the load steps, and the tables of their ramps. Data that a program sets before each step are not
saved: loads, supports, jumps, parameters and eigenstrain that may change.
"""

import dataclasses
import os
from collections.abc import Sequence
from typing import Any

import numpy as np

from dolfinx import fem
from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.algebra.parallel import any_rank
from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.checkpoint import Table, find_places, write
from dolfinx_mortar.disk import check_path
from dolfinx_mortar.interfaces.interface import Interface, ask, check_owned
from dolfinx_mortar.persistence.committed import Committed, ProblemState, StepOutcome
from dolfinx_mortar.persistence.contents import (
    NODES,
    POINTS,
    RESULTANTS,
    SLIPS,
    UNCOMMITTED,
    check_values,
    name_of,
)
from dolfinx_mortar.persistence.identity import describe, material_numbers


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
        "found": [ask(state.comm, interface, "found") for interface in state.interfaces],
    }
    places = places_of(state, [result is not None for result in results])
    values = {NODES: _nodal(state, outcome), POINTS: _at_points(state)}
    for k, interface in enumerate(state.interfaces):
        if results[k] is not None:
            values[name_of(k)] = _on_interface(interface) | _slips(state, k) | _near(state, k)
    with raised_together(state.comm):  # no restart could read what is not finite
        for name in places:
            check_values(state, name, values[name])
    tables = {name: Table(places[name], values[name]) for name in places}
    write(state.comm, file, about, tables)


# -- values of this rank -------------------------------------------------------------------------


def places_of(state: ProblemState, results: Sequence[bool]) -> dict[str, Floats]:
    """Return the places of the tables; interfaces without results have none; collective."""
    nodes = find_places(state.solid.V)
    sides = enumerate(state.system.sides)
    return {NODES: nodes, POINTS: find_places(state.solid.stress.function_space)} | {
        name_of(k): nodes[side.nodes] for k, side in sides if results[k]
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
        found["gained"] = last.gained.by.reshape(len(last.active), -1)
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
    fields, found = interface.fields, interface.resultants
    assert fields is not None and found is not None
    nodal = {f.name: _owned(f)[found.nodes] for f in interface.functions}
    multiplier = found.multiplier if found.multiplier.ndim > 1 else found.multiplier[:, None]
    return nodal | {"multiplier": multiplier, "carries": found.carries[:, None].astype(float)}


def _near(state: ProblemState, k: int) -> dict[str, Floats]:
    """Return which owned slave nodes are transformed by T, nothing before the first commit."""
    paired = state.committed.paired
    return {} if paired is None else {"near": paired.near[k][:, None].astype(float)}


def _slips(state: ProblemState, k: int) -> dict[str, Floats]:
    """Return total slip and dissipation at the owned slave nodes, nothing without friction."""
    interface, nodes = state.interfaces[k], state.system.sides[k].nodes
    if not interface.rough:
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

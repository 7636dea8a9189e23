# SPDX-License-Identifier: MIT
"""Saving the committed state of a problem in a checkpoint; the counterpart is `restoring`.

Displacement, internal variables, stress, closed contacts, slips, forces of supports and load level;
results of the interfaces (multipliers, pressures, gaps, resultants); tightening of ties; history of
the load steps, and the tables of their ramps. Data that a program sets before each step are not
saved: loads, supports, jumps, parameters and eigenstrain that may change.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from typing import Any

import numpy as np

from dolfinx import fem
from dolfinx_mortar.algebra.parallel import any_rank
from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.checkpoint import Table, find_places, write
from dolfinx_mortar.disk import check_path
from dolfinx_mortar.interfaces.interface import Interface, check_owned
from dolfinx_mortar.persistence.identity import describe, material_numbers
from dolfinx_mortar.persistence.lasting import Lasting

NODES, POINTS = "nodes", "points"
SLIPS = ("slid", "dissipated")
RESULTANTS = ("force", "moment", "master_force", "master_moment")


def save(lasting: Lasting, path: str | os.PathLike[str]) -> None:
    """Write a checkpoint; see `ContactProblem.save`."""
    file = check_path(lasting.comm, path)
    check_owned(lasting.interfaces, lasting.supports)
    committed = lasting.committed
    results = [_resultants(interface) for interface in lasting.interfaces]
    about = {
        "problem": describe(lasting),
        "begun": committed.begun,
        "level": committed.level,
        "walked": committed.walked,
        "walk": None if committed.walk is None else dataclasses.asdict(committed.walk),
        "steps": [step.as_dict() for step in committed.history],
        "interfaces": results,
        "found": [interface.found() for interface in lasting.interfaces],
    }
    places = places_of(lasting, [result is not None for result in results])
    values = {NODES: _nodal(lasting), POINTS: _at_points(lasting)}
    for k, interface in enumerate(lasting.interfaces):
        if results[k] is not None:
            values[name_of(k)] = _on_interface(interface) | _slips(lasting, k) | _near(lasting, k)
    tables = {name: Table(places[name], values[name]) for name in places}
    write(lasting.comm, file, about, tables)


# -- values of this rank -------------------------------------------------------------------------


def places_of(lasting: Lasting, results: Sequence[bool]) -> dict[str, Floats]:
    """Return the places of the tables; interfaces without results have none; collective."""
    nodes = find_places(lasting.solid.V)
    sides = enumerate(lasting.system.sides)
    return {NODES: nodes, POINTS: find_places(lasting.solid.stress.function_space)} | {
        name_of(k): nodes[side.nodes] for k, side in sides if results[k]
    }


def _nodal(lasting: Lasting) -> dict[str, Floats]:
    u = _owned(lasting.u)
    active, sliding = lasting.committed.contacts_at(lasting.comm, u.ravel())
    found = {"displacement": u, "active": active[:, None].astype(float)}
    if (paired := lasting.committed.paired) is not None and len(paired.at):
        found["paired"] = paired.at.reshape(u.shape)
    if (supports := lasting.committed.supports) is not None:
        found["supports"] = np.hstack([supports.forces, supports.points])
    if lasting.system.has_friction:  # slips are measured from it
        d = lasting.solid.V.dofmap.index_map_bs
        if sliding is not None:
            found["sliding"] = sliding
        found["committed"] = lasting.committed.displacement.reshape(-1, d)
    return found | {name: _owned(f) for name, f in lasting.states_of_terms.items()}


def _at_points(lasting: Lasting) -> dict[str, Floats]:
    """Return the fields at the owned points; those that are shown only if not committed as well."""
    fields = {name: _owned(f) for name, f in lasting.solid.lasting_fields().items()}
    for name in [name for name in fields if name.startswith("shown/")]:
        differs = not np.array_equal(fields[name], fields[name.replace("shown/", "committed/")])
        if not any_rank(lasting.comm, differs)[0]:
            del fields[name]
    return fields | {"material": material_numbers(lasting.solid)}


def _on_interface(interface: Interface) -> dict[str, Floats]:
    """Return the results at the owned slave nodes."""
    fields, found = interface.fields, interface.resultants
    assert fields is not None and found is not None
    nodal = {f.name: _owned(f)[found.nodes] for f in interface.functions}
    multiplier = found.multiplier if found.multiplier.ndim > 1 else found.multiplier[:, None]
    return nodal | {"multiplier": multiplier, "carries": found.carries[:, None].astype(float)}


def _near(lasting: Lasting, k: int) -> dict[str, Floats]:
    """Return which owned slave nodes are transformed by T, nothing before the first commit."""
    paired = lasting.committed.paired
    return {} if paired is None else {"near": paired.near[k][:, None].astype(float)}


def _slips(lasting: Lasting, k: int) -> dict[str, Floats]:
    """Return total slip and dissipation at the owned slave nodes, nothing without friction."""
    interface, nodes = lasting.interfaces[k], lasting.system.sides[k].nodes
    if not interface.rough:
        return {}
    columns = lasting.committed.slid[k], lasting.committed.dissipated[k]
    return {name: c[nodes, None] for name, c in zip(SLIPS, columns, strict=True)}


def _resultants(interface: Interface) -> dict[str, Any] | None:
    """Return the resultants, None before the first step."""
    found = interface.resultants
    return None if found is None else {n: getattr(found, n).tolist() for n in RESULTANTS}


def name_of(k: int) -> str:
    """Return the name of the table of an interface."""
    return f"interface {k}"


def _owned(f: fem.Function) -> Floats:
    """Return the owned values (n, c) of a Function."""
    dofmap = f.function_space.dofmap
    return np.asarray(f.x.array.reshape(-1, dofmap.bs)[: dofmap.index_map.size_local])

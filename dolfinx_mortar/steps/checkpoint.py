# SPDX-License-Identifier: MIT
"""What of a problem goes on from step to step, and how it is saved and restored.

Displacement, internal variables, stress, closed contacts, slips and load level; results of the
interfaces (multipliers, pressures, gaps, resultants); how far bolts are tightened; the history of
the load steps. What a program sets anew before a step is not saved: loads, supports, jumps,
parameters and eigenstrain that may change.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx import fem
from dolfinx_mortar.algebra.parallel import any_rank
from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.checkpoint import Table, find_places, read_about, read_tables, size_of, write
from dolfinx_mortar.interfaces.contact import Contact
from dolfinx_mortar.interfaces.interface import Interface, Resultants
from dolfinx_mortar.interfaces.tie import Tie
from dolfinx_mortar.steps.checks import check_owned, check_path
from dolfinx_mortar.steps.identity import describe, differences, other_places
from dolfinx_mortar.steps.lasting import Lasting
from dolfinx_mortar.steps.report import LoadStep

NODES, POINTS = "nodes", "points"
SLIPS = ("slid", "dissipated")
RESULTANTS = ("force", "moment", "master_force", "master_moment")


def save(lasting: Lasting, path: str | os.PathLike[str]) -> None:
    """Write a checkpoint; see `ContactProblem.save`."""
    file = check_path(lasting.comm, path)
    check_owned(lasting.interfaces, lasting.supports)
    committed = lasting.committed
    # goes on as what is restored does: pairs and claims depend on where the search was made
    committed.search = True
    results = [_resultants(interface) for interface in lasting.interfaces]
    about = {
        "problem": describe(lasting),
        "begun": committed.begun,
        "level": committed.level,
        "walked": committed.walked,
        "steps": [step.as_dict() for step in committed.history],
        "interfaces": results,
        # found, not given: a step without it would let the bolts go
        "tightening": [
            one.tightening.tolist() if isinstance(one, Tie) else None for one in lasting.interfaces
        ],
    }
    places = _places(lasting, results)
    values = {NODES: _nodal(lasting), POINTS: _at_points(lasting)}
    for k, interface in enumerate(lasting.interfaces):
        if results[k] is not None:
            values[_name(k)] = _on_interface(interface) | _slips(lasting, k)
    tables = {name: Table(places[name], values[name]) for name in places}
    write(lasting.comm, file, about, tables)


@dataclass(frozen=True)
class Saved:
    """A checkpoint of this very problem that has been read, but changes nothing yet."""

    lasting: Lasting
    about: dict[str, Any]
    tables: dict[str, dict[str, Floats]]

    @property
    def steps(self) -> list[LoadStep]:
        """The load steps until then."""
        return [LoadStep.from_dict(step) for step in self.about["steps"]]

    @property
    def walk(self) -> list[float]:
        """The levels of the last walk that were reached."""
        steps = self.about["steps"]
        return [step["time"] for step in steps[len(steps) - self.about["walked"] :]]

    def put(self) -> None:
        """Make it the state of the problem; collective."""
        lasting, committed = self.lasting, self.lasting.committed
        _set(lasting.u, self.tables[NODES]["displacement"])
        closed = self.tables[NODES]["active"][:, 0] > 0.0
        committed.contacts = closed, self.tables[NODES].get("sliding")  # without, begin stuck
        before = self.tables[NODES].get("committed", self.tables[NODES]["displacement"])
        committed.displacement[:] = before.ravel()
        shown = self.tables[POINTS]
        for name, field in lasting.solid.lasting_fields().items():
            same = name.replace("shown/", "committed/")
            _set(field, shown[name] if name in shown else shown[same])
        for k, interface in enumerate(lasting.interfaces):
            _take(lasting, k, interface, self.about["interfaces"][k], self.tables.get(_name(k), {}))
            if isinstance(interface, Tie):
                interface.tightening = np.array(self.about["tightening"][k])
        committed.begun = self.about["begun"]
        committed.level, committed.walked = self.about["level"], self.about["walked"]
        committed.history[:] = self.steps
        committed.search = lasting.system.faced = True


def read(lasting: Lasting, path: str | os.PathLike[str]) -> Saved:
    """Read a checkpoint of this problem, from any number of ranks; collective.

    Raises:
        OSError: on all ranks, if there is no such file, or it cannot be read.
        ValueError: on all ranks, if it is no checkpoint, cut off or damaged, of another version, or
            of another problem: the message names all that differs; if a problem made later has
            taken over an interface.
    """
    file, comm = check_path(lasting.comm, path), lasting.comm
    check_owned(lasting.interfaces, lasting.supports)
    about = read_about(comm, file)
    size = size_of(lasting.solid.V.mesh)
    present = describe(lasting)
    wrong = differences(about["problem"], present)
    tables: dict[str, dict[str, Floats]] = {}
    if not wrong:
        places = _places(lasting, about["interfaces"])
        names = {NODES: "mesh, nodes", POINTS: "mesh, integration points"}
        names |= {_name(k): f"{i}, slave nodes" for k, i in enumerate(lasting.interfaces)}
        tables, others = read_tables(comm, file, places, size)
        wrong = [f"{names[name]}: {text}" for name, text in others.items()]
        wrong = wrong or other_places(about["problem"], present, size)
    if wrong:
        raise ValueError(
            f"path is {str(file)!r}, a checkpoint of another problem: {'; '.join(wrong)}"
        )
    return Saved(lasting, about, tables)


# -- what there is on this rank ------------------------------------------------------------------


def _places(lasting: Lasting, results: Sequence[Any]) -> dict[str, Floats]:
    """Return the places of the tables; interfaces without results have none; collective."""
    nodes = find_places(lasting.solid.V)
    sides = enumerate(lasting.system.sides)
    return {NODES: nodes, POINTS: find_places(lasting.solid.stress.function_space)} | {
        _name(k): nodes[side.nodes] for k, side in sides if results[k] is not None
    }


def _nodal(lasting: Lasting) -> dict[str, Floats]:
    active = lasting.committed.active[:, None].astype(float)
    found = {"displacement": _owned(lasting.u), "active": active}
    if lasting.system.has_friction:  # slips are measured from it
        d = lasting.solid.V.dofmap.index_map_bs
        if lasting.committed.sliding is not None:
            found["sliding"] = lasting.committed.sliding
        found["committed"] = lasting.committed.displacement.reshape(-1, d)
    return found


def _at_points(lasting: Lasting) -> dict[str, Floats]:
    """Return the fields at the owned points; what is shown only where it is not committed."""
    fields = {name: _owned(f) for name, f in lasting.solid.lasting_fields().items()}
    for name in [name for name in fields if name.startswith("shown/")]:
        differs = not np.array_equal(fields[name], fields[name.replace("shown/", "committed/")])
        if not any_rank(lasting.comm, differs)[0]:
            del fields[name]
    return fields


def _on_interface(interface: Interface) -> dict[str, Floats]:
    """Return the results at the owned slave nodes."""
    fields, found = interface.fields, interface.resultants
    assert fields is not None and found is not None
    nodal = {f.name: _owned(f)[found.nodes] for f in interface.functions}
    multiplier = found.multiplier if found.multiplier.ndim > 1 else found.multiplier[:, None]
    return nodal | {"multiplier": multiplier, "carries": found.carries[:, None].astype(float)}


def _slips(lasting: Lasting, k: int) -> dict[str, Floats]:
    """Return what friction has added up at the owned slave nodes, nothing without friction."""
    interface, nodes = lasting.interfaces[k], lasting.system.sides[k].nodes
    if not (isinstance(interface, Contact) and interface.sliding is not None):
        return {}
    columns = lasting.committed.slid[k], lasting.committed.dissipated[k]
    return {name: c[nodes, None] for name, c in zip(SLIPS, columns, strict=True)}


def _resultants(interface: Interface) -> dict[str, Any] | None:
    """Return the resultants, None before the first step."""
    found = interface.resultants
    return None if found is None else {n: getattr(found, n).tolist() for n in RESULTANTS}


def _take(
    lasting: Lasting,
    k: int,
    interface: Interface,
    resultants: Mapping[str, Any] | None,
    values: Mapping[str, Floats],
) -> None:
    """Give an interface its results, or take them away; collective."""
    for function in interface.functions:
        function.x.array[:] = 0.0
    if isinstance(interface, Contact):
        interface.dissipated = 0.0
    lasting.committed.slid[k], lasting.committed.dissipated[k] = 0.0, 0.0
    if resultants is None:
        interface.resultants = None
        return
    nodes = lasting.system.sides[k].nodes
    multiplier = values["multiplier"]
    interface.resultants = Resultants(
        **{name: np.array(resultants[name]) for name in RESULTANTS},
        multiplier=multiplier[:, 0] if interface.one_sided else multiplier,
        nodes=nodes,
        carries=values["carries"][:, 0] > 0.0,
    )
    for function in interface.functions:
        at_nodes = values[function.name]
        function.x.array.reshape(-1, at_nodes.shape[1])[nodes] = at_nodes
        function.x.scatter_forward()
    if isinstance(interface, Contact) and interface.sliding is not None:
        committed = lasting.committed
        for column, name in zip((committed.slid[k], committed.dissipated[k]), SLIPS, strict=True):
            column[nodes] = values[name][:, 0]
        interface.dissipated = lasting.comm.allreduce(float(values["energy"].sum()), op=MPI.SUM)


def _name(k: int) -> str:
    return f"interface {k}"


def _owned(f: fem.Function) -> Floats:
    """Return the owned values (n, c) of a Function."""
    dofmap = f.function_space.dofmap
    return np.asarray(f.x.array.reshape(-1, dofmap.bs)[: dofmap.index_map.size_local])


def _set(f: fem.Function, values: Floats) -> None:
    """Set a Function to owned values (n, c); collective."""
    f.x.array[: values.size] = values.ravel()
    f.x.scatter_forward()

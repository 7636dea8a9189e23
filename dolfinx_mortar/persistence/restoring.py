# SPDX-License-Identifier: MIT
"""Restoring a checkpoint: all of it is checked before any of the state is changed.

A file with a correct checksum may still have been edited, or written by another program: then an
error names what is wrong, and the problem stays as it was.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypedDict

import numpy as np

from dolfinx import fem
from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.checkpoint import check_form, read_about, read_tables, size_of
from dolfinx_mortar.disk import check_path
from dolfinx_mortar.interfaces.interface import Interface, Resultants, check_owned
from dolfinx_mortar.interfaces.system import Paired
from dolfinx_mortar.persistence.identity import describe, differences, other_places
from dolfinx_mortar.persistence.lasting import Lasting, Slips, SupportForces, Walk
from dolfinx_mortar.persistence.saving import NODES, POINTS, RESULTANTS, SLIPS, name_of, places_of
from dolfinx_mortar.step_report import LoadStep, StepReport

FLAGS = ("active", "carries", "near")  # columns of zeros and ones
UNDEFINED = ("gap",)  # where a slave node faces no master

Tables = Mapping[str, Mapping[str, Floats]]


class SavedMaterial(TypedDict):
    """See `identity.describe`."""

    law: str
    parameters: dict[str, float | str]
    state: dict[str, list[int]]
    cells: int
    center: list[float]


class SavedProblem(TypedDict):
    """See `identity.describe`."""

    mesh: dict[str, Any]
    displacement: dict[str, Any]
    solid: dict[str, Any]
    problem: dict[str, Any]
    interfaces: list[str]
    materials: list[SavedMaterial]


class SavedStep(TypedDict):
    """See `LoadStep.as_dict`."""

    number: int
    time: float
    parts: list[StepReport]
    forces: list[list[float]]
    reactions: list[dict[str, Any]]


class SavedWalk(TypedDict):
    """See `lasting.Walk`."""

    start: float
    ramp: list[list[list[float]]]


class About(TypedDict):
    """What a checkpoint says beside its tables."""

    problem: SavedProblem
    begun: bool
    level: float
    walked: int
    walk: SavedWalk | None
    steps: list[SavedStep]
    interfaces: list[dict[str, list[float]] | None]
    found: list[dict[str, list[float]]]


@dataclass(frozen=True)
class Saved:
    """A checkpoint of this very problem that has been read and checked, but changes nothing yet."""

    lasting: Lasting
    about: About
    tables: Tables
    steps: list[LoadStep]  # until then

    @property
    def walk(self) -> list[float]:
        """The levels of the last walk that were reached."""
        return [step.time for step in self.steps[len(self.steps) - self.about["walked"] :]]

    def put(self) -> None:
        """Make it the state of the problem; collective."""
        lasting, committed = self.lasting, self.lasting.committed
        _set(lasting.u, self.tables[NODES]["displacement"])
        for name, f in lasting.states_of_terms.items():
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
        for name, field in lasting.solid.lasting_fields().items():
            same = name.replace("shown/", "committed/")
            _set(field, shown[name] if name in shown else shown[same])
        committed.found_slips = Slips(*np.zeros((2, *committed.slid.shape)))
        for k, interface in enumerate(lasting.interfaces):
            resultants = self.about["interfaces"][k]
            _take(lasting, k, interface, resultants, self.tables.get(name_of(k), {}))
            interface.take_found(self.about["found"][k])
        committed.paired = committed.found_paired = self._paired()
        committed.begun = self.about["begun"]
        committed.level, committed.walked = self.about["level"], self.about["walked"]
        walk = self.about["walk"]
        committed.walk = None if walk is None else Walk(**walk)
        committed.history[:], committed.brought = self.steps, len(self.steps)
        lasting.system.faced = True

    def _paired(self) -> Paired | None:
        """Return where the surfaces were paired; None where that is not known."""
        lasting, tables = self.lasting, self.tables
        at = tables[NODES].get("paired", np.zeros((0, 1))).flatten()
        near = [tables.get(name_of(k), {}).get("near") for k in range(len(lasting.interfaces))]
        known = [marks[:, 0] > 0.0 for marks in near if marks is not None]
        complete = len(known) == len(near) and "paired" in tables[NODES]
        if lasting.geometry == "reference":
            complete = len(known) == len(near)
        return Paired(at, known) if complete else None


def read(lasting: Lasting, path: str | os.PathLike[str]) -> Saved:
    """Read a checkpoint of this problem, from any number of ranks; collective.

    Raises:
        OSError: on all ranks, if there is no such file, or it cannot be read.
        ValueError: on all ranks, if it is no checkpoint, cut off or damaged, of another version,
            holds what cannot be, or is one of another problem: the message names all that differs;
            if a problem made later has taken over an interface.
    """
    file, comm = check_path(lasting.comm, path), lasting.comm
    check_owned(lasting.interfaces, lasting.supports)
    about: Any = read_about(comm, file)
    size, present = size_of(lasting.solid.V.mesh), describe(lasting)
    with raised_together(comm), _named(file):
        check_form("about", about, About)
    wrong = differences(about["problem"], present)
    tables: Tables = {}
    if not wrong:
        with raised_together(comm), _named(file):
            _check_steps(about)
            _check_interfaces(lasting, about)
            steps = [LoadStep.from_dict(step) for step in about["steps"]]
        places = places_of(lasting, [found is not None for found in about["interfaces"]])
        names = {NODES: "mesh, nodes", POINTS: "mesh, integration points"}
        names |= {name_of(k): f"{i}, slave nodes" for k, i in enumerate(lasting.interfaces)}
        tables, others = read_tables(comm, file, places, size)
        wrong = [f"{names[name]}: {text}" for name, text in others.items()]
        wrong = wrong or other_places(about["problem"], present, size)
    if wrong:
        raise ValueError(
            f"path is {str(file)!r}, a checkpoint of another problem: {'; '.join(wrong)}"
        )
    with raised_together(comm), _named(file):
        for name, values in tables.items():
            _check_values(name, values, _columns(lasting, name))
    return Saved(lasting, about, tables, steps)


# -- what may be in it ---------------------------------------------------------------------------


@contextmanager
def _named(file: Path) -> Iterator[None]:
    """Let errors name the file; what no check has foreseen is one, too."""
    try:
        yield
    except (ValueError, TypeError, KeyError, IndexError) as error:
        raise ValueError(f"path is {str(file)!r}, which cannot be taken over: {error}") from error


def _check_steps(about: About) -> None:
    """Raise a ValueError for levels and numbers of steps that cannot be; the form is right."""
    levels = {f"steps[{k}].time": step["time"] for k, step in enumerate(about["steps"])}
    for name, level in {"level": about["level"], **levels}.items():
        if not math.isfinite(level):
            raise ValueError(f"{name} is {level}: need a finite number")
    for k, step in enumerate(about["steps"]):
        if step["number"] < 1 or not step["parts"]:
            raise ValueError(f"steps[{k}] has number {step['number']}, {len(step['parts'])} parts")
    if not 0 <= about["walked"] <= len(about["steps"]):
        raise ValueError(f"walked is {about['walked']}, but there are {len(about['steps'])} steps")
    if about["walk"] is not None:
        _check_walk(about["walk"])


def _check_walk(walk: SavedWalk) -> None:
    """Raise a ValueError for a start and tables that no walk can have; the form is right."""
    if not math.isfinite(walk["start"]):
        raise ValueError(f"walk['start'] is {walk['start']}: need a finite number")
    for k, rows in enumerate(walk["ramp"]):
        name, widths = f"walk['ramp'][{k}]", {len(row) for row in rows}
        if len(rows) < 2 or len(widths) != 1 or min(widths) < 2:
            raise ValueError(f"{name} is {rows}: need two rows or more, of equal length")
        table = np.array(rows)
        if not np.isfinite(table).all() or (np.diff(table[:, 0]) <= 0.0).any():
            raise ValueError(f"{name} is {rows}: need finite numbers, and levels that rise")


def _check_interfaces(lasting: Lasting, about: About) -> None:
    """Raise a ValueError for vectors that cannot be those of this problem; the form is right."""
    d, n = lasting.solid.mesh.geometry.dim, len(lasting.interfaces)
    for k, material in enumerate(about["problem"]["materials"]):
        _check_vector(f"problem.materials[{k}].center", material["center"], d)
    for name, found in (("interfaces", about["interfaces"]), ("found", about["found"])):
        if len(found) != n:
            raise ValueError(f"{name} has {len(found)} entries, but there are {n} interfaces")
    for k, interface in enumerate(lasting.interfaces):
        resultants, saved, present = about["interfaces"][k], about["found"][k], interface.found()
        if resultants is not None:
            for name in RESULTANTS:
                size = 3 if "moment" in name else d
                _check_vector(f"interfaces[{k}].{name}", resultants.get(name), size)
        if saved.keys() != present.keys():
            raise ValueError(f"found[{k}] is {saved}, but {interface} finds {[*present]}")
        for name, value in present.items():
            _check_vector(f"found[{k}].{name}", saved[name], len(value))


def _check_vector(name: str, value: Sequence[float] | None, d: int) -> None:
    if value is None or len(value) != d or not np.isfinite(value).all():
        raise ValueError(f"{name} is {value}: need {d} finite numbers")


def _columns(lasting: Lasting, table: str) -> dict[str, tuple[int, bool]]:
    """Return how many components each column of a table has, and whether it may be missing."""
    d = lasting.solid.V.dofmap.index_map_bs
    if table == NODES:
        rough = {"committed": (d, False)} if lasting.system.has_friction else {}
        rough |= {"sliding": (d, True), "supports": (2 * d, True), "paired": (d, True)}
        states = lasting.states_of_terms.items()
        rough |= {name: (f.function_space.dofmap.bs, False) for name, f in states}
        return {"displacement": (d, False), "active": (1, False)} | rough
    if table == POINTS:
        fields = lasting.solid.lasting_fields().items()
        return {n: (f.function_space.dofmap.bs, n.startswith("shown/")) for n, f in fields}
    (interface,) = (i for k, i in enumerate(lasting.interfaces) if name_of(k) == table)
    columns = {f.name: (f.function_space.dofmap.bs, False) for f in interface.functions}
    if interface.rough:
        columns |= dict.fromkeys(SLIPS, (1, False))
    columns["near"] = 1, True
    components = interface.shown(np.zeros((1, d))).size
    return columns | {"multiplier": (components, False), "carries": (1, False)}


def _check_values(
    table: str, values: Mapping[str, Floats], columns: Mapping[str, tuple[int, bool]]
) -> None:
    """Raise a ValueError unless a table has all columns (n, c), with numbers that can be."""
    for name, (width, optional) in columns.items():
        what = f"tables/{table}/values/{name}"
        if name not in values:
            if not optional:
                raise ValueError(f"{what} is missing")
            continue
        if values[name].shape[1] != width:
            raise ValueError(f"{what} has {values[name].shape[1]} components: need {width}")
        bad = np.isinf(values[name]) if name in UNDEFINED else ~np.isfinite(values[name])
        if bad.any():
            raise ValueError(f"{what} holds NaN or infinity")
        if name in FLAGS and not np.isin(values[name], (0.0, 1.0)).all():
            raise ValueError(f"{what} holds other numbers than 0 and 1")


# -- how it is taken -----------------------------------------------------------------------------


def _take(
    lasting: Lasting,
    k: int,
    interface: Interface,
    resultants: Mapping[str, list[float]] | None,
    values: Mapping[str, Floats],
) -> None:
    """Give an interface its results, or take them away; collective."""
    interface.clear()
    committed, ended = lasting.committed, lasting.committed.found_slips
    assert ended is not None
    committed.slid[k], committed.dissipated[k] = 0.0, 0.0
    if resultants is None:
        return
    nodes = lasting.system.sides[k].nodes
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
    interface.sum_up(lasting.comm, nodes)


def _set(f: fem.Function, values: Floats) -> None:
    """Set a Function to owned values (n, c); collective."""
    f.x.array[: values.size] = values.ravel()
    f.x.scatter_forward()

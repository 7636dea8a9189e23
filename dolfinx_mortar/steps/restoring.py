# SPDX-License-Identifier: MIT
"""How a checkpoint becomes the state of a problem: all of it is checked before any of it is taken.

A file whose checksum is right may still be none that `checkpoint.save` has made; who edits one, or
writes one with a program of their own, is told what is wrong, and the problem stays as it was.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypedDict

from mpi4py import MPI

import numpy as np

from dolfinx import fem
from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.checkpoint import check_form, read_about, read_tables, size_of
from dolfinx_mortar.interfaces.contact import Contact
from dolfinx_mortar.interfaces.interface import Interface, Resultants
from dolfinx_mortar.interfaces.tie import Tie
from dolfinx_mortar.steps.checkpoint import NODES, POINTS, RESULTANTS, SLIPS, name_of, places_of
from dolfinx_mortar.steps.checks import check_owned, check_path
from dolfinx_mortar.steps.identity import describe, differences, other_places
from dolfinx_mortar.steps.lasting import Lasting, SupportForces
from dolfinx_mortar.steps.report import LoadStep, StepReport

FLAGS = ("active", "carries")  # columns of zeros and ones
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


class About(TypedDict):
    """What a checkpoint says beside its tables."""

    problem: SavedProblem
    begun: bool
    level: float
    walked: int
    steps: list[SavedStep]
    interfaces: list[dict[str, list[float]] | None]
    tightening: list[list[float] | None]


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
        closed = self.tables[NODES]["active"][:, 0] > 0.0
        committed.contacts = closed, self.tables[NODES].get("sliding")  # without, begin stuck
        supports = self.tables[NODES].get("supports")
        halves = None if supports is None else np.split(supports, 2, axis=1)
        committed.supports = None if halves is None else SupportForces(*halves)
        before = self.tables[NODES].get("committed", self.tables[NODES]["displacement"])
        committed.displacement[:] = before.ravel()
        shown = self.tables[POINTS]
        for name, field in lasting.solid.lasting_fields().items():
            same = name.replace("shown/", "committed/")
            _set(field, shown[name] if name in shown else shown[same])
        for k, interface in enumerate(lasting.interfaces):
            found = self.about["interfaces"][k]
            _take(lasting, k, interface, found, self.tables.get(name_of(k), {}))
            if isinstance(interface, Tie):
                interface.tightening = np.array(self.about["tightening"][k], dtype=float)
        committed.begun = self.about["begun"]
        committed.level, committed.walked = self.about["level"], self.about["walked"]
        committed.history[:], committed.brought = self.steps, len(self.steps)
        committed.search = lasting.system.faced = True


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


def _check_interfaces(lasting: Lasting, about: About) -> None:
    """Raise a ValueError for vectors that cannot be those of this problem; the form is right."""
    d, n = lasting.solid.mesh.geometry.dim, len(lasting.interfaces)
    for k, material in enumerate(about["problem"]["materials"]):
        _check_vector(f"problem.materials[{k}].center", material["center"], d)
    for name, found in (("interfaces", about["interfaces"]), ("tightening", about["tightening"])):
        if len(found) != n:
            raise ValueError(f"{name} has {len(found)} entries, but there are {n} interfaces")
    for k, interface in enumerate(lasting.interfaces):
        resultants, tightening = about["interfaces"][k], about["tightening"][k]
        if resultants is not None:
            for name in RESULTANTS:
                size = 3 if "moment" in name else d
                _check_vector(f"interfaces[{k}].{name}", resultants.get(name), size)
        if isinstance(interface, Tie):
            _check_vector(f"tightening[{k}]", tightening, d)
        elif tightening is not None:
            raise ValueError(f"tightening[{k}] is {tightening}, but {interface} is no tie")


def _check_vector(name: str, value: Sequence[float] | None, d: int) -> None:
    if value is None or len(value) != d or not np.isfinite(value).all():
        raise ValueError(f"{name} is {value}: need {d} finite numbers")


def _columns(lasting: Lasting, table: str) -> dict[str, tuple[int, bool]]:
    """Return how many components each column of a table has, and whether it may be missing."""
    d = lasting.solid.V.dofmap.index_map_bs
    if table == NODES:
        rough = {"committed": (d, False)} if lasting.system.has_friction else {}
        rough |= {"sliding": (d, True), "supports": (2 * d, True)}
        return {"displacement": (d, False), "active": (1, False)} | rough
    if table == POINTS:
        fields = lasting.solid.lasting_fields().items()
        return {n: (f.function_space.dofmap.bs, n.startswith("shown/")) for n, f in fields}
    (interface,) = (i for k, i in enumerate(lasting.interfaces) if name_of(k) == table)
    columns = {f.name: (f.function_space.dofmap.bs, False) for f in interface.functions}
    if isinstance(interface, Contact) and interface.sliding is not None:
        columns |= dict.fromkeys(SLIPS, (1, False))
    return columns | {"multiplier": (1 if interface.one_sided else d, False), "carries": (1, False)}


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
    vectors: dict[str, Floats] = {name: np.array(resultants[name], float) for name in RESULTANTS}
    interface.resultants = Resultants(
        **vectors,
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


def _set(f: fem.Function, values: Floats) -> None:
    """Set a Function to owned values (n, c); collective."""
    f.x.array[: values.size] = values.ravel()
    f.x.scatter_forward()

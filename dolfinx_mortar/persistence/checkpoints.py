# SPDX-License-Identifier: MIT
r"""Checkpoints: the committed state of a problem, as values at places in one HDF5 file.

    dolfinx_mortar checkpoint, format 10, version 0.2
    sha256 of what follows: 64 hexadecimal digits
    zeros to byte 512, and from there on HDF5

    about            JSON: identity of the problem, other state, columns of each table
    NAME/places      (N, k)   in each row a place
    NAME/COLUMN      (N, c)   the values there

Without the data that a program sets before each step: loads, supports, jumps, changing parameters.
Node numbers depend on the ranks, and nodes of both sides may coincide, so places are

    (x, c),    c the mean of the midpoints of its cells.

The ranks write their rows one after another; then the file is renamed. Each rank reads all rows, a
part at a time, and takes those at its places. HDF5 may crash on a damaged file, so the checksum is
tested first.
"""

import dataclasses
import errno
import hashlib
import json
import os
import sys
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import scipy

from dolfinx import fem, mesh
from dolfinx_mortar.algebra.parallel import maximum, raised_together
from dolfinx_mortar.common import compat, disk
from dolfinx_mortar.common.arguments import as_numbers
from dolfinx_mortar.common.arrays import CHUNK, SAME, Floats, Longs
from dolfinx_mortar.common.spaces import means_around, set_owned
from dolfinx_mortar.common.step_report import LoadStep
from dolfinx_mortar.interfaces.interface import check_owned
from dolfinx_mortar.interfaces.results import Resultants
from dolfinx_mortar.materials.protocol import named_parameters
from dolfinx_mortar.persistence.committed import (
    Before,
    ProblemState,
    SupportForces,
    Walk,
)
from dolfinx_mortar.solid.solid import Solid

FORMAT = 10  # raise this when the meaning of the content changes
HEAD = 512  # bytes: HDF5's smallest "user block"
CHECKSUM = b"sha256 of what follows: "
PLACES = "places"
Values = Mapping[str, Mapping[str, Floats]]  # (n, c) by column by table
NODES, POINTS = "nodes", "integration points"
RESULT = "interfaces[{}]: {}"  # column at nodes
RESULTANTS = ("force", "moment", "master_force", "master_moment", "place")


def save(state: ProblemState, path: str | os.PathLike[str]) -> None:
    """Write a checkpoint, see `ContactProblem.save`."""
    file = disk.check_path(state.comm, path)
    check_owned(state.interfaces, state.supports)
    committed = state.committed
    about = {
        "problem": describe(state),
        "begun": committed.begun,
        "level": committed.level,
        "walked": committed.walked,
        "walk": None if committed.walk is None else dataclasses.asdict(committed.walk),
        "steps": [step.as_dict() for step in committed.history],
        "interfaces": [
            i.resultants and {name: getattr(i.resultants, name) for name in RESULTANTS}
            for i in state.interfaces
        ],
        "found": [interface.state(False) for interface in state.interfaces],
    }
    values = {NODES: _at_nodes(state), POINTS: _at_points(state)}
    with raised_together(state.comm):
        for name, table in values.items():
            for column, array in table.items():
                # the gap is NaN where a slave node faces no master
                if not column.endswith(" gap") and not np.isfinite(array).all():
                    raise ValueError(f"{name}: {column} holds NaN or infinity: nothing is saved")
    write(state.comm, file, about, values)


def read(state: ProblemState, path: str | os.PathLike[str]) -> "Saved":
    """Read a checkpoint of this problem, from any number of ranks; collective.

    Raises:
        OSError: on all ranks, if it cannot be read.
        ValueError: on all ranks, if it is no checkpoint, damaged, of another version or problem,
            with all differences; or if a later problem uses one of the interfaces.
    """
    file, comm = disk.check_path(state.comm, path), state.comm
    check_owned(state.interfaces, state.supports)
    about = read_about(comm, file)
    tables: dict[str, dict[str, Floats]] = {}
    wrong = differences(about["problem"], describe(state))
    if not wrong:
        size = maximum(comm, np.abs(state.solid.mesh.geometry.x).max(initial=0.0))[0]
        spaces = {NODES: state.solid.V, POINTS: state.solid.stress.function_space}
        places = {name: find_places(V) for name, V in spaces.items()}
        tables, wrong = read_tables(comm, file, about, places, float(size))
    if not wrong:
        other = tables[POINTS]["material"] != material_numbers(state.solid)
        moved = comm.allreduce(int(other.sum()), op=MPI.SUM)
        wrong = [f"solid: {moved} integration points have another material"] if moved else []
    if wrong:
        raise ValueError(
            f"path is {str(file)!r}, a checkpoint of another problem: {'; '.join(wrong)}"
        )
    return Saved(state, about, tables, [LoadStep.from_dict(step) for step in about["steps"]])


@dataclass(frozen=True)
class Saved:
    """A checkpoint of this problem, read, but not yet restored."""

    state: ProblemState
    about: Mapping[str, Any]
    tables: Values
    steps: list[LoadStep]

    @property
    def walk(self) -> list[float]:
        """The levels of the last call of `load_steps`."""
        return [step.time for step in self.steps[len(self.steps) - self.about["walked"] :]]

    def put(self) -> None:
        """Restore it, or raise an error on all ranks and change nothing; collective."""
        before = Before(self.state, None)
        try:
            self._put()
        except BaseException:
            before.restore()
            raise

    def _put(self) -> None:
        state, committed, about = self.state, self.state.committed, self.about
        nodes, points = self.tables[NODES], self.tables[POINTS]
        with raised_together(state.comm):
            for interface, found in zip(state.interfaces, about["found"], strict=True):
                interface.restore({name: np.array(v, float) for name, v in found.items()})
        for name, f in {"displacement": state.solid.u, **state.states_of_terms}.items():
            set_owned(f, nodes[name])
        for name, f in state.solid.points.lasting_fields().items():
            set_owned(f, points[name.replace("shown/", "committed/")])
        state.solid.forms.committed.forget()
        for k in range(len(state.interfaces)):
            self._put_results(k, nodes)
        # without a column of directions, steps begin stuck
        committed.active, committed.sliding = nodes["active"][:, 0] > 0.0, nodes.get("sliding")
        committed.displacement = nodes.get("committed", nodes["displacement"]).flatten()
        committed.slid[:], committed.dissipated[:] = nodes["slid"].T, nodes["dissipated"].T
        # displacement of the pairing, empty for X
        committed.paired = np.zeros(0) if state.geometry == "reference" else None
        if "paired" in nodes:
            committed.paired = nodes["paired"].flatten()
        committed.supports = committed.gained = None
        if "supports" in nodes:
            committed.supports = SupportForces(*np.split(nodes["supports"], 2, axis=1))
        committed.begun, committed.level = about["begun"], about["level"]
        committed.walk = None if about["walk"] is None else Walk(**about["walk"])
        committed.walked, committed.brought = about["walked"], len(self.steps)
        committed.history[:] = self.steps
        state.system.faced = True

    def _put_results(self, k: int, values: Mapping[str, Floats]) -> None:
        state, interface = self.state, self.state.interfaces[k]
        resultants, nodes = self.about["interfaces"][k], state.system.sides[k].nodes
        interface.clear()
        if resultants is None:
            return
        multiplier, carries = (
            values[RESULT.format(k, n)][nodes] for n in ("multiplier", "carries")
        )
        interface.resultants = Resultants(
            **{name: np.array(v, float) for name, v in resultants.items()},
            multiplier=multiplier[:, 0] if interface.unilateral else multiplier,
            nodes=nodes,
            carries=carries[:, 0] > 0.0,
        )
        for name, function in interface.nodal.items():
            set_owned(function, values[RESULT.format(k, name)])
        interface.sum_up(state.comm, nodes)


def _at_nodes(state: ProblemState) -> dict[str, Floats]:
    u, committed = _owned(state.solid.u), state.committed
    found = {
        PLACES: find_places(state.solid.V),
        "displacement": u,
        "slid": committed.slid.T,
        "dissipated": committed.dissipated.T,
    }
    found["active"] = committed.active[:, None].astype(float)
    if state.system.has_friction and committed.sliding is not None:
        found["sliding"] = committed.sliding
    if (paired := committed.paired) is not None and len(paired):
        found["paired"] = paired.reshape(u.shape)
    if (supports := committed.supports) is not None:
        found["supports"] = np.hstack([supports.forces, supports.points])
    if state.system.has_friction:  # slips are measured from it
        found["committed"] = committed.displacement.reshape(u.shape)
    for k, (interface, side) in enumerate(zip(state.interfaces, state.system.sides, strict=True)):
        if (results := interface.resultants) is not None:
            own = {"multiplier": np.atleast_2d(results.multiplier.T).T}
            for name, rows in (own | {"carries": results.carries[:, None]}).items():
                found[RESULT.format(k, name)] = np.zeros((len(u), rows.shape[1]))
                found[RESULT.format(k, name)][side.nodes] = rows
            found |= {RESULT.format(k, name): _owned(f) for name, f in interface.nodal.items()}
    return found | {name: _owned(f) for name, f in state.states_of_terms.items()}


def _at_points(state: ProblemState) -> dict[str, Floats]:
    fields = state.solid.points.lasting_fields().items()
    found = {name: _owned(f) for name, f in fields if not name.startswith("shown/")}
    places = find_places(state.solid.stress.function_space)
    return {PLACES: places, "material": material_numbers(state.solid)} | found


def _owned(f: fem.Function) -> Floats:
    dofmap = f.function_space.dofmap
    return f.x.array.reshape(-1, dofmap.bs)[: dofmap.index_map.size_local]


def describe(state: ProblemState) -> dict[str, Any]:
    """Identity of a problem by argument, laws by name, not by their code; collective."""
    solid, V = state.solid, state.solid.V
    domain, fields = V.mesh, solid.points.lasting_fields() | state.states_of_terms
    materials = [material for region in solid.regions for material, _ in region.parts]
    found = {
        "mesh: dimension": domain.geometry.dim,
        "mesh: cell": domain.topology.cell_name(),
        "mesh: degree": compat.cell_degree(domain),
        "displacement: degree": V.element.basix_element.degree,
        "solid: kinematics": solid.kinematics.name,
        "solid: quadrature_degree": solid.quadrature_degree,
        "solid: volumetric": solid.volumetric,
        "solid: materials": ", ".join(type(material).__name__ for material in materials),
        "problem: geometry": state.geometry,
        "problem: interfaces": ", ".join(map(repr, state.interfaces)),
    }
    found |= {f"components of {name}": f.function_space.dofmap.bs for name, f in fields.items()}
    for k, material in enumerate(materials):
        for name, value in named_parameters(material).items():
            subject = f"material {k}, {type(material).__name__}: {name}"
            found[subject] = float(value) if isinstance(value, Real) else "changing"
    names = [name for name, _ in state.terms]
    identities = dict(zip(names, state.ask_terms("identity"), strict=True))
    for k, interface in enumerate(state.interfaces):
        if interface.rigid is not None:
            identities[f"interfaces[{k}], {interface!r}"] = interface.rigid.identity
    return found | {f"{i}: {n}": v for i, values in identities.items() for n, v in values.items()}


def material_numbers(solid: Solid) -> Floats:
    """Number of the material (points, 1) at the owned points."""
    dofmap = solid.stress.function_space.dofmap
    numbers = np.zeros((solid.stress.x.array.size // dofmap.bs, 1))
    for k, (_, cells) in enumerate(part for region in solid.regions for part in region.parts):
        numbers[dofmap.list[cells].ravel()] = k
    return numbers[: dofmap.index_map.size_local]


def differences(saved: Mapping[str, Any], present: Mapping[str, Any]) -> list[str]:
    """Differences of two problems in words."""
    told = []
    for name in {**present, **saved}:
        before, now = saved.get(name, "missing"), present.get(name, "missing")
        a, b = as_numbers(before), as_numbers(now)
        if isinstance(now, list) and a is not None and b is not None and a.shape == b.shape:
            off = float(np.abs(a - b).max(initial=0.0))
            if off > SAME * np.abs(b).max(initial=0.0):
                told.append(f"{name} is off by up to {off:.3g} from the checkpoint")
        elif before != now:
            told.append(f"{name} is {now!r}, in the checkpoint {before!r}")
    return told


def find_places(V: fem.FunctionSpace) -> Floats:
    """Places (n, 2d) of owned blocks of a nodal space, independent of ranks; collective."""
    d = V.mesh.geometry.dim
    means = means_around(V, lambda cells: mesh.compute_midpoints(V.mesh, d, cells)[:, :d])
    return np.hstack([V.tabulate_dof_coordinates()[: len(means), :d], means])


def import_h5py() -> Any:
    """The module h5py, or an ImportError with the remedy."""
    try:
        import h5py
    except ImportError as error:
        raise ImportError(
            "checkpoints need h5py: pip install h5py, or dolfinx_mortar[checkpoint]"
        ) from error
    return h5py


def check_folder(comm: MPI.Comm, path: Path) -> None:
    """Raise an OSError or RuntimeError on all ranks unless rank 0 can write there; collective."""
    with raised_together(comm):
        if comm.rank == 0:
            import_h5py()
            try:
                if path.exists() and not path.is_file():
                    raise OSError("no file, but something else of this name")
                if path.exists() and path.stat().st_size and not disk.is_checkpoint(path):
                    raise OSError("the file there is no checkpoint, and would be replaced")
                draft = disk.draft_of(path)
                draft.touch()
                draft.unlink()
            except (OSError, ValueError) as error:  # ValueError: an impossible file name
                raise OSError(
                    f"path is {str(path)!r}, which cannot be written ({error}): choose a file in "
                    "an existing, writable folder"
                ) from error


def write(comm: MPI.Comm, path: Path, about: Mapping[str, Any], values: Values) -> None:
    """Write values by table, with their `PLACES`, and `about`; an OSError on all ranks; collective.

    An older file stays until the new one is complete.
    """
    check_folder(comm, path)
    draft, columns = disk.draft_of(path), {name: list(table) for name, table in values.items()}
    arrays = {
        f"{name}/{column}": values[name][column] for name in values for column in values[name]
    }
    text = json.dumps({**about, "columns": columns}, default=_plain).encode()
    size = comm.allreduce(sum(rows.nbytes for rows in arrays.values())) + len(text)
    counts = np.array(comm.allgather([len(rows) for rows in arrays.values()]))
    try:
        with raised_together(comm):
            if comm.rank == 0:
                draft.write_bytes(b"")
                disk.demand_space(draft, disk.space_for(len(arrays) + len(values) + 1, size))
                with _opened(draft, "w", userblock_size=HEAD) as file:
                    file["about"] = np.frombuffer(text, np.uint8)
                    for (name, rows), n in zip(arrays.items(), counts.sum(axis=0), strict=True):
                        file.create_dataset(name, (n, rows.shape[1]), "f8")
        for rank in range(comm.size):
            with raised_together(comm):
                if comm.rank == rank:
                    _write_rows(draft, arrays, counts[:rank].sum(axis=0))
        with raised_together(comm):
            if comm.rank == 0:
                seal(draft)
                disk.replace_by_draft(path)
    except Exception as error:  # h5py has several for a disk that fails
        if comm.rank == 0:
            with suppress(Exception):
                draft.unlink()
        raise OSError(f"path is {str(path)!r}, which could not be written: {error}") from error


def _write_rows(draft: Path, arrays: Mapping[str, Floats], starts: Longs) -> None:
    with _opened(draft, "r+") as file:
        for (name, rows), start in zip(arrays.items(), starts, strict=True):
            file[name][start : start + len(rows)] = rows


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.generic | np.ndarray) else str(value)


def _first_line() -> bytes:
    """First line; before 1.0 a minor version may change laws and forms."""
    package = sys.modules[__name__.partition(".")[0]]
    minor = ".".join(package.__version__.split(".")[:2])
    return disk.CHECKPOINT + f", format {FORMAT}, version {minor}\n".encode()


def _head(file: Path) -> bytes:
    """Head of a complete file."""
    first = _first_line() + CHECKSUM
    with file.open("rb") as stream:
        stream.seek(len(first) + 65)  # 64 digits and the end of the line
        digest = hashlib.file_digest(stream, "sha256")
    return first + digest.hexdigest().encode() + b"\n"


def seal(file: Path) -> None:
    """Write the head of an otherwise complete file."""
    head = _head(file)
    with file.open("r+b") as stream:
        stream.write(head)


def read_about(comm: MPI.Comm, path: Path) -> dict[str, Any]:
    """JSON part of a file; an OSError or ValueError on all ranks; collective."""
    about: Any = {}
    with raised_together(comm):
        if comm.rank == 0:
            _check_head(path)
            with _opened(path) as file:
                about = json.loads(file["about"][:].tobytes())
    return dict(comm.bcast(about))


def read_tables(
    comm: MPI.Comm, path: Path, about: Mapping[str, Any], places: Mapping[str, Floats], size: float
) -> tuple[dict[str, dict[str, Floats]], list[str]]:
    """Values by column by table at places (n, k), up to round-off of `size`; collective.

    Also how places differ, in words.
    """
    found: dict[str, dict[str, Floats]] = {}
    hits: dict[str, tuple[Longs, int]] = {}
    with raised_together(comm), _opened(path) as file:
        for name, own in places.items():
            columns = about["columns"][name]
            found[name], hits[name] = _read_table(file[name], columns, own, SAME * size)
    told = {name: _difference(comm, own, *hits[name]) for name, own in places.items()}
    return found, [f"{name}: {text}" for name, text in told.items() if text]


def _read_table(
    table: Any, columns: Iterable[str], own: Floats, reach: float
) -> tuple[dict[str, Floats], tuple[Longs, int]]:
    """Values at own places (n, k); number of rows of each, and of all rows."""
    n, tree, places = len(own), scipy.spatial.cKDTree(own), table[PLACES]
    found, hits = {c: np.zeros((n, table[c].shape[1])) for c in columns}, np.zeros(n, np.int64)
    for first in range(0, len(places), CHUNK):
        some = slice(first, first + CHUNK)
        distance, at = tree.query(places[some], distance_upper_bound=reach)
        hit = np.isfinite(distance)
        hits += np.bincount(at[hit], minlength=n)
        for column, values in found.items():
            values[at[hit]] = table[column][some][hit]
    return found, (hits, len(places))


def _difference(comm: MPI.Comm, own: Floats, hits: Longs, there: int) -> str:
    total = comm.allreduce(len(own), op=MPI.SUM)
    if total != there:
        return f"there are {total}, in the checkpoint {there}"
    wrong = np.concatenate(comm.allgather(own[hits != 1, : own.shape[1] // 2]))
    if not len(wrong):
        return ""
    where = ", ".join(f"{v:.6g}" for v in min(wrong.tolist()))
    return (
        f"{len(wrong)} of {total} are in the checkpoint not at all, or more than once, such as "
        f"that at ({where})"
    )


def _opened(path: Path, mode: str = "r", **options: Any) -> Any:
    if mode != "r":
        options["libver"] = ("v110", "v110")
    return import_h5py().File(path, mode, locking="best-effort", **options)


def _check_head(path: Path) -> None:
    """Raise unless a file is an undamaged checkpoint of this format and version."""
    import_h5py()
    if not path.exists():
        raise FileNotFoundError(
            errno.ENOENT, "path: there is no such checkpoint; check the name", str(path)
        )
    if not disk.is_checkpoint(path):
        raise ValueError(
            f"path is {str(path)!r}, which is no checkpoint, or its writer was stopped before it "
            "was complete: take the last complete one"
        )
    with path.open("rb") as stream:
        first, second, own = stream.readline(HEAD), stream.readline(HEAD), _first_line()
    if first != own:
        begins, reads = (repr(line.decode(errors="replace").rstrip()) for line in (first, own))
        raise ValueError(
            f"path is {str(path)!r}, which begins with {begins}, but this version reads {reads}: "
            "go on with the version that has written it"
        )
    if first + second != _head(path):
        raise ValueError(
            f"path is {str(path)!r}, which is cut off, damaged or changed since it was written "
            "(its checksum differs): take an older one"
        )

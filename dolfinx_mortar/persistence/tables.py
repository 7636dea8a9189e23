# SPDX-License-Identifier: MIT
r"""One HDF5 file of values at places, written by any number of ranks and read by any other.

    dolfinx_mortar checkpoint, format 10, version 0.1
    sha256 of what follows: 64 hexadecimal digits
    zeros to byte 512, and from there on HDF5

    about            JSON: what the caller gives, and the columns of each table
    NAME/places      (N, k)   in each row a place
    NAME/COLUMN      (N, c)   the values there

Node numbers depend on the ranks, and nodes of both sides may coincide, so places are

    (x, c),    c the mean of the midpoints of its cells.

The ranks write their rows one after another; then the file is renamed. Each rank reads all rows, a
part at a time, and takes those at its places. HDF5 may crash on a damaged file, so the checksum is
tested first.
"""

import errno
import hashlib
import json
import sys
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import scipy

from dolfinx import fem, mesh
from dolfinx_mortar.algebra.parallel import raised_together
from dolfinx_mortar.common.arrays import CHUNK, SAME, Floats, Longs
from dolfinx_mortar.common.disk import (
    CHECKPOINT,
    demand_space,
    draft_of,
    is_checkpoint,
    replace_by_draft,
    space_for,
)
from dolfinx_mortar.common.spaces import means_around

FORMAT = 10  # raise this when the meaning of the content changes
HEAD = 512  # bytes: HDF5's smallest "user block"
CHECKSUM = b"sha256 of what follows: "
PLACES = "places"
Values = Mapping[str, Mapping[str, Floats]]  # (n, c) by column by table


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
                if path.exists() and path.stat().st_size and not is_checkpoint(path):
                    raise OSError("the file there is no checkpoint, and would be replaced")
                draft = draft_of(path)
                draft.touch()
                draft.unlink()
            except (OSError, ValueError) as error:  # ValueError: an impossible file name
                raise OSError(
                    f"path is {str(path)!r}, which cannot be written ({error}): choose a file in "
                    "an existing, writable folder"
                ) from error


def write(comm: MPI.Comm, path: Path, about: Mapping[str, Any], values: Values) -> None:
    """Write values by table, with their `PLACES`, and `about`, to a new file; collective.

    Raises:
        OSError: on all ranks, if rank 0 cannot write; an older file stays.
    """
    check_folder(comm, path)
    draft, columns = draft_of(path), {name: list(table) for name, table in values.items()}
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
                demand_space(draft, space_for(len(arrays) + len(values) + 1, size))
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
                replace_by_draft(path)
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
    return CHECKPOINT + f", format {FORMAT}, version {minor}\n".encode()


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
) -> tuple[dict[str, dict[str, Floats]], dict[str, str]]:
    """Values by column by table at places (n, k), up to round-off of `size`; collective.

    Also, by table, how places differ, in words.
    """
    found: dict[str, dict[str, Floats]] = {}
    hits: dict[str, tuple[Longs, int]] = {}
    with raised_together(comm), _opened(path) as file:
        for name, own in places.items():
            there, columns = file[name], about["columns"][name]
            found[name], hits[name] = _read_table(there, columns, own, SAME * size)
    told = {name: _difference(comm, own, *hits[name]) for name, own in places.items()}
    return found, {name: text for name, text in told.items() if text}


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
    wrong = hits != 1
    some = comm.allgather((int(wrong.sum()), own[wrong][:1, : own.shape[1] // 2]))
    if count := sum(n for n, _ in some):
        x = next(x[0] for n, x in some if n)
        where = ", ".join(f"{v:.6g}" for v in x)
        return (
            f"{count} of {total} are in the checkpoint not at all, or more than once, "
            f"such as that at ({where})"
        )
    return ""


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
    if not is_checkpoint(path):
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

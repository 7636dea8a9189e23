# SPDX-License-Identifier: MIT
r"""Writing: the values of all ranks go through rank 0 into one HDF5 file, part by part.

    (512 bytes in front)                     kind, format and checksum, see `seal`
    version                                  attribute of the root
    about                                    JSON, the same on all ranks
    tables/NAME/places        (N, k)         where the values are, see `places`
    tables/NAME/pieces        (p, 2 + 2k)    first row, rows, corners of the box of each piece
    tables/NAME/values/FIELD  (N, c)

Rank 0 receives at most `CHUNK` rows at a time: nothing is gathered, no file is open on two ranks,
and only rank 0 needs access to the folder. The file is written under another name, closed, sealed
with its checksum, flushed to the disk and then renamed: whenever the program is killed, there is a
complete file under the right name, the old or the new one.
"""

import importlib
import json
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.arrays import CHUNK, Floats
from dolfinx_mortar.checkpoint.places import box_of
from dolfinx_mortar.checkpoint.seal import HEAD, seal
from dolfinx_mortar.disk import (
    demand_space,
    draft_of,
    is_checkpoint,
    replace_by_draft,
    space_for,
)


def version() -> str:
    """Return the version of this package."""
    return str(importlib.import_module(__name__.partition(".")[0]).__version__)


@dataclass(frozen=True)
class Table:
    """Values at the places of this rank."""

    places: Floats  # (n, k)
    values: Mapping[str, Floats] = field(default_factory=dict)  # (n, c) by name


def import_h5py() -> Any:
    """Return the module h5py.

    Raises:
        ImportError: with what to install.
    """
    try:
        import h5py
    except ImportError as error:
        raise ImportError(
            "checkpoints need h5py: pip install h5py, or dolfinx_mortar[checkpoint]"
        ) from error
    return h5py


def check_folder(comm: MPI.Comm, path: Path) -> None:
    """Raise on all ranks unless a file can be written there, by rank 0; collective.

    Raises:
        OSError: if not, naming the folder.
        RuntimeError: if h5py is missing (on rank 0, an ImportError).
    """
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
            except (OSError, ValueError) as error:  # ValueError: a name that no file can have
                raise OSError(
                    f"path is {str(path)!r}, which cannot be written ({error}): choose a file in "
                    "an existing, writable folder"
                ) from error


def write(
    comm: MPI.Comm, path: Path, about: Mapping[str, Any], tables: Mapping[str, Table]
) -> None:
    """Write a file and replace an older one of this name; collective.

    Args:
        about: JSON values, the same on all ranks.
        tables: values at the places of this rank, by name.

    Raises:
        OSError: on all ranks, if rank 0 cannot write; an older file stays.
    """
    check_folder(comm, path)
    columns = {
        f"tables/{name}/{key}": values
        for name, table in tables.items()
        for key, values in {
            "places": table.places,
            **{f"values/{k}": v for k, v in table.values.items()},
        }.items()
    }
    rows = comm.allreduce(np.array([len(v) for v in columns.values()], dtype=int), op=MPI.SUM)
    widths = [values.shape[1] for values in columns.values()]
    shapes = dict(zip(columns, zip(rows.tolist(), widths, strict=True), strict=True))
    parts = ((name, part) for name, values in columns.items() for part in _parts(comm, values))
    with raised_together(comm):
        try:
            if comm.rank == 0:
                _write_file(path, shapes, about, parts)
        finally:
            for _ in parts:  # after an error, too: other ranks send until all is received
                pass


def _parts(comm: MPI.Comm, values: Floats) -> Iterator[Floats]:
    """Yield on rank 0 the rows (n, c) of all ranks in order, in parts; the others send; collective.

    Rank 0 has to take all parts.
    """
    counts = comm.gather(len(values))
    values = np.ascontiguousarray(values, dtype=np.float64)
    for first in range(0, max(len(values), 1), CHUNK):
        part = values[first : first + CHUNK]
        if comm.rank == 0:
            yield part  # at least one, which may be empty
        elif len(part):
            comm.Send(part, dest=0)
    for rank, count in enumerate(counts or []):
        for first in range(0, count if rank else 0, CHUNK):
            part = np.empty((min(CHUNK, count - first), values.shape[1]))
            comm.Recv(part, source=rank)
            yield part


def _write_file(
    path: Path,
    shapes: Mapping[str, tuple[int, int]],
    about: Mapping[str, Any],
    parts: Iterable[tuple[str, Floats]],
) -> None:
    """Write the rows of arrays, part by part, and replace the file; on rank 0."""
    draft = draft_of(path)
    try:
        text = np.frombuffer(json.dumps(about, default=_plain).encode(), dtype=np.uint8)
        numbers = 8 * sum(n * c for n, c in shapes.values())
        draft.write_bytes(b"")
        demand_space(draft, space_for(len(shapes), numbers + len(text)))
        with import_h5py().File(draft, "w", libver=("v110", "v110"), userblock_size=HEAD) as file:
            file.attrs["version"] = version()
            file.create_dataset("about", data=text)
            for name, shape in shapes.items():
                file.create_dataset(name, shape, "f8")
            for name, pieces in _append(file, parts).items():
                file.create_dataset(name, data=np.array(pieces))
        seal(draft)
        replace_by_draft(path)
    except Exception as error:  # h5py has several for a disk that fails
        with suppress(Exception):
            draft.unlink()
        raise OSError(f"path is {str(path)!r}, which could not be written: {error}") from error


def _append(file: Any, parts: Iterable[tuple[str, Floats]]) -> dict[str, list[Floats]]:
    """Append rows (n, c) to arrays; return first row, number and box of the pieces of places."""
    written: dict[str, int] = defaultdict(int)
    pieces: dict[str, list[Floats]] = defaultdict(list)
    for name, rows in parts:
        first = written[name]
        written[name] += len(rows)
        file[name][first : first + len(rows)] = rows
        if name.endswith("/places"):
            piece = np.concatenate([[first, len(rows)], box_of(rows).ravel()])
            pieces[name.removesuffix("places") + "pieces"].append(piece)
    return pieces


def _plain(value: Any) -> Any:
    """Return a NumPy number or array as JSON can hold it."""
    return value.tolist() if isinstance(value, np.generic | np.ndarray) else str(value)

# SPDX-License-Identifier: MIT
r"""Writing: what all ranks have goes through rank 0 into one HDF5 file, part by part.

    (512 bytes in front)                     kind, format and checksum, see `seal`
    version                                  attribute of the root
    about                                    JSON, the same on all ranks
    tables/NAME/places        (N, k)         where the values are, see `places`
    tables/NAME/pieces        (p, 2 + 2k)    first row, rows, corners of the box of each piece
    tables/NAME/values/FIELD  (N, c)

Rank 0 receives at most `ROWS` rows at a time: nothing is gathered, no file is open on two ranks,
and only rank 0 needs to reach the folder. The file is written under another name, closed, sealed
with the checksum of all that is in it, brought to the disk, and then takes the place of the last
one: who is killed at any moment leaves a whole file under the right name, the old or the new one.
"""

from __future__ import annotations

import importlib
import json
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx_mortar.algebra.errors import raise_together, raised_together
from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.checkpoint.places import box_of
from dolfinx_mortar.checkpoint.seal import ROOM, seal
from dolfinx_mortar.disk import demand_room, is_checkpoint

# Rows that travel together: 2 MB of strains and places.
ROWS = 2**15
SUFFIX = ".part"
# HDF5 keeps an index beside the numbers: bytes per file and per array, room for the head included.
# Measured: 6.7 kB for 3 arrays, 13 kB for 19, 480 kB for 1100
FILE_MARGIN, ARRAY_MARGIN = 2**13, 2**9


def version() -> str:
    """Return the version of this package, which its first file knows."""
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
                draft = _draft_of(path)
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
    """Write a file, which then takes the place of the last one of this name; collective.

    Args:
        comm: the ranks.
        path: the file.
        about: what JSON can hold, the same on all ranks.
        tables: values at the places of this rank, by name.

    Raises:
        OSError: on all ranks, if rank 0 cannot write; what was there before stays.
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
    draft = None
    if comm.rank == 0:
        widths = [values.shape[1] for values in columns.values()]
        shapes = dict(zip(columns, zip(rows.tolist(), widths, strict=True), strict=True))
        draft = _Draft(path, shapes, about)
    for name, values in columns.items():
        for part in _parts(comm, values):
            assert draft is not None
            draft.append(name, part)
    if draft is not None:
        draft.finish()
    raise_together(comm, None if draft is None else draft.error)


def _parts(comm: MPI.Comm, values: Floats) -> Iterator[Floats]:
    """Yield on rank 0 the rows (n, c) of all ranks in order, in parts; the others send; collective.

    Rank 0 has to take all parts.
    """
    counts = comm.gather(len(values))
    values = np.ascontiguousarray(values, dtype=np.float64)
    for first in range(0, max(len(values), 1), ROWS):
        part = values[first : first + ROWS]
        if comm.rank == 0:
            yield part  # perhaps an empty one, so that there is one
        elif len(part):
            comm.Send(part, dest=0)
    for rank, count in enumerate(counts or []):
        for first in range(0, count if rank else 0, ROWS):
            part = np.empty((min(ROWS, count - first), values.shape[1]))
            comm.Recv(part, source=rank)
            yield part


class _Draft:
    """The file in the making, on rank 0; after an error it takes what comes and does nothing.

    Attributes:
        error: the first one.
    """

    def __init__(
        self, path: Path, shapes: Mapping[str, tuple[int, int]], about: Mapping[str, Any]
    ) -> None:
        """Open the file, for arrays of known shapes and what JSON can hold."""
        self.path, self.part = path, _draft_of(path)
        self.error: OSError | None = None
        self._file: Any = None
        self._written = dict.fromkeys(shapes, 0)
        self._pieces: dict[str, list[Floats]] = {}
        self._attempt(lambda: self._open(shapes, about))

    def append(self, name: str, rows: Floats) -> None:
        """Write rows (n, c) after those that are there."""
        self._attempt(lambda: self._append(name, rows))

    def finish(self) -> None:
        """Complete the file and give it its name, or remove it after an error."""
        self._attempt(self._complete)
        if self.error is None:
            return
        # what is wrong with the disk is known already, and the other ranks wait for it
        with suppress(Exception):
            if self._file is not None:
                self._file.close()
        with suppress(Exception):
            self.part.unlink()

    def _attempt(self, work: Callable[[], None]) -> None:
        if self.error is None:
            try:
                work()
            except Exception as error:  # h5py has several for a disk that fails
                self.error = OSError(
                    f"path is {str(self.path)!r}, which could not be written: {error}"
                )

    def _open(self, shapes: Mapping[str, tuple[int, int]], about: Mapping[str, Any]) -> None:
        text = np.frombuffer(json.dumps(about, default=_plain).encode(), dtype=np.uint8)
        numbers = 8 * sum(n * c for n, c in shapes.values())
        self.part.write_bytes(b"")
        demand_room(self.part, numbers + len(text) + len(shapes) * ARRAY_MARGIN + FILE_MARGIN)
        self._file = import_h5py().File(
            self.part, "w", libver=("v110", "v110"), userblock_size=ROOM
        )
        self._file.attrs["version"] = version()
        for name, shape in shapes.items():
            self._file.create_dataset(name, shape, "f8")
        self._file.create_dataset("about", data=text)

    def _append(self, name: str, rows: Floats) -> None:
        first = self._written[name]
        self._written[name] += len(rows)
        self._file[name][first : first + len(rows)] = rows
        if name.endswith("/places"):
            piece = np.concatenate([[first, len(rows)], box_of(rows).ravel()])
            self._pieces.setdefault(name.removesuffix("places"), []).append(piece)

    def _complete(self) -> None:
        for table, pieces in self._pieces.items():
            self._file.create_dataset(f"{table}pieces", data=np.array(pieces))
        self._file.close()
        seal(self.part)
        _to_disk(self.part)
        self.part.replace(self.path)
        with suppress(OSError):  # not every file system can; either file is whole under the name
            _to_disk(self.path.parent)


def _draft_of(path: Path) -> Path:
    """Return the name under which a file is written."""
    return path.with_name(path.name + SUFFIX)


def _plain(value: Any) -> Any:
    """Return a NumPy number or array as JSON knows it."""
    return value.tolist() if isinstance(value, np.generic | np.ndarray) else str(value)


def _to_disk(path: Path) -> None:
    """Wait until a file, or the names in a folder, are on the disk."""
    number = os.open(path, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)

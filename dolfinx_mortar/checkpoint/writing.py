# SPDX-License-Identifier: MIT
r"""Writing: what all ranks have goes through rank 0 into one HDF5 file, part by part.

    kind, format, version, complete          attributes of the root
    about                                    JSON, the same on all ranks
    tables/NAME/places        (N, k)         where the values are, see `places`
    tables/NAME/pieces        (p, 2 + 2k)    first row, rows, corners of the box of each piece
    tables/NAME/values/FIELD  (N, c)

Rank 0 receives at most `ROWS` rows at a time: nothing is gathered, no file is open on two ranks,
and only rank 0 needs to reach the folder. All numbers have checksums (Fletcher's, of HDF5). The
file is written under another name, closed, brought to the disk, and then takes the place of the
last one: who is killed at any moment leaves a whole file under the right name, the old or the new
one.
"""

from __future__ import annotations

import errno
import importlib
import json
import math
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

KIND = "dolfinx_mortar checkpoint"
# Raise this when what is written changes its meaning.
FORMAT = 2
# Rows that travel together and have one checksum: 2 MB of strains and places.
ROWS = 2**15
SUFFIX = ".part"
# HDF5 keeps an index beside the numbers: bytes per file and per array.
FILE_MARGIN, ARRAY_MARGIN = 2**18, 2**13
CANNOT_TELL = (errno.EOPNOTSUPP, errno.EINVAL, errno.ENOSYS)


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
            if path.is_dir() or not os.access(path.parent, os.W_OK | os.X_OK):
                raise OSError(
                    f"path is {str(path)!r}, which cannot be written: choose a file in an "
                    "existing, writable folder"
                )


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
        draft = _Draft(path, shapes, json.dumps(about, default=_plain))
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

    def __init__(self, path: Path, shapes: Mapping[str, tuple[int, int]], about: str) -> None:
        """Open the file, for arrays of known shapes and a text."""
        self.path, self.part = path, path.with_name(path.name + SUFFIX)
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
        with suppress(OSError):
            self.part.unlink()

    def _attempt(self, work: Callable[[], None]) -> None:
        if self.error is None:
            try:
                work()
            except Exception as error:  # h5py has several for a disk that fails
                self.error = OSError(
                    f"path is {str(self.path)!r}, which could not be written: {error}"
                )

    def _open(self, shapes: Mapping[str, tuple[int, int]], about: str) -> None:
        text = np.frombuffer(about.encode(), dtype=np.uint8)
        chunks = {name: (max(min(n, ROWS), 1), c) for name, (n, c) in shapes.items()}
        # HDF5 writes whole chunks
        size = sum(
            8 * math.ceil(n / chunks[name][0]) * math.prod(chunks[name])
            for name, (n, _) in shapes.items()
        )
        _demand_room(self.part, size + 2 * len(text) + len(shapes) * ARRAY_MARGIN + FILE_MARGIN)
        self._file = import_h5py().File(self.part, "w", libver=("v110", "v110"))
        for key, value in (("kind", KIND), ("format", FORMAT), ("version", version())):
            self._file.attrs[key] = value
        for name, shape in shapes.items():
            how: dict[str, Any] = {"chunks": chunks[name], "fletcher32": True} if shape[0] else {}
            self._file.create_dataset(name, shape, "f8", **how)
        about_chunk = (min(len(text), 2**16),)
        self._file.create_dataset("about", data=text, chunks=about_chunk, fletcher32=True)

    def _append(self, name: str, rows: Floats) -> None:
        first = self._written[name]
        self._written[name] += len(rows)
        self._file[name][first : first + len(rows)] = rows
        if name.endswith("/places"):
            piece = np.concatenate([[first, len(rows)], box_of(rows).ravel()])
            self._pieces.setdefault(name.removesuffix("places"), []).append(piece)

    def _complete(self) -> None:
        for table, pieces in self._pieces.items():
            self._file.create_dataset(
                f"{table}pieces", data=np.array(pieces), chunks=True, fletcher32=True
            )
        self._file.flush()
        self._file.attrs["complete"] = True
        self._file.close()
        _to_disk(self.part)
        self.part.replace(self.path)
        with suppress(OSError):  # not every file system can; either file is whole under the name
            _to_disk(self.path.parent)


def _demand_room(path: Path, size: int) -> None:
    """Raise an OSError unless a file can grow to so many bytes.

    HDF5 cannot close a file on a full disk, and crashes later.
    """
    with path.open("wb") as file:
        try:
            os.posix_fallocate(file.fileno(), 0, size)
        except (AttributeError, OSError) as error:
            if getattr(error, "errno", errno.ENOSYS) not in CANNOT_TELL:
                raise OSError(f"{size} bytes are needed: {error}") from error


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

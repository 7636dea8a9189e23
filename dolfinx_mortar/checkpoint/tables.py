# SPDX-License-Identifier: MIT
r"""Files of values at places: a head with a checksum, and HDF5.

    dolfinx_mortar checkpoint, format 7
    sha256 of what follows: 64 hexadecimal digits
    zeros to byte 512, and from there on HDF5

    version                                  attribute of the root
    about                                    JSON, the same on all ranks
    tables/NAME/places        (N, k)         where the values are, see `places`
    tables/NAME/pieces        (p, 2 + 2k)    first row, rows, corners of the box of each piece
    tables/NAME/values/FIELD  (N, c)

Rank 0 writes, and receives at most `CHUNK` rows at a time: nothing is gathered, and only rank 0
needs access to the folder. The file is written under another name, closed, sealed with its
checksum, flushed to the disk and then renamed: whenever the program is killed, there is a complete
file under the right name, the old or the new one. Each piece was written by one rank, so it is
compact: a rank reads the pieces whose boxes meet its own, and matches rows by the nearest place. A
damaged file can crash HDF5, so it is not opened before the checksum has been found right.
"""

import errno
import hashlib
import importlib
import json
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

from mpi4py import MPI

import numpy as np
from scipy.spatial import cKDTree

from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.arrays import CHUNK, SAME, Floats, Longs
from dolfinx_mortar.checkpoint.places import box_of
from dolfinx_mortar.disk import (
    CHECKPOINT,
    demand_space,
    draft_of,
    is_checkpoint,
    replace_by_draft,
    space_for,
)

FORMAT = 7  # raise this when what is written changes its meaning
HEAD = 512  # bytes: the least that HDF5 leaves to programs, its "user block"
_CHECKSUM = b"sha256 of what follows: "
_FIRST = re.compile(re.escape(CHECKPOINT) + rb", format (\d+)\n")


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


def seal(file: Path) -> None:
    """Write the head of a file that is complete otherwise."""
    first = CHECKPOINT + b", format %d\n" % FORMAT + _CHECKSUM
    with file.open("r+b") as stream:
        stream.seek(len(first) + 65)  # 64 digits and the end of the line
        digest = _digest(stream)
        stream.seek(0)
        stream.write(first + digest + b"\n")


def _digest(stream: IO[bytes]) -> bytes:
    """Return the digits of the checksum of the rest of a stream."""
    return hashlib.file_digest(stream, "sha256").hexdigest().encode()  # type: ignore[arg-type]


# -- reading -------------------------------------------------------------------------------------


def read_about(comm: MPI.Comm, path: Path) -> dict[str, Any]:
    """Return the JSON part of a file; collective.

    Raises:
        OSError: on all ranks, if there is no such file, or it cannot be read.
        ValueError: on all ranks, if it is no checkpoint, has another format or version, or is not
            as it was written.
    """
    about: Any = {}
    with raised_together(comm):
        if comm.rank == 0:
            _check_head(path)
            with _opened(path) as file:
                _check_version(path, str(file.attrs["version"]))
                about = dict(json.loads(file["about"][:].tobytes()))
    return dict(comm.bcast(about))


def read_tables(
    comm: MPI.Comm, path: Path, places: Mapping[str, Floats], size: float
) -> tuple[dict[str, dict[str, Floats]], dict[str, str]]:
    """Return the values at the places of this rank; collective.

    Args:
        path: a file that `read_about` has accepted.
        places: (n, k) of this rank, by the name of the table.
        size: largest coordinate, which scales what counts as the same place.

    Returns:
        Values (n, c) by field by table; and by table, in words, how places differ, if they do.
    """
    found: dict[str, dict[str, Floats]] = {}
    hits: dict[str, Longs] = {}
    there: dict[str, int] = {}
    with raised_together(comm), _opened(path) as file:
        for name, own in places.items():
            table = file[f"tables/{name}"]
            there[name] = len(table["places"])
            found[name], hits[name] = _read_table(table, own, SAME * size)
    told = {name: _difference(comm, own, hits[name], there[name]) for name, own in places.items()}
    return found, {name: text for name, text in told.items() if text}


def _difference(comm: MPI.Comm, own: Floats, hits: Longs, there: int) -> str:
    """Return in words how places differ from those of the file, nothing if they do not."""
    total = comm.allreduce(len(own), op=MPI.SUM)
    if total != there:
        return f"there are {total}, in the checkpoint {there}"
    # numbers are equal, so where one is there twice another one is missing: name the cause first
    for wrong, text in ((hits > 1, "there more than once"), (hits == 0, "not in the checkpoint")):
        some = comm.allgather((int(wrong.sum()), own[wrong][:1, : own.shape[1] // 2]))
        count = sum(n for n, _ in some)
        if count:
            x = next(x[0] for n, x in some if n)
            where = ", ".join(f"{v:.6g}" for v in x)
            return f"{count} of {total} are {text}, such as that at ({where})"
    return ""


def _columns(table: Any) -> dict[str, Any]:
    """Return the arrays (N, c) of a table by name, which may contain slashes."""
    columns: dict[str, Any] = {}

    def visit(name: str, item: Any) -> None:
        if hasattr(item, "shape"):
            columns[name] = item

    if "values" in table:
        table["values"].visititems(visit)
    return columns


def _read_table(table: Any, own: Floats, tolerance: float) -> tuple[dict[str, Floats], Longs]:
    """Return the values at own places (n, k), and how many rows were found for each."""
    columns = _columns(table)
    values = {name: np.zeros((len(own), c.shape[1])) for name, c in columns.items()}
    hits = np.zeros(len(own), dtype=np.int64)
    if not len(own) or table["places"].shape[1] != own.shape[1]:
        return values, hits
    tree = cKDTree(own)
    for first, count in _near(table["pieces"][:], box_of(own), tolerance):
        rows = slice(first, first + count)
        distance, at = tree.query(table["places"][rows], distance_upper_bound=tolerance)
        hit = np.isfinite(distance)
        if hit.any():
            np.add.at(hits, at[hit], 1)
            for name, column in columns.items():
                values[name][at[hit]] = column[rows][hit]
    return values, hits


def _near(pieces: Floats, box: Floats, tolerance: float) -> Iterator[tuple[int, int]]:
    """Yield first row and number of rows of the pieces whose boxes meet a box (2, k)."""
    k = box.shape[1]
    low, high = pieces[:, 2 : 2 + k], pieces[:, 2 + k :]
    meets = (low <= box[1] + tolerance).all(axis=1) & (high >= box[0] - tolerance).all(axis=1)
    for first, count in pieces[meets, :2]:
        yield int(first), int(count)


def _opened(path: Path) -> Any:
    """Open a file for reading."""
    return import_h5py().File(path, "r", locking="best-effort")


def _check_head(path: Path) -> None:
    """Raise an error unless a file is a checkpoint of this format, as it was written."""
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
        first = _FIRST.match(stream.readline(HEAD))
        if first is not None and int(first[1]) != FORMAT:
            raise ValueError(
                f"path is {str(path)!r}, a checkpoint of format {int(first[1])}; this version of "
                f"dolfinx_mortar reads format {FORMAT}: go on with the version that has written it"
            )
        second = stream.readline(HEAD)
        if first is None or second != _CHECKSUM + _digest(stream) + b"\n":
            raise ValueError(
                f"path is {str(path)!r}, which is cut off, damaged or changed since it was written "
                "(its checksum differs): take an older one"
            )


def _check_version(path: Path, written: str) -> None:
    """Raise an error if another version has written a file.

    Before 1.0 a minor version may change what laws and forms mean.
    """
    if written.split(".")[:2] != version().split(".")[:2]:
        raise ValueError(
            f"path is {str(path)!r}, a checkpoint of version {written} of dolfinx_mortar, this is "
            f"version {version()}: go on with the version that has written it"
        )

# SPDX-License-Identifier: MIT
"""Reading: every rank finds the rows of its own places.

The pieces of a file come from ranks, so they are compact, and a rank reads those only whose boxes
meet its own. Rows are matched by the nearest place.
"""

from __future__ import annotations

import errno
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
from scipy.spatial import cKDTree

from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.arrays import Floats, Longs
from dolfinx_mortar.checkpoint.places import box_of, count_all
from dolfinx_mortar.checkpoint.seal import check_seal
from dolfinx_mortar.checkpoint.writing import import_h5py, version

# Of the largest coordinate: places farther apart are different ones. Round-off is a thousandth of
# it, and what is moved by as much has the same strains to as many digits.
SAME_PLACE = 1e-10


def read_about(comm: MPI.Comm, path: Path) -> dict[str, Any]:
    """Return what a file says about itself; collective.

    Raises:
        OSError: on all ranks, if there is no such file, or it cannot be read.
        ValueError: on all ranks, if it is no checkpoint, has another format or version, or is not
            as it was written.
    """
    about: Any = {}
    with raised_together(comm):
        if comm.rank == 0:
            _check_kind(path)
            with _opened(path) as file:
                _check_version(path, file)
                text = _array(file, "about", "u1", 1)
                about = json.loads(text[:].tobytes())
                if not isinstance(about, dict):
                    raise ValueError(f"about is {about!r}")
    return dict(comm.bcast(about))


def read_tables(
    comm: MPI.Comm, path: Path, places: Mapping[str, Floats], size: float
) -> tuple[dict[str, dict[str, Floats]], dict[str, str]]:
    """Return the values at the places of this rank; collective.

    Args:
        comm: the ranks.
        path: a file that `read_about` has accepted.
        places: (n, k) of this rank, by the name of the table.
        size: largest coordinate, which scales what counts as the same place.

    Returns:
        Values (n, c) by field by table, and for the tables whose places are others what differs.

    Raises:
        ValueError: on all ranks, if a table is missing or not as `write` makes it, naming it.
    """
    totals = {name: count_all(comm, own) for name, own in places.items()}
    found: dict[str, dict[str, Floats]] = {}
    hits: dict[str, Longs] = {}
    there: dict[str, int] = {}
    with raised_together(comm), _opened(path) as file:
        for name, own in places.items():
            table = _Rows.of(file, f"tables/{name}")
            there[name] = len(table.places)
            found[name], hits[name] = _read_table(table, own, SAME_PLACE * size)
    differences = {}
    for name, total in totals.items():
        text = _difference(comm, places[name], hits[name], total, there[name])
        if text:
            differences[name] = text
    return found, differences


def _difference(comm: MPI.Comm, own: Floats, hits: Longs, total: int, there: int) -> str:
    """Return in words how places differ from those of the file, nothing if they do not."""
    if total != there:
        return f"there are {total}, in the checkpoint {there}"
    # where one is met twice, another one is missing, as the numbers are the same: why comes first
    for wrong, text in ((hits > 1, "there more than once"), (hits == 0, "not in the checkpoint")):
        some = comm.allgather((int(wrong.sum()), own[wrong][:1, : own.shape[1] // 2]))
        count = sum(n for n, _ in some)
        if count:
            x = next(x[0] for n, x in some if n)
            where = ", ".join(f"{v:.6g}" for v in x)
            return f"{count} of {total} are {text}, such as that at ({where})"
    return ""


@dataclass(frozen=True)
class _Rows:
    """A table of a file, whose arrays are as `write` makes them."""

    name: str
    places: Any  # (N, k)
    pieces: Floats  # (p, 2 + 2k)
    values: dict[str, Any]  # (N, c) by name

    @classmethod
    def of(cls, file: Any, name: str) -> _Rows:
        """Return a table.

        Raises:
            ValueError: if something is missing or of another form, naming it.
        """
        places = _array(file, f"{name}/places", "f8", 2)
        n, k = places.shape
        pieces = _array(file, f"{name}/pieces", "f8", 2)[:]
        first, rows = pieces[:, :2].T if pieces.shape[1] == 2 + 2 * k else np.full((2, 1), np.nan)
        if not np.array_equal(np.cumsum(rows) - rows, first) or rows.sum() != n or (rows < 0).any():
            raise ValueError(f"{name}/pieces are not those of {n} places")
        values = {}
        for field in _fields(file[name]):
            values[field] = _array(file, f"{name}/values/{field}", "f8", 2)
            if len(values[field]) != n:
                raise ValueError(f"{name}/values/{field} has {len(values[field])} rows, not {n}")
        return cls(name, places, pieces, values)


def _array(file: Any, name: str, kind: str, dimensions: int) -> Any:
    """Return an array of a file.

    Raises:
        ValueError: if there is none of this name, of numbers of this kind, and of so many
            dimensions.
    """
    if name not in file:
        raise ValueError(f"{name} is missing")
    array = file[name]
    shape, dtype = getattr(array, "shape", None), getattr(array, "dtype", None)
    if shape is None or dtype != np.dtype(kind) or len(shape) != dimensions:
        what = "a group" if shape is None else f"{dtype} of shape {shape}"
        raise ValueError(f"{name} is {what}: need {np.dtype(kind)} of {dimensions} dimensions")
    return array


def _fields(table: Any) -> list[str]:
    """Return the names of the values of a table, also those that have several parts."""
    names: list[str] = []

    def visit(name: str, item: Any) -> None:
        if hasattr(item, "shape") or not len(item):  # no column is an empty group
            names.append(name)

    if hasattr(table.get("values"), "visititems"):
        table["values"].visititems(visit)
    return names


def _read_table(table: _Rows, own: Floats, tolerance: float) -> tuple[dict[str, Floats], Longs]:
    """Return the values at own places (n, k), and how many rows were found for each."""
    values = {name: np.zeros((len(own), c.shape[1])) for name, c in table.values.items()}
    hits = np.zeros(len(own), dtype=np.int64)
    if not len(own) or table.places.shape[1] != own.shape[1]:
        return values, hits
    tree = cKDTree(own)
    for first, count in _near(table.pieces, box_of(own), tolerance):
        rows = slice(first, first + count)
        places = table.places[rows]
        if not np.isfinite(places).all():
            raise ValueError(f"{table.name}/places holds NaN or infinity")
        distance, at = tree.query(places, distance_upper_bound=tolerance)
        hit = np.isfinite(distance)
        if hit.any():
            np.add.at(hits, at[hit], 1)
            for name, column in table.values.items():
                values[name][at[hit]] = column[rows][hit]
    return values, hits


def _near(pieces: Floats, box: Floats, tolerance: float) -> Iterator[tuple[int, int]]:
    """Yield first row and number of rows of the pieces whose boxes meet a box (2, k)."""
    k = box.shape[1]
    low, high = pieces[:, 2 : 2 + k], pieces[:, 2 + k :]
    meets = (low <= box[1] + tolerance).all(axis=1) & (high >= box[0] - tolerance).all(axis=1)
    for first, count in pieces[meets, :2]:
        yield int(first), int(count)


def _check_kind(path: Path) -> None:
    """Raise an error unless a file is a checkpoint, as it was written."""
    import_h5py()
    if not path.exists():
        raise FileNotFoundError(
            errno.ENOENT, "path: there is no such checkpoint; check the name", str(path)
        )
    if not path.is_file():
        raise ValueError(f"path is {str(path)!r}, which is no checkpoint: no file")
    try:
        check_seal(path)
    except OSError as error:
        raise OSError(error.errno, f"path: {error.strerror}", str(path)) from error


def _check_version(path: Path, file: Any) -> None:
    """Raise an error if another version has written a file.

    Before 1.0 a minor version may change what laws and forms mean.
    """
    written = str(file.attrs.get("version"))
    if written.split(".")[:2] != version().split(".")[:2]:
        raise ValueError(
            f"a checkpoint of version {written} of dolfinx_mortar, this is version {version()}: go "
            "on with the version that has written it"
        )


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """Open a file for reading; what is wrong in it is a ValueError that names the file.

    Its checksum was right, so what is wrong then was so when it was written.
    """
    try:
        with import_h5py().File(path, "r", locking="best-effort") as file:
            yield file
    except (PermissionError, FileNotFoundError, BlockingIOError):
        raise
    except (OSError, KeyError, RuntimeError, TypeError, ValueError) as error:
        raise ValueError(f"path is {str(path)!r}, which cannot be taken over: {error}") from error

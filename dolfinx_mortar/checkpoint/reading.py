# SPDX-License-Identifier: MIT
"""Reading: every rank finds the rows of its own places.

Each piece of a file was written by one rank, so it is compact: a rank reads the pieces whose boxes
meet its own. Rows are matched by the nearest place.
"""

import errno
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
from scipy.spatial import cKDTree

from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.arrays import SAME, Floats, Longs
from dolfinx_mortar.checkpoint.places import box_of
from dolfinx_mortar.checkpoint.seal import check_seal
from dolfinx_mortar.checkpoint.writing import import_h5py, version


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
            _check_kind(path)
            with _opened(path) as file:
                _check_version(file)
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

    Raises:
        ValueError: on all ranks, if a table is missing or not as `write` makes it.
    """
    totals = {name: comm.allreduce(len(own), op=MPI.SUM) for name, own in places.items()}
    found: dict[str, dict[str, Floats]] = {}
    hits: dict[str, Longs] = {}
    there: dict[str, int] = {}
    with raised_together(comm), _opened(path) as file:
        for name, own in places.items():
            table = file[f"tables/{name}"]
            _check_table(name, table)
            there[name] = len(table["places"])
            found[name], hits[name] = _read_table(table, own, SAME * size)
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


def _check_table(name: str, table: Any) -> None:
    """Raise a ValueError unless the arrays of a table are as `write` makes them."""
    arrays = {"places": table["places"], "pieces": table["pieces"]}
    arrays |= {f"values/{field}": column for field, column in _columns(table).items()}
    for field, array in arrays.items():
        shape, dtype = getattr(array, "shape", None), getattr(array, "dtype", None)
        if dtype != np.float64 or shape is None or len(shape) != 2:
            what = "a group" if shape is None else f"{dtype} of shape {shape}"
            raise ValueError(f"tables/{name}/{field} is {what}: need float64 of 2 dimensions")
    n, k = arrays["places"].shape
    pieces = arrays.pop("pieces")[:]
    first, rows = pieces[:, :2].T if pieces.shape[1] == 2 + 2 * k else np.full((2, 1), np.nan)
    if not np.array_equal(np.cumsum(rows) - rows, first) or rows.sum() != n or (rows < 0).any():
        raise ValueError(f"tables/{name}/pieces are not those of {n} places")
    for field, array in arrays.items():
        if len(array) != n:
            raise ValueError(f"tables/{name}/{field} has {len(array)} rows: need {n}")


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


def _check_version(file: Any) -> None:
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
    """Open a file for reading; errors in its contents become a ValueError that names the file."""
    try:
        with import_h5py().File(path, "r", locking="best-effort") as file:
            yield file
    except (PermissionError, FileNotFoundError, BlockingIOError):
        raise
    except (OSError, KeyError, RuntimeError, TypeError, ValueError) as error:
        raise ValueError(
            f"path is {str(path)!r}, which cannot be restored: {error}; take a file as it was "
            "written"
        ) from error

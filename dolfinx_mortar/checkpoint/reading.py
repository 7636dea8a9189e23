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
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
from scipy.spatial import cKDTree

from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.arrays import Floats, Longs
from dolfinx_mortar.checkpoint.places import box_of, count_all
from dolfinx_mortar.checkpoint.writing import FORMAT, KIND, import_h5py, version

# Of the largest coordinate: places farther apart are different ones. Round-off is a thousandth of
# it, and what is moved by as much has the same strains to as many digits.
SAME_PLACE = 1e-10


def read_about(comm: MPI.Comm, path: Path) -> dict[str, Any]:
    """Return what a file says about itself; collective.

    Raises:
        OSError: on all ranks, if there is no such file, or it cannot be read.
        ValueError: on all ranks, if it is no checkpoint, is not complete, or has another format.
    """
    about: dict[str, Any] = {}
    with raised_together(comm):
        if comm.rank == 0:
            _check_kind(path)
            with _opened(path) as file:
                about = json.loads(file["about"][:].tobytes())
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
        ValueError: on all ranks, if the file is damaged.
    """
    totals = {name: count_all(comm, own) for name, own in places.items()}
    found: dict[str, dict[str, Floats]] = {}
    missing: dict[str, Floats] = {}
    there: dict[str, int] = {}
    with raised_together(comm), _opened(path) as file:
        for name, own in places.items():
            table = file["tables"][name]
            there[name] = len(table["places"])
            found[name], hits = _read_table(table, own, SAME_PLACE * size)
            missing[name] = own[hits != 1]
    differences = {}
    for name, total in totals.items():
        text = _difference(comm, missing[name], total, there[name])
        if text:
            differences[name] = text
    return found, differences


def _difference(comm: MPI.Comm, missing: Floats, total: int, there: int) -> str:
    """Return in words how places differ from those of the file, nothing if they do not."""
    if total != there:
        return f"there are {total}, in the checkpoint {there}"
    some = comm.allgather((len(missing), missing[:1, : missing.shape[1] // 2]))
    count = sum(n for n, _ in some)
    if not count:
        return ""
    x = next(x[0] for n, x in some if n)
    where = ", ".join(f"{v:.6g}" for v in x)
    return f"{count} of {total} are not in the checkpoint, such as that at ({where})"


def _read_table(table: Any, own: Floats, tolerance: float) -> tuple[dict[str, Floats], Longs]:
    """Return the values at own places (n, k), and how many rows were found for each."""
    values = {name: np.zeros((len(own), column.shape[1])) for name, column in _columns(table)}
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
            for name, column in _columns(table):
                values[name][at[hit]] = column[rows][hit]
    return values, hits


def _columns(table: Any) -> list[tuple[str, Any]]:
    """Return names and columns of a table, also those whose names have several parts."""
    columns: list[tuple[str, Any]] = []

    def visit(name: str, item: Any) -> None:
        if hasattr(item, "shape"):
            columns.append((name, item))

    if "values" in table:
        table["values"].visititems(visit)
    return columns


def _near(pieces: Floats, box: Floats, tolerance: float) -> Iterator[tuple[int, int]]:
    """Yield first row and number of rows of the pieces whose boxes meet a box (2, k)."""
    k = box.shape[1]
    low, high = pieces[:, 2 : 2 + k], pieces[:, 2 + k :]
    meets = (low <= box[1] + tolerance).all(axis=1) & (high >= box[0] - tolerance).all(axis=1)
    for first, count in pieces[meets, :2]:
        yield int(first), int(count)


def _check_kind(path: Path) -> None:
    """Raise an error unless a file is a checkpoint, as far as its name and its head tell."""
    h5py = import_h5py()
    if not path.exists():
        raise FileNotFoundError(
            errno.ENOENT, "path: there is no such checkpoint; check the name", str(path)
        )
    try:
        if path.is_file():
            path.open("rb").close()
    except OSError as error:
        raise OSError(error.errno, f"path: {error.strerror}", str(path)) from error
    if not path.is_file() or not h5py.is_hdf5(path):
        raise ValueError(f"path is {str(path)!r}, which is no checkpoint: no HDF5 file")
    with _opened(path) as file:
        head = {name: file.attrs.get(name) for name in ("kind", "format", "version")}
        complete = bool(file.attrs.get("complete", False)) and "about" in file
    if head["kind"] != KIND:
        raise ValueError(
            f"path is {str(path)!r}, which is no checkpoint: an HDF5 file of another kind"
        )
    if not complete:
        raise ValueError(
            f"path is {str(path)!r}, which is not complete, because its writer was stopped: take "
            "the last complete one"
        )
    # before 1.0 a minor version may change what laws and forms mean
    written = str(head["version"])
    if head["format"] != FORMAT or written.split(".")[:2] != version().split(".")[:2]:
        raise ValueError(
            f"path is {str(path)!r}, a checkpoint of version {written} of dolfinx_mortar (format "
            f"{head['format']}); this is version {version()} (format {FORMAT}): go on with the "
            "version that has written it"
        )


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """Open a file for reading; what HDF5 cannot read in it is a ValueError that says so."""
    try:
        with import_h5py().File(path, "r", locking="best-effort") as file:
            yield file
    except (PermissionError, FileNotFoundError, BlockingIOError):
        raise
    except (OSError, KeyError, RuntimeError, json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ValueError(
            f"path is {str(path)!r}, which is cut off or damaged ({error}): take an older one"
        ) from error

# SPDX-License-Identifier: MIT
r"""One HDF5 file of values at places, written by any number of ranks and read by any other.

    dolfinx_mortar checkpoint, format 9, version 0.1
    sha256 of what follows: 64 hexadecimal digits
    zeros to byte 512, and from there on HDF5

    about            JSON: what the caller gives; columns and shape of each table
    NAME    (N, c)   a table: in each row a place, and the values there

Node numbers depend on the ranks, and nodes of both sides may coincide, so places are

    (x, c),    c the mean of the midpoints of its cells.

Rank 0 receives the rows of one rank at a time. The file is renamed once complete. Each rank reads
all rows, a part at a time, and takes those at its places. HDF5 may crash on a damaged file, so
the checksum is tested first.
"""

import errno
import hashlib
import json
import sys
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

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

FORMAT = 9  # raise this when the meaning of the content changes
HEAD = 512  # bytes: HDF5's smallest "user block"
CHECKSUM = b"sha256 of what follows: "
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


def write(
    comm: MPI.Comm,
    path: Path,
    about: Mapping[str, Any],
    places: Mapping[str, Floats],
    values: Values,
) -> None:
    """Write values at places (n, k) by table, and `about`, to a new file; collective.

    Raises:
        OSError: on all ranks, if rank 0 cannot write; an older file stays.
    """
    check_folder(comm, path)
    tables = {}
    for name, x in places.items():
        columns = {column: v.shape[1] for column, v in values[name].items()}
        shape = comm.allreduce(len(x)), x.shape[1] + sum(columns.values())
        tables[name] = {"columns": columns, "shape": shape}
    rows = ((n, part) for n in places for part in _rows(comm, [places[n], *values[n].values()]))
    with raised_together(comm):
        try:
            if comm.rank == 0:
                _write_file(path, {**about, "tables": tables}, rows)
        finally:
            for _ in rows:  # after an error, too: other ranks send until all is received
                pass


def _rows(comm: MPI.Comm, columns: list[Floats]) -> Iterator[Floats]:
    """Yield rows of all ranks on rank 0, which must exhaust them; others send; collective."""
    rows = np.hstack(columns)
    if comm.rank > 0:
        comm.send(rows, dest=0)
        return
    yield rows
    for rank in range(1, comm.size):
        yield comm.recv(source=rank)


def _write_file(path: Path, about: Mapping[str, Any], rows: Iterator[tuple[str, Floats]]) -> None:
    draft = draft_of(path)
    try:
        text = np.frombuffer(json.dumps(about, default=_plain).encode(), dtype=np.uint8)
        shapes = {name: table["shape"] for name, table in about["tables"].items()}
        draft.write_bytes(b"")
        numbers = 8 * sum(n * c for n, c in shapes.values())
        demand_space(draft, space_for(len(shapes) + 1, numbers + len(text)))
        with import_h5py().File(draft, "w", libver=("v110", "v110"), userblock_size=HEAD) as file:
            file.create_dataset("about", data=text)
            written = {name: 0 for name in shapes}
            for name, shape in shapes.items():
                file.create_dataset(name, shape, "f8")
            for name, part in rows:
                file[name][written[name] : written[name] + len(part)] = part
                written[name] += len(part)
        seal(draft)
        replace_by_draft(path)
    except Exception as error:  # h5py has several for a disk that fails
        with suppress(Exception):
            draft.unlink()
        raise OSError(f"path is {str(path)!r}, which could not be written: {error}") from error


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.generic | np.ndarray) else str(value)


def _first_line() -> bytes:
    """First line; before 1.0 a minor version may change laws and forms."""
    package = sys.modules[__name__.partition(".")[0]]
    minor = ".".join(package.__version__.split(".")[:2])
    return CHECKPOINT + f", format {FORMAT}, version {minor}\n".encode()


def _shown(line: bytes) -> str:
    return repr(line.decode(errors="replace").rstrip())


def _second_line(stream: IO[bytes]) -> bytes:
    digest = hashlib.file_digest(stream, "sha256")  # type: ignore[arg-type]
    return CHECKSUM + digest.hexdigest().encode() + b"\n"


def seal(file: Path) -> None:
    """Write the head of an otherwise complete file."""
    first = _first_line()
    with file.open("r+b") as stream:
        stream.seek(len(first + CHECKSUM) + 65)  # 64 digits and the end of the line
        second = _second_line(stream)
        stream.seek(0)
        stream.write(first + second)


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
    hits: dict[str, Longs] = {}
    with raised_together(comm), _opened(path) as file:
        for name, own in places.items():
            found[name], hits[name] = _read_table(
                file[name], about["tables"][name]["columns"], own, size
            )
    told = {}
    for name, own in places.items():
        told[name] = _difference(comm, own, hits[name], about["tables"][name]["shape"][0])
    return found, {name: text for name, text in told.items() if text}


def _read_table(
    table: Any, widths: Mapping[str, int], own: Floats, size: float
) -> tuple[dict[str, Floats], Longs]:
    """Values at own places (n, k), and number of rows of each."""
    n, k = own.shape
    tree = scipy.spatial.cKDTree(own)
    values, hits = np.zeros((n, sum(widths.values()))), np.zeros(n, dtype=np.int64)
    for first in range(0, len(table), CHUNK):
        rows = table[first : first + CHUNK]
        distance, at = tree.query(rows[:, :k], distance_upper_bound=SAME * size)
        hit = np.isfinite(distance)
        hits += np.bincount(at[hit], minlength=n)
        values[at[hit]] = rows[hit, k:]
    columns = np.split(values, np.cumsum([*widths.values()])[:-1], axis=1)
    return dict(zip(widths, columns, strict=False)), hits


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


def _opened(path: Path) -> Any:
    return import_h5py().File(path, "r", locking="best-effort")


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
            raise ValueError(
                f"path is {str(path)!r}, which begins with {_shown(first)}, but this version reads "
                f"{_shown(own)}: go on with the version that has written it"
            )
        if second != _second_line(stream):
            raise ValueError(
                f"path is {str(path)!r}, which is cut off, damaged or changed since it was written "
                "(its checksum differs): take an older one"
            )

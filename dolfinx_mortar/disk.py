# SPDX-License-Identifier: MIT
"""Files that are replaced as a whole, and checks of a path and its disk before HDF5 writes there.

Whether it can be a name; whether there is space, as HDF5 crashes on a full disk; and whether a file
that would be replaced is a checkpoint: ``Writer("run.xdmf", ..)`` and ``checkpoint="run.h5"`` use
the same one.
"""

import errno
import os
from contextlib import suppress
from pathlib import Path
from typing import Any

from mpi4py import MPI

from dolfinx_mortar.agreement import check_same_on_all_ranks

# Bytes that HDF5 keeps for an array, and for a file, beside the numbers. Measured: 0.5 kB for those
# of h5py, 4.4 kB for those of PETSc, which are in chunks.
INDEX = 2**13
CANNOT_TELL = (errno.EOPNOTSUPP, errno.EINVAL, errno.ENOSYS)  # file systems that allocate nothing

CHECKPOINT = b"dolfinx_mortar checkpoint"  # how one begins


def is_checkpoint(file: Path) -> bool:
    """Tell whether there is a file, and it begins as a checkpoint does."""
    if not file.is_file():
        return False
    with file.open("rb") as stream:
        return stream.read(len(CHECKPOINT)) == CHECKPOINT


def draft_of(path: Path) -> Path:
    """Return the name under which a file is written until it is complete."""
    return path.with_name(f"{path.name}.part")


def replace_by_draft(path: Path) -> None:
    """Give a complete draft the name of the file, in one move, when it is on the disk."""
    draft = draft_of(path)
    flush(draft)
    draft.replace(path)
    with suppress(OSError):  # not every file system can; either file is whole under the name
        flush(path.parent)


def flush(path: Path) -> None:
    """Wait until a file, or the names in a folder, are on the disk."""
    number = os.open(path, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)


def space_for(arrays: int, size: int) -> int:
    """Return by how many bytes a file of HDF5 grows at most, for arrays of so many bytes in all."""
    return size + INDEX * (arrays + 1)


def demand_space(file: Path, size: int) -> None:
    """Raise an OSError unless an existing file can grow by so many bytes; it is not changed.

    File systems that cannot reserve space raise nothing.
    """
    if not hasattr(os, "posix_fallocate"):
        return
    with file.open("r+b") as stream:
        before = os.fstat(stream.fileno()).st_size
        try:
            os.posix_fallocate(stream.fileno(), before, size)
        except OSError as error:
            if error.errno not in CANNOT_TELL:
                raise OSError(
                    error.errno, f"{error.strerror}: no space for {size} bytes more", str(file)
                ) from error
        finally:
            stream.truncate(before)


def check_path(comm: MPI.Comm, path: Any, name: str = "path") -> Path:
    """Return a file name as a path if it is one, the same on all ranks; collective."""
    known = isinstance(path, str | os.PathLike)
    check_same_on_all_ranks(comm, **{name: os.fspath(path) if known else path})
    if not known or not _can_be_name(os.fspath(path)):
        raise ValueError(f"{name} is {path!r}: give the name of a file")
    return Path(os.fsdecode(path))


def _can_be_name(path: str | bytes) -> bool:
    """Tell whether a file or a folder can have a name."""
    try:
        name = os.fsencode(path)
    except UnicodeEncodeError:
        return False
    return bool(name) and b"\0" not in name

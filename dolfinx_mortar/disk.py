# SPDX-License-Identifier: MIT
"""Checks of a path and its disk before HDF5 writes there.

Whether it can be a name; whether there is room, as HDF5 does not survive a full disk; and what a
file is that would be replaced: ``Writer("run.xdmf", ..)`` and ``checkpoint="run.h5"`` mean the same
one.
"""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import Any

from mpi4py import MPI

from dolfinx_mortar.agreement import check_same_on_all_ranks

CANNOT_TELL = (errno.EOPNOTSUPP, errno.EINVAL, errno.ENOSYS)  # file systems that allocate nothing

CHECKPOINT = b"dolfinx_mortar checkpoint"  # how one begins


def is_checkpoint(file: Path) -> bool:
    """Tell whether there is a file, and it begins as a checkpoint does."""
    if not file.is_file():
        return False
    with file.open("rb") as stream:
        return stream.read(len(CHECKPOINT)) == CHECKPOINT


def demand_room(file: Path, size: int) -> None:
    """Raise an OSError unless a file that is there can grow by so many bytes; it is left as it is.

    Where the system cannot tell, nothing is raised.
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
                    error.errno, f"{error.strerror}: no room for {size} bytes more", str(file)
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
    """Tell whether the system can call a file so, or a folder."""
    try:
        name = os.fsencode(path)
    except UnicodeEncodeError:
        return False
    return bool(name) and b"\0" not in name

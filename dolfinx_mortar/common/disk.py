# SPDX-License-Identifier: MIT
"""Files replaced atomically; checks of a path and its disk, as HDF5 crashes on a full one."""

import errno
import os
from contextlib import suppress
from pathlib import Path
from typing import Any

from mpi4py import MPI

from dolfinx_mortar.common.agreement import check_same_on_all_ranks

# Bytes of HDF5 per array and file in addition to data; at most 4.4 kB (chunks of PETSc).
INDEX = 2**13
CANNOT_TELL = (errno.EOPNOTSUPP, errno.EINVAL, errno.ENOSYS)  # file systems without allocation

CHECKPOINT = b"dolfinx_mortar checkpoint"  # first bytes of the file


def is_checkpoint(file: Path) -> bool:
    """Whether a file exists and begins as a checkpoint."""
    if not file.is_file():
        return False
    with file.open("rb") as stream:
        return stream.read(len(CHECKPOINT)) == CHECKPOINT


def draft_of(path: Path) -> Path:
    """Name of an incomplete file."""
    return path.with_name(f"{path.name}.part")


def replace_by_draft(path: Path) -> None:
    """Rename a complete draft, once it is on the disk."""
    draft = draft_of(path)
    flush(draft)
    draft.replace(path)
    with suppress(OSError):  # not all file systems can
        flush(path.parent)


def flush(path: Path) -> None:
    """Wait until a file or folder is on the disk."""
    number = os.open(path, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)


def space_for(arrays: int, size: int) -> int:
    """Upper bound of an HDF5 file's growth."""
    return size + INDEX * (arrays + 1)


def demand_space(file: Path, size: int) -> None:
    """Raise an OSError unless an existing file can grow by so many bytes."""
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
    """Checked file name as a path, the same on all ranks; collective."""
    try:
        known = os.fsencode(path)
    except (TypeError, UnicodeEncodeError):
        known = b""
    check_same_on_all_ranks(comm, **{name: os.fsdecode(known) or path})
    if not known or b"\0" in known:
        raise ValueError(f"{name} is {path!r}: give the name of a file")
    return Path(os.fsdecode(known))

# SPDX-License-Identifier: MIT
"""What has to be known of a disk before HDF5 writes on it.

Whether there is room, as HDF5 does not survive a full disk; and what a file is that would be
replaced: ``Writer("run.xdmf", ..)`` and ``checkpoint="run.h5"`` mean the same one.
"""

from __future__ import annotations

import errno
import os
from pathlib import Path

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

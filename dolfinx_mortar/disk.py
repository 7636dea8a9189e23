# SPDX-License-Identifier: MIT
"""Whether there is room on the disk: told before HDF5 meets its end, which it does not survive."""

from __future__ import annotations

import errno
import os
from pathlib import Path

CANNOT_TELL = (errno.EOPNOTSUPP, errno.EINVAL, errno.ENOSYS)  # file systems that allocate nothing


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

# SPDX-License-Identifier: MIT
"""The head of a file: its kind, its format, and the checksum of all that follows.

    dolfinx_mortar checkpoint, format 6
    sha256 of what follows: 64 hexadecimal digits
    zeros to byte 512, and from there on HDF5

HDF5 leaves the head to programs (its "user block"); h5py, h5dump and the like look for their data
behind it. A damaged file can crash HDF5, so it is not opened before the checksum has been found
right. The head is written last: a file that is not complete has none.
"""

import hashlib
import re
from pathlib import Path
from typing import IO

from dolfinx_mortar.disk import CHECKPOINT

# Raise this when what is written changes its meaning
FORMAT = 6
HEAD = 512  # bytes: the least that HDF5 leaves
KIND = CHECKPOINT + b", format "
CHECKSUM = b"sha256 of what follows: "
HDF5 = b"\x89HDF\r\n\x1a\n"
_FIRST = re.compile(re.escape(KIND) + rb"(\d+)\n")


def seal(file: Path) -> None:
    """Write the head of a file that is complete otherwise."""
    first = KIND + str(FORMAT).encode() + b"\n" + CHECKSUM
    with file.open("r+b") as stream:
        stream.seek(len(first) + 65)  # 64 digits and the end of the line
        digest = _digest(stream)
        stream.seek(0)
        stream.write(first + digest + b"\n")


def check_seal(file: Path) -> None:
    """Compare a file with its checksum.

    Raises:
        OSError: if it cannot be read.
        ValueError: if it is no checkpoint, of another format, or not as it was written.
    """
    with file.open("rb") as stream:
        first = _FIRST.match(stream.readline(HEAD))
        if first is None:
            raise ValueError(f"path is {str(file)!r}, which is no checkpoint: {_kind(stream)}")
        if int(first[1]) != FORMAT:
            raise ValueError(
                f"path is {str(file)!r}, a checkpoint of format {int(first[1])}; this version of "
                f"dolfinx_mortar reads format {FORMAT}: go on with the version that has written it"
            )
        second = stream.readline(HEAD)
        if second != CHECKSUM + _digest(stream) + b"\n":
            raise ValueError(
                f"path is {str(file)!r}, which is cut off, damaged or changed since it was written "
                "(its checksum differs): take an older one"
            )


def _digest(stream: IO[bytes]) -> bytes:
    """Return the digits of the checksum of the rest of a stream."""
    return hashlib.file_digest(stream, "sha256").hexdigest().encode()  # type: ignore[arg-type]


def _kind(stream: IO[bytes]) -> str:
    """Return in words what a file may be whose first line is not that of a checkpoint."""
    stream.seek(0)
    start = stream.read(HEAD)
    if start.startswith(HDF5):
        return "an HDF5 file of another kind, or written by a version before format 3: go on there"
    if len(start) == HEAD and not any(start):
        return "its writer was stopped before it was complete: take the last complete one"
    return "a file of another kind"

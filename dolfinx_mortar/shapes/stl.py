# SPDX-License-Identifier: MIT
"""STL files, binary or text."""

import os
import re
from pathlib import Path

import numpy as np

from dolfinx_mortar.arrays import Floats, Longs

HEADER = 84
"""Bytes before the first triangle of a binary file: 80 of text, and the number of triangles."""

RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
"""A triangle of a binary file, 50 bytes."""

VERTEX = re.compile(rb"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)", re.IGNORECASE)


def read_stl(path: str | os.PathLike[str]) -> tuple[Floats, Longs]:
    """Points (n, 3) and triangles (m, 3) of a file; corners are merged, normals ignored.

    Raises:
        ValueError: for unreadable, invalid or truncated files, NaN and infinity.
    """
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        raise ValueError(
            f"surface is {os.fspath(path)!r}, which cannot be read: {error.strerror}"
        ) from error
    corners = _binary(content)
    if corners is None:
        corners = _text(content)
        if corners is not None and b"endsolid" not in content.lower():
            raise ValueError(
                f"surface is {os.fspath(path)!r}, which ends after {len(corners)} triangles "
                "without 'endsolid': it is cut off; export or copy it anew"
            )
    if corners is None or not len(corners):
        raise ValueError(
            f"surface is {os.fspath(path)!r}, which is no STL file, {len(content)} bytes long: "
            "export the surface as STL, binary or text"
        )
    wrong = np.asarray(~np.isfinite(corners).all(axis=(1, 2)))
    if wrong.any():
        raise ValueError(
            f"surface is {os.fspath(path)!r}, in which {int(wrong.sum())} of {len(corners)} "
            "triangles have corners that are not finite, first number "
            f"{int(np.argmax(wrong)) + 1}: export it anew"
        )
    points, place = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    return points.astype(np.float64), place.reshape(-1, 3).astype(np.int64)


def _binary(content: bytes) -> Floats | None:
    """Corners (m, 3, 3); None if the length of the file does not fit."""
    if len(content) < HEADER:
        return None
    count = int.from_bytes(content[HEADER - 4 : HEADER], "little")
    if len(content) != HEADER + RECORD.itemsize * count:
        return None
    return np.frombuffer(content, RECORD, offset=HEADER)["corners"].astype(np.float64)


def _text(content: bytes) -> Floats | None:
    """Corners (m, 3, 3); None for other texts."""
    if not content.lstrip()[:5].lower() == b"solid":
        return None
    try:
        found = np.array(VERTEX.findall(content)).astype(np.float64)
    except ValueError:
        return None
    return found.reshape(-1, 3, 3) if found.size and len(found) % 3 == 0 else None

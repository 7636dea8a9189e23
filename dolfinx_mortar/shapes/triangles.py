# SPDX-License-Identifier: MIT
"""Tools given by triangles: STL files, or arrays.

A triangle of `curved` with corners p_i and smooth normals n_i has

    a_ij = (n_i + n_j) (n_j - n_i).(p_j - p_i) / |n_i + n_j|^2,

four times the offset of the edge's middle: T. Nagata, Simple local interpolation of surfaces using
normal vectors (2005), except for straight S-shaped edges. Creases are straight, faces without
smooth edges flat.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from dolfinx_mortar.common.arguments import FLAG, array, check
from dolfinx_mortar.common.arrays import HALF_OF_DIGITS, Bools, Floats, Longs
from dolfinx_mortar.shapes.curved import Curved
from dolfinx_mortar.shapes.shape import CREASE, Distance, refuse


def _check_surface(x: Floats, triangles: Longs, rim: bool) -> Longs:
    """Edges (m, 3) beyond those of triangles, 3 triangle + edge, -1 at a rim, or a ValueError."""

    def refuse_some(wrong: Bools, what: str, remedy: str) -> None:
        at = np.asarray(wrong.reshape(len(x), -1).any(axis=1))
        refuse("surface has", x.mean(axis=1), at, f"triangles {what}", remedy)

    across = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    sides = _length(x - x[:, [1, 2, 0]]).max(axis=1)
    refuse_some(
        _length(across) <= HALF_OF_DIGITS * sides**2,
        "without area",
        "remove them, and let their neighbours have common corners",
    )
    ends, size = np.stack([triangles, triangles[:, [1, 2, 0]]], axis=2), triangles.max() + 1
    keys, others = (ends @ [size, 1]).ravel(), (ends @ [1, size]).ravel()
    _, place, count = np.unique(np.minimum(keys, others), return_inverse=True, return_counts=True)
    refuse_some(
        count[place] > 2,
        "with an edge of three or more of them",
        "no surface does that; leave out what is inside the tool",
    )
    order = np.argsort(keys)
    found = order[np.minimum(np.searchsorted(keys[order], others), len(keys) - 1)]
    beyond = np.where(keys[found] == others, found, -1).reshape(-1, 3)
    turned = ((beyond < 0) & (count[place] == 2).reshape(-1, 3)).sum(axis=1)
    refuse_some(
        turned > (turned > 1).any(),  # of the majority
        "that are turned against their neighbours",
        "order the corners of all counterclockwise as seen from outside of the tool",
    )
    if not rim:
        refuse_some(
            beyond < 0,
            "at a hole",
            "close it; or give rim=True for a surface that ends beside the body",
        )
    volume = float((x[:, 0] * np.cross(x[:, 1], x[:, 2])).sum())
    if (beyond >= 0).all() and volume < 0.0:
        raise ValueError(
            "surface is turned inside out, as normals of all its triangles point into it: turn "
            "them round, triangles[:, ::-1], or for a body in a cavity give the Complement of that"
        )
    return beyond


def _round(x: Floats, triangles: Longs, beyond: Longs, crease: float) -> tuple[Floats, ...]:
    """Bends a and -a (m, 3, 2, 3), and sums of normals (m, 3, 3) at edges and at corners.

    Smooth normals are averages over triangles connected without a crease, exact for spheres: N.
    Max, Weights for computing vertex normals from facet normals (1999). The product of sums
    weighted by angles with the offset from the nearest point is positive outside: J. A. Baerentzen,
    H. Aanaes, Signed distance computation using the angle weighted pseudonormal (2005).
    """
    one, other = np.roll(x, -1, axis=1) - x, np.roll(x, 1, axis=1) - x
    across, sizes = np.cross(one, other), _length(one) * _length(other)
    normals, inner = across / _length(across)[..., None], beyond >= 0
    beside = np.where(inner[..., None], normals[beyond // 3, 0], 0.0)
    smooth = (normals * beside).sum(axis=2) >= np.cos(np.radians(crease)) - HALF_OF_DIGITS
    edge = np.flatnonzero(inner & smooth)
    back = beyond.ravel()[edge]
    pairs = edge, back - back % 3 + (back + 1) % 3  # first corner, and second one beyond
    graph = scipy.sparse.coo_array((np.ones(len(edge)), pairs), shape=(triangles.size,) * 2)
    _, group = scipy.sparse.csgraph.connected_components(graph, directed=False)
    n = _summed(group, across / sizes[..., None] ** 2)
    n /= _length(n)[..., None]
    after = np.roll(n, -1, axis=1)
    bent = ((after - n) * one).sum(axis=2) / ((n + after) ** 2).sum(axis=2)
    bent *= (smooth | ~inner) * (crease > 0.0)
    a = bent[..., None] * (n + after)
    angles = np.arccos(np.clip((one * other).sum(axis=2) / sizes, -1.0, 1.0))
    corners = _summed(triangles.ravel(), angles[..., None] * normals)
    return np.stack([a, -a], axis=2), normals + beside, corners


def _summed(group: Longs, parts: Floats) -> Floats:
    """Sums of parts (m, 3, 3) over groups (3 m,) of corners."""
    total = np.zeros((int(group.max()) + 1, 3))
    np.add.at(total, group, parts.reshape(-1, 3))
    return total[group].reshape(-1, 3, 3)


def _length(vectors: npt.NDArray[np.floating[Any]]) -> Floats:
    return np.linalg.norm(vectors, axis=-1)


HEADER = 84
"""Bytes before the first triangle of a binary file: 80 of text, and the number of triangles."""

RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
"""A triangle of a binary file, 50 bytes."""

VERTEX = re.compile(rb"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)", re.IGNORECASE)


class Triangles(Curved):
    """The body enclosed by triangles, counterclockwise as seen from outside; in space.

    Args:
        surface: path of an STL file, binary or text, read by every rank at the first use (errors
            are raised on all ranks); or points (n, 3) and triangles (m, 3).
        point: 3 coordinates of the tool's reference point; default the middle of its box.
        crease: angle of normals in degrees, 0 to 90, above which an edge is sharp. With 0 all
            triangles are flat.
        rim: whether the surface may end. Beyond its rim phi is the distance from it, where the body
            must not be.

    Raises:
        ValueError: also for unreadable files, triangles without area or turned against their
            neighbours, holes (without ``rim``), edges of more than two triangles, and bodies turned
            inside out.
    """

    def __init__(
        self, surface: Any, point: Any = None, *, crease: float = 30.0, rim: bool = False
    ) -> None:
        self.crease, self.rim = check("crease", crease, CREASE), check("rim", rim, FLAG)
        file = isinstance(surface, str | os.PathLike)
        self.file = os.fspath(surface) if file else None
        self.point: Floats = np.zeros(3)
        if point is not None:
            self.point = check("point", point, array((3,)))
        self._unread: ValueError | None = None
        try:
            self._surface = read_stl(surface) if file else _check_arrays(surface)
        except ValueError as error:
            if not file:
                raise
            self._unread = error  # perhaps on this rank only
            self._digest = f"not read, {error}"
            return
        points, triangles = self._surface
        x = points[triangles]
        if point is None:
            self.point = (x.min(axis=(0, 1)) + x.max(axis=(0, 1))) / 2
        beyond = _check_surface(x, triangles, self.rim)
        self._bend(x, *_round(x, triangles, beyond, self.crease))

    def misfit(self, d: int, revolved: bool) -> str:
        """See `Shape`."""
        return super().misfit(d, revolved) if self._unread is None else str(self._unread)

    @property
    def surface(self) -> tuple[Floats, Longs]:
        """See `Shape`; a ValueError for an unreadable file."""
        if self._unread is not None:
            raise self._unread
        return self._surface

    def __repr__(self) -> str:
        of = f"{self.file!r}, " if self.file else ""
        if self._unread is not None:
            return f"Triangles({of}not read)"
        return f"Triangles({of}{len(self._surface[1])} triangles)"

    def distance(self, x: Floats) -> Distance:
        """See `Shape`."""
        _ = self.surface  # raises for an unreadable file
        return super().distance(x)


def _check_arrays(surface: Any) -> tuple[Floats, Longs]:
    wanted = "give the path of an STL file, or points (n, 3) and triangles (m, 3)"
    if not isinstance(surface, list | tuple) or len(surface) != 2:
        raise ValueError(f"surface is {surface!r}: {wanted}")
    rule = array((None, 3), remedy=wanted, holds=len)
    points = check("surface: points", surface[0], rule)
    n = len(points)
    numbers = f"give rows of three numbers of points, 0 to {n - 1}, with a corner at each"
    rule = array((None, 3), remedy=numbers, holds=lambda k: len(k) and np.isin(k, range(n)).all())
    return points, check("surface: triangles", surface[1], rule).astype(np.int64)


def read_stl(path: str | os.PathLike[str]) -> tuple[Floats, Longs]:
    """Points (n, 3), merged, and triangles (m, 3) of a file; a ValueError if it is damaged."""
    who = f"surface is {os.fspath(path)!r}"
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        raise ValueError(f"{who}, which cannot be read: {error.strerror}") from error
    corners = _binary(content)
    if corners is None:
        corners = _text(content)
        if corners is not None and b"endsolid" not in content.lower():
            raise ValueError(
                f"{who}, which ends after {len(corners)} triangles "
                "without 'endsolid': it is cut off; export or copy it anew"
            )
    if corners is None or not len(corners):
        raise ValueError(
            f"{who}, which is no STL file, {len(content)} bytes long: "
            "export the surface as STL, binary or text"
        )
    wrong = ~np.isfinite(corners).all(axis=(1, 2))
    if wrong.any():
        raise ValueError(
            f"{who}, in which {int(wrong.sum())} of {len(corners)} "
            "triangles have corners that are not finite, first number "
            f"{int(np.argmax(wrong)) + 1}: export it anew"
        )
    points, place = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    return points.astype(np.float64), place.reshape(-1, 3).astype(np.int64)


def _binary(content: bytes) -> Floats | None:
    """Corners (m, 3, 3), None for a wrong length."""
    if len(content) < HEADER:
        return None
    count = int.from_bytes(content[HEADER - 4 : HEADER], "little")
    if len(content) != HEADER + RECORD.itemsize * count:
        return None
    return np.frombuffer(content, RECORD, offset=HEADER)["corners"].astype(np.float64)


def _text(content: bytes) -> Floats | None:
    """Corners (m, 3, 3), None for other texts."""
    if not content.lstrip()[:5].lower() == b"solid":
        return None
    try:
        found = np.array(VERTEX.findall(content)).astype(np.float64)
    except ValueError:
        return None
    return found.reshape(-1, 3, 3) if found.size and len(found) % 3 == 0 else None

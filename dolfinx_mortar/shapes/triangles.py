# SPDX-License-Identifier: MIT
r"""Tools of any form, given by triangles: files of CAD programs, or arrays.

Each triangle with corners p_i and smooth normals n_i there is that of `curved` with

    a_ij = (n_i + n_j) (n_j - n_i).(p_j - p_i) / |n_i + n_j|^2,

four times the way of the middle of the edge. Where it bends to one side, as on a sphere, it is
across n_i and n_j, and the surface that of T. Nagata, Simple local interpolation of surfaces using
normal vectors (2005); edges that would bend to both sides stay straight. Neighbours have the same
parabola, so the surface has no gaps. Creases stay straight, faces without a smooth edge flat.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from dolfinx_mortar.arguments import FLAG, array, check
from dolfinx_mortar.arrays import Floats, Longs
from dolfinx_mortar.shapes.curved import Curved
from dolfinx_mortar.shapes.shape import CREASE, Distance
from dolfinx_mortar.shapes.stl import read_stl
from dolfinx_mortar.shapes.triangulation import (
    FIRST,
    SECOND,
    Triangulation,
    create_triangulation,
)


class Triangles(Curved):
    """The body within triangles, whose normals, counterclockwise, point out of it; in space.

    Args:
        surface: the path of an STL file, binary or text, which every rank reads (what is wrong with
            it is raised where the shape is used first: on all ranks); or points (n, 3)
            and triangles (m, 3), the numbers of their corners.
        point: 3 coordinates that tell where the tool is, about which it turns; the middle of the
            box around the triangles if not given.
        crease: in degrees, from 0 to 90; an edge at which normals turn by more stays sharp, others
            are smooth. With 0 all triangles are flat.
        rim: whether the surface may end, as one side of a die. Beyond its rim phi is the distance
            from that: the body must not get there.

    Raises:
        ValueError: naming a wrong argument; for files that cannot be read or are no STL, triangles
            without area or turned against their neighbours, holes (without ``rim``), edges of more
            than two, and a body turned inside out.
    """

    def __init__(
        self, surface: Any, point: Any = None, *, crease: float = 30.0, rim: bool = False
    ) -> None:
        self.crease, self.rim = check("crease", crease, CREASE), check("rim", rim, FLAG)
        file = isinstance(surface, str | os.PathLike)
        self.file = os.fspath(surface) if file else None
        self._point: Floats = np.zeros(3)
        if point is not None:
            self._point = check("point", point, array((3,)))
        self._unread: ValueError | None = None
        try:
            points, triangles = read_stl(surface) if file else _check_arrays(surface)
        except ValueError as error:
            if not file:
                raise
            self._unread = error  # perhaps on this rank alone, which must not leave the others
            return
        self._triangulation = create_triangulation(points, triangles, rim=self.rim)
        x = self.triangulation.corners
        if point is None:
            self._point = (x.min(axis=(0, 1)) + x.max(axis=(0, 1))) / 2
        normals, smooth = self.triangulation.smooth_normals(self.crease)
        a = _bulges(x, normals) * smooth[..., None] * (self.crease > 0.0)
        shape = self.triangulation
        bends = np.stack([a, -a], axis=2)
        self._bend(x, bends, shape.edge_normals(), shape.point_normals())

    @property
    def triangulation(self) -> Triangulation:
        """The triangles with their neighbours.

        Raises:
            ValueError: for a file that could not be read.
        """
        if self._unread is not None:
            raise self._unread
        return self._triangulation

    def misfit(self, d: int, revolved: bool) -> str:
        """Say why it cannot be used; "" if it can."""
        return super().misfit(d, revolved) if self._unread is None else str(self._unread)

    @property
    def point(self) -> Floats:
        """As given, or the middle of the box around it, (3,)."""
        return self._point

    @property
    def surface(self) -> tuple[Floats, Longs]:
        """Points (n, 3) and triangles (m, 3) for pictures."""
        return self.triangulation.points, self.triangulation.triangles

    def given(self) -> Mapping[str, Any]:
        """Return the arguments by name, of the triangles a digest."""
        names = {"point": self._point, "crease": self.crease, "rim": self.rim}
        if self._unread is not None:
            return {"surface": f"not read, {self._unread}", **names}
        shape = self.triangulation
        digest = hashlib.sha256(shape.points.tobytes() + shape.triangles.tobytes()).hexdigest()
        return {"surface": digest, **names}

    def __repr__(self) -> str:
        of = f"{self.file!r}, " if self.file else ""
        if self._unread is not None:
            return f"Triangles({of}not read)"
        return f"Triangles({of}{len(self.triangulation.triangles)} triangles)"

    def distance(self, x: Floats) -> Distance:
        """Return the distances of points x (n, 3)."""
        _ = self.triangulation  # raises for a file that could not be read
        return super().distance(x)


def _bulges(x: Floats, normals: Floats) -> Floats:
    """Return a (m, 3, 3) of edges, see `curved`, from corners and normals there."""
    p, q, one, other = x[:, FIRST], x[:, SECOND], normals[:, FIRST], normals[:, SECOND]
    both = one + other
    turn = ((other - one) * (q - p)).sum(axis=2) / (both**2).sum(axis=2)
    return np.asarray(turn[..., None] * both)


def _check_arrays(surface: Any) -> tuple[Floats, Longs]:
    """Return points (n, 3) and triangles (m, 3), or raise a ValueError."""
    wanted = "give the path of an STL file, or points (n, 3) and triangles (m, 3)"
    if not isinstance(surface, list | tuple) or len(surface) != 2:
        raise ValueError(f"surface is {surface!r}: {wanted}")
    rule = array((None, 3), remedy=wanted, holds=len)
    points = check("surface: points", surface[0], rule)
    n = len(points)
    numbers = f"give rows of three numbers of points, 0 to {n - 1}, with a corner at each"
    rule = array((None, 3), remedy=numbers, holds=lambda k: len(k) and np.isin(k, range(n)).all())
    return points, check("surface: triangles", surface[1], rule).astype(np.int64)

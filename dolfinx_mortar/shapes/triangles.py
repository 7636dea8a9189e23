# SPDX-License-Identifier: MIT
r"""Tools of any form, given by triangles: files of CAD programs, or arrays.

Each triangle with corners p_i and smooth normals n_i there is curved: the middle of the edge from
p_i to p_j is moved by

    m = (n_i + n_j) (n_j - n_i).(p_j - p_i) / (4 |n_i + n_j|^2),

and the edge is a parabola. Where it bends to one side, as on a sphere, it is across n_i and n_j,
and the surface that of T. Nagata, Simple local interpolation of surfaces using normal vectors
(2005); edges that would bend to both sides stay straight. Neighbours have the same parabola, so the
surface has no gaps. Creases stay straight, faces without a smooth edge flat. phi is the distance
from this surface, with the normal and the curvature of the nearest point.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from dolfinx_mortar.arguments import FLAG, array, check
from dolfinx_mortar.arrays import HALF_OF_DIGITS, Floats, Longs
from dolfinx_mortar.shapes.nearest import EDGE, FACE, POINT, create_tree, find_nearest
from dolfinx_mortar.shapes.shape import CREASE, Distance, Shape
from dolfinx_mortar.shapes.stl import read_stl
from dolfinx_mortar.shapes.triangulation import (
    FIRST,
    SECOND,
    Triangulation,
    create_triangulation,
)


class Triangles(Shape):
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
        ValueError: for files that cannot be read or are no STL, arrays of other shapes, numbers
            that are not finite, corners that are no points, triangles without area, holes
            (without ``rim``), triangles turned against their neighbours, edges of more than two,
            a body turned inside out, and a crease that is no such angle.
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
        self._offsets = _bulges(x, normals) * smooth[..., None] * (self.crease > 0.0)
        self._tree = create_tree(x, self._offsets)
        self._edge_normals = self.triangulation.edge_normals()
        self._point_normals = self.triangulation.point_normals()

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
        corners = self.triangulation.corners
        found = find_nearest(np.ascontiguousarray(x), corners, self._offsets, *self._tree)
        nearest, where, at = found
        n = len(x)
        value, gradient, hessian = np.zeros(n), np.zeros((n, 3)), np.zeros((n, 3, 3))
        for mine, part in (
            (where == FACE, self._from_faces),
            ((where >= EDGE) & (where < POINT), self._from_edges),
            (where >= POINT, self._from_points),
        ):
            if mine.any():
                parts = part(x[mine], nearest[mine], where[mine], at[mine])
                value[mine], gradient[mine], hessian[mine] = parts
        return Distance(value, gradient, hessian)

    def _from_faces(
        self, x: Floats, near: Longs, where: Longs, at: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Return the distances of points (n, 3) from triangles, where these are nearest inside.

        With tangents J, first and second fundamental forms G and B, and F = G - phi B, the
        curvature is H = -J G^-1 B F^-1 J^T.
        """
        p, m = self.triangulation.corners[near], self._offsets[near]
        s, t = at[:, :1], at[:, 1:]
        o = 1.0 - s - t
        foot = o * p[:, 0] + s * p[:, 1] + t * p[:, 2]
        foot = foot + 4.0 * (o * s * m[:, 0] + s * t * m[:, 1] + t * o * m[:, 2])
        js = p[:, 1] - p[:, 0] + 4.0 * ((o - s) * m[:, 0] + t * (m[:, 1] - m[:, 2]))
        jt = p[:, 2] - p[:, 0] + 4.0 * (s * (m[:, 1] - m[:, 0]) + (o - t) * m[:, 2])
        normal = np.cross(js, jt)
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        phi = ((x - foot) * normal).sum(axis=1)
        J = np.stack([js, jt], axis=2)
        bend = -8.0 * (m * normal[:, None]).sum(axis=2)  # S_ss, S_tt are -8 m
        mixed = 0.5 * (bend[:, 0] - bend[:, 1] + bend[:, 2])
        B = np.stack([bend[:, 0], mixed, mixed, bend[:, 2]], axis=1).reshape(-1, 2, 2)
        Jt = np.swapaxes(J, 1, 2)
        G = Jt @ J
        F = G - phi[:, None, None] * B
        hessian = -J @ np.linalg.solve(G, B @ np.linalg.solve(F, Jt))
        return phi, np.asarray(normal), np.asarray(hessian)

    def _from_edges(
        self, x: Floats, near: Longs, where: Longs, at: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Return the distances of points (n, 3) from edges: across them the curvature is 1 / r."""
        k = where - EDGE
        corners, m = self.triangulation.corners[near], self._offsets[near, k]
        every = np.arange(len(near))
        p, q, t = corners[every, FIRST[k]], corners[every, SECOND[k]], at[:, :1]
        offset = x - p - t * (q - p) - 4.0 * t * (1.0 - t) * m
        slope = q - p + 4.0 * (1.0 - 2.0 * t) * m
        curved = (slope**2).sum(axis=1) + 8.0 * (offset * m).sum(axis=1)
        along = slope[:, :, None] * slope[:, None] / curved[:, None, None]
        return self._around(offset, self._edge_normals[near, k], along)

    def _from_points(
        self, x: Floats, near: Longs, where: Longs, at: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Return the distances of points (n, 3) from corners."""
        k = where - POINT
        offset = x - self.triangulation.corners[near, k]
        return self._around(offset, self._point_normals[near, k], np.zeros((len(x), 3, 3)))

    def _around(
        self, offset: Floats, normal: Floats, along: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Return the distances by offsets (n, 3) from edges or corners.

        Args:
            offset: from the nearest point.
            normal: of any length, there.
            along: (n, 3, 3), how far the nearest point moves with x.
        """
        r = np.linalg.norm(offset, axis=1)
        normal = normal / np.linalg.norm(normal, axis=1)[:, None]
        sign = np.where((offset * normal).sum(axis=1) < 0.0, -1.0, 1.0)
        size = np.ptp(self.triangulation.points, axis=0).max()
        apart = r > HALF_OF_DIGITS * size  # else offsets have no direction
        divisor = np.where(apart, sign * r, 1.0)
        gradient = np.where(apart[:, None], offset / divisor[:, None], normal)
        across = np.eye(3) - gradient[:, :, None] * gradient[:, None] - along
        hessian = np.where(apart[:, None, None], across / divisor[:, None, None], 0.0)
        return sign * r, gradient, hessian


def _bulges(x: Floats, normals: Floats) -> Floats:
    """Return the offsets (m, 3, 3) of the middles of edges, from corners and normals there."""
    p, q, one, other = x[:, FIRST], x[:, SECOND], normals[:, FIRST], normals[:, SECOND]
    both = one + other
    turn = ((other - one) * (q - p)).sum(axis=2) / (4.0 * (both**2).sum(axis=2))
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

# SPDX-License-Identifier: MIT
"""A surface of triangles: neighbours, checks of a closed body, normals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from dolfinx_mortar.arrays import HALF_OF_DIGITS, Bools, Floats, Longs
from dolfinx_mortar.shapes.shape import refuse

FIRST, SECOND = np.array([0, 1, 2]), np.array([1, 2, 0])
"""Corners of the edges of a triangle."""


@dataclass(frozen=True)
class Triangulation:
    """Triangles with common corners and edges."""

    points: Floats  # (n, 3)
    triangles: Longs  # (m, 3) counterclockwise as seen from outside
    normals: Floats  # (m, 3) unit normals
    beyond: Longs  # (m, 3) triangle across each edge, -1 at a rim

    @property
    def corners(self) -> Floats:
        """Corners of the triangles (m, 3, 3)."""
        return self.points[self.triangles]

    def edge_normals(self) -> Floats:
        """Sum of the normals at each edge (m, 3, 3)."""
        other = np.where((self.beyond >= 0)[..., None], self.normals[self.beyond], 0.0)
        return np.asarray(self.normals[:, None] + other)

    def point_normals(self) -> Floats:
        """Angle-weighted sum of the normals around each corner (m, 3, 3).

        Its product with the offset from the nearest point is positive outside. J. A. Baerentzen, H.
        Aanaes: Signed distance computation using the angle weighted pseudonormal (2005).
        """
        one, other = self._arms()
        cosine = (one * other).sum(axis=2) / (_length(one) * _length(other))
        angles = np.arccos(np.clip(cosine, -1.0, 1.0))
        return self._summed(self.triangles.ravel(), angles[..., None] * self.normals[:, None])

    def smooth_normals(self, crease: float) -> tuple[Floats, Bools]:
        """Unit normals at corners (m, 3, 3), and the mask (m, 3) of edges without crease.

        Averages over triangles connected without a crease (an angle of normals above ``crease``
        degrees), with weights exact for spheres. N. Max: Weights for computing vertex normals from
        facet normals (1999).
        """
        turn = (self.normals[:, None] * self.normals[self.beyond]).sum(axis=2)
        smooth = (self.beyond >= 0) & (turn >= np.cos(np.radians(crease)) - HALF_OF_DIGITS)
        m = len(self.triangles)
        mine, edge = np.nonzero(smooth)
        other = self.beyond[mine, edge]
        pairs = []
        for corner in (FIRST[edge], SECOND[edge]):
            same = self.triangles[other] == self.triangles[mine, corner][:, None]
            pairs.append((3 * mine + corner, 3 * other + np.argmax(same, axis=1)))
        rows, columns = (np.concatenate(part) for part in zip(*pairs, strict=True))
        graph = scipy.sparse.coo_array((np.ones(len(rows)), (rows, columns)), shape=(3 * m, 3 * m))
        _, group = scipy.sparse.csgraph.connected_components(graph, directed=False)
        one, other_arm = self._arms()
        weights = (_length(one) * _length(other_arm)) ** 2
        found = self._summed(group, np.cross(one, other_arm) / weights[..., None])
        return found / _length(found)[..., None], smooth | (self.beyond < 0)

    def _arms(self) -> tuple[Floats, Floats]:
        x = self.corners
        return x[:, [1, 2, 0]] - x, x[:, [2, 0, 1]] - x

    def _summed(self, group: Longs, parts: Floats) -> Floats:
        """Sums (m, 3, 3) of parts at corners (m, 3, 3) over groups (3 m,)."""
        total = np.zeros((int(group.max()) + 1, 3))
        np.add.at(total, group, parts.reshape(-1, 3))
        return np.asarray(total[group].reshape(-1, 3, 3))


def create_triangulation(points: Floats, triangles: Longs, *, rim: bool) -> Triangulation:
    """Surface of points (n, 3) and triangles (m, 3), perhaps with a rim.

    Raises:
        ValueError: for triangles without area or turned against neighbours, edges of more than two,
            holes, and bodies turned inside out.
    """
    x = points[triangles]
    across = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    sides = _length(x - x[:, [1, 2, 0]])
    flat = _length(across) <= HALF_OF_DIGITS * sides.max(axis=1) ** 2
    refuse(
        "surface has",
        x.mean(axis=1),
        flat,
        "triangles without area",
        "remove them, and let their neighbours have common corners",
    )
    beyond = _find_neighbours(x, triangles, rim)
    volume = float((x[:, 0] * np.cross(x[:, 1], x[:, 2])).sum())
    if (beyond >= 0).all() and volume < 0.0:
        raise ValueError(
            "surface is turned inside out, as normals of all its triangles point into it: turn "
            "them round, triangles[:, ::-1], or for a body in a cavity give the Complement of that"
        )
    return Triangulation(points, triangles, across / _length(across)[:, None], beyond)


def _find_neighbours(x: Floats, triangles: Longs, rim: bool) -> Longs:
    """Triangle beyond each edge (m, 3), -1 at a rim; ValueErrors of `create_triangulation`."""
    ends = np.stack([triangles[:, FIRST], triangles[:, SECOND]], axis=2).reshape(-1, 2)
    _, place, count = np.unique(
        np.sort(ends, axis=1), axis=0, return_inverse=True, return_counts=True
    )
    place = place.ravel()
    uses = count[place].reshape(-1, 3)
    refuse(
        "surface has",
        x.mean(axis=1),
        np.asarray((uses > 2).any(axis=1)),
        "triangles with an edge of three or more of them",
        "no surface does that; leave out what is inside the tool",
    )
    order = np.argsort(place, kind="stable")
    starts = np.cumsum(count) - count
    both = count == 2
    one, other = order[starts[both]], order[starts[both] + 1]
    beyond = np.full(len(ends), -1, dtype=np.int64)
    beyond[one], beyond[other] = other // 3, one // 3
    against = ends[one, 0] == ends[other, 0]
    turned = np.bincount(np.append(one[against], other[against]) // 3, minlength=len(x))
    refuse(
        "surface has",
        x.mean(axis=1),
        np.asarray(turned > (turned > 1).any()),  # of most, if any, edges
        "triangles that are turned against their neighbours",
        "order the corners of all counterclockwise as seen from outside of the tool",
    )
    found = beyond.reshape(-1, 3)
    if not rim:
        refuse(
            "surface has",
            x.mean(axis=1),
            np.asarray((found < 0).any(axis=1)),
            "triangles at a hole",
            "close it; or give rim=True for a surface that ends beside the body",
        )
    return found


def _length(vectors: npt.NDArray[np.floating[Any]]) -> Floats:
    return np.asarray(np.linalg.norm(vectors, axis=-1))

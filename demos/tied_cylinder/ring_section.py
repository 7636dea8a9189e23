# SPDX-License-Identifier: MIT
"""The mesh of the demo: a quarter of one ring, or of two rings with non-matching meshes."""

from __future__ import annotations

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np

from dolfinx_mortar.common.arrays import HALF_OF_DIGITS, Bools, Floats
from dolfinx_mortar.meshing.two_bodies import Arrays, TaggedMesh, all_at, two_bodies


def ring_section(
    comm: MPI.Intracomm,
    radii: Sequence[float],
    cells: Sequence[tuple[int, int]],
    cell: str = "quadrilateral",
) -> TaggedMesh:
    """Mesh the quarter x, y >= 0 of one ring or of two around each other (collective).

    Nodes lie on circles; two rings have no node in common. Bodies: "inner" (or only) and "outer".
    Sides: "bore", "outside", "around_inner" and "within_outer" where the rings meet, "on_y" on
    x = 0, "on_x" on y = 0.

    Args:
        comm: Communicator of the mesh.
        radii: Radii from the bore to the outside, two for one ring, three for two.
        cells: For each ring the numbers of cells across and along it.
        cell: "triangle" or "quadrilateral".
    """

    def create() -> tuple[Arrays, Arrays]:
        made = [_ring(radii[k], radii[k + 1], n, cell) for k, n in enumerate(cells)]
        nothing = np.empty((0, 2)), np.empty((0, made[0][1].shape[1]), dtype=np.int64)
        return made[0], (made[1] if len(made) > 1 else nothing)

    def sides(inner: Bools, x: Floats) -> dict[str, Bools]:
        def on(values: Floats, at: float) -> Bools:
            return all_at(values, at, HALF_OF_DIGITS * radii[-1])

        radius: Floats = np.linalg.norm(x, axis=2)
        between = on(radius, radii[1]) if len(radii) == 3 else np.zeros_like(inner)
        return {
            "bore": on(radius, radii[0]),
            "outside": on(radius, radii[-1]),
            "around_inner": between & inner,
            "within_outer": between & ~inner,
            "on_y": on(x[:, :, 0], 0.0),
            "on_x": on(x[:, :, 1], 0.0),
        }

    return two_bodies(comm, create, cell, "rings", ("inner", "outer"), sides)


def _ring(inner: float, outer: float, cells: tuple[int, int], cell: str) -> Arrays:
    """Mesh the quarter of one ring."""
    across, along = cells
    r = np.linspace(inner, outer, across + 1)
    angle = np.pi / 2 * np.linspace(0.0, 1.0, along + 1)
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    direction[-1, 0] = 0.0
    x = (direction[:, None] * r[:, None]).reshape(-1, 2)
    first = (np.arange(along)[:, None] * (across + 1) + np.arange(across)).ravel()
    quads = first[:, None] + np.array([0, 1, across + 1, across + 2])
    if cell == "quadrilateral":
        return x, quads
    return x, np.concatenate([quads[:, [0, 1, 3]], quads[:, [0, 3, 2]]])

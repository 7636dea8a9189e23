# SPDX-License-Identifier: MIT
"""The mesh of the demo: a hub on a shaft, their half section, or a quarter in 3D."""

from __future__ import annotations

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np

from dolfinx_mortar.common.arrays import HALF_OF_DIGITS, Bools, Floats
from dolfinx_mortar.meshing.two_bodies import Arrays, TaggedMesh, all_at, two_bodies


def tubes(
    comm: MPI.Intracomm,
    radii: tuple[float, float, float],
    length: float,
    cells: Sequence[Sequence[int]],
) -> TaggedMesh:
    """Mesh two coaxial tubes of equal length, non-matching at their common surface (collective).

    The section has coordinates (r, z) and quadrilaterals, the quarter x, y >= 0 in 3D coordinates
    (x, y, z) and hexahedra; z runs from 0 to the length. Nodes lie on circles; the tubes have no
    node in common. Bodies: "inner", "outer". Sides: "bore", "outside", "around_inner" and
    "within_outer" where the tubes meet, in 3D "on_y" on x = 0 and "on_x" on y = 0, and the ends at
    z = 0 and at the length, "inner_start", "inner_end", "outer_start" and "outer_end".

    Args:
        comm: Communicator of the mesh.
        radii: Radii of the bore, of the common surface, and of the outside.
        length: Length of both tubes.
        cells: For each tube the numbers of cells across the wall and along the axis; with a third
            number, around the quarter, the mesh is in 3D.
    """
    space = len(cells[0]) == 3

    def create() -> tuple[Arrays, Arrays]:
        return (
            _tube(radii[0], radii[1], length, cells[0]),
            _tube(radii[1], radii[2], length, cells[1]),
        )

    def sides(inner: Bools, x: Floats) -> dict[str, Bools]:
        def on(values: Floats, at: float, size: float) -> Bools:
            return all_at(values, at, HALF_OF_DIGITS * size)

        a, c, b = radii
        radius: Floats = np.linalg.norm(x[:, :, :2], axis=2) if space else x[:, :, 0]
        z, none = x[:, :, 2 if space else 1], np.zeros_like(inner)
        start, end = on(z, 0.0, length), on(z, length, length)
        return {
            "bore": on(radius, a, b),
            "outside": on(radius, b, b),
            "around_inner": on(radius, c, b) & inner,
            "within_outer": on(radius, c, b) & ~inner,
            "on_y": on(x[:, :, 0], 0.0, b) if space else none,
            "on_x": on(x[:, :, 1], 0.0, b) if space else none,
            "inner_start": start & inner,
            "inner_end": end & inner,
            "outer_start": start & ~inner,
            "outer_end": end & ~inner,
        }

    cell = "hexahedron" if space else "quadrilateral"
    return two_bodies(comm, create, cell, "tubes", ("inner", "outer"), sides)


def _tube(inner: float, outer: float, length: float, cells: Sequence[int]) -> Arrays:
    """Mesh one tube: nodes (n, d), cells (m, 2^d); the last direction runs fastest."""
    ends = ((inner, outer), (0.0, length), (0.0, 1.0))
    lines = [np.linspace(*ends[k], count + 1) for k, count in enumerate(cells)]
    grid: list[Floats] = [a.ravel() for a in np.meshgrid(*lines, indexing="ij")]
    strides = [int(np.prod([count + 1 for count in cells[k + 1 :]])) for k in range(len(cells))]
    corner = np.array([0])
    for stride in strides:
        corner = (corner[:, None] + np.array([0, stride])).ravel()
    lattice = np.meshgrid(*[np.arange(count) for count in cells], indexing="ij")
    first = sum(stride * a.ravel() for stride, a in zip(strides, lattice, strict=True))
    quads = np.asarray(first)[:, None] + corner
    if len(cells) == 2:
        return np.stack(grid, axis=1), quads.astype(np.int64)
    r, z, turn = grid
    # nodes on the symmetry planes are there without round-off
    x = np.where(turn == 1.0, 0.0, r * np.cos(np.pi / 2 * turn))
    return np.stack([x, r * np.sin(np.pi / 2 * turn), z], axis=1), quads.astype(np.int64)

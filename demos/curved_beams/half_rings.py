# SPDX-License-Identifier: MIT
"""The mesh of the demo: a standing half ring, and a hanging one that touches it."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np

from dolfinx_mortar.common.arrays import Bools, Floats
from dolfinx_mortar.meshing.two_bodies import Arrays, TaggedMesh, all_at, two_bodies

LOWER = (10.0, 12.0)  # mm, radii of the half ring that stands on y = 0, about (12, 0)
UPPER = (8.0, 10.0)  # mm, of the one that hangs from y = 17
HEIGHT = 17.0  # mm
LEFT = LOWER[1] - np.sqrt((LOWER[1] + UPPER[1]) ** 2 - HEIGHT**2)  # x of its centre: they touch


def half_rings(comm: MPI.Intracomm, along: int = 50, across: int = 5) -> TaggedMesh:
    """Mesh both half rings with quadrilaterals (collective).

    Bodies: "lower", "upper". Sides: "lower_arc" and "upper_arc", which touch, "feet" of the lower
    one and "ends" of the upper one.

    Args:
        comm: Communicator of the mesh.
        along: Cells along each half ring.
        across: Cells across.
    """

    def create() -> tuple[Arrays, Arrays]:
        lower = _half_ring(LOWER, (LOWER[1], 0.0), np.pi, along, across)
        return lower, _half_ring(UPPER, (LEFT, HEIGHT), 2 * np.pi, along, across)

    def sides(of_lower: Bools, x: Floats) -> dict[str, Bools]:
        def outside(centre: tuple[float, float], radius: float) -> Bools:
            return all_at(np.linalg.norm(x[:, :, :2] - centre, axis=2), radius, 1e-9)

        return {
            "feet": of_lower & all_at(x[:, :, 1], 0.0, 1e-9),
            "lower_arc": of_lower & outside((LOWER[1], 0.0), LOWER[1]),
            "ends": ~of_lower & all_at(x[:, :, 1], HEIGHT, 1e-9),
            "upper_arc": ~of_lower & outside((LEFT, HEIGHT), UPPER[1]),
        }

    return two_bodies(comm, create, "quadrilateral", "beams", ("lower", "upper"), sides)


def _half_ring(
    radii: tuple[float, float], centre: tuple[float, float], end: float, along: int, across: int
) -> Arrays:
    """Return nodes and cells of a half ring whose angles go up to an end."""
    angle, r = np.meshgrid(
        np.linspace(end - np.pi, end, along + 1), np.linspace(*radii, across + 1)
    )
    x = np.stack([centre[0] + r * np.cos(angle), centre[1] + r * np.sin(angle)], axis=2)
    y = x[:, :, 1]
    y[np.abs(y - centre[1]) < 1e-12 * radii[1]] = centre[1]
    first = (np.arange(across)[:, None] * (along + 1) + np.arange(along)).ravel()
    # outwards first, then around: right-handed
    cells = first[:, None] + np.array([0, along + 1, 1, along + 2])
    return x.reshape(-1, 2), cells.astype(np.int64)

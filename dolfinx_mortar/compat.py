# SPDX-License-Identifier: MIT
"""The dolfinx calls that changed between 0.9 and 0.11: one function per changed API."""

from __future__ import annotations

from typing import Any

import numpy as np

from dolfinx import fem, mesh


def interpolation_points(V: fem.FunctionSpace) -> np.ndarray:
    """Return the reference points (q, tdim) of V's element (a method until 0.9)."""
    points = V.element.interpolation_points
    return np.asarray(points() if callable(points) else points)


def on_same_mesh(tags: mesh.MeshTags, domain: mesh.Mesh) -> bool:
    """Tell whether the tags were made for this very mesh (the topology may be wrapped or not)."""

    def unwrapped(topology: Any) -> Any:
        return getattr(topology, "_cpp_object", topology)

    return unwrapped(tags.topology) is unwrapped(domain.topology)


def cell_partitioner(ghosts: mesh.GhostMode) -> Any:
    """Return the default partitioner with such ghosts (0.11 asks for the cells per facet)."""
    try:
        return mesh.create_cell_partitioner(ghosts, 2)
    except TypeError:
        return mesh.create_cell_partitioner(ghosts)

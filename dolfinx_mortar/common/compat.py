# SPDX-License-Identifier: MIT
"""Dolfinx calls that changed between 0.9 and 0.11: one function per call."""

from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinx import fem, mesh


def interpolation_points(V: fem.FunctionSpace) -> np.ndarray:
    """Reference points (q, tdim) of V's element (a method until 0.9)."""
    points = V.element.interpolation_points
    return np.asarray(points() if callable(points) else points)


def on_same_mesh(tags: mesh.MeshTags | mesh.Mesh, domain: mesh.Mesh) -> bool:
    """Whether tags, or a mesh, are of this very mesh (topologies may be wrapped)."""

    def unwrapped(topology: Any) -> Any:
        return getattr(topology, "_cpp_object", topology)

    return unwrapped(tags.topology) is unwrapped(domain.topology)


def cell_degree(domain: mesh.Mesh) -> int:
    """Degree of the cells' geometry (0.11 has a list of maps)."""
    geometry: Any = domain.geometry
    maps = getattr(geometry, "cmaps", None)
    return int((maps[0] if maps is not None else geometry.cmap).degree)


def cell_nodes(domain: mesh.Mesh) -> npt.NDArray[np.int32]:
    """Nodes (cells, n) of the cells' geometry (0.11 has a list)."""
    geometry: Any = domain.geometry
    lists = getattr(geometry, "dofmaps", None)
    return np.asarray(lists[0] if isinstance(lists, list | tuple) else geometry.dofmap)


def mesh_from_gmsh(
    model: Any, comm: Any, dim: int
) -> tuple[mesh.Mesh, mesh.MeshTags, mesh.MeshTags]:
    """Mesh, cell tags and facet tags of the Gmsh model on rank 0; collective."""
    try:
        from dolfinx.io.gmsh import model_to_mesh
    except ImportError:
        from dolfinx.io.gmshio import model_to_mesh
    domain, *tags = model_to_mesh(model, comm, 0, gdim=dim)[:3]
    for codim, found in enumerate(tags):
        if found is None:
            none = np.empty(0, dtype=np.int32)
            tags[codim] = mesh.meshtags(domain, dim - codim, none, none)
    return domain, tags[0], tags[1]


def cell_kinds(domain: mesh.Mesh) -> list[str]:
    """Names of the kinds of cells in a mesh, one unless mixed."""
    topology: Any = getattr(domain.topology, "_cpp_object", domain.topology)
    kinds = getattr(topology, "entity_types", None) or getattr(topology, "cell_types", None)
    return sorted(kind.name for kind in kinds[-1]) if kinds else [domain.topology.cell_name()]

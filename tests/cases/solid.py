# SPDX-License-Identifier: MIT
"""Small solids for the tests: boxes of any cell, waves as displacements, sums over ranks."""

from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx import fem, mesh
from dolfinx_mortar.materials import VonMises
from dolfinx_mortar.solid.solid import Solid

COMM = MPI.COMM_WORLD
STEEL = VonMises(E=206_900.0, nu=0.29, Y=450 * np.sqrt(2 / 3), a=10_000.0)
CELLS = ("triangle", "quadrilateral", "tetrahedron", "hexahedron")


def create_domain(cell: str, n: int = 4) -> mesh.Mesh:
    """Create a box, not a cube, so that no direction is like another."""
    cell_type = mesh.CellType[cell]
    if cell in ("triangle", "quadrilateral"):
        return mesh.create_rectangle(COMM, [(0, 0), (1.0, 2.0)], (n, n + 1), cell_type)
    return mesh.create_box(COMM, [(0, 0, 0), (1.0, 2.0, 1.5)], (n, n, n - 1), cell_type)


def create_displacement(domain: mesh.Mesh) -> fem.Function:
    """Create a displacement in the degree 1 vector space."""
    return fem.Function(fem.functionspace(domain, ("Lagrange", 1, (domain.geometry.dim,))))


def wave(size: float, phase: float = 0.0) -> Any:
    """Return a smooth field, the same on any number of ranks."""

    def values(x: np.ndarray) -> np.ndarray:
        parts = [np.sin((3 + i) * x[0] + (2 - i) * x[1] + x[2] + i + phase) for i in range(3)]
        return size * np.stack(parts)

    return values


def set_wave(f: fem.Function, size: float, phase: float = 0.0) -> None:
    """Interpolate a wave in as many components as f has."""
    d = f.function_space.mesh.geometry.dim
    f.interpolate(lambda x: wave(size, phase)(x)[:d])


def create_loaded(cell: str, n: int = 4) -> Solid:
    """Return a solid with some committed plastic strain, partly yielding at another u."""
    solid = Solid(create_displacement(create_domain(cell, n)), STEEL)
    set_wave(solid.u, 1.0e-3)
    solid.evaluate()
    solid.commit()
    set_wave(solid.u, 1.0e-3, 0.5)
    return solid


def residual(solid: Solid) -> np.ndarray:
    """Return the owned internal forces."""
    r = solid.u.x.petsc_vec.duplicate()
    solid.assemble_residual(r)
    return r.array.copy()


def total(values: np.ndarray) -> float:
    """Sum over all ranks."""
    return COMM.allreduce(float(np.sum(values)), op=MPI.SUM)


def create_tags(domain: mesh.Mesh, values: Any) -> mesh.MeshTags:
    """Tag all local cells by a function of the midpoints (cells, 3) -> int32."""
    cells = domain.topology.index_map(domain.topology.dim)
    every = np.arange(cells.size_local + cells.num_ghosts, dtype=np.int32)
    midpoints = mesh.compute_midpoints(domain, domain.topology.dim, every)
    return mesh.meshtags(domain, domain.topology.dim, every, values(midpoints).astype(np.int32))

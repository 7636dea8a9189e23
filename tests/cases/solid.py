# SPDX-License-Identifier: MIT
"""Small solids for the tests: boxes of any cell, waves as displacements, sums over ranks."""

from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx import default_scalar_type, fem, mesh
from dolfinx_mortar import ContactProblem
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


def create_displacement(domain: mesh.Mesh, degree: int = 1) -> fem.Function:
    return fem.Function(fem.functionspace(domain, ("Lagrange", degree, (domain.geometry.dim,))))


def solid_on(domain: mesh.Mesh, law: Any, *tags: Any, degree: int = 1, **options: Any) -> Solid:
    return Solid(create_displacement(domain, degree), law, *tags, **options)


def rectangle(ends: Any, cells: Any, cell: str | None = None) -> mesh.Mesh:
    kind = mesh.CellType[cell or ("quadrilateral", "hexahedron")[len(cells) - 2]]
    create = mesh.create_rectangle if len(cells) == 2 else mesh.create_box
    return create(COMM, ends, cells, kind)


def plane(axis: int, at: float = 0.0) -> Any:
    """Return whether points have x[axis] = at."""
    return lambda x: np.isclose(x[axis], at, atol=1e-9)


def hold(V: fem.FunctionSpace, where: Any, i: Any = None, value: Any = 0.0, d: Any = None) -> Any:
    """Prescribe u, or its component i, on facets, given by number or by a function of x.

    Or on entities of another dimension d.
    """
    W, d = V if i is None else V.sub(i), V.mesh.topology.dim - 1 if d is None else d
    if callable(where):
        where = mesh.locate_entities_boundary(V.mesh, d, where)
    dofs = fem.locate_dofs_topological(W, d, where)
    if isinstance(value, fem.Function):
        return fem.dirichletbc(value, dofs)
    if not isinstance(value, fem.Constant):
        shape = () if i is not None else V.mesh.geometry.dim
        value = fem.Constant(V.mesh, np.array(np.broadcast_to(value, shape), default_scalar_type))
    return fem.dirichletbc(value, dofs, W)


def rollers(V: fem.FunctionSpace, axes: Any = None, ends: Any = (0.0,)) -> list[Any]:
    """Return the conditions u_i = 0 at x[i] = 0, or other ends, for axes i."""
    axes = range(V.mesh.geometry.dim) if axes is None else axes
    return [hold(V, plane(i, end), i) for i in axes for end in ends]


def tag_facets(domain: mesh.Mesh, *places: Any) -> mesh.MeshTags:
    """Tag facets of the boundary by 1, 2, .. for each place, a function of x."""
    d = domain.topology.dim - 1
    found = [mesh.locate_entities_boundary(domain, d, where) for where in places]
    values = np.repeat(np.arange(1, len(places) + 1, dtype=np.int32), [len(f) for f in found])
    facets = np.concatenate(found)
    order = np.argsort(facets)
    return mesh.meshtags(domain, d, facets[order], values[order])


def stand(domain: mesh.Mesh, law: Any, supports: Any = None, *more: Any, **options: Any) -> Any:
    """Return the problem of a body.

    Supports are a function of the space, then interfaces and a function of the solid that returns
    terms may follow; options are `degree`, `given` to the problem, and those of the solid.
    """
    given = options.pop("given", {})
    solid = solid_on(domain, law, **options)
    bcs = supports(solid.V) if supports else []
    interfaces = more[0] if more else []
    terms = more[1](solid) if len(more) > 1 else []
    return ContactProblem(solid, interfaces, bcs=bcs, terms=terms, **given)


def wave(size: float, phase: float = 0.0) -> Any:
    """Return a smooth field, the same on any number of ranks."""

    def values(x: np.ndarray) -> np.ndarray:
        parts = [np.sin((3 + i) * x[0] + (2 - i) * x[1] + x[2] + i + phase) for i in range(3)]
        return size * np.stack(parts)

    return values


def set_wave(f: fem.Function, size: float, phase: float = 0.0) -> None:
    d = f.function_space.mesh.geometry.dim
    f.interpolate(lambda x: wave(size, phase)(x)[:d])


def create_loaded(cell: str, n: int = 4) -> Solid:
    """Return a solid with some committed plastic strain, partly yielding at another u."""
    solid = solid_on(create_domain(cell, n), STEEL)
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
    return COMM.allreduce(float(np.sum(values)), op=MPI.SUM)


def create_tags(domain: mesh.Mesh, values: Any) -> mesh.MeshTags:
    """Tag all local cells by a function of the midpoints (cells, 3) -> int32."""
    cells = domain.topology.index_map(domain.topology.dim)
    every = np.arange(cells.size_local + cells.num_ghosts, dtype=np.int32)
    midpoints = mesh.compute_midpoints(domain, domain.topology.dim, every)
    return mesh.meshtags(domain, domain.topology.dim, every, values(midpoints).astype(np.int32))


def largest(values: np.ndarray) -> float:
    return COMM.allreduce(float(np.abs(values).max(initial=0.0)), op=MPI.MAX)


def errors_of_derivatives(
    u: fem.Function, energy: Any, forces: Any, K: Any, v: fem.Function, h: float
) -> tuple[float, float]:
    """Return errors of forces and of K v against sixth-order differences along v, relative."""
    start, F, Kv = u.x.array.copy(), forces(), (K * v.x.petsc_vec).array.copy()
    slope, change = 0.0, np.zeros(len(F))
    for n, weight in {1: 3 / 4, 2: -3 / 20, 3: 1 / 60}.items():
        for sign in (1, -1):
            u.x.array[:] = start + sign * n * h * v.x.array
            change += sign * weight / h * forces()
            slope += sign * weight / h * total(0.0 if energy() is None else energy())
    u.x.array[:] = start
    work = total(F * v.x.array[: len(F)]) if energy() is not None else 0.0
    return abs(slope - work) / (abs(work) or 1.0), largest(change - Kv) / largest(Kv)

# SPDX-License-Identifier: MIT
"""Rings that fit into each other, for the tests of curved sides: shrink fits, and pins in holes."""

from dataclasses import dataclass
from types import SimpleNamespace

from mpi4py import MPI

import numpy as np

import dolfinx_mortar as dm
import ufl
from dolfinx import fem, mesh
from dolfinx_mortar.meshing.two_bodies import distribute
from tests.cases.rings import shrink_fit_pressure
from tests.cases.two_bodies import create_problem, held

COMM = MPI.COMM_WORLD


def ring_cells(n, layers):
    """Return quadrilaterals between layers + 1 closed lines of n nodes."""
    i, j = (a.ravel() for a in np.meshgrid(np.arange(layers), np.arange(n), indexing="ij"))
    k = (j + 1) % n
    return np.column_stack([i * n + j, (i + 1) * n + j, i * n + k, (i + 1) * n + k])


def create_ring(inner, outer, angles, layers=2, order=1):
    """Return nodes and quadrilaterals, of degree `order`, of a ring with vertices at angles."""
    if order > 1:
        turns = np.append(angles, angles[0] + 2 * np.pi)
        angles = np.ravel([turns[:-1], (turns[:-1] + turns[1:]) / 2], order="F")
    radii = np.linspace(inner, outer, order * layers + 1)
    r, angle = (a.ravel() for a in np.meshgrid(radii, angles, indexing="ij"))
    n = len(angles)
    if order > 1:
        i, j = (a.ravel() for a in np.meshgrid(2 * np.arange(layers), 2 * np.arange(n // 2)))
        out, along = np.array([[0, 2, 0, 2, 1, 0, 2, 1, 1], [0, 0, 2, 2, 0, 1, 1, 2, 1]])
        cells = (i[:, None] + out) * n + (j[:, None] + along) % n
        return np.column_stack([r * np.cos(angle), r * np.sin(angle)]), cells.astype(np.int64)
    return np.column_stack([r * np.cos(angle), r * np.sin(angle)]), ring_cells(n, layers)


def rings(comm, inner, outer, counts, layers, order=1):
    """Return the mesh of two rings, its cells of degree `order`; tags 1 to 4 of its circles."""
    parts = [
        create_ring(*radii, 2 * np.pi * np.arange(n) / n, layers=k, order=order)
        for radii, n, k in zip((inner, outer), counts, layers, strict=True)
    ]
    return nested(comm, parts, order)


def nested(comm, parts, order=1):
    """Return the mesh of two bodies around the origin, nodes and cells each; tags as of rings."""
    domain, size = distribute(comm, lambda: parts, "quadrilateral", order)
    domain.topology.create_connectivity(1, 2)
    facets = mesh.exterior_facet_indices(domain.topology)
    to_cell = domain.topology.connectivity(1, 2)
    cells = np.array([to_cell.links(f)[0] for f in facets], dtype=np.int32)
    x = mesh.compute_midpoints(domain, 1, facets)
    away = np.einsum("mi,mi->m", x, x - mesh.compute_midpoints(domain, 2, cells)) > 0
    first = domain.topology.original_cell_index[cells] < size
    values = np.where(first, 1, 3) + away
    return domain, mesh.meshtags(domain, 1, facets, values.astype(np.int32))


def hold(V, radius):
    """Return conditions that keep a circle from moving as a whole, and nothing else."""
    bcs = []
    for angle, component in ((0.0, 1), (np.pi, 1), (np.pi / 2, 0)):
        at = radius * np.array([np.cos(angle), np.sin(angle)])
        W = V.sub(component)
        dofs = fem.locate_dofs_geometrical(
            (W, W.collapse()[0]), lambda x, at=at: np.linalg.norm(x[:2].T - at, axis=1) < 1e-6
        )
        bcs.append(fem.dirichletbc(fem.Function(W.collapse()[0]), dofs, W))
    return bcs


@dataclass
class Pin:
    """A pin in a hole of radius 10 that touches it at the bottom and is pressed down."""

    problem: dm.ContactProblem
    contact: dm.Contact

    def solve(self):
        """Return the report and the slave nodes."""
        return dm.newton(self.problem), self.contact.gather(self.problem.u)


def create_pin(
    counts, swap, *, clearance=0.1, force=5000.0, comm=COMM, degree=1, order=1, **options
):
    """Create a pin with a clearance, by default of 1 % of the radius."""
    R = 10.0
    domain, tags = rings(comm, (1.0, R - clearance), (R, 25.0), counts, (8, 12), order)
    pin = np.hypot(*domain.geometry.x[:, :2].T) < R - clearance / 2
    domain.geometry.x[pin, 1] -= clearance
    V = fem.functionspace(domain, ("Lagrange", degree, (2,)))
    slave, master = (3, 2) if swap else (2, 3)
    contact = dm.Contact(tags, slave=slave, master=master, **options)
    ds, v = ufl.Measure("ds", domain, subdomain_data=tags), ufl.TestFunction(V)
    length = comm.allreduce(fem.assemble_scalar(fem.form(fem.Constant(domain, 1.0) * ds(1))))
    W = V.sub(0)
    axis = fem.locate_dofs_geometrical(
        (W, W.collapse()[0]), lambda x: (np.abs(x[0]) < 1e-9) & (np.abs(x[1]) < R / 2)
    )
    bcs = [held(V, tags, 4), fem.dirichletbc(fem.Function(W.collapse()[0]), axis, W)]
    loads = -force / length * v[1] * ds(1)
    return Pin(create_problem(V, [contact], bcs, dm.Elastic(200e3, 0.3), loads=loads), contact)


OVERLAP = 0.02
STEELS = ((200e3, 0.3), (100e3, 0.33))  # of the inner and the outer ring


def create_shrink_fit(
    counts,
    swap,
    *,
    overlap=OVERLAP,
    pressure=0.0,
    geometry="updated",
    comm=COMM,
    degree=1,
    order=1,
    shift=(0.0, 0.0),
    **options,
):
    """Create the rings 10 to 20 and 20 to 30, with facets in such numbers; with Lame's pressure."""
    a, b, c = 10.0, 20.0, 30.0
    domain, tags = rings(comm, (a, b + overlap), (b, c), counts, (16, 16), order)
    V = fem.functionspace(domain, ("Lagrange", degree, (2,)))
    limit = b + overlap / 2 + 1e-6
    inside = mesh.locate_entities(domain, 2, lambda x: np.hypot(x[0], x[1]) < limit)
    values = np.full(domain.topology.index_map(2).size_local, 2, dtype=np.int32)
    values[inside[inside < len(values)]] = 1
    cells = mesh.meshtags(domain, 2, np.arange(len(values), dtype=np.int32), values)
    laws = {k + 1: dm.Elastic(*steel) for k, steel in enumerate(STEELS)}
    slave, master = (3, 2) if swap else (2, 3)
    contact = dm.Contact(tags, slave=slave, master=master, **options)
    bcs = [*hold(V, a), *hold(V, c)]
    domain.geometry.x[:, :2] += shift
    loads = None
    if pressure:
        ds, n = ufl.Measure("ds", domain, subdomain_data=tags), ufl.FacetNormal(domain)
        loads = -pressure * ufl.inner(n, ufl.TestFunction(V)) * ds(1)
    problem = create_problem(V, [contact], bcs, laws, cells, loads=loads, geometry=geometry)
    E, nu = STEELS[0]
    widened = overlap + 2 * (1 - nu**2) * pressure * a**2 * b / (E * (b**2 - a**2))
    lame = shrink_fit_pressure(E, nu, (a, b, c), widened, STEELS[1])
    return SimpleNamespace(problem=problem, contact=contact, pressure=lame)

# SPDX-License-Identifier: MIT
"""A quarter of a pin in a lug of the same thickness, in 3D, pressed down by its bore."""

from mpi4py import MPI

import numpy as np

import dolfinx_mortar as dm
from dolfinx import fem, mesh
from dolfinx_mortar.meshing.two_bodies import (
    distribute,
    exterior_facets,
    gmsh_model,
    read_cells,
    set_graded_size,
)

COMM = MPI.COMM_WORLD
BORE, HOLE, OUTSIDE, THICKNESS, CLEARANCE = 3.0, 10.0, 25.0, 8.0, 0.1
PIN = HOLE - CLEARANCE
RADII = {"lug": (HOLE, OUTSIDE), "pin": (BORE, PIN)}


def hexahedra(inner, outer, h):
    """Return half a ring, x >= 0, with cells that grow with the radius."""
    n, layers = int(np.ceil(np.pi * outer / h)), int(np.ceil(THICKNESS / h))
    if inner == HOLE:
        n = int(np.ceil(np.pi * inner / h))
    m = int(np.ceil(n / np.pi * np.log(outer / inner)))
    r = inner * (outer / inner) ** (np.arange(m + 1) / m)
    angle = np.linspace(-np.pi / 2, np.pi / 2, n + 1)
    grid = np.meshgrid(r, angle, np.linspace(0.0, THICKNESS, layers + 1), indexing="ij")
    r, angle, z = (a.ravel() for a in grid)
    number = np.arange(len(r)).reshape(m + 1, n + 1, layers + 1)
    cells = np.stack(
        [number[a : a + m, b : b + n, c : c + layers].ravel() for a, b, c in np.ndindex(2, 2, 2)],
        axis=1,
    )
    return np.column_stack([r * np.cos(angle), r * np.sin(angle), z]), cells


def tetrahedra(inner, outer, h):
    """Return half a ring, x >= 0, coarser away from its lowest point."""
    with gmsh_model() as gmsh:
        occ = gmsh.model.occ
        parts = [(3, occ.addCylinder(0, 0, 0, 0, 0, THICKNESS, r)) for r in (outer, inner)]
        ring, _ = occ.cut(parts[:1], parts[1:])
        box = (3, occ.addBox(0, -2 * outer, -1, 2 * outer, 4 * outer, THICKNESS + 2))
        occ.intersect(ring, [box])
        occ.synchronize()
        near = (0.0, -(inner if inner == HOLE else outer), 0.0)
        points = [tag for _, tag in gmsh.model.getEntities(0)]
        x = np.array([gmsh.model.getValue(0, tag, []) for tag in points])
        origin = points[int(np.linalg.norm(x - near, axis=1).argmin())]
        set_graded_size(gmsh, origin, h, core=HOLE, limit=4.0, beyond=HOLE)
        gmsh.model.mesh.generate(3)
        return read_cells(gmsh, "tetrahedron")


def create_lug(cell, sizes):
    """Return the mesh and the tags: 1 outside, 2 bore, 3 hole, 4 pin, 5 x = 0, 6 z = 0.

    Args:
        cell: "tetrahedron" or "hexahedron".
        sizes: of facets of the lug and the pin.
    """
    make = hexahedra if cell == "hexahedron" else tetrahedra

    def create():
        lug, (x, cells) = (make(*RADII[body], h) for body, h in zip(RADII, sizes, strict=True))
        return lug, (x - [0.0, CLEARANCE, 0.0], cells)

    domain, first = distribute(COMM, create, cell)
    in_lug = domain.topology.original_cell_index < first
    facets, of_lug, x = exterior_facets(domain, in_lug)
    x = x + np.where(of_lug, 0.0, CLEARANCE)[:, None, None] * [0.0, 1.0, 0.0]

    def at(values, position):
        return np.abs(values - position).max(axis=1, initial=0.0) < 1e-6

    r = np.linalg.norm(x[:, :, :2], axis=2)
    where = [at(x[:, :, 0], 0.0), at(x[:, :, 2], 0.0), at(r, OUTSIDE), at(r, HOLE), at(r, PIN)]
    values = np.select([*where, at(r, BORE)], [5, 6, 1, 3, 4, 2], 0).astype(np.int32)
    on = values > 0
    return domain, mesh.meshtags(domain, 2, facets[on], values[on])


def press(domain, tags, slave, **options):
    """Press the bore down by 0.05; return the report, the force of the whole pin and its peak."""
    V = fem.functionspace(domain, ("Lagrange", 1, (3,)))
    bcs = []
    for tag, i, value in ((1, 0, 0.0), (1, 1, 0.0), (2, 1, -0.05), (5, 0, 0.0), (6, 2, 0.0)):
        W = V.sub(i)
        dofs = fem.locate_dofs_topological(W, 2, tags.find(tag))
        bcs.append(fem.dirichletbc(fem.Constant(domain, value), dofs, W))
    slave, master = {"lug": (3, 4), "pin": (4, 3)}[slave]
    contact = dm.Contact(tags, slave=slave, master=master, **options)
    solid = dm.Solid(fem.Function(V), dm.Elastic(200e3, 0.3))
    problem = dm.ContactProblem(solid, [contact], bcs=bcs)
    report = dm.newton(problem)
    return report, 4.0 * abs(contact.force[1]), contact.gather(problem.u)["pressure"].max()

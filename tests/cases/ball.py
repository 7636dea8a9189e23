# SPDX-License-Identifier: MIT
"""The quarter ball on a block, for the tests in 3D."""

from functools import lru_cache

from mpi4py import MPI

import dolfinx_mortar as dm
from dolfinx import fem

STEEL = dm.Elastic(E=206_900.0, nu=0.29)


@lru_cache
def create_mesh(h, cell):
    """Return one mesh per size: another call may partition it in another way."""
    return dm.meshing.sphere(MPI.COMM_WORLD, h=h, cell=cell)


def create_problem(*, h=0.5, slave="block", cell="hexahedron", degree=1, depth=0.2, **options):
    """Return the quarter of a half ball on a block, its flat face pushed down, and the contact."""
    m = create_mesh(h, cell)
    V = fem.functionspace(m.mesh, ("Lagrange", degree, (3,)))
    strain = options.pop("strain", "small")
    solid = dm.Solid(fem.Function(V, name="u"), options.pop("law", STEEL), strain=strain)
    bcs = []
    for tag, component, value in (
        *((tag, i, 0.0) for tag in (1, 2) for i in range(3) if (tag, i) != (2, 2)),
        *((2, 2, -depth), (5, 0, 0.0), (6, 1, 0.0)),
    ):
        W = V.sub(component)
        dofs = fem.locate_dofs_topological(W, 2, m.facet_tags.find(tag))
        bcs.append(fem.dirichletbc(fem.Constant(m.mesh, value), dofs, W))
    tags = (3, 4) if slave == "block" else (4, 3)
    surface = options.pop("surface", "smooth")
    contact = dm.Contact(m.facet_tags, slave=tags[0], master=tags[1], surface=surface)
    options = {"geometry": "reference"} | options
    return dm.ContactProblem(solid, [contact], bcs=bcs, **options), contact

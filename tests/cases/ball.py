# SPDX-License-Identifier: MIT
"""The quarter ball on a block, for the tests in 3D."""

from functools import lru_cache

from mpi4py import MPI

import dolfinx_mortar as dm
from dolfinx import fem
from tests.cases import two_bodies
from tests.cases.two_bodies import held

STEEL = dm.Elastic(E=206_900.0, nu=0.29)


@lru_cache
def create_mesh(h, cell, half=False):
    """Return one mesh per size: another call may partition it in another way."""
    return dm.meshing.sphere(MPI.COMM_WORLD, h=h, cell=cell, half=half)


def create_problem(
    *, h=0.5, slave="block", cell="hexahedron", degree=1, depth=0.2, half=False, **options
):
    """Return the quarter of a half ball on a block, its flat face pushed down, and the contact.

    Or both quarters beside the plane x = 0.
    """
    m = create_mesh(h, cell, half)
    V = fem.functionspace(m.mesh, ("Lagrange", degree, (3,)))
    bcs = [held(V, m.facet_tags, 1), held(V, m.facet_tags, 2, (0.0, 0.0, -depth))]
    bcs += [held(V, m.facet_tags, 5 + i, 0.0, i) for i in (0, 1) if i or not half]
    tags = (3, 4) if slave == "block" else (4, 3)
    surface = options.pop("surface", "smooth")
    contact = dm.Contact(m.facet_tags, slave=tags[0], master=tags[1], surface=surface)
    options = {"geometry": "reference", "law": STEEL} | options
    return two_bodies.create_problem(V, [contact], bcs, **options), contact

# SPDX-License-Identifier: MIT
"""Two blocks, or boxes in space, one above the other, that touch, or are tied, or stand apart."""

from mpi4py import MPI

import numpy as np

import dolfinx_mortar as dm
from dolfinx import default_scalar_type, fem
from tests.cases.meshes import BOTTOM, BOTTOM_OF_UPPER, TOP, TOP_OF_LOWER, UPPER, skins, two_blocks
from tests.cases.meshes_3d import two_boxes
from tests.cases.solid import hold

COMM = MPI.COMM_WORLD
SIDES = TOP_OF_LOWER, BOTTOM_OF_UPPER
CELLS = ["triangle", "quadrilateral", "tetrahedron", "hexahedron"]
ELASTIC = dm.Elastic(1000.0, 0.3)
OF_SOLID = "kinematics", "strain", "volumetric", "energies"


def held(V, tags, tag, value=0.0, component=None):
    """Return a condition on all components of a side, or on one of them."""
    return hold(V, tags.find(tag), component, value, tags.dim)


def create_problem(V, interfaces=(), bcs=(), law=ELASTIC, cells=None, **options):
    """Return the problem of a body, or several; the options are those of solid and problem.

    V may also be the displacement, and the law the solid.
    """
    own = {name: options.pop(name) for name in OF_SOLID if name in options}
    if not isinstance(law, dm.Solid):
        law = dm.Solid(V if isinstance(V, fem.Function) else fem.Function(V), law, cells, **own)
    return dm.ContactProblem(law, interfaces, bcs=bcs, **options)


class TwoBodies:
    """Mesh, tags and space; the bottom is clamped, the top moves by a Constant, 0 at first.

    Args:
        cell: of the mesh.
        degree: of the displacement.
        whole: whether sides are the whole skins, but for bottom and top.
        comm: communicator.
        options: of `two_blocks` or `two_boxes`.
    """

    def __init__(self, cell="triangle", degree=1, *, whole=False, comm=COMM, **options):
        create = two_boxes if cell.endswith("hedron") else two_blocks
        self.mesh, self.cells, self.facets = create(comm, cell=cell, **options)
        self.tags = skins(self.mesh, self.cells, self.facets) if whole else self.facets
        self.d = self.mesh.geometry.dim
        self.V = fem.functionspace(self.mesh, ("Lagrange", degree, (self.d,)))
        self.u = fem.Function(self.V)
        self.top = fem.Constant(self.mesh, np.zeros(self.d, dtype=default_scalar_type))

    def held(self, tag, value=0.0, component=None):
        return held(self.V, self.facets, tag, value, component)

    def bcs(self, *top):
        """Return the conditions at bottom and top, which moves by `top` if that is given."""
        if top:
            self.top.value[:] = top
        return [self.held(BOTTOM), self.held(TOP, self.top)]

    def interface(self, kind=dm.Contact, *, swap=False, slave=None, **options):
        """Return an interface whose slave is the lower body, or the upper one if swapped."""
        slave = SIDES[bool(swap)] if slave is None else slave
        return kind(self.tags, slave=slave, master=sum(SIDES) - slave, **options)

    def problem(self, interfaces=None, bcs=None, law=ELASTIC, **options):
        """Return the problem, in contact and clamped if nothing else is given."""
        interfaces = [self.interface()] if interfaces is None else interfaces
        bcs = self.bcs() if bcs is None else bcs
        cells = {"cells": self.cells} if isinstance(law, dict) else {}
        return create_problem(self.u, interfaces, bcs, law, **cells | options)

    def raise_upper(self, *way):
        """Move the upper body as a whole."""
        self.u.interpolate(lambda x: np.outer(way, np.ones(x.shape[1])), self.cells.find(UPPER))
        self.u.x.scatter_forward()

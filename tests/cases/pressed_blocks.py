# SPDX-License-Identifier: MIT
"""Two blocks pressed together by their supports: valid input, which tests solve or change."""

import re
from contextlib import contextmanager

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import default_scalar_type, fem
from tests.cases.meshes import BOTTOM, BOTTOM_OF_UPPER, TOP, TOP_OF_LOWER, two_blocks
from tests.cases.meshes_3d import two_boxes

COMM = MPI.COMM_WORLD
ELASTIC = dm.Elastic(1000.0, 0.3)


class PressedBlocks:
    """Mesh, tags, space and displacement, and the parts of a problem on them."""

    def __init__(self, *, degree=1, d=2, comm=COMM, **options):
        create = two_blocks if d == 2 else two_boxes
        self.mesh, self.cells, self.facets = create(comm, **options)
        self.V = fem.functionspace(self.mesh, ("Lagrange", degree, (d,)))
        self.u = fem.Function(self.V)
        down = np.append(np.zeros(d - 1), -0.01).astype(default_scalar_type)
        self.d, self.top = d, fem.Constant(self.mesh, down)

    def bc(self, tag, value=None):
        """Hold a side, by default where it is."""
        if value is None or isinstance(value, tuple):
            value = np.array(value or np.zeros(self.d), dtype=default_scalar_type)
        dofs = fem.locate_dofs_topological(self.V, self.d - 1, self.facets.find(tag))
        if isinstance(value, fem.Function):
            return fem.dirichletbc(value, dofs)
        return fem.dirichletbc(value, dofs, self.V)

    def roller(self, tag, component, value=0.0):
        W = self.V.sub(component)
        dofs = fem.locate_dofs_topological(W, self.d - 1, self.facets.find(tag))
        return fem.dirichletbc(value, dofs, W)

    def bcs(self):
        return [self.bc(BOTTOM), self.bc(TOP, self.top)]

    def contact(self, slave=TOP_OF_LOWER, master=BOTTOM_OF_UPPER, facets=None):
        return dm.Contact(self.facets if facets is None else facets, slave=slave, master=master)

    def tie(self, slave=TOP_OF_LOWER, master=BOTTOM_OF_UPPER, **options):
        return dm.Tie(self.facets, slave=slave, master=master, **options)

    def problem(self, interfaces=None, bcs=None, law=ELASTIC, **options):
        solid = law
        if not isinstance(law, dm.Solid):
            solid = dm.Solid(self.u, law, self.cells if isinstance(law, dict) else None)
        interfaces = [self.contact()] if interfaces is None else interfaces
        return dm.ContactProblem(
            solid, interfaces, bcs=self.bcs() if bcs is None else bcs, **options
        )

    def pull(self, traction):
        v, ds = ufl.TestFunction(self.V), ufl.Measure("ds", self.mesh, subdomain_data=self.facets)
        value = fem.Constant(self.mesh, default_scalar_type(traction))
        return ufl.inner(value, v) * ds(TOP)


class Bare(dm.Term):
    """A term that adds nothing."""

    linear, state, has_tangent = False, {}, False

    def __init__(self, **given):
        vars(self).update(given)

    def add_forces(self, F):
        """Do nothing."""

    add_tangent = add_forces


def rejected(*words, error=ValueError):
    """Expect an error on this rank (each rank asks for itself) whose message has all the words."""
    return pytest.raises(error, match="".join(f"(?=.*{re.escape(w)})" for w in words))


@contextmanager
def failing(problem, *words):
    """Expect a step to fail, and all the words in its error or in what is diagnosed."""
    with pytest.raises(dm.NewtonNotConverged) as caught:
        yield caught
    assert problem.diagnose()[-1].startswith(problem.told[-1][-1])
    said = "\n".join([caught.value.message, *problem.diagnose()])
    assert [word for word in words if word not in said] == []


def some_rank(array):
    """Return the entries on the last rank that has any, nothing elsewhere."""
    last = COMM.allreduce(COMM.rank if len(array) else -1, op=MPI.MAX)
    return array if last == COMM.rank else array[:0]

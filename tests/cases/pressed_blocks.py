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

COMM = MPI.COMM_WORLD
ELASTIC = dm.Elastic(1000.0, 0.3)


class PressedBlocks:
    """Mesh, tags, space and displacement, and the parts of a problem on them."""

    def __init__(self, *, degree=1, **options):
        """Create the blocks; the other options are those of `two_blocks`."""
        self.mesh, self.cells, self.facets = two_blocks(COMM, **options)
        self.V = fem.functionspace(self.mesh, ("Lagrange", degree, (2,)))
        self.u = fem.Function(self.V)
        self.top = fem.Constant(self.mesh, default_scalar_type((0.0, -0.01)))

    def bc(self, tag, value=(0.0, 0.0)):
        if isinstance(value, tuple):
            value = np.array(value, dtype=default_scalar_type)
        dofs = fem.locate_dofs_topological(self.V, 1, self.facets.find(tag))
        if isinstance(value, fem.Function):
            return fem.dirichletbc(value, dofs)
        return fem.dirichletbc(value, dofs, self.V)

    def bcs(self):
        return [self.bc(BOTTOM), self.bc(TOP, self.top)]

    def contact(self, slave=TOP_OF_LOWER, master=BOTTOM_OF_UPPER, facets=None):
        return dm.Contact(self.facets if facets is None else facets, slave=slave, master=master)

    def problem(self, interfaces=None, bcs=None, law=ELASTIC, **options):
        solid = law if isinstance(law, dm.Solid) else dm.Solid(self.u, law)
        interfaces = [self.contact()] if interfaces is None else interfaces
        return dm.ContactProblem(
            solid, interfaces, bcs=self.bcs() if bcs is None else bcs, **options
        )

    def pull(self, traction):
        v, ds = ufl.TestFunction(self.V), ufl.Measure("ds", self.mesh, subdomain_data=self.facets)
        value = fem.Constant(self.mesh, default_scalar_type(traction))
        return ufl.inner(value, v) * ds(TOP)


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

# SPDX-License-Identifier: MIT
"""Two blocks pressed together by their supports: valid input, which tests solve or change."""

import re
from contextlib import contextmanager

from mpi4py import MPI

import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import default_scalar_type, fem
from tests.cases.meshes import BOTTOM_OF_UPPER, TOP, TOP_OF_LOWER
from tests.cases.two_bodies import COMM, ELASTIC, TwoBodies

__all__ = ["COMM", "ELASTIC"]


class PressedBlocks(TwoBodies):
    """Parts of a problem of two blocks, in the plane or in space, whose top goes down."""

    def __init__(self, *, d=2, cell=None, **options):
        super().__init__(cell or ("triangle", "tetrahedron")[d - 2], **options)
        self.top.value[-1] = -0.01

    bc = TwoBodies.held

    def roller(self, tag, component, value=0.0):
        return self.held(tag, value, component)

    def contact(self, slave=TOP_OF_LOWER, master=BOTTOM_OF_UPPER, facets=None):
        return dm.Contact(self.facets if facets is None else facets, slave=slave, master=master)

    def tie(self, **options):
        return self.interface(dm.Tie, **options)

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

# SPDX-License-Identifier: MIT
"""Slave nodes far from the master stay out of T; what is left out must not change the answer."""

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx_mortar import newton
from dolfinx_mortar.steps import near
from tests.hertz_case import create_case, create_mesh

pytestmark = pytest.mark.mpi


def solve(geometry, slave, depth=0.3):
    case = create_case(create_mesh("paper", 0.5), slave=slave, geometry=geometry)
    case.press(depth)
    report = newton(case.problem, rtol=1e-11)
    near = np.array([case.contact.near.sum(), case.contact.kept.sum(), report.newton_iterations])
    near[:2] = MPI.COMM_WORLD.allreduce(near[:2])
    return case, near


@pytest.mark.parametrize("geometry", ["reference", "updated"])
@pytest.mark.parametrize("slave", ["block", "disc"])
def test_nodes_left_out_too_many_are_taken_back(monkeypatch, geometry, slave):
    """With no reach at all T starts with the first contact node; the answer must be the same."""
    case, usual = solve(geometry, slave)
    monkeypatch.setattr(near, "INCREMENT_SHARE", 0.0)
    monkeypatch.setattr(near, "FACETS", -0.5)  # not even the nodes that are expected to overlap
    narrow, few = solve(geometry, slave)
    assert narrow.force == pytest.approx(case.force, rel=1e-9)
    same = np.abs(narrow.problem.u.x.array - case.problem.u.x.array).max(initial=0.0)
    assert same < 1e-9 * 0.3
    assert few[0] < usual[0] < usual[1]
    assert few[2] > usual[2]  # it had to find out


@pytest.mark.parametrize("slave", ["block", "disc"])
def test_a_step_of_many_facets_needs_one_search(slave):
    """Partners are taken where the supports move the body, not where it starts."""
    mesh = create_mesh("graded", 0.05, gap=0.5)
    case = create_case(mesh, slave=slave)
    case.press(0.7)
    newton(case.problem)
    assert case.problem.searches == 1
    touching = create_case(create_mesh("graded", 0.05), slave=slave)
    touching.press(0.2)
    newton(touching.problem)
    assert case.force == pytest.approx(touching.force, rel=1e-3)

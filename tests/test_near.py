# SPDX-License-Identifier: MIT
"""When surfaces are paired and coupled, and the first guess of the nodes in contact."""

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx_mortar import meshing, newton
from dolfinx_mortar.interfaces.contact import MortarInterface
from tests.cases.bolted_joint import Joint
from tests.cases.hertz import ELASTIC, create_case

COMM = MPI.COMM_WORLD

pytestmark = pytest.mark.mpi


@pytest.fixture
def coupled(monkeypatch):
    """The interfaces of all calls of `couple`."""
    found, couple = [], MortarInterface.couple

    def counted(interface, *given):
        found.append(interface)
        return couple(interface, *given)

    monkeypatch.setattr(MortarInterface, "couple", counted)
    return found


@pytest.mark.mpi
def test_what_stays_at_X_is_coupled_once_a_search(coupled):
    """Ties beside contacts that follow u."""
    joint = Joint()
    for pull in (-30.0, -60.0):
        joint.pull.value = pull
        newton(joint.problem)
        joint.problem.commit()
    system = joint.problem.system
    counts = [coupled.count(interface) for interface in system.interfaces]
    assert counts[:2] == [system.searches] * 2 and min(counts[2:]) > system.searches


@pytest.mark.mpi
def test_sides_that_have_slid_are_coupled_where_they_are(coupled):
    """Not where they were, with the partners that they have left."""
    case = create_case(meshing.hertz(COMM, kind="paper"), ELASTIC)
    case.press(0.02)
    newton(case.problem)
    case.problem.commit()
    problem, system = case.problem, case.problem.system
    label = problem.bodies.label
    problem.owned_u.reshape(-1, 2)[label == 0, 0] += 3.0
    problem.u.x.scatter_forward()
    for pairs in (1, 2):  # the second time those of the last step have to be found again
        before = system.searches
        coupled.clear()
        found = system.begin(problem.configuration, problem.committed.paired)
        assert (len(coupled), system.searches - before) == (1, pairs)
        assert np.array_equal(found.paired_at, problem.owned_u)

# SPDX-License-Identifier: MIT
"""Checkpoints are restored as a whole or not at all."""

import shutil

from mpi4py import MPI

import h5py
import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from dolfinx_mortar.persistence.checkpoints import seal
from tests.cases.meshes import BOTTOM_OF_UPPER, TOP_OF_LOWER
from tests.cases.pressed_blocks import Bare, PressedBlocks, rejected
from tests.cases.states import state_of

COMM = MPI.COMM_WORLD
pytestmark = pytest.mark.mpi
LAW = dm.VonMises(E=1000.0, nu=0.3, Y=8.0, a=50.0)
SIDES = {"slave": TOP_OF_LOWER, "master": BOTTOM_OF_UPPER}
MADE = {}  # a problem in some state, the file of another state, and all of the first, by kind


def walked(kind, way):
    """Return a problem with a history, slips or a tightening, plastic strain and a term's state."""
    case = PressedBlocks(jitter=0.2)
    side = dm.Contact(case.facets, **SIDES, friction=0.3)
    if kind == "tie":
        side = dm.Tie(case.facets, **SIDES)
        side.tightening = np.array([0.0, way / 10])
    kept = fem.Function(case.V.sub(0).collapse()[0])
    kept.x.array[:] = way
    memory = Bare(state={"kept": kept}, has_tangent=True)
    problem = case.problem([side], law=LAW, terms=[memory])
    table = [(t, (way * t, -way * t)) for t in (0.0, 1.0)]
    list(dm.load_steps(problem, [0.5, 1.0], ramp={case.top: table}, progress=False))
    return problem


@pytest.fixture(params=["contact", "tie"])
def made(request, tmp_path_factory):
    kind = request.param
    if kind not in MADE:
        good = COMM.bcast(tmp_path_factory.mktemp(kind)) / "good.h5"
        problem = walked(kind, 0.01)
        walked(kind, 0.02).save(good)
        MADE[kind] = problem, good, state_of(problem)
    return MADE[kind]


def test_a_whole_file_is_taken(made):
    """What the other tests compare does change; and then it is put back for them."""
    problem, good, before = made
    own = good.with_name("own.h5")
    problem.save(own)
    problem.restore(good)
    changed = [one != other for one, other in zip(state_of(problem)[0], before[0], strict=True)]
    assert COMM.allreduce(sum(changed)) > 10
    problem.restore(own)
    assert state_of(problem) == before


def test_a_restart_that_fails_half_way_changes_nothing(made):
    """Whatever fails; here a column that the file lacks, of a file with a valid checksum."""
    problem, good, before = made
    file = good.with_name("edited.h5")
    COMM.barrier()
    if COMM.rank == 0:
        shutil.copy(good, file)
        with h5py.File(file, "r+") as opened:
            about = opened["about"][:].tobytes()
            about = about.replace(b': gap"', b': gib"')
            opened["about"][:] = np.frombuffer(about, dtype=np.uint8)
        seal(file)
    COMM.barrier()
    with pytest.raises(KeyError):
        problem.restore(file)
    assert state_of(problem) == before


@pytest.mark.parametrize("made", ["tie"], indirect=True)
def test_an_interface_that_refuses_changes_nothing(made):
    """A kind of one's own, on one rank."""
    problem, good, before = made
    tie = problem.interfaces[0]

    def refuse(found):
        del tie.restore
        tie.tightening = np.array([1.0, 1.0])
        if COMM.rank == COMM.size - 1:
            raise ValueError("not as tight as this")

    tie.restore = refuse
    with rejected("not as tight as this"):
        problem.restore(good)
    assert state_of(problem) == before


def test_what_no_restart_could_read_is_not_saved(folder):
    """Of a term of one's own, which nobody else has looked at."""
    problem, file = walked("tie", 0.01), folder / "x.h5"
    kept, *_ = problem.state.states_of_terms.values()
    if COMM.rank == COMM.size - 1:
        kept.x.array[:] = np.inf
    with rejected("kept holds NaN or infinity"):
        problem.save(file)
    assert not file.exists()

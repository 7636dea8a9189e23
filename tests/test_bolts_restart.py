# SPDX-License-Identifier: MIT
"""Bolts in runs that were stopped: they stay as tight as they were, on any number of ranks."""

import shutil

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from tests.cases.bolted_joint import Joint
from tests.cases.tightened_bar import tighten

COMM = MPI.COMM_WORLD
F0, LEVELS = 6.0, [3.0, 6.0, 12.0]
CARRIED = [F0 + 1.0, F0 + 2.0, 12.0]  # a third of the pull, until the plates part


@pytest.fixture
def folder(tmp_path):
    """Return a folder that all ranks see."""
    return COMM.bcast(tmp_path)


def tightened(comm=COMM, force=F0):
    """Return a joint with its pretension."""
    joint = Joint(comm=comm)
    tighten(joint.problem, {joint.bolt: force}, joint.direction)
    return joint


def walk(joint, levels, file):
    """Return number of the step and force of the bolt, for the steps that were left."""
    options = {"on_time": lambda t: joint.pull.value.fill(t), "checkpoint": file}
    steps = dm.load_steps(joint.problem, levels, progress=False, **options)
    return [(step.number, joint.tension()) for step in steps]


def going_on(first):
    """Return what the steps from a number on find."""
    return [(k, pytest.approx(CARRIED[k - 1], rel=1e-4)) for k in range(first, len(LEVELS) + 1)]


@pytest.mark.mpi
@pytest.mark.parametrize("create", [tightened, Joint], ids=["again", "forgotten"])
def test_a_walk_that_was_stopped_goes_on(create, folder):
    """Whether the program tightens its bolts before the walk once more, or not."""
    file = folder / "run.h5"
    first, second = tightened(), create()
    assert walk(first, LEVELS[:1], file) == going_on(1)[:1]
    assert walk(second, LEVELS, file) == going_on(2)
    assert np.array_equal(second.bolt.tightening, first.bolt.tightening)


@pytest.mark.mpi
def test_one_rank_tightens_and_all_go_on(folder):
    file = folder / "one.h5"
    if COMM.rank == 0:
        walk(tightened(comm=MPI.COMM_SELF), LEVELS[:1], file)
    COMM.barrier()
    assert walk(Joint(), LEVELS, file) == going_on(2)


@pytest.mark.mpi
def test_all_ranks_tighten_and_each_goes_on_alone(folder):
    walk(tightened(), LEVELS[:1], folder / "all.h5")
    own = folder / f"{COMM.rank}.h5"
    shutil.copy(folder / "all.h5", own)
    assert walk(Joint(comm=MPI.COMM_SELF), LEVELS, own) == going_on(2)


@pytest.mark.mpi
def test_what_is_restored_is_tightened_from_where_it_is(folder):
    joint, fresh = tightened(), Joint()
    joint.problem.save(folder / "tight.h5")
    fresh.problem.restore(folder / "tight.h5")
    assert tighten(fresh.problem, {fresh.bolt: F0}, fresh.direction).newton_iterations == 1
    assert np.allclose(fresh.bolt.tightening, joint.bolt.tightening, rtol=1e-7, atol=0.0)
    tighten(fresh.problem, {fresh.bolt: 2.0 * F0}, fresh.direction)
    assert np.allclose(fresh.bolt.tightening, 2.0 * joint.bolt.tightening, rtol=1e-4, atol=0.0)


@pytest.mark.mpi
def test_a_state_from_before_lets_the_bolt_go(folder):
    """Also one without results; what the program sets by hand before a step is kept."""
    joint = Joint()
    joint.problem.save(folder / "loose.h5")
    joint.bolt.tightening = [0.0, -1e-3]
    joint.problem.save(folder / "set.h5")
    tighten(joint.problem, {joint.bolt: F0}, joint.direction)
    joint.problem.restore(folder / "loose.h5")
    assert np.array_equal(joint.bolt.tightening, [0.0, 0.0])
    joint.problem.restore(folder / "set.h5")
    assert np.array_equal(joint.bolt.tightening, [0.0, -1e-3])

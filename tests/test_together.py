# SPDX-License-Identifier: MIT
"""An error on one rank is raised on all ranks, with its text."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx_mortar.algebra.parallel import raised_together
from tests.cases.pointwise_laws import Radial
from tests.cases.pressed_blocks import PressedBlocks

COMM = MPI.COMM_WORLD


class Odd(Exception):
    """An error that other ranks need not know."""


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("error", "elsewhere"),
    [(ValueError, ValueError), (FileNotFoundError, OSError), (Odd, RuntimeError)],
)
@pytest.mark.parametrize("rank", [0, -1])
def test_all_ranks_raise(error, elsewhere, rank):
    failing = rank % COMM.size
    expected = error if failing == COMM.rank else elsewhere
    with pytest.raises(expected, match="no luck") as caught, raised_together(COMM):
        if failing == COMM.rank:
            raise error("no luck")
    assert (f"on rank {failing}" in str(caught.value)) == (failing != COMM.rank)
    assert COMM.allreduce(1) == COMM.size  # nobody is left in another call


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("error", "code"),
    [
        (KeyboardInterrupt(), None),
        (SystemExit(3), 3),
        (SystemExit(), 0),
        (SystemExit("no licence"), "no licence"),
    ],
)
def test_all_ranks_end_as_one_does(error, code):
    """Ctrl-C or `sys.exit` in a law on one rank: the others would wait for it for ever."""
    failing = COMM.size - 1
    with pytest.raises(type(error)) as caught, raised_together(COMM):
        if COMM.rank == failing:
            raise error
    if isinstance(error, SystemExit):
        told = f"{code} (on rank {failing})" if isinstance(code, str) else code
        assert caught.value.code == (error.code if failing == COMM.rank else told)
    assert COMM.allreduce(1) == COMM.size


def test_a_generator_that_is_closed_asks_nobody():
    """Python closes it when it likes, not on all ranks at a time."""

    class Nobody:
        def allgather(self, _):
            raise AssertionError

    def walk():
        with raised_together(Nobody()):
            yield

    steps = walk()
    next(steps)
    steps.close()


@pytest.mark.mpi
def test_a_law_that_is_stopped_on_one_rank():
    """All ranks raise, and the step is undone on all."""
    stopped = []

    class Stopped(Radial):
        @staticmethod
        def update(strain, state, p):
            if stopped and COMM.rank == COMM.size - 1:
                raise stopped.pop()
            return Radial.update(strain, state, p)

    case = PressedBlocks()
    problem = case.problem(law=Stopped(1000.0, 0.3, 5.0, 10.0))
    dm.newton(problem)
    before = case.u.x.array.copy()
    case.top.value[1] = -0.012
    for error in (KeyboardInterrupt, SystemExit):
        stopped[:] = [error]
        with pytest.raises(error):
            dm.newton(problem)
        assert np.array_equal(case.u.x.array, before)
    assert COMM.allreduce(1) == COMM.size
    assert dm.newton(problem).converged

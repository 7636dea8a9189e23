# SPDX-License-Identifier: MIT
"""Interrupted runs to compare with an uninterrupted one, in this program and as separate jobs."""

from pathlib import Path

import numpy as np

from tests import jobs
from tests.checkpoint_program import Press

SAME = 1e-10
PROGRAM = Path(__file__).parent / "checkpoint_program.py"


def numbers_at_once():
    """Return the numbers of all steps in one go."""
    press = Press()
    list(press.walk())
    numbers = press.numbers()
    assert numbers["plastic"][0] > 1e-3 and 0 < sum(numbers["active"]) < len(numbers["active"])
    return numbers


def agree(found, expected):
    """Compare all numbers relative to the largest of their kind, moments to the forces."""
    for name, values in expected.items():
        a, b = np.array(found[name]), np.array(values)
        assert a.shape == b.shape, name
        scale = np.abs(np.array(expected["force"] if name == "moment" else values)).max()
        assert np.abs(a - b).max(initial=0.0) <= SAME * scale, name


def run(ranks, *arguments):
    """Run the program on some ranks and return its exit code and output."""
    done = jobs.run(ranks, PROGRAM, *arguments, seconds=300.0)
    return done.returncode, done.stdout + done.stderr

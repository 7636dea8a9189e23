# SPDX-License-Identifier: MIT
"""Runs that are compared with one that goes through: in this program, and as jobs of their own."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from tests.checkpoint_program import Press
from tests.test_parallel import LAUNCHER, ROOT

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
    environment = {k: v for k, v in os.environ.items() if not k.startswith(LAUNCHER)}
    environment["PYTHONPATH"] = os.pathsep.join([str(ROOT), environment.get("PYTHONPATH", "")])
    launcher = [] if ranks == 1 else ["mpirun", "-n", str(ranks)]
    command = [*launcher, sys.executable, str(PROGRAM), *map(str, arguments)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)
    return done.returncode, done.stdout + done.stderr

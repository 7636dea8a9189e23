# SPDX-License-Identifier: MIT
"""No number in geometry and mortar decides an answer: halved or doubled, each gives the same."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
NUMBERS = [
    "BLUR", "EPS", "FACING", "HALF_OF_DIGITS", "JUMP", "LEAST_COVERAGE", "LEAST_WEIGHT",
    "OPEN", "PROJECTIONS", "ROUND_OFF", "STAYS", "THROUGH", "TINY", "VERTICES", "area._ACCURACY",
    "area._HIGHEST", "operators._CHUNK", "parts._STEPS",
    "segments._SLIDING", "surface._MOST_WARPED",
]  # fmt: skip
# What its cases do not reach is judged with absurd values in test_smooth_3d (PROJECTIONS), in
# test_axisymmetric_patch (LEAST_WEIGHT), and in test_elements (_STEPS of parts).
DEFINITIONS = {"ALPHA"}  # of the multipliers' space, not of accuracy: see test_tying_3d
SAME = 1e-12
pytestmark = [pytest.mark.serial, pytest.mark.slow]


@pytest.fixture(scope="module")
def changes():
    """Return how halving and doubling changes [operators, resultants] for every number."""
    program = [sys.executable, "-m", "tests.numbers_program"]
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run(program, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_no_number_is_left_out(changes):
    assert sorted(changes.keys() - {"absurd", "again"} - DEFINITIONS) == NUMBERS


@pytest.mark.parametrize("name", [name for name in NUMBERS if name != "LEAST_COVERAGE"])
def test_same_operators(changes, name):
    assert max(nodal for nodal, _ in changes[name]) < SAME


def test_coverage_decides_who_carries_but_not_what(changes):
    """Which nodes have a multiplier depends on it; what the sides exchange in total does not."""
    assert max(total for _, total in changes["LEAST_COVERAGE"]) < SAME


def test_the_kernels_see_the_numbers(changes):
    """With a round-off of a tenth of a facet the operators are others, and afterwards as before."""
    assert changes["absurd"][0][0] > 1e-3
    assert changes["again"][0] == [0.0, 0.0]

# SPDX-License-Identifier: MIT
"""The same numbers on 1, 2 and 3 ranks: force, multipliers, displacement, however split."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests import jobs

SAME = 1e-10
PROGRAM = Path(__file__).parent / "ranks_program.py"

pytestmark = pytest.mark.serial


def run(ranks, folder):
    """Return the results of the program on some ranks."""
    result = folder / f"{ranks}.json"
    done = jobs.run(ranks, PROGRAM, result, seconds=300.0)
    assert done.returncode == 0, done.stdout + done.stderr
    return json.loads(result.read_text())


@pytest.fixture(scope="module")
def serial(tmp_path_factory):
    """Results on one rank."""
    return run(1, tmp_path_factory.mktemp("ranks"))


def compare(found, expected):
    """Compare everything relative to the largest entry of its kind."""
    for name in sorted(expected):
        a, b = np.array(found[name]), np.array(expected[name])
        assert a.shape == b.shape, name
        if name == "displacement":
            d = a.shape[1] // 2
            assert np.allclose(a[:, :d], b[:, :d], rtol=0, atol=1e-14)
            a, b = a[:, d:], b[:, d:]
        if name == "status":
            assert np.array_equal(a, b)
        difference = np.abs(a - b).max(initial=0.0)
        scale = np.abs(b).max()
        if name == "moment":
            scale = np.abs(expected["force"]).max()
        elif name == "step_slip":  # a difference of displacements
            scale = np.abs(np.array(expected["displacement"])[:, -a.shape[1] :]).max()
        assert difference <= SAME * scale, (name, difference / scale)


@pytest.mark.parametrize("ranks", [pytest.param(2, marks=pytest.mark.slow), 3])
def test_same_numbers_on_any_ranks(ranks, serial, tmp_path):
    """Force, moment, multipliers, displacement, slips and dissipation agree to 1e-10."""
    found = run(ranks, tmp_path)
    for case, expected in serial.items():
        compare(found[case], expected)

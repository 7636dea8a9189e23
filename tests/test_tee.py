# SPDX-License-Identifier: MIT
"""Resistances of T-stubs, and the demo of a bolted one: preload, prying, yielding, equilibrium."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from demos.bolted_tee.tee_stub import tee_stub
from tests import jobs

pytestmark = pytest.mark.serial

DEMO = Path(__file__).parent.parent / "demos" / "bolted_tee"
STUB = {"m": 30.0, "e": 30.0, "thickness": 10.0, "width": 40.0, "yield_stress": 240.0}


# -- formulas


def test_modes_of_a_narrow_stub():
    """The width bounds both lengths: by hand, M = 240 Nm."""
    found = tee_stub(**STUB, bolt=60e3)
    assert (found.length_1, found.length_2, found.lever) == (40.0, 40.0, 30.0)
    modes = (found.mode_1, found.mode_2, found.mode_3)
    assert modes == pytest.approx((32e3, 68e3, 120e3), rel=1e-12)
    assert found.resistance == found.mode_1
    assert tee_stub(**STUB, bolt=10e3).resistance == pytest.approx(18e3)  # of mode 2
    thick = STUB | {"thickness": 60.0}
    assert tee_stub(**thick, bolt=10e3).resistance == pytest.approx(20e3)  # of mode 3


@pytest.mark.parametrize(
    ("e", "length_1", "length_2", "lever"),
    [(30.0, 157.5, 157.5, 30.0), (100.0, 60.0 * np.pi, 245.0, 37.5)],
)
def test_patterns_of_a_wide_stub(e, length_1, length_2, lever):
    """A straight yield line, or for mode 1 a circle around the bolt."""
    found = tee_stub(**STUB | {"e": e, "width": 1e4}, bolt=60e3)
    expected = (length_1, length_2, lever)
    assert (found.length_1, found.length_2, found.lever) == pytest.approx(expected, rel=1e-12)
    assert found.mode_1 == pytest.approx(length_1 * 100.0 * 240.0 / 30.0, rel=1e-12)
    sides = 0.5 * length_2 * 100.0 * 240.0 + lever * 120e3
    assert found.mode_2 == pytest.approx(sides / (30.0 + lever), rel=1e-12)


# -- the demo


def run(*options, ranks=1):
    return jobs.run(ranks, DEMO / "bolted_tee.py", *options)


def rows_of(folder, *options, ranks=1):
    """Run the demo; return its steps, the preload first, and the whole summary."""
    done = run(*options, "--output", str(folder), ranks=ranks)
    assert done.returncode == 0, done.stderr
    summary = json.loads((folder / "summary.json").read_text())
    return summary["steps"], summary


def check_balance(rows, preload):
    """Every step: bolt, head and nut carry the same, and what is pulled plus the prying force."""
    assert rows[0]["bolt"] == pytest.approx(preload, rel=1e-7)
    for row in rows:
        assert row["balance"] < 1e-8
        assert row["bolt"] == pytest.approx(row["force"] / 2 + row["prying"], rel=1e-8)
        assert row["under_head"] == pytest.approx(row["bolt"], rel=1e-8)
        assert row["under_nut"] == pytest.approx(row["bolt"], rel=1e-8)
        assert row["prying"] > 0.0


@pytest.mark.slow
def test_a_coarse_joint(tmp_path):
    """Preload, then a pull into yielding: bolts gain less than is pulled, and flanges pry."""
    options = ("--layers", "2", "--steps", "3", "--pull", "0.9", "--preload", "25")
    rows, summary = rows_of(tmp_path, *options)
    check_balance(rows, 25e3)
    assert summary["jump"] > 0.0 and abs(rows[0]["force"]) < 0.1 * rows[0]["bolt"]
    force, bolt = ([row[name] for row in rows] for name in ("force", "bolt"))
    assert np.all(np.diff(force) > 0.0) and np.all(np.diff(bolt) > 0.0)
    assert bolt[1] - bolt[0] < 0.25 * (force[1] - force[0])  # preloaded: half of it otherwise
    assert rows[-1]["plastic_strain"] > 2e-3 and rows[-1]["opening"] > 0.8
    assert summary["modes"][0] == pytest.approx(42.76e3, rel=1e-3)
    assert summary["modes"][0] < force[-1] < 1.1 * summary["modes"][1]
    assert (tmp_path / "bolted_tee.xdmf").exists()
    assert (tmp_path / "result.png").stat().st_size > 5000
    with Image.open(tmp_path / "pull.gif") as shown:
        assert shown.n_frames == len(rows)
    assert (DEMO / "result.png").stat().st_size < 200_000


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--steps", "0"), "--steps 0"),
        pytest.param(("--layers", "1"), "--layers 1", marks=pytest.mark.slow),
        pytest.param(("--preload", "-3"), "--preload -3", marks=pytest.mark.slow),
        pytest.param(("--friction", "-0.1"), "--friction -0.1", marks=pytest.mark.slow),
    ],
)
def test_options_that_make_no_sense(options, said):
    done = run(*options)
    assert done.returncode == 2 and said in done.stderr and "Traceback" not in done.stderr

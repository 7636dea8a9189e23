# SPDX-License-Identifier: MIT
"""The demos as commands."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

DEMOS = Path(__file__).parent.parent / "demos"


def run(*options, demo="hertz"):
    return subprocess.run(
        [sys.executable, str(DEMOS / demo / f"{demo}.py"), *options],
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.serial
@pytest.mark.parametrize("demo", ["hertz", "sphere"])
@pytest.mark.parametrize("steps", ["0", "-3", "x"])
def test_steps_are_counted_from_one(demo, steps):
    done = run("--steps", steps, demo=demo)
    assert done.returncode == 2 and "--steps" in done.stderr and "Traceback" not in done.stderr


@pytest.mark.serial
def test_elastic_bodies_have_no_plastic_numbers(tmp_path):
    done = run("--material", "elastic", "--displacement", "0.05", "--output", str(tmp_path))
    assert done.returncode == 0, done.stderr
    (step,) = json.loads((tmp_path / "summary.json").read_text())["steps"]
    assert step["max_plastic_strain"] == step["max_back_stress"] == step["plastic_area"] == 0.0
    assert step["force"] == pytest.approx(2425.0, rel=0.05)  # on a coarse mesh
    assert step["certificate"]["equilibrium"] < 1e-6

# SPDX-License-Identifier: MIT
"""The demos at finite strain as commands, beside forces that others have published."""

import json

import numpy as np
import pytest
from PIL import Image

from tests.test_demo import DEMOS, run, shown

pytestmark = pytest.mark.serial


def steps_of(folder, demo, *options):
    """Run a demo and return the rows of its steps."""
    done = run(*options, "--no-animation", "--output", str(folder), demo=demo)
    assert done.returncode == 0, done.stderr
    return rows_in(folder)


def rows_in(folder):
    return json.loads((folder / "summary.json").read_text())["steps"]


def check_pictures(folder, demo, steps):
    """A picture and an animation of all steps; the picture in the repository is a small one."""
    assert (folder / "result.png").stat().st_size > 5000
    with Image.open(folder / f"{demo}.gif") as frames:
        assert frames.n_frames >= steps  # equal ones are one
    assert (folder / f"{demo}.gif").stat().st_size < 1_000_000
    assert (DEMOS / demo / "result.png").stat().st_size < 200_000


def forces(rows):
    """Return times, V and H of ironing."""
    return np.array([[row[name] for name in ("time", "vertical", "horizontal")] for row in rows]).T


def at(t, values, when):
    return values[np.argmin(np.abs(t - when))]


@pytest.mark.slow
def test_a_tool_is_dragged_as_others_have_found():
    """Forces between the lowest and the highest of six programs, and Coulomb's ratio."""
    folder = shown("ironing")
    rows = rows_in(folder)
    check_pictures(folder, "ironing", len(rows))
    t, V, H = forces(rows)
    assert 267.9 < at(t, V, 1.0) < 332.0 and 55.0 < at(t, H, 1.0) < 71.0
    assert 337.5 < at(t, V, 1.5) < 421.0 and 102.1 < at(t, H, 1.5) < 188.8
    sliding = (t > 1.07) & (t < 1.83)
    assert np.all((H > 0.3 * V)[sliding]) and np.all((H < 0.36 * V)[sliding])
    assert all(row["parts"] == 1 for row in rows)
    assert np.mean([row["newton_iterations"] for row in rows]) < 7.0
    assert min(row["smallest_J"] for row in rows) > 0.6


@pytest.mark.slow
def test_a_tool_without_friction_needs_no_thrust_half_way(tmp_path):
    """By symmetry, on any mesh; V is below that with friction, of which H leans the tool."""
    t, V, H = forces(steps_of(tmp_path, "ironing", "--friction", "0", "--h", "0.2"))
    assert abs(at(t, H, 1.5)) < 0.005 * at(t, V, 1.5)
    middle = np.abs(t - 1.5) < 0.26
    assert np.abs(H[middle]).max() < 0.02 * V[middle].min()
    assert 337.5 < at(t, V, 1.5) < 421.0


@pytest.mark.slow
@pytest.mark.nightly
@pytest.mark.parametrize("options", [("--slave", "block"), ("--h", "0.075")])
def test_ironing_depends_little_on_sides_and_mesh(options, tmp_path):
    """V within 1.5 % of the default's while the tool is down and dragged."""
    t, V, _ = forces(rows_in(shown("ironing")))
    _, W, _ = forces(steps_of(tmp_path, "ironing", *options))
    down = t > 0.95
    assert np.abs(V - W)[down].max() < 0.015 * V.max()


@pytest.mark.parametrize(
    ("demo", "options", "named"),
    [
        ("ironing", ("--steps", "2"), "--steps 2"),
        pytest.param("ironing", ("--h", "0.4"), "--h 0.4", marks=pytest.mark.slow),
        pytest.param("ironing", ("--friction", "-1"), "--friction -1", marks=pytest.mark.slow),
    ],
)
def test_options_that_make_no_sense(demo, options, named):
    done = run(*options, demo=demo)
    assert done.returncode == 2 and named in done.stderr and "Traceback" not in done.stderr

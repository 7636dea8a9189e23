# SPDX-License-Identifier: MIT
"""The demos as commands."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

DEMOS = Path(__file__).parent.parent / "demos"
SOCKET_FORCE = 67.8e3  # N, of 120 thousand unknowns in hexahedra, and 67.96 of 61 in tetrahedra


def run(*options, demo="hertz", ranks=1):
    launcher = [] if ranks == 1 else ["mpirun", "-n", str(ranks)]
    return subprocess.run(
        [*launcher, sys.executable, str(DEMOS / demo / f"{demo}.py"), *options],
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


@pytest.mark.serial
@pytest.mark.slow
@pytest.mark.parametrize("ranks", [1, 2])
@pytest.mark.parametrize("demo", ["hertz", "sphere"])
def test_demos_run_to_their_pictures(demo, ranks, tmp_path):
    """As a user calls them, on coarse meshes; elastic, they come near Hertz."""
    options = ["--h", "0.25", "--displacement", "0.05", "--steps", "2", "--material", "elastic"]
    options += ["--mesh", "graded"] if demo == "hertz" else ["--surface", "facets"]
    done = run(*options, "--output", str(tmp_path), demo=demo, ranks=ranks)
    assert done.returncode == 0, done.stderr
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["ranks"] == ranks and len(summary["steps"]) == 2
    last = summary["steps"][-1]
    assert last["peak_pressure_fit"] == pytest.approx(last["peak_pressure_hertz"], rel=0.05)
    assert last["certificate"]["equilibrium"] < 1e-6
    pictures = list(tmp_path.glob("*.png"))
    assert len(pictures) >= 3 and all(p.stat().st_size > 5000 for p in pictures)
    assert (tmp_path / f"{demo}.xdmf").exists()


@pytest.mark.serial
@pytest.mark.parametrize("ranks", [1, 2])
def test_the_ball_joint_shows_what_facets_do(ranks, tmp_path):
    """On the coarsest mesh: forces twice or three times those of smooth surfaces."""
    done = run("--meshes", "1", "--output", str(tmp_path), demo="ball_joint", ranks=ranks)
    assert done.returncode == 0, done.stderr
    rows = re.findall(r"slave (\w+), (\w+): (\d+) N, (\d+) MPa", done.stdout)
    force = {(slave, surface): float(F) for slave, surface, F, _ in rows}
    for slave in ("socket", "ball"):
        assert force[slave, "smooth"] == pytest.approx(SOCKET_FORCE, rel=0.04)
        assert force[slave, "facets"] > 2.0 * SOCKET_FORCE
    assert (tmp_path / "pressure.png").stat().st_size > 5000
    (folder,) = {p.parent for p in DEMOS.glob("ball_joint/*.png")}
    assert (folder / "result.png").stat().st_size < 200_000

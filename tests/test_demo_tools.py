# SPDX-License-Identifier: MIT
"""The demos of rigid tools as commands, beside Hertz, Johnson, Larsson, Siebel, Hill and others."""

import json

import pytest

from tests.test_demo import run, shown
from tests.test_demo_friction import read

pytestmark = pytest.mark.serial


def check_metal(found, modulus):
    """The modulus of the true area is the one put in; that of Oliver and Pharr is too large."""
    found = found["found"]
    assert found["modulus_contact"] == pytest.approx(found["modulus_given"], rel=modulus)
    # Bolshakov and Pharr (1998): metals without hardening pile up by up to a fifth or more
    assert 1.1 < found["piled_up"] < 1.3
    assert found["modulus_oliver_pharr"] > 1.1 * found["modulus_given"]
    # Tabor (1951): nearly three; 2.6 to 2.8 by computations with cones of this angle
    assert 2.3 < found["hardness_contact"] / found["yield_stress"] < 3.0


def check_ball(found):
    """First as Hertz says, then as Johnson's cavity, in the end nearly three yield stresses."""
    rows, found = found["steps"], found["found"]
    assert found["first_force_over_hertz"] == pytest.approx(1.0, abs=0.02)
    cavity = [row for row in rows if 1.8 < row.get("pressure_cavity", 0.0) < 2.5]
    assert len(cavity) >= 3
    for row in cavity:
        assert row["force"] / row["area"] == pytest.approx(row["pressure_cavity"], rel=0.05)
    assert 2.5 < found["hardness_contact"] / found["yield_stress"] < 3.0
    assert found["modulus_contact"] == pytest.approx(found["modulus_given"], rel=0.08)
    # its impression is shallow: less is piled up than beside a cone
    assert 1.0 < found["piled_up"] < 1.15
    assert found["modulus_contact"] < found["modulus_oliver_pharr"]


def indented(folder, tool, *options):
    """Return the summary of the demo with one tool."""
    done = run("--tool", tool, *options, "--output", str(folder), demo="hardness")
    assert done.returncode == 0, done.stderr
    return of_tool(folder, tool)


def of_tool(folder, tool):
    assert (folder / "result.png").stat().st_size > 5000
    return json.loads((folder / f"{tool}.json").read_text())


@pytest.mark.slow
def test_the_modulus_and_hardness_of_a_metal(tmp_path):
    """No step is cut: forces stay far from their balance for a dozen iterations, gaps do not."""
    found = indented(tmp_path, "cone", "--h", "0.2", "--steps", "10")
    check_metal(found, 0.05)
    assert all(step["parts"] == 1 for step in found["steps"])


@pytest.mark.slow
def test_a_ball_in_a_metal(tmp_path):
    check_ball(indented(tmp_path, "ball", "--h", "0.2", "--steps", "12"))


@pytest.mark.slow
@pytest.mark.parametrize(("tool", "error"), [("cone", 0.02), ("berkovich", 0.025)])
def test_tools_on_an_elastic_half_space(tmp_path, tool, error):
    """Hay, Bolshakov, Pharr (1999): 6.7 % over Sneddon; Larsson's computations (1996)."""
    found = indented(tmp_path, tool, "--elastic", "--h", "0.15", "--steps", "1")["found"]
    assert found["force_over_theory"] == pytest.approx(1.0, abs=error)


@pytest.mark.slow
@pytest.mark.nightly
def test_the_hardness_as_the_gallery_shows_it():
    folder = shown("hardness")
    check_metal(of_tool(folder, "cone"), 0.02)
    check_ball(of_tool(folder, "ball"))
    found = of_tool(folder, "berkovich")["found"]
    # the cone displaces as much as the pyramid; King's factor is that of a flat punch
    assert found["modulus_contact"] == pytest.approx(found["modulus_given"], rel=0.06)
    assert found["modulus_oliver_pharr"] > 1.1 * found["modulus_given"]
    assert 1.1 < found["piled_up"] < 1.3
    assert 2.0 < found["hardness_contact"] / found["yield_stress"] < 3.0


@pytest.mark.slow
def test_a_cup_is_drawn():
    summary = read(shown("deep_drawing"))
    found, steps = summary["found"], summary["steps"]
    # 144 in 35 steps; loads of tools that a QP misses by its own tolerance take four times as many
    assert sum(step["newton_iterations"] for step in steps) <= 160
    assert not any("parts" in note for step in steps for note in step["notes"])
    # a rim that nothing pulls: uniaxial compression around the axis (Hill 1950)
    assert found["thickness_of_rim"] == pytest.approx(found["thickness_hill"], rel=0.01)
    # what Siebel's estimate of the force is worth
    assert found["largest_force"] == pytest.approx(found["largest_force_siebel"], rel=0.2)
    assert found["holder"] == pytest.approx(10_000.0, rel=1e-4)

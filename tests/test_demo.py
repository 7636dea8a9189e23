# SPDX-License-Identifier: MIT
"""The demos as commands, beside closed solutions and the numbers that others have published."""

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from demos.curved_beams.literature import LARGEST, MOTION, REACTIONS
from tests import jobs
from tests.test_docs import tool

pytestmark = pytest.mark.serial
DEMOS = Path(__file__).parent.parent / "demos"
SOCKET_FORCE = 67.8e3  # N, of 120 thousand unknowns in hexahedra, and 67.96 of 61 in tetrahedra


def run(*options, demo, ranks=1):
    return jobs.run(ranks, DEMOS / demo / f"{demo}.py", *options)


def shown(name):
    """Return the folder of what the gallery shows of a demo, run unless docs/build has done so."""
    gallery = tool("gallery")
    (demo,) = (demo for demo in [*gallery.EXAMPLES, *gallery.DEMOS] if demo.name == name)
    gallery.run(demo)
    return gallery.KEPT / name


def read(folder, file="summary", picture="result"):
    assert (folder / f"{picture}.png").stat().st_size > 5000
    return json.loads((folder / f"{file}.json").read_text())


def summary(folder, demo, *options, ranks=1, **files):
    done = run(*options, "--output", str(folder), demo=demo, ranks=ranks)
    assert done.returncode == 0, done.stderr
    return read(folder, **files)


def near(found, rel, **expected):
    """Compare numbers of a file with others, which are given by their names or as numbers."""
    for name, value in expected.items():
        value = found[value] if isinstance(value, str) else value
        assert found[name] == pytest.approx(value, rel=rel), name


def columns(rows, *names):
    return np.array([[row[name] for row in rows] for name in names])


def at(t, values, when):
    return values[np.argmin(np.abs(t - when))]


@pytest.mark.parametrize(
    ("demo", "options", "named"),
    [
        ("tied_cylinder", ("--cells", "0"), "--cells 0"),
        pytest.param("ironing", ("--friction", "-1"), "--friction -1", marks=pytest.mark.slow),
    ],
)
def test_options_that_make_no_sense(demo, options, named):
    done = run(*options, demo=demo)
    assert done.returncode == 2 and named in done.stderr and "Traceback" not in done.stderr


# -- small strain


@pytest.mark.slow
@pytest.mark.parametrize(("demo", "ranks"), [("hertz", 2), ("sphere", 1)])
def test_elastic_bodies_come_near_hertz(demo, ranks, tmp_path):
    options = ["--h", "0.25", "--displacement", "0.05", "--steps", "2", "--material", "elastic"]
    options += ["--mesh", "graded"] if demo == "hertz" else ["--surface", "facets"]
    done = run(*options, "--output", str(tmp_path), demo=demo, ranks=ranks)
    assert done.returncode == 0, done.stderr
    found = json.loads((tmp_path / "summary.json").read_text())
    assert found["ranks"] == ranks and len(found["steps"]) == 2
    last = found["steps"][-1]
    near(last, 0.05, peak_pressure_fit="peak_pressure_hertz")
    assert last["certificate"]["equilibrium"] < 1e-6
    assert last["max_plastic_strain"] == last["max_back_stress"] == 0.0
    pictures = list(tmp_path.glob("*.png"))
    assert len(pictures) >= 3 and all(p.stat().st_size > 5000 for p in pictures)
    assert (tmp_path / f"{demo}.xdmf").exists()


@pytest.mark.slow
def test_the_ball_joint_shows_what_facets_do(tmp_path):
    """On the coarsest mesh: forces twice or three times those of smooth surfaces."""
    done = run("--meshes", "1", "--output", str(tmp_path), demo="ball_joint")
    assert done.returncode == 0, done.stderr
    rows = re.findall(r"slave (\w+), (\w+): (\d+) N, (\d+) MPa", done.stdout)
    force = {(slave, surface): float(F) for slave, surface, F, _ in rows}
    for slave in ("socket", "ball"):
        assert force[slave, "smooth"] == pytest.approx(SOCKET_FORCE, rel=0.04)
        assert force[slave, "facets"] > 2.0 * SOCKET_FORCE
    assert (tmp_path / "pressure.png").stat().st_size > 5000


@pytest.mark.slow
def test_a_bolted_joint_from_cad_carries_its_preload_until_it_opens(tmp_path):
    """Tight: all forces are the preload; open: the bolt carries the pull; between: B = C + W."""
    steps = summary(tmp_path, "assembly", "--size", "3", ranks=2)["steps"]
    names = "bolt and upper plate", "lower plate and nut", "lower plate and upper plate"
    near(steps[0], 1e-6, pull=0.0, bolt=20e3, **dict.fromkeys(names, 20e3))
    for step in steps:
        near(step, 1e-6, bolt=step["pull"] + step[names[2]], **dict.fromkeys(names[:2], "bolt"))
    assert steps[2]["bolt"] < 1.03 * 20e3 and steps[2]["pull"] == 10e3
    assert steps[-1][names[2]] == 0.0 and steps[-1]["pull"] == 25e3


@pytest.mark.slow
@pytest.mark.parametrize(("interference", "yields"), [("0.97", False), ("1.05", True)])
def test_first_yield_is_at_the_analytic_load(interference, yields, tmp_path):
    options = "--interference", interference, "--steps", "1", "--h", "0.05"
    (step,) = summary(tmp_path, "indentation", *options)["steps"]
    assert (step["plastic_volume"] > 0.0) == yields
    near(step, 0.01, force=float(interference) ** 1.5)


@pytest.mark.slow
def test_constants_are_identified_from_all_starts():
    """Those of the noise-free curve, in at most 15 iterations of Gauss and Newton's method."""
    found = read(shown("identify"))
    assert len(found["runs"]) == 3
    for run in found["runs"]:
        assert run["iterations"] <= 15
        near(run, 1e-6, **found["expected"])


@pytest.mark.slow
def test_a_ball_is_flattened_as_others_have_found():
    """Force within 5 % of either fit, contact radius to the facet."""
    steps = read(shown("indentation"))["steps"]
    near(steps[-1], 1e-6, interference=50.0)
    for step in steps:
        for fit in ("jackson_green", "kogut_etsion"):
            near(step, 0.05, force=f"force_{fit}")
            near(step, 0.08, contact_radius=f"contact_radius_{fit}")
    assert steps[0]["mean_pressure"] < 1.2 and 2.2 < steps[-1]["mean_pressure"] < 2.8


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ranks", "options"), [(1, ["--slave", "inner"]), (2, ["--cell", "triangle"])]
)
def test_the_tied_tube_reaches_its_limit_load(ranks, options, tmp_path):
    """Within 0.5 % in one piece, and as two rings within 0.2 % of that in every step."""
    options += ["--cells", "4", "--volumetric", "full" if ranks > 1 else "reduced"]
    files = {"ranks": ranks, "file": "monolithic", "picture": "limit"}
    whole = summary(tmp_path, "tied_cylinder", *options, **files)
    tied = read(tmp_path, "tied", "limit")["steps"]
    one, two = (columns(steps, "pressure")[0] for steps in (whole["steps"], tied))
    limit = 2 / 3**0.5 * 250 * math.log(1.3)
    near(whole, 1e-12, limit=limit)
    assert one[-1] == pytest.approx(limit, rel=0.005) and one[-1] - one[-2] < 0.001 * limit
    assert two == pytest.approx(one, rel=0.002)
    assert all(step["certificate"]["equilibrium"] < 1e-6 for step in tied)


# -- finite strain


def steps_shown(demo, frames=1):
    """Return the rows of a demo whose picture moves in as many frames."""
    folder = shown(demo)
    rows = read(folder)["steps"]
    with Image.open(folder / f"{demo}.gif") as moving:
        assert moving.n_frames >= len(rows) // frames  # equal ones are one
    return rows


@pytest.mark.slow
def test_a_tool_is_dragged_as_others_have_found():
    """Forces between the lowest and the highest of six programs, and Coulomb's ratio."""
    rows = steps_shown("ironing")
    t, V, H = columns(rows, "time", "vertical", "horizontal")
    assert 267.9 < at(t, V, 1.0) < 332.0 and 55.0 < at(t, H, 1.0) < 71.0
    assert 337.5 < at(t, V, 1.5) < 421.0 and 102.1 < at(t, H, 1.5) < 188.8
    sliding = (t > 1.07) & (t < 1.83)
    assert np.all((H > 0.3 * V)[sliding]) and np.all((H < 0.36 * V)[sliding])
    assert all(row["parts"] == 1 for row in rows)
    assert np.mean(columns(rows, "newton_iterations")) < 4.5
    assert min(row["smallest_J"] for row in rows) > 0.6


@pytest.mark.slow
def test_a_rubber_cylinder_is_pressed_as_others_have_found():
    """The forces of Sussman and Bathe's graph, and an energy that is the work of the plates."""
    rows = steps_shown("rubber")
    d, F, stored, work = columns(rows, "approach", "force", "stored", "work")
    assert 241.0 < at(d, F, 100.0) < 267.0 and 1350.0 < at(d, F, 200.0) < 1435.0
    # the trapezoidal rule is too large by d^2/12 (F' - F'(0)), and so by less than with F' at last
    error = (d[1] - d[0]) / 12 * (F[-1] - F[-2])
    assert stored[-1] < work[-1] < stored[-1] + 1.5 * error
    assert all(row["stored_in_plate"] < 1e-3 * row["stored"] for row in rows)
    assert max(row["newton_iterations"] for row in rows) <= 8
    assert max(row["volume_change"] for row in rows) < 0.01  # pressure over bulk modulus


def check_beams(rows, friction):
    """Reactions of Neto and others up to the largest one, to 3 % of it; the beams part."""
    d, Rx, Ry = columns(rows, "motion", "reaction_x", "reaction_y")
    when, largest = LARGEST[friction]
    assert Ry.max() == pytest.approx(largest, rel=0.03)
    assert abs(d[np.argmax(Ry)] - when) < 0.6  # a step is 0.5 mm
    room = 0.03 * largest
    for k, R in enumerate((Rx, Ry)):
        for motion, force in zip(MOTION, REACTIONS[friction][k], strict=True):
            if force is not None:  # forces fall by up to 5 N/mm in a mm: at most 0.2 mm late
                by = np.interp([motion - 0.2, motion, motion + 0.2], d, R)
                assert by.min() - room < force < by.max() + room
    assert sum(row["parts"] - 1 for row in rows) <= 1
    if friction < 0.5:
        assert rows[-1]["in_contact"] == 0 and abs(Ry[-1]) < 1e-6 * largest
        assert 28.5 < d[Ry > 1e-3].max() < 31.5


@pytest.mark.slow
def test_curved_beams_slide_as_others_have_found():
    rows = steps_shown("curved_beams", frames=2)
    check_beams(rows, 0.0)
    assert np.mean(columns(rows, "newton_iterations")) < 5.0
    dissipated, stored = (np.array([sum(r[n]) for r in rows]) for n in ("dissipated", "stored"))
    assert (np.diff(dissipated) > -1e-9 * dissipated[-1]).all()
    d, R = columns(rows, "motion", "reaction_x")
    energy, moved = dissipated + stored, np.diff([0.0, *d])
    # the ends move along x alone, and do the work of the feet's force
    work = -np.cumsum((R + np.append(0.0, R[:-1])) / 2 * moved)
    assert at(d, work, 10.0) == pytest.approx(at(d, energy, 10.0), rel=0.002)
    # sliding over corners of the facets: 2.3 % in the end, 0.6 % with twice as many cells along
    assert work[-1] == pytest.approx(energy[-1], rel=0.03)


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.3, 0.6])
def test_curved_beams_with_friction(friction, tmp_path):
    options = "--friction", str(friction), "--no-animation"
    check_beams(summary(tmp_path, "curved_beams", *options)["steps"], friction)


# -- friction


@pytest.mark.slow
def test_a_disc_pushed_to_and_fro_is_cattaneos():
    """Stick zone to the facet, tractions and the energy of the closed loop to two per cent."""
    found, h = read(shown("cattaneo")), 0.05
    rows = [row for row in found["steps"] if "share" in row]
    assert 0.6 < rows[-1]["share"] < 0.65 and 18.0 < rows[-1]["half_width"] / h < 22.0
    for row in rows:
        assert abs(row["stick_half_width"] - row["stick_half_width_cattaneo"]) < h
        assert row["traction_error"] < 0.02 and row["traction_error_mean"] < 0.02
        assert row["certificate"]["equilibrium"] < 1e-6
    assert found["loop"]["closed_by"] < 1e-4
    near(found["loop"], 0.02, dissipation="cattaneo", area="cattaneo")


def check_sliding(found, mesh):
    """All of the contact slips, and more motion takes no more force."""
    before, last = found["steps"][-2:]
    assert last["slipping"] == last["closed"]
    near(last, 5 * mesh, force=found["sliding_force_mu_N"])
    near(last, 1e-4, force=before["force"])
    moved = last["slid"] - before["slid"]
    assert moved > 0.0
    work = last["dissipation"] - before["dissipation"]
    assert work == pytest.approx(moved * last["force"], rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "mesh"),
    [(("--cells", "5", "--slave", "hub"), 0.002), (("--space", "--cells", "2"), 0.003)],
)
def test_a_shaft_is_held_by_friction(options, mesh, tmp_path):
    """Lame's pressure, a shaft that dead loads do not move, and Coulomb's force where it slides."""
    found = summary(tmp_path, "shrink_fit", *options)
    held = found["steps"][-5]
    near(found, mesh, pressure="pressure_lame")
    assert held["time"] == 2.0 and 0 < held["slipping"] < held["closed"]
    near(held, 5 * mesh, force=0.9 * found["sliding_force_lame"])
    near(found, 5 * mesh, sliding_force="sliding_force_stretched")
    check_sliding(found, mesh)


@pytest.mark.slow
def test_a_hub_that_flows_holds_less(tmp_path):
    """Its pressure is bounded by Tresca's rule; the shaft slides at Coulomb's force again."""
    found = summary(tmp_path, "shrink_fit", "--plastic")
    assert found["pressure_tresca"] < found["pressure"] < found["pressure_tresca_upper"]
    assert found["pressure"] < 0.8 * found["pressure_lame"]
    check_sliding(found, 0.002)


# -- tools


@pytest.mark.slow
def test_the_modulus_and_hardness_of_a_metal(tmp_path):
    """The modulus of the true area is the one put in; that of Oliver and Pharr is too large."""
    options = "--tool", "cone", "--h", "0.2", "--steps", "10"
    whole = summary(tmp_path, "hardness", *options, file="cone")
    found = whole["found"]
    near(found, 0.05, modulus_contact="modulus_given")
    # Bolshakov and Pharr (1998): metals without hardening pile up by up to a fifth or more
    assert 1.1 < found["piled_up"] < 1.3
    assert found["modulus_oliver_pharr"] > 1.1 * found["modulus_given"]
    # Tabor (1951): nearly three; 2.6 to 2.8 by computations with cones of this angle
    assert 2.3 < found["hardness_contact"] / found["yield_stress"] < 3.0
    # forces stay far from their balance for a dozen iterations, gaps do not
    assert all(step["parts"] == 1 for step in whole["steps"])


@pytest.mark.slow
def test_a_ball_in_a_metal(tmp_path):
    """First as Hertz says, then as Johnson's cavity, in the end nearly three yield stresses."""
    options = "--tool", "ball", "--h", "0.2", "--steps", "12"
    whole = summary(tmp_path, "hardness", *options, file="ball")
    found = whole["found"]
    near(found, 0.02, first_force_over_hertz=1.0)
    cavity = [row for row in whole["steps"] if 1.8 < row.get("pressure_cavity", 0.0) < 2.5]
    assert len(cavity) >= 3
    for row in cavity:
        near(row, 0.05, force=row["area"] * row["pressure_cavity"])
    assert 2.5 < found["hardness_contact"] / found["yield_stress"] < 3.0
    near(found, 0.08, modulus_contact="modulus_given")
    # its impression is shallow: less is piled up than beside a cone
    assert 1.0 < found["piled_up"] < 1.15
    assert found["modulus_contact"] < found["modulus_oliver_pharr"]


@pytest.mark.slow
@pytest.mark.parametrize(("tool", "error"), [("cone", 0.02), ("berkovich", 0.025)])
def test_tools_on_an_elastic_half_space(tmp_path, tool, error):
    """Hay, Bolshakov, Pharr (1999): 6.7 % over Sneddon; Larsson's computations (1996)."""
    options = "--tool", tool, "--elastic", "--h", "0.15", "--steps", "1"
    near(summary(tmp_path, "hardness", *options, file=tool)["found"], error, force_over_theory=1.0)


@pytest.mark.slow
def test_a_cup_is_drawn():
    whole = read(shown("deep_drawing"))
    found, steps = whole["found"], whole["steps"]
    # 144 in 35 steps; loads of tools that a QP misses by its own tolerance take four times as many
    assert sum(step["newton_iterations"] for step in steps) <= 160
    assert not any("parts" in note for step in steps for note in step["notes"])
    # a rim that nothing pulls: uniaxial compression around the axis (Hill 1950)
    near(found, 0.01, thickness_of_rim="thickness_hill")
    near(found, 0.2, largest_force="largest_force_siebel")  # what that estimate is worth
    near(found, 1e-4, holder=10_000.0)


# -- dynamics


@pytest.mark.slow
def test_the_last_rod_of_the_cradle_leaves(tmp_path):
    """It has the velocity of the first, in the time and by the force of a wave."""
    found = summary(tmp_path, "newtons_cradle", "--cells", "16")["found"]
    near(found, 0.02, velocity_of_the_last=1.0, force="force_saint_venant")
    assert abs(found["velocity_of_the_first"]) < 0.02 > abs(found["velocity_of_the_second"])
    near(found, 0.05, time_of_contact="time_of_contact_saint_venant")
    assert found["largest_defect_of_energy"] < 1e-6


@pytest.mark.slow
def test_two_rings_that_collide():
    """Momentum is kept, velocities say what is left as vibrations, the oval rings as it must."""
    found = read(shown("bouncing_rings"))["found"]
    assert abs(found["momentum_lost"]) < 1e-8
    defect, expected = found["largest_defect_of_energy"], found["vibrations_by_momentum"]
    assert defect < 2e-3 and 0.05 < expected < 0.4
    assert found["vibrations"] == pytest.approx(expected, abs=1.5 * defect)
    assert 0.0 < found["velocity_of_the_first"] < 0.3
    near(found, 5e-3, period="period_of_a_thin_ring")


@pytest.mark.slow
def test_a_bar_that_hits_a_wall(tmp_path):
    """Radii and length of codes that do not lock, extrapolated; the energy becomes heat."""
    options = "--cells", "2", "--dt", "0.05", "--no-animation"
    whole = summary(tmp_path, "taylor_bar", *options, ranks=2)
    found, ledger = whole["found"], whole["steps"][-1]["ledger"]
    assert found["steps"] == len(whole["steps"]) == 600
    near(found, 3e-3, radius_after_12_microseconds=5.45, radius=7.226)
    assert 7.19 < found["radius"] < 7.27 and 21.35 < found["length"] < 21.50
    near(found, 2e-3, length=21.42)
    assert found["largest_defect_of_energy"] < 1e-3
    # 1/2 m v^2 in mJ, of 8930 kg/m^3
    near(ledger, 0.02, initial=0.5 * 8.93e-9 * math.pi * 3.2**2 * 32.4 * 227e3**2)
    assert ledger["kinetic"] < 2e-3 * ledger["initial"]
    assert ledger["dissipated"] > 0.85 * ledger["initial"]

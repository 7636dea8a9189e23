# SPDX-License-Identifier: MIT
"""The demos at finite strain as commands, beside forces that others have published."""

import json

import meshio
import numpy as np
import pytest
from PIL import Image

from demos.curved_beams.literature import LARGEST, MOTION, REACTIONS
from tests.test_demo import DEMOS, run, shown

pytestmark = pytest.mark.serial


def steps_of(folder, demo, *options):
    """Run a demo and return the rows of its steps."""
    done = run(*options, "--no-animation", "--output", str(folder), demo=demo)
    assert done.returncode == 0, done.stderr
    return rows_in(folder)


def rows_in(folder):
    return json.loads((folder / "summary.json").read_text())["steps"]


def check_file(path):
    """Of the file at every step: J is the ratio of areas at X + u and X, stresses are finite."""
    with meshio.xdmf.TimeSeriesReader(path) as reader:
        points, (block,) = reader.read_points_cells()
        for k in range(reader.num_steps):
            _, node, cell = reader.read_data(k)
            x = points[:, :2] + node["displacement"][:, :2]
            ratio = area(x[block.data]) / area(points[block.data, :2])
            np.testing.assert_allclose(cell["J"][0], ratio, rtol=1e-9)
            assert np.isfinite(cell["von_mises"][0]).all()


def area(corners):
    """Return the areas of quadrilaterals (m, 4, 2)."""
    a, b = corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]
    return (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2


def check_pictures(folder, demo, steps):
    """A picture and an animation of steps; the picture in the repository is a small one."""
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
    check_file(folder / "ironing.xdmf")
    t, V, H = forces(rows)
    assert 267.9 < at(t, V, 1.0) < 332.0 and 55.0 < at(t, H, 1.0) < 71.0
    assert 337.5 < at(t, V, 1.5) < 421.0 and 102.1 < at(t, H, 1.5) < 188.8
    sliding = (t > 1.07) & (t < 1.83)
    assert np.all((H > 0.3 * V)[sliding]) and np.all((H < 0.36 * V)[sliding])
    assert all(row["parts"] == 1 for row in rows)
    assert np.mean([row["newton_iterations"] for row in rows]) < 4.5
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
    """V within 1.5 % of the default's while the tool is down and dragged, and no step is cut."""
    t, V, _ = forces(rows_in(shown("ironing")))
    rows = steps_of(tmp_path, "ironing", *options)
    assert all(row["parts"] == 1 for row in rows)
    assert np.mean([row["newton_iterations"] for row in rows]) < 6.0
    _, W, _ = forces(rows)
    down = t > 0.95
    assert np.abs(V - W)[down].max() < 0.015 * V.max()


def check_cylinder(rows):
    """The forces of Sussman and Bathe's graph, and an energy that is the work of the plates."""
    d, F, stored, work = (
        np.array([row[name] for row in rows]) for name in ("approach", "force", "stored", "work")
    )
    assert 241.0 < at(d, F, 100.0) < 267.0
    assert 1350.0 < at(d, F, 200.0) < 1435.0
    # the trapezoidal rule is too large by d^2/12 (F' - F'(0)), and so by less than with F' at last
    step = d[1] - d[0]
    error = step**2 / 12 * (F[-1] - F[-2]) / step
    assert stored[-1] < work[-1] < stored[-1] + 1.5 * error
    assert all(row["stored_in_plate"] < 1e-3 * row["stored"] for row in rows)


@pytest.mark.slow
def test_a_rubber_cylinder_is_pressed_as_others_have_found():
    folder = shown("rubber")
    rows = rows_in(folder)
    check_pictures(folder, "rubber", len(rows))
    check_file(folder / "rubber.xdmf")
    check_cylinder(rows)
    assert max(row["newton_iterations"] for row in rows) <= 8
    assert max(row["volume_change"] for row in rows) < 0.01  # pressure over bulk modulus


@pytest.mark.nightly
@pytest.mark.slow
def test_rubber_of_second_order_needs_no_more_force(tmp_path):
    """Triangles of second order: within 1 % of the quadrilaterals where the contact is wide."""
    options = ("--cell", "triangle", "--degree", "2", "--h", "25", "--steps", "10")
    rows = steps_of(tmp_path, "rubber", *options)
    check_cylinder(rows)
    first = rows_in(shown("rubber"))
    for row in rows[4:]:
        (same,) = (r for r in first if abs(r["approach"] - row["approach"]) < 1e-9)
        assert row["force"] == pytest.approx(same["force"], rel=0.01)


def check_beams(rows, friction):
    """Reactions of Neto and others up to the largest one, to 3 % of it; the beams part."""
    d, Rx, Ry = (
        np.array([row[name] for row in rows]) for name in ("motion", "reaction_x", "reaction_y")
    )
    when, largest = LARGEST[friction]
    assert Ry.max() == pytest.approx(largest, rel=0.03)
    assert abs(d[np.argmax(Ry)] - when) < 0.6  # a step is 0.5 mm
    for k, R in enumerate((Rx, Ry)):
        known = zip(MOTION, REACTIONS[friction][k], strict=True)
        for motion, force in ((m, F) for m, F in known if F is not None):
            # beyond the largest, where forces fall by up to 5 N/mm in a mm: at most 0.2 mm late
            near = np.interp([motion - 0.2, motion, motion + 0.2], d, R)
            room = 0.03 * largest
            assert near.min() - room < force < near.max() + room
    assert sum(row["parts"] - 1 for row in rows) <= 1
    if friction < 0.5:
        assert rows[-1]["in_contact"] == 0 and abs(Ry[-1]) < 1e-6 * largest
        assert 28.5 < d[Ry > 1e-3].max() < 31.5


@pytest.mark.slow
def test_curved_beams_slide_as_others_have_found():
    folder = shown("curved_beams")
    rows = rows_in(folder)
    check_pictures(folder, "curved_beams", len(rows) // 2)
    check_file(folder / "curved_beams.xdmf")
    check_beams(rows, 0.0)
    assert np.mean([row["newton_iterations"] for row in rows]) < 5.0
    dissipated = np.array([sum(row["dissipated"]) for row in rows])
    assert (np.diff(dissipated) > -1e-9 * dissipated[-1]).all()
    d, R = (np.array([row[name] for row in rows]) for name in ("motion", "reaction_x"))
    energy = dissipated + [sum(row["stored"]) for row in rows]
    moved = np.diff([0.0, *d])  # the ends move along x alone, and do the work of the feet's force
    work = -np.cumsum((R + np.append(0.0, R[:-1])) / 2 * moved)
    assert at(d, work, 10.0) == pytest.approx(at(d, energy, 10.0), rel=0.002)
    # sliding over corners of the facets: 2.3 % in the end, 0.6 % with twice as many cells along
    assert work[-1] == pytest.approx(energy[-1], rel=0.03)


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.3, 0.6])
def test_curved_beams_with_friction(friction, tmp_path):
    check_beams(steps_of(tmp_path, "curved_beams", "--friction", str(friction)), friction)


@pytest.mark.parametrize(
    ("demo", "options", "named"),
    [
        pytest.param("curved_beams", ("--steps", "0"), "--steps 0", marks=pytest.mark.slow),
        pytest.param("rubber", ("--approach", "400"), "--approach 400", marks=pytest.mark.slow),
        ("ironing", ("--steps", "2"), "--steps 2"),
        pytest.param("ironing", ("--h", "0.4"), "--h 0.4", marks=pytest.mark.slow),
        pytest.param("ironing", ("--friction", "-1"), "--friction -1", marks=pytest.mark.slow),
    ],
)
def test_options_that_make_no_sense(demo, options, named):
    done = run(*options, demo=demo)
    assert done.returncode == 2 and named in done.stderr and "Traceback" not in done.stderr

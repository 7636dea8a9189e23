# SPDX-License-Identifier: MIT
"""The demos of dynamics as commands, beside Saint-Venant's rods, Hoppe's ring, Taylor's bar."""

import pytest

from tests.test_demo import run, shown
from tests.test_demo_finite import check_pictures
from tests.test_demo_friction import read, summary

pytestmark = pytest.mark.serial
VOLUME = 3.141592653589793 * 3.2**2 * 32.4  # mm^3, of Taylor's bar


def check_cradle(found, velocity, force):
    """The last rod has the velocity of the first, in the time and by the force of a wave."""
    found = found["found"]
    assert found["velocity_of_the_last"] == pytest.approx(1.0, abs=velocity)
    assert abs(found["velocity_of_the_first"]) < velocity
    assert abs(found["velocity_of_the_second"]) < velocity
    assert found["force"] == pytest.approx(found["force_saint_venant"], rel=force)
    exact = found["time_of_contact_saint_venant"]
    assert found["time_of_contact"] == pytest.approx(exact, rel=0.05)
    assert found["largest_defect_of_energy"] < 1e-6


@pytest.mark.slow
def test_the_last_rod_of_the_cradle_leaves(tmp_path):
    check_cradle(summary(tmp_path, "newtons_cradle", "--cells", "16"), 0.02, 0.02)


@pytest.mark.slow
@pytest.mark.nightly
def test_the_cradle_as_the_gallery_shows_it():
    check_cradle(read(shown("newtons_cradle")), 5e-3, 2e-3)


def check_rings(found):
    """Momentum is kept, velocities say what is left as vibrations, and the oval rings as it must.

    Of a thin ring; shear and the rotation of sections make it some tenths of a per cent slower.
    """
    found = found["found"]
    assert abs(found["momentum_lost"]) < 1e-8
    defect = found["largest_defect_of_energy"]
    assert defect < 2e-3
    expected = found["vibrations_by_momentum"]
    assert found["vibrations"] == pytest.approx(expected, abs=1.5 * defect)
    assert 0.05 < expected < 0.4
    assert 0.0 < found["velocity_of_the_first"] < 0.3
    late = found["period"] / found["period_of_a_thin_ring"] - 1.0
    assert abs(late) < 5e-3


@pytest.mark.slow
def test_two_rings_that_collide():
    check_rings(read(shown("bouncing_rings")))


def check_bar(found, steps, early, radius, length):
    """Radii and length of codes that do not lock, extrapolated; the energy becomes heat."""
    found, rows = found["found"], found["steps"]
    assert found["steps"] == len(rows) == steps
    assert found["radius_after_12_microseconds"] == pytest.approx(5.45, rel=early)
    assert found["radius"] == pytest.approx(7.226, rel=radius)
    assert 7.19 < found["radius"] < 7.27 and 21.35 < found["length"] < 21.50
    assert found["length"] == pytest.approx(21.42, rel=length)
    assert found["largest_defect_of_energy"] < 1e-3
    ledger = rows[-1]["ledger"]
    # 1/2 m v^2 in mJ, of 8930 kg/m^3
    assert ledger["initial"] == pytest.approx(0.5 * 8.93e-9 * VOLUME * 227e3**2, rel=0.02)
    assert ledger["kinetic"] < 2e-3 * ledger["initial"]
    assert ledger["dissipated"] > 0.85 * ledger["initial"]


@pytest.mark.slow
def test_a_bar_that_hits_a_wall(tmp_path):
    """Two cells along the radius, on two ranks."""
    options = "--cells", "2", "--dt", "0.05", "--no-animation"
    check_bar(summary(tmp_path, "taylor_bar", *options, ranks=2), 600, 3e-3, 3e-3, 2e-3)


@pytest.mark.slow
@pytest.mark.nightly
def test_the_bar_as_the_gallery_shows_it():
    folder = shown("taylor_bar")
    check_bar(read(folder), 750, 3e-3, 1e-3, 5e-4)
    check_pictures(folder, "taylor_bar", 40)


@pytest.mark.slow
@pytest.mark.parametrize("options", [("--cells", "1"), ("--dt", "0.03"), ("--dt", "0")])
def test_a_bar_that_cannot_be(options):
    done = run(*options, demo="taylor_bar")
    assert done.returncode == 2 and options[0] in done.stderr and "Traceback" not in done.stderr

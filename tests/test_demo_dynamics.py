# SPDX-License-Identifier: MIT
"""The demos of dynamics as commands, beside Saint-Venant's rods and Hoppe's ring."""

import pytest

from tests.test_demo import shown
from tests.test_demo_friction import read, summary

pytestmark = pytest.mark.serial


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

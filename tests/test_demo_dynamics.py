# SPDX-License-Identifier: MIT
"""The demos of dynamics as commands, beside Saint-Venant's rods."""

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

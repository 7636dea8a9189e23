# SPDX-License-Identifier: MIT
"""The demos of rigid tools as commands, beside Sneddon, Tabor, Oliver and Pharr, Siebel, Hill."""

import pytest

from tests.test_demo import shown
from tests.test_demo_friction import read, summary

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


@pytest.mark.slow
def test_the_modulus_and_hardness_of_a_metal(tmp_path):
    check_metal(summary(tmp_path, "hardness", "--h", "0.2", "--steps", "10"), 0.05)


@pytest.mark.slow
def test_a_cone_on_an_elastic_half_space(tmp_path):
    """Hay, Bolshakov and Pharr (1999): 6.7 % more than Sneddon's force."""
    found = summary(tmp_path, "hardness", "--elastic", "--h", "0.2", "--steps", "1")["found"]
    assert found["force_over_sneddon"] == pytest.approx(found["factor"], abs=0.02)


@pytest.mark.slow
@pytest.mark.nightly
def test_the_hardness_as_the_gallery_shows_it():
    check_metal(read(shown("hardness")), 0.02)


@pytest.mark.slow
@pytest.mark.nightly
def test_a_cup_is_drawn():
    found = read(shown("deep_drawing"))["found"]
    # a rim that nothing pulls: uniaxial compression around the axis (Hill 1950)
    assert found["thickness_of_rim"] == pytest.approx(found["thickness_hill"], rel=0.01)
    # what Siebel's estimate of the force is worth
    assert found["largest_force"] == pytest.approx(found["largest_force_siebel"], rel=0.2)
    assert found["holder"] == pytest.approx(10_000.0, rel=1e-4)

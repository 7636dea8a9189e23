# SPDX-License-Identifier: MIT
"""Partial slip of a point contact against equilibrium and the compliance of circles that stick."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad

from dolfinx_mortar import analytic

MU, E, NU = 0.2, 206_900.0, 0.29
CONTACT = analytic.hertz_point(5036.0, 8.0, E, NU, E, NU)
A, LIMIT = CONTACT.contact_radius, MU * CONTACT.force
HISTORIES = [(0.3,), (-0.85,), (1.0,), (0.7, 0.1), (0.7, -0.7), (-0.9, 0.4, -0.2)]


def state(*shares):
    """Return the contact after tangential forces in units of mu P."""
    return analytic.mindlin_point(CONTACT, MU, NU, tuple(share * LIMIT for share in shares))


@pytest.mark.parametrize("history", HISTORIES)
def test_traction_carries_the_force_within_coulomb(history):
    s = state(*history)
    ends = sorted({0.0, A, *s.stick_radii})
    carried = sum(
        quad(lambda r: 2 * np.pi * r * float(s.traction(r)), *ab, epsrel=1e-10)[0]
        for ab in pairwise(ends)
    )
    assert carried == pytest.approx(history[-1] * LIMIT, abs=1e-8 * LIMIT)
    r = np.linspace(0.0, 1.1 * A, 501)
    q, limit = s.traction(r), MU * CONTACT.pressure(r)
    assert (np.abs(q) <= limit + 1e-12 * limit.max()).all()
    slips = r > s.stick_radius
    assert np.allclose(q[slips], np.sign(s.weights[-1]) * limit[slips], atol=1e-9 * limit.max())


@pytest.mark.parametrize("share", [0.2, 0.6, 0.95, 1.0])
def test_displacement_is_that_of_circles_that_stick(share):
    """Each part of the force moves two half spaces on a circle of radius c: (2 - nu)/(4 G c)."""
    G = E / (2 * (1 + NU))
    expected, _ = quad(
        lambda Q: (2 - NU) / (4 * G * state(Q / LIMIT).stick_radius), 0.0, share * LIMIT
    )
    assert state(share).displacement == pytest.approx(expected, rel=1e-6)
    assert state(share, -share).displacement == pytest.approx(-expected, rel=1e-6)


@pytest.mark.parametrize("share", [0.2, 0.6, 0.95, 1.0])
def test_a_loop_dissipates_what_it_encloses(share):
    v = np.sin(np.linspace(-np.pi / 2, np.pi / 2, 2001))
    motion = [state(share, share * float(at)).displacement for at in v[:-1]]
    motion.append(state(share).displacement)
    Q = share * LIMIT * v
    area = 2.0 * abs(np.sum(0.5 * (Q[1:] + Q[:-1]) * np.diff(motion)))
    first, loop = state(share), state(share, -share, share)
    assert loop.dissipation - first.dissipation == pytest.approx(area, rel=1e-5)
    assert loop.dissipation == pytest.approx(5 * first.dissipation, rel=1e-12)


@pytest.mark.parametrize(
    ("friction", "nu", "force", "words"),
    [
        (0.0, NU, 1.0, "friction is "),
        (MU, 0.5, 1.0, "nu is "),
        (MU, NU, 1.01 * LIMIT, "the whole contact slides"),
        (MU, NU, (0.5 * LIMIT, -0.6 * LIMIT), "closes a loop"),
        (MU, NU, "1", "force is "),
    ],
)
def test_bad_numbers_are_named(friction, nu, force, words):
    with pytest.raises(ValueError, match=words):
        analytic.mindlin_point(CONTACT, friction, nu, force)

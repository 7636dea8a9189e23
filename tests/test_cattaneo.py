# SPDX-License-Identifier: MIT
"""Partial slip of a line contact against independent quadrature of line forces on half planes."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad

from dolfinx_mortar import analytic

MU = 0.2
CONTACT = analytic.hertz_line(2427.22, 8.0, *(206_900.0, 0.29) * 2)
A, LIMIT = CONTACT.half_width, MU * CONTACT.force
HISTORIES = [
    (0.3,),
    (-0.85,),
    (1.0,),
    (0.7, 0.1),
    (0.7, -0.7),
    (-0.9, 0.4, -0.2),
    (0.6, -0.5, 0.3, 0.0),
]


def state(*shares):
    """Return the contact after tangential forces in units of mu P."""
    return analytic.cattaneo_line(CONTACT, MU, tuple(share * LIMIT for share in shares))


def integrate(function, contact_state, *more):
    """Integrate over the contact, piece by piece between all points where something is singular."""
    points = {0.0, -A, A, *more}
    points |= {sign * c for c in contact_state.stick_half_widths for sign in (-1.0, 1.0)}
    pieces = pairwise(sorted(points))
    return sum(quad(function, *ab, epsabs=0.0, epsrel=1e-11, limit=200)[0] for ab in pieces)


@pytest.mark.parametrize("history", HISTORIES)
def test_traction_carries_the_force(history):
    s = state(*history)
    carried = integrate(lambda x: float(s.traction(x)), s)
    assert carried == pytest.approx(history[-1] * LIMIT, rel=1e-8, abs=1e-8 * LIMIT)
    assert s.force == history[-1] * LIMIT


@pytest.mark.parametrize("history", HISTORIES)
def test_coulomb_holds_and_the_edges_are_at_its_limit(history):
    """Where the last leg slips, the traction is the limit, in the direction of that leg."""
    s = state(*history)
    x = np.linspace(-1.1 * A, 1.1 * A, 1101)
    q, limit = s.traction(x), MU * CONTACT.pressure(x)
    assert (np.abs(q) <= limit + 1e-12 * limit.max()).all()
    slips = np.abs(x) > s.stick_half_width
    assert slips.any()
    assert np.allclose(q[slips], np.sign(s.weights[-1]) * limit[slips], atol=1e-9 * limit.max())


@pytest.mark.parametrize("share", [0.2, 0.6, 0.95, 1.0])
def test_displacement_is_that_of_line_forces(share):
    """What is left of it without that of a contact that sticks, q = Q/(pi sqrt(a^2 - x^2))."""
    s = state(share)
    found = integrate(lambda at: float(s.traction(at)) * np.log(2.0 * abs(at) / A), s)
    expected = -2.0 / (np.pi * CONTACT.E_star) * found
    assert s.displacement == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize("share", [0.2, 0.6, 0.95, 1.0])
def test_a_loop_dissipates_what_it_encloses(share):
    """The area of force against displacement is four times the energy of the first loading."""
    first, there, back = state(share), state(share, -share), state(share, -share, share)
    assert np.allclose(back.traction([0.0, 0.9 * A]), first.traction([0.0, 0.9 * A]), rtol=1e-12)
    assert there.displacement == pytest.approx(-first.displacement, rel=1e-12)
    # with x as the variable of each leg, so that the logarithm at its end is tame
    x = np.sin(np.linspace(-np.pi / 2, np.pi / 2, 2001))
    legs = [(state(share, share * v).displacement, share * v * LIMIT) for v in x[:-1]]
    legs.append((first.displacement, share * LIMIT))
    down = np.array(legs)
    area = np.sum(0.5 * (down[1:, 1] + down[:-1, 1]) * np.diff(down[:, 0]))
    enclosed = -2.0 * area  # the way up is the image of the way down
    loop = back.dissipation - first.dissipation
    assert loop == pytest.approx(4.0 * first.dissipation, rel=1e-12)
    assert abs(enclosed) == pytest.approx(loop, rel=1e-5)


def test_little_slip_dissipates_with_the_cube():
    first, second = (state(share).dissipation for share in (1e-3, 2e-3))
    assert second / first == pytest.approx(8.0, rel=3e-3)
    full = LIMIT**2 / (2.0 * np.pi * CONTACT.E_star)
    assert first == pytest.approx(full * 1e-9 / 3.0, rel=1e-3)


@pytest.mark.parametrize("share", [0.0, 0.25, 0.75, 1.0])
def test_stick_zone(share):
    assert state(share).stick_half_width == pytest.approx(A * np.sqrt(1 - share), abs=1e-12)


@pytest.mark.parametrize(
    ("friction", "force", "words"),
    [
        (0.0, 1.0, "friction is "),
        (np.nan, 1.0, "friction is "),
        (MU, 1.01 * LIMIT, "the whole contact slides"),
        (MU, -1.01 * LIMIT, "the whole contact slides"),
        (MU, (0.5 * LIMIT, -0.6 * LIMIT), "closes a loop"),
        (MU, (0.5 * LIMIT, -0.2 * LIMIT, 0.7 * LIMIT), "closes a loop"),
        (MU, (0.2 * LIMIT, 0.3 * LIMIT), "let it turn at every value"),
        (MU, np.nan, "force is "),
        (MU, (), "force is "),
        (MU, "1", "force is "),
        (MU, (1.0, None), "force is "),
    ],
)
def test_bad_numbers_are_named(friction, force, words):
    with pytest.raises(ValueError, match=words):
        analytic.cattaneo_line(CONTACT, friction, force)


@pytest.mark.parametrize("x", [np.nan, "1", [0.0, None]])
def test_bad_places_are_named(x):
    with pytest.raises(ValueError, match=r"^x is "):
        state(0.5).traction(x)


@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0])
def test_loops_close_up_to_round_off(factor, monkeypatch):
    """Back and forth between the same forces, as sums have them; a per mille more is refused."""
    monkeypatch.setattr(analytic, "HALF_OF_DIGITS", factor * analytic.HALF_OF_DIGITS)
    Q = 0.3 * LIMIT
    expected = analytic.cattaneo_line(CONTACT, MU, [Q, -Q, Q]).dissipation
    found = analytic.cattaneo_line(CONTACT, MU, [Q, -Q * (1.0 + 4e-16), Q]).dissipation
    assert found == pytest.approx(expected)
    with pytest.raises(ValueError, match="loop"):
        analytic.cattaneo_line(CONTACT, MU, [Q, -1.001 * Q, 1.002 * Q])


def test_without_round_off_a_loop_does_not_close(monkeypatch):
    monkeypatch.setattr(analytic, "HALF_OF_DIGITS", -1e-3)
    Q = 0.3 * LIMIT
    with pytest.raises(ValueError, match="loop"):
        analytic.cattaneo_line(CONTACT, MU, [Q, -Q, Q])

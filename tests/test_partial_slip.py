# SPDX-License-Identifier: MIT
"""Partial slip of line and point contacts against quadrature, and compliances in closed form."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad

from dolfinx_mortar import analytic

MU, E, NU = 0.2, 206_900.0, 0.29
STEEL = E, NU, E, NU


@dataclass
class Slip:
    """A contact after tangential forces in units of mu P."""

    contact: object
    size: float  # half-width or radius
    of: object  # function of forces
    ends: tuple[str, str]  # names of where it sticks, now and in all legs

    def __call__(self, *shares):
        return self.of(tuple(share * self.limit for share in shares))

    @property
    def limit(self):
        return MU * self.contact.force

    def sticks(self, s):
        return getattr(s, self.ends[0])

    def integrate(self, s, weight):
        """Integrate over the contact between all points where something is singular."""
        ends = {0.0, self.size, *getattr(s, self.ends[1])}
        ends |= {-x for x in ends} if self is LINE else set()
        return sum(
            quad(lambda x: float(s.traction(x)) * weight(x), *ab, epsrel=1e-10, limit=200)[0]
            for ab in pairwise(sorted(ends))
        )


AT_LINE, AT_POINT = (
    analytic.hertz_line(2427.22, 8.0, *STEEL),
    analytic.hertz_point(5036.0, 8.0, *STEEL),
)
LINE = Slip(
    AT_LINE,
    AT_LINE.half_width,
    lambda force: analytic.cattaneo_line(AT_LINE, MU, force),
    ("stick_half_width", "stick_half_widths"),
)
POINT = Slip(
    AT_POINT,
    AT_POINT.contact_radius,
    lambda force: analytic.mindlin_point(AT_POINT, MU, NU, force),
    ("stick_radius", "stick_radii"),
)
KINDS = pytest.mark.parametrize("slip", [LINE, POINT], ids=["line", "point"])
SHARES = pytest.mark.parametrize("share", [0.2, 0.95, 1.0])


@KINDS
@pytest.mark.parametrize(
    "history", [(-0.85,), (1.0,), (0.7, 0.1), (0.7, -0.7), (0.6, -0.5, 0.3, 0.0)]
)
def test_traction_carries_the_force_within_coulomb(slip, history):
    """Where the last leg slips, the traction is the limit, in the direction of that leg."""
    s = slip(*history)
    weight = (lambda x: 1.0) if slip is LINE else (lambda r: 2 * np.pi * r)
    assert slip.integrate(s, weight) == pytest.approx(s.force, rel=1e-8, abs=1e-8 * slip.limit)
    assert s.force == history[-1] * slip.limit
    x = np.linspace(0.0 if slip is POINT else -1.1 * slip.size, 1.1 * slip.size, 1101)
    q, limit = s.traction(x), MU * slip.contact.pressure(x)
    assert (np.abs(q) <= limit + 1e-12 * limit.max()).all()
    slips = np.abs(x) > slip.sticks(s)
    assert slips.any()
    assert np.allclose(q[slips], np.sign(s.weights[-1]) * limit[slips], atol=1e-9 * limit.max())


@SHARES
def test_displacement_of_a_line_is_that_of_line_forces(share):
    """What is left of it without that of a contact that sticks, q = Q/(pi sqrt(a^2 - x^2))."""
    s = LINE(share)
    found = LINE.integrate(s, lambda x: np.log(2.0 * abs(x) / LINE.size))
    assert s.displacement == pytest.approx(-2.0 / (np.pi * AT_LINE.E_star) * found, rel=1e-7)


@SHARES
def test_displacement_of_a_point_is_that_of_circles_that_stick(share):
    """Each part of the force moves two half spaces on a circle of radius c: (2 - nu)/(4 G c)."""
    G = E / (2 * (1 + NU))
    expected, _ = quad(
        lambda Q: (2 - NU) / (4 * G * POINT(Q / POINT.limit).stick_radius), 0, share * POINT.limit
    )
    assert POINT(share).displacement == pytest.approx(expected, rel=1e-6)


@KINDS
@SHARES
def test_a_loop_dissipates_what_it_encloses(slip, share):
    """The area of force against displacement is four times the energy of the first loading."""
    first, there, back = slip(share), slip(share, -share), slip(share, -share, share)
    at = [0.0, 0.9 * slip.size]
    assert np.allclose(back.traction(at), first.traction(at), rtol=1e-12)
    assert there.displacement == pytest.approx(-first.displacement, rel=1e-12)
    # with x as the variable of each leg, so that the logarithm at its end is tame
    v = np.sin(np.linspace(-np.pi / 2, np.pi / 2, 2001))
    motion = [*(slip(share, share * float(x)).displacement for x in v[:-1]), first.displacement]
    Q = share * slip.limit * v
    area = 2.0 * abs(np.sum(0.5 * (Q[1:] + Q[:-1]) * np.diff(motion)))
    loop = back.dissipation - first.dissipation
    assert loop == pytest.approx(4.0 * first.dissipation, rel=1e-12)
    assert area == pytest.approx(loop, rel=1e-5)


@KINDS
@pytest.mark.parametrize("share", [0.0, 0.75, 1.0])
def test_stick_zone(slip, share):
    expected = slip.size * (1 - share) ** (1 / 2 if slip is LINE else 1 / 3)
    assert slip.sticks(slip(share)) == pytest.approx(expected, abs=1e-12)


P = LINE.limit
WRONG = [
    (0.0, 1.0, "friction is "),
    (MU, 1.01 * P, "the whole contact slides"),
    (MU, (0.5 * P, -0.6 * P), "closes a loop"),
    (MU, (0.2 * P, 0.3 * P), "let it turn at every value"),
    (MU, np.nan, "force is "),
    (MU, (1.0, None), "force is "),
]


@pytest.mark.parametrize(("friction", "force", "words"), WRONG)
def test_bad_numbers_are_named(friction, force, words):
    with pytest.raises(ValueError, match=words):
        analytic.cattaneo_line(AT_LINE, friction, force)


def test_other_bad_numbers_are_named():
    with pytest.raises(ValueError, match="nu is "):
        analytic.mindlin_point(AT_POINT, MU, 0.5, 1.0)
    with pytest.raises(ValueError, match="the whole contact slides"):
        POINT(1.01)
    for x in (np.nan, [0.0, None]):
        with pytest.raises(ValueError, match=r"^x is "):
            LINE(0.5).traction(x)


def test_loops_close_up_to_round_off(monkeypatch):
    """Back and forth between the same forces, as sums have them; a per mille more is refused."""
    Q = 0.3 * P
    found = analytic.cattaneo_line(AT_LINE, MU, [Q, -Q * (1.0 + 4e-16), Q]).dissipation
    assert found == pytest.approx(LINE(0.3, -0.3, 0.3).dissipation)
    with pytest.raises(ValueError, match="loop"):
        analytic.cattaneo_line(AT_LINE, MU, [Q, -1.001 * Q, 1.002 * Q])
    monkeypatch.setattr(analytic, "HALF_OF_DIGITS", -1e-3)
    with pytest.raises(ValueError, match="loop"):
        LINE(0.3, -0.3, 0.3)

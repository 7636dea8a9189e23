# SPDX-License-Identifier: MIT
"""Line contact with friction under a varying tangential force, with partial slip.

The half spaces are of one material, and the normal force is applied first and then held. A
tangential force Q (per unit thickness) that one body exerts on the other makes the edges slip and
leaves a middle that sticks. After each turn of the force the change of all tractions is that of a
first loading with twice the coefficient of friction.

Sources: C. Cattaneo, Rend. Accad. Naz. Lincei 27 (1938) 342-348, 434-436, 474-478; R. D. Mindlin,
H. Deresiewicz, "Elastic spheres in contact under varying oblique forces", J. Appl. Mech. 20 (1953)
327-344; K. L. Johnson, Contact Mechanics, sections 7.2 and 7.4. Slip, displacement and dissipation
follow from the strain of the surface beside an elliptic traction, sqrt(x^2 - c^2) (Johnson 2.7).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from dolfinx_mortar.analytic.hertz import LineContact
from dolfinx_mortar.arguments import FINITE, POSITIVE, array, check, check_all
from dolfinx_mortar.arrays import HALF_OF_DIGITS, Floats


@dataclass(frozen=True)
class PartialSlip:
    """A line contact that has been through tangential forces.

    The solution of Cattaneo for a force in (0, mu P), with k = 1 - Q/(mu P) and c = a sqrt(k),

        q_c(x) = mu p0 (sqrt(1 - x^2/a^2) - (c/a) sqrt(1 - x^2/c^2)),  the last term for |x| < c

    is summed over the legs of the history: weight 1 for the first, -2 and +2 alternately for all
    others, which need half the change of the force each.
    """

    contact: LineContact
    friction: float  # mu
    forces: tuple[float, ...]  # per unit thickness: where the force turned, and the present one
    weights: tuple[float, ...]  # of the legs, with the sign of the change of the force
    stick_half_widths: tuple[float, ...]  # of the legs, c = a sqrt(k)

    @property
    def force(self) -> float:
        """The present tangential force Q per unit thickness."""
        return self.forces[-1]

    @property
    def stick_half_width(self) -> float:
        """Where the present leg of the history sticks: |x| < c."""
        return self.stick_half_widths[-1]

    @property
    def dissipation(self) -> float:
        """Energy dissipated so far, per unit thickness; not negative.

        A leg takes |weight| mu^2 P^2/(2 pi E*) (1 - k^2 + 2 k ln k); a closed loop between -Q and
        Q four times what the first loading takes.
        """
        contact, limit = self.contact, self.friction * self.contact.force
        legs = [
            abs(w) * (1.0 - k**2 + 2.0 * _k_ln_k(k))
            for w, k in zip(self.weights, self._k, strict=True)
        ]
        return limit**2 / (2.0 * np.pi * contact.E_star) * sum(legs)

    @property
    def displacement(self) -> float:
        """The part of the relative displacement of the bodies that is due to partial slip.

        Distant points of half spaces have no finite displacement in the plane. Where the contact
        sticks as a whole, bodies of finite size move by C Q, with their own compliance C; this is
        the rest, mu P/(pi E*) (1 - k + k ln k) in the first loading. Positive in the direction in
        which Q pushes.
        """
        limit = self.friction * self.contact.force
        legs = [w * (1.0 - k + _k_ln_k(k)) for w, k in zip(self.weights, self._k, strict=True)]
        return limit / (np.pi * self.contact.E_star) * sum(legs)

    @property
    def _k(self) -> list[float]:
        return [(c / self.contact.half_width) ** 2 for c in self.stick_half_widths]

    def traction(self, x: npt.ArrayLike) -> Floats:
        """Return the shear traction at distances x from the middle, zero outside the contact.

        It is the one exerted by the body that pushes with Q on the other one: its integral is Q.
        """
        at, limit = self.contact, self.friction * self.contact.peak_pressure
        legs = self.weights, self.stick_half_widths
        return limit * traction_of_legs(check("x", x, FINITE), at.half_width, *legs)

    def slip(self, x: npt.ArrayLike) -> Floats:
        """Return how far the body that pushes has slid on the other one, NaN outside the contact.

            s_c(x) = mu/R (|x| sqrt(x^2 - c^2) - c^2 arcosh(|x|/c))/2   for |x| > c, else 0

        summed over the legs; relative to the middle, and positive in the direction in which Q
        pushes.
        """
        x = np.abs(check("x", x, FINITE))
        total = np.where(x <= self.contact.half_width, 0.0, np.nan)
        for w, c in zip(self.weights, self.stick_half_widths, strict=True):
            beyond = np.maximum(x, c)
            root = np.sqrt(beyond**2 - c**2)
            # arcosh(x/c) = ln((x + root)/c); c = 0 takes nothing off
            arc = c**2 * np.log((beyond + root) / c) if c > 0.0 else 0.0
            total += 0.5 * w * self.friction / self.contact.radius * (beyond * root - arc)
        return np.asarray(total)


def cattaneo_line(
    contact: LineContact, friction: float, force: float | tuple[float, ...]
) -> PartialSlip:
    """Solve a line contact under a tangential force, or under several one after the other.

    Args:
        contact: under its normal force P, from `hertz_line`, of one material.
        friction: coefficient of friction mu.
        force: tangential force Q per unit thickness, |Q| <= mu P; or all of them, those at which
            it turned and the present one last. No change may be larger than the one before it, and
            the second not larger than twice the first force, which is when an earlier loop closes.

    Raises:
        ValueError: for a number that is out of range, by the name of its argument.

    >>> from dolfinx_mortar.analytic import hertz_line
    >>> contact = hertz_line(100.0, 8.0, 200e3, 0.3, 200e3, 0.3)
    >>> s = cattaneo_line(contact, 0.2, 15.0)
    >>> round(s.stick_half_width / contact.half_width, 12)
    0.5
    >>> loop = cattaneo_line(contact, 0.2, (15.0, -15.0, 15.0))
    >>> round(loop.dissipation / s.dissipation, 12)
    5.0
    """
    check_all(POSITIVE, friction=friction)
    path, weights, shares = legs_of(force, friction * contact.force)
    widths = tuple(contact.half_width * float(np.sqrt(1.0 - share)) for share in shares)
    return PartialSlip(contact, float(friction), path, weights, widths)


def traction_of_legs(
    x: Floats, a: float, weights: tuple[float, ...], sticks: tuple[float, ...]
) -> Floats:
    """Return the shear traction over mu p0, the sum over legs that stick where |x| < c."""
    total = np.zeros_like(x)
    for w, c in zip(weights, sticks, strict=True):
        # (c/a) sqrt(1 - x^2/c^2) = sqrt(c^2 - x^2)/a, which holds for c = 0, too
        outer, inner = (np.sqrt(np.maximum(0.0, b**2 - x**2)) / a for b in (a, c))
        total += w * (outer - inner)
    return np.asarray(total)


def legs_of(
    force: float | tuple[float, ...], limit: float
) -> tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]:
    """Return the forces of a history, the weights of its legs, and their shares of the limit mu P.

    The weight is 1 for the first leg and 2 for the others, with the sign of the change; the share
    is 1 - k, the change of the force over weight and limit, from 0 to 1. A ValueError tells what is
    no force, goes beyond the limit, closes a loop, or does not turn.
    """
    history = np.atleast_1d(check("force", force, FORCES))
    path = tuple(float(Q) for Q in history)
    changes = [path[0], *(later - Q for Q, later in pairwise(path))]
    sizes = [1.0, *[2.0] * (len(changes) - 1)]
    weights = tuple(float(np.sign(c)) * size for c, size in zip(changes, sizes, strict=True))
    shares = [abs(c) / limit / size for c, size in zip(changes, sizes, strict=True)]
    for Q, share, before in zip(path, shares, [1.0, *shares], strict=False):
        if (
            share > before + HALF_OF_DIGITS
        ):  # a force that closes a loop may exceed its range by so much
            raise ValueError(
                f"force is {force!r}: {Q:g} exceeds friction * P = {limit:g}, at which the whole "
                "contact slides, or closes a loop: leave out the forces inside closed loops."
            )
    if any(later * before > 0.0 for before, later in pairwise(weights)):
        raise ValueError(f"force is {force!r}: let it turn at every value except the last one")
    return path, weights, tuple(min(share, 1.0) for share in shares)


FORCES = array((), (None,), remedy="give a finite number, or several in a sequence", holds=np.size)


def _k_ln_k(k: float) -> float:
    """Return k ln k, which is 0 at 0."""
    return k * float(np.log(k)) if k > 0.0 else 0.0

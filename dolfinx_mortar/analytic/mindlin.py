# SPDX-License-Identifier: MIT
"""Point contact with friction under a varying tangential force, with partial slip.

Two spheres of one material under a normal force that is held. As in line contact (`cattaneo`) the
edge slips, and each turn of the force starts a first loading anew with twice the friction; here
distant points move by a finite distance. All slip is taken along the force, which is right to some
per cent: what the surfaces move across it is left out.

Sources: R. D. Mindlin, H. Deresiewicz, "Elastic spheres in contact under varying oblique forces",
J. Appl. Mech. 20 (1953) 327-344; K. L. Johnson, Contact Mechanics, eqs. 7.40 to 7.42 and 7.4.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dolfinx_mortar.analytic.cattaneo import legs_of, traction_of_legs
from dolfinx_mortar.analytic.hertz import PointContact
from dolfinx_mortar.arguments import FINITE, POISSON, POSITIVE, check, check_all
from dolfinx_mortar.arrays import Floats


@dataclass(frozen=True)
class PartialSlipPoint:
    """A point contact that has been through tangential forces.

    With k = 1 - Q/(mu P) and c = a k^(1/3), as in line contact,

        q_c(r) = mu p0 (sqrt(1 - r^2/a^2) - (c/a) sqrt(1 - r^2/c^2)),  the last term for r < c

    is summed over the legs of the history: weight 1 for the first, -2 and +2 alternately for all
    others, which need half the change of the force each.
    """

    contact: PointContact
    friction: float  # mu
    nu: float  # Poisson's ratio of both
    forces: tuple[float, ...]  # where the force turned, and the present one
    weights: tuple[float, ...]  # of the legs, with the sign of the change of the force
    stick_radii: tuple[float, ...]  # of the legs

    @property
    def force(self) -> float:
        """The present tangential force Q."""
        return self.forces[-1]

    @property
    def stick_radius(self) -> float:
        """Where the present leg of the history sticks: r < c."""
        return self.stick_radii[-1]

    @property
    def displacement(self) -> float:
        """Tangential motion of distant points of the bodies, relative to each other.

        The first loading moves them by D (1 - k^(2/3)), D = 3 mu P (2 - nu)/(8 a E* (1 - nu)).
        """
        legs = [w * (1.0 - k ** (2.0 / 3.0)) for w, k in zip(self.weights, self._k, strict=True)]
        return self._largest * sum(legs)

    @property
    def dissipation(self) -> float:
        """Energy dissipated so far; not negative.

        A leg takes |weight| mu P D (1 + 5 k - 5 k^(2/3) - k^(5/3))/5; a closed loop between -Q and
        Q four times what the first loading takes.
        """
        legs = [
            abs(w) * (1.0 + 5.0 * k - 5.0 * k ** (2.0 / 3.0) - k ** (5.0 / 3.0)) / 5.0
            for w, k in zip(self.weights, self._k, strict=True)
        ]
        return self.friction * self.contact.force * self._largest * sum(legs)

    @property
    def _k(self) -> list[float]:
        return [(c / self.contact.contact_radius) ** 3 for c in self.stick_radii]

    @property
    def _largest(self) -> float:
        """The displacement D at which all slides."""
        at = self.contact
        stiffness = 8.0 * at.contact_radius * at.E_star * (1.0 - self.nu)
        return 3.0 * self.friction * at.force * (2.0 - self.nu) / stiffness

    def traction(self, r: npt.ArrayLike) -> Floats:
        """Return the shear traction at distances r from the middle, as `PartialSlip.traction`."""
        at, limit = self.contact, self.friction * self.contact.peak_pressure
        legs = self.weights, self.stick_radii
        return limit * traction_of_legs(check("r", r, FINITE), at.contact_radius, *legs)


def mindlin_point(
    contact: PointContact, friction: float, nu: float, force: float | tuple[float, ...]
) -> PartialSlipPoint:
    """Solve a point contact under a tangential force, or under several one after the other.

    Arguments and errors as for `cattaneo_line`, with the contact of `hertz_point`, the whole force,
    and Poisson's ratio nu of the material.

    >>> from dolfinx_mortar.analytic import hertz_point
    >>> contact = hertz_point(100.0, 8.0, 200e3, 0.3, 200e3, 0.3)
    >>> s = mindlin_point(contact, 0.2, 0.3, 17.5)
    >>> round(s.stick_radius / contact.contact_radius, 12)
    0.5
    """
    check_all(POSITIVE, friction=friction)
    check_all(POISSON, nu=nu)
    path, weights, shares = legs_of(force, friction * contact.force)
    radii = tuple(contact.contact_radius * float(np.cbrt(1.0 - share)) for share in shares)
    return PartialSlipPoint(contact, float(friction), float(nu), path, weights, radii)

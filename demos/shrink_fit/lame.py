# SPDX-License-Identifier: MIT
"""A hub shrunk on a hollow shaft, and the axial force that friction carries between them.

Sources: G. Lame's thick cylinders with free ends, see S. P. Timoshenko, J. N. Goodier, Theory of
Elasticity, section 28. The change of the pressure by axial stresses is that of slices which stay
plane, as in the pull-out of fibres (A. Takaku, R. G. C. Arridge, J. Phys. D 6 (1973) 2038-2047).
"""

from dataclasses import dataclass

import numpy as np

from dolfinx_mortar.common.arguments import POISSON, POSITIVE, array, check, check_all


@dataclass(frozen=True)
class ShrinkFit:
    """A hub on a hollow shaft, both elastic and of one length, with free ends."""

    radii: tuple[float, float, float]  # a, c, b: bore of the shaft, where they meet, outside
    shaft: tuple[float, float]  # E, nu
    hub: tuple[float, float]  # E, nu
    pressure: float  # between them

    def sliding_force(self, friction: float, length: float) -> float:
        """Return mu p 2 pi c L, at which the shaft slides if the pressure stays what it is."""
        check_all(POSITIVE, friction=friction, length=length)
        return 2.0 * np.pi * self.radii[1] * length * friction * self.pressure

    def pull_force(self, friction: float, length: float) -> float:
        """Return the force that pulls the shaft out of a hub held at the other end.

        The shaft gets thinner as it is stretched, and so does the hub. With the axial stresses S
        and H = (F - A S)/B of shaft and hub, whose sections are A and B,

            p(z) = p0 - (nu1 S/E1 - nu2 H/E2)/K,    dS/dz = 2 pi c mu p/A,    S(0) = 0

        where K = k1 + k2 are the compliances of Lame, u/(c p). The force F = A S(L) follows from
        this linear equation. A friction or a length that is not positive is a ValueError.
        """
        check_all(POSITIVE, friction=friction, length=length)
        a, c, b = self.radii
        A, B = np.pi * (c**2 - a**2), np.pi * (b**2 - c**2)
        K = _compliance(self.radii, self.shaft, self.hub)
        stretch = [nu / E / K for E, nu in (self.shaft, self.hub)]
        rate = 2.0 * np.pi * c * friction / A
        # dS/dz = rate (p0 + stretch2 F/B) - beta S
        beta = rate * (stretch[0] + stretch[1] * A / B)
        # (1 - exp(-beta L))/beta, which tends to L
        reach = -np.expm1(-beta * length) / beta if beta > 0.0 else length
        share = A * rate * reach
        return float(share * self.pressure / (1.0 - share * stretch[1] / B))


SIZES = array(
    (3,),
    remedy="give three increasing positive radii: of the bore, where the bodies meet, outside",
    holds=lambda r: 0.0 < r[0] < r[1] < r[2],
)


def shrink_fit(
    interference: float,
    radii: tuple[float, float, float],
    E1: float,
    nu1: float,
    E2: float,
    nu2: float,
) -> ShrinkFit:
    """Solve a shrink fit without axial stress (Lame).

        p = (d/c)/(k1 + k2),    k1 = ((c^2 + a^2)/(c^2 - a^2) - nu1)/E1,
                                k2 = ((b^2 + c^2)/(b^2 - c^2) + nu2)/E2

    The interference d is by how much the radius of the hub's bore is too small. The radii are a of
    the shaft's bore, c where they meet, b outside; E1 and nu1 belong to the shaft, E2 and nu2 to
    the hub. A number that is out of range is a ValueError that names its argument.

    >>> s = shrink_fit(0.01, (10.0, 20.0, 30.0), 200e3, 0.3, 200e3, 0.3)
    >>> round(s.pressure, 4), round(s.sliding_force(0.2, 20.0) / 1e3, 3)
    (23.4375, 11.781)
    """
    check_all(POSITIVE, interference=interference, E1=E1, E2=E2)
    check_all(POISSON, nu1=nu1, nu2=nu2)
    sizes = check("radii", radii, SIZES)
    a, c, b = map(float, sizes)
    shaft, hub = (float(E1), float(nu1)), (float(E2), float(nu2))
    K = _compliance((a, c, b), shaft, hub)
    return ShrinkFit((a, c, b), shaft, hub, interference / c / K)


def _compliance(
    radii: tuple[float, float, float], shaft: tuple[float, float], hub: tuple[float, float]
) -> float:
    """Return the sum k1 + k2 of u/(c p) of shaft and hub, both positive."""
    a2, c2, b2 = (r**2 for r in radii)
    (E1, nu1), (E2, nu2) = shaft, hub
    return ((c2 + a2) / (c2 - a2) - nu1) / E1 + ((b2 + c2) / (b2 - c2) + nu2) / E2

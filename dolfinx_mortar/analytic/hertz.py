# SPDX-License-Identifier: MIT
"""Elastic line and point contact, and the load at which a line contact first yields.

Line contact is plane strain and forces are per unit thickness, e.g. N/mm with mm and MPa.
Lengths, moduli and yield stresses are positive; pressure and depth are positive into the body.

Source of the formulas: K. L. Johnson, Contact Mechanics, Cambridge University Press 1985,
section 4.2 and eqs. 4.22-4.24 (point contact), eqs. 4.43-4.46 (line contact), 4.49 (stresses
below a line contact).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinx_mortar.arguments import POISSON, POSITIVE, Rule, array, as_numbers, check, check_all
from dolfinx_mortar.arrays import Floats


@dataclass(frozen=True)
class LineContact:
    """Hertz line contact of two parallel cylinders, plane strain."""

    force: float  # per unit thickness
    radius: float  # effective, 1/R = 1/R1 + 1/R2
    E_star: float  # effective modulus, 1/E* = (1 - nu1^2)/E1 + (1 - nu2^2)/E2
    half_width: float  # a = sqrt(4 F R/(pi E*))
    peak_pressure: float  # p0 = 2 F/(pi a)

    def pressure(self, x: npt.ArrayLike) -> Floats:
        """Return p0 sqrt(1 - x^2/a^2), zero outside the contact, at distances x from the middle."""
        return _semi_ellipse(x, self.half_width, self.peak_pressure)


@dataclass(frozen=True)
class PointContact:
    """Hertz point contact of two spheres."""

    force: float
    radius: float  # effective, 1/R = 1/R1 + 1/R2
    E_star: float  # effective modulus
    contact_radius: float  # a = (3 F R/(4 E*))^(1/3)
    peak_pressure: float  # p0 = 3 F/(2 pi a^2)
    approach: float  # of distant points, delta = a^2/R

    def pressure(self, r: npt.ArrayLike) -> Floats:
        """Return p0 sqrt(1 - r^2/a^2), zero outside the contact, at distances r from the middle."""
        return _semi_ellipse(r, self.contact_radius, self.peak_pressure)


@dataclass(frozen=True)
class FirstYield:
    """Load at which a line contact first yields: on its axis, at or below the surface."""

    peak_pressure: float
    half_width: float
    force: float  # per unit thickness
    depth: float  # of the point that yields first, 0 at the surface
    ratio: float  # largest von Mises stress over peak pressure


def _semi_ellipse(x: npt.ArrayLike, a: float, p0: float) -> Floats:
    return p0 * np.sqrt(np.maximum(0.0, 1.0 - (np.asarray(x, dtype=float) / a) ** 2))


def effective_modulus(E1: float, nu1: float, E2: float, nu2: float) -> float:
    """Return E* with 1/E* = (1 - nu1^2)/E1 + (1 - nu2^2)/E2; an infinite E is a rigid body.

    A number that is out of range, or two rigid bodies, are a ValueError.

    >>> round(effective_modulus(206_900.0, 0.29, 206_900.0, 0.29), 1)
    112949.0
    """
    for name, modulus in (("E1", E1), ("E2", E2)):
        if modulus != np.inf:
            check(name, modulus, POSITIVE, "give a positive number, np.inf for a rigid body")
    check_all(POISSON, nu1=nu1, nu2=nu2)
    compliance = (1.0 - nu1**2) / E1 + (1.0 - nu2**2) / E2
    if compliance == 0.0:
        raise ValueError(f"E1 is {E1}, and E2 is {E2}: one of the bodies must not be rigid")
    return float(1.0 / compliance)


def _read_radii(radius: Any) -> float | None:
    """Return R of one radius or two, None unless it is positive and finite."""
    radii = as_numbers(radius)
    if radii is None or radii.shape not in ((), (1,), (2,)):
        return None
    with np.errstate(divide="ignore", invalid="ignore"):
        curvature = float(np.sum(1.0 / radii))
    return 1.0 / curvature if 0.0 < curvature < np.inf else None


DEPTHS = array(
    remedy="give finite depths >= 0, as they are positive into the body",
    holds=lambda z: (z >= 0.0).all(),
)
RADII = Rule(
    "give a positive radius, or a pair of round bodies: neither is 0 or NaN, and one is positive "
    "and smaller than the other, if that is hollow (negative)",
    _read_radii,
)


def effective_radius(radius: float | tuple[float, float]) -> float:
    """Return R with 1/R = 1/R1 + 1/R2; one number stands for a round body on a flat one.

    A negative radius is that of a hollow surface, an infinite one is flat. Radii of surfaces that
    do not touch in a point or a line, as 1/R <= 0, are a ValueError.

    >>> effective_radius((8.0, 8.0)), effective_radius(8.0), effective_radius((4.0, -8.0))
    (4.0, 8.0, 8.0)
    """
    return check("radius", radius, RADII)


def hertz_line(
    force: float, radius: float | tuple[float, float], E1: float, nu1: float, E2: float, nu2: float
) -> LineContact:
    """Solve the line contact of two cylinders (Johnson eqs. 4.43, 4.45), plane strain.

        a = sqrt(4 F R/(pi E*)),    p0 = 2 F/(pi a),    p(x) = p0 sqrt(1 - x^2/a^2)

    The force F is per unit thickness, positive in compression; the radius that of a cylinder on a
    flat body, or the pair (R1, R2); E and nu are Young's moduli and Poisson's ratios of both
    bodies. A number that is out of range is a ValueError that names its argument.

    >>> c = hertz_line(10.0, 8.0, 200.0, 0.3, 200.0, 0.3)
    >>> round(c.half_width, 5), round(c.peak_pressure, 5)
    (0.96277, 6.6124)
    """
    check_all(POSITIVE, force=force)
    R, E_star = effective_radius(radius), effective_modulus(E1, nu1, E2, nu2)
    a = float(np.sqrt(4.0 * force * R / (np.pi * E_star)))
    return LineContact(force, R, E_star, a, 2.0 * force / (np.pi * a))


def hertz_point(
    force: float, radius: float | tuple[float, float], E1: float, nu1: float, E2: float, nu2: float
) -> PointContact:
    """Solve the point contact of two spheres (Johnson eqs. 4.22-4.24).

        a = (3 F R/(4 E*))^(1/3),    p0 = 3 F/(2 pi a^2),    delta = a^2/R

    Arguments and errors as for `hertz_line`; the force F is the whole one.

    >>> c = hertz_point(117808.787, (6.1237, 6.1237), 1e8, 0.29, 1e6, 0.29)
    >>> round(c.contact_radius, 5), round(c.peak_pressure / 1e5, 5)
    (0.63018, 1.41642)
    """
    check_all(POSITIVE, force=force)
    R, E_star = effective_radius(radius), effective_modulus(E1, nu1, E2, nu2)
    a = float(np.cbrt(3.0 * force * R / (4.0 * E_star)))
    return PointContact(force, R, E_star, a, 1.5 * force / (np.pi * a**2), a**2 / R)


def line_axis_stress(depth: npt.ArrayLike, nu: float) -> Floats:
    """Principal stresses below the middle of a line contact (Johnson eq. 4.49), plane strain.

    With z = depth/a and s = sqrt(1 + z^2), in units of the peak pressure,

        sigma_x = 2 z - (1 + 2 z^2)/s,    sigma_y = -1/s,    sigma_z = nu (sigma_x + sigma_y)

    Depths over the half-width a have any shape (...) and are not negative, else it is a ValueError;
    the stresses along the surface, normal to it and out of plane have the shape (..., 3).

    >>> line_axis_stress(0.0, 0.25).tolist()
    [-1.0, -1.0, -0.5]
    """
    check_all(POISSON, nu=nu)
    z = check("depth", depth, DEPTHS)
    s = np.sqrt(1.0 + z**2)
    sx, sy = 2.0 * z - (1.0 + 2.0 * z**2) / s, -1.0 / s
    return np.stack([sx, sy, nu * (sx + sy)], axis=-1)


def first_yield_line(
    yield_stress: float,
    radius: float | tuple[float, float],
    E1: float,
    nu1: float,
    E2: float,
    nu2: float,
) -> FirstYield:
    """Find the load at which the first body of a line contact starts to yield (von Mises).

    The von Mises stress is largest on the axis, and there either below the surface, at half to
    0.8 half-widths, or for nu below about 0.194 at it, where it is (1 - 2 nu) p0.

    The yield stress is the uniaxial one, sqrt(3/2) Y for the Frobenius norm Y of the deviatoric
    stress; other arguments and errors as for `hertz_line`; the first body is the one that yields.

    >>> y = first_yield_line(450.0, 8.0, 206_900.0, 0.29, 206_900.0, 0.29)
    >>> round(y.peak_pressure, 1), round(y.half_width, 5), round(y.force, 1), round(y.depth, 4)
    (801.4, 0.11353, 142.9, 0.079)
    """
    from scipy.optimize import minimize_scalar  # 0.1 s, for this alone

    check_all(POSITIVE, yield_stress=yield_stress)
    R, E_star = effective_radius(radius), effective_modulus(E1, nu1, E2, nu2)

    def von_mises(z: float) -> float:
        s = line_axis_stress(z, nu1)
        return float(np.sqrt(0.5 * np.sum((s - np.roll(s, 1)) ** 2)))

    found = minimize_scalar(lambda z: -von_mises(z), bounds=(0.2, 2.0), options={"xatol": 1e-10})
    # From the surface it falls at first, for every nu: a second maximum, not the end of this one.
    ratio, depth = max((-float(found.fun), float(found.x)), (von_mises(0.0), 0.0))
    p0 = yield_stress / ratio
    a = 2.0 * p0 * R / E_star  # from p0 = 2 F/(pi a) and a^2 = 4 F R/(pi E*)
    return FirstYield(p0, a, 0.5 * np.pi * a * p0, depth * a, ratio)

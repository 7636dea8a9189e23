# SPDX-License-Identifier: MIT
"""Closed solutions of contact mechanics, in any consistent units.

Line contact is plane strain, with forces per unit thickness; pressure and depth are positive into
the body. A ValueError names an argument out of range.

Sources: K. L. Johnson, Contact Mechanics, 1985; C. Cattaneo, Rend. Accad. Naz. Lincei 27 (1938)
342-348, 434-436, 474-478; R. D. Mindlin, H. Deresiewicz, J. Appl. Mech. 20 (1953) 327-344.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.special import xlogy

from dolfinx_mortar.common.arguments import FINITE, POISSON, POSITIVE, array, check, check_all
from dolfinx_mortar.common.arrays import HALF_OF_DIGITS, Bools, Floats

__all__ = [
    "FirstYield",
    "LineContact",
    "PartialSlip",
    "PartialSlipPoint",
    "PointContact",
    "cattaneo_line",
    "effective_modulus",
    "effective_radius",
    "first_yield_line",
    "fit_pressure",
    "hertz_line",
    "hertz_point",
    "line_axis_stress",
    "mindlin_point",
]

Radius = float | tuple[float, float]
Force = float | tuple[float, ...]
# Share of p0^2 below which a node is at the edge; half and twice as much change the fit by < 0.5 %.
EDGE = 0.1


@dataclass(frozen=True)
class LineContact:
    """Hertz line contact of two parallel cylinders, plane strain."""

    force: float  # per unit thickness
    radius: float  # effective
    E_star: float  # effective modulus
    half_width: float  # a
    peak_pressure: float  # p0

    def pressure(self, x: npt.ArrayLike) -> Floats:
        """Return p0 sqrt(1 - x^2/a^2), zero outside the contact, at distances x from the middle."""
        return self.peak_pressure * _ellipse(x, self.half_width)


@dataclass(frozen=True)
class PointContact:
    """Hertz point contact of two spheres."""

    force: float
    radius: float  # effective
    E_star: float  # effective modulus
    contact_radius: float  # a
    peak_pressure: float  # p0
    approach: float  # delta, of distant points

    def pressure(self, r: npt.ArrayLike) -> Floats:
        """Pressure at distances r from the middle, as `LineContact.pressure`."""
        return self.peak_pressure * _ellipse(r, self.contact_radius)


@dataclass(frozen=True)
class FirstYield:
    """Load at which a line contact first yields, on its axis."""

    peak_pressure: float
    half_width: float
    force: float  # per unit thickness
    depth: float  # of the point that yields first
    ratio: float  # largest von Mises stress over peak pressure


def _ellipse(x: npt.ArrayLike, a: float) -> Floats:
    return np.sqrt(np.maximum(0.0, 1.0 - (np.asarray(x, dtype=np.float64) / a) ** 2))


def effective_modulus(E1: float, nu1: float, E2: float, nu2: float) -> float:
    """Return E* with 1/E* = (1 - nu1^2)/E1 + (1 - nu2^2)/E2; one E may be infinite (rigid).

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


def effective_radius(radius: Radius) -> float:
    """Return R with 1/R = 1/R1 + 1/R2; one number is a round body on a flat one.

    A negative radius is concave, an infinite one flat; 1/R > 0.

    >>> effective_radius((8.0, 8.0)), effective_radius(8.0), effective_radius((4.0, -8.0))
    (4.0, 8.0, 8.0)
    """
    remedy = (
        "give a positive radius, or a pair of round bodies: neither is 0 or NaN, and one is "
        "positive and smaller than the other, if that is hollow (negative)"
    )
    radii = check("radius", radius, array((), (1,), (2,), remedy=remedy, finite=False))
    with np.errstate(divide="ignore", invalid="ignore"):
        curvature = float(np.sum(1.0 / radii))
    if not 0.0 < curvature < np.inf:
        raise ValueError(f"radius is {radius!r}: {remedy}")
    return 1.0 / curvature


def hertz_line(
    force: float, radius: Radius, E1: float, nu1: float, E2: float, nu2: float
) -> LineContact:
    """Solve the line contact of two cylinders (Johnson eqs. 4.43, 4.45).

        a = sqrt(4 F R/(pi E*)),    p0 = 2 F/(pi a),    p(x) = p0 sqrt(1 - x^2/a^2)

    F > 0 in compression; radius as in `effective_radius`, moduli as in `effective_modulus`.

    >>> c = hertz_line(10.0, 8.0, 200.0, 0.3, 200.0, 0.3)
    >>> round(c.half_width, 5), round(c.peak_pressure, 5)
    (0.96277, 6.6124)
    """
    check_all(POSITIVE, force=force)
    R, E_star = effective_radius(radius), effective_modulus(E1, nu1, E2, nu2)
    a = float(np.sqrt(4.0 * force * R / (np.pi * E_star)))
    return LineContact(force, R, E_star, a, 2.0 * force / (np.pi * a))


def hertz_point(
    force: float, radius: Radius, E1: float, nu1: float, E2: float, nu2: float
) -> PointContact:
    """Solve the point contact of two spheres (Johnson eqs. 4.22-4.24).

        a = (3 F R/(4 E*))^(1/3),    p0 = 3 F/(2 pi a^2),    delta = a^2/R

    Arguments as for `hertz_line`.

    >>> c = hertz_point(117808.787, (6.1237, 6.1237), 1e8, 0.29, 1e6, 0.29)
    >>> round(c.contact_radius, 5), round(c.peak_pressure / 1e5, 5)
    (0.63018, 1.41642)
    """
    check_all(POSITIVE, force=force)
    R, E_star = effective_radius(radius), effective_modulus(E1, nu1, E2, nu2)
    a = float(np.cbrt(3.0 * force * R / (4.0 * E_star)))
    return PointContact(force, R, E_star, a, 1.5 * force / (np.pi * a**2), a**2 / R)


def line_axis_stress(depth: npt.ArrayLike, nu: float) -> Floats:
    """Principal stresses below the middle of a line contact (Johnson eq. 4.49).

    With z = depth/a and s = sqrt(1 + z^2), in units of the peak pressure,

        sigma_x = 2 z - (1 + 2 z^2)/s,    sigma_y = -1/s,    sigma_z = nu (sigma_x + sigma_y)

    Depths >= 0 over a have any shape (...); stresses (..., 3) are along the surface, normal to it
    and out of plane.

    >>> line_axis_stress(0.0, 0.25).tolist()
    [-1.0, -1.0, -0.5]
    """
    check_all(POISSON, nu=nu)
    remedy = "give finite depths >= 0, as they are positive into the body"
    z = check("depth", depth, array(remedy=remedy, holds=lambda z: (z >= 0.0).all()))
    s = np.sqrt(1.0 + z**2)
    sx, sy = 2.0 * z - (1.0 + 2.0 * z**2) / s, -1.0 / s
    return np.stack([sx, sy, nu * (sx + sy)], axis=-1)


def first_yield_line(
    yield_stress: float, radius: Radius, E1: float, nu1: float, E2: float, nu2: float
) -> FirstYield:
    """Find the load at which the first body of a line contact starts to yield (von Mises).

    The von Mises stress is largest on the axis, at a depth of 0.5 to 0.8 a, or for nu < 0.194 on
    the surface, (1 - 2 nu) p0. The yield stress is uniaxial; other arguments as for `hertz_line`.

    >>> y = first_yield_line(450.0, 8.0, 206_900.0, 0.29, 206_900.0, 0.29)
    >>> round(y.peak_pressure, 1), round(y.half_width, 5), round(y.force, 1), round(y.depth, 4)
    (801.4, 0.11353, 142.9, 0.079)
    """
    from scipy.optimize import minimize_scalar  # slow import

    check_all(POSITIVE, yield_stress=yield_stress)
    R, E_star = effective_radius(radius), effective_modulus(E1, nu1, E2, nu2)

    def von_mises(z: float) -> float:
        s = line_axis_stress(z, nu1)
        return float(np.sqrt(0.5 * np.sum((s - np.roll(s, 1)) ** 2)))

    found = minimize_scalar(lambda z: -von_mises(z), bounds=(0.2, 2.0), options={"xatol": 1e-10})
    ratio, depth = max((-float(found.fun), float(found.x)), (von_mises(0.0), 0.0))
    p0 = yield_stress / ratio
    a = 2.0 * p0 * R / E_star  # from p0 = 2 F/(pi a) and a^2 = 4 F R/(pi E*)
    return FirstYield(p0, a, 0.5 * np.pi * a * p0, depth * a, ratio)


@dataclass(frozen=True, eq=False)
class _History:
    """A contact of one material after tangential forces Q, in legs."""

    contact: Any
    friction: float  # mu
    forces: Floats  # where the force turned, and the present one
    weights: Floats  # of the legs, with the sign of the change of the force
    size: float  # a
    sticks: Floats  # sizes c of stick of the legs
    moves: Floats  # displacements over weights
    works: Floats  # dissipated, over |weights| mu P

    @property
    def force(self) -> float:
        """The present tangential force Q."""
        return float(self.forces[-1])

    @property
    def displacement(self) -> float:
        """Relative displacement of the bodies due to partial slip, positive along Q."""
        return float(self.weights @ self.moves)

    @property
    def dissipation(self) -> float:
        """Energy dissipated so far, >= 0; a closed loop takes four times the first loading."""
        return float(self.friction * self.contact.force * (np.abs(self.weights) @ self.works))

    def traction(self, x: npt.ArrayLike) -> Floats:
        """Shear traction at distances x from the middle, zero outside the contact.

        Exerted by the body that pushes with Q on the other one: its integral is Q.
        """
        at, a = check("x", x, FINITE), self.size
        total = np.zeros_like(at)
        for w, c in zip(self.weights, self.sticks, strict=True):
            # (c/a) sqrt(1 - x^2/c^2) = sqrt(c^2 - x^2)/a, also for c = 0
            outer, inner = (np.sqrt(np.maximum(0.0, b**2 - at**2)) / a for b in (a, c))
            total += w * (outer - inner)
        return self.friction * self.contact.peak_pressure * total


@dataclass(frozen=True, eq=False)
class PartialSlip(_History):
    """A line contact of one material after a history of tangential forces, per unit thickness.

    The normal force P is constant. A tangential force Q makes the edges slip around a stick zone.
    Cattaneo's solution for a force in (0, mu P), with k = 1 - Q/(mu P) and c = a sqrt(k),

        q_c(x) = mu p0 (sqrt(1 - x^2/a^2) - (c/a) sqrt(1 - x^2/c^2)),  the last term for |x| < c

    is summed over the legs: weight 1 for the first, then -2 and +2 in turn with half the change of
    the force. A leg moves the bodies by weight D (1 - k + k ln k), D = mu P/(pi E*), and dissipates
    |weight| mu P D (1 - k^2 + 2 k ln k)/2. Bodies of finite size move by C Q in addition, with
    their compliance C without slip.
    """

    @property
    def stick_half_widths(self) -> tuple[float, ...]:
        """Half-widths of stick c = a sqrt(k) of all legs."""
        return tuple(map(float, self.sticks))

    @property
    def stick_half_width(self) -> float:
        """Half-width of stick of the present leg."""
        return float(self.sticks[-1])


def cattaneo_line(contact: LineContact, friction: float, force: Force) -> PartialSlip:
    """Solve a line contact under one tangential force, or a sequence.

    Args:
        contact: under its normal force P, from `hertz_line`, of one material.
        friction: coefficient of friction mu.
        force: tangential force Q per unit thickness, |Q| <= mu P; or those at which it turned and
            the present one. No change may exceed the one before it (the second: twice the first),
            which would close a loop.

    >>> contact = hertz_line(100.0, 8.0, 200e3, 0.3, 200e3, 0.3)
    >>> s = cattaneo_line(contact, 0.2, 15.0)
    >>> round(s.stick_half_width / contact.half_width, 12)
    0.5
    >>> loop = cattaneo_line(contact, 0.2, (15.0, -15.0, 15.0))
    >>> round(loop.dissipation / s.dissipation, 12)
    5.0
    """
    limit, forces, weights, k = _legs_of(contact, friction, force)
    a, D, rest = contact.half_width, limit / (np.pi * contact.E_star), xlogy(k, k)
    legs = a * np.sqrt(k), D * (1.0 - k + rest), D * ((1.0 - k**2) / 2.0 + rest)
    return PartialSlip(contact, float(friction), forces, weights, a, *legs)


@dataclass(frozen=True, eq=False)
class PartialSlipPoint(_History):
    """A point contact after a history of tangential forces, see `PartialSlip`.

    With c = a k^(1/3) and r in place of x. A leg moves distant points of the bodies by weight D (1
    - k^(2/3)), D = 3 mu P (2 - nu)/(8 a E* (1 - nu)), and dissipates |weight| mu P D (1 + 5 k - 5
    k^(2/3) - k^(5/3))/5. Slip across the force is neglected, right to some per cent (Johnson eqs.
    7.40 to 7.42).
    """

    nu: float  # Poisson's ratio of both

    @property
    def stick_radii(self) -> tuple[float, ...]:
        """Radii of stick c = a k^(1/3) of all legs."""
        return tuple(map(float, self.sticks))

    @property
    def stick_radius(self) -> float:
        """Radius of stick of the present leg."""
        return float(self.sticks[-1])


def mindlin_point(
    contact: PointContact, friction: float, nu: float, force: Force
) -> PartialSlipPoint:
    """Solve a point contact under one tangential force, or a sequence.

    As `cattaneo_line`, with the contact of `hertz_point` and Poisson's ratio nu.

    >>> contact = hertz_point(100.0, 8.0, 200e3, 0.3, 200e3, 0.3)
    >>> s = mindlin_point(contact, 0.2, 0.3, 17.5)
    >>> round(s.stick_radius / contact.contact_radius, 12)
    0.5
    """
    check_all(POISSON, nu=nu)
    limit, forces, weights, k = _legs_of(contact, friction, force)
    a, root = contact.contact_radius, np.cbrt(k)
    D = 3.0 * limit * (2.0 - nu) / (8.0 * a * contact.E_star * (1.0 - nu))
    legs = a * root, D * (1.0 - root**2), D * (1.0 + 5.0 * k - (5.0 + k) * root**2) / 5.0
    return PartialSlipPoint(contact, float(friction), forces, weights, a, *legs, float(nu))


def _legs_of(contact: Any, friction: float, force: Force) -> tuple[float, Floats, Floats, Floats]:
    """Limit mu P, forces of a history, weights of its legs (1, then 2, signed), and k of each.

    1 - k in [0, 1] is the change of the force over weight times mu P.
    """
    check_all(POSITIVE, friction=friction)
    remedy = "give a finite number, or several in a sequence"
    path = np.atleast_1d(check("force", force, array((), (None,), remedy=remedy, holds=np.size)))
    limit, changes = friction * contact.force, np.diff(path, prepend=0.0)
    sizes = np.where(np.arange(len(path)) > 0, 2.0, 1.0)
    weights, shares = np.sign(changes) * sizes, np.abs(changes) / limit / sizes
    # closed loops, up to round-off
    beyond = shares > np.append(1.0, shares[:-1]) + HALF_OF_DIGITS
    if beyond.any():
        raise ValueError(
            f"force is {force!r}: {path[beyond][0]:g} exceeds friction * P = {limit:g}, at which "
            "the whole contact slides, or closes a loop: leave out the forces inside closed loops."
        )
    if (weights[1:] * weights[:-1] > 0.0).any():
        raise ValueError(f"force is {force!r}: let it turn at every value except the last one")
    return limit, path, weights, 1.0 - np.minimum(shares, 1.0)


def fit_pressure(x: npt.ArrayLike, p: npt.ArrayLike) -> tuple[float, float]:
    """Fit a Hertz distribution to nodal pressures: least squares of p^2 linear in x^2.

        p^2 = p0^2 (1 - x^2/a^2) = c0 + c1 x^2,    p0 = sqrt(c0),    a = sqrt(-c0/c1)

    Nodes where the inner ones predict p^2 below a tenth of p0^2 are excluded. With 3, 4 and 6
    facets across, a is right to 6, 5 and 3 %.

    Args:
        x: distances (n,) of the active nodes from the middle of the contact.
        p: pressures (n,) at these nodes.

    Returns:
        Peak pressure p0 and half-width a; (nan, nan) for fewer than two distances, or a pressure
        that does not fall with the distance.

    >>> peak, width = fit_pressure([-3.0, 0.0, 3.0], [8.0, 10.0, 8.0])
    >>> round(peak, 12), round(width, 12)
    (10.0, 5.0)
    """
    distances = check("x", x, array((None,), remedy="give distances (n,), finite numbers"))
    wanted = f"give pressures of as many nodes, {len(distances)} finite numbers"
    values = check("p", p, array((len(distances),), remedy=wanted))
    squares = distances**2, values**2
    farthest = squares[0].max(initial=0.0)
    c0, c1 = _fit_line(*squares, squares[0] <= (1.0 - EDGE) * farthest)
    c0, c1 = _fit_line(*squares, ~(c0 + c1 * squares[0] < EDGE * c0))
    if not (c1 < 0.0 < c0):
        return np.nan, np.nan
    return float(np.sqrt(c0)), float(np.sqrt(-c0 / c1))


def _fit_line(x: Floats, y: Floats, on: Bools) -> tuple[float, float]:
    """Return (c0, c1) of the least-squares line y = c0 + c1 x; NaN for one x."""
    x, y = x[on], y[on]
    if len(x) < 2 or np.ptp(x) <= HALF_OF_DIGITS * np.max(x):
        return np.nan, np.nan
    slope, start = np.polyfit(x, y, 1)
    return float(start), float(slope)

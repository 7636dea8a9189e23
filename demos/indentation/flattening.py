# SPDX-License-Identifier: MIT
"""Published fits for a perfectly plastic sphere, flattened by a rigid plane without friction.

The interference w is the approach of the plane and the centre of the sphere. The two fits differ by
up to five per cent.

Sources: R. L. Jackson, I. Green, "A finite element study of elasto-plastic hemispherical contact
against a rigid flat", J. Tribol. 127 (2005) 343-354; L. Kogut, I. Etsion, "Elastic-plastic contact
analysis of a sphere and a rigid flat", J. Appl. Mech. 69 (2002) 657-662. Only their abstracts were
available: the fits are quoted from memory, and agree with each other and with our computations to
5 %.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class YieldOfSphere:
    """First yield of a sphere on a rigid plane."""

    yield_stress: float  # S, uniaxial
    radius: float  # R
    E_star: float  # effective modulus E/(1 - nu^2)
    C: float  # largest Hertz pressure over S, 1.295 exp(0.736 nu)
    interference: float  # w_c = (pi C S/(2 E*))^2 R
    force: float  # P_c = 4/3 (R/E*)^2 (pi C S/2)^3
    contact_radius: float  # a_c = sqrt(w_c R)


@dataclass(frozen=True)
class Flattening:
    """Force and contact radius of a fit at given interferences."""

    force: Floats
    contact_radius: Floats


def first_yield_sphere(yield_stress: float, radius: float, E: float, nu: float) -> YieldOfSphere:
    """Return first yield of a sphere on a rigid plane (Jackson and Green).

    Args:
        yield_stress: uniaxial yield stress S.
        radius: radius R of the sphere.
        E: its Young's modulus.
        nu: its Poisson's ratio.

    >>> y = first_yield_sphere(1000.0, 1.0, 200e3, 0.3)
    >>> round(y.interference, 9), round(y.force, 6)
    (0.000133225, 0.450617)
    """
    E_star, C = E / (1.0 - nu**2), 1.295 * float(np.exp(0.736 * nu))
    half = 0.5 * np.pi * C * yield_stress
    wc = (half / E_star) ** 2 * radius
    Pc = 4.0 / 3.0 * (radius / E_star) ** 2 * half**3
    return YieldOfSphere(yield_stress, radius, E_star, C, wc, Pc, float(np.sqrt(wc * radius)))


def jackson_green(w: npt.ArrayLike, at: YieldOfSphere) -> Flattening:
    """Return force and contact radius by Jackson and Green.

    With w* = w/w_c and e = S/E*: Hertz' formulas up to w* = 1.9, beyond this

        a*^2 = w* (w*/1.9)^B,      B = 0.14 exp(23 e)
        P*   = exp(-w*^(5/12)/4) w*^(3/2) + 4 H/(C S) (1 - exp(-w*^(5/9)/25)) w*
        H/S  = 2.84 (1 - exp(-0.82 (a/R)^-0.7))

    Args:
        w: interferences, shape (...), positive.
        at: first yield of the sphere.
    """
    s = np.asarray(w, dtype=float) / at.interference
    elastic, e = s <= 1.9, at.yield_stress / at.E_star
    a = at.contact_radius * np.sqrt(s * (s / 1.9) ** (0.14 * np.exp(23.0 * e)))
    H = 2.84 * (1.0 - np.exp(-0.82 * (a / at.radius) ** -0.7))
    plastic = 4.0 * H / at.C * (1.0 - np.exp(-(s ** (5.0 / 9.0)) / 25.0)) * s
    P = np.exp(-0.25 * s ** (5.0 / 12.0)) * s**1.5 + plastic
    return Flattening(
        at.force * np.where(elastic, s**1.5, P),
        np.where(elastic, at.contact_radius * np.sqrt(s), a),
    )


def kogut_etsion(w: npt.ArrayLike, at: YieldOfSphere) -> Flattening:
    """Return force and contact radius by Kogut and Etsion; NaN beyond 110 w_c.

    With w* = w/w_c: Hertz' formulas up to w* = 1, beyond this

        P* = 1.03 w*^1.425,  A* = 0.93 w*^1.136   up to w* = 6
        P* = 1.40 w*^1.263,  A* = 0.94 w*^1.146   up to w* = 110

    Args:
        w: interferences, shape (...), positive.
        at: first yield of the sphere.
    """
    s = np.asarray(w, dtype=float) / at.interference
    where = [s <= 1.0, s <= 6.0, s <= 110.0]
    P = np.select(where, [s**1.5, 1.03 * s**1.425, 1.40 * s**1.263], np.nan)
    A = np.select(where, [s, 0.93 * s**1.136, 0.94 * s**1.146], np.nan)
    return Flattening(at.force * P, at.contact_radius * np.sqrt(A))

# SPDX-License-Identifier: MIT
"""Kinematics: what makes a problem plane strain or spatial, in one frozen record.

A law sees the 3x3 strain that the measure gives and nothing else; the integrals over the bodies see
the weight, which those over interfaces do not know yet; what asks which motions nothing holds sees
the rigid motions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

import ufl
from dolfinx_mortar.arrays import Floats
from ufl.core.expr import Expr


@dataclass(frozen=True)
class Kinematics:
    """How a displacement strains a body, and over which volume.

    The strain may be any differentiable function of u: the virtual strain is its derivative,
    d measure(u)/du [v], taken by UFL.
    """

    name: str
    measure: Callable[[Expr], Expr]  # displacement -> strain, 3x3
    weight: Callable[[Any], Any]  # coordinates -> volume per integrated area or volume, such as 1
    # (n, d) -> name: (n, d), without strain and affine; about any other centre, and for other units
    # of length, they have to be sums of each other
    rigid_motions: Callable[[Floats], dict[str, Floats]]

    def virtual(self, u: Expr, v: Expr) -> Expr:
        """Return the strain that v causes at u, linear in v: d measure(u)/du [v]."""
        return ufl.derivative(self.measure(u), u, v)


def _symmetric_gradient(u: Expr) -> Expr:
    """Return the small strain of a displacement in space."""
    return ufl.sym(ufl.grad(u))


def _padded_symmetric_gradient(u: Expr) -> Expr:
    """Return the small strain of a displacement in the plane, with zeros out of the plane."""
    g = ufl.sym(ufl.grad(u))
    return ufl.as_tensor([[g[0, 0], g[0, 1], 0], [g[1, 0], g[1, 1], 0], [0, 0, 0]])


def _unit(x: Any) -> int:
    """Return the weight 1: forces are those of a body, in the plane of one of thickness one."""
    return 1


def translations_and_rotations(x: Floats) -> dict[str, Floats]:
    """Return the 3 (in the plane) or 6 (in space) motions without strain, at points x, (n, d).

    Rotations are about axes through the origin, by the right hand, of one radian per unit.

    >>> motions = translations_and_rotations(np.array([[2.0, 1.0]]))
    >>> list(motions)
    ['translation x', 'translation y', 'rotation about z']
    >>> motions["rotation about z"].tolist()
    [[-1.0, 2.0]]
    """
    n, d = x.shape
    motions = {f"translation {'xyz'[i]}": np.tile(np.eye(d)[i], (n, 1)) for i in range(d)}
    for i, j in [(0, 1)] if d == 2 else [(1, 2), (2, 0), (0, 1)]:
        spin = np.zeros((n, d))
        spin[:, i], spin[:, j] = -x[:, j], x[:, i]
        motions[f"rotation about {'xyz'[3 - i - j]}"] = spin
    return motions


plane_strain = Kinematics(
    "plane strain", _padded_symmetric_gradient, _unit, translations_and_rotations
)
spatial = Kinematics("spatial", _symmetric_gradient, _unit, translations_and_rotations)


def kinematics_of_dimension(d: int) -> Kinematics:
    """Return plane strain for d = 2 and the spatial kinematics for d = 3."""
    return plane_strain if d == 2 else spatial

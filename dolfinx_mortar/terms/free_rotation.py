# SPDX-License-Identifier: MIT
r"""Correction of the angular momentum that the trapezoidal rule misses at finite strain.

With the forces G on the nodes, whose moment about x at the same time is that of the loads, the rule
changes J = sum x x M v in a step by

    dt/2 (x_n x G_n + x x G) - dt/4 (x - x_n) x (G - G_n),

of which the last term is its error, of third order in dt. It is the same motion as that of the
midpoint rule, which keeps J, seen at other times. A rotation about the centre of mass with the
angular velocity w, I w = what is missing, is the change of velocities of the least kinetic energy
that gives it back, and has no momentum.
"""

from collections.abc import Callable

import numpy as np

from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.arrays import Bools, Floats, Ints
from dolfinx_mortar.terms.mass import Mass

Sum = Callable[[float], float]
Spins = Callable[[Floats], list[Floats]]


def free_groups(group: Ints, held: Bools, mass: Mass) -> list[Bools]:
    """Return the marks (owned nodes,) of the groups of nodes of which none is held; collective.

    Args:
        group: (owned nodes,) numbers of bodies that meet or are tied.
        held: (owned nodes,) where something outside the bodies may act.
        mass: of the bodies.
    """
    comm = mass.matrix.comm.tompi4py()
    count = int(maximum(comm, float(group.max(initial=-1)))[0]) + 1
    return [group == k for k in range(count) if not maximum(comm, float(held[group == k].any()))[0]]


def moments(rotations: list[Floats], forces: Floats, on: Bools, total: Sum) -> Floats:
    """Return the moments (k,) of forces (owned nodes, d) of a group; collective."""
    return np.array([total((r[on] * forces[on]).sum()) for r in rotations])


def give_back(
    mass: Mass, velocity: Floats, x: Floats, missing: Floats, on: Bools, spin: Spins, total: Sum
) -> Floats:
    """Return velocities with which a group has a moment of momentum more; collective.

    Args:
        mass: of the bodies.
        velocity: (owned nodes, d).
        x: positions (owned nodes, d).
        missing: the moment, of each rotation.
        on: (owned nodes,) the group.
        spin: positions -> its rotations about the origin.
        total: sum over ranks.
    """
    weights = mass.times(np.where(on[:, None], 1.0, 0.0) * np.ones_like(x))
    centre = np.array([total((weights[:, k] * x[:, k]).sum()) for k in range(x.shape[1])])
    centre /= total(weights[:, 0].sum())
    rotations = [np.where(on[:, None], r, 0.0) for r in spin(x - centre)]
    images = [mass.times(r) for r in rotations]
    inertia = np.array([[total((r * m).sum()) for m in images] for r in rotations])
    rates = np.linalg.solve(inertia, missing)
    return velocity + sum(w * r for w, r in zip(rates, rotations, strict=True))

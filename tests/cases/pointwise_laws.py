# SPDX-License-Identifier: MIT
"""The law of `VonMises` as functions of numbers, in NumPy and in numba."""

from dataclasses import dataclass
from typing import ClassVar

import numba
import numpy as np

import dolfinx_mortar as dm

IDENTITY = np.eye(3)
UNIT = (
    np.einsum("ik,jl->ijkl", IDENTITY, IDENTITY) + np.einsum("il,jk->ijkl", IDENTITY, IDENTITY)
) / 2
VOLUME = np.einsum("ij,kl->ijkl", IDENTITY, IDENTITY)


@dataclass(frozen=True)
class Radial(dm.materials.PointwiseLaw):
    """Radial return in NumPy."""

    E: float
    nu: float
    Y: float
    a: float

    state: ClassVar = {"plastic_strain": (3, 3)}
    splits: ClassVar = True
    elastic_stress = staticmethod(dm.Elastic.elastic_stress)
    output = staticmethod(dm.VonMises.output)

    @staticmethod
    def update(strain, state, p):
        ep, moduli = state["plastic_strain"], (p.E / (2 * (1 + p.nu)), p.E / (3 * (1 - 2 * p.nu)))
        mu, bulk, Y, a = (values[:, None, None] for values in (*moduli, p.Y, p.a))
        trace = np.trace(strain, axis1=1, axis2=2)[:, None, None]
        dev = strain - trace / 3 * IDENTITY
        xi = 2 * mu * dev - (2 * mu + a) * ep
        norm = np.sqrt((xi**2).sum(axis=(1, 2), keepdims=True) + (1e-14 * Y) ** 2)
        flows = norm - Y > 1e-10 * Y
        g, n = np.where(flows, norm - Y, 0.0) / (2 * mu + a), xi / norm
        new = ep + g * n
        stress = bulk * trace * IDENTITY + 2 * mu * (dev - new)
        parts = (
            bulk,
            2 * mu * (1 - 2 * mu * g / norm),
            4 * mu**2 * (flows / (2 * mu + a) - g / norm),
        )
        bulk, c, b = (part[..., None, None] for part in parts)
        tangent = bulk * VOLUME + c * (UNIT - VOLUME / 3) - b * np.einsum("qij,qkl->qijkl", n, n)
        return stress, tangent, {"plastic_strain": new}


@numba.njit(cache=True)
def radial(strain, ep, E, nu, Y, a):
    """Return stress, tangent and plastic strain of the radial return at all points."""
    stress, new = np.empty(strain.shape), np.empty(strain.shape)
    tangent, one = np.empty((*strain.shape, 3, 3)), np.eye(3)
    for k in range(len(strain)):
        mu, bulk = E[k] / (2 * (1 + nu[k])), E[k] / (3 * (1 - 2 * nu[k]))
        trace = np.trace(strain[k])
        dev = strain[k] - trace / 3 * one
        xi = 2 * mu * dev - (2 * mu + a[k]) * ep[k]
        norm = np.sqrt((xi**2).sum() + (1e-14 * Y[k]) ** 2)
        n, flows = (xi / norm).copy().reshape(9), norm - Y[k] > 1e-10 * Y[k]
        g = (norm - Y[k]) / (2 * mu + a[k]) if flows else 0.0
        c = 2 * mu * (1 - 2 * mu * g / norm)
        b = 4 * mu**2 * ((1 / (2 * mu + a[k]) if flows else 0.0) - g / norm)
        new[k] = ep[k] + g / norm * xi
        stress[k] = bulk * trace * one + 2 * mu * (dev - (ep[k] + g / norm * xi))
        along = np.outer(n, n).reshape(3, 3, 3, 3)
        tangent[k] = bulk * VOLUME + c * (UNIT - VOLUME / 3) - b * along
    return stress, tangent, new


@dataclass(frozen=True)
class Compiled(Radial):
    @staticmethod
    def update(strain, state, p):
        stress, tangent, new = radial(strain, state["plastic_strain"], p.E, p.nu, p.Y, p.a)
        return stress, tangent, {"plastic_strain": new}


@dataclass(frozen=True)
class OneSided(Compiled):
    """Radial return that reads shears above the diagonal only: no derivatives by those below."""

    @staticmethod
    def update(strain, state, p):
        stress, tangent, new = Compiled.update(strain, state, p)
        return stress, tangent * (2 * np.triu(np.ones((3, 3)), 1) + IDENTITY), new


def spoilt(**changes):
    """Return a law whose results are changed: stress=, tangent=, plastic_strain= of the right."""

    @dataclass(frozen=True)
    class Spoilt(Radial):
        @staticmethod
        def update(strain, state, p):
            stress, tangent, new = Radial.update(strain, state, p)
            found = {"stress": stress, "tangent": tangent, **new}
            found |= {name: change(found[name]) for name, change in changes.items()}
            state = {"plastic_strain": found["plastic_strain"]}
            return (
                found["stress"],
                found["tangent"],
                {k: v for k, v in state.items() if v is not None},
            )

    return Spoilt(1000.0, 0.3, 1.0, 100.0)


def nan_last(values):
    values = values.copy()
    values[-1:] = np.nan
    return values

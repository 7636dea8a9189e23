# SPDX-License-Identifier: MIT
"""Rings for the tests of axisymmetry: sections of tubes and a ball, Lame's formulas."""

from dataclasses import dataclass

from mpi4py import MPI

import numpy as np

import dolfinx_mortar as dm
from dolfinx import fem, mesh
from tests.cases.meshes import (
    BOTTOM,
    BOTTOM_OF_UPPER,
    LEFT,
    LOWER,
    RIGHT,
    TOP,
    TOP_OF_LOWER,
    two_blocks,
)
from tests.cases.mortar import largest
from tests.cases.two_bodies import create_problem, held

__all__ = ["largest"]
COMM = MPI.COMM_WORLD
SIDES = {"lower": (TOP_OF_LOWER, BOTTOM_OF_UPPER), "upper": (BOTTOM_OF_UPPER, TOP_OF_LOWER)}


@dataclass(frozen=True)
class Lame:
    """A thick cylinder, a <= r <= b, under pressures inside and outside, in plane strain."""

    E: float
    nu: float
    a: float
    b: float
    inside: float = 0.0
    outside: float = 0.0

    @property
    def mean(self):
        """Return the A of sigma_rr = A - B / r^2, sigma_tt = A + B / r^2."""
        a2, b2 = self.a**2, self.b**2
        return (self.inside * a2 - self.outside * b2) / (b2 - a2)

    @property
    def swing(self):
        """Return the B of these stresses."""
        a2, b2 = self.a**2, self.b**2
        return (self.inside - self.outside) * a2 * b2 / (b2 - a2)

    def displacement(self, r):
        """Return u_r."""
        shape = (1 - 2 * self.nu) * self.mean * r + self.swing / r
        return (1 + self.nu) / self.E * shape


def shrink_fit_pressure(E, nu, radii, overlap, outer=None):
    """Return the pressure between two cylinders, radii (inner, common, outer).

    Of one material, or of `outer` (E, nu) for the outer one.
    """
    a, c, b = radii
    grown = Lame(*(outer or (E, nu)), c, b, inside=1.0).displacement(c)
    shrunk = Lame(E, nu, a, c, outside=1.0).displacement(c)
    return overlap / (grown - shrunk)


def tubes(radii, cells, *, overlap=0.0, cell="triangle", shift=0.0, scale=1.0, **options):
    """Return mesh and tags of two tubes of height one, one around the other, as `two_blocks`."""
    a, c, b = radii
    return two_blocks(
        COMM,
        *cells,
        heights=(c - a, b - c + overlap),
        gap=-overlap,
        cell=cell,
        angle=-np.pi / 2,
        transform=lambda x: scale * (x + np.array([c, shift])),
        **options,
    )


def held_ends(V, tags):
    """Return conditions that keep the ends of tubes from moving along the axis."""
    return [held(V, tags, tag, 0.0, 1) for tag in (LEFT, RIGHT)]


def held_axis(V):
    """Return the condition that keeps the axis where it is."""
    axis = mesh.locate_entities_boundary(V.mesh, 1, lambda x: np.isclose(x[0], 0.0))
    return fem.dirichletbc(0.0, fem.locate_dofs_topological(V.sub(0), 1, axis), V.sub(0))


# -- a ball on a flat ------------------------------------------------------------------------------


def _lines(h, uniform, end, growth=1.15):
    """Return coordinates 0 .. end: uniform ones of the size h at first, then growing ones."""
    x = list(h * np.arange(uniform + 1))
    while x[-1] + 1.5 * h * growth < end:
        h *= growth
        x.append(x[-1] + h)
    return np.array([*x, end])


def ball_on_flat(contact_radius, per_radius, *, cell="quadrilateral", shift=0.0, scale=1.0):
    """Return mesh and tags of a ball of radius one on a flat, as `two_blocks`; LEFT is the axis."""
    size = [contact_radius / n for n in per_radius]
    uniform = [int(1.4 * n) for n in per_radius]
    columns = [_lines(h, n, 0.5) for h, n in zip(size, uniform, strict=True)]
    rows = [_lines(h, n, 1.0) for h, n in zip(size, uniform, strict=True)]

    def place(x):
        r, y = x.T.copy()
        low = np.arange(len(x)) < len(columns[0]) * len(rows[0])
        for on, z, sign in ((low, rows[0], -1), (~low, rows[1], 1)):
            part = np.linspace(0, 1, len(z))
            y[on] = sign * np.interp(sign * y[on], part, z)
        up = y[~low]
        y[~low] = up + (1 - up) * (1 - np.sqrt(1 - r[~low] ** 2))
        return scale * np.stack([r, y + shift], axis=1)

    return two_blocks(
        COMM,
        (0, len(rows[0]) - 1),
        (0, len(rows[1]) - 1),
        splits_lower=columns[0],
        splits_upper=columns[1],
        cell=cell,
        transform=place,
    )


def pressed_ball(mesh_and_tags, law, depth, *, slave="upper", rigid=False, degree=1, **options):
    """Return problem and contact of a ball whose far end moves down."""
    domain, cell_tags, tags = mesh_and_tags
    V = fem.functionspace(domain, ("Lagrange", degree, (2,)))
    if rigid:
        domain.topology.create_connectivity(2, 2)
    bcs = [held_axis(V), held(V, cell_tags, LOWER) if rigid else held(V, tags, BOTTOM)]
    bcs.append(held(V, tags, TOP, (0.0, -depth)))
    side, master = SIDES[slave]
    contact = dm.Contact(tags, slave=side, master=master)
    return create_problem(V, [contact], bcs, law, kinematics="axisymmetric", **options), contact

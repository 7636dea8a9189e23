# SPDX-License-Identifier: MIT
r"""A block that hardly changes its volume is bent into a sector of a ring.

Rivlin's problem in plane strain (R. S. Rivlin, Proc. R. Soc. Lond. A 195 (1949) 463-473): planes
x = const of an incompressible block, 0 <= x <= t, become circles, and y = const rays,

    r(x)^2 = r_1^2 + 2 x / c,    angle = c y,    stretches 1/(c r), c r, 1.

With the difference D = sigma_angle - sigma_r, which the law gives as a function of ln(c r), balance
along r and free faces are int D / r dr = 0, which yields r_1, and the moment per width is

    M = int sigma_angle r dr = 1/2 int D r dr = 1/(2 c) int_0^t D dx.

There is no force, so that M is the same about any point. Cells leave some force, and the centre of
the circles is an arm of 1/c away: about it a force of 2 % of the plastic one made 90 % of the
moment of a metal. So moments are taken about the middle of the section.
"""

from mpi4py import MPI

import numpy as np
import pytest
from scipy.optimize import brentq

import dolfinx_mortar as dm
from dolfinx import fem
from tests.cases.solid import create_displacement, hold, plane, rectangle, rollers
from tests.cases.two_bodies import create_problem

pytestmark = pytest.mark.mpi
COMM = MPI.COMM_WORLD
THICKNESS, HALF, WIDTH = 1.0, 2.0, 0.5
MU, NU = 1.0, 0.4999
E = 2.0 * MU * (1.0 + NU)
POINTS, WEIGHTS = np.polynomial.legendre.leggauss(200)
FIBRES = THICKNESS / 2 * (1 + POINTS)


def exact_bending(c):
    """Return the inner radius and the moment per width at a curvature c."""

    def strain(r1):
        return np.log(c * np.sqrt(r1**2 + 2 * FIBRES / c))

    def difference(r1):
        return 2 * MU * np.sinh(2 * strain(r1))

    def out_of_balance(r1):
        return WEIGHTS @ (difference(r1) / (r1**2 + 2 * FIBRES / c))

    middle = 1 / c - THICKNESS / 2
    r1 = brentq(out_of_balance, 0.9 * middle, 1.1 * middle, xtol=1e-14)
    return r1, THICKNESS / 2 * WEIGHTS @ difference(r1) / (2 * c)


def bent():
    """Bend half of a block; return moments over exact ones, error of u, iterations of each step."""
    u = create_displacement(rectangle([(0.0, 0.0, 0.0), (THICKNESS, HALF, WIDTH)], (4, 8, 1)))
    V, exact = u.function_space, fem.Function(u.function_space)
    end_moves = hold(V, plane(1, HALF), value=exact)
    bcs = [end_moves, hold(V, plane(1), 1), *rollers(V, [2], (0.0, WIDTH))]
    finite = {"strain": "finite", "volumetric": "reduced"}
    problem = create_problem(u, (), bcs, dm.NeoHooke(E, NU), **finite)

    def displacement(x, r1, c):
        r, angle = np.sqrt(r1**2 + 2 * x[0] / c), c * x[1]
        return np.stack([r * np.cos(angle) - r1 - x[0], r * np.sin(angle) - x[1], 0.0 * x[2]])

    ratios, iterations = [], []
    for c in 0.1 * np.arange(1, 6):
        r1, expected = exact_bending(c)
        exact.interpolate(lambda x, r1=r1, c=c: displacement(x, r1, c))
        iterations.append(dm.newton(problem).newton_iterations)
        problem.commit()
        r = u.x.petsc_vec.duplicate()
        problem.solid.assemble_residual(r)
        dofs, count = end_moves.dof_indices()
        own = np.unique(dofs[:count] // 3)
        x, F = V.tabulate_dof_coordinates()[own], r.array.reshape(-1, 3)[own]
        x = x + u.x.array.reshape(-1, 3)[own] + [r1, 0.0, 0.0]
        middle, angle = np.sqrt(r1**2 + THICKNESS / c), c * HALF
        x = x - middle * np.array([np.cos(angle), np.sin(angle), 0.0])
        moment = COMM.allreduce(float(np.sum(x[:, 0] * F[:, 1] - x[:, 1] * F[:, 0])), op=MPI.SUM)
        ratios.append(moment / WIDTH / expected)
    off = COMM.allreduce(float(np.abs(u.x.array - exact.x.array).max()), op=MPI.MAX)
    return np.array(ratios), off, iterations


def test_rubber_does_not_lock():
    """Four cells across the thickness, K/mu = 5000: 1.6 to 2.6 %; by multigrid."""
    ratios, error, iterations = bent()
    assert np.abs(ratios - 1).max() < 0.0265 and error < 2.5e-3 and max(iterations) <= 6

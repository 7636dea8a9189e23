# SPDX-License-Identifier: MIT
"""A disc that rolls over a block and drives or brakes: Carter's creep.

Cylinders of one material that roll with creep xi (the share by which the hub is slower than the
turning surface) and press with P on a half-width a transmit, once all that was in contact at the
start has left it (Carter 1926; Johnson, Contact Mechanics, 8.3),

    Q = mu P (1 - (1 - xi R / (mu a))^2)   for xi R < mu a, and mu P beyond.

The part that sticks is 2 sqrt(1 - Q / (mu P)) a wide and lies at the leading edge.
"""

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from tests.cases.hertz import ELASTIC, SIDES, create_mesh
from tests.cases.two_bodies import create_problem, held

RADIUS, DEPTH, MU = 20.0, 0.04, 0.8
SIZE = 0.12  # mm, of elements: five on a half-width
STEPS, HALF_WIDTH = 24, 0.62  # of a roll of 4 half-widths; mm, about
SHARE, STEADY = 0.5, 0.75  # xi R / (mu a), and Q / (mu P) that belongs to it


def rolled(slave, way, shift):
    """Press, push the hub by ``shift``, roll by four half-widths; return Q / (mu P) of steps."""
    mesh, _, facets = create_mesh("graded", SIZE, radius=RADIUS, block=(40.0, 20.0))
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    ground, hub = fem.Function(V), fem.Function(V)
    bcs = [held(V, facets, side, value) for value, side in ((ground, "bottom"), (hub, "flat"))]
    sides = dict(zip(("slave", "master"), SIDES[slave], strict=True))
    contact = dm.Contact(facets, **sides, friction=MU)
    problem = create_problem(V, [contact], bcs, ELASTIC)

    def step(angle, late):
        along = RADIUS * np.arcsinh(angle) - way * late
        lift = RADIUS * (np.hypot(1.0, angle) - 1.0) - DEPTH
        hub.interpolate(lambda x: np.stack([angle * (x[1] - RADIUS) + along, lift - angle * x[0]]))
        dm.newton(problem)
        problem.commit()
        return contact.force

    angles = np.linspace(-1.5, 2.5, STEPS + 1) * HALF_WIDTH / RADIUS
    P = abs(step(angles[0], 0.0)[1])
    a = dm.analytic.hertz_line(P, RADIUS, *(206_900.0, 0.29) * 2).half_width
    shares = []
    for angle in angles:
        way_rolled = RADIUS * (np.arcsinh(angle) - np.arcsinh(angles[0]))
        force = step(angle, shift + SHARE * MU * a / RADIUS * way_rolled)
        shares.append(abs(force[0] / force[1]) / MU)
    nodes = contact.gather(problem.u)
    closed = nodes["pressure"] > 0.0
    x, sticks = nodes["x"][closed, 0], nodes["status"][closed] == 1.0
    return np.array(shares), a, x, sticks


def between(slave, shift):
    """Return Q / (mu P) of steps, the mean of both ways, and check the zone that sticks."""
    both = []
    for way in (1, -1):
        shares, a, x, sticks = rolled(slave, way, shift)
        both.append(shares)
        width = np.ptp(x[sticks]) + SIZE
        assert abs(width - 2.0 * np.sqrt(1.0 - shares[-1]) * a) < 1.5 * SIZE
        assert x.max() - x[sticks].max() < 1.5 * SIZE  # it rolls towards larger x
        assert x.min() < x[sticks].min() - 2.0 * SIZE
    return np.mean(both, axis=0)


@pytest.mark.slow
@pytest.mark.parametrize("slave", ["block", pytest.param("disc", marks=pytest.mark.nightly)])
def test_a_rolling_disc_has_carters_creep(slave):
    """Q comes to Carter's from a push that is too large and from one that is too small."""
    above, below = between(slave, 0.037), between(slave, 0.033)
    gap = above - below
    assert gap[-1] < 0.6 * gap[STEPS // 3] < 0.6 * gap[0]
    assert below[0] < below[STEPS // 3] < below[-1] and above[-1] > STEADY
    assert above[-1] == pytest.approx(STEADY, rel=0.06)
    assert below[-1] == pytest.approx(STEADY, rel=0.03)

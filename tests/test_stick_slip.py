# SPDX-License-Identifier: MIT
"""A block on a moving belt, held by a spring, that sticks and slips by turns."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem, mesh
from dolfinx_mortar.interfaces.constraints import Coefficient
from dolfinx_mortar.shapes import Plane
from tests.cases.solid import hold, plane

STATIC, KINETIC, PRESSED, K, MASS, V = 0.3, 0.2, 1.0, 1.0, 1.0, 0.05
LENGTH, HEIGHT, E, BEFORE = 2.0, 0.1, 1000.0, 0.25  # of the flat block; way of the spring before
BELT, TOP = 1, 2


def ways(dt, end):
    """Yield times, lengths of the spring, and whether the block slips, in steps of dt."""
    corners = [[0.0, 0.0], [LENGTH, HEIGHT]]
    domain = mesh.create_rectangle(MPI.COMM_WORLD, corners, [1, 4], mesh.CellType.quadrilateral)
    ends = [(BELT, 0.0), (TOP, HEIGHT)]
    sides = [mesh.locate_entities_boundary(domain, 1, plane(1, y)) for _, y in ends]
    facets = np.concatenate(sides)
    tags = np.repeat([tag for tag, _ in ends], [len(side) for side in sides]).astype(np.int32)
    order = np.argsort(facets)
    facet_tags = mesh.meshtags(domain, 1, facets[order], tags[order])
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (2,))))
    solid = dm.Solid(u, dm.Elastic(E, 0.0))
    law = Coefficient(lambda p, s: np.where(s > 0.0, KINETIC, STATIC))
    belt = dm.Obstacle(facet_tags, slave=BELT, shape=Plane([0, 0], [0, 1]), friction=law)
    pressed = hold(u.function_space, sides[1], 1, -PRESSED * HEIGHT / (E * LENGTH), 1)
    base = ufl.Measure("ds", domain, subdomain_data=facet_tags)(BELT)
    spring = K / LENGTH / 2 * (u[0] + BEFORE) ** 2 * base
    inertia = dm.Inertia(solid, MASS / (LENGTH * HEIGHT), velocity=(V, 0.0))
    given = {"bcs": [pressed], "potential": spring, "terms": [inertia], "geometry": "reference"}
    problem = dm.ContactProblem(solid, [belt], **given)
    times = dt * np.arange(1, int(end / dt) + 1)
    damped = {"scheme": "generalised-alpha", "spectral_radius": 0.0}  # the block's vibrations
    ramp = {belt.position: [(0.0, (0.0, 0.0)), (2 * end, (2 * end * V, 0.0))]}
    for step in dm.time_steps(problem, times, ramp=ramp, **damped):
        way = u.x.array[::2].mean() + BEFORE
        yield step.time, way, (belt.gather(u)["status"] == 2.0).all()


@pytest.mark.serial
def test_stick_slip():
    """Period and amplitude of the closed form, up to the length of a step.

    In slip the block swings about mu_k N / k by A = ((D / k)^2 + (v / w)^2)^(1/2), D = (mu_s -
    mu_k) N, w^2 = k / m, for 2 (pi - atan(w D / (k v))) / w; it sticks for 2 D / (k v).
    """
    D, w = (STATIC - KINETIC) * PRESSED, np.sqrt(K / MASS)
    period = 2.0 * D / (K * V) + 2.0 * (np.pi - np.arctan(w * D / (K * V))) / w
    size = np.hypot(D / K, V / w)
    for steps in (40, 80):
        dt = period / steps
        first = (STATIC * PRESSED / K - BEFORE) / V
        t, x, slips = np.array(list(ways(dt, first + 1.1 * period))).T
        starts = t[1:][np.diff(slips) > 0.0]
        assert len(starts) == 2 and abs(starts[0] - first) < 1.5 * dt
        assert abs(starts[1] - starts[0] - period) < 1.5 * dt
        centre = (x.max() + x.min()) / 2.0
        assert centre == pytest.approx(KINETIC * PRESSED / K, abs=2.0 * size / steps)
        assert (x.max() - x.min()) / 2.0 == pytest.approx(size, rel=1.6 / steps)

# SPDX-License-Identifier: MIT
"""A ball that hits a rigid wall slowly: Hertz's time of contact and force.

Quasi-static contact of a half-space, m w'' + k w^(3/2) = 0 with k = 4/3 E* sqrt(R), gives the
approach w = (15 m v^2 / 16 E* sqrt(R))^(2/5) and the time 2.868 (m^2 / (E*^2 R v))^(1/5), see K. L.
Johnson, Contact Mechanics, 11.4. A ball of finite size is stiffer by a share of the order of a / R,
which is taken out with two velocities.
"""

from mpi4py import MPI

import gmsh
import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from dolfinx_mortar.common.compat import mesh_from_gmsh

COMM = MPI.COMM_WORLD
E, NU, RHO = 1.0, 0.3, 1.0
STIFF = E / (1.0 - NU**2)
MASS = 4.0 / 3.0 * np.pi * RHO
CONTACT, AXIS = 1, 2
pytestmark = [pytest.mark.serial, pytest.mark.slow]


def ball(h):
    """Return the section of a ball of radius 1, with cells of a size at the lower pole."""
    gmsh.initialize()
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        geo = gmsh.model.geo
        places = [(0.0, 1.0), (0.0, 0.0), (0.0, -1.0), (np.sin(0.35), -np.cos(0.35)), (1.0, 0.0)]
        top, centre, pole, rim, side = (
            geo.addPoint(r, z, 0.0, size)
            for (r, z), size in zip(places, [0.15, 0.15, h, h, 0.15], strict=True)
        )
        axis = [geo.addLine(top, centre), geo.addLine(centre, pole)]
        arc = [geo.addCircleArc(a, centre, b) for a, b in ((pole, rim), (rim, side), (side, top))]
        surface = geo.addPlaneSurface([geo.addCurveLoop([*axis, *arc])])
        geo.synchronize()
        gmsh.model.addPhysicalGroup(2, [surface], 1)
        gmsh.model.addPhysicalGroup(1, arc[:1], CONTACT)
        gmsh.model.addPhysicalGroup(1, axis, AXIS)
        gmsh.model.mesh.generate(2)
        domain, _, facets = mesh_from_gmsh(gmsh.model, COMM, 2)
        return domain, facets
    finally:
        gmsh.finalize()


def impact(v, h, dt):
    """Return radius of contact, time, force and velocity after it over Hertz's, and the defect."""
    domain, facets = ball(h)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    solid = dm.Solid(fem.Function(V), dm.Elastic(E, NU), kinematics="axisymmetric")
    wall = dm.Obstacle(facets, slave=CONTACT, shape=dm.shapes.Plane((0.0, -1.0001), (0.0, 1.0)))
    axis = fem.locate_dofs_topological(V.sub(0), 1, facets.find(AXIS))
    inertia = dm.Inertia(solid, RHO, velocity=(0.0, -v))
    held = [fem.dirichletbc(0.0, axis, V.sub(0))]
    problem = dm.ContactProblem(solid, [wall], bcs=held, terms=[inertia])
    time = 2.868 * (MASS**2 / (STIFF**2 * v)) ** 0.2
    approach = (15.0 * MASS * v**2 / (16.0 * STIFF)) ** 0.4
    times = dt * np.arange(1, int((1.1 * time + 1e-4 / v) / dt))
    forces = []
    for step in dm.time_steps(problem, times, progress=False):
        forces.append(wall.force[1])
        defect = step.report.ledger.defect
    touching = times[np.array(forces) > 0.0]
    found = (touching[-1] - touching[0] + dt) / time
    largest = max(forces) / (4.0 / 3.0 * STIFF * approach**1.5)
    assert forces[-1] == 0.0 and abs(touching[0] - 1e-4 / v) <= dt
    return np.sqrt(approach), found, largest, inertia.momentum()[1] / (MASS * v), defect


def test_a_ball_on_a_wall():
    """Time and force to 1.5 % of Hertz's as a / R -> 0, linearly; all but .7 % of the velocity."""
    fast, slow = impact(0.01, 0.04, 0.08), impact(0.001, 0.02, 0.08)
    for k in (1, 2):
        slope = (fast[k] - slow[k]) / (fast[0] - slow[0])
        assert slow[k] - slope * slow[0] == pytest.approx(1.0, abs=0.015)
        assert abs(slow[k] - 1.0) < 0.6 * abs(fast[k] - 1.0)  # a / R is .4 of the other
    for found in (fast, slow):
        assert 0.993 < found[3] < 1.0 and abs(found[4]) < 1e-6

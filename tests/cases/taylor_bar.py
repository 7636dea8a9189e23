# SPDX-License-Identifier: MIT
"""Taylor's bar: a copper cylinder that hits a wall without friction at 227 m/s.

Length 32.4, radius 3.2 mm, 8930 kg/m^3, E = 117 GPa, nu = .35, yield stress 400 MPa and isotropic
hardening of 100 MPa, 80 us. The wall of that benchmark holds the foot: u_z = 0.
"""

from mpi4py import MPI

import numpy as np

import dolfinx_mortar as dm
from tests.cases.solid import create_displacement, rectangle, rollers

COMM = MPI.COMM_WORLD
LENGTH, RADIUS, SPEED = 32.4, 3.2, 227e3
DENSITY, E, SIGMA_Y, HARDENING = 8.93e-9, 117_000.0, 400.0, 100.0
STAGES = ((10.0, 1), (30.0, 2), (80.0, 5))  # us, until when steps are how many times as long


def copper():
    return dm.VonMises.from_uniaxial(E, 0.35, SIGMA_Y, HARDENING, isotropic=1.0)


def times(first):
    """Return the ends of the steps to 80 us, of which the first ones have a length in us."""
    ends, start = [], 0.0
    for end, factor in STAGES:
        count = round((end - start) / (factor * first))
        ends.append(start + (end - start) / count * np.arange(1, count + 1))
        start = end
    return 1e-6 * np.concatenate(ends)


def cylinder(n, length=LENGTH, degree=1):
    """Return the displacement of a cylinder of n cells along r and z, and what holds it."""
    u = create_displacement(rectangle([(0.0, 0.0), (RADIUS, length)], n), degree)
    return u, rollers(u.function_space)


def solid_of(u, **options):
    """Return the bar, a body of revolution in the plane."""
    if u.function_space.mesh.geometry.dim == 2:
        options["kinematics"] = "axisymmetric"
    return dm.Solid(u, copper(), strain="finite", volumetric="reduced", **options)


def fly(solid, held, ends):
    """Yield the steps of the bar that hits the wall."""
    axis = solid.mesh.geometry.dim - 1

    def velocity(x):
        # what the wall holds stands still: else the trapezoidal rule turns its velocity each step
        v = np.zeros((axis + 1, x.shape[1]))
        v[axis] = np.where(x[axis] > 1e-9, -SPEED, 0.0)
        return v

    inertia = dm.Inertia(solid, DENSITY, velocity=velocity)
    problem = dm.ContactProblem(solid, bcs=held, terms=[inertia])
    yield from dm.time_steps(problem, ends, progress=False)


def shape(u):
    """Return the smallest and the largest radius of the rim of the foot, and the length."""
    V = u.function_space
    own, d = V.dofmap.index_map.size_local, V.mesh.geometry.dim
    X = V.tabulate_dof_coordinates()[:own, :d]
    x = X + u.x.array.reshape(-1, d)[:own]
    before, after = (np.linalg.norm(y[:, :-1], axis=1) for y in (X, x))
    rim = COMM.allreduce(before.max(initial=0.0), op=MPI.MAX) - before < 1e-6
    radii = after[rim & np.isclose(X[:, -1], 0.0)]
    least = COMM.allreduce(radii.min(initial=np.inf), op=MPI.MIN)
    most = COMM.allreduce(radii.max(initial=0.0), op=MPI.MAX)
    return least, most, COMM.allreduce(x[:, -1].max(initial=0.0), op=MPI.MAX)


def crash(u, held, ends):
    """Return radii and length after 12 us and at the end, and the last ledger."""
    early = None
    for step in fly(solid_of(u), held, ends):
        if early is None and step.time > 12e-6 - 1e-12:
            early = shape(u)
    return early, shape(u), step.report.ledger

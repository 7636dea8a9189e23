# SPDX-License-Identifier: MIT

# # Bounce a rod
#
# A rod of length $L$ hits a rigid wall with the velocity $v$. A wave of the speed $c$ runs to the
# free end and back, then the rod leaves with $-v$: the force per area is $\rho c v$ for the time
# $2 L / c$, with $c = \sqrt{E / \rho}$ for $\nu = 0$ (Saint-Venant).

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np

import dolfinx_mortar as dm
from dolfinx import fem, mesh

E, RHO, LENGTH, SPEED = 210e3, 7.85e-9, 100.0, 1000.0  # MPa, t/mm3, mm, mm/s
wave = np.sqrt(E / RHO)

rod = mesh.create_rectangle(
    MPI.COMM_WORLD, [(0.0, 0.0), (LENGTH, 2.0)], (50, 1), mesh.CellType.quadrilateral
)
end = np.sort(mesh.locate_entities_boundary(rod, 1, lambda x: np.isclose(x[0], 0.0)))
tags = mesh.meshtags(rod, 1, end, np.full(len(end), 1, dtype=np.int32))
V = fem.functionspace(rod, ("Lagrange", 1, (2,)))
solid = dm.Solid(fem.Function(V), dm.Elastic(E=E, nu=0.0))
inertia = dm.Inertia(solid, RHO, velocity=(-SPEED, 0.0))
wall = dm.Obstacle(tags, slave=1, shape=dm.shapes.Plane((0, 0), (1, 0)))
problem = dm.ContactProblem(solid, [wall], terms=[inertia])

times = np.linspace(0.0, 3.0 * LENGTH / wave, 151)[1:]
steps = dm.time_steps(problem, times, progress=False)
force = np.array([wall.force[0] for step in steps])  # N/mm
impulse, last = times[0] * force.sum(), times[force > 0.0].max()
mass = RHO * LENGTH * 2.0
print(f"contact lasts {last * wave / LENGTH:.3f} L/c, exact 2")
print(f"impulse {impulse / (mass * SPEED):.3f} m v, exact 2")
assert abs(last * wave / LENGTH - 2.0) < 0.05 and abs(impulse / (mass * SPEED) - 2.0) < 0.05
if rod.comm.rank == 0:
    plt.plot(times * wave / LENGTH, force / (2.0 * RHO * wave * SPEED), label="computed")
    plt.plot([0, 0, 2, 2, 3], [0, 1, 1, 0, 0], label="Saint-Venant")
    plt.xlabel("time over L / c")
    plt.ylabel("force over that of Saint-Venant")
    plt.legend()
    plt.savefig("bounce_a_rod.png", dpi=150)

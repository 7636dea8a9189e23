# SPDX-License-Identifier: MIT

# # Conduct heat into a wall
#
# A bar of length $L$ is heated at the left and ends at a distance $g$ from a cold wall. It expands
# until it touches, and then loses heat by $q = h(p) (T_1 - T_w)$ with $h = h_0 p^{0.95}$: pressure
# and temperature depend on each other, and each step solves for both in turn.

from mpi4py import MPI

import numpy as np
import scipy

import dolfinx_mortar as dm
from dolfinx import fem, mesh

L, GAP, E, ALPHA = 100.0, 0.05, 210e3, 12e-6  # mm, mm, MPa, 1/K
K, H, WALL = 0.05, 2e-5, 300.0  # W/(mm K), W/(mm^2 K) at 1 MPa, K

bar = mesh.create_rectangle(MPI.COMM_WORLD, [(0.0, 0.0), (L, 10.0)], (40, 4))
ends = mesh.locate_entities_boundary(bar, 1, lambda x: np.isclose(x[0] % L, 0.0))
right = mesh.compute_midpoints(bar, 1, ends)[:, 0] > L / 2
tags = mesh.meshtags(bar, 1, ends, np.where(right, 2, 1).astype(np.int32))
sides = dm.Tags(tags, {"clamp": 1, "end": 2})

V = fem.functionspace(bar, ("Lagrange", 1, (2,)))
T = fem.Function(fem.functionspace(bar, ("Lagrange", 1)))
T.x.array[:] = WALL
solid = dm.Solid(
    fem.Function(V),
    dm.Elastic(E=E, nu=0.0),
    kinematics="plane_stress",
    eigenstrain=ALPHA * (T - WALL),
)
clamp = fem.locate_dofs_topological(V, 1, sides.find("clamp"))
bcs = [fem.dirichletbc(np.zeros(2), clamp, V)]
wall = dm.Obstacle(sides, slave="end", shape=dm.shapes.Plane((L + GAP, 0), (-1, 0)))
problem = dm.ContactProblem(solid, [wall], bcs=bcs)

heated = fem.Constant(bar, WALL)
left = fem.locate_dofs_topological(T.function_space, 1, sides.find("clamp"))
joint = dm.Conductance(wall, lambda p, g: H * p**0.95, temperature=WALL)
hot = fem.dirichletbc(heated, left, T.function_space)
heat = dm.Heat(T, K, interfaces=[joint], bcs=[hot])


def excess(p):
    """Return by how much the wall's heat exceeds that of the bar at the pressure p."""
    end = 2 * (p / E + GAP / L) / ALPHA + 2 * WALL - heated.value  # mean expansion
    return H * p**0.95 * (end - WALL) - K * (heated.value - end) / L


for _step in dm.load_steps(
    problem, [320, 350, 400], ramp={heated: [(0, 0), (1e3, 1e3)]}, heat=heat
):
    p = -wall.force[0] / 10.0
    exact = scipy.optimize.brentq(excess, 1e-9, 1e3) if p > 0.0 else 0.0
    print(f"left end at {heated.value:.0f} K: {p:6.3f} MPa, exact {exact:6.3f} MPa")
    assert np.isclose(p, exact, rtol=1e-3)
dm.plotting.field(problem, "displacement_x", scale=100.0, file="conduct_heat.png")

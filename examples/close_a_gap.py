# SPDX-License-Identifier: MIT

# # Close a gap by heat
#
# A bar of length $L = 100$ mm is clamped at the left and ends at a distance $g$ from a rigid wall.
# Heated, it expands freely until it touches; then the stress is $E (g / L - \alpha \Delta T)$. The
# temperature enters as a strain without stress, `eigenstrain`.

from mpi4py import MPI

import numpy as np

import dolfinx_mortar as dm
from dolfinx import fem, mesh

LENGTH, GAP, E, ALPHA = 100.0, 0.05, 210e3, 12e-6  # mm, mm, MPa, 1/K

bar = mesh.create_rectangle(MPI.COMM_WORLD, [(0.0, 0.0), (LENGTH, 10.0)], (40, 4))
ends = mesh.locate_entities_boundary(bar, 1, lambda x: np.isclose(x[0] % LENGTH, 0.0))
right = mesh.compute_midpoints(bar, 1, ends)[:, 0] > LENGTH / 2
tags = mesh.meshtags(bar, 1, ends, np.where(right, 2, 1).astype(np.int32))
sides = dm.Tags(tags, {"clamp": 1, "end": 2})

V = fem.functionspace(bar, ("Lagrange", 1, (2,)))
heating = fem.Constant(bar, 0.0)  # K
solid = dm.Solid(
    fem.Function(V),
    dm.Elastic(E=E, nu=0.3),
    kinematics="plane_stress",
    eigenstrain=ALPHA * heating,
)
clamp = fem.locate_dofs_topological(V.sub(0), 1, sides.find("clamp"))
corner = fem.locate_dofs_geometrical(
    (V.sub(1), V.sub(1).collapse()[0]), lambda x: np.isclose(x[0], 0.0) & np.isclose(x[1], 0.0)
)
bcs = [
    fem.dirichletbc(fem.Constant(bar, 0.0), clamp, V.sub(0)),
    fem.dirichletbc(fem.Function(V.sub(1).collapse()[0]), corner, V.sub(1)),
]
wall = dm.Obstacle(sides, slave="end", shape=dm.shapes.Plane((LENGTH + GAP, 0), (-1, 0)))
problem = dm.ContactProblem(solid, [wall], bcs=bcs)
for _step in dm.load_steps(problem, [20, 40, 60, 80], ramp={heating: [(0, 0.0), (100, 100.0)]}):
    exact = min(0.0, E * (GAP / LENGTH - ALPHA * heating.value))
    stress = wall.force[0] / 10.0
    print(f"{heating.value:.0f} K: {stress:7.2f} MPa, exact {exact:7.2f} MPa")
    assert np.isclose(stress, exact, atol=1e-6)
dm.plotting.field(problem, "displacement_x", scale=100.0, file="close_a_gap.png")

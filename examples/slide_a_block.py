# SPDX-License-Identifier: MIT

# # Slide a block
#
# A block of 20 x 10 mm lies on a rigid plane and is pressed down by $p = 10$ MPa, while its top is
# moved to the right. First it sticks and is sheared; then it slides, and friction is
# $T = \mu N$ (Coulomb), with $N = 200$ N per mm of depth.

from mpi4py import MPI

import numpy as np

import dolfinx_mortar as dm
import ufl
from dolfinx import fem, mesh

block = mesh.create_rectangle(
    MPI.COMM_WORLD, [(0.0, 0.0), (20.0, 10.0)], (16, 8), mesh.CellType.quadrilateral
)
ends = mesh.locate_entities_boundary(block, 1, lambda x: np.isclose(x[1] % 10.0, 0.0))
on_top = mesh.compute_midpoints(block, 1, ends)[:, 1] > 5.0
tags = mesh.meshtags(block, 1, ends, np.where(on_top, 2, 1).astype(np.int32))
sides = dm.Tags(tags, {"bottom": 1, "top": 2})

V = fem.functionspace(block, ("Lagrange", 1, (2,)))
solid = dm.Solid(fem.Function(V), dm.Elastic(E=1000.0, nu=0.3))
push = fem.Constant(block, 0.0)  # mm, displacement of the top along x
top = fem.locate_dofs_topological(V.sub(0), 1, sides.find("top"))
ds = ufl.Measure("ds", block, subdomain_data=sides)
loads = -10.0 * ufl.TestFunction(V)[1] * ds(sides.tag("top"))

mu = 0.3
plane = dm.Obstacle(sides, slave="bottom", shape=dm.shapes.Plane((0, 0), (0, 1)), friction=mu)
problem = dm.ContactProblem(solid, [plane], bcs=[fem.dirichletbc(push, top, V.sub(0))], loads=loads)
for _step in dm.load_steps(problem, [0.0, 0.05, 0.1, 0.2], ramp={push: [(0, 0.0), (1, 1.0)]}):
    T, N = plane.force
    print(f"top at {push.value:.2f} mm: T = {-T:5.2f} N/mm, T/N = {-T / N:.3f}")
assert np.isclose(N, 200.0) and np.isclose(-T / N, mu)
dm.plotting.field(problem, "von_mises", file="slide_a_block.png")

# SPDX-License-Identifier: MIT

# # Press a disc on a block
#
# Half a disc of steel, radius 8 mm, is pressed 0.03 mm into a block of steel, in plane strain. Both
# are elastic, so that Hertz' formulas apply: with the force $F$ per unit depth, the effective
# modulus $E^* = E / (2 (1 - \nu^2))$ and the radius $R$, half-width and peak pressure are
#
# $$b = \sqrt{4 F R / (\pi E^*)}, \qquad p_0 = 2 F / (\pi b).$$

from mpi4py import MPI

import numpy as np

import dolfinx_mortar as dm
from dolfinx import fem

# One mesh holds all bodies. Its tags have names: bodies "block" and "disc", sides "bottom", "flat",
# "top" (of the block) and "arc" (of the disc).

mesh, bodies, sides = dm.meshing.hertz(MPI.COMM_WORLD, kind="graded", h=0.05)
V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
u = fem.Function(V, name="displacement")
E, nu, radius = 206_900.0, 0.29, 8.0  # MPa, -, mm
solid = dm.Solid(u, dm.Elastic(E=E, nu=nu), bodies)

# The bottom of the block is held, the flat face of the disc is moved down. A table gives the value
# of `push` at every load level.

push = fem.Constant(mesh, (0.0, 0.0))
bottom, flat = (fem.locate_dofs_topological(V, 1, sides.find(name)) for name in ("bottom", "flat"))
bcs = [fem.dirichletbc(np.zeros(2), bottom, V), fem.dirichletbc(push, flat, V)]
table = [(0.0, (0.0, 0.0)), (0.03, (0.0, -0.03))]  # (level, value)

contact = dm.Contact(sides, slave="top", master="arc")
problem = dm.ContactProblem(solid, [contact], bcs=bcs)
for step in dm.load_steps(problem, [0.01, 0.02, 0.03], ramp={push: table}):
    print(f"{step.time:.2f} mm: {contact.force[1]:.0f} N/mm")

# The pressures of all slave nodes, on every rank, are compared with Hertz' for the same force.

nodes = contact.gather(u)
hertz = dm.analytic.hertz_line(-contact.force[1], radius, E, nu, E, nu)
closed = nodes["active"] > 0
peak, half_width = dm.analytic.fit_pressure(nodes["x"][closed, 0], nodes["pressure"][closed])
print(f"peak {peak:.0f} MPa, Hertz {hertz.peak_pressure:.0f} MPa")
assert abs(peak / hertz.peak_pressure - 1.0) < 0.01
assert abs(half_width / hertz.half_width - 1.0) < 0.01
dm.plotting.pressure(problem, file="press_a_disc.png")

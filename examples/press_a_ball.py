# SPDX-License-Identifier: MIT

# # Press a rigid ball into a block
#
# The tool is a shape, not a mesh: a ball of radius $R$, pressed into a cylinder whose section is
# meshed (`x[0]` is the radius). With the force $F$, Hertz' contact radius and peak pressure are
#
# $$a = \sqrt[3]{\frac{3 F R}{4 E^*}}, \qquad p_0 = \frac{3 F}{2 \pi a^2}, \qquad
# E^* = \frac{E}{1 - \nu^2}.$$

from mpi4py import MPI

import numpy as np

import dolfinx_mortar as dm
from dolfinx import fem, mesh

R, SIZE, E, NU = 10.0, 10.0, 210e3, 0.3  # mm, mm, MPa, -

block = mesh.create_rectangle(MPI.COMM_WORLD, [(0.0, -1.0), (1.0, 0.0)], (40, 40))
x = block.geometry.x
x[:] = SIZE * np.sign(x) * x**2  # finer towards the first contact point
lines = {"axis": (0, 0.0), "top": (1, 0.0), "bottom": (1, -SIZE)}
facets = [
    mesh.locate_entities_boundary(block, 1, lambda x, i=i, at=at: np.isclose(x[i], at))
    for i, at in lines.values()
]
every, tags = np.concatenate(facets), np.repeat([1, 2, 3], [len(f) for f in facets])
order = np.argsort(every)
found = mesh.meshtags(block, 1, every[order], tags[order].astype(np.int32))
sides = dm.Tags(found, {"axis": 1, "top": 2, "bottom": 3})

V = fem.functionspace(block, ("Lagrange", 1, (2,)))
solid = dm.Solid(fem.Function(V), dm.Elastic(E=E, nu=NU), kinematics="axisymmetric")
bcs = []
for i, name in [(0, "axis"), (1, "bottom")]:
    dofs = fem.locate_dofs_topological(V.sub(i), 1, sides.find(name))
    bcs.append(fem.dirichletbc(fem.Constant(block, 0.0), dofs, V.sub(i)))

ball = dm.Obstacle(sides, slave="top", shape=dm.shapes.Sphere((0, R), R))
problem = dm.ContactProblem(solid, [ball], bcs=bcs)
for _step in dm.load_steps(problem, [0.02], ramp={ball.position: [(0, (0, R)), (1, (0, R - 1))]}):
    force = -ball.force[1]
nodes = ball.gather(solid.u)
peak = nodes["pressure"].max()
a = (3 * force * R * (1 - NU**2) / (4 * E)) ** (1 / 3)
exact = 3 * force / (2 * np.pi * a**2)
print(f"{force:.0f} N: contact radius {a:.3f} mm, peak {peak:.0f} MPa, Hertz {exact:.0f} MPa")
assert abs(peak / exact - 1.0) < 0.02
dm.plotting.pressure(problem, file="press_a_ball.png")

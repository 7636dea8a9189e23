# SPDX-License-Identifier: MIT

# # Wear a cylinder
#
# A cylinder of steel of radius $R$ slides on a hard flat plate, out of the plane, under a force $F$
# per length. By Archard's law it loses the depth $k p \,\mathrm{d}s$, hence the area $k F s$ of its
# section. Once the worn flat is much wider than Hertz' contact, its half-width and depth are
#
# $$a = \sqrt[3]{\tfrac{3}{2} R k F s}, \qquad h = \frac{a^2}{2 R}.$$

from mpi4py import MPI

import numpy as np

import dolfinx_mortar as dm
from dolfinx import fem, mesh
from dolfinx_mortar.interfaces.wear import Archard

R, F, k, E, NU = 10.0, 100.0, 1e-5, 200e3, 0.3  # mm, N/mm, 1/MPa, MPa, -

# Half of the section, and of the force, with the round side below.

body = mesh.create_rectangle(MPI.COMM_WORLD, [(0.0, 0.0), (4.0, 4.0)], (100, 40))
lines = {"axis": (0, 0.0), "round": (1, 0.0), "top": (1, 4.0)}
facets = [
    mesh.locate_entities_boundary(body, 1, lambda x, i=i, at=at: np.isclose(x[i], at))
    for i, at in lines.values()
]
every, tags = np.concatenate(facets), np.repeat([1, 2, 3], [len(f) for f in facets])
order = np.argsort(every)
found = mesh.meshtags(body, 1, every[order], tags[order].astype(np.int32))
sides, x = dm.Tags(found, {"axis": 1, "round": 2, "top": 3}), body.geometry.x
x[:, 1] += (R - np.sqrt(R**2 - x[:, 0] ** 2)) * (1.0 - x[:, 1] / 4.0)

V = fem.functionspace(body, ("Lagrange", 1, (2,)))
solid = dm.Solid(fem.Function(V), dm.Elastic(E=E, nu=NU))
bcs = []
for i, name in [(0, "axis"), (1, "top")]:
    dofs = fem.locate_dofs_topological(V.sub(i), 1, sides.find(name))
    bcs.append(fem.dirichletbc(fem.Constant(body, 0.0), dofs, V.sub(i)))

# The length of the path is a Constant. A step may be as long as it likes: wear is implicit.

path = fem.Constant(body, 0.0)
flat, wear = dm.shapes.Plane((0.0, 0.0), (0.0, 1.0)), Archard(k, slip=path)
plate = dm.Obstacle(sides, slave="round", shape=flat, load={"y": F / 2}, wear=wear)
problem = dm.ContactProblem(solid, [plate], bcs=bcs)
for step in dm.load_steps(problem, [0, 10, 100, 1000], ramp={path: [(0, 0), (1000, 1000)]}):
    nodes = plate.gather(solid.u)
    h, a = nodes["wear_depth"], (1.5 * R * k * F * step.time) ** (1 / 3)
    if step.time > 0.0:
        worn = h > 0.0
        width = np.sqrt(np.mean(nodes["X"][worn, 0] ** 2 + 2.0 * R * h[worn]))
        print(
            f"{step.time:4g} mm: half-width {width:.3f} mm, rigid {a:.3f}; depth {h.max():.4f} mm"
        )
        assert abs(width / a - 1.0) < 0.005 and abs(h.max() / (a**2 / (2 * R)) - 1.0) < 0.012
dm.plotting.pressure(problem, file="wear_a_cylinder.png")

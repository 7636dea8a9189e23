# SPDX-License-Identifier: MIT

# # Squeeze rubber
#
# A block of rubber is squeezed to 60 % of its height by a rigid plate without friction, in plane
# strain, at finite strain. With the stretches $a$ across and $b$ along the load, Neo-Hooke's law is
#
# $$P_x = \mu (a - 1/a) + \frac{\lambda}{a} \ln(a b) = 0, \qquad
# P_y = \mu (b - 1/b) + \frac{\lambda}{b} \ln(a b).$$

from mpi4py import MPI

import numpy as np
import scipy

import dolfinx_mortar as dm
from dolfinx import fem, mesh

E, NU, WIDTH, HEIGHT = 3.0, 0.45, 20.0, 10.0  # MPa, -, mm, mm

block = mesh.create_rectangle(MPI.COMM_WORLD, [(0.0, 0.0), (WIDTH, HEIGHT)], (16, 8))
V = fem.functionspace(block, ("Lagrange", 1, (2,)))
bcs = []
for i in range(2):  # planes of symmetry
    facets = mesh.locate_entities_boundary(block, 1, lambda x, i=i: np.isclose(x[i], 0.0))
    dofs = fem.locate_dofs_topological(V.sub(i), 1, facets)
    bcs.append(fem.dirichletbc(fem.Constant(block, 0.0), dofs, V.sub(i)))
top = np.sort(mesh.locate_entities_boundary(block, 1, lambda x: np.isclose(x[1], HEIGHT)))
tags = mesh.meshtags(block, 1, top, np.full(len(top), 1, dtype=np.int32))

solid = dm.Solid(fem.Function(V), dm.NeoHooke(E=E, nu=NU), strain="finite")
plate = dm.Obstacle(tags, slave=1, shape=dm.shapes.Plane((0, HEIGHT), (0, -1)))
problem = dm.ContactProblem(solid, [plate], bcs=bcs)
path = [(0, (0, HEIGHT)), (1, (0, 0))]
mu, lame = E / (2 * (1 + NU)), E * NU / ((1 + NU) * (1 - 2 * NU))
for step in dm.load_steps(problem, [0.1, 0.2, 0.3, 0.4], ramp={plate.position: path}):
    b = 1.0 - step.time
    a = scipy.optimize.brentq(lambda a: mu * (a - 1 / a) + lame * np.log(a * b) / a, 1.0, 3.0)  # noqa: B023
    exact = WIDTH * (mu * (b - 1 / b) + lame * np.log(a * b) / b)
    print(f"height {b:.0%}: {plate.force[1]:7.3f} N/mm, exact {exact:7.3f} N/mm")
    assert np.isclose(plate.force[1], exact)
dm.plotting.field(problem, "displacement_x", file="squeeze_rubber.png")

# SPDX-License-Identifier: MIT

# # Yield under a plate
#
# A cube of 10 mm is compressed 1 % by a rigid plate without friction, and unloaded. The metal
# yields at $\sigma_y$ and hardens with the modulus $H$ (kinematic, von Mises). The stress is
#
# $$\sigma = \sigma_y + E_t (\varepsilon - \sigma_y / E), \qquad E_t = \frac{E H}{E + H}.$$

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np

import dolfinx_mortar as dm
from dolfinx import fem, mesh

E, YIELD, H, EDGE = 210e3, 400.0, 10e3, 10.0  # MPa, MPa, MPa, mm

cube = mesh.create_box(
    MPI.COMM_WORLD, [(0, 0, 0), (EDGE, EDGE, EDGE)], (3, 3, 3), mesh.CellType.hexahedron
)
V = fem.functionspace(cube, ("Lagrange", 1, (3,)))
bcs = []
for i in range(3):  # the planes x = 0, y = 0 and z = 0 are planes of symmetry
    facets = mesh.locate_entities_boundary(cube, 2, lambda x, i=i: np.isclose(x[i], 0.0))
    dofs = fem.locate_dofs_topological(V.sub(i), 2, facets)
    bcs.append(fem.dirichletbc(fem.Constant(cube, 0.0), dofs, V.sub(i)))
top = np.sort(mesh.locate_entities_boundary(cube, 2, lambda x: np.isclose(x[2], EDGE)))
tags = mesh.meshtags(cube, 2, top, np.full(len(top), 1, dtype=np.int32))

# The law has the radius Y of the yield surface in deviatoric stresses, and a = 2 H / 3.

steel = dm.VonMises(E=E, nu=0.3, Y=np.sqrt(2 / 3) * YIELD, a=2 / 3 * H)
solid = dm.Solid(fem.Function(V), steel)
plate = dm.Obstacle(tags, slave=1, shape=dm.shapes.Plane((0, 0, EDGE), (0, 0, -1)))
problem = dm.ContactProblem(solid, [plate], bcs=bcs)
path = [(0, (0, 0, EDGE)), (1, (0, 0, 0.99 * EDGE)), (2, (0, 0, EDGE))]
stress = {}
for step in dm.load_steps(problem, [0.1, 0.4, 0.7, 1.0, 1.2, 1.4], ramp={plate.position: path}):
    stress[step.time] = -plate.force[2] / EDGE**2
    print(f"plate at {plate.position.value[2]:.2f} mm: {stress[step.time]:6.2f} MPa")
exact = YIELD + E * H / (E + H) * (0.01 - YIELD / E)
assert np.isclose(stress[1.0], exact) and stress[1.4] == 0.0
if cube.comm.rank == 0:
    plt.plot([0.0, *(1.0 - abs(t - 1.0) for t in stress)], [0.0, *stress.values()], "o-")
    plt.xlabel("compression [%]")
    plt.ylabel("stress [MPa]")
    plt.savefig("yield_in_contact.png", dpi=150)

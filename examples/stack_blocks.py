# SPDX-License-Identifier: MIT

# # Find the contacts of a stack
#
# Three blocks with meshes of their own lie on each other under their weight. `find_pairs` finds
# which sides face each other, tags them and proposes contacts. Each carries the weight above it.

from mpi4py import MPI

import gmsh
import numpy as np

import dolfinx_mortar as dm
import ufl
from dolfinx import fem

if MPI.COMM_WORLD.rank == 0:
    gmsh.initialize(["", "-v", "0"])
    for k, size in enumerate([1.0, 1.4, 0.8]):
        block = gmsh.model.occ.addRectangle(1.0 * k, 10.0 * k, 0.0, 20.0 - 2.0 * k, 10.0)
        gmsh.model.occ.synchronize()
        gmsh.model.addPhysicalGroup(2, [block], name=f"block {k}")
        gmsh.model.mesh.setSize(gmsh.model.getBoundary([(2, block)], recursive=True), size)
    gmsh.model.mesh.generate(2)
    gmsh.write("stack_blocks.msh")
    gmsh.finalize()
mesh, bodies, _ = dm.meshing.read_msh("stack_blocks.msh")
sides, contacts = dm.find_pairs(mesh, bodies, friction=0.3)

V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
solid = dm.Solid(fem.Function(V), dm.Elastic(E=100.0, nu=0.3), bodies)
bottom = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[1], 0.0))
weight = fem.Constant(mesh, 1e-3)  # N/mm3
loads = -weight * ufl.TestFunction(V)[1] * ufl.dx
problem = dm.ContactProblem(
    solid, contacts, bcs=[fem.dirichletbc(np.zeros(2), bottom, V)], loads=loads
)
dm.newton(problem)

above = {"block 0": 1e-3 * 10.0 * (18.0 + 16.0), "block 1": 1e-3 * 10.0 * 16.0}
for contact, carried in zip(contacts, above.values(), strict=True):
    print(f"{contact}: {abs(contact.force[1]):.3f} N/mm, weight above {carried:.3f} N/mm")
    assert np.isclose(abs(contact.force[1]), carried)
dm.plotting.field(problem, "stress_yy", file="stack_blocks.png")

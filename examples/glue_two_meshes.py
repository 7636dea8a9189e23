# SPDX-License-Identifier: MIT

# # Tie two meshes
#
# Two blocks with non-matching meshes are tied and pulled at the top by a traction $t$, in plane
# strain. With rollers on the left and at the bottom, the strain is uniform; this is a patch test:
#
# $$u_x = -\nu (1 + \nu) \frac{t}{E} x, \qquad u_y = (1 - \nu^2) \frac{t}{E} y.$$

from mpi4py import MPI

import gmsh
import numpy as np

import dolfinx_mortar as dm
import ufl
from dolfinx import fem

# Gmsh meshes both blocks on rank 0. Without `fragment` each block has its own nodes on the common
# line.

if MPI.COMM_WORLD.rank == 0:
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    for name, y, size in [("lower", 0.0, 1.0), ("upper", 5.0, 0.7)]:
        block = gmsh.model.occ.addRectangle(0.0, y, 0.0, 10.0, 5.0)
        gmsh.model.occ.synchronize()
        gmsh.model.addPhysicalGroup(2, [block], name=name)
        curves = gmsh.model.getBoundary([(2, block)], oriented=False)
        for (_, tag), side in zip(curves, ("bottom", "right", "top", "left"), strict=True):
            gmsh.model.addPhysicalGroup(1, [tag], name=f"{name} {side}")
        gmsh.model.mesh.setSize(gmsh.model.getBoundary([(2, block)], recursive=True), size)
    gmsh.model.mesh.generate(2)
    gmsh.write("glue_two_meshes.msh")
    gmsh.finalize()
mesh, bodies, sides = dm.meshing.read_msh("glue_two_meshes.msh")

E, nu, traction = 1000.0, 0.3, 10.0  # MPa, -, MPa
V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
u = fem.Function(V, name="displacement")
solid = dm.Solid(u, dm.Elastic(E=E, nu=nu), bodies)
bcs = []
for i, name in [(0, "lower left"), (0, "upper left"), (1, "lower bottom")]:
    dofs = fem.locate_dofs_topological(V.sub(i), 1, sides.find(name))
    bcs.append(fem.dirichletbc(fem.Constant(mesh, 0.0), dofs, V.sub(i)))
ds = ufl.Measure("ds", mesh, subdomain_data=sides)
loads = traction * ufl.TestFunction(V)[1] * ds(sides.tag("upper top"))

glue = dm.Tie(sides, slave="upper bottom", master="lower top")
problem = dm.ContactProblem(solid, [glue], bcs=bcs, loads=loads)
report = dm.newton(problem, rtol=1e-11)

x, y = V.tabulate_dof_coordinates()[:, :2].T
exact = traction / E * (1.0 + nu) * np.column_stack([-nu * x, (1.0 - nu) * y])
error = np.abs(u.x.array.reshape(-1, 2) - exact).max() / (traction / E * 10.0)
print(f"{report.newton_iterations} iteration, largest error of the displacement {error:.0e}")
assert error < 1e-10 and np.allclose(glue.force, [0.0, -10.0 * traction])
dm.plotting.mesh(mesh, bodies, sides, file="glue_two_meshes.png")

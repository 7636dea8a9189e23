# SPDX-License-Identifier: MIT

# # Fit two rings
#
# The inner ring, from $a$ to $b$, is larger than the bore of the outer one, from $b$ to $c$, by
# $\delta$. The section is meshed (`x[0]` is the radius) with the overlap, which contact removes. In
# plane strain, with $E' = E / (1 - \nu^2)$ for equal materials, the pressure is that of Lamé,
#
# $$p \left(\frac{c^2 + b^2}{c^2 - b^2} + \frac{b^2 + a^2}{b^2 - a^2}\right) = E' \delta / b.$$

from mpi4py import MPI

import gmsh
import numpy as np

import dolfinx_mortar as dm
from dolfinx import fem

A, B, C, DELTA, E, NU = 20.0, 30.0, 50.0, 0.02, 210e3, 0.3  # mm, MPa, -

if MPI.COMM_WORLD.rank == 0:
    gmsh.initialize(["", "-v", "0"])
    for name, r, width, size in [("inner", A, B + DELTA - A, 1.0), ("outer", B, C - B, 1.3)]:
        ring = gmsh.model.occ.addRectangle(r, 0.0, 0.0, width, 10.0)
        gmsh.model.occ.synchronize()
        gmsh.model.addPhysicalGroup(2, [ring], name=name)
        curves = gmsh.model.getBoundary([(2, ring)], oriented=False)
        for (_, tag), side in zip(curves, ("bottom", "out", "top", "in"), strict=True):
            gmsh.model.addPhysicalGroup(1, [tag], name=f"{name} {side}")
        gmsh.model.mesh.setSize(gmsh.model.getBoundary([(2, ring)], recursive=True), size)
    gmsh.model.mesh.generate(2)
    gmsh.write("fit_two_rings.msh")
    gmsh.finalize()
mesh, bodies, sides = dm.meshing.read_msh("fit_two_rings.msh")

V = fem.functionspace(mesh, ("Lagrange", 2, (2,)))
solid = dm.Solid(fem.Function(V), dm.Elastic(E=E, nu=NU), kinematics="axisymmetric")
bcs = []
for name in ("inner bottom", "inner top", "outer bottom", "outer top"):  # plane strain
    dofs = fem.locate_dofs_topological(V.sub(1), 1, sides.find(name))
    bcs.append(fem.dirichletbc(fem.Constant(mesh, 0.0), dofs, V.sub(1)))
fit = dm.Contact(sides, slave="inner out", master="outer in")
problem = dm.ContactProblem(solid, [fit], bcs=bcs)
dm.newton(problem)

sizes = (C**2 + B**2) / (C**2 - B**2) + (B**2 + A**2) / (B**2 - A**2)
exact = E / (1 - NU**2) * DELTA / B / sizes
pressure = fit.gather(solid.u)["pressure"]
print(f"pressure {pressure.min():.2f} to {pressure.max():.2f} MPa, Lamé {exact:.2f} MPa")
assert np.abs(pressure / exact - 1.0).max() < 0.002  # the overlap is not small beside b
dm.plotting.field(problem, "von_mises", file="fit_two_rings.png")

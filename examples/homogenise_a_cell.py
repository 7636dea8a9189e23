# SPDX-License-Identifier: MIT

# # Homogenise a periodic cell
#
# A square cell has a stiff inclusion, loose in its hole. Opposite sides, with meshes that do not
# match, are tied with a jump $u^+ - u^- = H (x^+ - x^-)$ of the mean strain $H$. The forces of
# the ties are the mean stress. Without a gap it is proportional to $H$, and the strain energy per
# volume is $\sigma : H / 2$.

from mpi4py import MPI

import gmsh
import numpy as np

import dolfinx_mortar as dm
from dolfinx import fem

NAMES = {(2, 1): "right", (0, 1): "left", (1, 2): "top", (1, 0): "bottom", (1, 1): "hole"}
SIZES = (0.02, 0.03, 0.04, 0.03, 0.01, 0.012)

if MPI.COMM_WORLD.rank == 0:
    gmsh.initialize(["", "-v", "0"])
    occ, model = gmsh.model.occ, gmsh.model
    square = [(2, occ.addRectangle(0.0, 0.0, 0.0, 1.0, 1.0))]
    (matrix,), _ = occ.cut(square, [(2, occ.addDisk(0.5, 0.5, 0.0, 0.35, 0.25))])
    disc = occ.addDisk(0.5, 0.5, 0.0, 0.35, 0.25)
    occ.synchronize()
    model.addPhysicalGroup(2, [matrix[1]], name="matrix")
    model.addPhysicalGroup(2, [disc], name="disc")
    for _, curve in model.getBoundary([matrix], oriented=False):
        middle = tuple(2.0 * np.round(occ.getCenterOfMass(1, curve)[:2], 3))
        model.addPhysicalGroup(1, [curve], name=NAMES[middle])
    model.addPhysicalGroup(1, [model.getBoundary([(2, disc)])[0][1]], name="rim")
    for size, point in zip(SIZES, model.getEntities(0), strict=True):
        model.mesh.setSize([point], size)
    model.mesh.generate(2)
    gmsh.write("homogenise_a_cell.msh")
    gmsh.finalize()
mesh, bodies, sides = dm.meshing.read_msh("homogenise_a_cell.msh")

V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
laws = {"matrix": dm.Elastic(E=3.0, nu=0.35), "disc": dm.Elastic(E=70.0, nu=0.2)}  # GPa
solid = dm.Solid(fem.Function(V), laws, bodies, energies=True)
pin = fem.dirichletbc(np.zeros(2), fem.locate_dofs_geometrical(V, lambda x: sum(x) < 1e-9), V)
options = {"surface": "facets", "within": np.inf}  # across the cell
pairs = [("right", "left"), ("top", "bottom")]
ties = [dm.Tie(sides, slave=s, master=m, **options) for s, m in pairs]
interfaces = [*ties, dm.Contact(sides, slave="rim", master="hole")]
problem = dm.ContactProblem(solid, interfaces, bcs=[pin], geometry="reference")

for said, *strain in [("along x", -5e-3, 0.0), ("along y", 0.0, -5e-3), ("both", -5e-3, -5e-3)]:
    H = np.diag(strain)
    ties[0].jump, ties[1].jump = H.T
    dm.newton(problem, rtol=1e-9)
    stress = np.column_stack([tie.force for tie in ties])  # the sides have length 1
    print(f"pressed {said}: {1e3 * stress[0, 0]:.2f} MPa, {1e3 * stress[1, 1]:.2f} MPa")
    energy = sum(body.stored for body in solid.energies().values())
    assert abs((stress * H).sum() / 2.0 / energy - 1.0) < 2e-4
dm.plotting.field(problem, "von_mises", file="homogenise_a_cell.png")
dm.plotting.field(problem, "von_mises", file="homogenise_a_cell.png")

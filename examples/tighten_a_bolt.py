# SPDX-License-Identifier: MIT

# # Tighten a bolt
#
# A bolt is preloaded in a housing, then its head is pulled. Axisymmetric: `x[0]` is the radius,
# `x[1]` the axis. A tie with a pretension connects shank and housing. While the head presses on the
# housing, with a force $F_c$, the bolt force is $F_b = F_c + W$ and changes little with the pull
# $W$. Once the joint is open, the bolt force is the pull. Units: mm, MPa, N.

from mpi4py import MPI

import gmsh
import numpy as np

import dolfinx_mortar as dm
import ufl
from dolfinx import fem


def draw(body, corners, sides):  # a polygon; edge k ends at corner k
    points = [gmsh.model.geo.addPoint(r, z, 0.0) for r, z in corners]
    lines = [gmsh.model.geo.addLine(points[k - 1], points[k]) for k in range(len(points))]
    face = gmsh.model.geo.addPlaneSurface([gmsh.model.geo.addCurveLoop(lines)])
    gmsh.model.geo.synchronize()
    gmsh.model.addPhysicalGroup(2, [face], name=body)
    for side, k in sides.items():
        gmsh.model.addPhysicalGroup(1, [lines[k]], name=side)


if MPI.COMM_WORLD.rank == 0:
    gmsh.initialize(["", "-v", "0", "-clmax", "1"])
    cup = [(0, -8), (10, -8), (10, 20), (5, 20), (5, 0), (0, 0)]
    draw("housing", cup, {"foot": 1, "seat": 3, "ground": 5, "axis of the housing": 0})
    tee = [(0, 0), (4, 0), (4, 20), (9, 20), (9, 26), (0, 26)]
    draw("bolt", tee, {"cut": 1, "collar": 3, "top": 5, "axis of the bolt": 0})
    gmsh.model.mesh.generate(2)
    gmsh.write("tighten_a_bolt.msh")
    gmsh.finalize()
mesh, bodies, sides = dm.meshing.read_msh("tighten_a_bolt.msh")

V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
solid = dm.Solid(fem.Function(V), dm.Elastic(E=210e3, nu=0.3), bodies, kinematics="axisymmetric")
bcs = []
for i, name in [(1, "foot"), (0, "axis of the housing"), (0, "axis of the bolt")]:
    dofs = fem.locate_dofs_topological(V.sub(i), 1, sides.find(name))
    bcs.append(fem.dirichletbc(fem.Constant(mesh, 0.0), dofs, V.sub(i)))
pull = fem.Constant(mesh, 0.0)  # N, spread over the top
ds = ufl.Measure("ds", mesh, subdomain_data=sides)
loads = pull / (np.pi * 9.0**2) * ufl.TestFunction(V)[1] * ds(sides.tag("top"))

cut = dm.Tie(sides, slave="cut", master="ground", pretension=20e3)  # N, tension
collar = dm.Contact(sides, slave="collar", master="seat")
problem = dm.ContactProblem(solid, [cut, collar], bcs=bcs, loads=loads)
for step in dm.load_steps(problem, [0.0, 10e3, 40e3], ramp={pull: [(0.0, 0.0), (40e3, 40e3)]}):
    cut.pretension = None  # tight from the first step on
    bolt, clamp = -cut.force[1], collar.force[1]
    print(f"pull {step.time:5.0f} N: bolt {bolt:5.0f} N, clamp {clamp:5.0f} N")
    assert np.isclose(bolt, clamp + step.time, rtol=1e-5)
assert clamp == 0.0
dm.plotting.field(problem, "von_mises", file="tighten_a_bolt.png")

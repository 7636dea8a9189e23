# SPDX-License-Identifier: MIT

# # Read a deck
#
# Two cubes of steel, one on the other, as a deck of Abaqus or CalculiX: meshes, sets, surfaces,
# laws and contacts are read; supports and loads are set here. Pressed by 0.002 mm of 2 mm, with
# $\nu = 0$, the cubes have the pressure $E \cdot 0.001$.

from mpi4py import MPI

import numpy as np

import dolfinx_mortar as dm
from dolfinx import fem

DECK = """*PART, NAME=CUBE
*NODE
1, 0,0,0
2, 1,0,0
3, 1,1,0
4, 0,1,0
5, 0,0,1
6, 1,0,1
7, 1,1,1
8, 0,1,1
*ELEMENT, TYPE=C3D8R, ELSET=BODY
1, 1,2,3,4,5,6,7,8
*NSET, NSET=BASE
1,2,3,4
*NSET, NSET=TOP
5,6,7,8
*SURFACE, NAME=S_BASE
BODY, S1
*SURFACE, NAME=S_TOP
BODY, S2
*SOLID SECTION, ELSET=BODY, MATERIAL=STEEL
*END PART
*INSTANCE, NAME=LOW, PART=CUBE
*INSTANCE, NAME=UP, PART=CUBE
0., 0., 1.
*MATERIAL, NAME=STEEL
*ELASTIC
210e3, 0.
*CONTACT PAIR
UP.S_BASE, LOW.S_TOP
"""
if MPI.COMM_WORLD.rank == 0:
    with open("cubes.inp", "w") as file:
        file.write(DECK)
deck = dm.meshing.read_inp("cubes.inp")
V = fem.functionspace(deck.mesh, ("Lagrange", 1, (3,)))
solid = dm.Solid(fem.Function(V), deck.materials, deck.cell_tags)
base, top = (deck.dofs(V, name) for name in ("LOW.BASE", "UP.TOP"))
bcs = [fem.dirichletbc(np.array([0.0, 0.0, z]), at, V) for z, at in ((0.0, base), (-2e-3, top))]
problem = dm.ContactProblem(solid, deck.interfaces, bcs=bcs)
dm.newton(problem)
print(f"force {deck.interfaces[0].force[2]:.3f} N, exact 210.000 N")
assert np.isclose(deck.interfaces[0].force[2], 210.0)
dm.plotting.field(problem, "displacement_z", file="read_a_deck.png")

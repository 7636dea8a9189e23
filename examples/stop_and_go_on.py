# SPDX-License-Identifier: MIT

# # Stop and go on
#
# A disc is pressed into a block that yields. The run stops after two of four load steps and writes
# a checkpoint; a new problem, as another program would make it, continues from there, also on
# another number of ranks. Its forces are those of a run without a stop.

from mpi4py import MPI

import numpy as np

import dolfinx_mortar as dm
from dolfinx import fem

mesh, bodies, sides = dm.meshing.hertz(MPI.COMM_WORLD, kind="graded", h=0.2)
V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
steel = dm.VonMises(E=206_900.0, nu=0.29, Y=450.0 * np.sqrt(2 / 3), a=10_000.0)


def pressed():
    """Return the problem, its contact and its ramp."""
    push = fem.Constant(mesh, (0.0, 0.0))
    bottom, flat = (fem.locate_dofs_topological(V, 1, sides.find(n)) for n in ("bottom", "flat"))
    bcs = [fem.dirichletbc(np.zeros(2), bottom, V), fem.dirichletbc(push, flat, V)]
    contact = dm.Contact(sides, slave="top", master="arc")
    solid = dm.Solid(fem.Function(V), steel, bodies)
    problem = dm.ContactProblem(solid, [contact], bcs=bcs)
    return problem, contact, {push: [(0.0, (0.0, 0.0)), (1.0, (0.0, -1.0))]}


def walk(problem, contact, ramp, levels):
    """Return the force of each level."""
    return [-contact.force[1] for _ in dm.load_steps(problem, levels, ramp=ramp, progress=False)]


levels = [0.02, 0.04, 0.06, 0.08]  # mm
whole = walk(*pressed(), levels)

first, contact, ramp = pressed()
walk(first, contact, ramp, levels[:2])
first.save("stop_and_go_on.h5")

second, contact, ramp = pressed()
second.restore("stop_and_go_on.h5")
forces = walk(second, contact, ramp, levels[2:])
print("without a stop", np.round(whole[2:], 3), "after the checkpoint", np.round(forces, 3), "N/mm")
assert np.allclose(forces, whole[2:], rtol=1e-9)
dm.plotting.field(second, "plastic_strain_norm", file="stop_and_go_on.png")

# SPDX-License-Identifier: MIT

# # Heat a contact by a current
#
# A disc of copper is pressed on a block of copper. A voltage $V$ between its flat face and the
# bottom of the block drives a current, whose power heats both and the contact, and the pressure $p$
# decides how well charges and heat cross it: $h_\varphi = 2000\, p^{0.95}$ S/mm² and
# $h = h_\varphi k / \sigma$. Then, for any shape and pressure, the temperature above that of the
# ends depends on the potential alone (Kohlrausch, 1900):
#
# $$T - T_0 = \frac{\sigma}{2 k}\, \varphi\, (V - \varphi).$$

from mpi4py import MPI

import numpy as np

import dolfinx_mortar as dm
from dolfinx import fem

K, SIGMA, ALPHA, T0, VOLTS = 0.38, 5.8e4, 17e-6, 20.0, 0.08  # W/(mm K), S/mm, 1/K, °C, V

mesh, bodies, sides = dm.meshing.hertz(MPI.COMM_WORLD, kind="graded", h=0.05)
V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
W = fem.functionspace(mesh, ("Lagrange", 1))
phi, T = fem.Function(W, name="potential"), fem.Function(W, name="temperature")
T.x.array[:] = T0
solid = dm.Solid(fem.Function(V), dm.Elastic(E=120e3, nu=0.34), eigenstrain=ALPHA * (T - T0))
push, voltage = fem.Constant(mesh, (0.0, 0.0)), fem.Constant(mesh, 0.0)
ends = [(fem.locate_dofs_topological, 1, sides.find(name)) for name in ("bottom", "flat")]


def held(space, *values):
    """Return Dirichlet conditions of the bottom and of the flat face."""
    return [
        fem.dirichletbc(value, locate(space, d, facets), space)
        for value, (locate, d, facets) in zip(values, ends, strict=True)
    ]


contact = dm.Contact(sides, slave="top", master="arc")
problem = dm.ContactProblem(solid, [contact], bcs=held(V, np.zeros(2), push))

# The potential is a `Heat` with other numbers; as `current=` it is solved first, and heats.

charges = dm.Conductance(contact, lambda p, g: 2e3 * p**0.95)
flow = dm.Conductance(contact, lambda p, g: 2e3 * p**0.95 * K / SIGMA)
current = dm.Heat(phi, SIGMA, interfaces=[charges], bcs=held(W, 0.0, voltage))
heat = dm.Heat(T, K, interfaces=[flow], bcs=held(W, T0, T0), current=current)
ramp = {push: [(0, (0.0, 0.0)), (1, (0.0, -0.02))], voltage: [(0, 0.0), (1, VOLTS)]}
for _step in dm.load_steps(problem, [0.5, 1.0], ramp=ramp, heat=heat):
    exact = SIGMA / (2 * K) * phi.x.array * (voltage.value - phi.x.array)
    error = mesh.comm.allreduce(np.abs(T.x.array - T0 - exact).max(), MPI.MAX)
    hottest = mesh.comm.allreduce(T.x.array.max(), MPI.MAX)
    print(f"{voltage.value:.2f} V: {hottest:.1f} °C, error {error:.2f} K")
    assert error < 0.002 * (hottest - T0)
dm.plotting.field(problem, "stress_yy", file="heat_by_current.png")

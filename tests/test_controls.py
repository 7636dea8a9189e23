# SPDX-License-Identifier: MIT
"""Two squares in contact: constant and linear stress states, exact to round-off.

E = 1000, nu = 0 and the expected numbers follow the control tests of EdelweissFE's contact fork.
"""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from dolfinx_mortar.algebra.parallel import maximum
from tests.cases.meshes import BOTTOM, LEFT, TOP, two_blocks

E = 1000.0
EXACT = 1e-10
SPLITS = {"matching": ((2, 2), (2, 2)), "non-matching": ((2, 2), (3, 3))}
COMM = MPI.COMM_WORLD


class Squares:
    """Two unit squares; the bottom rests on rollers, the left sides slide vertically."""

    def __init__(
        self,
        slave="lower",
        mesh="non-matching",
        *,
        moduli=(E, E),
        length=1.0,
        stress=1.0,
        angle=0.0,
        cell="triangle",
        geometry="updated",
    ):
        """Keep units and create the space; ``load`` and ``solve`` follow."""
        self.length, self.stress, self.geometry = length, stress, geometry
        self.mesh, cells, self.facets = two_blocks(
            COMM, *SPLITS[mesh], cell=cell, angle=angle, transform=lambda x: length * x
        )
        self.V = fem.functionspace(self.mesh, ("Lagrange", 1, (2,)))
        self.u = fem.Function(self.V)
        laws = {tag: dm.Elastic(stress * modulus, 0.0) for tag, modulus in enumerate(moduli, 1)}
        self.solid = dm.Solid(self.u, laws, cells)
        slave, master = (3, 4) if slave == "lower" else (4, 3)
        self.contact = dm.Contact(self.facets, slave=slave, master=master)

    def hold(self, tag, component, value=0.0):
        """Return a condition on a component of a side, in multiples of the unit length."""
        space = self.V.sub(component)
        dofs = fem.locate_dofs_topological(space, 1, self.facets.find(tag))
        constant = fem.Constant(self.mesh, float(value * self.length))
        return fem.dirichletbc(constant, dofs, space)

    def solve(self, bcs, loads=None, rtol=1e-10):
        """Solve one step."""
        self.problem = dm.ContactProblem(
            self.solid, [self.contact], bcs=bcs, loads=loads, geometry=self.geometry
        )
        report = dm.newton(self.problem, rtol=rtol)
        self.problem.commit()
        return report

    def traction(self, pressure):
        """Return the load of a pressure on the top."""
        ds = ufl.Measure("ds", self.mesh, subdomain_data=self.facets)
        p = fem.Constant(self.mesh, float(pressure * self.stress))
        return -p * ufl.TestFunction(self.V)[1] * ds(TOP)

    def check(self, exact, pressure):
        """Compare displacement, in multiples of the length, and contact pressure."""
        x = self.V.tabulate_dof_coordinates()[:, :2] / self.length
        error = np.abs(self.u.x.array.reshape(-1, 2) / self.length - exact(x)).max(initial=0.0)
        size = np.abs(exact(x)).max(initial=0.0)
        surface = self.contact.gather(self.u)
        error, size = maximum(COMM, error, size)
        assert error < EXACT * size
        assert np.abs(surface["pressure"] / self.stress - pressure).max() < EXACT * max(pressure, 1)


def uniform(strain):
    """Return the displacement of a vertical strain per block, zero at the bottom y = -1."""
    lower, upper = (strain, strain) if np.isscalar(strain) else strain

    def u(x):
        # which side of the interface matters only through the slope, the field is continuous
        y = x[:, 1]
        return np.column_stack([0 * y, lower * (np.minimum(y, 0) + 1) + upper * np.maximum(y, 0)])

    return u


UNITS = [(1.0, 1.0), (1e3, 1.0), (1.0, 1e3), (1e6, 1e-6), (1e-6, 1e6)]


@pytest.mark.parametrize("length, stress", UNITS)
@pytest.mark.parametrize("mesh", SPLITS)
@pytest.mark.parametrize("slave", ["lower", "upper"])
def test_pressure(slave, mesh, length, stress):
    """A pressure of 10 on top gives u = -0.01 y and the pressure 10 everywhere."""
    s = Squares(slave, mesh, length=length, stress=stress)
    s.solve([s.hold(BOTTOM, 1), s.hold(LEFT, 0)], s.traction(10.0))
    s.check(uniform(-0.01), 10.0)
    assert np.isclose(abs(s.contact.force[1]), 10.0 * stress * length, rtol=1e-9)
    sign = -1 if slave == "lower" else 1
    assert np.sign(s.contact.force[1]) == sign
    # moment about the origin: the resultant acts in the middle
    assert np.isclose(s.contact.moment[2], 0.5 * length * s.contact.force[1], rtol=1e-9)


@pytest.mark.parametrize("mesh", SPLITS)
@pytest.mark.parametrize("slave", ["lower", "upper"])
@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
def test_displacement(slave, mesh, cell):
    """A displacement of -0.02 on top of the height 2 gives the stress -10."""
    s = Squares(slave, mesh, cell=cell)
    s.solve([s.hold(BOTTOM, 1), s.hold(LEFT, 0), s.hold(TOP, 1, -0.02)])
    s.check(uniform(-0.01), 10.0)
    s.solid.evaluate()
    assert np.allclose(s.solid.fields.values("stress_yy"), -10.0, rtol=EXACT, atol=0)


@pytest.mark.parametrize("slave", ["lower", "upper"])
def test_self_weight(slave):
    """The pressure between the squares is the weight of the upper one."""
    s = Squares(slave)
    v = ufl.TestFunction(s.V)
    s.solve([s.hold(BOTTOM, 1), s.hold(LEFT, 0)], -fem.Constant(s.mesh, 10.0) * v[1] * ufl.dx)
    assert np.isclose(abs(s.contact.force[1]), 10.0, rtol=1e-9)
    # without lateral contraction every column bears its own weight, up to the mesh
    pressure = s.contact.gather(s.u)["pressure"]
    assert np.abs(pressure - 10.0).max() < 1.0
    bottom = s.solid.fields.values("stress_yy") * s.solid.fields.weights
    assert np.isclose(COMM.allreduce(bottom.sum()), -20.0, rtol=1e-9)  # int (y - 2) over height 2


@pytest.mark.parametrize("slave", ["lower", "upper"])
def test_separation(slave):
    """Pulled apart, the squares are free of stress and no node is active."""
    s = Squares(slave)
    report = s.solve([s.hold(BOTTOM, 1), s.hold(LEFT, 0), s.hold(TOP, 1, 0.02)])
    assert report.certificate.active_nodes == 0
    assert np.allclose(s.contact.force, 0.0, atol=1e-9)
    assert s.solid.fields.max("von_mises") < 1e-9
    surface = s.contact.gather(s.u)
    assert np.allclose(surface["gap"], 0.02, rtol=1e-9)
    assert np.all(surface["pressure"] == 0.0) and np.all(surface["active"] == 0)


@pytest.mark.parametrize("slave", ["lower", "upper"])
def test_tangential_displacement(slave):
    """Frictionless: the upper square slides without shear and keeps the pressure."""
    s = Squares(slave, geometry="reference")  # the updated one sees that the ends slide off
    s.solve([*(s.hold(BOTTOM, i) for i in (0, 1)), s.hold(TOP, 0, 0.05), s.hold(TOP, 1, -0.02)])
    s.solid.evaluate()
    assert np.abs(s.solid.fields.values("stress_xy")).max(initial=0.0) < 10 * EXACT
    assert abs(s.contact.force[0]) < EXACT * abs(s.contact.force[1])
    assert np.isclose(abs(s.contact.force[1]), 10.0, rtol=1e-9)


@pytest.mark.parametrize("slave", ["lower", "upper"])
def test_two_moduli(slave):
    """E = 1000 on E = 1e5: the squares act as springs in a row."""
    s = Squares(slave, moduli=(1e3, 1e5))
    s.solve([s.hold(BOTTOM, 1), s.hold(LEFT, 0), s.hold(TOP, 1, -0.02)])
    expected = 0.02 / (1 / 1e3 + 1 / 1e5)
    assert np.isclose(expected, 19.80198, rtol=1e-6)
    s.check(uniform((-expected / 1e3, -expected / 1e5)), expected)


@pytest.mark.parametrize("depth", [0.02, -0.02])
@pytest.mark.parametrize("slave", ["lower", "upper"])
def test_initial_gap_and_overlap(slave, depth):
    """An initial overlap is pushed out, an initial gap stays open."""
    mesh, _, facets = two_blocks(COMM, (2, 2), (3, 3), gap=-depth)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    u = fem.Function(V)
    tags = (3, 4) if slave == "lower" else (4, 3)
    contact = dm.Contact(facets, slave=tags[0], master=tags[1])
    zero = fem.Constant(mesh, 0.0)
    bcs = [
        fem.dirichletbc(zero, fem.locate_dofs_topological(V.sub(i), 1, facets.find(tag)), V.sub(i))
        for i, tag in ((0, LEFT), (1, BOTTOM), (1, TOP))
    ]
    problem = dm.ContactProblem(dm.Solid(u, dm.Elastic(E, 0.0)), [contact], bcs=bcs)
    dm.newton(problem, rtol=1e-10)
    expected = max(depth, 0.0) / 2 * E
    assert np.allclose(contact.gather(u)["pressure"], expected, rtol=1e-9)

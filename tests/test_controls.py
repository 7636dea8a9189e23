# SPDX-License-Identifier: MIT
"""Two squares in contact: constant and linear stress states, exact to round-off.

E = 1000, nu = 0 and the expected numbers follow the control tests of EdelweissFE's contact fork.
"""

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from dolfinx_mortar.algebra.parallel import maximum
from tests.cases.meshes import BOTTOM, LEFT, TOP
from tests.cases.pressed_blocks import COMM, PressedBlocks

E = 1000.0
EXACT = 1e-10
SIDES = {"lower": (3, 4), "upper": (4, 3)}
either_side = pytest.mark.parametrize("slave", SIDES)


class Squares(PressedBlocks):
    """Two unit squares; the bottom rests on rollers, the left sides slide vertically."""

    def __init__(self, slave, *, length=1.0, stress=1.0, **options):
        super().__init__(transform=lambda x: length * x, **options)
        self.length, self.stress = length, stress
        self.side = self.contact(*SIDES[slave])

    def solve(self, *bcs, held=((BOTTOM, 1), (LEFT, 0)), moduli=(E, E), **options):
        """Solve a step, and commit it."""
        laws = {tag: dm.Elastic(self.stress * one, 0.0) for tag, one in enumerate(moduli, 1)}
        bcs = [*(self.roller(tag, i) for tag, i in held), *bcs]
        problem = self.problem([self.side], bcs, laws, **options)
        report = dm.newton(problem, rtol=1e-10)
        problem.commit()
        self.fields = problem.solid.fields
        return report

    def check(self, strains, pressure):
        """Compare displacements, of the vertical strain of each block, and contact pressures."""
        y = self.V.tabulate_dof_coordinates()[:, 1] / self.length
        lower, upper = strains
        exact = np.stack([0 * y, lower * (np.minimum(y, 0) + 1) + upper * np.maximum(y, 0)], axis=1)
        error = np.abs(self.u.x.array.reshape(-1, 2) / self.length - exact).max(initial=0.0)
        error, size = maximum(COMM, error, np.abs(exact).max(initial=0.0))
        assert error < EXACT * size
        found = self.side.gather(self.u)["pressure"] / self.stress
        assert np.abs(found - pressure).max() < EXACT * max(pressure, 1)


@pytest.mark.parametrize(
    ("slave", "n", "length", "stress"),
    [
        *(("lower", 2, *units) for units in ((1.0, 1.0), (1e3, 1.0), (1e6, 1e-6))),
        *(("upper", 3, *units) for units in ((1.0, 1.0), (1.0, 1e3), (1e-6, 1e6))),
    ],
)
def test_pressure(slave, n, length, stress):
    """A pressure of 10 on top gives u = -0.01 y and the pressure 10 everywhere."""
    s = Squares(slave, n_upper=(n, n), length=length, stress=stress)
    s.solve(loads=s.pull((0.0, -10.0 * stress)))
    s.check((-0.01, -0.01), 10.0)
    sign = -1 if slave == "lower" else 1
    assert np.isclose(s.side.force[1], 10.0 * sign * stress * length, rtol=1e-9)
    # moment about the origin: the resultant acts in the middle
    assert np.isclose(s.side.moment[2], 0.5 * length * s.side.force[1], rtol=1e-9)


@either_side
@pytest.mark.parametrize(("cell", "n"), [("triangle", 3), ("quadrilateral", 2)])
def test_displacement(slave, cell, n):
    """A displacement of -0.02 on top of the height 2 gives the stress -10."""
    s = Squares(slave, n_upper=(n, n), cell=cell)
    s.solve(s.roller(TOP, 1, -0.02))
    s.check((-0.01, -0.01), 10.0)
    assert np.allclose(s.fields.values("stress_yy"), -10.0, rtol=EXACT, atol=0)


@either_side
def test_self_weight(slave):
    """The pressure between the squares is the weight of the upper one."""
    s = Squares(slave)
    s.solve(loads=-fem.Constant(s.mesh, 10.0) * ufl.TestFunction(s.V)[1] * ufl.dx)
    assert np.isclose(abs(s.side.force[1]), 10.0, rtol=1e-9)
    # without lateral contraction every column bears its own weight, up to the mesh
    assert np.abs(s.side.gather(s.u)["pressure"] - 10.0).max() < 1.0
    bottom = s.fields.values("stress_yy") * s.fields.weights
    assert np.isclose(COMM.allreduce(bottom.sum()), -20.0, rtol=1e-9)  # int (y - 2) over height 2


@either_side
def test_separation(slave):
    """Pulled apart, the squares are free of stress and no node is active."""
    s = Squares(slave)
    report = s.solve(s.roller(TOP, 1, 0.02))
    assert report.certificate.active_nodes == 0
    assert np.allclose(s.side.force, 0.0, atol=1e-9) and s.fields.max("von_mises") < 1e-9
    surface = s.side.gather(s.u)
    assert np.allclose(surface["gap"], 0.02, rtol=1e-9)
    assert np.all(surface["pressure"] == 0.0) and np.all(surface["active"] == 0)


@either_side
def test_tangential_displacement(slave):
    """Frictionless: the upper square slides without shear and keeps the pressure."""
    s = Squares(slave)  # the updated geometry sees that the ends slide off
    pushed = s.roller(TOP, 0, 0.05), s.roller(TOP, 1, -0.02)
    s.solve(*pushed, held=((BOTTOM, 0), (BOTTOM, 1)), geometry="reference")
    assert np.abs(s.fields.values("stress_xy")).max(initial=0.0) < 10 * EXACT
    assert abs(s.side.force[0]) < EXACT * abs(s.side.force[1])
    assert np.isclose(abs(s.side.force[1]), 10.0, rtol=1e-9)


@either_side
def test_two_moduli(slave):
    """E = 1000 on E = 1e5: the squares act as springs in a row."""
    s = Squares(slave)
    s.solve(s.roller(TOP, 1, -0.02), moduli=(1e3, 1e5))
    expected = 0.02 / (1 / 1e3 + 1 / 1e5)
    assert np.isclose(expected, 19.80198, rtol=1e-6)
    s.check((-expected / 1e3, -expected / 1e5), expected)


@either_side
@pytest.mark.parametrize("depth", [0.02, -0.02])
def test_initial_gap_and_overlap(slave, depth):
    """An initial overlap is pushed out, an initial gap stays open."""
    s = Squares(slave, gap=-depth)
    s.solve(s.roller(TOP, 1))
    expected = max(depth, 0.0) / 2 * E
    assert np.allclose(s.side.gather(s.u)["pressure"], expected, rtol=1e-9)

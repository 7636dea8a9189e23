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


@pytest.mark.parametrize(
    ("slave", "options", "top", "moduli", "pressure"),
    [
        ("lower", {}, None, (E, E), 10.0),
        ("lower", {"length": 1e6, "stress": 1e-6}, None, (E, E), 10.0),
        ("upper", {"length": 1e-6, "stress": 1e6, "n_upper": (3, 3)}, None, (E, E), 10.0),
        ("upper", {"cell": "quadrilateral"}, -0.02, (E, E), 10.0),
        *((slave, {}, -0.02, (E, 1e5), 19.8019802) for slave in SIDES),  # springs in a row
    ],
)
def test_pressure(slave, options, top, moduli, pressure):
    """Of 10 on top, or of a displacement of it, is everywhere; forces act in the middle."""
    s = Squares(slave, **options)
    if top is None:
        s.solve(loads=s.pull((0.0, -pressure * s.stress)))
    else:
        s.solve(s.roller(TOP, 1, top), moduli=moduli)
        pressure = -top / sum(1 / one for one in moduli)
    y = s.V.tabulate_dof_coordinates()[:, 1] / s.length
    lower, upper = (-pressure / one for one in moduli)
    exact = np.stack([0 * y, lower * (np.minimum(y, 0) + 1) + upper * np.maximum(y, 0)], axis=1)
    error = np.abs(s.u.x.array.reshape(-1, 2) / s.length - exact).max(initial=0.0)
    error, size = maximum(COMM, error, np.abs(exact).max(initial=0.0))
    assert error < EXACT * size
    found = s.side.gather(s.u)["pressure"] / s.stress
    assert np.abs(found - pressure).max() < EXACT * pressure
    assert np.allclose(s.fields.values("stress_yy") / s.stress, -pressure, rtol=EXACT, atol=0)
    sign = -1 if slave == "lower" else 1
    force = s.side.force[1]
    assert np.isclose(force, pressure * sign * s.stress * s.length, rtol=1e-9)
    assert np.isclose(s.side.moment[2], 0.5 * s.length * force, rtol=1e-9)


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
@pytest.mark.parametrize(("depth", "top"), [(0.02, 0.0), (-0.02, 0.0), (0.0, 0.02)])
def test_initial_gap_and_overlap(slave, depth, top):
    """An overlap is pushed out; a gap, of the start or pulled open, stays, free of stress."""
    s = Squares(slave, gap=-depth)
    report = s.solve(s.roller(TOP, 1, top))
    nodes, expected = s.side.gather(s.u), max(depth, 0.0) / 2 * E
    assert np.allclose(nodes["pressure"], expected, rtol=1e-9)
    if not expected:
        assert report.certificate.active_nodes == 0 and not nodes["active"].any()
        assert np.allclose(s.side.force, 0.0, atol=1e-9) and s.fields.max("von_mises") < 1e-9
        assert np.allclose(nodes["gap"], 0.02, rtol=1e-9)

# SPDX-License-Identifier: MIT
"""Heat and parameters that change in a motion: waves that they make, and the ledger of energies."""

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from tests.cases.solid import COMM, create_displacement, hold, plane, rectangle

pytestmark = pytest.mark.mpi

E, RHO, LENGTH, HEIGHT = 100.0, 1.0, 1.0, 0.1
PERIOD = 4 * LENGTH / np.sqrt(E / RHO)


class Bar:
    """A bar held at its left end, whose temperature and modulus are Constants."""

    def __init__(self, *, nu=0.0, bends=False):
        """Create the problem; heat stretches it along x, in proportion to y if it bends."""
        self.mesh = rectangle([(0, 0), (LENGTH, HEIGHT)], (20, 2))
        u = create_displacement(self.mesh)
        self.heat, self.E = fem.Constant(self.mesh, 0.0), fem.Constant(self.mesh, E)
        along = ufl.as_matrix([[1, 0, 0], [0, 0, 0], [0, 0, 0]])
        strain = self.heat * (ufl.SpatialCoordinate(self.mesh)[1] if bends else 1.0) * along
        law = dm.Elastic(E=self.E, nu=nu)
        self.solid, bcs = dm.Solid(u, law, eigenstrain=strain), [hold(u.function_space, plane(0))]
        self.problem = dm.ContactProblem(self.solid, bcs=bcs, terms=[dm.Inertia(self.solid, RHO)])

    def tip(self):
        return max(COMM.allgather(self.solid.u.x.array[::2].max(initial=-np.inf)))

    def walk(self, times, ramp, **options):
        steps = dm.time_steps(self.problem, times, ramp=ramp, progress=False, **options)
        return [(self.tip(), step.report.ledger) for step in steps]


def test_a_bar_that_is_heated_at_once():
    """Its end swings between 0 and 2 a L, and E a^2 / 2 per volume are there from then on.

    Less what a wave at c from the end relieves while it is heated over s, c s / (3 L) of it, which
    is the integral of E a / s times its stress, E a (t - x / c) / s.
    """
    a, bar = 1e-3, Bar()
    times = PERIOD * np.arange(1, 161) / 80
    found = bar.walk(times, {bar.heat: [(0.0, 0.0), (times[0], a), (times[-1], a)]})
    tips, ledgers = zip(*found, strict=True)
    assert np.mean(tips) == pytest.approx(a * LENGTH, rel=0.01)
    assert max(tips) == pytest.approx(2 * a * LENGTH, rel=0.03)
    given = E * a**2 / 2 * (LENGTH - np.sqrt(E / RHO) * times[0] / 3) * HEIGHT
    assert ledgers[-1].loads == pytest.approx(given, rel=0.01)
    assert max(abs(ledger.defect) for ledger in ledgers) < 1e-12
    assert not any("of the energy" in note for note in bar.problem.history[-1].report.notes)


def test_the_ledger_of_a_bar_that_is_heated_and_softens_goes_on_after_a_restart(tmp_path):
    times = PERIOD * np.arange(1, 21) / 40
    file = COMM.bcast(tmp_path / "heated.h5")

    def ramp(bar):
        soft = [(0.0, E), (PERIOD, E / 2)]
        return {bar.heat: [(0.0, 0.0), (PERIOD / 4, 1e-2), (PERIOD, 0.0)], bar.E: soft}

    whole = Bar(nu=0.3, bends=True)
    _, last = whole.walk(times, ramp(whole))[-1]
    assert abs(last.defect) < 1e-6
    assert last.loads > 0.1 * last.largest
    first, second = (Bar(nu=0.3, bends=True) for _ in range(2))
    first.walk(times[:7], ramp(first), checkpoint=file)
    found = second.walk(times, ramp(second), checkpoint=file)
    assert len(found) == 13
    assert found[-1][1].loads == pytest.approx(last.loads, rel=1e-7)
    assert abs(found[-1][1].defect) < 1e-6

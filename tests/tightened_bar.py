# SPDX-License-Identifier: MIT
"""A glued bar that is tightened, what a failure must leave as it was, and steps that fail."""

import numpy as np

import dolfinx_mortar as dm
from dolfinx import fem
from dolfinx_mortar.steps.newton import solve_step
from dolfinx_mortar.steps.report import StepReport
from tests.glued_bar import Bar, largest
from tests.meshes import BOTTOM, TOP


def clamped(cell="quadrilateral", **options):
    """Return a bar between rigid walls, confined all around, and its problem."""
    case = Bar(cell, **options)
    last = case.d - 1
    return case, case.problem([*case.rollers(), case.hold(BOTTOM, last), case.hold(TOP, last)])


def outwards(case):
    """Return the direction out of the slave side."""
    return case.along(-case.sign)


class Watched:
    """All that a failure must leave as it was."""

    def __init__(self, case, problem):
        """Keep copies."""
        self.parts = (case, problem)
        self.before = self.now()

    def now(self):
        case, problem = self.parts
        fields = [case.u, case.solid.stress, *case.solid.state.values()]
        fields += [case.tie.pressure, case.tie.gap, case.tie.active]
        arrays = [f.x.array.copy() for f in fields]
        return [*arrays, case.tie.force, case.tie.tightening, problem.committed.active.copy()]

    def unchanged(self):
        return all(map(np.array_equal, self.before, self.now()))


def loaded(**options):
    """Return a bar that carries a committed state, which is to stay."""
    case = Bar("quadrilateral", **options)
    push = fem.Constant(case.mesh, -1e-4)
    problem = case.problem([case.hold(BOTTOM), case.hold(TOP, 1, push), case.hold(TOP, 0)])
    dm.newton(problem)
    problem.commit()
    return case, problem


def refuse_beyond(monkeypatch, tie, most):
    """Let steps with larger jumps fail; return the jumps that were tried."""
    tried, begins = [], []

    def solve(problem, **options):
        begins.append(problem.u.x.array.copy())
        assert np.array_equal(begins[-1], begins[0])  # every try is one from the committed state
        tried.append(largest(tie.tightening))
        if tried[-1] > most:
            raise dm.NewtonNotConverged("too far", StepReport())
        return solve_step(problem, **options)

    monkeypatch.setattr("dolfinx_mortar.steps.tightening.solve_step", solve)
    return tried


def scripted(monkeypatch, force_of, *, refused=np.inf):
    """Let the force be a function of the jump, and steps with larger jumps fail."""

    def solve(search, s):
        search.steps.reports.append(StepReport())
        if s > refused:
            raise dm.NewtonNotConverged("too far", StepReport())
        search.tries.append((s, force_of(s)))
        search.tie.tightening = s * search.n
        return force_of(s) - search.force

    monkeypatch.setattr("dolfinx_mortar.steps.tightening.Search.solve", solve)
    return loaded()

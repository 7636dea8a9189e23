# SPDX-License-Identifier: MIT
"""A tied bar that is tightened, and the state that a failure must not change."""

import numpy as np

import dolfinx_mortar as dm
from dolfinx import fem
from tests.cases.glued_bar import Bar
from tests.cases.meshes import BOTTOM, TOP


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


def tighten(problem, forces, direction, **options):
    """Give ties their forces in one step, commit it and hold their overlaps; return its report."""
    for tie, force in forces.items():
        tie.pretension, tie.direction = force, direction
    try:
        report = dm.newton(problem, **{"rtol": 1e-7} | options)
    finally:
        for tie in forces:
            tie.pretension = None
    problem.commit()
    return report

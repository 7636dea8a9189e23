# SPDX-License-Identifier: MIT
"""All that a step starts from and all that is shown, to be compared bit by bit."""

import numpy as np


def fields_of(problem):
    """Return the Functions: displacement, states of points and of terms, nodal results."""
    fields = [problem.u, *problem.solid.points.lasting_fields().values()]
    fields += problem.state.states_of_terms.values()
    return fields + [f for interface in problem.interfaces for f in interface.nodal.values()]


def state_of(problem):
    """Return the bits of fields and of what is committed, the history, and the walk at last."""
    committed = problem.committed
    arrays = [f.x.array for f in fields_of(problem)]
    arrays += [committed.active, committed.displacement, committed.slid, committed.dissipated]
    arrays += [committed.paired, getattr(committed.supports, "forces", 0.0)]
    arrays += [np.zeros(0) if committed.sliding is None else committed.sliding]
    for interface in problem.interfaces:
        arrays += [] if interface.resultants is None else vars(interface.resultants).values()
        arrays += [getattr(interface, name, 0.0) for name in ("tightening", "dissipated")]
        if tool := getattr(interface, "tool", None):
            arrays += [tool.began.position]
    steps = [(step.number, step.time, step.forces) for step in committed.history]
    reached = committed.begun, committed.level, committed.walked, repr(committed.walk)
    return [np.asarray(array).tobytes() for array in arrays], repr(steps), *reached

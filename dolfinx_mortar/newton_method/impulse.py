# SPDX-License-Identifier: MIT
"""Response of the bodies to an impulse at the end of a step."""

from dataclasses import replace

import numpy as np

from dolfinx_mortar import qp as backends
from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.interfaces.constraints import equalities, join
from dolfinx_mortar.newton_method.linearisation import (
    Balance,
    linearise,
    support_slots,
    to_displacement,
    to_reduced,
)
from dolfinx_mortar.newton_method.residuals import tightest
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.qp import LinearSolver


def respond(
    problem: ContactProblem, forces: Floats, rtol: float, linear: LinearSolver
) -> Floats | None:
    """Return y (owned nodes, d) with K y = f, the last K, or None; collective.

    Supports and ties hold, contacts are free.
    """
    T, r = problem.system.transformation, problem.vector(forces)
    found = problem.system.constraints(problem.positions(), problem.vector(problem.owned_u))
    tied, contacts = found.select(found.equal), found.select(~found.equal)
    none = np.zeros(len(tied.dofs))
    infinite = np.full(len(contacts.dofs), np.inf)
    slots = support_slots(problem)[1]
    supported = equalities(slots, np.zeros(len(slots)))
    balance = Balance(
        r=r,
        reduced=to_reduced(T, r),
        equal=join([supported, replace(tied, lower=none, upper=none)]),
        bounds=replace(contacts, lower=-infinite, upper=infinite),
        elements=0.0,
        external=0.0,
    )
    try:
        lin = linearise(problem, balance, tangent=False, linear=linear)
        solved = backends.solve(
            lin.qp,
            linear=linear,
            start_active=np.zeros(len(contacts.dofs), dtype=np.int8),
            rtol=tightest(rtol),
        )
    except (backends.QPNotSolved, backends.UnusableQP):
        return None
    return np.asarray(to_displacement(T, solved.x).array_r.reshape(forces.shape)).copy()

# SPDX-License-Identifier: MIT
"""Trust-region Newton with projected searches: TAO's tron."""

from dolfinx_mortar.qp import tao
from dolfinx_mortar.qp.bound_qp import BoundQP, QPSolution
from dolfinx_mortar.qp.linear import LinearSolver
from dolfinx_mortar.qp.state import State


def solve(qp: BoundQP, linear: LinearSolver, *, start: State, rtol: float) -> QPSolution:
    """Solve a bound-constrained QP with TAO's tron (collective).

    Args:
        qp: the problem.
        linear: gives its options to the solver inside, and makes the last solve.
        start: unused; the method starts from the point of the box nearest to zero.
        rtol: tolerance of the KKT check.
    """
    return tao.run(qp, linear, "tron", name="tron", rtol=rtol)

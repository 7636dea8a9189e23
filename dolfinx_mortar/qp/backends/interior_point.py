# SPDX-License-Identifier: MIT
"""Interior point: TAO's bqpip, the counterpart of the quadprog that the paper calls."""

from dolfinx_mortar.qp import tao
from dolfinx_mortar.qp.bound_qp import BoundQP, QPSolution
from dolfinx_mortar.qp.linear import LinearSolver
from dolfinx_mortar.qp.state import State


def solve(qp: BoundQP, linear: LinearSolver, *, start: State, rtol: float) -> QPSolution:
    """Solve a bound-constrained QP with TAO's bqpip (collective).

    Args:
        qp: the problem.
        linear: gives its options to the solver inside, and makes the last solve.
        start: unused; the method starts from the interior of the bounds.
        rtol: tolerance of the KKT check.
    """
    return tao.run(qp, linear, "bqpip", name="interior-point", rtol=rtol)

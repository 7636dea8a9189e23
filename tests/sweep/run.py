# SPDX-License-Identifier: MIT
"""Solve one random problem and say what came of it."""

from dataclasses import dataclass, field
from typing import Any

from mpi4py import MPI

import numpy as np

import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from tests.sweep.draws import draw
from tests.sweep.problems import COMM, create
from tests.sweep.recheck import at_points, is_finite, largest_force, residuals, stress_tensor

TOLERANCE = 1e-4
"""Largest residual of a step solved to rtol = 1e-6. These are largest entries over the largest
nodal force; Newton takes norms, and its scale knows the forces inside the elements."""
FLOWING = 0.9
"""Share of a body that has to flow for a limit load."""
CUTS = 10
"""Halvings of a step, more than by default: so near to its limit load does such a body flow."""
LIMIT_LOAD = "limit load"
"""A body that does not harden flows."""
LARGE = "beyond small strain"
"""A body has strained or turned further than a small strain describes."""
TANGLED = "tangled cells"
"""At finite strain a body flows past an edge of the other: a cell loses its volume there."""


@dataclass
class Outcome:
    """What came of a random problem."""

    kind: str
    seed: int
    data: dict[str, Any]
    failure: str = ""  # why it failed
    excuse: str = ""  # LIMIT_LOAD, LARGE or TANGLED where no solver could do better
    iterations: list[int] = field(default_factory=list)  # of Newton, one per committed part
    steps: int = 0  # committed steps
    cuts: int = 0  # parts in excess of the steps
    residuals: dict[str, float] = field(default_factory=dict)  # worst over the steps

    @property
    def is_failed(self):
        """Tell whether it failed without an excuse."""
        return bool(self.failure) and not self.excuse


def run(kind, seed, surface="smooth"):
    """Solve a random problem and check its steps; collective."""
    data = draw(kind, seed)
    outcome = Outcome(kind, seed, data | {"laws": {k: repr(v) for k, v in data["laws"].items()}})
    case = None
    try:
        case = create(kind, seed, surface)
        _solve(case, outcome)
    except Exception as error:
        outcome.failure = f"{type(error).__name__}: {error}"
        if case is not None and isinstance(error, dm.NewtonNotConverged):
            outcome.excuse = _excuse(case, str(error))
    worst = max(outcome.residuals.values(), default=0.0, key=_badness)
    if not outcome.failure and not worst <= TOLERANCE:
        outcome.failure = f"the solution does not pass the check: {outcome.residuals}"
    return outcome


def _solve(case, outcome):
    """Walk through the steps; record each after its check."""
    u = case.problem.u.x.array
    own = case.problem.d * case.problem.n
    before, begun = u[:own].copy(), 0.0
    for step in dm.load_steps(case.problem, case.levels, on_time=case.on_time, max_cuts=CUTS):
        outcome.iterations += [part.newton_iterations for part in step.parts]
        outcome.steps += 1
        outcome.cuts += len(step.parts) - 1
        known = len(step.parts) == 1  # slips are those of the last part
        for name, value in residuals(case, before if known else None, begun).items():
            # not a number is the worst of all
            outcome.residuals[name] = max(value, outcome.residuals.get(name, 0.0), key=_badness)
        before, begun = u[:own].copy(), largest_force(case)


def _badness(value):
    return float("inf") if value != value else value


def _excuse(case, message):
    """Return why the step that did not converge may have no solution, or nothing; collective."""
    if flows(case):
        return LIMIT_LOAD
    if is_finite(case):
        lost = "turned inside out" in message or "of their volume" in message
        return TANGLED if lost else ""
    return LARGE if is_large(case) else ""


def flows(case):
    """Tell whether most of some body that does not harden is at its yield limit; collective.

    |dev sigma| = Y there, in the Frobenius norm: a traction that needs more cannot be carried.
    """
    s, dx = case.problem.solid.stress, at_points(case)
    out_of_plane = s[2] if case.problem.V.mesh.geometry.dim == 2 else 0
    in_plane = stress_tensor(case)
    mean = (ufl.tr(in_plane) + out_of_plane) / 3
    square = ufl.inner(in_plane, in_plane) + out_of_plane**2 - 3 * mean**2
    for tag, law in case.data["laws"].items():
        if getattr(law, "a", None) != 0.0 or getattr(law, "H", 0.0) != 0.0:
            continue
        yields = ufl.conditional(ufl.ge(square, (0.999 * law.Y) ** 2), 1.0, 0.0)
        one = fem.Constant(case.problem.V.mesh, 1.0)
        share = [COMM.allreduce(_integral(f * dx(tag)), op=MPI.SUM) for f in (yields, one)]
        if share[0] >= FLOWING * share[1]:
            return True
    return False


def is_large(case):
    """Tell whether a body has strained or turned beyond what a small strain describes; collective.

    The mean of |H^T H| / 2, H = grad u, is the error of lengths there: a tenth and more.
    """
    H = ufl.grad(case.problem.u)
    left_out, dx = ufl.sqrt(ufl.inner(H.T * H, H.T * H)) / 2, at_points(case)
    one = fem.Constant(case.problem.V.mesh, 1.0)
    parts = [_integral(f * dx(tag)) for tag in case.data["laws"] for f in (left_out, one)]
    sums = np.array(COMM.allreduce(np.array(parts), op=MPI.SUM)).reshape(-1, 2)
    return bool((sums[:, 0] > 0.1 * sums[:, 1]).any())


def _integral(form):
    return float(fem.assemble_scalar(fem.form(form)))

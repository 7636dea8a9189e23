# SPDX-License-Identifier: MIT
"""Why a step has failed, as far as it can be told: too large a load, or a body that floats."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from mpi4py import MPI

import numpy as np

from dolfinx import la
from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.qp import QPNotSolved, UnusableQP
from dolfinx_mortar.steps.bodies import name_of
from dolfinx_mortar.steps.problem import ContactProblem
from dolfinx_mortar.steps.report import NewtonNotConverged, StepReport

# A body that floats off does not strain. One that flows in more than this share of its volume does.
FLOWING = 0.1
# A body whose tangent is softer than this share of its elasticity, along its own displacement, has
# come to the end of what it carries; hardening laws of metals are ten times stiffer and more.
SOFT = 0.01
# The end of what is said of a step alone.
AS_BEFORE = (
    ". The displacement and the committed state are as before the step: retry with a smaller one "
    "(dm.load_steps does)"
)
# What is said first where friction holds a body.
TOO_MUCH = (
    "the loads may exceed what friction carries (then prescribe displacements instead of forces), "
    "or the step is too large for it (then take smaller ones)"
)


@contextmanager
def named(problem: ContactProblem, report: StepReport) -> Iterator[None]:
    """Turn the failure of a backend, or a QP that has no solution, into that of the step."""
    try:
        yield
    except (QPNotSolved, UnusableQP) as error:
        number, cause = len(report.iterations) + 1, str(error).rstrip(". ")
        message = f"the QP of Newton iteration {number}: {cause}"
        raise not_converged(message, problem, report) from error


def not_converged(message: str, problem: ContactProblem, report: StepReport) -> NewtonNotConverged:
    """Return the error of a step that has failed at the present displacement; collective."""
    flowing = describe_flow(problem)
    if flowing:  # what the solver says of singular matrices would point to floating bodies
        report.notes.append(message)
        message = flowing
    elif held := problem.audit().held_by_contact:
        if problem.system.has_friction:  # one cause, of which solvers say one thing or another
            message = f"{TOO_MUCH}: {message}"
        message += (
            f". Contact alone holds {'; '.join(held)}: it may float away (do the loads press it "
            "on?), or slides or rolls freely (then prescribe that motion)"
        )
    message += _describe_own_laws(problem)
    return NewtonNotConverged(f"{message}{AS_BEFORE}", report)


def unsettled(problem: ContactProblem) -> str:
    """Say why the geometry of contact does not come to rest."""
    flows = bool(problem.solid.state)  # elastic bodies have none, and no hardening
    soft = "a body that flows with little hardening: give it more, " if flows else "a soft body: "
    return (
        "the geometry does not settle: normals and gaps change more from one update to the "
        "next, although the forces are in balance in between. Contact forces that turn with the "
        f"surfaces may be stiffer than {soft}take smaller steps, or hold the surfaces, "
        "geometry='reference'"
    )


def _describe_own_laws(problem: ContactProblem) -> str:
    """Say how laws that are not of this package are judged; nothing where there are none."""
    package = __name__.partition(".")[0]
    laws = [region.law for region in problem.solid.regions]
    own = [law.__name__ for law in laws if not law.__module__.startswith(f"{package}.")]
    if not own:
        return ""
    return (
        f". {', '.join(own)}: {package}.materials.check tells whether the potential of a law is "
        "convex and its tangent the derivative of its stress"
    )


def describe_flow(problem: ContactProblem) -> str:
    """Say which body flows, and how much of it; nothing where none flows much; collective."""
    try:
        problem.solid.evaluate()
    except ValueError:  # not a number: the iterate says nothing
        return ""
    shares = flow_shares(problem)
    body = int(np.argmax(shares))
    if shares[body] <= FLOWING or stiffness_left(problem) > SOFT:
        return ""
    return (
        f"limit load? {name_of(problem.bodies, [body])} flows in {100 * shares[body]:.0f} % of its "
        "volume at the last iterate; without hardening a law carries no more than its limit load: "
        "reduce the load, or give the law hardening"
    )


def stiffness_left(problem: ContactProblem) -> float:
    """Return u.K u over u.K_e u, K_e the elastic stiffness; 1 where nothing is strained.

    K is the tangent at the present displacement; collective.
    """
    problem.solid.assemble_tangent(problem.K)  # the next step assembles its own
    u = problem.vector(problem.u.x.array[: problem.d * problem.n])
    elastic = problem.solid.elastic_norm(problem.u) ** 2
    return float(u.dot(problem.K * u) / elastic) if elastic > 0.0 else 1.0


def flow_shares(problem: ContactProblem) -> Floats:
    """Return the share (bodies,) of each body's volume whose internal variables change; collective.

    Between the committed state and what `Solid.evaluate` has found last.
    """
    flowing, weights = problem.solid.flowing(), problem.solid.fields.weights
    V, n = problem.V, problem.n
    label = la.vector(V.dofmap.index_map, 1)
    label.array[:n] = problem.bodies.label
    label.scatter_forward()
    body = label.array[V.dofmap.list[: len(weights), 0]].astype(np.int64)
    count = problem.bodies.count
    volumes = np.stack(
        [
            np.bincount(body, (weights * part).sum(axis=1), minlength=count)
            for part in (flowing, np.ones_like(weights))
        ]
    )
    flow, whole = problem.comm.allreduce(volumes, op=MPI.SUM)
    return np.asarray(flow / whole)

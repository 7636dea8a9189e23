# SPDX-License-Identifier: MIT
"""Why a step has failed, as far as it can be told."""

from __future__ import annotations

from dolfinx_mortar.steps.problem import ContactProblem
from dolfinx_mortar.steps.report import NewtonNotConverged, StepReport


def not_converged(message: str, problem: ContactProblem, report: StepReport) -> NewtonNotConverged:
    """Return the error, with what the audit knows about bodies that may move off; collective."""
    if problem.audit().held_by_contact:
        message += (
            ". A body held by contact alone may float away (do the loads press it on?), or slides "
            "or rolls freely (then prescribe that motion)"
        )
    return NewtonNotConverged(
        f"{message}. The displacement and the committed state are as before the step: "
        "retry with a smaller one (dm.load_steps does)",
        report,
    )

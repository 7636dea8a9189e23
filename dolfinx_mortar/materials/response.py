# SPDX-License-Identifier: MIT
"""What a law makes of a strain: its methods called and what they return judged, as UFL."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import ufl
from ufl.classes import Label, Variable
from ufl.core.expr import Expr


@dataclass(frozen=True)
class Response:
    """The answer of a law to a strain."""

    stress: Expr  # (3, 3)
    energy: Expr | None  # the incremental potential, if the law has one
    updated: dict[str, Expr]  # internal variables at the end of the step, () or (3, 3)


def respond(law: Any, strain: Expr, state: Mapping[str, Expr], p: Any) -> Response:
    """Return stress, energy and new internal variables of a law.

    A law without a stress gives the derivative of its energy.

    Args:
        law: class (or instance) of the material.
        strain: 3x3 UFL expression.
        state: committed internal variables by name, () or (3, 3).
        p: parameters as attributes.
    """
    energy = law.energy(strain, state, p) if hasattr(law, "energy") else None
    if hasattr(law, "stress"):
        stress = law.stress(strain, state, p)
    else:
        # Not ufl.variable: its running number would get into the signature of the compiled code.
        variable = Variable(strain, Label(-1))
        stress = ufl.diff(law.energy(variable, state, p), variable)
    return Response(stress, energy, law.updated_state(strain, state, p))

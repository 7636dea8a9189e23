# SPDX-License-Identifier: MIT
"""Laws at finite strain as functions of arrays: from the deformation gradient to P and dP/dF.

A solid with ``strain="finite"`` calls a `FiniteLaw` for each region whose law is one of arrays
that is made for F (`PointwiseLaw` with ``strain = "finite"``). Laws of a small strain are
`logarithmic.LogarithmicLaw`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np

from dolfinx_mortar.arrays import Bools, Floats
from dolfinx_mortar.materials.protocol import Law
from dolfinx_mortar.materials.response import shaped_array, values_at_points


@dataclass(frozen=True)
class FiniteValues:
    """The answer of a law at q deformation gradients, each with det F > 0."""

    energy: Floats | None  # (q,) psi, the incremental potential per volume at X; None without one
    stress: Floats  # (q, 3, 3) P = d psi / dF, force per area at X
    tangent: Floats  # (q, 3, 3, 3, 3) dP_ij / dF_kl, with the symmetry ij <-> kl
    state: dict[str, Floats]  # (q,) or (q, 3, 3), internal variables at the end of the step
    normal: Floats | None = None  # (q,) in plane stress the stretch out of the plane less 1

    @property
    def undefined(self) -> Bools:
        """At which points (q,) something is NaN or infinite."""
        parts = [self.stress, self.tangent, *self.state.values()]
        parts += [] if self.energy is None else [self.energy]
        found = np.zeros(len(self.stress), dtype=bool)
        for part in parts:
            if not np.isfinite(part.sum()):  # much quicker than to look at each
                found |= ~np.isfinite(part.reshape(len(part), -1)).all(axis=1)
        return found


Evaluation = Callable[[Floats, Mapping[str, Floats], SimpleNamespace], FiniteValues]


@dataclass(frozen=True)
class FiniteLaw:
    """A law that is ready to be called at points.

    ``evaluate(F, state, p)`` gets F (q, 3, 3), det F > 0, q may be 0; the committed internal
    variables, (q,) or (q, 3, 3), not to be changed; and the parameters (q,) by name.
    """

    evaluate: Evaluation
    has_energy: bool  # whether `FiniteValues.energy` is there


def create_finite_law(law: Law) -> FiniteLaw:
    """Return what evaluates a law of arrays that is made for F."""

    def evaluate(F: Floats, state: Mapping[str, Floats], p: SimpleNamespace) -> FiniteValues:
        found = values_at_points(law, F, state, p)
        energy = None
        if found.normal is not None:
            F = F.copy()
            F[:, 2, 2] = 1.0 + found.normal
        if law.energy is not None:
            try:
                given = law.energy(F, state, p)
            except Exception as error:
                raise ValueError(
                    f"{law.name}.energy raised {type(error).__name__}: {error} (at {len(F)} points)"
                ) from error
            energy = shaped_array(f"{law.name}.energy", given, (len(F),))
        return FiniteValues(energy, found.stress, found.tangent, found.state, found.normal)

    return FiniteLaw(evaluate, law.energy is not None)

# SPDX-License-Identifier: MIT
"""Material laws: stress or energy, and new state, of a 3x3 strain."""

from typing import Any

from dolfinx_mortar.materials.creep import Norton, Viscoelastic
from dolfinx_mortar.materials.elastic import Elastic, MooneyRivlin, NeoHooke, Ogden, Orthotropic
from dolfinx_mortar.materials.plasticity import DruckerPrager, VonMises, VonMisesVoce
from dolfinx_mortar.materials.protocol import Material, PointwiseLaw

__all__ = [
    "DruckerPrager",
    "Elastic",
    "Material",
    "MooneyRivlin",
    "NeoHooke",
    "Norton",
    "Ogden",
    "Orthotropic",
    "PointwiseLaw",
    "Viscoelastic",
    "VonMises",
    "VonMisesVoce",
    "check",
]


def __getattr__(name: str) -> Any:
    """Load `check` at first use."""
    if name == "check":
        from dolfinx_mortar.materials.law_check import check

        return check
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

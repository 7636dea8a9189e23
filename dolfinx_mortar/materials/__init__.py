# SPDX-License-Identifier: MIT
"""Material laws: one file per law, UFL expressions only.

A law turns a 3x3 strain, its committed state and parameters into stress or energy and new state.
It must not know of meshes, functions or contact; `check` tries a law out without any of them.
"""

from typing import Any

from dolfinx_mortar.materials.drucker_prager import DruckerPrager
from dolfinx_mortar.materials.elastic import Elastic
from dolfinx_mortar.materials.mooney_rivlin import MooneyRivlin
from dolfinx_mortar.materials.neo_hooke import NeoHooke
from dolfinx_mortar.materials.ogden import Ogden
from dolfinx_mortar.materials.orthotropic import Orthotropic
from dolfinx_mortar.materials.protocol import Material, PointwiseLaw
from dolfinx_mortar.materials.voce import VonMisesVoce
from dolfinx_mortar.materials.von_mises import VonMises

__all__ = [
    "DruckerPrager",
    "Elastic",
    "Material",
    "MooneyRivlin",
    "NeoHooke",
    "Ogden",
    "Orthotropic",
    "PointwiseLaw",
    "VonMises",
    "VonMisesVoce",
    "check",
]


def __getattr__(name: str) -> Any:
    """Load `check`, a companion, at first use."""
    if name == "check":
        from dolfinx_mortar.materials.law_check import check

        return check
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

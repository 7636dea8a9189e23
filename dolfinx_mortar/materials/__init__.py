# SPDX-License-Identifier: MIT
"""Material laws: one file per law, UFL expressions only."""

from dolfinx_mortar.materials.elastic import Elastic
from dolfinx_mortar.materials.protocol import Material
from dolfinx_mortar.materials.von_mises import VonMises

__all__ = ["Elastic", "Material", "VonMises"]

# SPDX-License-Identifier: MIT
"""Meshes of bodies in contact, one distributed mesh: from files, or a disc or ball on a block."""

from dolfinx_mortar.meshing.deck import Deck
from dolfinx_mortar.meshing.inp import read_inp
from dolfinx_mortar.meshing.msh import read_msh
from dolfinx_mortar.meshing.step_file import read_step
from dolfinx_mortar.meshing.two_bodies import TaggedMesh, hertz, sphere

__all__ = ["Deck", "TaggedMesh", "hertz", "read_inp", "read_msh", "read_step", "sphere"]

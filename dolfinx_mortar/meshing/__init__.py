# SPDX-License-Identifier: MIT
"""Meshes of bodies in contact, one distributed mesh: from files, or a disc or ball on a block."""

from dolfinx_mortar.meshing.msh import read_msh
from dolfinx_mortar.meshing.two_bodies import TaggedMesh, hertz, sphere

__all__ = ["TaggedMesh", "hertz", "read_msh", "sphere"]

# SPDX-License-Identifier: MIT
"""Meshes of bodies that touch, each in one distributed mesh: from files, for demos and tests."""

from dolfinx_mortar.meshing.msh import MshMesh, read_msh
from dolfinx_mortar.meshing.plane import (
    ARC,
    AXIS,
    BLOCK,
    BOTTOM,
    DISC,
    FLAT,
    TOP,
    HertzMesh,
    hertz,
)
from dolfinx_mortar.meshing.rings import RingsMesh, rings
from dolfinx_mortar.meshing.socket import socket
from dolfinx_mortar.meshing.sphere import BALL, SPHERE, SYMMETRY_X, SYMMETRY_Y, SphereMesh, sphere
from dolfinx_mortar.meshing.tubes import TubesMesh, tubes

__all__ = [
    "ARC",
    "AXIS",
    "BALL",
    "BLOCK",
    "BOTTOM",
    "DISC",
    "FLAT",
    "SPHERE",
    "SYMMETRY_X",
    "SYMMETRY_Y",
    "TOP",
    "HertzMesh",
    "MshMesh",
    "RingsMesh",
    "SphereMesh",
    "TubesMesh",
    "hertz",
    "read_msh",
    "rings",
    "socket",
    "sphere",
    "tubes",
]

# SPDX-License-Identifier: MIT
"""Meshes for the demos and tests: two bodies that touch, in one distributed mesh."""

from dolfinx_mortar.meshing.plane import ARC, BLOCK, BOTTOM, DISC, FLAT, TOP, HertzMesh, hertz
from dolfinx_mortar.meshing.socket import socket
from dolfinx_mortar.meshing.sphere import BALL, SPHERE, SYMMETRY_X, SYMMETRY_Y, SphereMesh, sphere

__all__ = [
    "ARC",
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
    "SphereMesh",
    "hertz",
    "socket",
    "sphere",
]

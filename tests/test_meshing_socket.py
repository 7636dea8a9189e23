# SPDX-License-Identifier: MIT
"""Tests for the mesh of a ball in its socket: shapes, tags, and errors."""

import importlib

from mpi4py import MPI

import numpy as np
import pytest

import ufl
from dolfinx import fem
from dolfinx_mortar import meshing

COMM = MPI.COMM_WORLD
CELLS = ["tetrahedron", "hexahedron"]


def integral(expression):
    """Return the integral of a form over all ranks."""
    return COMM.allreduce(fem.assemble_scalar(fem.form(expression)))


@pytest.mark.mpi
@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("radius", [10.0, 1e-3])
def test_bodies_and_sides(cell, radius):
    """Areas by tag, volumes, and the point in which the spheres touch."""
    R, r = radius, 0.95 * radius
    m = meshing.socket(COMM, cell=cell, h=(R / 8, R / 10), radius=R, clearance=R - r)
    one = fem.Constant(m.mesh, 1.0)
    ds = ufl.Measure("ds", m.mesh, subdomain_data=m.facet_tags)
    areas = [integral(one * ds(tag)) / R**2 for tag in range(1, 7)]
    side = 2.5**2 - np.pi / 4 + np.pi / 4 * 0.95**2
    spheres = np.pi / 2, np.pi / 2 * 0.95**2
    assert areas == pytest.approx([2.5**2, np.pi / 4 * 0.95**2, *spheres, side, side], rel=0.02)
    dx = ufl.Measure("dx", m.mesh, subdomain_data=m.cell_tags)
    volumes = [integral(one * dx(tag)) / R**3 for tag in (1, 2)]
    assert volumes == pytest.approx([2.5**3 - np.pi / 6, np.pi / 6 * 0.95**3], rel=0.02)
    at = np.linalg.norm(m.mesh.geometry.x - [0.0, 0.0, -R], axis=1) < 1e-9 * R
    touching = m.mesh.geometry.x[at]
    count = COMM.allreduce(len(touching))
    assert count >= 2  # a node of either body, on some ranks as a ghost, too


@pytest.mark.parametrize(
    "options",
    [
        {"cell": "prism"},
        {"h": 0.0},
        {"h": 6.0},
        {"h": (0.1, 0.1, 0.1)},
        {"radius": -1.0},
        {"radius": np.nan},
        {"clearance": 0.0},
        {"clearance": 6.0},
        {"clearance": None},
    ],
)
def test_bad_arguments_are_named(options, monkeypatch):
    module = importlib.import_module("dolfinx_mortar.meshing.socket")  # not the function
    monkeypatch.setattr(module, "distribute", pytest.fail)
    with pytest.raises(ValueError, match=f"^{next(iter(options))} = "):
        meshing.socket(COMM, **options)

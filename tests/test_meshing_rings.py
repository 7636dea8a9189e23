# SPDX-License-Identifier: MIT
"""Tests for the mesh of a tube's section: areas and sides by tag, and errors."""

from mpi4py import MPI

import numpy as np
import pytest

import ufl
from dolfinx import fem
from dolfinx_mortar import meshing

COMM = MPI.COMM_WORLD


def integral(expression):
    """Return the integral of a form over all ranks."""
    return COMM.allreduce(fem.assemble_scalar(fem.form(expression)))


@pytest.mark.mpi
@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
@pytest.mark.parametrize("unit", [1.0, 1e-6])
@pytest.mark.parametrize("count", [1, 2])
def test_bodies_and_sides(cell, unit, count):
    """Polygons in circles: second order in the angle, known exactly."""
    radii, cells = unit * np.array([1.0, 1.5, 2.5]), ((2, 10), (3, 14))
    m = meshing.rings(COMM, radii=radii[: count + 1], cells=cells[:count], cell=cell)
    one = fem.Constant(m.mesh, 1.0)
    ds = ufl.Measure("ds", m.mesh, subdomain_data=m.facet_tags)
    dx = ufl.Measure("dx", m.mesh, subdomain_data=m.cell_tags)

    def chords(r, n):
        return 2 * n * r * unit * np.sin(np.pi / 4 / n)

    def area(a, b, n):
        return n / 2 * np.sin(np.pi / 2 / n) * (b**2 - a**2) * unit**2

    rim = 1.5 if count == 2 else 0.5
    sides = [chords(1.0, 10), chords(2.5, 14), chords(1.5, 10), chords(1.5, 14)]
    if count == 1:
        sides = [chords(1.0, 10), chords(1.5, 10), 0.0, 0.0]
    assert [integral(one * ds(tag)) for tag in range(1, 7)] == pytest.approx(
        [*sides, rim * unit, rim * unit], rel=1e-10, abs=1e-12 * unit
    )
    areas = [area(1.0, 1.5, 10), area(1.5, 2.5, 14) * (count == 2)]
    found = [integral(one * dx(tag)) for tag in (1, 2)]
    assert found == pytest.approx(areas, rel=1e-10, abs=1e-12 * unit**2)
    normal, x = ufl.FacetNormal(m.mesh), ufl.SpatialCoordinate(m.mesh)
    for tag, outwards in ((1, -1), (2, 1), (3, 1), (4, -1)):
        assert outwards * integral(ufl.dot(normal, x) * ds(tag)) >= 0.0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"cell": "hexahedron"}, "cell = 'hexahedron' is not known"),
        ({"radii": (1.0,)}, r"radii = \(1.0,\) must be two or three growing"),
        ({"radii": (1.0, 1.3, 1.2)}, r"radii = .* growing positive numbers"),
        ({"radii": (0.0, 1.0, 2.0)}, r"radii = .* growing positive numbers"),
        ({"radii": (1.0, np.nan, 2.0)}, r"radii = .* growing positive numbers"),
        ({"radii": "ab"}, "radii = 'ab' must be"),
        ({"cells": ((3, 4),)}, r"cells = \(\(3, 4\),\) must be a pair .* each of 2 rings"),
        ({"cells": ((3, 4), (0, 4))}, r"cells = .* positive integers"),
        ({"cells": ((3, 4), (1.5, 4))}, r"cells = .* positive integers"),
        ({"cells": None}, "cells = None must be"),
    ],
)
def test_bad_arguments_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        meshing.rings(COMM, **options)

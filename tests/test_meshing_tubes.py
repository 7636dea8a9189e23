# SPDX-License-Identifier: MIT
"""Tests for the mesh of a hub on a shaft: volumes and sides by tag, and errors."""

from mpi4py import MPI

import numpy as np
import pytest

import ufl
from dolfinx import fem
from dolfinx_mortar import meshing

COMM = MPI.COMM_WORLD
RADII, LENGTH = np.array([1.0, 1.5, 2.5]), 3.0


def measures(m):
    """Return the sizes of the bodies by tag 1, 2, and of the sides by tag 1 to 10."""
    one = fem.Constant(m.mesh, 1.0)
    ds = ufl.Measure("ds", m.mesh, subdomain_data=m.facet_tags)
    dx = ufl.Measure("dx", m.mesh, subdomain_data=m.cell_tags)

    def size(measure):
        return COMM.allreduce(fem.assemble_scalar(fem.form(one * measure)))

    return [size(dx(tag)) for tag in (1, 2)], [size(ds(tag)) for tag in range(1, 11)]


@pytest.mark.mpi
@pytest.mark.parametrize("unit", [1.0, 1e-6])
def test_section(unit):
    m = meshing.tubes(COMM, radii=tuple(unit * RADII), length=unit * LENGTH)
    bodies, sides = measures(m)
    assert bodies == pytest.approx([0.5 * LENGTH * unit**2, LENGTH * unit**2], rel=1e-12)
    ends = [0.5, 0.5, 1.0, 1.0]
    expected = unit * np.array([*[LENGTH] * 4, 0.0, 0.0, *ends])
    assert sides == pytest.approx(expected, rel=1e-12)


@pytest.mark.mpi
@pytest.mark.parametrize("unit", [1.0, 1e-6])
def test_quarter(unit):
    """Prisms on polygons in circles, known exactly."""
    cells = ((2, 3, 5), (3, 4, 7))
    m = meshing.tubes(COMM, radii=tuple(unit * RADII), length=unit * LENGTH, cells=cells)
    bodies, sides = measures(m)

    def area(a, b, n):
        return n / 2 * np.sin(np.pi / 2 / n) * (b**2 - a**2)

    def round_side(r, n):
        return 2 * n * r * np.sin(np.pi / 4 / n) * LENGTH

    walls = [area(1.0, 1.5, 5), area(1.5, 2.5, 7)]
    expected = unit**3 * LENGTH * np.array(walls)
    assert bodies == pytest.approx(expected, rel=1e-10, abs=1e-12 * unit**3)
    curved = [round_side(*at) for at in ((1.0, 5), (2.5, 7), (1.5, 5), (1.5, 7))]
    flat = [1.5 * LENGTH, 1.5 * LENGTH, walls[0], walls[0], walls[1], walls[1]]
    expected = unit**2 * np.array([*curved, *flat])
    assert sides == pytest.approx(expected, rel=1e-10, abs=1e-12 * unit**2)
    normal, x = ufl.FacetNormal(m.mesh), ufl.SpatialCoordinate(m.mesh)
    ds = ufl.Measure("ds", m.mesh, subdomain_data=m.facet_tags)
    radial = normal[0] * x[0] + normal[1] * x[1]
    for tag, outwards in ((1, -1), (2, 1), (3, 1), (4, -1)):
        form = fem.form(radial * ds(tag))
        assert outwards * COMM.allreduce(fem.assemble_scalar(form)) > 0.0
    for tag, end in ((7, 0.0), (8, LENGTH), (9, 0.0), (10, LENGTH)):
        mean = COMM.allreduce(fem.assemble_scalar(fem.form(x[2] * ds(tag)))) / sides[tag - 1]
        assert mean == pytest.approx(unit * end, abs=1e-12 * unit)


def test_nodes_lie_on_circles_and_on_the_symmetry_planes():
    m = meshing.tubes(COMM, radii=tuple(RADII), length=LENGTH, cells=((1, 2, 3), (1, 2, 4)))
    x = m.mesh.geometry.x
    r = np.hypot(x[:, 0], x[:, 1])
    assert np.abs(r[:, None] - RADII).min(axis=1).max(initial=0.0) < 1e-14
    for name, axis in (("on_y", 0), ("on_x", 1)):
        V = fem.functionspace(m.mesh, ("Lagrange", 1))
        dofs = fem.locate_dofs_topological(V, 2, m.facet_tags.find(name))
        assert np.abs(V.tabulate_dof_coordinates()[dofs, axis]).max(initial=0.0) < 1e-14


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"radii": (1.0, 2.0)}, r"radii = \(1.0, 2.0\) must be 3 positive numbers"),
        ({"radii": (0.0, 1.0, 2.0)}, "radii = .* must be 3 positive"),
        ({"radii": (1.0, 3.0, 2.0)}, "radii = .* must grow"),
        ({"length": 0.0}, "length = 0.0 must be one positive number"),
        ({"length": np.nan}, "length = nan must be"),
        ({"cells": ((3, 4),)}, r"cells = \(\(3, 4\),\) must be two positive integers"),
        ({"cells": ((3, 4), (0, 4))}, "cells = .* positive integers"),
        ({"cells": ((3, 4, 5), (3, 4))}, "cells = .* positive integers"),
        ({"cells": ((3, 4), (1.5, 4))}, "cells = .* positive integers"),
        ({"cells": None}, "cells = None must be"),
    ],
)
def test_bad_arguments_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        meshing.tubes(COMM, **options)

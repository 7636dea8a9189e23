# SPDX-License-Identifier: MIT
"""The meshes of the demos: sizes and sides by tag, whatever the unit."""

from mpi4py import MPI

import numpy as np
import pytest

import ufl
from demos.ball_joint.ball_in_socket import ball_in_socket
from demos.shrink_fit.tubes import tubes
from demos.tied_cylinder.ring_section import ring_section
from dolfinx import fem
from tests.cases.integrals import integral

COMM = MPI.COMM_WORLD
RADII, LENGTH = np.array([1.0, 1.5, 2.5]), 3.0


@pytest.mark.mpi
@pytest.mark.parametrize("cell", ["tetrahedron", "hexahedron"])
@pytest.mark.parametrize("radius", [10.0, 1e-3])
def test_a_ball_in_its_socket(cell, radius):
    """Areas by tag, volumes, and the point in which the spheres touch."""
    R, r = radius, 0.95 * radius
    m = ball_in_socket(COMM, cell=cell, h=(R / 8, R / 10), radius=R, clearance=R - r)
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


@pytest.mark.mpi
@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
@pytest.mark.parametrize("unit", [1.0, 1e-6])
@pytest.mark.parametrize("count", [1, 2])
def test_rings(cell, unit, count):
    """Polygons in circles: second order in the angle, known exactly."""
    radii, cells = unit * RADII, ((2, 10), (3, 14))
    m = ring_section(COMM, radii[: count + 1], cells[:count], cell)
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


def measures(m):
    """Return the sizes of the bodies by tag 1, 2, and of the sides by tag 1 to 10."""
    one = fem.Constant(m.mesh, 1.0)
    ds = ufl.Measure("ds", m.mesh, subdomain_data=m.facet_tags)
    dx = ufl.Measure("dx", m.mesh, subdomain_data=m.cell_tags)
    bodies = [integral(one * dx(tag)) for tag in (1, 2)]
    return bodies, [integral(one * ds(tag)) for tag in range(1, 11)]


@pytest.mark.mpi
@pytest.mark.parametrize("unit", [1.0, 1e-6])
def test_the_section_of_tubes(unit):
    m = tubes(COMM, tuple(unit * RADII), unit * LENGTH, ((6, 12), (7, 15)))
    bodies, sides = measures(m)
    assert bodies == pytest.approx([0.5 * LENGTH * unit**2, LENGTH * unit**2], rel=1e-12)
    ends = [0.5, 0.5, 1.0, 1.0]
    expected = unit * np.array([*[LENGTH] * 4, 0.0, 0.0, *ends])
    assert sides == pytest.approx(expected, rel=1e-12)


@pytest.mark.mpi
@pytest.mark.parametrize("unit", [1.0, 1e-6])
def test_a_quarter_of_tubes(unit):
    """Prisms on polygons in circles, known exactly."""
    cells = ((2, 3, 5), (3, 4, 7))
    m = tubes(COMM, tuple(unit * RADII), unit * LENGTH, cells)
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
        assert outwards * integral(radial * ds(tag)) > 0.0
    for tag, end in ((7, 0.0), (8, LENGTH), (9, 0.0), (10, LENGTH)):
        mean = integral(x[2] * ds(tag)) / sides[tag - 1]
        assert mean == pytest.approx(unit * end, abs=1e-12 * unit)

# SPDX-License-Identifier: MIT
"""The meshes of the demos: sizes and sides by tag, whatever the unit."""

from mpi4py import MPI

import numpy as np
import pytest

from demos.ball_joint.ball_in_socket import ball_in_socket
from demos.shrink_fit.tubes import tubes
from demos.tied_cylinder.ring_section import ring_section
from tests.cases.integrals import sizes

COMM = MPI.COMM_WORLD
RADII, LENGTH = np.array([1.0, 1.5, 2.5]), 3.0


def measures(m, count):
    """Return the sizes of the bodies by tag 1, 2, and of the sides by tag 1 to count."""
    bodies = sizes(m.mesh, m.cell_tags, "dx", (1, 2))
    sides = sizes(m.mesh, m.facet_tags, "ds", range(1, count + 1))
    return [*bodies.values()], [*sides.values()]


def chord(r, n):
    """Return the length of a quarter of a polygon with 4 n corners."""
    return 2 * n * r * np.sin(np.pi / 4 / n)


def section(a, b, n):
    """Return the area of a quarter between two such polygons."""
    return n / 2 * np.sin(np.pi / 2 / n) * (b**2 - a**2)


@pytest.mark.mpi
@pytest.mark.parametrize(("cell", "R"), [("tetrahedron", 10.0), ("hexahedron", 1e-3)])
def test_a_ball_in_its_socket(cell, R):
    """Areas by tag, volumes, and the point in which the spheres touch."""
    m = ball_in_socket(COMM, cell=cell, h=(R / 8, R / 10), radius=R, clearance=0.05 * R)
    volumes, areas = measures(m, 6)
    side = 2.5**2 - np.pi / 4 + np.pi / 4 * 0.95**2
    spheres = np.pi / 2, np.pi / 2 * 0.95**2
    expected = np.array([2.5**2, np.pi / 4 * 0.95**2, *spheres, side, side])
    assert areas == pytest.approx(R**2 * expected, rel=0.02)
    expected = np.array([2.5**3 - np.pi / 6, np.pi / 6 * 0.95**3])
    assert volumes == pytest.approx(R**3 * expected, rel=0.02)
    at = np.linalg.norm(m.mesh.geometry.x - [0.0, 0.0, -R], axis=1) < 1e-9 * R
    assert COMM.allreduce(int(at.sum())) >= 2  # a node of either body, also as a ghost


@pytest.mark.mpi
@pytest.mark.parametrize(("cell", "unit"), [("triangle", 1.0), ("quadrilateral", 1e-6)])
def test_rings(cell, unit):
    """Polygons in circles: second order in the angle, known exactly."""
    m = ring_section(COMM, unit * RADII, ((2, 10), (3, 14)), cell)
    areas, sides = measures(m, 6)
    walls = np.array([section(1.0, 1.5, 10), section(1.5, 2.5, 14)])
    assert areas == pytest.approx(unit**2 * walls, rel=1e-10)
    around = [chord(*at) for at in ((1.0, 10), (2.5, 14), (1.5, 10), (1.5, 14))]
    assert sides == pytest.approx(unit * np.array([*around, 1.5, 1.5]), rel=1e-10)


@pytest.mark.mpi
def test_the_section_of_tubes():
    unit = 1e-6
    bodies, sides = measures(
        tubes(COMM, tuple(unit * RADII), unit * LENGTH, ((6, 12), (7, 15))), 10
    )
    assert bodies == pytest.approx([0.5 * LENGTH * unit**2, LENGTH * unit**2], rel=1e-12)
    expected = unit * np.array([*[LENGTH] * 4, 0.0, 0.0, 0.5, 0.5, 1.0, 1.0])
    assert sides == pytest.approx(expected, rel=1e-12)


@pytest.mark.mpi
def test_a_quarter_of_tubes():
    """Prisms on polygons in circles, known exactly."""
    m = tubes(COMM, tuple(RADII), LENGTH, ((2, 3, 5), (3, 4, 7)))
    bodies, sides = measures(m, 10)
    walls = np.array([section(1.0, 1.5, 5), section(1.5, 2.5, 7)])
    assert bodies == pytest.approx(LENGTH * walls, rel=1e-10)
    curved = [LENGTH * chord(*at) for at in ((1.0, 5), (2.5, 7), (1.5, 5), (1.5, 7))]
    flat = [1.5 * LENGTH, 1.5 * LENGTH, *np.repeat(walls, 2)]
    assert sides == pytest.approx([*curved, *flat], rel=1e-10)

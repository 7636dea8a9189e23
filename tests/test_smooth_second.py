# SPDX-License-Identifier: MIT
"""Contact of second order on straight facets of curved sides: heights that strain, a warning."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from dolfinx_mortar.mortar.surface import create_surface, thickness_stretches
from tests.cases.close_fits import create_shrink_fit
from tests.cases.hertz import create_case
from tests.cases.meshes import TOP_OF_LOWER
from tests.cases.shells import to_arc, to_sphere
from tests.choice import quick
from tests.test_smooth_tie import CELLS, largest, sides

COMM = MPI.COMM_WORLD
SPIN = np.array([[0.8, -0.6, 0.0], [0.36, 0.48, -0.8], [0.48, 0.64, 0.6]])  # by 65 degrees


@pytest.mark.mpi
@pytest.mark.parametrize("cell", CELLS)
def test_stretch_along_the_normal(cell):
    """1 / |F^-T n| of a deformation with the gradient F, whatever it does in the plane."""
    mesh, tags = sides(COMM, cell, None)
    d = mesh.geometry.dim
    V = fem.functionspace(mesh, ("Lagrange", 2, (d,)))
    u, surface = fem.Function(V), create_surface(V, tags, TOP_OF_LOWER, "slave")
    F = np.eye(d) + 0.3 * np.sin(np.arange(d * d)).reshape(d, d)
    turned = SPIN[:d, :d] if d == 3 else np.array([[0.8, -0.6], [0.6, 0.8]])
    for gradient in (F, turned, turned @ F, 1.2 * np.eye(d)):
        u.interpolate(lambda x, G=gradient: (G - np.eye(d)) @ x[:d])
        expected = 1.0 / np.linalg.norm(np.linalg.inv(gradient).T[:, -1])
        assert largest(COMM, thickness_stretches(surface, u) - expected) < 1e-12


@pytest.mark.mpi
@pytest.mark.parametrize("geometry", ["updated", "reference"])
@pytest.mark.parametrize("cell", CELLS)
def test_heights_grow_with_the_bodies(cell, geometry):
    """A dilatation scales them, a rotation leaves them, and those at X are kept if held there."""
    mesh, tags = sides(COMM, cell, to_arc if cell in CELLS[:2] else to_sphere, n=2)
    d = mesh.geometry.dim
    u = fem.Function(fem.functionspace(mesh, ("Lagrange", 2, (d,))))
    contact = dm.Contact(tags, slave=3, master=4)
    problem = dm.ContactProblem(dm.Solid(u, dm.Elastic(1.0, 0.3)), [contact], geometry=geometry)
    turned = SPIN[:d, :d] if d == 3 else np.array([[0.8, -0.6], [0.6, 0.8]])
    found = []
    for gradient in (np.eye(d), 1.1 * np.eye(d), turned):
        u.interpolate(lambda x, G=gradient: (G - np.eye(d)) @ x[:d])
        problem.update_geometry()
        (link,) = problem.system.links
        found.append(link.coupling.heights.copy())
    at_X, grown, rotated = found
    size = largest(COMM, at_X)
    assert size > 1e-3
    assert largest(COMM, grown - (1.1 if geometry == "updated" else 1.0) * at_X) < 1e-10 * size
    assert largest(COMM, rotated - at_X) < 1e-10 * size


@pytest.mark.parametrize("swap", quick([False, True], True))
def test_pressures_of_second_order_converge(swap):
    """Uniform to 0.5 %; with the heights of X 2.8 and 1.6 %, of which finer meshes keep half."""
    case = create_shrink_fit((192, 144), swap, degree=2)
    dm.newton(case.problem)
    pressure = case.contact.gather(case.problem.u)["pressure"] / case.pressure
    assert np.ptp(pressure) < 5e-3 and abs(pressure.mean() - 1.0) < 0.01


def warned(problem):
    """Return the warnings of straight facets."""
    return [w for w in problem.audit().warnings if "straight facets stand for" in w]


@pytest.mark.mpi
@pytest.mark.parametrize("geometry", ["updated", "reference"])
@pytest.mark.parametrize(
    ("degree", "order", "surface", "said"),
    [
        (2, 1, "smooth", True),
        *((1, 1, "smooth", False), (2, 2, "smooth", False), (2, 1, "facets", False)),
    ],
)
def test_the_audit_warns_of_close_fits(degree, order, surface, said, geometry):
    """On coarse meshes their pressures of degree 2 are far off; facets have a warning of theirs."""
    case = create_shrink_fit(
        (48, 36), False, degree=degree, order=order, surface=surface, geometry=geometry
    )
    found = warned(case.problem)
    assert len(found) == said and all("curved sides that fit closely" in w for w in found)


def test_sides_that_part_are_not_warned_of():
    """A disc on a plane, of degree 2 on straight cells: the gap soon outgrows the heights."""
    mesh = dm.meshing.hertz(COMM, h=(0.5, 0.6))
    case = create_case(mesh, dm.Elastic(1000.0, 0.3), degree=2)
    assert warned(case.problem) == []

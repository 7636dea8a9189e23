# SPDX-License-Identifier: MIT
"""Closely fitting sides in 3D: a ball in its socket, a pin in a lug, on any mesh and slave."""

import itertools

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem, mesh
from dolfinx_mortar.mortar import curvature_correction as smooth
from dolfinx_mortar.mortar.mirrors import judge_supports
from dolfinx_mortar.mortar.surface import create_surface
from tests.cases.ball import create_problem
from tests.choice import crosswise

CELLS = ["tetrahedron", "hexahedron"]


def uneven_cylinder(h):
    """Return the side of half a cylinder on the plane x = 0, its facets about h long."""
    n = int(np.ceil(np.pi / h))
    m = mesh.create_box(MPI.COMM_WORLD, [(0, 0, 0), (1, 1, 1)], (1, n, n // 4))
    r, t, z = m.geometry.x.T.copy()
    side = mesh.locate_entities_boundary(m, 2, lambda x: np.isclose(x[0], 1.0))
    wave = np.sin(np.pi * t) / n
    t, z = t + 0.2 * wave * np.sin(9 * n * t + 7 * z), z + 0.2 * wave * np.cos(5 * n * t + 8 * z)
    angle, r = np.pi * (t - 0.5), 0.7 + 0.3 * r
    m.geometry.x[:] = np.column_stack([r * np.cos(angle), r * np.sin(angle), 0.8 * z])
    tags = mesh.meshtags(m, 2, np.sort(side), np.full(len(side), 3, dtype=np.int32))
    return create_surface(fem.functionspace(m, ("Lagrange", 1, (3,))), tags, 3, "slave")


@pytest.mark.mpi
def test_normals_of_a_cylinder_on_uneven_triangles(monkeypatch):
    """Third order in the size of facets, instead of the sums' first."""
    error = {}
    for h in (0.1, 0.05):
        surface = uneven_cylinder(h)
        fixed = np.abs(surface.X) < 1e-9
        fixed[:, 1] = False
        exact = surface.X * [1.0, 1.0, 0.0]
        for count in (0, smooth.PROJECTIONS, 2 * smooth.PROJECTIONS):
            monkeypatch.setattr(smooth, "PROJECTIONS", count)
            found = smooth.smooth_normals(surface, surface.X, fixed, 40.0)
            monkeypatch.undo()
            square = ((found.n - exact)[found.regular] ** 2).sum()
            regular = MPI.COMM_WORLD.allreduce(found.regular.sum())
            error[h, count] = np.sqrt(MPI.COMM_WORLD.allreduce(square) / regular)
    assert error[0.05, 2] < 0.02 * error[0.05, 0]
    assert error[0.1, 2] > 4.0 * error[0.05, 2]
    assert error[0.05, 4] > 0.7 * error[0.05, 2]


# -- supports at the ends of sides -----------------------------------------------------------------


def round_side(along, across, oblique=0.0, slope=0.0):
    """Return the points at s and c (n,), of a torus or a sphere, cylinder, cone or plane."""
    start, rise = np.radians(oblique), np.tan(np.radians(slope))

    def points(s, c):
        x = np.sin(start + along * s) - np.sin(start) if along else s
        radius = (np.cos(start + along * s) if along else 1.0) + rise * s
        turn = across * (c - 0.5)
        y = radius * np.sin(turn) if across else c
        return np.column_stack([x, y, radius * np.cos(turn)])

    return points


SIDES = {
    "sphere": (round_side(1.2, 1.2), True),
    "cylinder, curved towards the support": (round_side(1.2, 0.0), True),
    "cylinder, straight towards the support": (round_side(0.0, 1.2), True),
    "level plane": (round_side(0.0, 0.0), True),
    "cone of 3 degrees": (round_side(0.0, 1.2, slope=3.0), False),
    "cone of -3 degrees": (round_side(0.0, 1.2, slope=-3.0), False),
    "plane at 1 degree": (round_side(0.0, 0.0, slope=1.0), False),
    "plane at -60 degrees": (round_side(0.0, 0.0, slope=-60.0), False),
    "arc at 15 degrees": (round_side(1.2, 0.0, oblique=15.0), False),
    "barrel at 15 degrees": (round_side(1.2, 1.2, oblique=-15.0), False),
}


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("name", "cell", "degree"), crosswise([*SIDES], [*itertools.product(CELLS, (1, 2))])
)
def test_the_curvature_tells_mirrors_from_other_supports(name, cell, degree):
    """All nodes on the support alike, on uneven facets, also where it meets the free rim."""
    points, mirror = SIDES[name]
    m = mesh.create_box(MPI.COMM_WORLD, [(0, 0, 0), (1, 1, 1)], (6, 8, 1), mesh.CellType[cell])
    m.topology.create_connectivity(2, 3)
    top = mesh.locate_entities_boundary(m, 2, lambda x: np.isclose(x[2], 1.0))
    s, c, depth = m.geometry.x.T.copy()
    wave = 0.2 * np.sin(np.pi * s) * np.sin(np.pi * c)
    s, c = s + wave * np.sin(40 * c + 9 * s) / 6, c + wave * np.cos(30 * s + 7 * c) / 8
    m.geometry.x[:] = points(s, c) - 0.3 * (1 - depth)[:, None] * [0.0, 0.0, 1.0]
    tags = mesh.meshtags(m, 2, np.sort(top), np.full(len(top), 3, dtype=np.int32))
    surface = create_surface(fem.functionspace(m, ("Lagrange", degree, (3,))), tags, 3, "slave")
    fixed = np.zeros(surface.X.shape, dtype=bool)
    fixed[np.abs(surface.X[:, 0]) < 1e-9, 0] = True
    assert MPI.COMM_WORLD.allreduce(int(fixed[: surface.owned].sum())) == 8 * degree + 1
    assert np.array_equal(judge_supports(surface, fixed, 40.0)[0], fixed & mirror)
    assert not judge_supports(surface, fixed[:, :1].repeat(3, axis=1), 40.0)[0].any()


def press(half, **options):
    """Press a quarter of a ball or half of it on a block; return twice, or once, the force."""
    problem, contact = create_problem(h=1.0, half=half, **options)
    dm.newton(problem, rtol=1e-10)
    pressure = contact.gather(problem.u)["pressure"].max()
    return (1 if half else 2) * abs(contact.force[2]), pressure


@pytest.mark.parametrize("slave", ["ball", "block"])
@pytest.mark.parametrize(("cell", "degree"), [("tetrahedron", 2), ("hexahedron", 1)])
def test_half_of_a_model_is_as_the_whole(cell, degree, slave):
    """On a plane of symmetry normals are those of the whole: of both sides, and between nodes."""
    part, whole = (press(half, cell=cell, degree=degree, slave=slave) for half in (False, True))
    assert part == pytest.approx(whole, rel=1e-9)

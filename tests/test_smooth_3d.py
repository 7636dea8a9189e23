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


def uneven_side(points, n, cell="tetrahedron", degree=1):
    """Return the side at points(s, c), 0 <= s, c <= 1, of n uneven facets along each."""
    m = mesh.create_box(MPI.COMM_WORLD, [(0, 0, 0), (1, 1, 1)], (*n, 1), mesh.CellType[cell])
    m.topology.create_connectivity(2, 3)
    top = mesh.locate_entities_boundary(m, 2, lambda x: np.isclose(x[2], 1.0))
    s, c, depth = m.geometry.x.T.copy()
    wave = 0.2 * np.sin(np.pi * s) * np.sin(np.pi * c)
    shift = np.sin(5 * n[1] * c + 9 * s) / n[0], np.cos(5 * n[0] * s + 7 * c) / n[1]
    s, c = s + wave * shift[0], c + wave * shift[1]
    m.geometry.x[:] = points(s, c) - 0.3 * (1 - depth)[:, None] * [0.0, 0.0, 1.0]
    tags = mesh.meshtags(m, 2, np.sort(top), np.full(len(top), 3, dtype=np.int32))
    return create_surface(fem.functionspace(m, ("Lagrange", degree, (3,))), tags, 3, "slave")


@pytest.mark.mpi
def test_normals_of_a_cylinder_on_uneven_triangles(monkeypatch):
    """Third order in the size of facets, instead of the sums' first."""
    error = {}
    for n in (12, 24):
        surface = uneven_side(round_side(0.0, 1.2), (n, n))
        none, exact = np.zeros(surface.X.shape, dtype=bool), surface.X * [0.0, 1.0, 1.0]
        for count in (0, smooth.PROJECTIONS, 2 * smooth.PROJECTIONS):
            monkeypatch.setattr(smooth, "PROJECTIONS", count)
            found = smooth.smooth_normals(surface, surface.X, none, 40.0)
            monkeypatch.undo()
            square = ((found.n - exact)[found.regular] ** 2).sum()
            regular = MPI.COMM_WORLD.allreduce(found.regular.sum())
            error[n, count] = np.sqrt(MPI.COMM_WORLD.allreduce(square) / regular)
    assert error[24, 2] < 0.02 * error[24, 0]
    assert error[12, 2] > 4.0 * error[24, 2]
    assert error[24, 4] > 0.7 * error[24, 2]


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
    surface = uneven_side(points, (6, 8), cell, degree)
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

# SPDX-License-Identifier: MIT
"""The Hertz meshes: sizes of tagged parts, symmetry, separation of the bodies, shapes of cells."""

from mpi4py import MPI

import numpy as np
import pytest
from scipy.spatial import cKDTree

import ufl
from dolfinx import fem, mesh
from dolfinx_mortar import meshing
from dolfinx_mortar.common import compat
from dolfinx_mortar.meshing import two_bodies
from tests.cases.integrals import integral, sizes

COMM = MPI.COMM_WORLD
CELLS = ["triangle", "quadrilateral"]
SOLID = ["hexahedron", "tetrahedron"]
OPTIONS = {"kind": "graded", "h": 0.3, "radius": 6.0, "block": (20.0, 8.0), "gap": 0.25}


def measures(m, tags):
    """Return areas or lengths of sides, and the integrals (sides, d) of their outward normals."""
    n = ufl.FacetNormal(m.mesh)
    ds = ufl.Measure("ds", m.mesh, subdomain_data=m.facet_tags)
    flux = [[integral(n[i] * ds(t)) for i in range(m.mesh.geometry.dim)] for t in tags]
    return np.array([*sizes(m.mesh, m.facet_tags, "ds", tags).values()]), np.array(flux)


def volumes(m):
    """Return areas or volumes of block and round body."""
    return [*sizes(m.mesh, m.cell_tags, "dx", (1, 2)).values()]


def count(m):
    """Return how many facets of all ranks have each tag; another mesh may be split otherwise."""
    tags = m.facet_tags
    owned = tags.values[tags.indices < tags.topology.index_map(tags.dim).size_local]
    return COMM.allreduce(np.bincount(owned, minlength=7))


@pytest.mark.parametrize(
    ("kind", "cell", "radius", "block", "gap"),
    [
        ("paper", "triangle", 6.0, (20.0, 8.0), 0.25),
        ("graded", "quadrilateral", 6.0, (20.0, 8.0), 0.25),
        # no gap and no size swallows a tag
        ("paper", "triangle", 8.0, (30.0, 10.0), -7.99),
        ("paper", "triangle", 1e-7, (30.0, 10.0), 0.0),  # round-off of a common scale
        ("paper", "triangle", 8e-6, (30e-6, 10e-6), 1e-7),
    ],
)
def test_areas_lengths_and_flux_of_tagged_parts(kind, cell, radius, block, gap):
    h = 0.3 if radius == 6.0 else None
    options = {"kind": kind, "cell": cell, "radius": radius, "block": block, "gap": gap}
    m = meshing.hertz(COMM, **options | ({"h": h} if h else {}))
    sizes, flux = measures(m, (1, 2, 3, 4))
    width, diameter = block[0], 2 * radius
    assert sizes[:3] == pytest.approx([width, diameter, width], rel=1e-9)
    assert sizes[3] == pytest.approx(np.pi * radius, rel=1e-2)
    assert flux[:, 1] == pytest.approx([-width, diameter, width, -diameter], rel=1e-9)
    assert volumes(m) == pytest.approx([block[0] * block[1], np.pi * radius**2 / 2], rel=2e-2)


@pytest.mark.parametrize("cell", SOLID)
@pytest.mark.parametrize(
    ("radius", "block", "gap"),
    [
        (6.0, (24.0, 20.0, 8.0), 0.25),
        (8.0, (30.0, 30.0, 10.0), -7.99),
        (8e-3, (30e-3, 30e-3, 10e-3), 1e-4),
    ],
)
def test_volumes_areas_and_flux_of_the_quarter(cell, radius, block, gap):
    m = meshing.sphere(COMM, cell=cell, h=radius / 24, radius=radius, block=block, gap=gap)
    sizes, flux = measures(m, range(1, 7))
    (a, b, c), circle = block, np.pi * radius**2 / 4
    expected = [a * b / 4, circle, a * b / 4, 2 * circle, b * c / 2 + circle, a * c / 2 + circle]
    assert sizes == pytest.approx(expected, rel=3e-2)
    assert sizes[0] == pytest.approx(a * b / 4, rel=1e-9)
    expected = [-sizes[0], sizes[1], sizes[2], -sizes[1], 0.0, 0.0]
    assert flux[:, 2] == pytest.approx(expected, abs=1e-9 * a**2)
    assert [flux[4, 0], flux[5, 1]] == pytest.approx(-sizes[4:], rel=1e-9)
    assert volumes(m) == pytest.approx([a * b * c / 4, np.pi * radius**3 / 6], rel=4e-2)


def test_paper_counts():
    m = meshing.hertz(COMM)
    owned = m.mesh.topology.index_map(2).size_local
    block, disc = (COMM.allreduce(int(np.sum(m.cell_tags.values[:owned] == tag))) for tag in (1, 2))
    assert block == 2720
    assert disc == pytest.approx(1200, rel=0.02)


def points_and_cells(m):
    V = fem.functionspace(m.mesh, ("Lagrange", 1))
    return V.tabulate_dof_coordinates()[:, : m.mesh.geometry.dim], V.dofmap.list


@pytest.mark.parametrize(
    ("make", "options"),
    [
        *((meshing.hertz, {"kind": "graded", "h": 0.2, "gap": gap}) for gap in (0.0, -0.05)),
        *((meshing.sphere, {"h": 0.25, "cell": cell}) for cell in SOLID),
    ],
)
def test_both_bodies_have_a_node_of_their_own_at_the_contact_point(make, options):
    V = fem.functionspace(make(COMM, **options).mesh, ("Lagrange", 1))
    x, up = V.tabulate_dof_coordinates()[: V.dofmap.index_map.size_local], V.mesh.geometry.dim - 1
    places, counts = np.unique([0.0, options.get("gap", 0.0)], return_counts=True)
    for place, count in zip(places, counts, strict=True):
        here = np.abs(x - place * np.eye(3)[up]).max(axis=1) < 1e-12
        assert COMM.allreduce(int(here.sum())) == count


@pytest.mark.parametrize("cell", CELLS)
def test_halves_and_images(cell):
    """The disc is symmetric, its half is half of it."""
    whole, half = (
        meshing.hertz(MPI.COMM_SELF, half=k, cell=cell, **OPTIONS) for k in (False, True)
    )
    (x, all_cells), (y, cells) = points_and_cells(whole), points_and_cells(half)
    for points in (x, x[all_cells].mean(axis=1)):
        distance, image = cKDTree(points).query(points * [-1.0, 1.0])
        assert distance.max() < 1e-12
        assert np.array_equal(np.sort(image), np.arange(len(points)))
    sizes, _ = measures(half, (1, 2, 3, 5))
    assert sizes == pytest.approx([10.0, 6.0, 10.0, 14.0], rel=1e-12)
    assert cKDTree(x).query(y)[0].max() < 1e-12 and 2 * len(cells) == len(all_cells)


@pytest.mark.parametrize(("cell", "limit"), [("triangle", 10.0), ("quadrilateral", 4.0)])
def test_graded_sizes(cell, limit):
    h = 0.1
    m = meshing.hertz(MPI.COMM_SELF, kind="graded", h=h, cell=cell, limit=limit)
    m.mesh.topology.create_entities(1)
    edges = np.arange(m.mesh.topology.index_map(1).size_local, dtype=np.int32)
    ends = m.mesh.geometry.x[mesh.entities_to_geometry(m.mesh, 1, edges)]
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    r = np.linalg.norm(ends.mean(axis=1), axis=1)
    size = h * np.clip(1 + r - 2.5, 1.0, limit)
    assert np.median(length / size) == pytest.approx(1.0, abs=0.1)


def test_hexahedra_are_nearly_cubes_everywhere():
    """Volume of a cell over the cube of its longest edge; the sphere's nodes are on it."""
    m = meshing.sphere(COMM, h=0.25)
    owned = m.mesh.topology.index_map(3).size_local
    x = m.mesh.geometry.x[compat.cell_nodes(m.mesh)[:owned]]
    edges = np.stack([x[:, 1] - x[:, 0], x[:, 2] - x[:, 0], x[:, 4] - x[:, 0]], axis=1)
    lengths = np.linalg.norm(edges, axis=2)
    shape = np.abs(np.linalg.det(edges)) / lengths.max(axis=1) ** 3
    assert shape.min(initial=1.0) > 0.1
    facets = m.facet_tags.find("sphere")
    on = m.mesh.geometry.x[mesh.entities_to_geometry(m.mesh, 2, facets)] if len(facets) else [[8]]
    assert np.linalg.norm(np.array(on) - [0, 0, 8], axis=-1) == pytest.approx(8.0, abs=1e-9)


@pytest.mark.serial
def test_a_running_gmsh_is_left_as_it_was(monkeypatch):
    """Its options and its current model, also if the meshing fails; nothing of theirs is used."""
    import gmsh

    alone = meshing.hertz(COMM, kind="graded", h=0.6, cell="quadrilateral").mesh.geometry.x
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    try:
        theirs = {"Mesh.MeshSizeMax": 0.3, "Mesh.Algorithm": 5.0, "General.Terminal": 0.0}
        theirs |= {"Mesh.Algorithm3D": 4.0, "Mesh.MeshSizeFromCurvature": 12.0}
        for name, value in theirs.items():
            gmsh.option.setNumber(name, value)
        gmsh.model.add("theirs")
        for cell in ("quadrilateral", "triangle"):
            found = meshing.hertz(COMM, kind="graded", h=0.6, cell=cell).mesh.geometry.x
            assert cell == "triangle" or np.array_equal(found, alone)
        meshing.sphere(COMM, h=1.0, cell="tetrahedron")
        monkeypatch.setattr(gmsh.model.mesh, "generate", lambda _: 1 / 0)
        with pytest.raises(RuntimeError, match="gmsh failed"):
            meshing.hertz(COMM, kind="graded", h=0.6)
        assert gmsh.model.getCurrent() == "theirs" and len(gmsh.model.list()) == 2  # and an empty
        assert {name: gmsh.option.getNumber(name) for name in theirs} == theirs
    finally:
        gmsh.finalize()


def test_meshing_is_deterministic_and_silent(capfd):
    first, second = (meshing.hertz(MPI.COMM_SELF, kind="graded", h=0.3) for _ in range(2))
    assert np.array_equal(first.mesh.geometry.x, second.mesh.geometry.x)
    captured = capfd.readouterr()
    assert (captured.out, captured.err) == ("", "")


PLANE = [  # the first name is that of the error
    {"kind": "fine"},
    {"cell": "tetrahedron"},
    *({"h": value} for value in (0.0, (0.1, 0.2, 0.3))),
    {"h": 5.0, "kind": "graded"},
    {"radius": -8.0},
    {"block": (30.0, 30.0, 10.0)},
    {"limit": 1.0},
    {"core": 0.0},
    {"gap": np.inf},
    {"gap": -8.0},  # the block reaches the flat face
    {"gap": -2.5, "block": (30.0, 2.5)},  # the disc reaches the bottom
]
SPACE = [
    {"cell": "prism"},
    *({"h": value} for value in (0.0, 2.0)),
    {"radius": -1.0},
    {"block": (30.0, 10.0)},
    {"gap": -8.0},
    {"core": 20.0},
    {"h": 0.2, "core": 0.1},
]


@pytest.mark.parametrize(
    ("make", "arguments"),
    [*((meshing.hertz, case) for case in PLANE), *((meshing.sphere, case) for case in SPACE)],
)
def test_bad_input_is_named_on_all_ranks(make, arguments, monkeypatch):
    monkeypatch.setattr(two_bodies, "distribute", pytest.fail)
    with pytest.raises(ValueError, match=f"^{next(iter(arguments))} is "):
        make(COMM, **arguments)


@pytest.mark.mpi
def test_bad_input_of_one_rank_is_an_error_on_all():
    last = COMM.rank == COMM.size - 1
    with pytest.raises(ValueError, match=r"^gap is nan"):
        meshing.hertz(COMM, gap=np.nan if last else 0.0)
    if COMM.size > 1:
        with pytest.raises(ValueError, match=r"^radius differs between the ranks: 8.0 on rank 0"):
            meshing.hertz(COMM, radius=9.0 if last else 8.0)


@pytest.mark.parametrize("factor", [0.0, 0.5, 2.0, 1e8])
def test_tags_do_not_hang_on_a_tolerance(factor, monkeypatch):
    """Half and twice as much change nothing; none at all, or the size of a body, does."""
    options = {"gap": 0.1} if factor < 3.0 else {"h": 1.0, "core": 2.0}
    make = meshing.hertz if factor < 3.0 else meshing.sphere  # which has nothing to mirror
    before = count(make(COMM, **options))
    monkeypatch.setattr(two_bodies, "HALF_OF_DIGITS", factor * two_bodies.HALF_OF_DIGITS)
    after = count(make(COMM, **options))
    assert np.array_equal(before, after) == (factor in (0.5, 2.0))

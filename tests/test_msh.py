"""Meshes from files of Gmsh: bodies and sides by their names, and files that are refused."""

import sys

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx_mortar.common.compat import cell_degree
from tests.cases.integrals import integral, sizes
from tests.cases.msh_files import boxes, folder, msh_file, squares
from tests.cases.pressed_blocks import rejected

COMM = MPI.COMM_WORLD
pytest.importorskip("gmsh")


@pytest.mark.mpi
@pytest.mark.parametrize(
    "options",
    [
        {"ElementOrder": 2, "Binary": 1},
        {"RecombineAll": 1, "ElementOrder": 2, "MshFileVersion": 2.2, "Binary": 1},
    ],
)
def test_bodies_and_sides_in_the_plane_have_their_names(options):
    with msh_file(squares, **options) as file:
        mesh, cell_tags, facet_tags = dm.meshing.read_msh(file, COMM)
    assert mesh.geometry.dim == mesh.topology.dim == 2
    assert cell_degree(mesh) == options.get("ElementOrder", 1)
    cell = "quadrilateral" if "RecombineAll" in options else "triangle"
    assert mesh.topology.cell_name() == cell
    assert cell_tags.names == {"low": 11, "up": 12}
    assert facet_tags.names == {"bottom": 3, "slave": 5, "master": 7}
    assert sizes(mesh, cell_tags, "dx") == pytest.approx({"low": 1.5, "up": 1.0})
    lengths = {"bottom": 1.5, "slave": 1.0, "master": 1.5}
    assert sizes(mesh, facet_tags, "ds") == pytest.approx(lengths)
    assert COMM.allreduce(len(facet_tags.find(9))) > 0
    assert (facet_tags.find("slave") == facet_tags.find(5)).all()


@pytest.mark.mpi
@pytest.mark.parametrize(("order", "hexahedra"), [(1, False), (2, True)])
def test_bodies_in_space(order, hexahedra):
    recombine = {"RecombineAll": 1, "Recombine3DAll": 1} if hexahedra else {}
    with msh_file(lambda m: boxes(m, hexahedra=hexahedra), ElementOrder=order, **recombine) as file:
        mesh, cell_tags, facet_tags = dm.meshing.read_msh(str(file))
    assert mesh.topology.cell_name() == ("hexahedron" if hexahedra else "tetrahedron")
    assert cell_degree(mesh) == order
    assert sizes(mesh, cell_tags, "dx") == pytest.approx({"ball": 1.0, "plate": 1.0})
    assert sizes(mesh, facet_tags, "ds") == pytest.approx({"ball": 1.0, "between": 2.0})


def bent(model):
    """Mesh boxes by bricks, and move their nodes by x -> x + y^2/4 + y z/2."""
    model.mesh.clear()
    model.mesh.setTransfiniteAutomatic()
    for _, curve in model.getEntities(1):
        model.mesh.setTransfiniteCurve(curve, 3)
    model.mesh.generate(model.getDimension())
    tags, x, _ = model.mesh.getNodes()
    for tag, (a, y, z) in zip(tags, x.reshape(-1, 3), strict=True):
        model.mesh.setNode(tag, [a + y * y / 4 + y * z / 2, y, z], [])


@pytest.mark.mpi
@pytest.mark.parametrize(("bodies", "nodes"), [(squares, 2 * 5**2), (boxes, 2 * 5**3)])
def test_cells_without_nodes_at_their_middles_get_them(bodies, nodes):
    """All polynomials of degree 2 are among their shape functions: a bent grid is one again."""
    options = {"RecombineAll": 1, "Recombine3DAll": 1, "ElementOrder": 2}
    with msh_file(
        lambda model: [bodies(model), bent(model)], SecondOrderIncomplete=1, **options
    ) as file:
        mesh, cell_tags, facet_tags = dm.meshing.read_msh(file)
    assert cell_degree(mesh) == 2 and mesh.geometry.index_map().size_global == nodes
    x, y, z = mesh.geometry.x.T
    grid = 8.0 * np.array([x - y**2 / 4 - y * z / 2, y, z])
    assert grid == pytest.approx(np.round(grid), abs=1e-12)
    volume = {"low": 1.5, "up": 1.0} if bodies is squares else {"ball": 1.0, "plate": 1.0}
    assert sizes(mesh, cell_tags, "dx") == pytest.approx(volume, rel=1e-12)
    n, d = ufl.FacetNormal(mesh), mesh.geometry.dim - 1
    ds = ufl.Measure("ds", mesh, subdomain_data=facet_tags)
    below = {"bottom": 1.5} if bodies is squares else {"ball": 1.0}
    for name, size in below.items():
        assert integral(n[d] * ds(facet_tags.tag(name))) == pytest.approx(-size, rel=1e-12)


@pytest.mark.mpi
def test_groups_of_one_name_are_one():
    """Gmsh gives a name once, and leaves the other group without one, which is told."""
    with msh_file(squares) as file:
        if COMM.rank == 0:
            text = file.read_text()
            for old, new in (('2 12 "up"', '2 12 "low"'), ('1 7 "master"', '1 7 "slave"')):
                text = text.replace(old, new)
            file.write_text(text)
        COMM.Barrier()
        mesh, cell_tags, facet_tags = dm.meshing.read_msh(file)
    assert sizes(mesh, cell_tags, "dx") == pytest.approx({"low": 2.5})
    assert facet_tags.names == {"bottom": 3, "slave": 5}
    assert sizes(mesh, facet_tags, "ds") == pytest.approx({"bottom": 1.5, "slave": 2.5})


def test_a_group_that_has_lost_its_name_is_told(caplog):
    def draw(model):
        squares(model)
        model.addPhysicalGroup(1, [8], 41, "bottom")

    with msh_file(draw) as file:
        facet_tags = dm.meshing.read_msh(file).facet_tags
    assert COMM.allreduce(len(facet_tags.find(41))) > 0
    if COMM.rank == 0:
        assert "without a name, of dimension 1: 9, 41" in caplog.text


def cut(model):
    """Draw the squares, in partitions."""
    squares(model)
    model.mesh.partition(2)


@pytest.mark.mpi
@pytest.mark.parametrize("version", [2.2, 4.1])
def test_partitions_of_a_file_are_left_out(version):
    options = {"MshFileVersion": version, "PartitionCreateGhostCells": 1}
    with msh_file(squares) as file:
        whole = dm.meshing.read_msh(file)
    with msh_file(cut, **options) as file:
        mesh, cell_tags, facet_tags = dm.meshing.read_msh(file)
    for d in (0, 2):
        counts = [m.topology.index_map(d).size_global for m in (mesh, whole.mesh)]
        assert counts[0] == counts[1] > 0
    assert sizes(mesh, cell_tags, "dx") == pytest.approx({"low": 1.5, "up": 1.0})
    lengths = {"bottom": 1.5, "slave": 1.0, "master": 1.5}
    assert sizes(mesh, facet_tags, "ds") == pytest.approx(lengths)


MESHIO = """$MeshFormat
2.2 0 8
$EndMeshFormat
$PhysicalNames
4
1 3 "right of a"
1 4 "left of b"
2 1 "a"
2 2 "b"
$EndPhysicalNames
$Nodes
8
1 0 0 0
2 1 0 0
3 1 1 0
4 0 1 0
5 2 0 0
6 4 0 0
7 4 1 0
8 2 1 0
$EndNodes
$Elements
4
1 3 2 1 0 1 2 3 4
2 3 2 2 0 5 6 7 8
3 1 2 3 0 2 3
4 1 2 4 0 5 8
$EndElements
"""


@pytest.mark.mpi
def test_version_2_without_tags_of_geometry():
    """As meshio writes it, with 0 for the elementary tags."""
    with folder() as there:
        file = there / "case.msh"
        if COMM.rank == 0:
            file.write_text(MESHIO)
        COMM.Barrier()
        mesh, cell_tags, facet_tags = dm.meshing.read_msh(file)
    assert (cell_tags.names, facet_tags.names) == (
        {"a": 1, "b": 2},
        {"right of a": 3, "left of b": 4},
    )
    assert sizes(mesh, cell_tags, "dx") == pytest.approx({"a": 1.0, "b": 2.0})
    assert sizes(mesh, facet_tags, "ds") == pytest.approx({"right of a": 1.0, "left of b": 1.0})


# -- files that are refused


@pytest.mark.mpi
def test_files_and_arguments_that_are_none():
    with folder() as there:
        geo, cut = there / "case.geo", there / "cut.msh"
        if COMM.rank == 0:
            geo.write_text("Point(1) = {0, 0, 0};")
            cut.write_text("$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n1 5 1 5\n2 1")
        COMM.Barrier()
        for path, error, words in (
            (there / "no.msh", OSError, r"no\.msh.* no such file"),
            (there, OSError, "no such file"),
            (geo, ValueError, r"case\.geo.* no mesh of Gmsh.*gmsh -3"),
            (cut, ValueError, r"cut\.msh.* damaged: gmsh says"),
            (None, ValueError, "path is None: give the name of a file"),
        ):
            with pytest.raises(error, match=words):
                dm.meshing.read_msh(path)
    with pytest.raises(ValueError, match="comm is None: give a communicator"):
        dm.meshing.read_msh("case.msh", None)


def changed(*without, base=squares, **groups):
    """Return what draws a model without some groups, with others: name=(dimension, entities)."""

    def draw(model):
        base(model)
        if without:  # none would be all of them
            model.removePhysicalGroups(list(without))
        for tag, (name, (dim, entities)) in enumerate(groups.items(), 31):
            model.addPhysicalGroup(dim, entities, tag, name)

    return draw


def one(add, dim=2, group=(), mesh=2):
    """Return what draws and meshes one entity, in a group or in none."""

    def draw(model):
        add(model.occ)
        model.occ.synchronize()
        for name in group:
            model.addPhysicalGroup(dim, [1], 1, name)
        model.mesh.generate(mesh)

    return draw


def rectangle(occ):
    occ.addRectangle(0, 0, 0, 1, 1)


def box(occ):
    occ.addBox(0, 0, 0, 1, 1, 1)


def line(occ):
    occ.addLine(occ.addPoint(0, 0, 0), occ.addPoint(1, 0, 0))


def section(model):
    """Draw boxes and a plane beside them."""
    boxes(model)
    plane = model.occ.addRectangle(2.0, 0.0, 0.0, 1.0, 1.0)
    model.occ.synchronize()
    model.addPhysicalGroup(2, [plane], 9, "plane")
    model.mesh.clear()
    model.mesh.generate(3)


def mixed(model):
    for x in (0.0, 2.0):
        model.occ.addRectangle(x, 0, 0, 1, 1)
    model.occ.synchronize()
    model.mesh.setRecombine(2, 1)
    model.mesh.setTransfiniteSurface(1)
    model.addPhysicalGroup(2, [1, 2], 1, "bodies")
    model.mesh.generate(2)


def hollow(model):
    """Draw the squares, and a group of an entity without elements."""
    squares(model)
    model.addDiscreteEntity(1, 99)
    model.addPhysicalGroup(1, [99], 21, "nothing")


def doubled(model):
    squares(model)
    nodes = model.mesh.getElements(2, 1)[2][0]
    model.addDiscreteEntity(2, 50)
    model.mesh.addElementsByType(50, 2, [], nodes)
    model.removePhysicalGroups([(2, 11)])
    model.addPhysicalGroup(2, [1, 50], 11, "low")


LOOSE = "are no facets of a body"  # at which dolfinx ends the process
REFUSED = [
    (changed((2, 12), (1, 9)), {}, LOOSE, "4 of the 4", "'slave'", "give it a physical surface"),
    (section, {}, LOOSE, "'plane'", "dimension 2", "physical volume", "out of the groups"),
    (one(rectangle), {}, "no physical groups", "addPhysicalGroup"),
    (hollow, {}, "'nothing'", "empty", "dimension 1"),
    (one(box, 3, ["ball"]), {}, "'ball'", "empty", "gmsh -3"),
    (mixed, {}, "mixes cells", "Quad", "Triangle"),
    (squares, {"ElementOrder": 3}, "Triangle 10", "not supported"),
    (one(line, 1, ["bar"], 1), {}, "dimension 1", "physical surface or volume"),
    *(
        (changed(all=group), {"MshFileVersion": version}, f"'{first}' and 'all'", "do not fragment")
        for version, group, first in ((2.2, (2, [1]), "low"), (4.1, (1, [5]), "slave"))
    ),
    (doubled, {}, "'low' are in the file twice"),
    (changed((2, 12)), {"SaveAll": 1}, "cells of dimension 2 are in no physical group"),
    (changed((3, 1), (3, 2), base=boxes), {}, "plane z = 0", "physical volumes"),
    (lambda model: squares(model, z=0.5), {}, "plane z = 0", "z from 0.5 to 0.5"),
]


@pytest.mark.mpi
@pytest.mark.parametrize("case", REFUSED)
def test_what_is_refused(case):
    draw, options, *words = case
    with msh_file(draw, **options) as file, rejected("case.msh", *words):
        dm.meshing.read_msh(file, COMM)


@pytest.mark.serial
def test_without_gmsh_the_error_names_the_extra(monkeypatch):
    with msh_file(squares) as file:
        monkeypatch.setitem(sys.modules, "gmsh", None)
        with pytest.raises(RuntimeError, match=r"gmsh is not installed.*dolfinx_mortar\[demo\]"):
            dm.meshing.read_msh(file)

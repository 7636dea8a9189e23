# SPDX-License-Identifier: MIT
"""Decks of Abaqus and CalculiX: cells, sets, surfaces, laws and interfaces, and their errors."""

import re

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from dolfinx_mortar.meshing.deck import CELLS, TYPES
from tests.cases import msh_files
from tests.cases.integrals import integral, sizes
from tests.cases.pressed_blocks import rejected

COMM = MPI.COMM_WORLD
CORNERS = {  # of S1, S2 .., as Abaqus' and CalculiX's manuals have them
    "triangle": "12 23 31",
    "quadrilateral": "12 23 34 41",
    "tetrahedron": "123 142 243 341",
    "hexahedron": "1234 5876 1562 2673 3784 4851",
}
MIDDLES = {  # corners between which further nodes are
    "triangle": "12 23 31",
    "quadrilateral": "12 23 34 41",
    "tetrahedron": "12 23 31 14 24 34",
    "hexahedron": "12 23 34 41 56 67 78 85 15 26 37 48",
}
SIZES = {"triangle": 0.5, "quadrilateral": 1.0, "tetrahedron": 1 / 6, "hexahedron": 1.0}


def deck_of(kind, bulge=0.0):
    """One reference cell as a deck; its middles of edges are moved by x -> x + bulge x^2."""
    known = TYPES[kind]
    element, order = known.nodes()
    x = element.basix_element.points[np.argsort(order)][: known.size]
    x[:, 0] += bulge * x[:, 0] ** 2
    nodes = "\n".join(f"{i}, {', '.join(map(str, at))}" for i, at in enumerate(x, 10))
    numbers = ", ".join(str(i) for i in range(10, 10 + known.size))
    return f"*NODE\n{nodes}\n*ELEMENT, TYPE={kind}RH, ELSET=E\n7, {numbers}\n"


def read(text, **more):
    """Read a deck from its text, and texts of included files."""
    with msh_files.folder() as place:
        if COMM.rank == 0:
            for name, content in {"deck": text, **more}.items():
                (place / f"{name}.inp").write_text(content)
        COMM.Barrier()
        return dm.meshing.read_inp(place / "deck.inp")


@pytest.mark.mpi
@pytest.mark.parametrize("kind", [kind for kind in TYPES if kind[:3] in ("C3D", "CPE")])
def test_volume_and_facets_of_a_cell(kind):
    """Int dx and int ds of each facet: x -> x + x^2/4 has the volume int 1 + x/2, exactly."""
    known = TYPES[kind]
    bulge, dim = 0.25 * (known.degree - 1), known.nodes()[0].block_size
    names = [f"S{i}" for i in range(1, len(CELLS[known.cell][1]) + 1)]
    surfaces = "".join(f"*SURFACE, NAME=F{n}\nE, {n}\n" for n in names)
    deck = read(deck_of(kind, bulge) + surfaces)
    x = ufl.SpatialCoordinate(deck.mesh)
    one = fem.Constant(deck.mesh, 1.0)
    mean = {"triangle": 1 / 3, "tetrahedron": 1 / 4}.get(known.cell, 1 / 2)
    volume = SIZES[known.cell] * (1.0 + 2.0 * bulge * mean)
    assert integral(one * ufl.dx(deck.mesh)) == pytest.approx(volume, rel=1e-12)
    n, ds = ufl.FacetNormal(deck.mesh), ufl.Measure("ds", deck.mesh, subdomain_data=deck.tags())
    every = sum(integral(ufl.dot(x, n) * ds(deck.tags().tag(f"F{s}"))) for s in names)
    assert every == pytest.approx(dim * volume, rel=1e-12)


@pytest.mark.mpi
@pytest.mark.parametrize("kind", [kind for kind in TYPES if kind[:3] in ("C3D", "CAX")])
def test_faces_and_middles_have_the_corners_of_the_manuals(kind):
    """The middle of a face is that of its corners, as are further nodes in the reference cell."""
    element, order = TYPES[kind].nodes()
    x = element.basix_element.points[np.argsort(order)]
    pairs = MIDDLES[TYPES[kind].cell].split()
    further = x[TYPES[kind].size - len(pairs) : TYPES[kind].size]
    if TYPES[kind].degree == 2:
        assert further == pytest.approx(
            np.array([x[[int(a) - 1, int(b) - 1]].mean(axis=0) for a, b in pairs])
        )
    faces = CORNERS[TYPES[kind].cell].split()
    deck = read(
        deck_of(kind) + "".join(f"*SURFACE, NAME=F{i}\nE, S{i}\n" for i in range(1, 1 + len(faces)))
    )
    tags = deck.tags()
    ds, X = ufl.Measure("ds", deck.mesh, subdomain_data=tags), ufl.SpatialCoordinate(deck.mesh)
    for i, corners in enumerate(faces, 1):
        size = integral(fem.Constant(deck.mesh, 1.0) * ds(i))
        middle = [integral(X[k] * ds(i)) / size for k in range(len(x[0]))]
        expected = x[[int(corner) - 1 for corner in corners]].mean(axis=0)
        assert middle == pytest.approx(expected, abs=1e-12)


DECK = """*PART, NAME=BLOCK
*INCLUDE, INPUT=block.inp
*END PART
** a comment
*ASSEMBLY, NAME=A
*INSTANCE, NAME=LOW, PART=BLOCK
*END INSTANCE
*INSTANCE, NAME=UP, PART=BLOCK
-1., -2., 0.
0., 0., 0., 0., 0., 1., 180.
*END INSTANCE
*NSET, NSET=HELD
LOW.FOOT,
*NSET, NSET=PUSHED, INSTANCE=UP
Foot, 1
*END ASSEMBLY
*MATERIAL, NAME=STEEL
*ELASTIC
200., .3
*EXPANSION
1.2D-5
*DENSITY
7.8e-9
*SURFACE INTERACTION, NAME=DRY
*FRICTION
.3
*STEP
*STATIC
*END STEP
"""
BLOCK = """*Node, nset=all
1, 0, 0
2, 1, 0
3, 1, 1
4, 0, 1
5, .5, 0
6, 1, .5
7, .5, 1
8, 0, .5
*Element, type=CPE8R, elset=E
1, 1,2,3,4,5,
6,7,8
*Nset, nset=Foot, generate
1, 2, 1
5, 5
*Nset, nset=Top
3, 4, 7
*Surface, name=Upper, type=NODE
Top
*Surface, name=Skin
E
*Solid Section, elset=E, material=STEEL
,
"""
CONTACT = "*CONTACT PAIR, INTERACTION=DRY\nUP.UPPER, LOW.UPPER\n"
TIE = "*TIE, NAME=GLUE, POSITION TOLERANCE=0.5\nUP.UPPER, LOW.UPPER\n"


@pytest.mark.mpi
@pytest.mark.parametrize(("joint", "kind"), [(CONTACT, dm.Contact), (TIE, dm.Tie)])
def test_two_instances_of_a_block(joint, kind):
    """A uniform strain of .005 in plane strain: the pressure is E/(1 - nu^2) times that."""
    deck = read(DECK + joint, block=BLOCK)
    mesh, cell_tags = deck.mesh, deck.cell_tags
    assert cell_tags.names == {"LOW.E": 1, "UP.E": 2} and deck.kinematics == "plane_strain"
    assert {*deck.tags("LOW.SKIN", "UP.SKIN").names} == {"LOW.SKIN", "UP.SKIN"}
    assert deck.densities == {"LOW.E": 7.8e-9, "UP.E": 7.8e-9}
    assert deck.expansions == {"LOW.E": 1.2e-5, "UP.E": 1.2e-5}
    unread = [text.partition("*")[2] for text in deck.unread]
    assert unread == ["STEP", "STATIC", "END STEP"] and "deck.inp, line 27" in deck.unread[0]
    (joined,) = deck.interfaces
    assert type(joined) is kind and (joined.slave, joined.master) == (1, 2)
    V = fem.functionspace(mesh, ("Lagrange", 2, (2,)))
    solid = dm.Solid(fem.Function(V), deck.materials, cell_tags, kinematics=deck.kinematics)
    zero, push = (fem.Constant(mesh, v) for v in (0.0, -0.01))
    held, pushed = (deck.dofs(V, name) for name in ("HELD", "PUSHED"))
    assert COMM.allreduce(len(held)) >= 3
    middle = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[0], 0.5))
    bcs = [
        fem.dirichletbc(
            zero, 2 * np.intersect1d(middle, [*held, *pushed]).astype(np.int32), V.sub(0)
        )
    ]
    bcs += [fem.dirichletbc(v, 2 * at + 1, V.sub(1)) for v, at in ((zero, held), (push, pushed))]
    dm.newton(dm.ContactProblem(solid, deck.interfaces, bcs=bcs))
    pressure = 0.005 * 200.0 / (1.0 - 0.3**2)
    assert joined.force == pytest.approx([0.0, pressure], rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(
    ("plastic", "law"),
    [
        ("*PLASTIC\n300., 0.\n", {"a": 0.0, "H": 0.0}),
        ("*PLASTIC\n300., 0.\n330., .1\n", {"a": 0.0, "H": 200.0}),
        ("*PLASTIC, HARDENING=KINEMATIC\n300., 0.\n330., .1\n", {"a": 200.0, "H": 0.0}),
        ("*PLASTIC\n300., 0.\n330., .1\n340., .2\n", None),
        ("*HYPERELASTIC\n", {}),
    ],
)
def test_laws(plastic, law):
    """Y = sqrt(2/3) 300; a slope of 300 in tension is 2/3 of that in the deviator; no tables."""
    deck = read(DECK.replace("*EXPANSION", plastic + "*EXPANSION") + CONTACT, block=BLOCK)
    told = [line for line in deck.unread if "PLASTIC" in line or "HYPER" in line]
    assert len(told) == (law is None or plastic.startswith("*HYPER"))
    if law is None:
        assert not deck.materials
        return
    found = deck.materials["UP.E"]
    assert found == (dm.VonMises(200.0, 0.3, Y=found.Y, **law) if law else dm.Elastic(200.0, 0.3))
    assert not law or found.Y == pytest.approx(np.sqrt(2 / 3) * 300.0)


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("CPE8R", "S8R", ("block.inp, line 10, *ELEMENT", "no element type 'S8'", "C3D4")),
        ("6,7,8", "6,7,9", ("line 12", "there is no NODE '9'")),
        ("6,7,8", "6,7", ("line 10, *ELEMENT", "element 1 has fewer than 8 nodes")),
        ("6,7,8", "6,7,7", ("line 12", "element 1 has a node twice")),
        (".5, 0", ".5, x", ("line 6", "3 finite numbers")),
        ("type=NODE\nTop", "type=NODE\nTip", ("line 19", "no NSET 'TIP'")),
        (
            "name=Skin\nE",
            "name=Skin\nE, S5",
            (
                "no face 'S5'",
                "S1, S2, S3, S4",
            ),
        ),
        ("material=STEEL", "material=IRON", ("line 22", "no material 'IRON'")),
        ("elset=E, material", "elset=F, material", ("line 22", "no ELSET 'F'")),
        ("*Solid Section, elset=E", "*Solid Section, x=E", ("ELSET= is missing",)),
        ("PART=BLOCK\n-1", "PART=BLACK\n-1", ("line 8", "no part 'BLACK'")),
        ("LOW.FOOT", "LOW.FEET", ("line 13, *NSET", "no NSET 'LOW.FEET'")),
        ("LOW.UPPER", "LOW.OTHER", ("no SURFACE 'LOW.OTHER'",)),
        ("200., .3", "-200., .3", ("line 18, *ELASTIC", "E")),
        ("\n3, 1, 1", "\n3, 1, 1, 1", ("CPE8 are in the plane z = 0",)),
        ("3, 1, 1", "2, 1, 1", ("line 1, *NODE", "2 is there twice")),
        ("nset=all", "system=c", ("line 1, *NODE", "SYSTEM")),
        ("\n,\n", "\n*Solid section, elset=E, material=STEEL\n", ("*SOLID SECTION", "another")),
        ("*MATERIAL", "*SOLID SECTION, ELSET=UP.F\n*MATERIAL", ("no ELSET 'UP.F'",)),
        ("Top\n*Surface", "1, 3\n*Surface", ("*CONTACT PAIR", "has no facet on the boundary")),
        ("LOW.UPPER", "UP.SKIN", ("*CONTACT PAIR", "'UP.SKIN' has facets of one before it")),
        ("200., .3", "200.", ("line 19, *ELASTIC", "2 finite numbers")),
        ("block.inp", "black.inp", ("deck.inp, line 2: INPUT", "black.inp", "no such file")),
        ("block.inp", "deck.inp", ("includes itself",)),
    ],
)
def test_decks_that_are_refused(old, new, words):
    texts = [text.replace(old, new) for text in (DECK + CONTACT, BLOCK)]
    with rejected(*words, error=(ValueError, OSError)):
        read(texts[0], block=texts[1])


# R. H. MacNeal, R. L. Harder, Finite Elem. Anal. Des. 1 (1985) 3-20: the inner nodes of the patch
# test for solids in the unit cube, E = 1e6, nu = 0.25, and u = G x on all of its surface.
INNER = """.249 .342 .192  .826 .288 .288  .850 .649 .263  .273 .750 .230
           .320 .186 .643  .677 .305 .683  .788 .693 .644  .165 .745 .702"""
G = 5e-4 * (np.ones((3, 3)) + np.eye(3))
INWARD = (0, 1, 2, 3), (4, 7, 6, 5), (0, 4, 5, 1), (1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0)


def patch(kind):
    """The patch as a deck of CalculiX: a cell in the middle, and one between it and each side."""
    known = TYPES[kind]
    element, order = known.nodes()
    corners = element.basix_element.points[np.argsort(order)][:8]
    x = np.concatenate([corners, np.array(INNER.split(), dtype=float).reshape(8, 3)])
    cells = [[*range(8, 16)], *([*face, *(i + 8 for i in face)] for face in INWARD)]
    ends = [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4)]
    ends += [(i, i + 4) for i in range(4)]
    edges = {}
    for cell in cells:
        pairs = [tuple(sorted((cell[i], cell[j]))) for i, j in ends[: known.size - 8]]
        cell += [edges.setdefault(pair, 16 + len(edges)) for pair in pairs]
    x = np.concatenate([x, *(x[[*pair]].mean(axis=0, keepdims=True) for pair in edges)])
    outside = np.flatnonzero(((x == 0.0) | (x == 1.0)).any(axis=1))
    lines = ["*NODE, NSET=NALL", *(f"{i + 1},{a},{b},{c}" for i, (a, b, c) in enumerate(x))]
    lines.append(f"*ELEMENT, TYPE={kind}, ELSET=EALL")
    for i, cell in enumerate(cells, 1):
        numbers = [str(i), *(str(n + 1) for n in cell)]
        lines += [",".join(numbers[:11]) + ",", ",".join(numbers[11:])][: 1 + (known.size > 8)]
    lines += ["*NSET, NSET=OUTSIDE", *(f"{i + 1}," for i in outside)]
    lines += [
        "*MATERIAL, NAME=M",
        "*ELASTIC",
        "1.E6, .25",
        "*SOLID SECTION, MATERIAL=M, ELSET=EALL",
    ]
    return "\n".join([*lines, "*STEP", "*STATIC", "*NODE PRINT, NSET=NALL", "U", "*END STEP"])


@pytest.mark.mpi
@pytest.mark.parametrize("kind", ["C3D8", "C3D20"])
def test_the_patch_of_macneal_and_harder(kind):
    """Displacements are those of the surface inside, too; stresses are 2000 and 400."""
    deck = read(patch(kind))
    assert len(deck.unread) == 4
    V = fem.functionspace(deck.mesh, ("Lagrange", TYPES[kind].degree, (3,)))
    assert V.dofmap.index_map.size_global == {"C3D8": 16, "C3D20": 16 + 32 + 24 + 7}[kind]
    u, exact = fem.Function(V), fem.Function(V)
    exact.interpolate(lambda x: G @ x)
    held = fem.dirichletbc(exact, deck.dofs(V, "OUTSIDE"))
    problem = dm.ContactProblem(dm.Solid(u, deck.materials, deck.cell_tags), [], bcs=[held])
    dm.newton(problem, rtol=1e-12)
    error = np.abs(u.x.array - exact.x.array)
    assert COMM.allreduce(error.max(initial=0.0), op=MPI.MAX) < 1e-10 * 2e-3
    e, one = ufl.sym(ufl.grad(u)), fem.Constant(deck.mesh, 1.0)
    volume = integral(one * ufl.dx(deck.mesh))
    assert volume == pytest.approx(1.0, rel=1e-12)
    shear = 0.8e6 * e[0, 1] * ufl.dx(deck.mesh)
    assert integral(shear) == pytest.approx(400.0, rel=1e-10)


CELLS_OF_TWO = "1, 1, 2, 3, 4\n2, 2, 5, 6,\n3"
NODES_OF_TWO = "1, 0, 0\n2, 1,\t0\n3, 1, 1\n4, , 1\n5, 2, 0\n6, 2, 1\n7, 9, 9"
TWO = """*NODE, INPUT=nodes.inp
*ELEMENT, TYPE=CPS4R,
ELSET="All of it"
*INCLUDE, INPUT=cells.inp
*NSET, NSET=ODD, GENERATE
1, 99, 2
*ELSET, ELSET=RIGHT
2
*SURFACE, NAME=ENDS, TYPE=NODE
1, 4, 5, 6
*SURFACE, NAME=UP
RIGHT, S3
All of it, S3
*SURFACE, NAME=NONE, TYPE=NODE
7
"""


@pytest.mark.mpi
def test_two_cells_of_several_files():
    """Data of included files continue those of a keyword; a range has the numbers that exist."""
    deck = read(TWO, nodes=NODES_OF_TWO, cells=CELLS_OF_TWO)
    assert deck.kinematics == "plane_stress" and deck.cell_tags.names == {"BODY": 1}
    assert deck.materials == {} and deck.unread == []
    tags = deck.tags("UP", "ENDS")
    found = sizes(deck.mesh, tags, "ds")
    assert found == pytest.approx({"UP": 2.0, "ENDS": 2.0})
    V = fem.functionspace(deck.mesh, ("Lagrange", 1))
    at = np.round(V.tabulate_dof_coordinates()[deck.dofs(V, "ODD")], 12) + 0.0
    places = {tuple(x) for part in COMM.allgather(at.tolist()) for x in part}
    assert places == {(0.0, 0.0, 0.0), (1.0, 1.0, 0.0), (2.0, 0.0, 0.0)}
    for call in (deck.tags, lambda name: deck.dofs(V, name)):
        with rejected("no ", "'NOWHERE'", "known are"):
            call("NOWHERE")
    with rejected("'NONE' has no facet"):
        deck.tags("NONE")
    with rejected("Lagrange space on the mesh of the deck"):
        deck.dofs(fem.functionspace(deck.mesh, ("Lagrange", 2)), "ODD")


@pytest.mark.mpi
def test_elements_without_a_section_are_refused():
    section = "*MATERIAL, NAME=M\n*SOLID SECTION, ELSET=RIGHT, MATERIAL=M\n"
    with rejected("element 1 is in no SOLID SECTION"):
        read(TWO + section, nodes=NODES_OF_TWO, cells=CELLS_OF_TWO)


def write_step(path, draw, *names):
    """Write what is drawn by Gmsh as a STEP file, on rank 0; names of solids as CAD writes them."""
    gmsh = pytest.importorskip("gmsh")
    if COMM.rank == 0:
        gmsh.initialize(interruptible=False)
        gmsh.option.setNumber("General.Terminal", 0)
        draw(gmsh.model.occ)
        gmsh.model.occ.synchronize()
        gmsh.write(str(path))
        gmsh.finalize()
        unnamed, text = r"'Open CASCADE STEP translator [\d.]+ 1\.(\d+)'", path.read_text()
        if names:
            text = re.sub(unnamed, lambda found: repr(names[int(found[1]) - 1]), text)
        path.write_text(text)
    COMM.Barrier()


@pytest.mark.mpi
@pytest.mark.parametrize("degree", [1, 2])
def test_solids_of_a_step_file_are_bodies(folder, degree):
    """A plate of 4 x 4 x 1 with a hole of radius 1, and a pin of .9 in it: volumes, areas, pair."""

    def draw(occ):
        plate, hole = occ.addBox(-2, -2, 0, 4, 4, 1), occ.addCylinder(0, 0, -1, 0, 0, 3, 1)
        occ.cut([(3, plate)], [(3, hole)])
        occ.addCylinder(0, 0, -1, 0, 0, 3, 0.9)
        occ.addBox(3, 0, 0, 1, 1, 1)

    write_step(folder / "pin.step", draw, "plate", "pin", "pin")
    mesh, bodies, faces = dm.meshing.read_step(folder / "pin.step", size=0.7, degree=degree)
    assert [*bodies.names] == ["plate", "pin", "pin#2"] and len(faces.names) == 7 + 3 + 6
    assert "plate 7" in faces.names and "pin#2 6" in faces.names
    dx = ufl.Measure("dx", mesh, subdomain_data=bodies)
    one = fem.Constant(mesh, 1.0)
    volumes = [integral(one * dx(bodies.tag(name))) for name in ("plate", "pin")]
    close = 0.05 if degree == 1 else 1e-3
    assert volumes == pytest.approx([16 - np.pi, 3 * 0.81 * np.pi], rel=close)
    _, contacts = dm.find_pairs(mesh, bodies, show=False)
    assert len(contacts) == 1


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"size": 0.0}, ("size is 0.0",)),
        ({"size": 1e-4}, ("size is 0.0001", "half of the memory", "give at least")),
        ({"size": 1.0, "degree": 3}, ("degree is 3",)),
    ],
)
def test_step_files_that_are_refused(folder, options, words):
    write_step(folder / "box.step", lambda occ: occ.addBox(0, 0, 0, 1, 1, 1))
    with rejected(*words):
        dm.meshing.read_step(folder / "box.step", **options)
    write_step(folder / "face.step", lambda occ: occ.addRectangle(0, 0, 0, 1, 1))
    with rejected("has no solids"):
        dm.meshing.read_step(folder / "face.step", size=1.0)
    with pytest.raises(OSError, match="no such file"):
        dm.meshing.read_step(folder / "none.step", size=1.0)
    if COMM.rank == 0:
        (folder / "text.step").write_text("a text")
    COMM.Barrier()
    with rejected("text.step", "is no STEP file"):
        dm.meshing.read_step(folder / "text.step", size=1.0)

# SPDX-License-Identifier: MIT
"""Decks of Abaqus and CalculiX: mesh, sets, surfaces, laws and proposed interfaces."""

import itertools
import logging
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
from scipy.spatial.transform import Rotation

import basix
import basix.ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from dolfinx_mortar.algebra.parallel import raised_together
from dolfinx_mortar.common import compat
from dolfinx_mortar.common.arguments import check, instance
from dolfinx_mortar.common.arrays import Floats, Ints, Longs
from dolfinx_mortar.common.disk import check_path
from dolfinx_mortar.common.tags import Tags
from dolfinx_mortar.interfaces.contact import Contact
from dolfinx_mortar.interfaces.tie import Tie
from dolfinx_mortar.materials.elastic import Elastic
from dolfinx_mortar.materials.von_mises import VonMises

log = logging.getLogger(__name__)

KINEMATICS = {"CPE": "plane_strain", "CPS": "plane_stress", "CAX": "axisymmetric"}
KINEMATICS |= {"C3D": "spatial"}
KNOWN = "C3D4, C3D10, C3D8, C3D20, and CPE, CPS or CAX with 3, 4, 6 or 8 nodes"
# What says how, not what, or holds other keywords.
SILENT = {"HEADING", "INCLUDE", "ASSEMBLY", "END ASSEMBLY", "END INSTANCE"}
PROPERTIES = {"ELASTIC", "PLASTIC", "DENSITY", "EXPANSION", "FRICTION"}


@dataclass(frozen=True)
class Shape:
    """Numbering of a cell in a deck."""

    cell: str
    corners: tuple[tuple[int, ...], ...]  # on the reference cell of basix
    edges: tuple[tuple[int, int], ...]  # whose middles are the further nodes of degree 2
    faces: tuple[tuple[int, ...], ...]  # corners of S1, S2 ..


TRIANGLE = Shape("triangle", ((0, 0), (1, 0), (0, 1)), *2 * (((0, 1), (1, 2), (2, 0)),))
QUADRILATERAL = Shape(
    "quadrilateral", ((0, 0), (1, 0), (1, 1), (0, 1)), *2 * (((0, 1), (1, 2), (2, 3), (3, 0)),)
)
TETRAHEDRON = Shape(
    "tetrahedron",
    ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)),
    ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)),
    ((0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0)),
)
HEXAHEDRON = Shape(
    "hexahedron",
    tuple((*corner, z) for z in (0, 1) for corner in QUADRILATERAL.corners),
    tuple(
        [(i, (i + 1) % 4) for i in range(4)]
        + [(4 + i, 4 + (i + 1) % 4) for i in range(4)]
        + [(i, i + 4) for i in range(4)]
    ),
    ((0, 1, 2, 3), (4, 7, 6, 5), *((i, i + 4, 4 + (i + 1) % 4, (i + 1) % 4) for i in range(4))),
)
SHAPES = {("C3D", len(s.corners)): s for s in (TETRAHEDRON, HEXAHEDRON)}
SHAPES |= {("C", len(s.corners)): s for s in (TRIANGLE, QUADRILATERAL)}
SHAPES |= {(k, n + len(s.edges)): s for (k, n), s in SHAPES.items()}


@dataclass(frozen=True)
class Deck:
    """What a deck describes; unpacks as ``mesh, cell_tags, facet_tags``.

    Attributes:
        mesh: all bodies.
        cell_tags: bodies, under the names of the element sets of their sections.
        facet_tags: surfaces that share no facet with one before them; `tags` has the others.
        kinematics: for `Solid`.
        materials: law of a body, where the deck gives one that exists here.
        densities: mass per volume of a body, where given.
        expansions: thermal expansion of a body per degree, where given.
        interfaces: a `Tie` for each TIE, a `Contact` for each CONTACT PAIR, slave side first.
        unread: keywords that were not read, with file and line.
    """

    mesh: dmesh.Mesh
    cell_tags: Tags
    facet_tags: Tags
    kinematics: str
    materials: dict[str, Any]
    densities: dict[str, float]
    expansions: dict[str, float]
    interfaces: list[Contact | Tie]
    unread: list[str]
    surfaces: dict[str, Ints] = field(repr=False)  # facets of this rank
    nodes: dict[str, Ints] = field(repr=False)  # nodes of the geometry of this rank

    def __iter__(self) -> Iterator[Any]:
        return iter((self.mesh, self.cell_tags, self.facet_tags))

    def tags(self, *names: str) -> Tags:
        """Tags 1, 2 .. of these surfaces, which must not overlap.

        Raises:
            ValueError: for unknown names, and surfaces with a facet in common.
        """
        for name in names:
            _check_known(name, self.surfaces, "surface")
        tags, shared = _tag_facets(self.mesh, {name: self.surfaces[name] for name in names})
        if shared:
            raise ValueError(
                f"the surfaces {names} have facets in common, but a facet has one tag: take "
                f"{shared[0]!r} into tags of its own"
            )
        return tags

    def dofs(self, V: fem.FunctionSpace, name: str) -> Ints:
        """Dofs (blocks) of a node set, for ``fem.dirichletbc``.

        Args:
            V: Lagrange space on this mesh, of a degree up to that of the cells.
            name: of an NSET.

        Raises:
            ValueError: for unknown names, and spaces that do not fit.
        """
        _check_known(name, self.nodes, "node set")
        cells, every = compat.cell_nodes(self.mesh), np.asarray(V.dofmap.list)
        if V.mesh is not self.mesh or every.shape[1] > cells.shape[1]:
            raise ValueError(f"V is {V!r}: give a Lagrange space on the mesh of the deck")
        chosen = np.isin(cells[:, : every.shape[1]], self.nodes[name])
        return np.unique(every[chosen]).astype(np.int32)


def read_inp(path: str | os.PathLike[str], comm: MPI.Intracomm = MPI.COMM_WORLD) -> Deck:
    """Read a deck of Abaqus or CalculiX (collective).

        deck = dm.meshing.read_inp("bearing.inp")
        u = fem.Function(fem.functionspace(deck.mesh, ("Lagrange", 1, (3,))))
        solid = dm.Solid(u, deck.materials, deck.cell_tags, kinematics=deck.kinematics)
        bcs = [fem.dirichletbc(np.zeros(3), deck.dofs(u.function_space, "FIXED"), u.function_space)]
        problem = dm.ContactProblem(solid, deck.interfaces, bcs=bcs)

    Read are nodes, elements (C3D4, C3D10, C3D8, C3D20; CPE, CPS, CAX with 3, 4, 6, 8 nodes; also
    reduced and hybrid ones, as full ones), NSET, ELSET, SURFACE of elements or nodes, TIE, CONTACT
    PAIR with FRICTION, SOLID SECTION with ELASTIC (isotropic), PLASTIC (of at most two points, with
    kinematic hardening), DENSITY, EXPANSION, parts, instances and INCLUDE. Steps, loads and all
    else are listed in ``unread``. Nodes that 20-node hexahedra and 8-node quadrilaterals lack are
    added by their own shape functions. Names are in capitals unless quoted; those of a part are
    INSTANCE.NAME. Bodies that share nodes are one. Rank 0 reads and distributes.

    Args:
        path: the file; included ones are searched for beside the one that names them.
        comm: communicator of the mesh.

    Raises:
        OSError: if a file is missing or cannot be read.
        ValueError: naming file and line: for elements of an unknown kind or of several kinds, for
            sets, surfaces, materials and nodes that do not exist, numbers that are none, elements
            that are in no section or in two.
    """
    check("comm", comm, instance(MPI.Intracomm, "give a communicator, such as MPI.COMM_WORLD"))
    file = check_path(comm, path)
    read = None
    with raised_together(comm):
        if comm.rank == 0:
            read = _tell(_Model(file))
    return _distribute(comm, read, file.stem)


@dataclass(frozen=True)
class Keyword:
    """A keyword with its options and data lines, (line number, words)."""

    file: Path
    line: int
    name: str
    options: dict[str, str]
    data: list[tuple[int, list[str]]] = field(default_factory=list)

    def place(self, line: int | None = None) -> str:
        """Where it is."""
        return f"{self.file}, line {line or self.line}, *{self.name}"

    def error(self, text: str, line: int | None = None) -> ValueError:
        """Error that names the place."""
        return ValueError(f"{self.place(line)}: {text}")

    def option(self, name: str) -> str:
        """Value of an option, an error without."""
        if not self.options.get(name):
            raise self.error(f"{name}= is missing")
        return self.options[name]

    def numbers(self, at: int, least: int) -> list[float]:
        """Numbers of a data line, at least so many."""
        line, words = self.data[at] if at < len(self.data) else (self.line, [])
        try:
            found = [float(w.upper().replace("D", "E")) for w in words if w]
        except ValueError:
            found = []
        if len(found) < least or not np.isfinite(found).all():
            raise self.error(f"{', '.join(words)!r}: give {least} finite numbers", line)
        return found

    def words(self) -> list[tuple[int, str]]:
        """Words of all data lines, each with its line."""
        return [(line, _name(word)) for line, words in self.data for word in words if word]


def _keywords(file: Path, above: tuple[Path, ...] = ()) -> Iterator[Keyword]:
    """Keywords of a file and of those that it includes."""
    if not file.is_file() or file in above:
        where = f", which {above[-1]} includes" if above else f" in {Path.cwd()}"
        why = "includes itself" if file in above else "is no file"
        raise FileNotFoundError(f"path = {str(file)!r}{where}, {why}.")
    found, begun = Keyword(file, 0, "HEADING", {}), ""
    for number, raw in enumerate(file.read_text(errors="replace").splitlines(), 1):
        text = "" if raw.startswith("**") else begun + raw.strip()
        begun = text if text[:1] == "*" and text[-1:] == "," else begun if not text else ""
        if begun or not text:
            continue
        if text[0] != "*":
            found.data.append((number, [word.strip() for word in text.split(",")]))
            continue
        yield found
        name, *words = (word.strip() for word in text[1:].split(","))
        pairs = (word.partition("=") for word in words)
        options = {key.strip().upper(): value.strip() for key, _, value in pairs}
        found = Keyword(file, number, " ".join(name.upper().split()), options)
        if found.name == "INCLUDE":
            yield from _keywords(file.parent / found.option("INPUT").strip('"'), (*above, file))
        found.options.update({k: _name(v) for k, v in options.items() if k != "INPUT"})
    yield found


def _name(text: str) -> str:
    """Name in capitals, unless in quotes."""
    return text[1:-1] if text[:1] == '"' == text[-1:] else text.upper()


def _check_known(name: str, known: Iterable[str], sort: str) -> None:
    if name not in known:
        raise ValueError(f"{name!r} is no {sort} of the deck; there are {', '.join(known)}")


def _entries(file: Path) -> Iterator[tuple[Keyword, str, Keyword | None]]:
    """Keywords with the instance (and a dot), material or interaction that they belong to."""
    parts: dict[str, list[Keyword]] = {}
    part: list[Keyword] | None = None
    owner = ""
    for keyword in _keywords(file):
        if keyword.name == "PART":
            part = parts[keyword.option("NAME")] = []
        elif keyword.name == "END PART":
            part = None
        elif part is not None:
            part.append(keyword)
        elif keyword.name == "INSTANCE":
            if keyword.option("PART") not in parts:
                raise keyword.error(f"there is no part {keyword.options['PART']!r}")
            for own in parts[keyword.options["PART"]]:
                yield own, f"{keyword.option('NAME')}.", keyword
        elif keyword.name in ("MATERIAL", "SURFACE INTERACTION"):
            owner = keyword.option("NAME")
            yield keyword, owner, None
        else:
            yield keyword, owner if keyword.name in PROPERTIES else "", None


class _Model:
    """A deck on the rank that reads it: rows of nodes and elements by number and by set."""

    def __init__(self, file: Path) -> None:
        self.x: list[Floats] = []
        self.elements: list[tuple[Keyword, int, Longs]] = []  # keyword, line, nodes
        self.rows: dict[str, dict[str, Longs]] = {"node": {}, "element": {}}
        self.surfaces: dict[str, Longs] = {}  # corners of facets, or one column of nodes
        self.sections: dict[str, tuple[Keyword, Longs]] = {}
        self.properties: dict[str, list[Keyword]] = {}  # by material and interaction
        self.joints: list[Keyword] = []
        self.unread: list[str] = []
        reads = {
            "NODE": self.read_nodes,
            "ELEMENT": self.read_elements,
            "NSET": self.read_set,
            "ELSET": self.read_set,
            "SURFACE": self.read_surface,
            "SOLID SECTION": self.read_section,
        }
        order = [*reads]
        entries = [*_entries(file)]
        entries.sort(key=lambda e: order.index(e[0].name) if e[0].name in reads else len(order))
        for keyword, owner, moved in entries:
            if keyword.name in reads:
                reads[keyword.name](keyword, owner, moved)
            elif keyword.name in ("TIE", "CONTACT PAIR"):
                self.joints.append(keyword)
            elif owner:
                self.properties.setdefault(owner, []).append(keyword)
            elif keyword.name not in SILENT:
                self.unread.append(keyword.place())
        if not self.elements:
            raise ValueError(f"path = {str(file)!r} has no elements")

    def read_nodes(self, keyword: Keyword, owner: str, moved: Keyword | None) -> None:
        """Nodes, moved with their instance."""
        if "SYSTEM" in keyword.options:
            raise keyword.error("coordinates in another SYSTEM are not read: give x, y, z")
        read = [keyword.numbers(at, 3) for at in range(len(keyword.data))]
        x = np.array([[*at[1:], 0.0][:3] for at in read]).reshape(-1, 3)
        for number, *_ in read:
            self.rows["node"][f"{owner}{int(number)}"] = np.array([len(self.x)])
            self.x.append(np.empty(3))
        self.x[len(self.x) - len(read) :] = [*(x if moved is None else _move(moved, x))]
        self.add("node", keyword.options.get("NSET"), owner, np.arange(-len(read), 0) + len(self.x))

    def read_elements(self, keyword: Keyword, owner: str, _: Any) -> None:
        """Elements of a kind."""
        _shape(keyword)
        each, words, begin = 1 + _count(keyword), keyword.words(), len(self.elements)
        if len(words) % each:
            raise keyword.error(f"some of the {each - 1} nodes of an element are missing")
        for i in range(0, len(words), each):
            (line, number), *nodes = words[i : i + each]
            own = [self.find("node", n, owner, keyword, at) for at, n in nodes]
            if len(np.unique(own)) < len(own):
                raise keyword.error(f"element {number} has a node twice", line)
            self.rows["element"][f"{owner}{number}"] = np.array([len(self.elements)])
            self.elements.append((keyword, line, np.concatenate(own)))
        rows = np.arange(begin, len(self.elements))
        self.add("element", keyword.options.get("ELSET"), owner, rows)

    def add(self, kind: str, name: str | None, owner: str, rows: Longs) -> None:
        """Add to a set, if it has a name."""
        if name:
            before = self.rows[kind].get(owner + name, np.empty(0, dtype=np.int64))
            self.rows[kind][owner + name] = np.unique(np.append(before, rows))

    def find(self, kind: str, word: str, owner: str, keyword: Keyword, line: int) -> Longs:
        """Rows of a number or set."""
        for name in (owner + word, word):
            if name in self.rows[kind]:
                return self.rows[kind][name]
        raise keyword.error(f"there is no {kind}{'' if word.isdigit() else ' set'} {word!r}", line)

    def read_set(self, keyword: Keyword, owner: str, _: Any) -> None:
        """A set of nodes or elements."""
        kind = {"NSET": "node", "ELSET": "element"}[keyword.name]
        words = keyword.words()
        if "GENERATE" in keyword.options:
            words = []
            for at, (line, _given) in enumerate(keyword.data):
                first, last, *step = (int(v) for v in keyword.numbers(at, 2))
                words += [(line, str(n)) for n in range(first, last + 1, *step or [1])]
        scope = f"{keyword.options['INSTANCE']}." if "INSTANCE" in keyword.options else owner
        found = [self.find(kind, word, scope, keyword, line) for line, word in words]
        name = keyword.option(keyword.name)
        self.add(kind, name, owner, np.concatenate([*found, np.empty(0, dtype=np.int64)]))

    def read_surface(self, keyword: Keyword, owner: str, _: Any) -> None:
        """A surface of nodes, or of facets of elements."""
        found = []
        for line, (word, *label) in keyword.data:
            if keyword.options.get("TYPE") == "NODE":
                found.append(self.find("node", _name(word), owner, keyword, line)[:, None])
                continue
            for row in self.find("element", _name(word), owner, keyword, line):
                of, _line, nodes = self.elements[row]
                faces = {f"S{i}": face for i, face in enumerate(_shape(of).faces, 1)}
                chosen = [name.upper() for name in label if name] or [*faces]
                if chosen[0] not in faces:
                    raise keyword.error(f"{chosen[0]!r} is none of {', '.join(faces)}", line)
                found += [np.sort(nodes[list(faces[name])])[None] for name in chosen]
        if not found:
            raise keyword.error("the surface is empty")
        self.surfaces[owner + keyword.option("NAME")] = np.concatenate(found)

    def read_section(self, keyword: Keyword, owner: str, _: Any) -> None:
        """A body."""
        elset = keyword.option("ELSET")
        rows = self.find("element", elset, owner, keyword, keyword.line)
        self.sections[owner + elset] = keyword, rows

    def kind(self) -> tuple[str, Shape]:
        """Family and shape of all elements."""
        first = self.elements[0][0]
        for keyword, line, _ in self.elements:
            if (_family(keyword), _count(keyword)) != (_family(first), _count(first)):
                types = f"{first.options['TYPE']} and {keyword.options['TYPE']}"
                raise keyword.error(f"{types} are mixed: mesh all bodies with one kind", line)
        return _family(first), _shape(first)

    def bodies(self) -> tuple[list[str], Ints]:
        """Names of the bodies, and the body of each element."""
        owner = np.full(len(self.elements), -1, dtype=np.int32)
        for i, (keyword, rows) in enumerate(self.sections.values()):
            if (owner[rows] >= 0).any():
                raise keyword.error("some of its elements are in another section, too")
            owner[rows] = i
        if not self.sections:
            return ["BODY"], np.zeros_like(owner)
        for keyword, line, _ in (self.elements[i] for i in np.flatnonzero(owner < 0)):
            raise keyword.error("an element is in no section", line)
        return [*self.sections], owner

    def joint(self, keyword: Keyword, at: int) -> dict[str, Any]:
        """Arguments of an interface from a data line."""
        line, words = keyword.data[at]
        names = [_name(w) for w in words[:2] if w]
        for name in names:
            if name not in self.surfaces:
                raise keyword.error(f"there is no surface {name!r}", line)
        given: dict[str, Any] = {"slave": names[0], "master": names[-1]}
        if keyword.name == "TIE":
            tolerance = keyword.options.get("POSITION TOLERANCE")
            return given | {"within": None if tolerance is None else float(tolerance)}
        laws = self.properties.get(keyword.options.get("INTERACTION", ""), [])
        friction = [law.numbers(0, 1)[0] for law in laws if law.name == "FRICTION"]
        return given | {"friction": (friction or [0.0])[-1] or None}

    def constants(self, body: str) -> dict[str, Any]:
        """Constants of a body's material."""
        section = self.sections.get(body, (None,))[0]
        if section is None:
            return {}
        if section.option("MATERIAL") not in self.properties:
            raise section.error(f"there is no material {section.options['MATERIAL']!r}")
        found: dict[str, Any] = {}
        for keyword in self.properties[section.options["MATERIAL"]][1:]:
            rows = len(keyword.data)
            other = not keyword.options.get("TYPE", "ISO").startswith("ISO")
            if other or rows > 1 + (keyword.name == "PLASTIC"):
                found["no law"] = keyword
                self.unread.append(f"{keyword.place()} of {section.options['MATERIAL']!r}")
            elif keyword.name == "ELASTIC":
                found["E"], found["nu"] = keyword.numbers(0, 2)[:2]
            elif keyword.name == "PLASTIC":
                found["plastic"] = _plastic(keyword)
            else:
                found[keyword.name] = keyword.numbers(0, 1)[0]
        return found


def _plastic(keyword: Keyword) -> dict[str, float]:
    """Y, a and H of one or two points (stress, plastic strain) of uniaxial loading."""
    points = [[*keyword.numbers(at, 1), 0.0][:2] for at in range(len(keyword.data))]
    (stress, start), (last, end) = points[0], points[-1]
    if start or (len(points) > 1 and not end > 0.0):
        raise keyword.error("plastic strains have to rise from 0")
    slope = 2 / 3 * (last - stress) / end if end else 0.0
    kinematic = keyword.options.get("HARDENING") == "KINEMATIC"
    return {"Y": (2 / 3) ** 0.5 * stress, "a": slope * kinematic, "H": slope * (not kinematic)}


def _family(keyword: Keyword) -> str:
    return keyword.option("TYPE")[:3]


def _count(keyword: Keyword) -> int:
    return int("".join(filter(str.isdigit, keyword.option("TYPE")[3:])) or 0)


def _shape(keyword: Keyword) -> Shape:
    found = SHAPES.get(("C3D" if _family(keyword) == "C3D" else "C", _count(keyword)))
    if found is None or _family(keyword) not in KINEMATICS:
        raise keyword.error(f"TYPE={keyword.options['TYPE']} is unknown; known are {KNOWN}")
    return found


def _move(moved: Keyword, x: Floats) -> Floats:
    """Positions (n, 3) in an instance: translated, then rotated about a line."""
    if moved.data:
        x = x + np.array([*moved.numbers(0, 2), 0.0][:3])
    if len(moved.data) > 1:
        given = np.array(moved.numbers(1, 7))
        axis = given[3:6] - given[:3]
        turn = Rotation.from_rotvec(np.radians(given[6]) * axis / np.linalg.norm(axis))
        x = given[:3] + turn.apply(x - given[:3])
    return x


def full_cells(shape: Shape, cells: Longs, x: Floats) -> tuple[Longs, Floats, list[Longs]]:
    """Cells in basix's order with the nodes that serendipity cells lack (and their sources).

    On the reference cell the given nodes determine a polynomial of superlinear degree at most 2; a
    node that is not given has its value there. Source: D. N. Arnold, G. Awanou, Found. Comput.
    Math. 11 (2011) 337-344.

    Args:
        shape: of the cells.
        cells: (m, k) nodes in the order of a deck.
        x: (n, d) positions.

    Returns:
        Cells (m, K), positions (N, d), and for each of the N - n new nodes those that it is of.
    """
    corners = np.array(shape.corners, dtype=float)
    degree = 1 if cells.shape[1] == len(corners) else 2
    middles = [corners[list(edge)].mean(axis=0) for edge in shape.edges]
    given = np.array([*corners, *middles])[: cells.shape[1]]
    kind = basix.CellType[shape.cell]
    variant = basix.LagrangeVariant.equispaced
    full = np.asarray(basix.create_element(basix.ElementFamily.P, kind, degree, variant).points)
    powers = np.array([*itertools.product(range(degree + 1), repeat=corners.shape[1])])
    simplex = len(corners) == corners.shape[1] + 1
    order = powers.sum(axis=1) if simplex else (powers * (powers > 1)).sum(axis=1)
    powers = powers[order <= degree]
    at = [(np.asarray(y)[:, None] ** powers).prod(axis=2) for y in (full, given)]
    values = at[0] @ np.linalg.inv(at[1])
    values[np.abs(values) < 1e-12] = 0.0
    columns, new_x, sources = [], [x], []
    known = len(x)
    for weights in values:
        support = np.flatnonzero(weights)
        if len(support) == 1:
            columns.append(cells[:, support[0]])
            continue
        of = np.sort(cells[:, support], axis=1)
        _, first, number = np.unique(of, axis=0, return_index=True, return_inverse=True)
        columns.append(known + number.ravel())
        new_x.append(np.einsum("k,mkd->md", weights[support], x[cells[first][:, support]]))
        sources += [*of[first]]
        known += len(first)
    return np.stack(columns, axis=1), np.concatenate(new_x), sources


@dataclass(frozen=True)
class _Told:
    """What all ranks have to know of a deck."""

    kind: tuple[str, str, int, int]  # family, cell, degree, nodes of a cell
    bodies: list[str]
    owner: Ints
    laws: list[dict[str, Any]]
    surfaces: dict[str, Longs]
    nodes: dict[str, Longs]
    joints: list[tuple[str, str, dict[str, Any]]]  # sort, place, arguments
    unread: list[str]


def _tell(model: _Model) -> tuple[_Told, Longs, Floats]:
    """Message to all ranks, cells, and positions of their nodes."""
    family, shape = model.kind()
    bodies, owner = model.bodies()
    cells = np.array([nodes for _, _, nodes in model.elements])
    count, dim = cells.shape[1], len(shape.corners[0])
    used, cells = np.unique(cells, return_inverse=True)
    x = np.array(model.x)[used][:, :dim]
    cells, x, sources = full_cells(shape, cells.reshape(-1, count), x)
    nodes = {}
    for name, rows in model.rows["node"].items():
        if name.rpartition(".")[2].isdigit():
            continue
        own = np.flatnonzero(np.isin(used, rows))
        new = [len(used) + i for i, of in enumerate(sources) if np.isin(of, own).all()]
        nodes[name] = np.append(own, np.array(new, dtype=np.int64))
    row = np.full(len(model.x), -1)
    row[used] = np.arange(len(used))
    joints = [
        (k.name, k.place(k.data[at][0]), model.joint(k, at))
        for k in model.joints
        for at in range(len(k.data))
    ]
    degree = 1 if count == len(shape.corners) else 2
    surfaces = {name: row[rows] for name, rows in model.surfaces.items()}
    kind = family, shape.cell, degree, cells.shape[1]
    laws = [model.constants(body) for body in bodies]
    told = _Told(kind, bodies, owner, laws, surfaces, nodes, joints, model.unread)
    return told, cells, x


def _distribute(comm: MPI.Intracomm, read: tuple[_Told, Longs, Floats] | None, name: str) -> Deck:
    """Mesh, tags, laws and interfaces of a deck read by rank 0; collective."""
    told: _Told = comm.bcast(read[0] if read else None)
    family, cell, degree, count = told.kind
    dim = 3 if family == "C3D" else 2
    none = np.empty((0, count), dtype=np.int64), np.empty((0, dim))
    cells, x = read[1:] if read else none
    variant = basix.LagrangeVariant.equispaced
    element = basix.ufl.element("P", cell, degree, lagrange_variant=variant, shape=(dim,))
    domain = dmesh.create_mesh(comm, cells=cells, e=element, x=np.ascontiguousarray(x))
    domain.name = name
    of = told.owner[domain.topology.original_cell_index]
    every = np.arange(len(of), dtype=np.int32)
    cell_tags = dmesh.meshtags(domain, dim, every, of + 1)
    cell_tags.name = "bodies"
    surfaces = _find_facets(domain, told.surfaces)
    facet_tags, shared = _tag_facets(domain, surfaces)
    if shared and comm.rank == 0:
        log.warning(
            "%s: the surfaces %s share facets with others and are not in facet_tags; "
            "deck.tags(name) has them",
            *(name, ", ".join(shared)),
        )
    number = np.asarray(domain.geometry.input_global_indices)
    laws = [*zip(told.bodies, told.laws, strict=True)]
    deck = Deck(
        domain,
        Tags(cell_tags, {body: i for i, body in enumerate(told.bodies, 1)}),
        facet_tags,
        KINEMATICS[family],
        {b: law for b, own in laws if (law := _law(own))},
        {b: own["DENSITY"] for b, own in laws if "DENSITY" in own},
        {b: own["EXPANSION"] for b, own in laws if "EXPANSION" in own},
        [],
        told.unread,
        surfaces,
        {n: np.flatnonzero(np.isin(number, r)).astype(np.int32) for n, r in told.nodes.items()},
    )
    for sort, place, given in told.joints:
        names = dict.fromkeys([given["slave"], given["master"]])
        try:
            joint = (Tie if sort == "TIE" else Contact)(deck.tags(*names), **given)
        except ValueError as error:
            raise ValueError(f"{place}: {error}") from error
        deck.interfaces.append(joint)
    return deck


def _law(given: dict[str, Any]) -> Any:
    if "no law" in given or "E" not in given:
        return None
    elastic = {"E": given["E"], "nu": given["nu"]}
    return VonMises(**elastic, **given["plastic"]) if "plastic" in given else Elastic(**elastic)


def _find_facets(domain: dmesh.Mesh, surfaces: Mapping[str, Longs]) -> dict[str, Ints]:
    """Facets of this rank on the boundary of each surface; a ValueError if no rank has any."""
    dim = domain.topology.dim
    domain.topology.create_entities(dim - 1)
    domain.topology.create_connectivity(dim - 1, dim)
    facets = dmesh.exterior_facet_indices(domain.topology)
    nodes: Ints = np.empty((0, 4), dtype=np.int32)
    if len(facets):  # dolfinx divides by their number
        nodes = dmesh.entities_to_geometry(domain, dim - 1, facets)
    count = {"tetrahedron": 3, "hexahedron": 4}.get(domain.topology.cell_name(), 2)
    corners = np.asarray(domain.geometry.input_global_indices)[nodes[:, :count]]
    corners.sort(axis=1)
    found = {}
    for name, rows in surfaces.items():
        of = np.isin(corners, rows).all(axis=1)
        if rows.shape[1] > 1:
            known = {tuple(row) for row in rows}
            of &= np.array([tuple(row) in known for row in corners], dtype=bool)
        found[name] = facets[of]
    counts = domain.comm.allreduce(np.array([len(own) for own in found.values()], dtype=int))
    if lost := [name for name, n in zip(found, counts, strict=True) if not n]:
        raise ValueError(f"the surface {lost[0]!r} has no facet on the boundary of a body")
    return found


def _tag_facets(domain: dmesh.Mesh, surfaces: Mapping[str, Ints]) -> tuple[Tags, list[str]]:
    """Tags 1, 2 .. of surfaces in order, and those left out for facets of others; collective."""
    taken: Ints = np.empty(0, dtype=np.int32)
    names, parts, left = {}, [], []
    for i, (name, facets) in enumerate(surfaces.items(), 1):
        if domain.comm.allreduce(int(np.isin(facets, taken).sum())):
            left.append(name)
            continue
        taken = np.append(taken, facets)
        names[name] = i
        parts.append(np.full(len(facets), i, dtype=np.int32))
    values = np.concatenate([*parts, np.empty(0, dtype=np.int32)])
    order = np.argsort(taken)
    tags = dmesh.meshtags(domain, domain.topology.dim - 1, taken[order], values[order])
    tags.name = "boundary"
    return Tags(tags, names), left

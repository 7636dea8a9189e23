# SPDX-License-Identifier: MIT
"""Decks of Abaqus and CalculiX: mesh, sets, surfaces, laws and proposed interfaces."""

import logging
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

from mpi4py import MPI

import numpy as np
from scipy.spatial.transform import Rotation

import basix
import basix.ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from dolfinx.cpp.io import perm_vtk
from dolfinx_mortar.algebra.parallel import raised_together
from dolfinx_mortar.common import compat
from dolfinx_mortar.common.arguments import check, instance
from dolfinx_mortar.common.arrays import Floats, Ints, Longs
from dolfinx_mortar.common.disk import check_path
from dolfinx_mortar.common.tags import Tags
from dolfinx_mortar.interfaces.contact import Contact
from dolfinx_mortar.interfaces.tie import Tie
from dolfinx_mortar.materials.elastic import Elastic
from dolfinx_mortar.materials.plasticity import VonMises
from dolfinx_mortar.meshing.full_cells import full_cells, missing_nodes

log = logging.getLogger(__name__)


class Kind(NamedTuple):
    """Kind of the elements of a deck."""

    kinematics: str
    cell: str
    degree: int
    count: int  # nodes of an element, in the order of VTK

    def nodes(self) -> tuple[Floats, Ints]:
        """Nodes of the full cell in that order, and where those of basix are in it."""
        variant, kind = basix.LagrangeVariant.equispaced, basix.CellType[self.cell]
        element = basix.create_element(basix.ElementFamily.P, kind, self.degree, variant)
        order = np.array(perm_vtk(dmesh.CellType[self.cell], element.dim), dtype=np.int32)
        return np.asarray(element.points)[np.argsort(order)], order

    def facets(self) -> Ints:
        """Corners (facets, k) of the facets of the reference cell, in basix's order."""
        return np.array(basix.topology(basix.CellType[self.cell])[-2], dtype=np.int32)


SPACE = {4: ("tetrahedron", 1), 10: ("tetrahedron", 2), 8: ("hexahedron", 1), 20: ("hexahedron", 2)}
PLANE = {3: ("triangle", 1), 6: ("triangle", 2), 4: ("quadrilateral", 1), 8: ("quadrilateral", 2)}
FAMILIES = {
    "C3D": ("spatial", SPACE),
    "CPE": ("plane_strain", PLANE),
    "CPS": ("plane_stress", PLANE),
    "CAX": ("axisymmetric", PLANE),
}
TYPES = {
    f"{name}{count}": Kind(kinematics, *cell, count)
    for name, (kinematics, cells) in FAMILIES.items()
    for count, cell in cells.items()
}
VARIANTS = "RHIMTS"  # reduced, hybrid, incompatible, modified, thermal, stresses at surfaces
FACES = {  # facets of the reference cell that are called S1, S2 ..
    "triangle": (2, 0, 1),
    "quadrilateral": (0, 2, 3, 1),
    "tetrahedron": (3, 2, 0, 1),
    "hexahedron": (0, 5, 1, 3, 4, 2),
}
SORTS = {"NSET": "node", "ELSET": "element"}
OWNERS = "MATERIAL", "SURFACE INTERACTION"
PROPERTIES = "ELASTIC", "PLASTIC", "DENSITY", "EXPANSION", "FRICTION"
# What says how, not what, or holds other keywords.
SILENT = {"HEADING", "INCLUDE", "ASSEMBLY", "END ASSEMBLY"}
NONE: Longs = np.empty(0, dtype=np.int64)


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
        chosen = {name: _find(self.surfaces, name, "surface") for name in names}
        tags, shared = _tag_facets(self.mesh, chosen)
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
        nodes = _find(self.nodes, name, "node set")
        cells, every = compat.cell_nodes(self.mesh), np.asarray(V.dofmap.list)
        if V.mesh is not self.mesh or every.shape[1] > cells.shape[1]:
            raise ValueError(f"V is {V!r}: give a Lagrange space on the mesh of the deck")
        return np.unique(every[np.isin(cells[:, : every.shape[1]], nodes)]).astype(np.int32)


def read_inp(path: str | os.PathLike[str], comm: MPI.Intracomm = MPI.COMM_WORLD) -> Deck:
    """Read a deck of Abaqus or CalculiX (collective).

        deck = dm.meshing.read_inp("bearing.inp")
        u = fem.Function(fem.functionspace(deck.mesh, ("Lagrange", 1, (3,))))
        solid = dm.Solid(u, deck.materials, deck.cell_tags, kinematics=deck.kinematics)
        bcs = [fem.dirichletbc(np.zeros(3), deck.dofs(u.function_space, "FIXED"), u.function_space)]
        problem = dm.ContactProblem(solid, deck.interfaces, bcs=bcs)

    Read are nodes, elements (C3D4, C3D10, C3D8, C3D20; CPE, CPS, CAX with 3, 4, 6, 8 nodes; also
    with the letters R, H, I, M, T or S, as full ones without), NSET, ELSET, SURFACE of elements or
    nodes, TIE, CONTACT PAIR with FRICTION, SOLID SECTION with ELASTIC (isotropic), PLASTIC (of at
    most two points, with kinematic hardening), DENSITY, EXPANSION, parts, instances and INCLUDE.
    Steps, loads and all else are listed in ``unread``. 20-node hexahedra and 8-node quadrilaterals
    get the nodes they lack by their own shape functions. Names are in capitals unless quoted; those
    of a part are INSTANCE.NAME. Bodies that share nodes are one. Rank 0 reads and distributes.

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
    told, cells, x = None, NONE, np.empty(0)
    with raised_together(comm):
        if comm.rank == 0:
            told, cells, x = _Model(file).finish()
    return _distribute(comm.bcast(told), comm, cells, x, file.stem)


@dataclass(frozen=True)
class Keyword:
    """A keyword with its options and data lines, (line number, words)."""

    file: Path
    line: int
    name: str
    options: dict[str, str]
    data: list[tuple[int, list[str]]] = field(default_factory=list)
    scope: str = ""  # before names: an instance and a dot; a material or interaction
    instance: "Keyword | None" = None

    def place(self, line: int | None = None) -> str:
        """Where it is."""
        return f"{self.file}, line {line or self.line}, *{self.name}"

    def error(self, text: object, line: int | None = None) -> ValueError:
        """Error that names the place."""
        return ValueError(f"{self.place(line)}: {text}")

    def __getitem__(self, option: str) -> str:
        if not self.options.get(option):
            raise self.error(f"{option}= is missing")
        return self.options[option]

    def find(self, known: Mapping[str, Any], name: str, sort: str, line: int | None = None) -> Any:
        """What has a name in the scope, or else in the deck."""
        try:
            return _find(known, self.scope + name if self.scope + name in known else name, sort)
        except ValueError as error:
            raise self.error(error, line) from error

    def numbers(self, at: int, least: int) -> list[float]:
        """Numbers of a data line, at least so many."""
        line, words = self.data[at] if at < len(self.data) else (self.line, [])
        text = ", ".join(words).rstrip(", ")
        try:
            found = [float(w.upper().replace("D", "E") or 0) for w in text.split(", ") if text]
        except ValueError:
            found = []
        if len(found) < least or not np.isfinite(found).all():
            raise self.error(f"{text!r}: give {least} finite numbers", line)
        return found

    def words(self) -> list[tuple[int, str]]:
        """Words of all data lines, each with its line."""
        return [(line, _name(word)) for line, words in self.data for word in words if word]


def _name(text: str) -> str:
    """Name in capitals, unless in quotes."""
    return text[1:-1] if text[:1] == '"' == text[-1:] else text.upper()


def _find(known: Mapping[str, Any], name: str, sort: str) -> Any:
    if name not in known:
        names = [key for key in known if not key.rpartition(".")[2].isdigit()]
        raise ValueError(f"there is no {sort} {name!r}; known are {', '.join(names[:20])}")
    return known[name]


def _keywords(file: Path, above: tuple[Keyword, ...] = ()) -> Iterator[Keyword]:
    """Keywords of a file and of those that it includes."""
    by = f"{above[-1].place()}: INPUT" if above else "path"
    if not file.is_file() or file.resolve() in [k.file.resolve() for k in above]:
        why = "includes itself" if file.is_file() else f"there is no such file in {Path.cwd()}"
        raise FileNotFoundError(f"{by} = {str(file)!r}: {why}")
    found, begun = Keyword(file, 0, "HEADING", {}), ""
    for number, line in enumerate(file.read_text(errors="replace").splitlines(), 1):
        if line.startswith("**"):
            continue
        text = begun + line.strip()
        begun = text if text[:1] == "*" and text[-1:] == "," else ""
        words = [word.strip() for word in text.lstrip("*").split(",")]
        if text[:1] != "*":
            found.data.extend([(number, words)] if text else [])
        elif not begun:
            yield found
            pairs = [[part.strip() for part in word.partition("=")] for word in words[1:]]
            options = {
                key.upper(): value if key.upper() == "INPUT" else _name(value)
                for key, _, value in pairs
            }
            found = Keyword(file, number, " ".join(words[0].upper().split()), options)
            if found.name == "INCLUDE":
                yield from _keywords(file.parent / found["INPUT"].strip('"'), (*above, found))
    yield found


def _entries(file: Path) -> Iterator[Keyword]:
    """Keywords in their scope, those of parts once for each instance."""
    parts: dict[str, list[Keyword]] = {}
    part: list[Keyword] | None = None
    instance: Keyword | None = None
    scope = owner = ""
    for k in _keywords(file):
        if k.name == "PART":
            part = parts[k["NAME"]] = []
        elif k.name == "INSTANCE":
            instance, scope = k, f"{k['NAME']}."
            yield from (
                replace(own, scope=scope, instance=k) for own in k.find(parts, k["PART"], "part")
            )
        elif k.name in ("END PART", "END INSTANCE"):
            part, instance, scope = None, None, ""
        elif part is not None:
            part.append(k)
        else:
            owner = k["NAME"] if k.name in OWNERS else owner
            yield replace(k, scope=owner if k.name in PROPERTIES else scope, instance=instance)


class _Told(NamedTuple):
    """What all ranks have to know of a deck."""

    kind: Kind
    owner: Ints  # body of each element
    bodies: dict[str, dict[str, Any]]
    surfaces: dict[str, Longs]  # (n, 2): elements and their facets
    nodes: dict[str, Longs]
    joints: list[tuple[type[Contact] | type[Tie], str, dict[str, Any]]]
    unread: list[str]


class _Model:
    """A deck on the rank that reads it."""

    def __init__(self, file: Path) -> None:
        self.kind: Any = None
        self.x: list[Floats] = []
        self.cells: list[Longs] = []
        self.rows: dict[str, dict[str, Any]] = {sort: {} for sort in SORTS}  # of numbers and sets
        self.surfaces: dict[str, Longs] = {}  # elements and their facets (n, 2), or nodes (n,)
        self.sections: list[tuple[Keyword, Longs]] = []
        self.properties: dict[str, dict[str, Keyword]] = {}  # of materials and interactions
        self.joints: list[tuple[type[Contact] | type[Tie], str, dict[str, Any]]] = []
        self.unread: dict[str, None] = {}
        order = {name: i for i, name in enumerate(READERS)}
        for k in sorted(_entries(file), key=lambda k: order.get(k.name, len(order))):
            if k.name in READERS:
                READERS[k.name](self, k)
            elif k.name not in SILENT:
                self.unread[k.place()] = None
        if not self.cells:
            raise ValueError(f"path = {str(file)!r} has no elements")

    def read_nodes(self, k: Keyword) -> None:
        """Nodes, moved with their instance."""
        if "SYSTEM" in k.options:
            raise k.error("coordinates in another SYSTEM are not read: give x, y, z")
        read = np.array([[*k.numbers(at, 3), 0.0][:4] for at in range(len(k.data))]).reshape(-1, 4)
        words = [(line, f"{number:.0f}") for (line, _), number in zip(k.data, read[:, 0], strict=True)]
        self.x += [*_move(k.instance, read[:, 1:])]
        self.number("NSET", k, words, len(self.x))

    def read_elements(self, k: Keyword) -> None:
        """Elements of a kind."""
        kind = k.find(TYPES, k["TYPE"].rstrip(VARIANTS), "element type")
        if self.kind not in (None, kind):
            raise k.error(f"{k['TYPE']} is not of the kind {self.kind}: mesh all bodies with one")
        self.kind = kind
        words, step = k.words(), 1 + kind.count
        if len(words) % step:
            raise k.error(f"some of the {kind.count} nodes of an element are missing")
        for i in range(0, len(words), step):
            nodes = [self.find("NSET", k, *word) for word in words[i + 1 : i + step]]
            self.cells.append(np.concatenate(nodes))
            if len(np.unique(self.cells[-1])) != kind.count:
                line, number = words[i]
                raise k.error(f"element {number} has a node twice", line)
        self.number("ELSET", k, words[::step], len(self.cells))

    def number(self, sort: str, k: Keyword, words: list[tuple[int, str]], end: int) -> None:
        """Number the last rows, and add them to the set of the keyword."""
        rows = np.arange(end - len(words), end)
        for (line, number), row in zip(words, rows, strict=True):
            if k.scope + number in self.rows[sort]:
                raise k.error(f"{SORTS[sort]} {number} is there twice", line)
            self.rows[sort][k.scope + number] = row
        self.add(sort, k, rows)

    def add(self, sort: str, k: Keyword, rows: Longs) -> None:
        """Add to the set of the keyword, if it names one."""
        if name := k.options.get(sort):
            before = self.rows[sort].get(k.scope + name, rows)
            self.rows[sort][k.scope + name] = np.union1d(before, rows)

    def find(self, sort: str, k: Keyword, line: int, word: str) -> Longs:
        """Rows of a number or set."""
        what = SORTS[sort] + " set" * (not word.isdigit())
        return np.atleast_1d(k.find(self.rows[sort], word, what, line))

    def read_set(self, k: Keyword) -> None:
        """A set of nodes or elements."""
        words = k.words()
        if "GENERATE" in k.options:
            ranges = [(line, k.numbers(at, 2)) for at, (line, _) in enumerate(k.data)]
            words = [
                (line, str(number))
                for line, (first, last, *step) in ranges
                for number in range(int(first), int(last) + 1, *map(int, filter(None, step)))
            ]
        of = replace(k, scope=f"{k['INSTANCE']}.") if "INSTANCE" in k.options else k
        rows = [self.find(k.name, of, *word) for word in words]
        self.add(k.name, replace(k, options={k.name: k[k.name]}), np.concatenate([NONE, *rows]))

    def read_surface(self, k: Keyword) -> None:
        """A surface: facets of elements, or the nodes of all facets."""
        sort = "NSET" if k.options.get("TYPE") == "NODE" else "ELSET"
        faces = {f"S{i}": f for i, f in enumerate(FACES[self.kind.cell], 1)}
        found = []
        for line, (word, *labels) in k.data:
            rows = self.find(sort, k, line, _name(word))
            own = [k.find(faces, _name(label), "face", line) for label in labels if label]
            pairs = [(row, face) for row in rows for face in own or faces.values()]
            found.append(rows if sort == "NSET" else np.array(pairs))
        if not found:
            raise k.error("the surface is empty")
        self.surfaces[k.scope + k["NAME"]] = np.concatenate(found)

    def read_section(self, k: Keyword) -> None:
        """A body."""
        self.sections.append((k, self.find("ELSET", k, k.line, k["ELSET"])))

    def read_property(self, k: Keyword) -> None:
        """A material, an interaction, or a property of one."""
        self.properties.setdefault(k.scope, {})[k.name] = k

    def read_joint(self, k: Keyword) -> None:
        """Arguments of interfaces, one of each data line."""
        kind, given = (Tie if k.name == "TIE" else Contact), {}
        if "POSITION TOLERANCE" in k.options:
            tolerance = k.line, [k["POSITION TOLERANCE"]]
            given["within"] = replace(k, data=[tolerance]).numbers(0, 1)[0]
        if "INTERACTION" in k.options:
            own = k.find(self.properties, k["INTERACTION"], "surface interaction")
            given["friction"] = (
                own["FRICTION"].numbers(0, 1)[0] or None if "FRICTION" in own else None
            )
        for line, words in k.data:
            names = [_name(word) for word in words[:2] if word]
            for name in names:
                k.find(self.surfaces, name, "surface", line)
            sides = {"slave": names[0], "master": names[-1]}
            self.joints.append((kind, k.place(line), sides | given))

    def constants(self, section: Keyword) -> dict[str, Any]:
        """Law, DENSITY and EXPANSION of a body, as far as they are constant."""
        own = section.find(self.properties, section["MATERIAL"], "material")
        read = {name: k for name, k in own.items() if _is_constant(k)}
        self.unread |= {k.place(): None for name, k in own.items() if name not in read}
        found = {n: read[n].numbers(0, 1)[0] for n in ("DENSITY", "EXPANSION") if n in read}
        if "ELASTIC" in read and ("PLASTIC" in read) == ("PLASTIC" in own):
            found["law"] = _law(read["ELASTIC"], read.get("PLASTIC"))
        return found

    def finish(self) -> tuple[_Told, Longs, Floats]:
        """What all ranks have to know, cells, and positions of their nodes."""
        kind = self.kind
        owner = np.full(len(self.cells), -1, dtype=np.int32)
        for i, (k, rows) in enumerate(self.sections):
            if (owner[rows] >= 0).any():
                raise k.error("some of its elements are in another section, too")
            owner[rows] = i
        for name, row in self.rows["ELSET"].items():
            if self.sections and np.ndim(row) == 0 and owner[row] < 0:
                raise ValueError(f"{k.file}: the element {name} is in no SOLID SECTION")
        bodies = {k.scope + k["ELSET"]: self.constants(k) for k, _ in self.sections}
        points, order = kind.nodes()
        weights = missing_nodes(kind.cell, points, kind.count)
        used, cells = np.unique(np.array(self.cells), return_inverse=True)
        cells = cells.reshape(-1, kind.count)
        x, (full,) = full_cells(np.array(self.x)[used, : points.shape[1]], (weights, cells))
        # a node is in a set if all of those are that it is computed from
        sources = np.vstack([np.eye(kind.count), weights != 0.0])
        nodes = {}
        for name, rows in self.rows["NSET"].items():
            inside = np.isin(used, rows)[cells] @ sources.T == sources.sum(axis=1)
            if np.ndim(rows) and inside.any():
                nodes[name] = np.unique(full[inside])
        corners = order[kind.facets()]
        for name, rows in self.surfaces.items():
            if rows.ndim == 1:
                self.surfaces[name] = np.argwhere(
                    np.isin(used, rows)[cells[:, corners]].all(axis=2)
                )
        told = kind, owner, bodies or {"BODY": {}}, self.surfaces, nodes, self.joints
        return _Told(*told, [*self.unread]), full[:, order], x


READERS: dict[str, Callable[[_Model, Keyword], None]] = {  # in the order of reading
    "NODE": _Model.read_nodes,
    "ELEMENT": _Model.read_elements,
    "NSET": _Model.read_set,
    "ELSET": _Model.read_set,
    "SURFACE": _Model.read_surface,
    "SOLID SECTION": _Model.read_section,
    **dict.fromkeys((*OWNERS, *PROPERTIES), _Model.read_property),
    "TIE": _Model.read_joint,
    "CONTACT PAIR": _Model.read_joint,
}


def _move(moved: Keyword | None, x: Floats) -> Floats:
    """Positions (n, 3) in an instance: translated, then rotated about a line."""
    if moved and moved.data:
        x = x + [*moved.numbers(0, 2), 0.0][:3]
    if moved and len(moved.data) > 1:
        given = np.array(moved.numbers(1, 7))
        axis = given[3:6] - given[:3]
        turn = Rotation.from_rotvec(np.radians(given[6]) * axis / np.linalg.norm(axis))
        x = given[:3] + turn.apply(x - given[:3])
    return x


def _is_constant(k: Keyword) -> bool:
    """Whether a property is isotropic and has one row, of plasticity up to two."""
    strains = [[*k.numbers(at, 1), 0.0][1] for at in range(len(k.data))]
    rows = strains == [0.0] or (len(strains) == 2 and 0.0 == strains[0] < strains[1])
    known = k.options.get("HARDENING", "ISOTROPIC") in ("ISOTROPIC", "KINEMATIC")
    isotropic = k.options.get("TYPE", "ISO") in ("ISO", "ISOTROPIC")
    return isotropic and known and (rows if k.name == "PLASTIC" else len(strains) < 2)


def _law(elastic: Keyword, plastic: Keyword | None) -> Elastic | VonMises:
    """Law of constants of uniaxial loading."""
    E, nu = elastic.numbers(0, 2)[:2]
    try:
        if plastic is None:
            return Elastic(E, nu)
        first, last = (plastic.numbers(at, 1) for at in (0, len(plastic.data) - 1))
        slope = (last[0] - first[0]) / last[1] if len(plastic.data) > 1 else 0.0
        isotropic = float(plastic.options.get("HARDENING") != "KINEMATIC")
        return VonMises.from_uniaxial(E, nu, first[0], slope, isotropic=isotropic)
    except ValueError as error:
        raise elastic.error(error) from error


def _distribute(told: _Told, comm: MPI.Intracomm, cells: Longs, x: Floats, name: str) -> Deck:
    """Mesh, tags, laws and interfaces of a deck read by rank 0; collective."""
    kind = told.kind
    points, facets = kind.nodes()[0], kind.facets()
    n, dim = points.shape
    variant = basix.LagrangeVariant.equispaced
    element = basix.ufl.element("P", kind.cell, kind.degree, lagrange_variant=variant, shape=(dim,))
    cells, x = cells.reshape(-1, n), np.ascontiguousarray(x.reshape(-1, dim))
    domain = dmesh.create_mesh(comm, cells=cells, e=element, x=x)
    domain.name = name
    original = domain.topology.original_cell_index
    every = np.arange(len(original), dtype=np.int32)
    cell_tags = dmesh.meshtags(domain, dim, every, told.owner[original] + 1)
    cell_tags.name = "bodies"
    domain.topology.create_entities(dim - 1)
    domain.topology.create_connectivity(dim - 1, dim)
    exterior = dmesh.exterior_facet_indices(domain.topology)
    own_facets = domain.topology.connectivity(dim, dim - 1).array.reshape(-1, len(facets))
    own_cell = np.full(len(told.owner), -1)
    own_cell[original] = every
    surfaces = {}
    for surface, (of, facet) in {s: rows.T for s, rows in told.surfaces.items()}.items():
        here = own_cell[of] >= 0
        found = np.intersect1d(own_facets[own_cell[of[here]], facet[here]], exterior)
        if not comm.allreduce(len(found)):
            raise ValueError(f"the surface {surface!r} has no facet on the boundary of a body")
        surfaces[surface] = found.astype(np.int32)
    facet_tags, shared = _tag_facets(domain, surfaces)
    if shared and comm.rank == 0:
        log.warning(
            "%s: the surfaces %s share facets with others and are not in facet_tags; "
            "deck.tags(name) has them",
            *(name, ", ".join(shared)),
        )
    number = np.asarray(domain.geometry.input_global_indices)
    of_bodies = [
        {body: given[what] for body, given in told.bodies.items() if what in given}
        for what in ("law", "DENSITY", "EXPANSION")
    ]
    deck = Deck(
        domain,
        Tags(cell_tags, {body: i for i, body in enumerate(told.bodies, 1)}),
        facet_tags,
        kind.kinematics,
        *of_bodies,
        [],
        told.unread,
        surfaces,
        {n: np.flatnonzero(np.isin(number, r)).astype(np.int32) for n, r in told.nodes.items()},
    )
    for joint, place, given in told.joints:
        try:
            tags = deck.tags(*dict.fromkeys([given["slave"], given["master"]]))
            deck.interfaces.append(joint(tags, **given))
        except ValueError as error:
            raise ValueError(f"{place}: {error}") from error
    return deck


def _tag_facets(domain: dmesh.Mesh, surfaces: Mapping[str, Ints]) -> tuple[Tags, list[str]]:
    """Tags 1, 2 .. of surfaces in order, and those left out for facets of others; collective."""
    values = np.zeros(domain.topology.index_map(domain.topology.dim - 1).size_local, dtype=np.int32)
    names, left = {}, []
    for i, (name, facets) in enumerate(surfaces.items(), 1):
        if domain.comm.allreduce(int(values[facets].any())):
            left.append(name)
        else:
            names[name] = values[facets] = i
    marked = np.flatnonzero(values).astype(np.int32)
    tags = dmesh.meshtags(domain, domain.topology.dim - 1, marked, values[marked])
    tags.name = "boundary"
    return Tags(tags, names), left

# SPDX-License-Identifier: MIT
"""Decks of Abaqus and CalculiX: mesh, sets, surfaces, laws and proposed interfaces."""

import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import product, zip_longest
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
from scipy.spatial.transform import Rotation

from dolfinx_mortar.algebra.parallel import named, raised_together
from dolfinx_mortar.common.arguments import check, instance
from dolfinx_mortar.common.arrays import Floats, Longs
from dolfinx_mortar.common.disk import check_path
from dolfinx_mortar.interfaces.contact import Contact
from dolfinx_mortar.interfaces.tie import Tie
from dolfinx_mortar.materials.elastic import Elastic
from dolfinx_mortar.materials.plasticity import VonMises
from dolfinx_mortar.meshing.deck import CELLS, TYPES, Deck, complete, find_name

VARIANTS = "RHIMTS"  # reduced, hybrid, incompatible, modified, thermal, stresses at surfaces
NUMBERED = {"NSET": "NODE", "ELSET": "ELEMENT"}
OWNERS = "MATERIAL", "SURFACE INTERACTION"
PROPERTIES = *OWNERS, "PLASTIC", "ELASTIC", "DENSITY", "EXPANSION", "FRICTION"
# What says how, not what, or holds other keywords.
SILENT = {"", "HEADING", "ASSEMBLY", "END ASSEMBLY"}
TEXTS = "|".join(["INCLUDE", *NUMBERED, *NUMBERED.values()])
INPUT = re.compile(rf"\* *({TEXTS}) *,.*\bINPUT *= *\"?([^\",]+)", re.IGNORECASE)


def read_inp(path: str | os.PathLike[str], comm: MPI.Intracomm = MPI.COMM_WORLD) -> Deck:
    """Read a deck of Abaqus or CalculiX (collective).

        deck = dm.meshing.read_inp("bearing.inp")
        u = fem.Function(fem.functionspace(deck.mesh, ("Lagrange", 1, (3,))))
        solid = dm.Solid(u, deck.materials, deck.cell_tags, kinematics=deck.kinematics)
        bcs = [fem.dirichletbc(np.zeros(3), deck.dofs(u.function_space, "FIXED"), u.function_space)]
        problem = dm.ContactProblem(solid, deck.interfaces, bcs=bcs)

    Read are NODE, ELEMENT (C3D4, C3D10, C3D8, C3D20; CPE, CPS, CAX with 3, 4, 6, 8 nodes; letters
    R, H, I, M, T or S are left out), NSET, ELSET, SURFACE, TIE, CONTACT PAIR with FRICTION, SOLID
    SECTION with ELASTIC, PLASTIC (of one or two points), DENSITY, EXPANSION, PART, INSTANCE and
    INCLUDE; all else is listed in ``unread``. Cells of 8 and 20 nodes that lack nodes get them by
    their own shape functions. Names are in capitals, those of a part INSTANCE.NAME. Bodies that
    share nodes are one. Rank 0 reads and distributes.

    Args:
        path: the file; included ones are searched for beside the one that names them.
        comm: communicator of the mesh.

    Raises:
        OSError: if a file is missing or cannot be read.
        ValueError: naming file and line: for unknown or mixed kinds of elements, sets, surfaces,
            materials and nodes that do not exist, and elements in no section or in two.
    """
    check("comm", comm, instance(MPI.Intracomm, "give a communicator, such as MPI.COMM_WORLD"))
    file = check_path(comm, path)
    read = None
    with raised_together(comm):
        if comm.rank == 0:
            read = _Model(file).finish()
    return Deck(comm, file.stem, read)


@dataclass
class Keyword:
    """A keyword with its options and data lines, (place, words)."""

    place: str
    name: str
    options: dict[str, str] = field(default_factory=dict)
    data: list[tuple[str, list[str]]] = field(default_factory=list)
    scope: str = ""  # before names: an instance and a dot; a material or interaction
    instance: "Keyword | None" = None

    def __getitem__(self, option: str) -> str:
        if not self.options.get(option):
            raise ValueError(f"{option}= is missing")
        return self.options[option]

    def rows(self) -> Iterator[list[str]]:
        """Words of each data line, whose place is that of the keyword meanwhile."""
        if not self.data:
            raise ValueError("data are missing")
        place = self.place
        for at, words in self.data:
            self.place = f"{at}, *{self.name}"
            yield words
        self.place = place

    def words(self) -> Iterator[str]:
        """All words."""
        return (word for words in self.rows() for word in words if word)

    def numbers(self, least: int) -> Iterator[list[float]]:
        """Numbers of each data line, at least so many."""
        return (_numbers(words, least) for words in self.rows())

    def find(self, known: Mapping[str, Any], name: str, sort: str) -> Any:
        """What has a name in the scope, or else in the deck."""
        return find_name(known, self.scope + name if self.scope + name in known else name, sort)


def _numbers(words: list[str], least: int) -> list[float]:
    text = ", ".join(words).rstrip(", ").replace("D", "E")
    try:
        found = [float(word or 0) for word in text.split(", ") if text]
    except ValueError:
        found = []
    if len(found) < least or not np.isfinite(found).all():
        raise ValueError(f"{text!r}: give {least} finite numbers")
    return found


def _lines(file: Path, by: str = "path", above: tuple[Path, ...] = ()) -> Iterator[tuple[str, str]]:
    """Places and texts of the lines of a file and of those that it includes."""
    if not file.is_file() or file.resolve() in above:
        why = "includes itself" if file.is_file() else "there is no such file"
        raise FileNotFoundError(f"{by} = {str(file)!r}: {why}")
    for number, line in enumerate(file.read_text(errors="replace").splitlines(), 1):
        place, text = f"{file}, line {number}", line.strip()
        found = INPUT.match(text)
        if text and not text.startswith("**") and not (found and found[1].upper() == "INCLUDE"):
            yield place, text.upper().replace('"', "")
        if found:
            other = file.parent / found[2].strip()
            yield from _lines(other, f"{place}: INPUT", (*above, file.resolve()))


def _keywords(lines: Iterator[tuple[str, str]]) -> Iterator[Keyword]:
    """Keywords with their data."""
    found, begun = Keyword("", ""), ""
    for place, line in lines:
        text = begun + line
        begun = text if text[0] == "*" and text[-1] == "," else ""
        words = [word.strip() for word in text.lstrip("*").split(",")]
        if text[0] != "*":
            found.data.append((place, words))
        elif not begun:
            yield found
            pairs = (word.partition("=") for word in words[1:])
            options = {key.strip(): value.strip() for key, _, value in pairs}
            name = " ".join(words[0].split())
            found = Keyword(f"{place}, *{name}", name, options)
    yield found


def _entries(keywords: Iterable[Keyword]) -> Iterator[Keyword]:
    """Keywords in their scope, those of parts once for each instance."""
    parts: dict[str, list[Keyword]] = {}
    part, scope, owner = None, "", ""
    for k in keywords:
        with named(k.place):
            if k.name == "PART":
                part = parts[k["NAME"]] = []
            elif k.name == "INSTANCE":
                scope = f"{k['NAME']}."
                for own in k.find(parts, k["PART"], "part"):
                    yield replace(own, scope=scope, instance=k)
            elif k.name in ("END PART", "END INSTANCE"):
                part, scope = None, ""
            elif part is not None:
                part.append(k)
            else:
                owner = k["NAME"] if k.name in OWNERS else owner
                yield replace(k, scope=owner if k.name in PROPERTIES else scope)


class _Model:
    """A deck on the rank that reads it."""

    def __init__(self, file: Path) -> None:
        self.kind: Any = None
        self.x: list[Floats] = []
        self.cells: list[list[int]] = []
        # by number and by name of a set
        self.rows: dict[str, dict[str, list[int]]] = {sort: {} for sort in READERS}
        self.surfaces: dict[str, Longs] = {}  # elements and their facets (n, 2)
        self.properties: dict[str, dict[str, Any]] = {}  # of materials and interactions
        self.bodies: dict[str, dict[str, Any]] = {}
        self.owner: dict[int, int] = {}
        self.joints: list[tuple[type[Contact | Tie], str, dict[str, Any]]] = []
        self.unread: list[str] = []
        order = {name: i for i, name in enumerate(READERS)}
        entries = _entries(_keywords(_lines(file)))
        for k in sorted(entries, key=lambda k: order.get(k.name, len(order))):
            try:
                READERS.get(k.name, _Model.leave)(self, k)
            except ValueError as error:
                raise ValueError(f"{k.place}: {error}") from error
        if not self.cells:
            raise ValueError(f"path = {str(file)!r} has no elements")

    def leave(self, k: Keyword) -> None:
        """Tell what is not read."""
        if k.name not in SILENT and k.place not in self.unread:
            self.unread.append(k.place)

    def read_nodes(self, k: Keyword) -> None:
        """Nodes, moved with their instance."""
        if "SYSTEM" in k.options:
            raise ValueError("coordinates in another SYSTEM are not read: give x, y, z")
        read = np.array([[*row, 0.0][:4] for row in k.numbers(3)])
        for i, number in enumerate(read[:, 0], len(self.x)):
            self.add("NSET", k, f"{number:.0f}", i)
        self.x += [*_move(k.instance, read[:, 1:])]

    def read_elements(self, k: Keyword) -> None:
        """Elements of a kind."""
        kind = k.find(TYPES, k["TYPE"].rstrip(VARIANTS), "element type")
        if self.kind not in (None, kind):
            raise ValueError(f"{k['TYPE']} beside {self.kind.name}: mesh all bodies with one kind")
        self.kind = kind
        for number, *nodes in zip_longest(*[k.words()] * (kind.size + 1)):
            if None in nodes:
                raise ValueError(f"element {number} has fewer than {kind.size} nodes")
            cell = self.find("NSET", k, nodes)
            if len({*cell}) < kind.size:
                raise ValueError(f"element {number} has a node twice")
            self.add("ELSET", k, number, len(self.cells))
            self.cells.append(cell)

    def add(self, sort: str, k: Keyword, number: str, row: int) -> None:
        """Number a row, and add it to the set of the keyword."""
        if k.scope + number in self.rows[k.name]:
            raise ValueError(f"{number} is there twice")
        self.rows[k.name][k.scope + number] = [row]
        if name := k.options.get(sort):
            self.rows[sort].setdefault(k.scope + name, []).append(row)

    def find(self, sort: str, k: Keyword, words: Iterable[str]) -> list[int]:
        """Rows of numbers and sets."""
        sorts = ((NUMBERED[sort] if word.isdigit() else sort, word) for word in words)
        return [row for of, word in sorts for row in k.find(self.rows[of], word, of)]

    def read_set(self, k: Keyword) -> None:
        """A set of nodes or elements."""
        of = replace(k, scope=f"{k['INSTANCE']}.") if "INSTANCE" in k.options else k
        words = k.words()
        if "GENERATE" in k.options:
            ranges = (map(int, row) for row in k.numbers(2))
            numbers = (str(n) for low, high, *by in ranges for n in range(low, high + 1, *by))
            words = (n for n in numbers if of.scope + n in self.rows[NUMBERED[k.name]])
        known = self.rows[k.name].setdefault(k.scope + k[k.name], [])
        known += self.find(k.name, of, words)

    def read_surface(self, k: Keyword) -> None:
        """A surface of facets of elements, or of those whose corners are nodes of it."""
        if k.options.get("TYPE") == "NODE":
            corners = np.array(self.cells)[:, self.kind.corners()]
            rows = np.argwhere(np.isin(corners, self.find("NSET", k, k.words())).all(axis=2))
        else:
            faces = {f"S{i}": face for i, face in enumerate(CELLS[self.kind.cell][1], 1)}
            pairs: list[tuple[int, int]] = []
            for word, *labels in k.rows():
                own = [k.find(faces, label, "face") for label in labels if label]
                pairs += product(self.find("ELSET", k, [word]), own or faces.values())
            rows = np.array(pairs, dtype=np.int64).reshape(-1, 2)
        self.surfaces[k.scope + k["NAME"]] = rows

    def read_section(self, k: Keyword) -> None:
        """A body."""
        rows = self.find("ELSET", k, [k["ELSET"]])
        if self.owner.keys() & {*rows}:
            raise ValueError("some of its elements are in another section, too")
        self.owner |= dict.fromkeys(rows, len(self.bodies))
        self.bodies[k.scope + k["ELSET"]] = k.find(self.properties, k["MATERIAL"], "material")

    def read_property(self, k: Keyword) -> None:
        """A material, an interaction, or a property of it, None if not constant and isotropic."""
        own = self.properties.setdefault(k.scope, {})
        if k.name in OWNERS:
            return
        kinds = {k.options.get(option, "ISO")[:3] for option in ("TYPE", "HARDENING")}
        least = 2 if k.name == "ELASTIC" and kinds == {"ISO"} else 1
        rows = [[*row, 0.0] for row in k.numbers(least)]
        (first, start), (last, end) = rows[0][:2], rows[-1][:2]
        rising = k.name == "PLASTIC" and start == 0.0 < end
        own[k.name] = first
        if len(rows) > 1 + rising or kinds - {"ISO", "KIN"}:
            own[k.name] = None
            self.leave(k)
        elif k.name == "PLASTIC":
            modulus = (last - first) / (end or 1.0)
            own[k.name] = first, modulus, float("KIN" not in kinds)
        elif k.name == "ELASTIC" and "PLASTIC" not in own:
            own["law"] = Elastic(first, start)
        elif k.name == "ELASTIC" and own["PLASTIC"]:
            stress, modulus, isotropic = own["PLASTIC"]
            own["law"] = VonMises.from_uniaxial(first, start, stress, modulus, isotropic=isotropic)

    def read_joint(self, k: Keyword) -> None:
        """Arguments of interfaces, one of each data line."""
        if {"CYCLIC SYMMETRY", "MULTISTAGE"} & k.options.keys():
            return self.leave(k)
        kind = Tie if k.name == "TIE" else Contact
        given: dict[str, Any] = {}
        if "POSITION TOLERANCE" in k.options:
            given["within"] = float(k["POSITION TOLERANCE"])
        if "INTERACTION" in k.options:
            own = k.find(self.properties, k["INTERACTION"], "surface interaction")
            given["friction"] = own.get("FRICTION") or None
        for words in k.rows():
            slave, *other = filter(None, words[:2])
            sides = {"slave": slave, "master": other[0] if other else slave}
            self.joints.append((kind, k.place, sides | given))

    def finish(self) -> tuple[Any, Longs, Floats]:
        """What all ranks have to know, cells, and positions of their nodes."""
        lost = {*range(len(self.cells))} - self.owner.keys()
        if self.bodies and lost:
            name = next(name for name, (row,) in self.rows["ELEMENT"].items() if row in lost)
            raise ValueError(f"element {name} is in no SOLID SECTION")
        mesh = np.array(self.cells), np.array(self.x)
        cells, x, nodes = complete(self.kind, *mesh, self.rows["NSET"])
        owner = np.array([self.owner.get(i, 0) for i in range(len(cells))], dtype=np.int32)
        parts = self.bodies or {"BODY": {}}, self.surfaces, nodes
        return (self.kind, owner, *parts, self.joints, self.unread), cells, x


READERS: dict[str, Callable[[_Model, Keyword], None]] = {  # in the order of reading
    "NODE": _Model.read_nodes,
    "ELEMENT": _Model.read_elements,
    "NSET": _Model.read_set,
    "ELSET": _Model.read_set,
    "SURFACE": _Model.read_surface,
    **dict.fromkeys(PROPERTIES, _Model.read_property),
    "SOLID SECTION": _Model.read_section,
    "TIE": _Model.read_joint,
    "CONTACT PAIR": _Model.read_joint,
}


def _move(moved: Keyword | None, x: Floats) -> Floats:
    """Positions (n, 3) in an instance: translated, then rotated about a line."""
    rows = [*moved.numbers(2)] if moved and moved.data else [[]]
    x = x + [*rows[0], 0.0, 0.0, 0.0][:3]
    for *line, angle in (row[:7] for row in rows[1:]):
        start, end = np.reshape(line, (2, 3))
        axis = (end - start) / np.linalg.norm(end - start)
        x = start + Rotation.from_rotvec(np.radians(angle) * axis).apply(x - start)
    return x

# SPDX-License-Identifier: MIT
"""The layers of the package and the imports between them (ARCHITECTURE.md)."""

import ast
import functools
import re
import types
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import dolfinx_mortar
from dolfinx_mortar.interfaces.interface import Interface

PACKAGE = Path(dolfinx_mortar.__file__).parent

# Layer -> the layers it may import.
BELOW = {
    "common": set(),
    "algebra": {"common"},
    "geometry": {"common"},
    "materials": {"common"},
    "shapes": {"common"},
    "analytic": {"common"},
    "meshing": {"common", "algebra", "interfaces", "materials"},
    "output": {"common", "algebra", "materials"},
    "qp": {"common", "algebra"},
    "mortar": {"common", "algebra", "geometry"},
    "solid": {"common", "algebra", "geometry", "materials"},
    "terms": {"common", "algebra", "solid"},
    "interfaces": {"common", "algebra", "geometry", "mortar", "shapes"},
    "audit": {"common", "algebra", "geometry", "mortar", "interfaces", "solid"},
    "persistence": {"common", "algebra", "interfaces", "materials", "solid"},
    "plotting": {"common", "algebra", "interfaces", "mortar", "solid"},
    "problem": {
        *("common", "algebra", "mortar", "interfaces", "solid", "terms", "qp"),
        *("audit", "persistence"),
    },
    "report": {
        *("common", "algebra", "geometry", "mortar", "interfaces", "materials", "solid"),
        *("audit", "persistence", "problem"),
    },
    "heat": {"common", "algebra", "interfaces", "mortar", "solid"},
    "steps": {
        *("common", "algebra", "mortar", "interfaces", "solid", "terms", "qp"),
        *("audit", "persistence", "problem", "report", "heat"),
    },
    "sensitivity": {
        *("common", "algebra", "interfaces", "persistence", "problem", "qp", "report"),
    },
}
FLOORS = 8
FOREIGN = {  # libraries that a layer must not import
    "geometry": {"dolfinx", "petsc4py", "mpi4py", "ufl"},
    "algebra": {"dolfinx", "ufl", "basix"},
    "qp": {"dolfinx", "ufl", "basix"},
    "materials": {"dolfinx", "petsc4py", "mpi4py"},
    "shapes": {"dolfinx", "petsc4py", "mpi4py"},
}


@functools.cache
def nodes(file):
    """Return all nodes of a file's syntax tree, the module first."""
    return list(ast.walk(ast.parse(file.read_text())))


def imported(file):
    """Yield the dotted names that a file imports, also inside functions and for types only."""
    for node in nodes(file):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file}: imports are absolute"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def layers():
    """Return (file, its layer, the layers it imports, the libraries it imports)."""
    found = []
    for file in sorted(PACKAGE.rglob("*.py")):
        parts = file.relative_to(PACKAGE).with_suffix("").parts
        if parts == ("__init__",):
            continue
        names = [name.split(".") for name in imported(file)]
        ours = {name[1] for name in names if name[0] == "dolfinx_mortar"}
        found.append((file, parts[0], ours - {parts[0]}, {name[0] for name in names}))
    return found


def test_no_two_modules_share_a_name():
    """A sub-package may have a module of its own name."""
    packages = [p.parent.name for p in PACKAGE.rglob("__init__.py") if p.parent != PACKAGE]
    modules = [p for p in PACKAGE.rglob("*.py") if p.stem not in ("__init__", p.parent.name)]
    names = packages + [p.stem for p in modules]
    assert sorted(names) == sorted(set(names))


def test_imports_point_down():
    wrong = {
        str(file.relative_to(PACKAGE)): sorted(ours - BELOW[layer])
        for file, layer, ours, _ in layers()
        if ours - BELOW[layer]
    }
    assert not wrong


def test_layers_form_no_cycle():
    TopologicalSorter(BELOW).prepare()
    floors = {}
    for layer in TopologicalSorter(BELOW).static_order():
        floors[layer] = 1 + max((floors[below] for below in BELOW[layer]), default=0)
    assert max(floors.values()) <= FLOORS
    with pytest.raises(CycleError):
        TopologicalSorter(BELOW | {"algebra": {"steps"}}).prepare()


def test_modules_form_no_cycle():
    """Also within a layer, and also in imports for types only."""
    files = [f for f in PACKAGE.rglob("*.py") if f.stem != "__init__"]
    modules = {".".join(f.relative_to(PACKAGE.parent).with_suffix("").parts): f for f in files}
    graph = {}
    for module, file in modules.items():
        names = {part for name in imported(file) for part in (name, name.rpartition(".")[0])}
        graph[module] = names & modules.keys()
    TopologicalSorter(graph).prepare()


def test_modules_with_a_cache_have_one_name():
    """What numba keeps under one name of a module stops programs that know it by another."""
    folder = Path(__file__).parent
    cached = [f.stem for f in folder.rglob("*.py") if "@numba.njit(cache=True)" in f.read_text()]
    assert "pointwise_laws" in cached
    files = [*folder.rglob("*.py"), *(folder.parent / "benchmarks").glob("*.py")]
    short = re.compile(rf"^\s*(from|import) ({'|'.join(cached)})\b", re.MULTILINE)
    assert [str(f) for f in files if short.search(f.read_text())] == []


def test_layers_import_no_foreign_library():
    wrong = {
        str(file.relative_to(PACKAGE)): sorted(libraries & FOREIGN.get(layer, set()))
        for file, layer, _, libraries in layers()
        if libraries & FOREIGN.get(layer, set())
    }
    assert not wrong


def test_every_layer_has_a_docstring():
    for layer in BELOW:
        if [*(PACKAGE / layer).glob("*.py")]:
            assert ast.get_docstring(nodes(PACKAGE / layer / "__init__.py")[0])


def creations(file):
    """Yield the calls that create an object of PETSc on a communicator."""
    of_petsc = "PETSc." in file.read_text()
    for call in nodes(file):
        text = ast.unparse(call) if of_petsc and isinstance(call, ast.Call) else ""
        if re.match(r"PETSc\.(IS|KSP|Mat|NullSpace|PC|SF|TAO|Vec)\(\)\.create", text):
            yield text


def test_objects_of_petsc_name_their_communicator():
    """The default is the world: a problem on fewer ranks would wait for all other ranks."""
    made = [text for file in PACKAGE.rglob("*.py") for text in creations(file)]
    assert len(made) > 20
    of_arguments = "createDiagonal"  # takes that of its vector
    assert [t for t in made if "comm" not in t.lower() and of_arguments not in t] == []


# Named numbers without influence on results: file formats, capabilities, error codes.
FORMATS = """
    FORMAT HEAD INDEX HEADER RECORD CELLS GMSH_OPTIONS KINDS WORKSPACE_ERRORS MEMORY_ERRORS
    OUT_OF_MEMORY OUT_OF_RANGE HIGHEST HIGHEST_RULE
""".split()
# Sizes of pictures, messages and buffers.
SIZES = "CHUNK GRID VERTICES".split()
# Tables of elements, components and differences, samples of checks, a published mesh.
TABLES = """
    LINE2 LINE3 TRI3 TRI6 QUAD4 QUAD9 FACETS_OF ANYWHERE _CORNERS WEIGHTS
    STRETCHES VOLUMES SIZES PATHS NORMAL COMPONENTS GRADIENT INDEX FIRST SECOND
    THIRD
    TURNS
""".split()
TAGS = "LOOSE TIGHT FACE EDGE POINT".split()
# What arguments have to be; the errors say it.
RULES = "POSITIVE NOT_NEGATIVE POISSON LENGTH CREASE".split()


def test_named_numbers_are_few():
    """At most seventy that are no format, size, table or tag; those have tests of their own."""
    names = [
        (file.stem, name.id)
        for file in PACKAGE.rglob("*.py")
        for node in nodes(file)[0].body
        for name in assigned_numbers(node)
    ]
    known = {*FORMATS, *SIZES, *TABLES, *TAGS, *RULES}
    assert known <= {name for _, name in names}
    left = [pair for pair in names if pair[1] not in known or pair == ("fit", "EDGE")]
    assert len(left) <= 70, sorted(left)


def assigned_numbers(node):
    """Return the names of constants that a statement of a module assigns numbers to."""
    if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
        return []
    numbers = [
        part
        for part in ast.walk(node.value)
        if isinstance(part, ast.Constant) and type(part.value) in (int, float)
    ]
    target = node.targets[0] if isinstance(node, ast.Assign) else node.target
    names = target.elts if isinstance(target, ast.Tuple) else [target]
    return [n for n in names if numbers and isinstance(n, ast.Name) and n.id.strip("_").isupper()]


def test_classes_have_little_state():
    """At most ten attributes change after construction: more are more than one subject."""
    kinds = [
        kind
        for file in PACKAGE.rglob("*.py")
        for kind in nodes(file)
        if isinstance(kind, ast.ClassDef)
    ]
    assert not {kind.name: found for kind in kinds if len(found := state(kind)) > 10}


def state(kind):
    """Return the names that methods of a class set on self, its construction apart."""
    return {
        node.attr
        for method in kind.body
        if isinstance(method, ast.FunctionDef)
        if method.name not in ("__init__", "__post_init__")
        for node in ast.walk(method)
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store)
        if isinstance(node.value, ast.Name) and node.value.id == "self"
    }


def test_an_interface_answers_fifteen_questions():
    """What one kind alone needs stays in that kind."""
    kinds = types.FunctionType, property
    own = [name for name, member in vars(Interface).items() if isinstance(member, kinds)]
    assert len(own) <= 15, own

# SPDX-License-Identifier: MIT
"""The documentation: its programs run, its names exist, all public names are described."""

import dataclasses
import doctest
import functools
import importlib
import importlib.util
import inspect
import json
import logging
import re
import sys
from pathlib import Path

import pytest

import dolfinx_mortar as dm

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
SOURCES = sorted(p for p in DOCS.rglob("*.md") if not {"_build", "generated"} & set(p.parts))
TOOLS = ["docstrings", "elsewhere", "gallery", "links", "tables"]


def programs(path):
    """Return the Python programs of a page."""
    return re.findall(r"```python\n(.*?)```", path.read_text(), re.DOTALL)


def tool(name):
    """Import a tool of the documentation."""
    file = DOCS / "tools" / f"{name}.py"
    spec = importlib.util.spec_from_file_location(f"docs_{name}", file)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def resolve(name):
    """Return what a dotted name stands for; AttributeError if there is none."""
    parts = name.split(".")
    for k in range(1, len(parts) + 1):  # a sub-package and a function may share a name
        try:
            found = importlib.import_module(".".join(parts[:k]))
            return functools.reduce(getattr, parts[k:], found)
        except (AttributeError, ModuleNotFoundError):
            continue
    raise AttributeError(name)


def missing(names):
    """Return the names that stand for nothing."""
    wrong = []
    for name in sorted(names):
        try:
            resolve(name)
        except AttributeError:
            wrong.append(name)
    return wrong


# -- programs --------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.serial
def test_the_tutorial_runs():
    """From Gmsh to the picture; the audit has nothing to warn of, as the text says."""
    tool("gallery").run_tutorial()  # unless docs/build has done so
    folder = DOCS / "generated" / "tutorial"
    said = (folder / "said.txt").read_text()
    assert "2 bodies, 1 interfaces" in said and "warning" not in said
    assert "converged in" in said and "NOT" not in said
    written = {path.name for path in folder.iterdir()}
    assert {"stamp.xdmf", "mesh.png", "pressure.png", "stress.png"} <= written


@pytest.mark.serial
@pytest.mark.slow
def test_the_programs_of_the_guide_run(tmp_path, monkeypatch, caplog, capsys):
    """Those of each page after the one of the first page, as its readers paste them."""
    monkeypatch.chdir(tmp_path)
    caplog.set_level(logging.INFO, "dolfinx_mortar")  # they set it, too, and it is put back
    first = {}
    (begin,) = programs(DOCS / "index.md")
    assert len([line for line in begin.splitlines() if line.strip()]) <= 25
    exec(compile(begin, "index.md", "exec"), first)
    assert "converged in" in capsys.readouterr().out and (tmp_path / "out.xdmf").exists()
    for draw in programs(DOCS / "tutorial.md")[:2]:  # the mesh that a page reads
        exec(compile(draw, "tutorial.md", "exec"), first)
    pages = sorted(p for p in (DOCS / "guide").glob("*.md") if programs(p) and p != HOW_TO)
    assert len(pages) > 10
    for page in pages:
        names = dict(first)
        for code in programs(page):
            exec(compile(code, f"guide/{page.name}", "exec"), names)


HOW_TO = DOCS / "guide" / "howto.md"
LONG = "A bolt circle"  # half a minute
RECIPES = {text.splitlines()[0]: text for text in re.split(r"(?m)^## ", HOW_TO.read_text())[1:]}


@pytest.mark.serial
@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.slow] if n == LONG else []) for n in RECIPES]
)
def test_every_recipe_is_a_whole_program(name, tmp_path, monkeypatch, capsys):
    """It says what its comments promise: every number that stands behind a print is shown."""
    monkeypatch.chdir(tmp_path)
    code = "\n".join(re.findall(r"```python\n(.*?)```", RECIPES[name], re.DOTALL))
    exec(compile(code, f"how to: {name}", "exec"), {})
    said = capsys.readouterr().out
    promised = re.findall(r"(?m)^ *print\(.*\)  # (.+)$", code)
    assert promised and all(words in said for words in promised), said


def test_no_program_of_the_pages_escapes():
    """What shall not be run has another form: a code-block, or the README's fragments."""
    for page in SOURCES:
        assert not re.findall(r"(?m)^```(?:py|python3|pycon|ipython)$", page.read_text()), page


# -- names -----------------------------------------------------------------------------------------


def public():
    """Return the full names of all that is public."""
    modules = [dm, dm.analytic, dm.materials, dm.meshing, dm.plotting, dm.shapes]
    return {id(getattr(m, n)): f"{m.__name__}.{n}" for m in modules for n in m.__all__}


def called_by_users():
    """Yield (name, function) of all that is called: no records and errors, which others make."""
    for name in public().values():
        found = resolve(name)
        kinds = getattr(found, "__mro__", ())
        made = dataclasses.is_dataclass(found) and dm.Material not in kinds
        if callable(found) and not made and Exception not in kinds:
            yield name, found
            methods = inspect.getmembers(found, inspect.isfunction) if kinds else []
            yield from ((f"{name}.{method}", function) for method, function in methods)


def test_every_option_is_in_the_guide():
    """Arguments that may be left out or need their name; of methods, those that the guide calls."""
    text = "".join(page.read_text() for page in sorted((DOCS / "guide").glob("*.md")))
    code = " ".join(re.findall(r"```.*?```|`[^`\n]+`", text, re.DOTALL))
    methods = set(re.findall(r"\.(\w+)\b", code))
    named = {*re.findall(r"\b(\w+) ?=", code), *re.findall(r"[(,]\s*(\w+)(?=[,)])", code)}
    options = {
        (name, argument.name)
        for name, function in called_by_users()
        if inspect.isclass(function) or name in public().values() or name.split(".")[-1] in methods
        for argument in inspect.signature(function).parameters.values()
        if argument.kind is argument.KEYWORD_ONLY or argument.default is not argument.empty
    }
    assert len(options) > 150
    assert not {option for option in options if option[1] not in named}


def described():
    """Return the names that the reference describes."""
    kinds = r"\.\. (?:auto\w+|py:module):: ([\w.]+)"
    return {n for p in (DOCS / "api").glob("*.md") for n in re.findall(kinds, p.read_text())}


def test_every_public_name_is_in_the_reference():
    found = described()
    objects = {id(resolve(name)) for name in found}
    assert not {name for key, name in public().items() if key not in objects}


def test_every_name_of_the_pages_exists():
    roles = {
        name
        for page in SOURCES
        for name in re.findall(r"\{(?:py:\w+|source)\}`~?([\w.]+)`", page.read_text())
    }
    spoken = {
        f"dolfinx_mortar.{name}"
        for page in [*SOURCES, ROOT / "README.md"]
        for name in re.findall(r"\bdm\.([\w.]*\w)", page.read_text())
    }
    assert len(roles) > 50 and len(spoken) > 20
    assert not missing(roles | spoken | described())


def test_files_and_tests_that_pages_name_exist():
    named = r"`((?:docs|tests|demos|benchmarks|containers|dolfinx_mortar|paper)/[\w./]*\w)"
    files = {f for p in SOURCES for f in re.findall(named, p.read_text())}
    assert len(files) > 8
    made = {f for f in files if f.startswith("docs/_build")}
    assert not {f for f in files - made if not (ROOT / f).exists()}
    text = (ROOT / "ARCHITECTURE.md").read_text()
    for file, name in re.findall(r"`(test_\w+\.py)(?:::(\w+))?`", text):
        assert f"def {name}" in (ROOT / "tests" / file).read_text()


def test_every_equation_has_a_function_and_a_test():
    """Equations 1 to 20 of the paper, and what is beyond them."""
    text = (DOCS / "theory.md").read_text()
    sections = re.split(r"(?m)^### ", text)[1:]
    numbers = set()
    for section in sections:
        tests = re.findall(r"```\{test\} ((?:contracts/)?test_\w+\.py)::(\w+)", section)
        assert tests and "{source}`" in section, section.splitlines()[0]
        for file, name in tests:
            assert f"def {name}(" in (ROOT / "tests" / file).read_text()
        if heading := re.match(r"Equations? (\d+)(?: (?:to|and) (\d+))?:", section):
            first, last = int(heading[1]), int(heading[2] or heading[1])
            numbers |= set(range(first, last + 1))
    assert numbers == set(range(1, 21))


# -- numbers ---------------------------------------------------------------------------------------


def test_the_verification_manual_is_of_this_version_and_close():
    """The numbers of the file are in the page; none is further off than what its text admits."""
    found = json.loads((DOCS / "verification.json").read_text())
    assert found["version"] == dm.__version__
    page = tool("tables").verification(DOCS / "verification.json")
    for case in found["cases"]:
        assert case["problem"] in page and case["rows"]
        for row in case["rows"]:
            assert abs(row["ours"] / row["reference"] - 1) < 0.05, row
    names = [f"{c['problem']}: {r['quantity']}" for c in found["cases"] for r in c["rows"]]
    assert len(names) == len(set(names)) >= 20


# -- the build -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", TOOLS)
def test_examples_of_the_tools(name):
    result = doctest.testmod(tool(name))
    assert result.failed == 0 and (result.attempted or name == "links")


@pytest.mark.parametrize("demo", sorted(path.name for path in ROOT.glob("demos/*")))
def test_a_notebook_is_flat_and_whole(demo, tmp_path):
    """Each cell is a program of its own; what it imports it brings; the pictures are shown."""
    gallery = tool("gallery")
    (shown,) = (d for d in gallery.DEMOS if d.name == demo)
    picture = next(iter(shown.pictures))
    (tmp_path / picture).write_bytes(b"drawn")
    gallery.notebook(shown, tmp_path / "demo.ipynb", tmp_path)
    book = json.loads((tmp_path / "demo.ipynb").read_text())
    cells = book["cells"]
    code = [cell["source"] for cell in cells if cell["cell_type"] == "code"]
    files = {re.match(r"%%writefile (.*)\.py\n", text)[1] for text in code if text.startswith("%%")}
    assert files == {p.stem for p in (ROOT / "demos" / demo).glob("*.py")} - {demo}
    for text in code:
        compile(text.partition("\n")[2] if text.startswith("%%") else text, demo, "exec")
    assert "parse_args([])" in "".join(code) and "def main(" not in "".join(code)
    assert "display(Image" in code[-1]


def test_the_gallery_leaves_out_nothing():
    gallery = tool("gallery")
    names = {demo.name for demo in gallery.DEMOS}
    assert names == {p.parent.name for p in ROOT.glob("demos/*/*.py")}
    assert {demo.name for demo in gallery.EXAMPLES} == {p.stem for p in ROOT.glob("examples/*.py")}

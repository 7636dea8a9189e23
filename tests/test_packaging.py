# SPDX-License-Identifier: MIT
"""What a release holds and needs: the version, the folders of its archive, the libraries."""

import re
import tomllib
from pathlib import Path

import dolfinx_mortar as dm

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def test_the_version_stands_in_one_place():
    project, build = PROJECT["project"], PROJECT["tool"]["hatch"]
    assert "version" not in project and project["dynamic"] == ["version"]
    assert ROOT / build["version"]["path"] == Path(dm.__file__)
    assert re.fullmatch(r"\d+\.\d+\.\d+\w*", dm.__version__)


def test_the_citation_names_this_version():
    (cited,) = re.findall(r"^version: *(\S+)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)
    assert cited == dm.__version__


def included():
    """Return what the archive of the sources holds, beside pyproject.toml."""
    return set(PROJECT["tool"]["hatch"]["build"]["targets"]["sdist"]["include"])


HIDDEN = {"/.ci", "/.github", "/.zenodo.json"}


def test_the_archive_holds_all_that_the_repository_shows():
    ignored = {line.strip("/") for line in (ROOT / ".gitignore").read_text().splitlines()}
    shown = {p.name for p in ROOT.iterdir() if p.name[0] not in "._"} - ignored
    assert {f"/{name}" for name in shown} - {"/pyproject.toml"} == included() - HIDDEN
    assert HIDDEN <= included()


def test_the_changelog_tells_of_this_version_in_the_form_that_tools_read():
    text = (ROOT / "CHANGELOG.md").read_text()
    headings = re.findall(r"^## \[(.*?)\]", text, re.MULTILINE)
    assert headings[0] == "Unreleased" and dm.__version__ in headings
    kinds = set(re.findall(r"^### (.*)$", text, re.MULTILINE))
    assert kinds <= {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}


def test_every_environment_is_of_one_list_of_packages():
    """Docker and Apptainer read it in the same way; what pip installs is what conda asks for."""
    lines = "sed 's/#.*//' /packages.txt"
    for file in ("Dockerfile", "dolfinx_mortar.def"):
        text = (ROOT / "containers" / file).read_text()
        assert lines in text and "packages.txt /" in text and "python3-dolfinx" not in text
    recipe = (ROOT / "conda" / "meta.yaml").read_text()
    run = recipe.partition("  run:\n")[2].partition("run_constrained")[0]
    for name in PROJECT["project"]["dependencies"]:
        assert f"- {name}\n" in run
    assert f"python {PROJECT['project']['requires-python']}" in run


def test_the_paper_cites_what_it_lists():
    text = (ROOT / "paper" / "paper.md").read_text()
    listed = re.findall(r"^@\w+\{(\w+),", (ROOT / "paper" / "paper.bib").read_text(), re.MULTILINE)
    assert set(re.findall(r"@(\w+)", text)) == set(listed) and len(listed) == len(set(listed))
    for part in ("title:", "authors:", "affiliations:", "# Summary", "# Statement of need"):
        assert part in text
    assert 250 < len(text.split()) < 1000

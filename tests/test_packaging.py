# SPDX-License-Identifier: MIT
"""What a release holds and needs: the version, the folders of its archive, the libraries."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

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


def test_the_archive_holds_all_that_the_repository_shows():
    ignored = {line.strip("/") for line in (ROOT / ".gitignore").read_text().splitlines()}
    shown = {p.name for p in ROOT.iterdir() if p.name[0] not in "._"} - ignored
    included = PROJECT["tool"]["hatch"]["build"]["targets"]["sdist"]["include"]
    assert {f"/{name}" for name in shown} - {"/pyproject.toml"} == set(included)


@pytest.mark.serial
def test_rich_is_not_needed():
    code = "import sys; sys.modules['rich'] = None; import dolfinx_mortar"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
    needed = {re.split(r"[<>=~ ]", line)[0] for line in PROJECT["project"]["dependencies"]}
    assert (
        "rich" not in needed and "rich" in PROJECT["project"]["optional-dependencies"]["progress"]
    )

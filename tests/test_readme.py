# SPDX-License-Identifier: MIT
"""The commands and the program of the README work, and the README is short."""

import re
from pathlib import Path

import pytest

README = (Path(__file__).parent.parent / "README.md").read_text()


def test_it_is_read_in_a_few_minutes():
    """The first program is seen at once, there is one picture, and small strain is said first."""
    before, python, _ = README.partition("```python")
    assert python and len(before.split()) <= 60
    assert len(re.findall(r"!\[", README)) == 1
    assert "small strain" in before and "| | can | cannot |\n" in README


@pytest.mark.serial
def test_the_program_runs(capsys):
    (code,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    assert len([line for line in code.splitlines() if line.strip()]) <= 12
    exec(compile(code, "README.md", "exec"), {})
    last = capsys.readouterr().out.splitlines()[-1]
    time, across, along, stress = map(float, re.findall(r"-?[\d.]+(?:e-?\d+)?", last))
    assert time == 0.1 and abs(across) < 1e-3 * abs(along) and along < 0 < stress


def test_its_links_lead_somewhere():
    targets = re.findall(r"\]\((?!https?:)([^)#]+)\)", README)
    root = Path(__file__).parent.parent
    assert len(targets) > 15 and not [name for name in targets if not (root / name).exists()]

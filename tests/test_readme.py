# SPDX-License-Identifier: MIT
"""What the README tells a newcomer to type must work."""

import re
from pathlib import Path

import pytest

README = (Path(__file__).parent.parent / "README.md").read_text()


@pytest.mark.serial
def test_library_example_runs(tmp_path, monkeypatch, capsys):
    (code,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    lines = [line for line in code.splitlines() if line.strip()]
    assert len(lines) <= 25
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "README.md", "exec"), {})
    assert "converged in" in capsys.readouterr().out
    assert (tmp_path / "out.xdmf").exists()


def test_first_block_holds_exactly_two_commands():
    first = re.search(r"```\n(.*?)```", README, re.DOTALL)
    assert first[1].splitlines() == [
        "containers/run python3 demos/hertz/hertz.py",
        "containers/run pytest",
    ]

# SPDX-License-Identifier: MIT
"""The examples as files: short, flat, run on one and on two ranks; each asserts its own result."""

import ast
import re
from pathlib import Path

import pytest

from tests import jobs
from tests.choice import quick
from tests.test_demo import shown

EXAMPLES = sorted((Path(__file__).parent.parent / "examples").glob("*.py"))
LINES = 60  # at most
SAID = {  # what they print, by their last lines
    "press_a_disc": ("peak 2478 MPa, Hertz 2461 MPa",),
    "glue_two_meshes": ("1 iteration, largest error of the displacement",),
    "tighten_a_bolt": ("pull 10000 N: bolt 22004 N", "pull 40000 N: bolt 40000 N"),
    "slide_a_block": ("top at 0.20 mm: T = 60.00 N/mm, T/N = 0.300",),
    "press_a_ball": ("peak 6707 MPa, Hertz 6708 MPa",),
    "fit_two_rings": ("pressure 32.56 to 32.58 MPa, Lamé 32.56 MPa",),
    "stack_blocks": ("0.340 N/mm, weight above 0.340 N/mm",),
    "yield_in_contact": ("plate at 9.90 mm: 477.27 MPa",),
    "squeeze_rubber": ("height 60%: -61.756 N/mm, exact -61.756 N/mm",),
    "close_a_gap": ("80 K:  -96.60 MPa, exact  -96.60 MPa",),
    "conduct_heat": ("left end at 400 K: 62.5",),
    "homogenise_a_cell": ("pressed along x: -34.76 MPa, -19.23 MPa", "both: -53.99 MPa"),
    "bounce_a_rod": ("contact lasts 2.020 L/c, exact 2",),
    "stop_and_go_on": ("without a stop",),
    "wear_a_cylinder": ("1000 mm: half-width 2.461 mm, rigid 2.466; depth 0.3037 mm",),
}


def test_all_are_listed():
    assert {path.stem for path in EXAMPLES} == set(SAID)


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_they_are_short_and_flat(path):
    """So they can be pasted: no options, no other file; and they assert what they find."""
    source = path.read_text()
    assert len(source.splitlines()) <= LINES
    assert any(isinstance(node, ast.Assert) for node in ast.walk(ast.parse(source)))
    assert not re.search(r"argparse|__main__|__file__|sys\.path|^from tests", source, re.MULTILINE)


@pytest.mark.serial
@pytest.mark.parametrize("path", quick(EXAMPLES, EXAMPLES[-1]), ids=lambda path: path.stem)
def test_they_run(path):
    folder = shown(path.stem)
    check(path, folder, (folder / "said.txt").read_text())


@pytest.mark.serial
@pytest.mark.slow
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_they_run_on_two_ranks(path, tmp_path):
    done = jobs.run(2, path, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    check(path, tmp_path, done.stdout)


def check(path, folder, said):
    assert all(words in said for words in SAID[path.stem])
    assert (folder / f"{path.stem}.png").stat().st_size > 5000

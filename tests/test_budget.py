# SPDX-License-Identifier: MIT
"""The size of the package: ceilings that each change lowers to where it stands.

Tokens are those of Python 3.12 and later; before, an f-string is one, and there are fewer.
"""

import ast
import io
import json
import os
import subprocess
import sys
import tokenize
from pathlib import Path

import pytest

import dolfinx_mortar

PACKAGE = Path(dolfinx_mortar.__file__).parent
CEILINGS = {
    "files": 148,
    "tokens of code": 294_196,
    "words of prose": 55_894,
    "words of strings": 13_698,
}
TOKENS_OF_TESTS = 332_944
PUBLIC_NAMES = 46
WORDS_OF_PAGES = {"README.md": 699, "ARCHITECTURE.md": 1_493}
SIMPLEST_STEP = {"files": 69, "functions": 661, "lines": 6_952}
LAYOUT = (
    *(tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT),
    *(tokenize.COMMENT, tokenize.ENDMARKER),
)
DOCUMENTED = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef | ast.Module


def size_of(source):
    r"""Return tokens of code, words of docstrings and comments, and words of other strings.

    >>> size_of('def f(x):  # twice\n    "Return 2 x."\n    return x, "two words"\n')
    (11, 5, 2)
    """
    tree = ast.parse(source)
    nodes = list(ast.walk(tree))
    docs = [ast.get_docstring(n) or "" for n in nodes if isinstance(n, DOCUMENTED)]
    texts = [n.value for n in nodes if isinstance(n, ast.Constant) and isinstance(n.value, str)]
    found = list(tokenize.generate_tokens(io.StringIO(source).readline))
    comments = [t.string for t in found if t.type == tokenize.COMMENT]
    in_docs = sum(len(text.split()) for text in docs)
    return (
        sum(t.type not in LAYOUT for t in found),
        in_docs + sum(len(text.split()) for text in comments),
        sum(len(text.split()) for text in texts) - in_docs,
    )


@pytest.fixture(scope="module")
def sizes():
    files = sorted(PACKAGE.rglob("*.py"))
    sums = map(sum, zip(*(size_of(f.read_text()) for f in files), strict=True))
    return dict(zip(CEILINGS, [len(files), *sums], strict=True))


@pytest.mark.parametrize("what", CEILINGS)
def test_the_package_does_not_grow(sizes, what):
    """What a change adds, it or another one takes off elsewhere; then the ceiling is lowered."""
    assert sizes[what] <= CEILINGS[what]


def test_the_tests_do_not_grow():
    files = Path(__file__).parent.rglob("*.py")
    assert sum(size_of(f.read_text())[0] for f in files) <= TOKENS_OF_TESTS


def test_public_names_and_pages_do_not_grow():
    assert len(dolfinx_mortar.__all__) <= PUBLIC_NAMES
    for page, most in WORDS_OF_PAGES.items():
        assert len((PACKAGE.parent / page).read_text().split()) <= most


@pytest.mark.serial
def test_the_simplest_step_enters_no_more():
    """Kernels are Python there, and count."""
    run = subprocess.run(
        [sys.executable, "-m", "tests.simplest_step"],
        cwd=Path(__file__).parents[1],
        env=os.environ | {"NUMBA_DISABLE_JIT": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    found = json.loads(run.stdout.splitlines()[-1])
    assert all(a <= b for a, b in zip(found, SIMPLEST_STEP.values(), strict=True)), found

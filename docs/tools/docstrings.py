# SPDX-License-Identifier: MIT
"""Docstrings as Sphinx wants them: plain text with formulas and indented blocks, made safe.

Docstrings of this package are read in the terminal first. They write formulas as they are, |xi| and
a_j* included, and show formulas and programs as indented paragraphs. Here those become literal
blocks, and signs that reStructuredText takes for markup are escaped.
"""

import dataclasses
import inspect
import re
from typing import Any

SECTIONS = {
    *("Args:", "Returns:", "Raises:", "Yields:", "Attributes:", "Example:", "Examples:"),
    *("Note:", "Notes:", "Source:", "References:"),
}
LITERAL = re.compile(r"(``.*?``|`[^`]+`)")
ARRAY = re.compile(
    r"~?(?:numpy\.)?ndarray\[tuple\[int, \.\.\.\], ~?(?:numpy\.)?dtype\[~?(?:numpy\.)?(\w+)\]\]"
)
ARRAYS = {"float64": "Floats", "bool": "Bools"}
ARRAYS |= {"int8": "Actives", "int32": "Ints", "int64": "Longs"}
PROMPT = re.compile(r"\s*>>> ")


def escape(line: str) -> str:
    r"""Escape what is no markup outside of backticks.

    >>> print(escape("the norm |xi| of `x` and sum_j D_j* a_"))
    the norm \|xi\| of `x` and sum_j D_j\* a\_
    """
    parts = LITERAL.split(line)
    for i in range(0, len(parts), 2):
        bullet = "* " if i == 0 and parts[i].lstrip().startswith("* ") else ""
        head, _, tail = parts[i].partition(bullet) if bullet else ("", "", parts[i])
        part = head + bullet + re.sub(r"([|*])", r"\\\1", tail.replace("\\", "\\\\"))
        parts[i] = re.sub(r"_(?=\W|$)", r"\\_", part)
    return "".join(parts)


def indent_of(line: str) -> int:
    """Return the number of leading spaces."""
    return len(line) - len(line.lstrip())


def prepare(lines: list[str]) -> list[str]:
    """Return the lines of a docstring with literal blocks marked and signs escaped.

    >>> prepare(["Return a.", "", "    a = |b|", "", "and so on"])
    ['Return a.', '', '::', '', '    a = |b|', '', 'and so on']
    """
    result: list[str] = []
    margin, literal, doctest = 0, None, False
    for i, line in enumerate(lines):
        bare, depth = line.strip(), indent_of(line)
        if not bare:
            doctest = False
            result.append(line)
            continue
        if literal is not None and depth >= literal:
            result.append(line)
            continue
        literal = None
        if PROMPT.match(line):
            doctest = True
        if doctest:
            result.append(line)
            continue
        after_blank = i > 0 and not lines[i - 1].strip()
        if after_blank and depth >= margin + 4:
            literal = depth
            result += [" " * margin + "::", "", line]
            continue
        result.append(escape(line))
        margin = depth + 4 if bare in SECTIONS else depth
    return result


def without_type(line: str) -> str:
    """Return the first line of a property, of which napoleon would take a type before a colon.

    >>> without_type("Frames in use: Cartesian ones where nothing is bound: all.")
    'Frames in use \N{EN DASH} Cartesian ones where nothing is bound: all.'
    """
    return line.replace(": ", " \N{EN DASH} ", 1)


def named_types(signature: str) -> str:
    """Return a signature in which array types have names, as in `dolfinx_mortar.common.arrays`.

    Defaults that are made anew for each object are three dots.

    >>> named_types("(x: TypeAliasForwardRef('Floats')) -> ndarray[tuple[int, ...], dtype[bool]]")
    '(x: Floats) -> Bools'
    >>> named_types("(parts: list[StepReport] = <factory>)")
    '(parts: list[StepReport] = ...)'
    """
    signature = signature.replace("<factory>", "...")
    signature = re.sub(r"TypeAliasForwardRef\('(\w+)'\)", r"\1", signature)
    return ARRAY.sub(lambda found: ARRAYS.get(found[1], found[0]), signature)


def fields_of(kind: type) -> list[str]:
    """Return an Attributes section from the comments behind the fields of a record."""
    if not (dataclasses.is_dataclass(kind) or hasattr(kind, "_fields")):
        return []
    own = set(vars(kind).get("__annotations__", {}))
    try:
        source = inspect.getsource(kind)
    except (OSError, TypeError):
        return []
    found = re.findall(r"^    (\w+): [^#\n]*?  # (.*)$", source, re.MULTILINE)
    rows = [f"    {name}: {' '.join(said.split())}" for name, said in found if name in own]
    return ["", "Attributes:", *rows] if rows else []


def setup(app: Any) -> dict[str, bool]:
    """Connect to autodoc, before napoleon reads the sections."""

    def process(_: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
        if not any(line.strip() == "Attributes:" for line in lines) and what == "class":
            lines += fields_of(obj)
        lines[:] = prepare(lines)
        if what == "property" and lines:
            lines[0] = without_type(lines[0])

    def shorten(*event: Any) -> tuple[str | None, str | None]:
        signature, returned = (named_types(part) if part else part for part in event[-2:])
        return signature, returned

    app.connect("autodoc-process-docstring", process, priority=400)
    app.connect("autodoc-process-signature", shorten)
    return {"parallel_read_safe": True}

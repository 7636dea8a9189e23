# SPDX-License-Identifier: MIT
"""Small tables for notebooks: no scripts and no colours, so that any theme can show them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from numbers import Real
from typing import Any


def table(title: str, rows: Iterable[Sequence[Any]], head: Sequence[str] = ()) -> str:
    """Return a table in HTML; all texts are escaped, numbers have four digits.

    >>> table("Hooke", [("E", 2e5), ("law", "<b>")]).count("&lt;b&gt;")
    1
    """
    lines = [_row("th", head)] if head else []
    lines += [_row("td", row) for row in rows]
    return (
        f'<table style="text-align: left"><caption style="text-align: left">{escape(title)}'
        f"</caption><tbody>{''.join(lines)}</tbody></table>"
    )


def items(texts: Iterable[str]) -> str:
    """Return a list in HTML, nothing without texts; all texts are escaped."""
    entries = "".join(f"<li>{escape(text)}</li>" for text in texts)
    return f"<ul>{entries}</ul>" if entries else ""


def _row(kind: str, cells: Sequence[Any]) -> str:
    style = ' style="text-align: left"'
    return f"<tr>{''.join(f'<{kind}{style}>{_shown(cell)}</{kind}>' for cell in cells)}</tr>"


def _shown(value: Any) -> str:
    """Return a value as escaped text."""
    if isinstance(value, Real) and not isinstance(value, bool):
        return escape(f"{value:d}" if isinstance(value, int) else f"{float(value):.4g}")
    return escape(str(value))

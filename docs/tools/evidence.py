# SPDX-License-Identifier: MIT
"""What stands behind a statement: a role for the source of a function, a directive for a test.

    {source}`dolfinx_mortar.problem.linearisation.linearise`

    ```{test} test_qp.py::test_backends_agree
    ```

Both fail the build where the function or the test does not exist.
"""

import functools
import importlib
import inspect
import re
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.util.docutils import SphinxDirective, SphinxRole

TESTS = Path(__file__).parents[2] / "tests"


def find(name: str) -> Any:
    """Return the object of a dotted name.

    >>> find("dolfinx_mortar.qp.bound_qp.check").__name__
    'check'
    """
    parts = name.split(".")
    for k in range(1, len(parts) + 1):  # a sub-package and a function may share a name
        try:
            found = importlib.import_module(".".join(parts[:k]))
            return functools.reduce(getattr, parts[k:], found)
        except (AttributeError, ModuleNotFoundError):
            continue
    raise AttributeError(f"there is no {name}")


class Source(SphinxRole):
    """A function's name as a link to its lines."""

    def run(self) -> tuple[list[nodes.Node], list[nodes.system_message]]:
        """Return the link to the page of the highlighted module."""
        found = find(self.text)
        module = found.__name__ if inspect.ismodule(found) else found.__module__
        anchor = "" if inspect.ismodule(found) else f"#{found.__qualname__}"
        up = "../" * self.env.docname.count("/")
        address = f"{up}_modules/{module.replace('.', '/')}.html{anchor}"
        shown = self.text.removeprefix("dolfinx_mortar.")
        link = nodes.reference("", "", nodes.literal("", shown), refuri=address, internal=True)
        return [link], []


class Test(SphinxDirective):
    """A test, folded up: its name, and its lines."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Return the folded test."""
        file, _, name = self.arguments[0].partition("::")
        if f"def {name}(" not in (TESTS / file).read_text():
            raise self.error(f"tests/{file} has no {name}")
        up = "../" * self.env.docname.count("/")
        text = f"""\
::::{{dropdown}} `tests/{file}::{name}`
:icon: beaker
```{{literalinclude}} {up}../tests/{file}
:pyobject: {name}
:language: python
```
::::
"""
        return self.parse_text_to_nodes(text)


def drop_dead_links(app: Any, page: str, template: str, context: dict, tree: Any) -> None:
    """Leave out links from source to pages that viewcode has guessed wrong."""
    known = app.env.get_domain("py").objects
    if page.startswith("_modules/"):
        back = r'<a class="viewcode-back" href="[^"#]*#([^"]+)">\[docs\]</a>'
        named = known.keys() | {f"{name}.__init__" for name in known}
        context["body"] = re.sub(back, lambda m: m[0] if m[1] in named else "", context["body"])


def setup(app: Any) -> dict[str, bool]:
    """Add both."""
    app.add_role("source", Source())
    app.add_directive("test", Test)
    app.connect("html-page-context", drop_dead_links)
    return {"parallel_read_safe": True}

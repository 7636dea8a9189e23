# SPDX-License-Identifier: MIT
"""Settings of Sphinx for the documentation; `docs/build` calls it."""

import sys
from pathlib import Path

DOCS = Path(__file__).parent
sys.path[:0] = [str(DOCS.parent), str(DOCS / "tools")]

import dolfinx_mortar  # noqa: E402

project = "dolfinx_mortar"
author = "The dolfinx_mortar developers"
copyright = author
version = release = dolfinx_mortar.__version__

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx.ext.mathjax",
    "sphinx-mathjax-offline",
    "myst_parser",
    "sphinx_design",
    "sphinx_copybutton",
    "docstrings",
    "elsewhere",
    "evidence",
]
exclude_patterns = ["_build", "tools", "generated/static", "**.ipynb"]
myst_enable_extensions = ["amsmath", "attrs_block", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
default_role = "py:obj"
# types and names in docstrings need not be pages; those that pages name do (tests/test_docs.py)
nitpicky = True
nitpick_ignore_regex = [("py:obj", ".*"), ("py:class", ".*")]
suppress_warnings = ["myst.header"]

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_default_options = {"exclude-members": "__new__"}
autodoc_type_aliases = {n: n for n in ("Actives", "Bools", "Floats", "Ints", "Longs", "Weight")}
autodoc_type_aliases["npt.ArrayLike"] = "ArrayLike"
autodoc_preserve_defaults = True
autodoc_class_signature = "separated"
napoleon_use_rtype = False
napoleon_use_ivar = True
napoleon_attr_annotations = False
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 88

html_theme = "furo"
html_title = f"dolfinx_mortar {version}"
html_static_path = ["_static", "generated/static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sourcelink = False
html_theme_options = {"navigation_with_keys": True}
pygments_style, pygments_dark_style = "friendly", "monokai"
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True
# on this site alone; sites of others are asked by docs/build --external
linkcheck_timeout = 20
linkcheck_retries = 2

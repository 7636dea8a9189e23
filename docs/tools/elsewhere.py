# SPDX-License-Identifier: MIT
"""Links from signatures and docstrings to the pages of dolfinx, petsc4py, mpi4py, NumPy and UFL.

The rules of their addresses are few, so no inventory has to be fetched: a build needs no network.
"""

import re
from typing import Any

FENICS = "https://docs.fenicsproject.org"
# how a name may look in our sources -> address of its page
PAGES = [
    (
        r"(?:dolfinx\.)?(fem|mesh)\.(\w+)",
        FENICS + "/dolfinx/v0.9.0/python/generated/"
        r"dolfinx.\1.html#dolfinx.\1.\2",
    ),
    (
        r"(?:petsc4py\.)?PETSc\.(\w+)",
        r"https://petsc.org/release/petsc4py/reference/"
        r"petsc4py.PETSc.\1.html",
    ),
    (
        r"(?:mpi4py\.)?MPI\.(\w+)",
        r"https://mpi4py.readthedocs.io/en/stable/reference/"
        r"mpi4py.MPI.\1.html",
    ),
    (
        r"(?:np|numpy)\.(ndarray)",
        r"https://numpy.org/doc/stable/reference/generated/"
        r"numpy.\1.html",
    ),
]
# what an import makes of a short name
FULL = {
    "Function": "dolfinx.fem.Function",
    "FunctionSpace": "dolfinx.fem.FunctionSpace",
    "Constant": "dolfinx.fem.Constant",
    "DirichletBC": "dolfinx.fem.DirichletBC",
    "MeshTags": "dolfinx.mesh.MeshTags",
    "Mesh": "dolfinx.mesh.Mesh",
}


def address(name: str) -> str | None:
    """Return the page of a name of another library, or None.

    >>> address("PETSc.Mat")
    'https://petsc.org/release/petsc4py/reference/petsc4py.PETSc.Mat.html'
    >>> address("dolfinx.fem.function.Function") == address("fem.Function") == address("Function")
    True
    >>> address("Solid")
    """
    name = re.sub(r"^dolfinx\.(fem|mesh)\.(?:\w+\.)*(\w+)$", r"dolfinx.\1.\2", name)
    name = FULL.get(name, name)
    for pattern, page in PAGES:
        if re.fullmatch(pattern, name):
            return re.sub(pattern, page, name)
    return None


def setup(app: Any) -> dict[str, bool]:
    """Answer references that Sphinx itself cannot resolve."""
    from docutils import nodes

    def resolve(_: Any, env: Any, node: Any, content: Any) -> Any:
        if node.get("refdomain") != "py" or not (page := address(node.get("reftarget", ""))):
            return None
        reference = nodes.reference("", "", internal=False, refuri=page)
        reference += content
        return reference

    app.connect("missing-reference", resolve)
    return {"parallel_read_safe": True}

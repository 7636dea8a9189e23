# SPDX-License-Identifier: MIT
"""Dolfinx calls that changed between 0.9 and 0.11: one function per call."""

from typing import Any

import numpy as np
import numpy.typing as npt

import ffcx.codegeneration.jit
import ufl
from dolfinx import default_scalar_type, fem, jit, mesh


def interpolation_points(V: fem.FunctionSpace) -> np.ndarray:
    """Reference points (q, tdim) of V's element (a method until 0.9)."""
    points = V.element.interpolation_points
    return np.asarray(points() if callable(points) else points)


def on_same_mesh(tags: mesh.MeshTags | mesh.Mesh, domain: mesh.Mesh) -> bool:
    """Whether tags, or a mesh, are of this very mesh (topologies may be wrapped)."""

    def unwrapped(topology: Any) -> Any:
        return getattr(topology, "_cpp_object", topology)

    return unwrapped(tags.topology) is unwrapped(domain.topology)


def cell_degree(domain: mesh.Mesh) -> int:
    """Degree of the cells' geometry (0.11 has a list of maps)."""
    geometry: Any = domain.geometry
    maps = getattr(geometry, "cmaps", None)
    return int((maps[0] if maps is not None else geometry.cmap).degree)


def cell_nodes(domain: mesh.Mesh) -> npt.NDArray[np.int32]:
    """Nodes (cells, n) of the cells' geometry (0.11 has a list)."""
    geometry: Any = domain.geometry
    lists = getattr(geometry, "dofmaps", None)
    return np.asarray(lists[0] if isinstance(lists, list | tuple) else geometry.dofmap)


def mesh_from_gmsh(
    model: Any, comm: Any, dim: int
) -> tuple[mesh.Mesh, mesh.MeshTags, mesh.MeshTags]:
    """Mesh, cell tags and facet tags of the Gmsh model on rank 0; collective."""
    try:
        from dolfinx.io.gmsh import model_to_mesh
    except ImportError:
        from dolfinx.io.gmshio import model_to_mesh
    domain, *tags = model_to_mesh(model, comm, 0, gdim=dim)[:3]
    for codim, found in enumerate(tags):
        if found is None:
            none = np.empty(0, dtype=np.int32)
            tags[codim] = mesh.meshtags(domain, dim - codim, none, none)
    return domain, tags[0], tags[1]


def cell_kinds(domain: mesh.Mesh) -> list[str]:
    """Names of the kinds of cells in a mesh, one unless mixed."""
    topology: Any = getattr(domain.topology, "_cpp_object", domain.topology)
    kinds = getattr(topology, "entity_types", None) or getattr(topology, "cell_types", None)
    return sorted(kind.name for kind in kinds[-1]) if kinds else [domain.topology.cell_name()]


def compile_together(*forms: ufl.Form, compiler: list[str] | None = None) -> list[fem.Form]:
    """Compile forms over cells in one module, cached as a whole; collective."""
    comm = forms[0].ufl_domain().ufl_cargo().comm
    options = ffcx.get_options({"scalar_type": default_scalar_type})
    compile_forms = jit.mpi_jit_decorator(ffcx.codegeneration.jit.compile_forms)
    given = jit.get_options() | ({} if compiler is None else {"cffi_extra_compile_args": compiler})
    kernels, module, code = compile_forms(comm, list(forms), options, **given)
    pairs = zip(forms, kernels, strict=True)
    return [_create_form(form, kernel, module, code) for form, kernel in pairs]


def _create_form(form: ufl.Form, kernel: Any, module: Any, code: Any) -> fem.Form:
    ((domain, data),) = form.subdomain_data().items()
    functions, positions = form.coefficients(), kernel.original_coefficient_positions
    address = int(module.ffi.cast("uintptr_t", module.ffi.addressof(kernel)))
    spaces = [argument.ufl_function_space()._cpp_object for argument in form.arguments()]
    rest: Any = (
        [functions[positions[i]]._cpp_object for i in range(kernel.num_coefficients)],
        [constant._cpp_object for constant in form.constants()],
        {fem.IntegralType.cell: [(i, np.array(cells)) for i, cells in data["cell"][0] or []]},
        [] if hasattr(mesh, "EntityMap") else {},
        domain.ufl_cargo(),
    )
    create: Any = fem.form_cpp_class(default_scalar_type)
    try:
        made = create([address], spaces, *rest)
    except TypeError:  # 0.9 takes one kernel, later versions a list
        made = create(address, spaces, *rest)
    return fem.Form(made, kernel, code, module)

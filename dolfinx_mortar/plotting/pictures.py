# SPDX-License-Identifier: MIT
"""The three pictures: arguments are checked, fields gathered, and rank 0 draws."""

import os
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from typing import Any

import numpy as np

from dolfinx import fem
from dolfinx import mesh as dmesh
from dolfinx_mortar import compat
from dolfinx_mortar.agreement import check_same_on_all_ranks
from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.arguments import check, check_optional, instance, one_of
from dolfinx_mortar.arrays import Ints
from dolfinx_mortar.plotting.gathered import NO_TAG, Values, gather_bodies, gather_facets
from dolfinx_mortar.spaces import CELLS
from dolfinx_mortar.tags import tags_of

File = str | os.PathLike[str] | None
MOVED = " moved"  # name of the positions among values at nodes; not a name of a field


def mesh(
    mesh: dmesh.Mesh,
    cell_tags: dmesh.MeshTags | None = None,
    facet_tags: dmesh.MeshTags | None = None,
    *,
    file: File = None,
    view: Any = None,
    ax: Any = None,
) -> Any:
    """Draw a mesh with its bodies and sides in colours, and their names if the tags have some.

    Collective; all is gathered on rank 0.

    Args:
        mesh: the mesh.
        cell_tags: of its bodies, see `Tags` for names.
        facet_tags: of its sides; in space they have a pane of their own.
        file: picture to write (.png); no window is opened then.
        view: in space, the direction (x, y, z) to look from.
        ax: axes of matplotlib to draw in, in the plane.

    Returns:
        matplotlib's axes in the plane, PyVista's plotter in space (call its ``show()``), None on
        all ranks but 0.

    Raises:
        ValueError: for no mesh, tags of another one, `view` in the plane, `ax` in space.
        ImportError: without matplotlib or PyVista; the message names the extra.
        RuntimeError: in space, if there is no screen to draw on.
    """
    if not isinstance(mesh, dmesh.Mesh) or mesh.topology.cell_name() not in CELLS:
        unpack = "; unpack what a reader returns, mesh(*found)" if isinstance(mesh, tuple) else ""
        raise ValueError(
            f"mesh is {mesh!r}: give a dolfinx mesh of {', '.join(CELLS)} cells{unpack}."
        )
    check_same_on_all_ranks(mesh.comm, cell_tags=cell_tags, facet_tags=facet_tags)
    tdim = mesh.topology.dim
    for name, tags, dim in (("cell_tags", cell_tags, tdim), ("facet_tags", facet_tags, tdim - 1)):
        check_optional(name, tags, tags_of(mesh, dim))
    drawer = _drawer(mesh, file, view, ax)
    values: Ints = np.full(mesh.topology.index_map(tdim).size_local, NO_TAG, dtype=np.int32)
    if cell_tags is not None:
        inside = cell_tags.indices < len(values)
        values[cell_tags.indices[inside]] = cell_tags.values[inside]
    V = fem.functionspace(mesh, ("Lagrange", compat.cell_degree(mesh)))
    bodies = gather_bodies(V, {}, {"tag": values})
    sides = None if facet_tags is None else gather_facets(V, facet_tags, {})
    named = cell_tags, facet_tags
    panes = 1 if facet_tags is None else 2
    return _on_rank_0(
        mesh, drawer, lambda on: drawer.draw_mesh(on, bodies, sides, *named), file, view, ax, panes
    )


def field(
    problem: Any,
    name: str | fem.Function,
    *,
    scale: float = 1.0,
    file: File = None,
    view: Any = None,
    ax: Any = None,
) -> Any:
    """Draw a field on the deformed bodies. Collective; all is gathered on rank 0.

    Rigid tools are drawn where they are now, as far as they reach around the bodies, unless
    displacements are enlarged.

    Args:
        problem: a `ContactProblem`, or a `Solid`, which has no tools.
        name: of a scalar field of `Solid.cell_values`, such as "von_mises", "stress_yy" or
            "plastic_strain_norm", with one colour per cell; "displacement" for its length, or
            "displacement_x"; or another Function: one value per cell (DG0), or a continuous scalar
            or vector (of which the length is drawn).
        scale: by how much displacements are enlarged.
        file: as for `mesh`.
        view: as for `mesh`.
        ax: as for `mesh`.

    Returns:
        What `mesh` returns.

    Raises:
        ValueError: for unknown names, tensors, Functions of another mesh or that jump from cell to
            cell; else as `mesh` does.
    """
    solid = getattr(problem, "solid", problem)
    V = getattr(solid, "V", None)
    if not isinstance(V, fem.FunctionSpace) or not hasattr(solid, "cell_values"):
        raise ValueError(f"problem is {problem!r}: give a ContactProblem or a Solid.")
    check_same_on_all_ranks(V.mesh.comm, name=name, scale=scale)
    drawer = _drawer(V.mesh, file, view, ax)
    title, at_nodes, of_cells = _values(solid, name)
    bodies = gather_bodies(V, {**at_nodes, **_moved(V, solid.u, scale)}, of_cells)
    every = getattr(problem, "interfaces", ()) if scale == 1.0 else ()
    tools = [one.tool.outline() for one in every if one.tool is not None]

    def draw(on: Any) -> None:
        assert bodies is not None
        moved = bodies.at_nodes[MOVED]
        drawer.draw_field(on, replace(bodies, x=moved), title)
        if tools and len(moved):
            drawer.draw_tools(on, tools, *_box(moved[:, : V.mesh.geometry.dim]))

    return _on_rank_0(V.mesh, drawer, draw, file, view, ax)


def pressure(
    problem: Any,
    interfaces: Any = None,
    *,
    over: str | None = None,
    file: File = None,
    view: Any = None,
    ax: Any = None,
) -> Any:
    """Draw the contact pressure: along the slave side in the plane, over it in space.

    Collective; all is gathered on rank 0. Of ties the normal traction is drawn, positive in
    compression like a pressure and negative in tension.

    Args:
        problem: a `ContactProblem` that has made a step.
        interfaces: one or several of its interfaces, by default its contacts, or its ties if it
            has none.
        over: in the plane, "x" or "y", by default the axis along which the sides are longer.
        file: as for `mesh`.
        view: as for `mesh`.
        ax: as for `mesh`.

    Returns:
        What `mesh` returns.

    Raises:
        ValueError: for interfaces of other problems, and wrong ``over``; else as `mesh` does.
        NoResult: before the first step.
    """
    chosen = _chosen(problem, interfaces, over)
    V: fem.FunctionSpace = problem.solid.V
    axes = ("x", "y") if V.mesh.geometry.dim == 2 else ()
    check_optional("over", over, one_of(*axes), "choose 'x' or 'y' in the plane, None in space")
    drawer = _drawer(V.mesh, file, view, ax)
    moved = _moved(V, problem.solid.u, 1.0)
    sides = []
    for one in chosen:
        one.force  # noqa: B018 - an error before the first step
        values = {"pressure": one.pressure.x.array, **moved}
        side = gather_facets(V, one.facet_tags, values, one.slave)
        sides += [] if side is None else [(repr(one), replace(side, x=side.at_nodes[MOVED]))]
    # one title for all sides: the pressure of a contact is a normal traction, too
    title = "contact pressure" if all(one.unilateral for one in chosen) else "normal traction"
    return _on_rank_0(
        V.mesh, drawer, lambda on: drawer.draw_pressure(on, sides, over, title), file, view, ax
    )


def _box(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners (d,) of the box around points (n, d), a tenth of its diagonal larger."""
    low, high = x.min(axis=0), x.max(axis=0)
    beside = 0.1 * np.linalg.norm(high - low)
    return low - beside, high + beside


def _chosen(problem: Any, interfaces: Any, over: Any) -> list[Any]:
    """Return the interfaces to draw; collective."""
    if not hasattr(problem, "check_owned"):
        raise ValueError(f"problem is {problem!r}: give a ContactProblem.")
    problem.check_owned()
    check_same_on_all_ranks(problem.comm, interfaces=interfaces, over=over)
    asked = (problem.contacts or problem.interfaces) if interfaces is None else interfaces
    asked = list(asked) if isinstance(asked, list | tuple) else [asked]
    for interface in asked:
        if not any(interface is one for one in problem.interfaces):
            raise ValueError(
                f"interfaces: {interface!r} is none of this problem's, {problem.interfaces}."
            )
    if not asked:
        none = "problem has no contact or tie to draw"
        none = none if interfaces is None else f"interfaces is {interfaces!r}"
        raise ValueError(f"{none}; interfaces of the problem: {problem.interfaces}.")
    return asked


def _moved(V: fem.FunctionSpace, u: fem.Function, scale: float) -> Values:
    """Return the local nodes (n, 3) at X + scale u."""
    x = V.tabulate_dof_coordinates().copy()
    d = V.mesh.geometry.dim
    x[:, :d] += scale * u.x.array.reshape(-1, d)
    return {MOVED: x}


def _values(solid: Any, name: str | fem.Function) -> tuple[str, Values, Values]:
    """Return the title of a field or a Function, its values at nodes or of cells; collective."""
    if isinstance(name, fem.Function):
        return _values_of(solid.V, name)
    axes = "xyz"[: solid.V.mesh.geometry.dim]
    components = {"displacement": None} | {f"displacement_{a}": i for i, a in enumerate(axes)}
    drawable = [*components, *solid.fields.scalars]
    rule = one_of(*drawable)
    check("name", name, rule, f"{rule.remedy}, or give a Function")
    if name in components:
        return name, {name: _at_nodes(solid.V, solid.u, components[name])}, {}
    return name, {}, {name: _of_cells(solid.cell_values(name))}


def _values_of(V: fem.FunctionSpace, function: fem.Function) -> tuple[str, Values, Values]:
    """Return what is drawn of a Function.

    Raises:
        ValueError: if it is on another mesh, or is neither constant in cells nor continuous.
    """
    name, space = function.name, function.function_space
    if space.mesh is not V.mesh:
        raise ValueError(f"name: the Function {name!r} is on another mesh than the bodies.")
    d, element = V.mesh.geometry.dim, space.ufl_element()
    if function.ufl_shape not in ((), (d,)):
        raise ValueError(
            f"name: the Function {name!r} has values of shape {function.ufl_shape}: give a scalar "
            f"or a vector ({d},)."
        )
    if element.family_name != "P" or (element.discontinuous and element.degree > 0):
        raise ValueError(
            f"name: the Function {name!r} ({'discontinuous ' * element.discontinuous}"
            f"{element.family_name} of degree {element.degree}) is neither Lagrange nor constant "
            "in cells: interpolate it into such a space."
        )
    if space.component():
        function = function.collapse()
    if element.degree > 0:
        return name, {name: _at_nodes(V, function, None)}, {}
    return name, {}, {name: _of_cells(function)}


def _of_cells(function: fem.Function) -> np.ndarray:
    """Return the values, or lengths of the vectors, of a DG0 Function in the owned cells."""
    space = function.function_space
    cells = space.dofmap.list[: space.mesh.topology.index_map(space.mesh.topology.dim).size_local]
    return _length(function.x.array.reshape(-1, space.dofmap.index_map_bs)[cells[:, 0]], None)


def _at_nodes(V: fem.FunctionSpace, function: fem.Function, component: int | None) -> np.ndarray:
    """Return a scalar, a component or the length of a vector at the local nodes of V."""
    target = function
    if function.function_space != V:
        target = fem.Function(V if function.ufl_shape else V.sub(0).collapse()[0])
        target.interpolate(function)
        target.x.scatter_forward()
    values = target.x.array.reshape(-1, target.function_space.dofmap.index_map_bs)
    return _length(values, component)


def _length(values: np.ndarray, component: int | None) -> np.ndarray:
    if values.shape[1] == 1:
        return values[:, 0]
    if component is not None:
        return values[:, component]
    return np.asarray(np.linalg.norm(values, axis=1))


def _drawer(domain: dmesh.Mesh, file: File, view: Any, ax: Any) -> Any:
    """Return the module that draws on rank 0, imported on all ranks; collective.

    Axes may be given on rank 0 alone.

    Raises:
        ImportError: if its library is not installed; the message names the extra that brings it.
        ValueError: for an argument of the other module, and a file that is no name.
    """
    dim = domain.geometry.dim
    with raised_together(domain.comm):
        check_optional("file", file, instance((str, os.PathLike), "give the name of a picture"))
        name, given, where = ("view", view, "space") if dim == 2 else ("ax", ax, "the plane")
        if given is not None:
            raise ValueError(f"{name} is {given!r}: for bodies in {where} only; leave it out")
    try:
        return import_module(f"dolfinx_mortar.plotting.{'in_plane' if dim == 2 else 'in_space'}")
    except ImportError as error:
        library = "matplotlib" if dim == 2 else "pyvista"
        raise ImportError(
            f"{library} is needed for this picture and cannot be imported ({error}): pip install "
            f"'dolfinx_mortar[demo]', or the package python3-{library}.",
            name=library,
        ) from error


def _on_rank_0(
    domain: dmesh.Mesh,
    drawer: Any,
    draw: Callable[[Any], None],
    file: File,
    view: Any,
    ax: Any,
    panes: int = 1,
) -> Any:
    """Draw on rank 0 and return axes or plotter; errors are raised on all ranks; collective."""
    result = None
    with raised_together(domain.comm):
        if domain.comm.rank == 0:
            result = drawer.begin(file, ax, panes)
            draw(result)
            drawer.finish(result, file, view)
    return result

# SPDX-License-Identifier: MIT
"""The three pictures: what is asked for is checked and gathered, then drawn on rank 0."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from dolfinx import fem
from dolfinx import mesh as dmesh
from dolfinx_mortar import compat
from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.arguments import is_name, is_number
from dolfinx_mortar.arrays import Ints
from dolfinx_mortar.plotting import plane, space
from dolfinx_mortar.plotting.libraries import require
from dolfinx_mortar.plotting.parts import (
    NO_TAG,
    outer_facets,
    parts_of_mesh,
    parts_of_side,
    parts_of_space,
)
from dolfinx_mortar.spaces import CELLS

File = str | os.PathLike[str] | None
ABSCISSAE = ("x", "y", "length")


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
        ValueError: for what is no mesh, tags of another one, `view` in the plane, `ax` in space.
        ImportError: without matplotlib or PyVista; the message names the extra.
        RuntimeError: in space, if there is no screen to draw on.
    """
    if not isinstance(mesh, dmesh.Mesh) or mesh.topology.cell_name() not in CELLS:
        unpack = "; unpack what a reader returns, mesh(*found)" if isinstance(mesh, tuple) else ""
        raise ValueError(
            f"mesh is {mesh!r}: give a dolfinx mesh of {', '.join(CELLS)} cells{unpack}."
        )
    tdim = mesh.topology.dim
    for name, tags, dim in (("cell_tags", cell_tags, tdim), ("facet_tags", facet_tags, tdim - 1)):
        sound = isinstance(tags, dmesh.MeshTags) and compat.on_same_mesh(tags, mesh)
        if tags is not None and (not sound or tags.dim != dim):
            raise ValueError(f"{name} is {tags!r}: give tags of dimension {dim} of this mesh.")
    _check_target(mesh, file, view, ax)
    owned = mesh.topology.index_map(tdim).size_local
    values: Ints = np.full(owned, NO_TAG, dtype=np.int32)
    if cell_tags is not None:
        inside = cell_tags.indices < owned
        values[cell_tags.indices[inside]] = cell_tags.values[inside]
    if tdim == 2:
        cells = parts_of_mesh(mesh, 2, np.arange(owned, dtype=np.int32), values)
    else:
        outside, behind, _ = outer_facets(mesh)
        cells = parts_of_mesh(mesh, 2, outside, values[behind])
    facets = None
    if facet_tags is not None:
        facets = parts_of_mesh(mesh, tdim - 1, facet_tags.indices, facet_tags.values)

    def draw(target: Any) -> None:
        (plane if tdim == 2 else space).draw_mesh(target, cells, facets, cell_tags, facet_tags)

    panes = 2 if facets is not None and len(facets.nodes) else 1
    return _on_rank_0(mesh, draw, file=file, view=view, ax=ax, panes=panes)


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

    Args:
        problem: a `ContactProblem`, or a `Solid`.
        name: of a scalar field of `Solid.cell_values`, such as "von_mises", "stress_yy" or
            "plastic_strain_norm", drawn as computed, a colour per cell; "displacement" for its
            length, or "displacement_x"; or a Function of your own: one value per cell (DG0), or a
            scalar or vector (of which the length is drawn) that is continuous.
        scale: by how much displacements are enlarged.
        file: picture to write (.png); no window is opened then.
        view: in space, the direction (x, y, z) to look from.
        ax: axes of matplotlib to draw in, in the plane.

    Returns:
        matplotlib's axes in the plane, PyVista's plotter in space (call its ``show()``), None on
        all ranks but 0.

    Raises:
        ValueError: for unknown names (the message lists those there are), tensors, Functions of
            another mesh or that jump from cell to cell, a ``scale`` that is no number, and
            `view` in the plane, `ax` in space.
        ImportError: without matplotlib or PyVista; the message names the extra.
        RuntimeError: in space, if there is no screen to draw on.
    """
    solid = getattr(problem, "solid", problem)
    if not hasattr(solid, "cell_values"):
        raise ValueError(f"problem is {problem!r}: give a ContactProblem or a Solid.")
    V: fem.FunctionSpace = solid.V
    d = V.mesh.geometry.dim
    if not is_number(scale):
        raise ValueError(f"scale is {scale!r}: give a number, 1 for displacements as they are.")
    _check_target(V.mesh, file, view, ax)
    title, at_nodes, of_cells = _values(solid, name)
    u = solid.u.x.array.reshape(-1, d)
    at_nodes = at_nodes | {" u": np.pad(u, ((0, 0), (0, 3 - d)))}
    cells = parts_of_space(V, at_nodes, of_cells)

    def draw(target: Any) -> None:
        assert cells is not None
        moved = replace(cells, x=cells.x + scale * cells.at_nodes[" u"])
        (plane if d == 2 else space).draw_field(target, moved, title)

    return _on_rank_0(V.mesh, draw, file=file, view=view, ax=ax)


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

    Collective; all is gathered on rank 0. Ties are drawn if they are asked for, or if there is
    nothing else: their normal traction, positive in compression like a pressure, and negative where
    the tie pulls.

    Args:
        problem: a `ContactProblem` that has made a step.
        interfaces: which of its interfaces, one or several; if not given its contacts, or its ties
            where it has none.
        over: in the plane, "x", "y" or "length", the length along the slave side; if not given, the
            first of these that grows along it.
        file: picture to write (.png); no window is opened then.
        view: in space, the direction (x, y, z) to look from.
        ax: axes of matplotlib to draw in, in the plane.

    Returns:
        matplotlib's axes in the plane, PyVista's plotter in space (call its ``show()``), None on
        all ranks but 0.

    Raises:
        ValueError: for interfaces of other problems, also of one made later that has taken them
            over, problems without any, unknown ``over``, and `view` in the plane, `over` or `ax`
            in space.
        NoResult: before the first step, a RuntimeError.
        ImportError: without matplotlib or PyVista; the message names the extra.
        RuntimeError: in space, if there is no screen to draw on.
    """
    chosen = _chosen(problem, interfaces)
    if over is not None and not is_name(over, ABSCISSAE):
        raise ValueError(f"over is {over!r}: choose one of {ABSCISSAE}.")
    V: fem.FunctionSpace = problem.solid.V
    d = V.mesh.geometry.dim
    if over is not None and d == 3:
        raise ValueError(
            f"over is {over!r}: pressures in space are drawn over the side; leave it out."
        )
    _check_target(V.mesh, file, view, ax)
    x = V.tabulate_dof_coordinates()[:, :d] + problem.solid.u.x.array.reshape(-1, d)
    sides = []
    for interface, surface in chosen:
        interface.force  # noqa: B018 - says that a step has to be made first
        side = parts_of_side(V, surface, x, interface.pressure.x.array)
        sides += [] if side is None else [(repr(interface), side)]

    # one title for all sides: the pressure of a contact is a normal traction, too
    pushes = all(interface.one_sided for interface, _ in chosen)
    title = "contact pressure" if pushes else "normal traction"

    def draw(target: Any) -> None:
        if d == 2:
            plane.draw_pressure(target, sides, over, title)
        else:
            space.draw_pressure(target, sides, title)

    return _on_rank_0(V.mesh, draw, file=file, view=view, ax=ax)


def _chosen(problem: Any, interfaces: Any) -> list[tuple[Any, Any]]:
    """Return the interfaces to draw, with the surfaces of their slave sides."""
    if not hasattr(problem, "system"):
        raise ValueError(f"problem is {problem!r}: give a ContactProblem.")
    problem.check_owned()
    own = list(zip(problem.interfaces, problem.system.sides, strict=True))
    asked = (problem.contacts or problem.interfaces) if interfaces is None else interfaces
    asked = list(asked) if isinstance(asked, list | tuple) else [asked]
    for interface in asked:
        if not any(interface is one for one, _ in own):
            raise ValueError(
                f"interfaces: {interface!r} is none of this problem's, {problem.interfaces}."
            )
    if not asked:
        said = (
            "problem has no contact or tie to draw"
            if interfaces is None
            else f"interfaces is {interfaces!r}"
        )
        raise ValueError(f"{said}; interfaces of the problem: {problem.interfaces}.")
    return [(one, side.slave) for one, side in own if any(one is i for i in asked)]


Values = tuple[str, dict[str, np.ndarray], dict[str, np.ndarray]]
"""Title, values at the local nodes and values of the owned cells, by title."""


def _values(solid: Any, name: str | fem.Function) -> Values:
    """Return what is drawn of a field by its name, or of a Function; collective."""
    if isinstance(name, fem.Function):
        return _values_of(solid.V, name)
    axes = "xyz"[: solid.V.mesh.geometry.dim]
    components = {"displacement": None} | {f"displacement_{a}": i for i, a in enumerate(axes)}
    drawable = [*components, *solid.fields.scalars]
    if not is_name(name, drawable):
        raise ValueError(f"name is {name!r}: choose one of {', '.join(drawable)}, or a Function.")
    if name in components:
        return name, {name: _at_nodes(solid.V, solid.u, components[name])}, {}
    return name, {}, {name: _of_cells(solid.cell_values(name))}


def _values_of(V: fem.FunctionSpace, function: fem.Function) -> Values:
    """Return what is drawn of a Function.

    Raises:
        ValueError: if it lives on another mesh, or is neither constant in cells nor continuous.
    """
    name, space = function.name, function.function_space
    if space.mesh is not V.mesh:
        raise ValueError(f"name: the Function {name!r} lives on another mesh than the bodies.")
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


def _check_target(domain: dmesh.Mesh, file: Any, view: Any, ax: Any) -> None:
    """Raise an error on all ranks, before anything is gathered, if one cannot draw there.

    Axes may be given on rank 0 alone, where they are. Collective.
    """
    dim = domain.geometry.dim
    require("matplotlib" if dim == 2 else "pyvista")
    with raised_together(domain.comm):
        if not (file is None or isinstance(file, str | os.PathLike)):
            raise ValueError(f"file is {file!r}: give the name of a picture, such as 'stress.png'.")
        if dim == 2 and view is not None:
            raise ValueError(f"view is {view!r}: for bodies in space only; leave it out.")
        if dim == 2 and ax is not None and not hasattr(ax, "add_collection"):
            raise ValueError(f"ax is {ax!r}: give axes of matplotlib, such as subplots()[1].")
        if dim == 3 and ax is not None:
            raise ValueError("ax is for bodies in the plane only; leave it out, PyVista draws.")
        if view is not None:
            space.direction(view)


def _on_rank_0(
    domain: dmesh.Mesh,
    draw: Callable[[Any], None],
    *,
    file: File,
    view: Any,
    ax: Any,
    panes: int = 1,
) -> Any:
    """Draw on rank 0 and return what was drawn on; errors are raised on all ranks; collective."""
    result = None
    with raised_together(domain.comm):
        if domain.comm.rank == 0:
            if domain.geometry.dim == 2:
                result = ax if ax is not None else plane.new_axes(file)
                draw(result)
                plane.finish(result, file)
            else:
                result = space.new_plotter(panes, file)
                draw(result)
                space.finish(result, file, view)
    return result

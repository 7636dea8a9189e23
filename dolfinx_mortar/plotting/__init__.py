# SPDX-License-Identifier: MIT
"""Pictures: a mesh with its tags, a field on the deformed bodies, pressures.

    dm.plotting.mesh(*dm.meshing.read_msh("bearing.msh"))
    dm.plotting.field(problem, "von_mises", file="stress.png")
    dm.plotting.pressure(problem)

Bodies in the plane are drawn by matplotlib, bodies in space by PyVista (``pip install
dolfinx_mortar[demo]``). All functions are collective and gather on rank 0.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from itertools import cycle
from typing import Any

import numpy as np

from dolfinx import fem, plot
from dolfinx import mesh as dmesh
from dolfinx_mortar.algebra.parallel import raised_together
from dolfinx_mortar.common import compat
from dolfinx_mortar.common.agreement import check_same_on_all_ranks
from dolfinx_mortar.common.arguments import check, check_optional, instance, one_of
from dolfinx_mortar.common.arrays import Floats, Ints, Longs
from dolfinx_mortar.common.spaces import CELLS
from dolfinx_mortar.common.tags import names_of, tags_of
from dolfinx_mortar.interfaces.interface import check_owned
from dolfinx_mortar.mortar.surface import connect, facet_nodes
from dolfinx_mortar.solid.laws import UNTAGGED, tags_of_cells

__all__ = ["field", "mesh", "pressure"]

SIDES = ("#d62728", "#1f77b4", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf", "#8c564b", "#e377c2")
File = str | os.PathLike[str] | None


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

    Collective.

    Args:
        mesh: the mesh.
        cell_tags: of its bodies, see `Tags` for names.
        facet_tags: of its sides; in space in their own pane.
        file: picture to write (.png), without opening a window.
        view: in space, the direction (x, y, z) to look from.
        ax: axes of matplotlib to draw in, in the plane; on rank 0.

    Returns:
        matplotlib's axes in the plane, PyVista's plotter in space (call its ``show()``), None on
        all ranks but 0.

    Raises:
        ValueError: for wrong arguments, also `view` in the plane and `ax` in space.
        ImportError: without matplotlib or PyVista.
        RuntimeError: in space, without a screen.
    """
    if not isinstance(mesh, dmesh.Mesh) or mesh.topology.cell_name() not in CELLS:
        unpack = "; unpack what a reader returns, mesh(*found)" if isinstance(mesh, tuple) else ""
        raise ValueError(
            f"mesh is {mesh!r}: give a dolfinx mesh of {', '.join(CELLS)} cells{unpack}."
        )
    check_same_on_all_ranks(mesh.comm, cell_tags=cell_tags, facet_tags=facet_tags)
    tdim = mesh.topology.dim
    check_optional("facet_tags", facet_tags, tags_of(mesh, tdim - 1))
    owned = mesh.topology.index_map(tdim).size_local
    values = np.full(owned, UNTAGGED) if cell_tags is None else tags_of_cells(mesh, cell_tags)
    V = fem.functionspace(mesh, ("Lagrange", compat.cell_degree(mesh)))
    x = V.tabulate_dof_coordinates()
    layers = [(gather_bodies(V, x, values[:owned], at_nodes=False), cell_tags)]
    if facet_tags is not None:
        layers.append((_gather_facets(V, x, facet_tags), facet_tags))
    to = file, view, ax
    return _on_rank_0(mesh, to, lambda drawer, on: drawer.draw_mesh(on, layers), len(layers))


def field(
    problem: Any,
    name: str,
    *,
    scale: float = 1.0,
    file: File = None,
    view: Any = None,
    ax: Any = None,
) -> Any:
    """Draw a field on the deformed bodies.

    Rigid tools are drawn near the bodies, unless displacements are enlarged.

    Args:
        problem: a `ContactProblem`, or a `Solid`, which has no tools.
        name: of a scalar field of `Solid.cell_values`, such as "von_mises" or "stress_yy", with one
            colour per cell; "displacement" for its length, or "displacement_x".
        scale: factor of displacements.
        file: as `view`, `ax`, result and errors, see `mesh`.
    """
    solid = getattr(problem, "solid", problem)
    V = getattr(solid, "V", None)
    if not isinstance(V, fem.FunctionSpace) or not hasattr(solid, "cell_values"):
        raise ValueError(f"problem is {problem!r}: give a ContactProblem or a Solid.")
    check_same_on_all_ranks(V.mesh.comm, name=name, scale=scale)
    d, u = V.mesh.geometry.dim, solid.u.x.array.reshape(-1, V.mesh.geometry.dim)
    of_nodes = {"displacement": np.linalg.norm(u, axis=1)}
    of_nodes |= {f"displacement_{axis}": u[:, k] for k, axis in enumerate("xyz"[:d])}
    check("name", name, one_of(*of_nodes, *solid.fields.scalars))
    if name in of_nodes:
        values = of_nodes[name]
    else:
        found = solid.cell_values(name)
        owned = V.mesh.topology.index_map(d).size_local
        values = found.x.array[found.function_space.dofmap.list[:owned, 0]]
    bodies = gather_bodies(V, _moved(V, solid.u, scale), values, name in of_nodes)
    every = getattr(problem, "interfaces", ()) if scale == 1.0 else ()
    tools = [one.tool for one in every if one.tool is not None]

    to = file, view, ax
    return _on_rank_0(V.mesh, to, lambda drawer, on: drawer.draw_field(on, bodies, name, tools))


def pressure(
    problem: Any, interfaces: Any = None, *, file: File = None, view: Any = None, ax: Any = None
) -> Any:
    """Draw the contact pressure: along the slave side in the plane, over it in space.

    In the plane the abscissa is the axis along which the sides are longer. Of ties the normal
    traction is drawn, positive in compression.

    Args:
        problem: a `ContactProblem` after a step.
        interfaces: some of its interfaces, by default its contacts, or its ties if it has none.
        file: as `view`, `ax`, result and errors, see `mesh`.

    Raises:
        NoResult: before the first step.
    """
    if not hasattr(problem, "supports"):
        raise ValueError(f"problem is {problem!r}: give a ContactProblem.")
    check_owned(problem.interfaces, problem.supports)
    check_same_on_all_ranks(problem.comm, interfaces=interfaces)
    asked = (problem.contacts or problem.interfaces) if interfaces is None else interfaces
    chosen = list(asked) if isinstance(asked, list | tuple) else [asked]
    wrong = [one for one in chosen if not any(one is own for own in problem.interfaces)]
    if wrong or not chosen:
        raise ValueError(
            f"interfaces is {wrong or interfaces!r}: no contact or tie of the problem is given or "
            f"there; it has {problem.interfaces}."
        )
    V: fem.FunctionSpace = problem.solid.V
    moved, sides = _moved(V, problem.solid.u, 1.0), []
    for one in chosen:
        one.force  # noqa: B018 - an error before the first step
        side = _gather_facets(V, moved, one.facet_tags, one.slave, one.pressure.x.array)
        sides += [] if side is None else [(repr(one), side)]
    # one title for all sides: the pressure of a contact is a normal traction, too
    title = "contact pressure" if all(one.unilateral for one in chosen) else "normal traction"
    to = file, view, ax
    return _on_rank_0(V.mesh, to, lambda drawer, on: drawer.draw_pressure(on, sides, title))


def _moved(V: fem.FunctionSpace, u: fem.Function, scale: float) -> Floats:
    x = V.tabulate_dof_coordinates().copy()
    d = V.mesh.geometry.dim
    x[:, :d] += scale * u.x.array.reshape(-1, d)
    return x


def _on_rank_0(
    domain: dmesh.Mesh,
    to: tuple[File, Any, Any],
    draw: Callable[[Any, Any], Any],
    panes: int = 1,
) -> Any:
    """Draw on rank 0 and return axes or plotter; errors are raised on all ranks; collective.

    `draw` may return a direction to look from.
    """
    dim, (file, view, ax) = domain.geometry.dim, to
    with raised_together(domain.comm):
        check_optional("file", file, instance((str, os.PathLike), "give the name of a picture"))
        name, given, where = ("view", view, "space") if dim == 2 else ("ax", ax, "the plane")
        if given is not None:
            raise ValueError(f"{name} is {given!r}: for bodies in {where} only; leave it out")
    try:
        drawer = import_module(f"{__name__}.{'in_plane' if dim == 2 else 'in_space'}")
    except ImportError as error:
        library = "matplotlib" if dim == 2 else "pyvista"
        raise ImportError(
            f"{library} is needed for this picture and cannot be imported ({error}): pip install "
            f"'dolfinx_mortar[demo]', or the package python3-{library}.",
            name=library,
        ) from error
    result = None
    with raised_together(domain.comm):
        if domain.comm.rank == 0:
            result = drawer.begin(file, ax, panes)
            own = draw(drawer, result)
            drawer.finish(result, file, own if view is None else view)
    return result


@dataclass(frozen=True)
class Parts:
    """Cells in the plane, or facets, of all ranks, with nodal or constant values."""

    x: Floats  # (n, 3)
    nodes: Longs  # (m, k): vertices in order around the part, middles of edges, interior node
    values: np.ndarray  # (n,) at nodes, or (m,)
    at_nodes: bool

    @property
    def box(self) -> Floats:
        """Box (2, 3) around the parts, enlarged by a tenth of its diagonal."""
        low, high = self.x.min(axis=0), self.x.max(axis=0)
        beside = 0.1 * np.linalg.norm(high - low)
        return np.stack([low - beside, high + beside])

    @property
    def polygons(self) -> Longs:
        """Nodes (m, p) around the parts."""
        k = self.nodes.shape[1]
        n = 3 if k in (3, 6) else 4
        return self.nodes if k == n else self.nodes[:, np.arange(2 * n).reshape(2, n).T.ravel()]

    @property
    def triangles(self) -> Longs:
        """Nodes (t, 3) of triangles of the parts, in order, around an interior or mid node."""
        around = self.polygons
        if self.nodes.shape[1] > around.shape[1]:
            tip, rim = self.nodes[:, -1:], np.hstack([around, around[:, :1]])
        else:
            tip, rim = around[:, 1:2], np.hstack([around[:, 2:], around[:, :1]])
        corners = np.broadcast_arrays(tip, rim[:, :-1], rim[:, 1:])
        return np.stack(corners, axis=2).reshape(-1, 3)

    def by_tag(
        self, tags: dmesh.MeshTags | None, colours: Sequence[str]
    ) -> Iterator[tuple[str, str, Parts]]:
        """Yield name, colour and parts of each tag, with colours repeated."""
        names = {tag: name for name, tag in names_of(tags).items()} | {UNTAGGED: "no tag"}
        for tag, colour in zip(np.unique(self.values), cycle(colours), strict=False):
            on = self.values == tag
            parts = replace(self, nodes=self.nodes[on], values=self.values[on])
            yield names.get(int(tag), f"tag {tag}"), colour, parts


def gather_bodies(
    V: fem.FunctionSpace, x: Floats, values: np.ndarray, at_nodes: bool
) -> Parts | None:
    """Gather cells in the plane, or outer facets in space, on rank 0; collective.

    `x` (n, 3) are positions of local nodes; values at the local nodes (n,), or of the owned cells.
    """
    topology = V.mesh.topology
    if topology.dim == 2:
        listed, _, _ = plot.vtk_mesh(V)
        nodes = listed.reshape(-1, V.dofmap.dof_layout.num_dofs + 1)[:, 1:]
        return _gather(V, nodes, x, values, at_nodes)
    connect(topology)
    nodes, cells = facet_nodes(V, dmesh.exterior_facet_indices(topology))
    return _gather(V, nodes, x, values if at_nodes else values[cells], at_nodes)


def _gather_facets(
    V: fem.FunctionSpace,
    x: Floats,
    tags: dmesh.MeshTags,
    tag: int | None = None,
    values: Floats | None = None,
) -> Parts | None:
    chosen = tags.indices < V.mesh.topology.index_map(tags.dim).size_local
    if tag is not None:
        chosen &= tags.values == tag
    connect(V.mesh.topology)
    nodes, _ = facet_nodes(V, tags.indices[chosen])
    own = tags.values[chosen] if values is None else values
    return _gather(V, nodes, x, own, at_nodes=values is not None)


def _gather(
    V: fem.FunctionSpace, nodes: Ints | Longs, x: Floats, values: np.ndarray, at_nodes: bool
) -> Parts | None:
    """Parts of all ranks on rank 0, None elsewhere; collective."""
    used, own = np.unique(nodes, return_inverse=True)
    ranks = V.mesh.comm.gather(
        (x[used], own.reshape(nodes.shape), values[used] if at_nodes else values)
    )
    if ranks is None:
        return None
    points, numbers, found = zip(*ranks, strict=True)
    before = np.cumsum([0, *map(len, points)])
    own = np.concatenate([one + n for one, n in zip(numbers, before, strict=False)])
    return Parts(np.concatenate(points), own, np.concatenate(found), at_nodes)

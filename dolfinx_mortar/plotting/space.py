# SPDX-License-Identifier: MIT
"""Bodies in space, drawn by PyVista."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from dolfinx import mesh as dmesh
from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.plotting.libraries import find_screen, require
from dolfinx_mortar.plotting.parts import TRIANGLES, WAY_AROUND, Parts, groups
from dolfinx_mortar.plotting.plane import COLOURS, SIDES

BODIES = ("#6f9bc4", "#cf9650", "#7fae69", "#a583bd", "#b5a53c", "#909090")  # also of their names


def new_plotter(panes: int, file: Any) -> Any:
    """Return a plotter, without a window where there is no screen, or a file is asked for.

    Raises:
        RuntimeError: if nothing can be drawn.
    """
    pyvista = require("pyvista")
    hidden = find_screen() or pyvista.OFF_SCREEN or file is not None
    plotter = pyvista.Plotter(
        off_screen=hidden, shape=(1, panes), border=False, window_size=(500 + 500 * panes, 800)
    )
    plotter.set_background("white", all_renderers=True)
    return plotter


def finish(plotter: Any, file: Any, view: Any) -> Any:
    """Look from the asked direction, write a picture if there is a file, return the plotter."""
    if view is not None:
        look(plotter, direction(view))
    if file is not None:
        plotter.screenshot(os.fspath(file))
    return plotter


def draw_mesh(
    plotter: Any,
    outside: Parts,
    facets: Parts | None,
    cell_tags: dmesh.MeshTags | None,
    facet_tags: dmesh.MeshTags | None,
) -> None:
    """Draw the bodies in one pane and the tagged sides in another one, with their names."""
    entries = []
    for name, colour, body in groups(outside, cell_tags, BODIES):
        entries.append((name, colour))
        _add_facets(plotter, body, color=colour, ambient=0.4)
    _describe(plotter, entries if cell_tags is not None else [])
    if facets is None or not len(facets.nodes):
        return
    plotter.subplot(0, 1)
    entries = []
    for name, colour, side in groups(facets, facet_tags, SIDES):
        entries.append((name, colour))
        _add_facets(plotter, side, color=colour, opacity=0.5, ambient=0.6)
    # facets are numbered either way around
    surface = _triangles(outside).compute_normals(cell_normals=False, split_vertices=False)
    outline = surface.extract_feature_edges(boundary_edges=False, manifold_edges=False)
    if outline.n_points:
        plotter.add_mesh(outline, color="#404040", line_width=2)
    _describe(plotter, entries)
    plotter.link_views()


def draw_field(plotter: Any, outside: Parts, name: str) -> None:
    """Draw a field of cells (flat colours) or of nodes (shaded) with its scale."""
    _draw_values(plotter, outside, name, name)
    _describe(plotter, [])


def draw_pressure(plotter: Any, sides: list[tuple[str, Parts]], title: str) -> None:
    """Draw pressures on the slave sides, seen from the master's side."""
    towards = np.zeros(3)
    for _, side in sides:
        _draw_values(plotter, side, "value", title)
        a, b, c = (side.x[side.nodes[:, i]] for i in range(3))
        towards += np.cross(b - a, c - a).sum(axis=0)
    _describe(plotter, [])
    size = float(np.linalg.norm(towards))
    if size > 0.0:
        look(plotter, towards / size)


def look(plotter: Any, towards: np.ndarray) -> None:
    """Look from a direction (3,), with z upwards, or y where that is the direction."""
    upright = np.linalg.norm(towards[:2]) > 0.1 * abs(towards[2])
    for renderer in plotter.renderers:
        renderer.view_vector(towards, viewup=(0, 0, 1) if upright else (0, 1, 0))


def direction(view: Any) -> Floats:
    """Return a direction (3,) that a user has given.

    Raises:
        ValueError: for what is no direction.
    """
    try:
        towards = np.array(view, dtype=float)
    except (TypeError, ValueError):
        towards = np.zeros(0)
    if towards.shape != (3,) or not np.isfinite(towards).all() or not towards.any():
        raise ValueError(f"view is {view!r}: give the direction to look from, (x, y, z).")
    return towards


def _draw_values(plotter: Any, parts: Parts, name: str, title: str) -> None:
    """Draw values of parts or at nodes in colours, with their scale."""
    bar = {"title": f"{title}\n", "color": "black", "vertical": True, "position_x": 0.85}
    bar |= {"fmt": "%.3g", "title_font_size": 18, "label_font_size": 18}
    _add_facets(plotter, parts, name, cmap=COLOURS, lighting=False, scalar_bar_args=bar)


def _add_facets(plotter: Any, facets: Parts, name: str | None = None, **style: Any) -> None:
    """Draw facets and their edges, in the colours of one of their values if it is named."""
    surface = _triangles(facets)
    if name in facets.of_parts:
        each = surface.n_cells // len(facets.nodes)
        style["scalars"] = np.repeat(facets.of_parts[name], each)
    elif name is not None:
        style["scalars"] = facets.at_nodes[name]
    actor = plotter.add_mesh(surface, **style)
    # edges lie in front of their facets, also of those that are seen at an angle
    actor.mapper.resolve = "polygon_offset"
    actor.mapper.SetRelativeCoincidentTopologyPolygonOffsetParameters(2.0, 2.0)
    around = facets.nodes[:, WAY_AROUND[facets.nodes.shape[1]]]
    closed = np.hstack([np.full((len(around), 1), around.shape[1] + 1), around, around[:, :1]])
    edges = require("pyvista").PolyData(facets.x, lines=closed.ravel())
    plotter.add_mesh(edges, color="#303030", line_width=1, opacity=0.4, lighting=False)


def _triangles(facets: Parts) -> Any:
    """Return facets for PyVista, those with curved edges in parts."""
    corners = np.array(TRIANGLES[facets.nodes.shape[1]])
    triangles = facets.nodes[:, corners].reshape(-1, 3)
    return require("pyvista").PolyData.from_regular_faces(facets.x, triangles)


def _describe(plotter: Any, entries: list[tuple[str, str]]) -> None:
    """Add names and axes to a pane."""
    for i, (name, colour) in enumerate(entries):
        place = {"position": (0.03, 0.95 - 0.035 * i), "viewport": True}
        plotter.add_text(name, color=colour, font_size=12, **place)
    plotter.add_axes(color="black")
    plotter.view_isometric()

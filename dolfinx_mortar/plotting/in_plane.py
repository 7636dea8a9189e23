# SPDX-License-Identifier: MIT
"""Bodies in the plane, drawn by matplotlib."""

from typing import Any

import numpy as np
from matplotlib import pyplot
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from dolfinx import mesh as dmesh
from dolfinx_mortar.plotting import SIDES, Parts

GRID = 400
"""Points along each side of the box in which tools are drawn."""

TOOL = "#b8b8b8"
BODIES = ("#c6d8ea", "#ecd3b4", "#cfe3c4", "#dccbe6", "#e8e0b0", "#d9d9d9")


def begin(file: Any, ax: Any, panes: int) -> Any:
    """Axes: given ones, of pyplot, or for a file only."""
    if ax is not None:
        return ax
    figure = pyplot.figure(layout="constrained") if file is None else Figure(layout="constrained")
    return figure.subplots()


def finish(axes: Any, file: Any, view: Any) -> None:
    """Write the figure if there is a file for it."""
    if file is not None:
        axes.figure.savefig(file, dpi=150, bbox_inches="tight")


def draw_mesh(axes: Any, layers: list[tuple[Parts, dmesh.MeshTags | None]]) -> None:
    """Draw bodies, and tagged sides as thick lines, with names."""
    entries: list[Any] = []
    (cells, cell_tags), *sides = layers
    for name, colour, body in cells.by_tag(cell_tags, BODIES):
        _add_cells(axes, body, facecolor=colour, edgecolor="#20415c80")
        if cell_tags is not None:
            entries.append(Patch(facecolor=colour, edgecolor="#20415c", label=name))
    for facets, facet_tags in sides:
        for name, colour, side in facets.by_tag(facet_tags, SIDES):
            lines = side.x[_in_order(side)][:, :, :2]
            entries.append(LineCollection(lines, colors=colour, linewidths=2.5, label=name))
            axes.add_collection(entries[-1])
    _frame(axes)
    if entries:
        axes.legend(handles=entries, loc="center left", bbox_to_anchor=(1.0, 0.5))


def draw_field(axes: Any, cells: Parts, name: str, tools: list[Any]) -> None:
    """Draw a field of cells (flat) or nodes (shaded) with its scale, and the interior of tools."""
    if cells.at_nodes:
        x, y = cells.x[:, :2].T
        style = {"shading": "gouraud", "cmap": "viridis"}
        drawn = axes.tripcolor(x, y, cells.triangles, cells.values, **style)
        _add_cells(axes, cells, facecolor="none", edgecolor="#00000030")
    else:
        drawn = _add_cells(axes, cells, array=cells.values, edgecolor="#00000030")
    axes.figure.colorbar(drawn, ax=axes, label=name, shrink=0.8)
    _frame(axes)
    if not tools:
        return
    low, high = cells.box
    x, y = (np.linspace(low[i], high[i], GRID) for i in range(2))
    points = np.stack(np.meshgrid(x, y), axis=-1)
    for tool in tools:
        phi = tool.shape.values(tool.pose().to_tool(points.reshape(-1, 2))).reshape(GRID, GRID)
        if phi.min() < 0.0:
            axes.contourf(x, y, phi, levels=[phi.min(), 0.0], colors=[TOOL], zorder=0.5)
            axes.contour(x, y, phi, levels=[0.0], colors=["#404040"], linewidths=1.0)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))


def draw_pressure(axes: Any, sides: list[tuple[str, Parts]], title: str) -> None:
    """Draw pressures over x or y, facet by facet."""
    axis = int(np.argmax(sum(np.ptp(side.x[:, :2], axis=0) for _, side in sides if len(side.x))))
    for (name, side), colour in zip(sides, SIDES * len(sides), strict=False):
        order = _in_order(side)
        gap = np.full((len(order), 1), np.nan)  # no line between facets
        s = np.hstack([side.x[order, axis], gap]).ravel()
        p = np.hstack([side.values[order], gap]).ravel()
        axes.plot(s, p, ".-", color=colour, ms=4, lw=1.0, label=name)
    loaded = np.concatenate([s.x[s.values != 0.0, axis] for _, s in sides])
    if len(loaded) > 1:
        axes.set_xlim(loaded.min() - np.ptp(loaded), loaded.max() + np.ptp(loaded))
    axes.set(xlabel="xy"[axis], ylabel=title)
    axes.grid(alpha=0.3)
    axes.legend(fontsize="small")


def _in_order(facets: Parts) -> Any:
    return facets.nodes[:, (0, 2, 1) if facets.nodes.shape[1] == 3 else (0, 1)]


def _add_cells(axes: Any, cells: Parts, **style: Any) -> Any:
    polygons: Any = cells.x[cells.polygons][:, :, :2]
    drawn = PolyCollection(polygons, linewidth=0.2, cmap="viridis", **style)
    axes.add_collection(drawn)
    return drawn


def _frame(axes: Any) -> None:
    axes.autoscale()
    axes.margins(0.03)
    axes.set(aspect="equal", xlabel="x", ylabel="y")

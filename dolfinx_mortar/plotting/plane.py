# SPDX-License-Identifier: MIT
"""Bodies in the plane, drawn by matplotlib."""

from __future__ import annotations

from typing import Any

import numpy as np

from dolfinx import mesh as dmesh
from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.plotting.libraries import require
from dolfinx_mortar.plotting.parts import TRIANGLES, WAY_AROUND, Parts, curves, groups

BODIES = ("#c6d8ea", "#ecd3b4", "#cfe3c4", "#dccbe6", "#e8e0b0", "#d9d9d9")
SIDES = ("#d62728", "#1f77b4", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf", "#8c564b", "#e377c2")
COLOURS = "viridis"
EDGES = 1e3  # cells from which on their edges become thinner, so as not to hide the colours
EQUAL = 1e-6  # relative difference of distances that count as one
MARGIN = 0.4  # of the loaded length, shown on both sides of it


def new_axes(file: Any) -> Any:
    """Return axes of a figure that pyplot shows, or of one that is only written to a file."""
    if file is None:
        try:
            return require("matplotlib.pyplot").subplots(layout="constrained")[1]
        except ImportError:  # a backend with windows was chosen, where there are none
            pass
    return require("matplotlib.figure").Figure(layout="constrained").subplots()


def finish(axes: Any, file: Any) -> Any:
    """Write the figure of axes if there is a file for it, and return the axes."""
    if file is not None:
        axes.figure.savefig(file, dpi=150, bbox_inches="tight")
    return axes


def draw_mesh(
    axes: Any,
    cells: Parts,
    facets: Parts | None,
    cell_tags: dmesh.MeshTags | None,
    facet_tags: dmesh.MeshTags | None,
) -> None:
    """Draw bodies in pale colours and tagged sides as thick lines, with their names."""
    patches = require("matplotlib.patches")
    entries = []
    for name, colour, body in groups(cells, cell_tags, BODIES):
        _add_cells(axes, body, facecolor=colour, edgecolor="#20415c80")
        if cell_tags is not None:
            entries.append(patches.Patch(facecolor=colour, edgecolor="#20415c", label=name))
    if facets is not None and len(facets.nodes):
        for name, colour, side in groups(facets, facet_tags, SIDES):
            entries.append(_add_lines(axes, side, colour, name))
    _frame(axes)
    if entries:
        axes.legend(handles=entries, loc="center left", bbox_to_anchor=(1.0, 0.5))


def draw_field(axes: Any, cells: Parts, name: str) -> None:
    """Draw a field of cells (flat colours) or of nodes (shaded) with its scale."""
    if name in cells.of_parts:
        drawn = _add_cells(
            axes, cells, array=cells.of_parts[name], cmap=COLOURS, edgecolor="#00000030"
        )
    else:
        corners = np.array(TRIANGLES[cells.nodes.shape[1]])
        triangles = cells.nodes[:, corners].reshape(-1, 3)
        drawn = axes.tripcolor(
            *cells.x[:, :2].T, triangles, cells.at_nodes[name], shading="gouraud", cmap=COLOURS
        )
        _add_cells(axes, cells, facecolor="none", edgecolor="#00000030")
    axes.figure.colorbar(drawn, ax=axes, label=name, shrink=0.8)
    _frame(axes)


def draw_pressure(axes: Any, sides: list[tuple[str, Parts]], over: str | None, title: str) -> None:
    """Draw pressures over a coordinate or the length along the slave sides."""
    lines = [(name, list(_curves(side))) for name, side in sides]
    every = [curve for _, found in lines for curve in found]
    over = over or _abscissa(every)
    ends = []
    for i, (name, found) in enumerate(lines):
        at = [_along(points, over) for points, _ in found]
        for k, (s, (_, p)) in enumerate(zip(at, found, strict=True)):
            label = name if k == 0 else None
            axes.plot(s, p, ".-", color=SIDES[i % len(SIDES)], ms=4, lw=1.0, label=label)
            ends += [s[p != 0.0]] if p.any() else []
    if ends:
        low, high = min(s.min() for s in ends), max(s.max() for s in ends)
        if high > low:  # more than one node
            axes.set_xlim(low - MARGIN * (high - low), high + MARGIN * (high - low))
    words = {"x": "x", "y": "y", "length": "length along the slave side"}
    axes.set(xlabel=words[over], ylabel=title)
    axes.grid(alpha=0.3)
    if lines:
        axes.legend(fontsize="small")


def _add_cells(axes: Any, cells: Parts, **style: Any) -> Any:
    """Draw cells as polygons along their nodes."""
    collections = require("matplotlib.collections")
    around = cells.nodes[:, WAY_AROUND[cells.nodes.shape[1]]]
    width = min(0.5, EDGES / max(len(around), 1))
    drawn = collections.PolyCollection(cells.x[around][:, :, :2], linewidth=width, **style)
    axes.add_collection(drawn)
    return drawn


def _add_lines(axes: Any, facets: Parts, colour: str, name: str) -> Any:
    """Draw facets as lines along their nodes."""
    collections = require("matplotlib.collections")
    way = (0, 2, 1) if facets.nodes.shape[1] == 3 else (0, 1)
    lines = facets.x[facets.nodes[:, way]][:, :, :2]
    drawn = collections.LineCollection(lines, colors=colour, linewidths=2.5, label=name)
    axes.add_collection(drawn)
    return drawn


def _frame(axes: Any) -> None:
    axes.autoscale()
    axes.margins(0.03)
    axes.set(aspect="equal", xlabel="x", ylabel="y")


def _curves(side: Parts) -> list[tuple[Floats, Floats]]:
    """Return points (n, 2) and values (n,) of each curve, from left to right, or upwards.

    Closed ones run counterclockwise from where they are farthest from what is loaded, whatever the
    numbers of their nodes are, which change with the ranks.
    """
    found = []
    for curve in curves(side.nodes[:, :2]):
        nodes = [int(side.nodes[curve[0][0], int(curve[0][1])])]
        for line, backwards in curve:
            own = side.nodes[line]
            nodes += [*own[2:], own[0] if backwards else own[1]]
        x, p = side.x[nodes, :2], side.at_nodes["value"][nodes]
        if nodes[0] == nodes[-1]:
            found.append(_opened(x, p))
            continue
        across = x[-1] - x[0]
        turn = across[np.argmax(np.abs(across))] < 0.0
        found.append((x[::-1], p[::-1]) if turn else (x, p))
    return found


def _opened(x: Floats, p: Floats) -> tuple[Floats, Floats]:
    """Return a closed curve, last point on the first, so that it starts away from the load."""
    a, b = x[:-1], x[1:]
    if np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) < 0.0:  # twice its area
        x, p = x[::-1], p[::-1]
    x, p = x[:-1], p[:-1]
    weight = np.abs(p) if p.any() else np.ones_like(p)
    away = np.linalg.norm(x - weight @ x / weight.sum(), axis=1)
    far = np.flatnonzero(away > (1.0 - EQUAL) * away.max())
    start = far[np.lexsort(np.round(x[far] / away.max(), 6).T)[0]]  # the lowest of several
    order = np.append(np.roll(np.arange(len(p)), -start), start)
    return x[order], p[order]


def _abscissa(lines: list[tuple[Floats, Floats]]) -> str:
    """Return the first of x, y and the length that grows along all curves."""
    for axis, name in enumerate("xy"):
        if all((np.diff(points[:, axis]) > 0.0).all() for points, _ in lines):
            return name
    return "length"


def _along(points: Floats, over: str) -> Floats:
    """Return the abscissa of points of a curve."""
    if over != "length":
        return points[:, "xy".index(over)]
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])

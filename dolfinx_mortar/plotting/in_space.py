# SPDX-License-Identifier: MIT
"""Bodies in space, drawn by PyVista, also without a screen."""

import ctypes
import ctypes.util
import os
import shutil
import subprocess
import sys
from functools import cache
from typing import Any

import numpy as np
import pyvista

from dolfinx import mesh as dmesh
from dolfinx_mortar.plotting import SIDES, Parts

TOOL = "#808080"
BODIES = ("#6f9bc4", "#cf9650", "#7fae69", "#a583bd", "#b5a53c", "#909090")  # also of their names


def begin(file: Any, ax: Any, panes: int) -> Any:
    """A plotter, off-screen for a file or without a screen; a RuntimeError if VTK cannot draw."""
    find_screen()
    plotter: Any = pyvista.Plotter(
        off_screen=pyvista.OFF_SCREEN or file is not None,
        shape=(1, panes),
        border=False,
        window_size=(500 + 500 * panes, 800),
    )
    plotter.set_background("white", all_renderers=True)
    for k in range(panes):
        plotter.subplot(0, k)
        plotter.add_axes(color="black")
    return plotter


def finish(plotter: Any, file: Any, view: Any) -> None:
    """Look from a direction with z upwards, or y for a view along z; write a picture to a file."""
    towards = np.asarray((1.0, 1.0, 1.0) if view is None else view, dtype=float)
    upright = np.linalg.norm(towards[:2]) > 0.1 * abs(towards[2])
    for renderer in plotter.renderers:
        renderer.view_vector(towards, viewup=(0, 0, 1) if upright else (0, 1, 0))
    if file is not None:
        plotter.screenshot(os.fspath(file))


def draw_mesh(plotter: Any, layers: list[tuple[Parts, dmesh.MeshTags | None]]) -> None:
    """Draw bodies and tagged sides in two panes, with names."""
    styles = {"ambient": 0.4}, {"ambient": 0.6, "opacity": 0.5}
    for k, (parts, tags) in enumerate(layers):
        plotter.subplot(0, k)
        names = []
        for name, colour, part in parts.by_tag(tags, (BODIES, SIDES)[k]):
            names.append((name, colour))
            _add_facets(plotter, part, color=colour, **styles[k])
        if k > 0:
            _add_facets(plotter, layers[0][0], color="white", opacity=0.1)
        if tags is not None and names:
            size = 0.25, 0.035 * len(names)
            plotter.add_legend(names, face="rectangle", loc="upper left", size=size)
    plotter.link_views()


def draw_field(plotter: Any, outside: Parts, name: str, tools: list[Any]) -> None:
    """Draw a field of cells (flat) or nodes (shaded) with its scale, and transparent tools."""
    _add_values(plotter, outside, name)
    low, high = outside.box
    corners = np.stack(np.meshgrid(*zip(low, high, strict=True)), axis=-1).reshape(-1, 3)
    for tool in tools:
        pose = tool.pose()
        within = pose.to_tool(corners)
        points, cells = tool.cut(within.min(axis=0), within.max(axis=0))
        if len(cells):
            surface: Any = pyvista.PolyData.from_regular_faces(pose.to_space(points), cells)
            clipped = surface.clip_box(np.column_stack([low, high]).ravel(), invert=False)
            if clipped.n_points:
                style = {"color": TOOL, "opacity": 0.35, "smooth_shading": True}
                plotter.add_mesh(clipped.extract_surface(), **style)


def draw_pressure(plotter: Any, sides: list[tuple[str, Parts]], title: str) -> Any:
    """Draw pressures on the slave sides; return the direction of their least extent."""
    for _, side in sides:
        _add_values(plotter, side, title)
    x = np.concatenate([side.x for _, side in sides])
    if not len(x):
        return None
    least = np.linalg.eigh(np.cov(x.T))[1][:, 0]
    return least * np.sign(least[np.abs(least).argmax()])


def _add_values(plotter: Any, parts: Parts, title: str) -> None:
    bar = {"title": f"{title}\n", "color": "black", "vertical": True, "position_x": 0.85}
    bar |= {"fmt": "%.3g", "title_font_size": 18, "label_font_size": 18}
    style = {"cmap": "viridis", "lighting": False, "scalar_bar_args": bar}
    _add_facets(plotter, parts, scalars=parts.values, **style)


def _add_facets(plotter: Any, facets: Parts, **style: Any) -> None:
    surface: Any = pyvista.PolyData.from_regular_faces
    around = surface(facets.x, facets.polygons)
    drawn = surface(facets.x, facets.triangles) if facets.at_nodes else around
    actor = plotter.add_mesh(drawn, **style)
    actor.mapper.resolve = "polygon_offset"
    actor.mapper.SetRelativeCoincidentTopologyPolygonOffsetParameters(2.0, 2.0)
    edges = {"color": "#303030", "line_width": 1, "opacity": 0.4, "lighting": False}
    plotter.add_mesh(around.extract_all_edges(), **edges)


def find_screen() -> None:
    """Make sure that VTK can draw, off-screen if necessary, or raise a RuntimeError.

    A VTK before 9.4, as in Debian 13, ends the program without an X server: then Xvfb is started.
    """
    display = os.environ.get("DISPLAY", "")
    if sys.platform in ("darwin", "win32") or _connect(display):
        return
    if pyvista.vtk_version_info < (9, 4):
        own = _start() if shutil.which("Xvfb") else ""
        if not _connect(own):
            raise RuntimeError(
                f"there is no screen to draw on in 3D: no X server answers at DISPLAY = "
                f"{display!r}. Install Xvfb (apt-get install xvfb), or a VTK from 9.4 on, which "
                "draws in memory."
            )
        os.environ["DISPLAY"] = own
    pyvista.OFF_SCREEN = True


@cache
def _connect(display: str) -> bool:
    """Whether an X server answers; stays connected."""
    library = ctypes.util.find_library("X11")
    if not display or library is None:
        return bool(display)
    x11 = ctypes.CDLL(library)
    x11.XOpenDisplay.restype = ctypes.c_void_p  # not the default, an integer of 32 bits
    return bool(x11.XOpenDisplay(display.encode()))


def _start() -> str:
    """Start Xvfb, which ends after its last client; return its display."""
    server = subprocess.Popen(
        "Xvfb -displayfd 1 -terminate -nolisten tcp -screen 0 1600x1200x24".split(),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        start_new_session=True,  # or Ctrl-C would end it, and the next picture the program
    )
    assert server.stdout is not None
    with server.stdout as said:
        number = said.readline().strip()
    return f":{number}" if number else ""

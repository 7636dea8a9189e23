# SPDX-License-Identifier: MIT
"""The pictures of the sphere demo: bodies in perspective, contact pressure as a map and a curve.

They are drawn on one rank from the XDMF file, so they look the same on any number of ranks. Fields
are constant per cell, as computed, and drawn on the deformed bodies at true scale.
"""

from __future__ import annotations

import logging
import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import meshio
import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation

log = logging.getLogger(__name__)

ZZ = 8  # place of the zz component among the nine of a tensor
DPI = 150
SIZE = (1200, 900)  # pixels of the pictures in perspective
VIEW = (-1.0, -1.1, 0.75)  # from where the symmetry planes are seen
COLOURS = "viridis"

Pressure = tuple[np.ndarray, np.ndarray]  # positions (n, 2), pressures (n,)


def draw(output: Path, xdmf: Path, step: dict[str, Any], pressure: Pressure) -> None:
    """Draw all pictures of the last step into a folder; call on one rank.

    Args:
        output: Existing folder for the PNG files.
        xdmf: File written by `dolfinx_mortar.Writer`.
        step: The demo's numbers of the last step: load, force and Hertz' solution.
        pressure: Positions (n, 2) [mm] and contact pressures (n,) [MPa] of the slave nodes.
    """
    _map(step, pressure).savefig(output / "pressure_map.png", dpi=DPI)
    _curve(step, pressure).savefig(output / "pressure.png", dpi=DPI)
    try:
        import pyvista
    except ImportError:
        log.warning("pyvista is not installed: no pictures in perspective")
        return
    with _screen() as found:
        if found:
            _perspectives(pyvista, output, xdmf, step, pressure)
        else:
            log.warning("no screen and no Xvfb: no pictures in perspective")


@contextmanager
def _screen() -> Iterator[bool]:
    """Provide an X server of our own if there is no screen; tell whether there is one."""
    if os.environ.get("DISPLAY"):
        yield True
        return
    if shutil.which("Xvfb") is None:
        yield False
        return
    read, write = os.pipe()
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", str(write), "-screen", "0", "1600x1200x24", "-nolisten", "tcp"],
        pass_fds=[write],
        stderr=subprocess.DEVNULL,
    )
    os.close(write)
    with os.fdopen(read) as pipe:
        number = pipe.readline().strip()
    try:
        if number:
            os.environ["DISPLAY"] = f":{number}"
        yield bool(number)
    finally:
        os.environ.pop("DISPLAY", None)
        server.terminate()
        server.wait()


def _perspectives(
    pyvista: Any, output: Path, xdmf: Path, step: dict[str, Any], pressure: Pressure
) -> None:
    """Draw mesh and fields, whole and at the contact."""
    grid = _read(pyvista, xdmf)
    load = f"d = {step['displacement']:.4g} mm, P = {step['force']:.0f} N"
    near = _near(pressure)
    pictures = {
        "mesh": (None, f"Quarter model: {grid.n_cells} cells, {grid.n_points} nodes", None),
        "von_mises": ("von_mises", f"Von Mises stress [MPa], {load}", None),
        "von_mises_zoom": ("von_mises", f"Von Mises stress [MPa], {load}", near),
        "stress_z_zoom": ("stress_z", f"Vertical stress [MPa], {load}", near),
        "deformed": ("u_z", f"Vertical displacement [mm], {load}", None),
    }
    if step["plastic_volume"] > 0.0:
        pictures["plastic_strain_zoom"] = (
            "plastic_strain_norm",
            f"Plastic strain (Frobenius norm), {load}",
            near,
        )
    for name, (field, title, size) in pictures.items():
        pixels = _photograph(pyvista, grid, field, size)
        _framed(pixels, grid, field, title).savefig(output / f"{name}.png", dpi=DPI)


def _photograph(pyvista: Any, grid: Any, field: str | None, size: float | None) -> np.ndarray:
    """Return the pixels of the bodies, seen so that both symmetry planes show."""
    plotter = pyvista.Plotter(off_screen=True, window_size=SIZE)
    plotter.set_background("white")
    style = {"show_edges": True, "line_width": 1, "edge_color": "#404040", "edge_opacity": 0.4}
    if field is None:
        plotter.add_mesh(grid, scalars="body", cmap=["#b9cfe4", "#e4c9a8"], **style)
    else:
        plotter.add_mesh(grid, scalars=field, cmap=COLOURS, lighting=False, **style)
    plotter.remove_scalar_bar()
    plotter.add_axes(color="black")
    plotter.enable_parallel_projection()
    plotter.view_vector(VIEW, viewup=(0, 0, 1))
    if size is not None:
        plotter.camera.focal_point = (0.0, 0.0, 0.0)
        plotter.camera.position = tuple(100.0 * c for c in VIEW)
        plotter.camera.parallel_scale = size
    pixels = plotter.screenshot(return_img=True)
    plotter.close()
    return np.asarray(pixels)


def _framed(pixels: np.ndarray, grid: Any, field: str | None, title: str) -> Figure:
    """Put a picture below its title and beside its colour bar."""
    figure = Figure(figsize=(8.0, 5.8), layout="constrained")
    axes = figure.subplots()
    axes.imshow(pixels)
    axes.set_axis_off()
    axes.set_title(title)
    if field is not None:
        values = grid[field]
        norm = Normalize(float(values.min()), float(values.max()))
        figure.colorbar(ScalarMappable(norm, COLOURS), ax=axes, shrink=0.8)
    return figure


def _read(pyvista: Any, xdmf: Path) -> Any:
    """Return the last step that the file holds, on the deformed bodies."""
    with meshio.xdmf.TimeSeriesReader(xdmf) as reader:
        points, (block,) = reader.read_points_cells()
        _, node, cell = reader.read_data(reader.num_steps - 1)
    kinds = {"hexahedron": pyvista.CellType.HEXAHEDRON, "tetra": pyvista.CellType.TETRA}
    grid = pyvista.UnstructuredGrid(
        {kinds[block.type]: np.asarray(block.data)}, points + node["displacement"]
    )
    # the bodies are told apart before they are deformed
    middle = points[block.data][:, :, 2].mean(axis=1)
    grid.cell_data["body"] = (middle > 0.0).astype(float)
    grid.cell_data["stress_z"] = cell["stress"][0][:, ZZ]
    for name in ("von_mises", "plastic_strain_norm"):
        if name in cell:
            grid.cell_data[name] = cell[name][0]
    grid.point_data["u_z"] = node["displacement"][:, 2]
    return grid


def _near(pressure: Pressure) -> float:
    """Return half the height of the part to show at the contact."""
    x, p = pressure
    r = np.hypot(*x.T)
    return 1.6 * float(r[p > 0.0].max(initial=0.1 * r.max()))


def _map(step: dict[str, Any], pressure: Pressure) -> Figure:
    """Draw the pressure over the quarter of the contact, with Hertz' circle."""
    x, p = pressure
    figure = Figure(figsize=(6.4, 5.4), layout="constrained")
    axes = figure.subplots()
    drawn = axes.tripcolor(Triangulation(*x.T), p, shading="gouraud", cmap="inferno")
    axes.plot(*x[p > 0.0].T, ".", color="white", ms=2, label="nodes in contact")
    a = step["contact_radius_hertz"]
    t = np.linspace(0.0, np.pi / 2, 91)
    axes.plot(a * np.cos(t), a * np.sin(t), "c--", lw=1.2, label=f"Hertz, elastic: a = {a:.3f} mm")
    limit = 1.25 * max(a, step["contact_radius_last_node"])
    axes.set(
        aspect="equal",
        title=f"Contact pressure at $P$ = {step['force']:.0f} N",
        xlabel="x [mm]",
        ylabel="y [mm]",
        xlim=(0.0, limit),
        ylim=(0.0, limit),
    )
    axes.legend(loc="upper right", fontsize="small", facecolor="#808080")
    figure.colorbar(drawn, ax=axes, label="pressure [MPa]")
    return figure


def _curve(step: dict[str, Any], pressure: Pressure) -> Figure:
    """Draw the nodal pressures over the radius, and Hertz' elastic solution for this force."""
    x, p = pressure
    r = np.hypot(*x.T)
    figure = Figure(figsize=(7.2, 4.6), layout="constrained")
    axes = figure.subplots()
    a, p0 = step["contact_radius_hertz"], step["peak_pressure_hertz"]
    t = np.linspace(0.0, np.pi / 2, 201)
    label = f"Hertz, elastic: $p_0$ = {p0:.0f} MPa, $a$ = {a:.3f} mm"
    axes.plot(a * np.cos(t), p0 * np.sin(t), "k--", lw=1.2, label=label)
    limit = 1.4 * max(a, step["contact_radius_last_node"], 1e-300)
    shown = r < limit
    label = f"computed, all slave nodes: largest {p.max(initial=0.0):.0f} MPa"
    axes.plot(r[shown], p[shown], "o", color="#c03a2b", ms=3.5, label=label)
    axes.set(
        title=f"Contact pressure at $P$ = {step['force']:.0f} N",
        xlabel="distance r from the axis [mm]",
        ylabel="pressure [MPa]",
        xlim=(0.0, limit),
    )
    axes.set_ylim(0.0, 1.25 * max(axes.get_ylim()[1], 1e-300))  # room for the legend
    axes.grid(alpha=0.3)
    axes.legend(loc="upper right", fontsize="small")
    return figure

# SPDX-License-Identifier: MIT
"""The pictures of the sphere demo: bodies in perspective, contact pressure as a map and a curve.

Fields are computed as constants per cell, and drawn on the deformed bodies at true scale.
"""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation

import dolfinx_mortar as dm

log = logging.getLogger(__name__)

DPI = 150
VIEW = (-1.0, -1.1, 0.75)  # direction of the camera: both symmetry planes are visible

Pressure = tuple[np.ndarray, np.ndarray]  # positions (n, 2), pressures (n,)


def draw(
    output: Path,
    problem: dm.ContactProblem,
    bodies: dm.Tags,
    step: dict[str, Any],
    pressure: Pressure,
) -> None:
    """Draw all pictures of the last step into a folder; collective.

    Args:
        output: Existing folder for the PNG files.
        problem: The problem after its last step.
        bodies: Its cell tags.
        step: The demo's numbers of the last step: load, force and Hertz' solution.
        pressure: Positions (n, 2) [mm] and contact pressures (n,) [MPa] of the slave nodes.
    """
    if problem.comm.rank == 0:
        _map(step, pressure).savefig(output / "pressure_map.png", dpi=DPI)
        _curve(step, pressure).savefig(output / "pressure.png", dpi=DPI)
    try:
        _perspectives(output, problem, bodies, step, _near(pressure))
    except (ImportError, RuntimeError) as error:
        log.warning("no pictures in perspective: %s", error)


def _perspectives(
    output: Path, problem: dm.ContactProblem, bodies: dm.Tags, step: dict[str, Any], near: float
) -> None:
    """Draw mesh and fields, whole and at the contact, so that both symmetry planes show."""
    load = f"d = {step['displacement']:.4g} mm, P = {step['force']:.0f} N"
    plotter = dm.plotting.mesh(problem.solid.mesh, bodies, view=VIEW)
    _photograph(plotter, output / "mesh.png", "Quarter model", None)
    pictures = {
        "von_mises": ("von_mises", f"Von Mises stress [MPa], {load}", None),
        "von_mises_zoom": ("von_mises", f"Von Mises stress [MPa], {load}", near),
        "stress_z_zoom": ("stress_zz", f"Vertical stress [MPa], {load}", near),
        "deformed": ("displacement_z", f"Vertical displacement [mm], {load}", None),
    }
    if step["plastic_volume"] > 0.0:
        title = f"Plastic strain (Frobenius norm), {load}"
        pictures["plastic_strain_zoom"] = ("plastic_strain_norm", title, near)
    for name, (field, title, size) in pictures.items():
        plotter = dm.plotting.field(problem, field, view=VIEW)
        _photograph(plotter, output / f"{name}.png", title, size)


def _photograph(plotter: Any, file: Path, title: str, size: float | None) -> None:
    """Write a picture, or what is near the contact; only rank 0 has a plotter."""
    if plotter is None:
        return
    plotter.enable_parallel_projection()
    if size is not None:
        plotter.camera.focal_point = (0.0, 0.0, 0.0)
        plotter.camera.position = tuple(100.0 * c for c in VIEW)
        plotter.camera.parallel_scale = size
    # title and colour bar are drawn beside the bodies, so that nothing covers them
    scale = None
    if plotter.scalar_bars:
        scale = Normalize(*plotter.scalar_bar.GetLookupTable().GetRange())
        plotter.remove_scalar_bar()
    figure = Figure(figsize=(8.0, 5.8), layout="constrained")
    axes = figure.subplots()
    axes.imshow(plotter.screenshot(return_img=True))
    plotter.close()
    axes.set_axis_off()
    axes.set_title(title)
    if scale is not None:
        figure.colorbar(ScalarMappable(scale), ax=axes, shrink=0.8)
    figure.savefig(file, dpi=DPI)


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
    axes.legend(loc="upper right", fontsize="small", facecolor="#303030", labelcolor="white")
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

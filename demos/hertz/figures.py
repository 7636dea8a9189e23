# SPDX-License-Identifier: MIT
"""The pictures of the Hertz demo: figures 2 to 7 of the paper, deformed shape, contact pressure.

They are drawn on one rank from the XDMF file, so they look the same on any number of ranks. Fields
are computed as constants per cell; as in the paper they are averaged at the nodes before they are
drawn, on the deformed bodies at true scale.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import meshio
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

YY = 4  # place of the yy component among the nine of a tensor
DPI = 150
HARDENING = "Hardening: norm of the back stress as a vector (xx, yy, zz, xy)"


@dataclass(frozen=True)
class Result:
    """Last step of the XDMF file."""

    points: np.ndarray  # (n, 2) reference coordinates in mm
    cells: np.ndarray  # (m, k) corners
    u: np.ndarray  # (n, 2) displacement in mm
    fields: dict[str, np.ndarray]  # cell values by name, (m,) or (m, components)


def read(xdmf: Path) -> Result:
    """Read the last step that the file holds."""
    with meshio.xdmf.TimeSeriesReader(xdmf) as reader:
        points, (block,) = reader.read_points_cells()
        _, node, cell = reader.read_data(reader.num_steps - 1)
    corners = 3 if block.type.startswith("triangle") else 4
    fields = {name: values[0] for name, values in cell.items()}
    return Result(points[:, :2], block.data[:, :corners], node["displacement"][:, :2], fields)


def draw(
    output: Path, xdmf: Path, step: dict[str, Any], pressure: tuple[np.ndarray, np.ndarray]
) -> None:
    """Draw all pictures of the last step into a folder; call on one rank.

    Args:
        output: Existing folder for the PNG files.
        xdmf: File written by `dolfinx_mortar.Writer`, with the displacement and the cell fields
            stress, von_mises and hardening.
        step: The demo's numbers of the last step: load, force and Hertz' solution.
        pressure: Positions x [mm] and contact pressures [MPa] of the slave nodes.
    """
    result = read(xdmf)
    window = _contact_window(result, pressure)
    stress_y = result.fields["stress"][:, YY]
    von_mises = result.fields["von_mises"]
    hardening = result.fields.get("hardening", np.zeros_like(von_mises))  # none if all is elastic
    load = f"$d$ = {step['displacement']:.4g} mm, $P$ = {step['force']:.1f} N/mm"
    figures = {
        "fig2_mesh": _mesh(result),
        "fig3_hardening": _field(result, hardening, (HARDENING, load), "magma"),
        "fig4_stress_y": _field(result, stress_y, ("Stress σ$_y$", load), "viridis"),
        "fig5_von_mises": _field(result, von_mises, ("Von Mises stress", load), "viridis"),
        "fig6_stress_y_zoom": _field(
            result, stress_y, ("Stress σ$_y$ at the contact", load), "viridis", window
        ),
        "fig7_von_mises_zoom": _field(
            result, von_mises, ("Von Mises stress at the contact", load), "viridis", window
        ),
        "deformed": _deformed(result, window, load),
        "pressure": _pressure(step, pressure),
    }
    for name, figure in figures.items():
        figure.savefig(output / f"{name}.png", dpi=DPI)


def _contact_window(
    result: Result, pressure: tuple[np.ndarray, np.ndarray]
) -> tuple[float, float, float, float]:
    """Return x0, x1, y0, y1 of a square around the contact, on the deformed bodies."""
    x, p = pressure
    active = np.abs(x[p > 0.0])
    half = 2.5 * active.max() if active.size else 0.1 * np.ptp(result.points[:, 0])
    half = min(max(half, 0.02 * np.ptp(result.points[:, 0])), 0.3 * np.ptp(result.points[:, 0]))
    middle = np.argmin(np.linalg.norm(result.points, axis=1))
    y = result.points[middle, 1] + result.u[middle, 1]
    return -half, half, y - half, y + half


def _axes(width: float, height: float, title: str) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(width, height), layout="constrained")
    axes = figure.subplots()
    axes.set(aspect="equal", xlabel="x [mm]", ylabel="y [mm]", title=title)
    return figure, axes


def _add_cells(
    axes: Axes,
    x: np.ndarray,
    cells: np.ndarray,
    window: tuple[float, ...] | None = None,
    **style: Any,
) -> PolyCollection:
    """Draw the cells that meet the window (all without one) and fit the axes to them."""
    polygons = x[cells]
    values = style.pop("array", None)
    if window is not None:
        low, high = polygons.min(axis=1), polygons.max(axis=1)
        inside = (high[:, 0] > window[0]) & (low[:, 0] < window[1])
        inside &= (high[:, 1] > window[2]) & (low[:, 1] < window[3])
        polygons = polygons[inside]
        values = None if values is None else values[inside]
    collection = PolyCollection(polygons, array=values, **style)
    axes.add_collection(collection)
    if window is None:
        axes.autoscale()
        axes.margins(0.02)
    else:
        axes.set(xlim=window[:2], ylim=window[2:])
    return collection


def _mesh(result: Result) -> Figure:
    title = f"Mesh: {len(result.cells)} elements, {len(result.points)} nodes"
    figure, axes = _axes(8.0, 5.4, title)
    _add_cells(axes, result.points, result.cells, fc="#e8eef4", ec="#20415c", lw=0.3)
    return figure


def _field(
    result: Result,
    values: np.ndarray,
    titles: tuple[str, str],
    colours: str,
    window: tuple[float, ...] | None = None,
) -> Figure:
    """Draw a field in MPa with its colour bar, in a window or on the whole bodies."""
    figure, axes = _axes(*((8.0, 5.0) if window is None else (6.4, 5.6)), "\n".join(titles))
    x, cells = result.points + result.u, result.cells
    triangles = np.concatenate([cells[:, [0, i, i + 1]] for i in range(1, cells.shape[1] - 1)])
    drawn = axes.tripcolor(
        *x.T, triangles, _nodal_average(result, values), shading="gouraud", cmap=colours
    )
    if window is not None:
        axes.set(xlim=window[:2], ylim=window[2:])
    figure.colorbar(drawn, ax=axes, label="MPa", shrink=0.9)
    return figure


def _nodal_average(result: Result, values: np.ndarray) -> np.ndarray:
    """Return the mean over the cells at each node, weighted by their areas; bodies stay apart."""
    x = result.points[result.cells]
    area = _cross(x[:, 1] - x[:, 0], x[:, -1] - x[:, 0]) + _cross(
        x[:, -2] - x[:, 1], x[:, -2] - x[:, -1]
    )
    total = np.zeros((2, len(result.points)))
    for corner in result.cells.T:
        np.add.at(total[0], corner, area * values)
        np.add.at(total[1], corner, area)
    return total[0] / total[1]


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _deformed(result: Result, window: tuple[float, ...], load: str) -> Figure:
    """Draw the deformed mesh over the undeformed one, all of it and at the contact."""
    largest = float(np.linalg.norm(result.u, axis=1).max())
    figure = Figure(figsize=(11.0, 4.8), layout="constrained")
    figure.suptitle(f"Deformed shape at true scale, {load}")
    size = np.linalg.norm(result.u, axis=1)[result.cells].mean(axis=1)
    thin = min(0.3, 1e3 / len(result.cells))  # lines must not hide the colours of a fine mesh
    both = figure.subplots(1, 2, width_ratios=(1.55, 1.0))
    for axes, part in zip(both, (None, window), strict=True):
        axes.set(aspect="equal", xlabel="x [mm]", ylabel="y [mm]")
        x = result.points + result.u
        _add_cells(axes, result.points, result.cells, part, fc="none", ec="#bbbbbb", lw=thin)
        cells = _add_cells(
            axes, x, result.cells, part, array=size, cmap="viridis", ec="#ffffffa0", lw=thin
        )
        cells.set_clim(0.0, max(largest, 1e-300))
    figure.colorbar(cells, ax=both[1], label="|u| [mm]", shrink=0.9)
    return figure


def _pressure(step: dict[str, Any], pressure: tuple[np.ndarray, np.ndarray]) -> Figure:
    """Draw the nodal pressures and Hertz' elastic solution for the same force."""
    x, p = (values[np.argsort(pressure[0])] for values in pressure)
    a, p0 = step["half_width_hertz"], step["peak_pressure_hertz"]
    loaded = np.abs(x[p > 0.0])
    half = max(a, loaded.max()) if loaded.size else 0.1 * np.ptp(x)
    figure, axes = _axes(7.2, 4.6, f"Contact pressure at $P$ = {step['force']:.1f} N/mm")
    axes.set(aspect="auto", ylabel="pressure [MPa]", xlim=(-1.4 * half, 1.4 * half))
    t = np.linspace(0.0, np.pi, 201)
    hertz = f"Hertz, elastic: $p_0$ = {p0:.0f} MPa, $a$ = {a:.3f} mm"
    axes.plot(a * np.cos(t), p0 * np.sin(t), "k--", lw=1.2, label=hertz)
    computed = f"computed: largest {p.max(initial=0.0):.0f} MPa"
    axes.plot(x, p, "o-", color="#c03a2b", ms=3.5, lw=1.0, label=computed)
    axes.set_ylim(0.0, 1.25 * max(axes.get_ylim()[1], 1e-300))  # room for the legend
    axes.grid(alpha=0.3)
    axes.legend(loc="upper right", fontsize="small")
    return figure

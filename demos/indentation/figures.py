# SPDX-License-Identifier: MIT
"""The pictures of the indentation demo: curves beside the fits, pressures, and the plastic zone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import meshio
import numpy as np
from flattening import YieldOfSphere, jackson_green, kogut_etsion
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

DPI = 90
SHOWN = 5  # pressure curves


def draw(
    output: Path,
    xdmf: Path,
    case: tuple[str, YieldOfSphere],
    steps: list[dict[str, Any]],
    surfaces: list[dict[str, np.ndarray]],
) -> None:
    """Draw all pictures into a folder; call on one rank.

    Args:
        output: existing folder for the PNG files.
        xdmf: file of `dolfinx_mortar.Writer`, with displacement and plastic_strain_norm.
        case: "flattening" or "indentation", and first yield.
        steps: the demo's numbers of every step.
        surfaces: slave nodes of every step.
    """
    figure = Figure(figsize=(10.0, 8.0), layout="constrained")
    (curve, pressure), (zone, profile) = figure.subplots(2, 2)
    _curve(curve, *case, steps)
    _pressures(pressure, steps, surfaces, case[1].yield_stress)
    _zone(zone, xdmf, steps[-1])
    _profiles(profile, steps, surfaces)
    figure.savefig(output / "result.png", dpi=DPI)


def _curve(axes: Axes, case: str, at: YieldOfSphere, steps: list[dict[str, Any]]) -> None:
    """Draw force and contact radius over the interference, beside the fits."""
    w = np.array([s["interference"] for s in steps])
    fine = np.geomspace(w[0], w[-1], 200)
    if case == "flattening":
        for name, fit, style in (
            ("Jackson and Green", jackson_green, "k-"),
            ("Kogut and Etsion", kogut_etsion, "k--"),
        ):
            found = fit(fine * at.interference, at)
            axes.loglog(fine, found.force / at.force, style, lw=1.0, label=name)
            axes.loglog(fine, (found.contact_radius / at.contact_radius) ** 2, style, lw=1.0)
    else:
        axes.loglog(fine, fine**1.5, "k:", lw=1.0, label="Hertz, elastic")
    area = [(s["contact_radius"] / at.contact_radius) ** 2 for s in steps]
    axes.loglog(w, [s["force"] for s in steps], "o", color="#c03a2b", ms=4, label="force $P/P_c$")
    axes.loglog(w, area, "s", color="#20609f", ms=4, label="contact area $A/A_c$")
    axes.set(xlabel="interference $w/w_c$", title=case)
    axes.grid(alpha=0.3, which="both")
    axes.legend(fontsize="small")


def _pressures(
    axes: Axes, steps: list[dict[str, Any]], surfaces: list[dict[str, np.ndarray]], S: float
) -> None:
    """Draw pressures over the radius: first an ellipse, at large interferences a plateau."""
    for k in _chosen(steps):
        r, p = surfaces[k]["x"][:, 0], surfaces[k]["pressure"] / S
        order = np.argsort(r)
        near = order[: max(np.count_nonzero(p) + 1, 2)]
        label = f"$w/w_c$ = {steps[k]['interference']:.3g}"
        axes.plot(r[near], p[near], ".-", lw=1.0, ms=4, label=label)
    axes.set(xlabel="r [mm]", title="pressure over yield stress", ylim=(0.0, None))
    axes.grid(alpha=0.3)
    axes.legend(fontsize="small")


def _chosen(steps: list[dict[str, Any]]) -> list[int]:
    w = np.log([s["interference"] for s in steps])
    return sorted({int(np.argmin(np.abs(w - at))) for at in np.linspace(w[0], w[-1], SHOWN)})


def _profiles(
    axes: Axes, steps: list[dict[str, Any]], surfaces: list[dict[str, np.ndarray]]
) -> None:
    """Draw the profile of the surface, with the pile-up beside the contact."""
    size = 2.2 * steps[-1]["contact_radius"]
    for k in _chosen(steps)[1:]:
        order = np.argsort(surfaces[k]["x"][:, 0])
        r, z = surfaces[k]["x"][order].T
        axes.plot(r[r < size], z[r < size], lw=1.2, label=f"{steps[k]['interference']:.3g}")
    order = np.argsort(surfaces[0]["X"][:, 0])
    r, z = surfaces[0]["X"][order].T
    axes.plot(r[r < size], z[r < size], "k:", lw=1.0, label="unloaded")
    axes.set(xlabel="r [mm]", ylabel="z [mm]", title="surface, heights enlarged")
    axes.grid(alpha=0.3)
    axes.legend(fontsize="small", title="$w/w_c$")


def _zone(axes: Axes, xdmf: Path, step: dict[str, Any]) -> None:
    """Draw the plastic strain on the deformed bodies around the contact."""
    with meshio.xdmf.TimeSeriesReader(xdmf) as reader:
        points, (block,) = reader.read_points_cells()
        _, node, cell = reader.read_data(reader.num_steps - 1)
    corners = 3 if block.type.startswith("triangle") else 4
    cells, strain = block.data[:, :corners], cell["plastic_strain_norm"][0]
    x = points[:, :2] + node["displacement"][:, :2]
    size = 2.2 * step["contact_radius"]
    polygons = x[cells]
    near = np.abs(polygons).max(axis=(1, 2)) < 1.5 * size
    drawn = PolyCollection(
        polygons[near], array=100.0 * strain[near], cmap="magma_r", ec="#00000030", lw=0.2
    )
    axes.add_collection(drawn)
    axes.set(xlim=(0.0, size), ylim=(-size / 2, size / 2), aspect="equal", xlabel="r [mm]")
    axes.set(ylabel="z [mm]", title=f"plastic strain at $w/w_c$ = {step['interference']:.3g}")
    axes.figure.colorbar(drawn, ax=axes, label="%", shrink=0.8)

# SPDX-License-Identifier: MIT
"""The pictures of Taylor's bar, drawn on one rank from its file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import meshio
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from PIL import Image

Array = npt.NDArray[np.float64]
AROUND = (0, 4, 1, 5, 2, 6, 3, 7)  # nodes of a cell of second order, along its edges
PARTS = {"kinetic": "#9ec5e8", "stored": "#f0c987", "dissipated": "#c9a6a1"}
RADII = {"radius": (7.19, 7.27), "length": (21.35, 21.50)}  # mm, of codes that do not lock


def frames_of(xdmf: Path) -> tuple[Array, list[tuple[Array, Array]]]:
    """Return the times, and corners (m, 8, 2), moved, with plastic strains (m,) at each."""
    with meshio.xdmf.TimeSeriesReader(xdmf) as reader:
        points, (block,) = reader.read_points_cells()
        steps = [reader.read_data(k) for k in range(reader.num_steps)]
    cells = block.data[:, AROUND]
    frames = [
        ((points[:, :2] + node["displacement"][:, :2])[cells], cell["plastic_strain_norm"][0])
        for _, node, cell in steps
    ]
    return np.array([time for time, _, _ in steps]), frames


def draw_bar(axes: Axes, frame: tuple[Array, Array], largest: float) -> PolyCollection:
    """Draw the section of the bar on its wall, with the plastic strain."""
    corners, strain = frame
    both = np.concatenate([corners, corners * [-1.0, 1.0]])
    shown = PolyCollection(
        both,
        array=np.tile(np.sqrt(2.0 / 3.0) * np.ravel(strain), 2),
        **{"ec": "#ffffff80", "lw": 0.3, "cmap": "viridis"},
    )
    shown.set_clim(0.0, largest)
    axes.add_collection(shown)
    axes.fill_between([-9.0, 9.0], -1.2, 0.0, color="#a8a8a8", lw=0.0)
    axes.plot([-3.2, -3.2, 3.2, 3.2], [0.0, 32.4, 32.4, 0.0], color="#909090", ls=":", lw=1.0)
    axes.set(xlim=(-9.0, 9.0), ylim=(-1.2, 33.2), aspect="equal")
    axes.axis("off")
    return shown


def draw_energies(axes: Axes, rows: list[dict[str, Any]], upto: int) -> None:
    """Draw the ledger up to a step, in J."""
    t = 1e6 * np.array([row["time"] for row in rows])
    parts = [1e-3 * np.array([row["ledger"][name] for row in rows]) for name in PARTS]
    shown = [part[: upto + 1] for part in parts]
    axes.stackplot(t[: upto + 1], *shown, colors=PARTS.values(), labels=PARTS)
    initial = 1e-3 * rows[0]["ledger"]["initial"]
    axes.axhline(initial, color="black", ls="--", lw=0.8, label="at the start")
    defect = max(abs(row["ledger"]["defect"]) for row in rows)
    axes.set(title=f"energy, kept to {defect:.0e}", ylabel="J", xlabel="time [µs]")
    axes.set(xlim=(0.0, t[-1]), ylim=(0.0, 1.3 * initial))
    axes.legend(fontsize=8, loc="upper center", ncols=2, frameon=False)
    axes.grid(alpha=0.3)


def draw_shape(axes: Axes, rows: list[dict[str, Any]], upto: int) -> None:
    """Draw radius and length up to a step, beside the final values of other codes."""
    t = 1e6 * np.array([row["time"] for row in rows])
    for (name, band), colour in zip(RADII.items(), ("#c03a2b", "#20609f"), strict=True):
        values = [row[name] for row in rows[: upto + 1]]
        label = {"radius": "radius of the foot"}.get(name, name)
        axes.plot(t[: upto + 1], values, color=colour, lw=1.6, label=label)
        middle, half = np.mean(band), np.diff(band)[0] / 2
        axes.errorbar(t[-1], middle, yerr=half, fmt="ks", ms=4, mfc="none", capsize=5)
        said = f"other codes: {band[0]:.2f} to {band[1]:.2f} mm"
        axes.text(0.95 * t[-1], middle - 1.6, said, ha="right", va="center", fontsize=8)
    axes.set(title="shape", ylabel="mm", xlabel="time [µs]", xlim=(0.0, 1.04 * t[-1]))
    axes.set_ylim(0.0, 34.0)
    axes.legend(fontsize=8, loc="upper right", frameon=False)
    axes.grid(alpha=0.3)


def picture(
    rows: list[dict[str, Any]], frame: tuple[Array, Array], upto: int, largest: float
) -> Figure:
    """Return the bar beside shape and ledger up to a step."""
    figure = Figure(figsize=(11.0, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    left, middle, right = figure.subplots(1, 3, width_ratios=(0.85, 1.0, 1.0))
    shown = draw_bar(left, frame, largest)
    left.set_title(f"{1e6 * rows[upto]['time']:.0f} µs")
    figure.colorbar(shown, ax=left, label="equivalent plastic strain", shrink=0.8)
    draw_shape(middle, rows, upto)
    draw_energies(right, rows, upto)
    return figure


def draw(folder: Path, xdmf: Path, rows: list[dict[str, Any]], *, animated: bool) -> None:
    """Write result.png and, on request, taylor_bar.gif; call on one rank."""
    times, frames = frames_of(xdmf)
    largest = float(np.sqrt(2.0 / 3.0) * frames[-1][1].max())
    picture(rows, frames[-1], len(rows) - 1, largest).savefig(folder / "result.png", dpi=110)
    if not animated:
        return
    at = np.array([row["time"] for row in rows])
    images = []
    for time, frame in zip(times, frames, strict=True):
        figure = picture(rows, frame, int(np.abs(at - time).argmin()), largest)
        figure.set_dpi(60)
        figure.canvas.draw()
        image = Image.fromarray(np.asarray(figure.canvas.buffer_rgba())).convert("RGB")
        images.append(image.quantize(96, Image.Quantize.MAXCOVERAGE))
    shown = [*images, *([images[-1]] * 4)]
    shown[0].save(
        folder / "taylor_bar.gif", save_all=True, append_images=shown[1:], duration=150, loop=0
    )

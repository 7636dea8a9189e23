# SPDX-License-Identifier: MIT
"""The pictures of the ironing demo, drawn on one rank from its file: forces, bodies, animation."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import meshio
import numpy as np
import numpy.typing as npt
from literature import FORCES
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from PIL import Image

Array = npt.NDArray[np.float64]
MARKERS = "os^vD*"
SHOWN = 0.98  # quantile of the stress at which colours end


def frames_of(xdmf: Path) -> list[tuple[Array, Array]]:
    """Return corners (m, 4, 2), moved, and von Mises stresses (m,) of all steps."""
    with meshio.xdmf.TimeSeriesReader(xdmf) as reader:
        points, (block,) = reader.read_points_cells()
        steps = [reader.read_data(k)[1:] for k in range(reader.num_steps)]
    return [
        ((points[:, :2] + node["displacement"][:, :2])[block.data], cell["von_mises"][0])
        for node, cell in steps
    ]


def draw_bodies(axes: Axes, frame: tuple[Array, Array], largest: float) -> PolyCollection:
    """Draw the deformed bodies with their stress."""
    corners, stress = frame
    shown = PolyCollection(corners, array=stress, ec="#ffffff80", lw=0.2, cmap="viridis")
    shown.set_clim(0.0, largest)
    axes.add_collection(shown)
    axes.set(xlim=(-0.4, 12.4), ylim=(-0.1, 5.6), aspect="equal")
    axes.axis("off")
    return shown


def draw_forces(axes: Axes, rows: list[dict[str, Any]], upto: int) -> None:
    """Draw both forces up to a step, beside those of others, with friction, at t = 1 and 1.5."""
    t = np.array([0.0, *(row["time"] for row in rows)])
    for name, label, colour in (("vertical", "V", "C0"), ("horizontal", "H", "C3")):
        force = np.array([0.0, *(row[name] for row in rows)])
        axes.plot(t[: upto + 1], force[: upto + 1], ".-", ms=4, color=colour, label=label)
    for (name, at), marker in zip(FORCES.items(), MARKERS, strict=True):
        V, H = np.array(at).T
        style: dict[str, Any] = {"ls": "", "marker": marker, "ms": 5, "mfc": "none"}
        axes.plot([1.0, 1.5], V, color="C0", mew=0.8, **style)
        axes.plot([1.0, 1.5], H, color="C3", mew=0.8, **style)
        axes.plot([], [], color="0.3", mew=0.8, label=name, **style)
    axes.set(xlabel="t (down to 1, along to 2)", ylabel="force [N/mm]", xlim=(0.0, 2.05))
    lowest = min(0.0, *(row["horizontal"] for row in rows))
    axes.set_ylim(1.1 * lowest - 5.0, 450.0)
    axes.grid(alpha=0.3)
    axes.legend(fontsize="x-small", loc="upper left", frameon=False)


def picture(
    rows: list[dict[str, Any]], frames: list[tuple[Array, Array]], step: int, largest: float
) -> Figure:
    """Return forces up to a step, beside the bodies then."""
    figure = Figure(figsize=(10.5, 3.9), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.8))
    draw_forces(left, rows, step + 1)
    shown = draw_bodies(right, frames[step], largest)
    label = "von Mises stress (Cauchy) [MPa]"
    bar = {"shrink": 0.7, "orientation": "horizontal", "extend": "max"}
    figure.colorbar(shown, ax=right, label=label, **bar)
    return figure


def draw(folder: Path, xdmf: Path, rows: list[dict[str, Any]], *, animated: bool) -> None:
    """Write result.png, half way along, and on request ironing.gif; call on one rank."""
    frames = frames_of(xdmf)
    largest = float(np.quantile(frames[-1][1], SHOWN))
    half_way = int(np.argmin([abs(row["time"] - 1.5) for row in rows]))
    result = picture(rows, frames, len(rows) - 1, largest)
    bodies = result.axes[1]
    bodies.collections[0].remove()
    draw_bodies(bodies, frames[half_way], largest)
    result.savefig(folder / "result.png", dpi=110)
    if not animated:
        return
    images = []
    for step in range(len(rows)):
        figure = picture(rows, frames, step, largest)
        figure.set_dpi(70)
        figure.canvas.draw()
        image = Image.fromarray(np.asarray(figure.canvas.buffer_rgba())).convert("RGB")
        images.append(image.quantize(96, Image.Quantize.MAXCOVERAGE))
    shown = [*images, *([images[-1]] * 4)]
    shown[0].save(
        folder / "ironing.gif", save_all=True, append_images=shown[1:], duration=200, loop=0
    )

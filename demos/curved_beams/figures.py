# SPDX-License-Identifier: MIT
"""The pictures of the curved beams, drawn on one rank from their file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import meshio
import numpy as np
import numpy.typing as npt
from literature import LARGEST, MOTION, REACTIONS
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from PIL import Image

Array = npt.NDArray[np.float64]
FIELDS = {
    "von_mises": "von Mises stress (Cauchy) [MPa]",
    "plastic_strain_norm": "logarithmic plastic strain, Frobenius norm",
}


def frames_of(xdmf: Path) -> list[tuple[Array, dict[str, Array]]]:
    """Return corners (m, 4, 2), moved, and the fields of the cells (m,) of all steps."""
    with meshio.xdmf.TimeSeriesReader(xdmf) as reader:
        points, (block,) = reader.read_points_cells()
        steps = [reader.read_data(k)[1:] for k in range(reader.num_steps)]
    return [
        (
            (points[:, :2] + node["displacement"][:, :2])[block.data],
            {name: cell[name][0] for name in FIELDS},
        )
        for node, cell in steps
    ]


def draw_bodies(axes: Axes, corners: Array, values: Array, largest: float) -> PolyCollection:
    """Draw the deformed beams with a field."""
    shown = PolyCollection(corners, array=values, ec="#ffffff80", lw=0.15, cmap="viridis")
    shown.set_clim(0.0, largest)
    axes.add_collection(shown)
    axes.set(xlim=(-13.0, 41.0), ylim=(-0.5, 17.5), aspect="equal")
    axes.axis("off")
    return shown


def draw_forces(axes: Axes, rows: list[dict[str, Any]], friction: float, upto: int) -> None:
    """Draw the reactions of the lower feet up to a step, beside those of Neto and others."""
    d = np.array([0.0, *(row["motion"] for row in rows)])
    published = REACTIONS.get(friction)
    for k, (name, label) in enumerate((("reaction_x", "$R_x$"), ("reaction_y", "$R_y$"))):
        force, colour = np.array([0.0, *(row[name] for row in rows)]), f"C{3 - 3 * k}"
        axes.plot(d[: upto + 1], force[: upto + 1], lw=1.2, color=colour, label=label)
        if published is not None:
            known = [(at, F) for at, F in zip(MOTION, published[k], strict=True) if F is not None]
            known += [LARGEST[friction]] if k else []
            others = {"label": "Neto and others 2016"} if k else {}
            axes.plot(*np.array(known).T, "o", color=colour, mfc="none", ms=5, **others)
    forces = np.array([[row["reaction_x"], row["reaction_y"]] for row in rows])
    low, high = min(forces.min(), 0.0), forces.max()
    room = 0.08 * (high - low)
    axes.set(xlim=(0.0, d[-1]), ylim=(low - room, high + 5 * room))
    axes.set(xlabel="motion of the upper beam [mm]", ylabel="reaction of the feet [N/mm]")
    axes.set_title(f"friction coefficient {friction:g}", fontsize="small")
    axes.grid(alpha=0.3)
    axes.legend(fontsize="x-small", loc="upper left", frameon=False)


def picture(
    rows: list[dict[str, Any]],
    frames: list[tuple[Array, dict[str, Array]]],
    friction: float,
    steps: tuple[int, int],
) -> Figure:
    """Return forces up to the last of two steps, beside the stress then, plastic strain there."""
    figure = Figure(figsize=(10.5, 4.6), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.0, 1.5))
    draw_forces(figure.add_subplot(grid[:, 0]), rows, friction, steps[1] + 1)
    for row, (step, (name, label)) in enumerate(zip(steps, FIELDS.items(), strict=True)):
        axes = figure.add_subplot(grid[row, 1])
        corners, values = frames[step]
        largest = max(float(fields[name].max()) for _, fields in frames) or 1e-2
        shown = draw_bodies(axes, corners, values[name], largest)
        axes.set_title(f"{rows[step]['motion']:g} mm", fontsize="small")
        figure.colorbar(shown, ax=axes, shrink=0.8).set_label(label, fontsize="x-small")
    return figure


def draw(
    folder: Path, xdmf: Path, rows: list[dict[str, Any]], friction: float, *, animated: bool
) -> None:
    """Write result.png: stress at the largest force, plastic strain at last; curved_beams.gif."""
    frames = frames_of(xdmf)
    highest = int(np.argmax([row["reaction_y"] for row in rows]))
    picture(rows, frames, friction, (highest, len(rows) - 1)).savefig(
        folder / "result.png", dpi=110
    )
    if not animated:
        return
    images = []
    for step in range(0, len(rows), 2):
        figure = picture(rows, frames, friction, (step, step))
        figure.set_dpi(70)
        figure.canvas.draw()
        image = Image.fromarray(np.asarray(figure.canvas.buffer_rgba())).convert("RGB")
        images.append(image.quantize(96, Image.Quantize.MAXCOVERAGE))
    shown = [*images, *([images[-1]] * 6)]
    shown[0].save(
        folder / "curved_beams.gif", save_all=True, append_images=shown[1:], duration=200, loop=0
    )

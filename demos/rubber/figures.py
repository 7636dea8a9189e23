# SPDX-License-Identifier: MIT
"""The pictures of the rubber cylinder, drawn on one rank from its file."""

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
RADIUS = 200.0
GRAPH = ((100.0, 200.0), (250.0, 1400.0))  # Sussman and Bathe: mm, N/mm
VARIANTS = (0.966, 1.066)  # of another program, of the graph


def frames_of(xdmf: Path) -> list[tuple[Array, Array, Array]]:
    """Return corners (m, k, 2), moved, von Mises stresses (m,) and which cells are of rubber."""
    with meshio.xdmf.TimeSeriesReader(xdmf) as reader:
        points, (block,) = reader.read_points_cells()
        steps = [reader.read_data(k)[1:] for k in range(reader.num_steps)]
    cells = block.data[:, : 3 if block.type.startswith("triangle") else 4]
    rubber = points[cells, 1].mean(axis=1) > 0.0
    return [
        ((points[:, :2] + node["displacement"][:, :2])[cells], cell["von_mises"][0], rubber)
        for node, cell in steps
    ]


def draw_bodies(axes: Axes, frame: tuple[Array, Array, Array], largest: float) -> PolyCollection:
    """Draw all four quarters around the middle of the cylinder, with the stress of the rubber."""
    corners, stress, rubber = frame
    middle = corners[rubber][:, :, 1].max()
    quarter = corners - [0.0, middle]
    four = [quarter * [s, t] for s in (1.0, -1.0) for t in (1.0, -1.0)]
    plates = np.concatenate([q[~rubber] for q in four])
    axes.add_collection(PolyCollection(plates, fc="#c8c8c8", ec="#a8a8a8", lw=0.2))
    shown = PolyCollection(
        np.concatenate([q[rubber] for q in four]),
        array=np.tile(stress[rubber], 4),
        **{"ec": "#ffffff60", "lw": 0.15, "cmap": "viridis"},
    )
    shown.set_clim(0.0, largest)
    axes.add_collection(shown)
    axes.set(xlim=(-1.9 * RADIUS, 1.9 * RADIUS), ylim=(-1.2 * RADIUS, 1.2 * RADIUS))
    axes.set_aspect("equal")
    axes.axis("off")
    return shown


def draw_force(axes: Axes, rows: list[dict[str, Any]], upto: int) -> None:
    """Draw the force up to a step, beside Sussman and Bathe's."""
    d, F = (np.array([0.0, *(row[name] for row in rows)]) for name in ("approach", "force"))
    axes.plot(d[: upto + 1], F[: upto + 1], ".-", ms=4, label="computed")
    at, force = np.array(GRAPH)
    spread = np.abs(np.outer(np.array(VARIANTS) - 1.0, force))
    label = "Sussman, Bathe 1987; bars: variants of Ansys"
    axes.errorbar(at, force, yerr=spread, fmt="ks", ms=4, mfc="none", capsize=4, lw=1, label=label)
    top = 1.1 * max(float(F.max()), VARIANTS[1] * float(force[at <= d[-1]].max(initial=1.0)))
    axes.set(xlabel="approach of the plates [mm]", ylabel="force [N/mm]")
    axes.set(xlim=(0.0, 1.04 * d[-1]), ylim=(0.0, top))
    axes.grid(alpha=0.3)
    axes.legend(fontsize="small", loc="upper left", frameon=False)


def picture(
    rows: list[dict[str, Any]],
    frames: list[tuple[Array, Array, Array]],
    step: int,
    largest: float,
) -> Figure:
    """Return the force up to a step, beside the bodies then."""
    figure = Figure(figsize=(10.0, 4.0), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.5))
    draw_force(left, rows, step + 1)
    shown = draw_bodies(right, frames[step], largest)
    label = "von Mises stress (Cauchy) [MPa]"
    bar = {"shrink": 0.7, "orientation": "horizontal", "extend": "max"}
    figure.colorbar(shown, ax=right, label=label, **bar)
    return figure


def draw(folder: Path, xdmf: Path, rows: list[dict[str, Any]], *, animated: bool) -> None:
    """Write result.png and, on request, rubber.gif; call on one rank."""
    frames = frames_of(xdmf)
    largest = float(np.quantile(frames[-1][1][frames[-1][2]], 0.99))
    picture(rows, frames, len(rows) - 1, largest).savefig(folder / "result.png", dpi=110)
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
        folder / "rubber.gif", save_all=True, append_images=shown[1:], duration=250, loop=0
    )
